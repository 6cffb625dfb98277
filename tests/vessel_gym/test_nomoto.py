"""Nomoto's model of a ship: of records with known figures, and of our ships."""

from dataclasses import replace

import numpy as np
import pytest
from nomoto_models import nomoto_fit, nomoto_linear
from scipy.signal import StateSpace, lsim

from vessel_gym.sea_trials import simulate
from vessel_gym.vehicles.corvette import sway_yaw_jacobian
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.files import load

SHIP = load("corvette-thesis")
SHIPS = {"thesis": SHIP, "corvette": load("corvette")}
each_ship = pytest.mark.parametrize("ship", SHIPS.values(), ids=SHIPS)
L = SHIP.length
DEG = np.pi / 180.0


@each_ship
def test_the_fit_is_exact_for_a_linear_ship_whose_rudder_moves_linearly_between_samples(ship: CorvetteParameters):
    A, B = sway_yaw_jacobian(np.array([ship.speed, 0.0, 0.0]), np.array(0.0), ship)
    time = 0.5 * np.arange(240)
    rudder = np.repeat(np.random.default_rng(0).normal(size=40), 6) * 0.1
    _, yaw_rate, _ = lsim(StateSpace(A, B, [[0.0, 1.0]], [[0.0]]), rudder, time)
    fit, exact = nomoto_fit(time, rudder, yaw_rate, ship.speed, L), nomoto_linear(ship)
    for name in ("K", "T", "T1", "T2", "T3"):
        assert getattr(fit, name) == pytest.approx(getattr(exact, name), rel=1e-9)


@each_ship
def test_the_linear_figures_are_the_gain_and_the_slope_of_the_ships_transfer_function(ship: CorvetteParameters):
    A, B = sway_yaw_jacobian(np.array([ship.speed, 0.0, 0.0]), np.array(0.0), ship)
    unit = L / ship.speed

    def gain(s: complex) -> complex:
        return np.linalg.solve(s * np.eye(2) - A, B)[1, 0]

    n = nomoto_linear(ship)
    assert pytest.approx(gain(0.0) * unit) == n.K
    assert n.K > 0.0  # positive rudder turns to starboard
    rises = [np.log(gain(s)) - np.log(gain(-s)) for s in (1e-4, 2e-4)]
    slope = (8.0 * rises[0] - rises[1]) / 12e-4
    assert pytest.approx(-slope / unit, rel=1e-6) == n.T
    s = 0.3j  # any other point of the complex plane
    model = n.K * (1.0 + n.T3 * s) / ((1.0 + n.T1 * s) * (1.0 + n.T2 * s))
    assert abs(model / (gain(s / unit) * unit) - 1.0) < 1e-9


def small_zigzag(ship: CorvetteParameters, rudder: float):
    """The fit to a zig-zag in whose steps the rudder moves linearly: it goes over in one, back in two."""
    orders = [rudder]

    def helmsman(_: float, state: np.ndarray) -> float:
        """The rudder is reversed at the first sample at which the heading has changed by as much."""
        if np.sign(orders[-1]) * state[2] >= rudder:
            orders.append(-orders[-1])
        return orders[-1]

    dt = rudder / ship.rudder_rate
    track = simulate(ship, helmsman, 1800.0, dt, stop=lambda _: len(orders) > 3)
    return nomoto_fit(track.time, track.rudder, track.state[:, 5], ship.speed, L)


def test_a_small_zigzag_shows_the_linearised_ship():
    fit, exact = small_zigzag(SHIP, 0.25 * DEG), nomoto_linear(SHIP)
    assert pytest.approx(exact.K, rel=0.05) == fit.K
    assert pytest.approx(exact.T, rel=0.05) == fit.T
    assert min(fit.K, fit.T) > 0.0


def test_what_a_zigzag_shows_beyond_the_linearised_ship_is_cross_flow_drag():
    # |v| v is of second order: its share goes with the rudder angle, and without it two degrees are still small.
    exact = nomoto_linear(SHIP)
    large, half = small_zigzag(SHIP, 0.5 * DEG), small_zigzag(SHIP, 0.25 * DEG)
    assert pytest.approx(2.0, rel=0.1) == (exact.K - large.K) / (exact.K - half.K)
    assert pytest.approx(2.0, rel=0.1) == (exact.T - large.T) / (exact.T - half.T)
    smooth = replace(SHIP, drag_coefficient=0.0)
    fit, exact = small_zigzag(smooth, 2 * DEG), nomoto_linear(smooth)
    assert pytest.approx(exact.K, rel=0.005) == fit.K
    assert pytest.approx(exact.T, rel=0.005) == fit.T


def test_a_record_that_does_not_determine_the_model_is_refused():
    time = 0.5 * np.arange(50)
    turn = simulate(SHIP, 0.02, 24.5)
    yaw_rate = turn.state[:, 5]
    for t, d, r in (
        (time, np.zeros(50), yaw_rate),
        (time, turn.rudder, np.zeros(50)),
        (time**1.1, turn.rudder, yaw_rate),
        (time[:6], turn.rudder[:6], yaw_rate[:6]),
        (time, np.full(50, 0.02), yaw_rate),
    ):
        with pytest.raises(ValueError, match="record"):
            nomoto_fit(t, d, r, SHIP.speed, L)
