"""Numbers of manoeuvres, against circles and triangles whose numbers are known."""

from dataclasses import replace

import numpy as np

from tests.vessel_gym.identification.voyages import SHIP, coefficients
from vessel_gym.identification.manoeuvres import compare, executed, execution, manoeuvre, periods, track_errors
from vessel_gym.identification.prediction import simulate
from vessel_gym.identification.score import Predict, predictors
from vessel_gym.identification.trial import Trial
from vessel_gym.vehicles.measured_ship import MeasuredShip


def circle(side: float, course: float, radius: float = 5.0) -> np.ndarray:
    """States on a circle, at a speed that falls by a third in half a turn."""
    psi = np.linspace(0.0, 1.2 * np.pi, 2001)
    north, east = radius * np.sin(psi), side * radius * (1.0 - np.cos(psi))
    cos, sin = np.cos(course), np.sin(course)
    speed = 1.5 - 0.5 * psi / np.pi
    zero = np.zeros_like(psi)
    return np.stack([cos * north - sin * east, sin * north + cos * east, course + side * psi, speed, zero, zero], -1)


def test_a_circle_has_its_radius_as_advance_and_its_diameter() -> None:
    for side in (1.0, -1.0):
        for course in (0.0, 2.5):
            found = manoeuvre(circle(side, course), np.full(2000, 0.6 * side))
            np.testing.assert_allclose(found.advance, 5.0, rtol=1e-5)
            np.testing.assert_allclose(found.tactical_diameter, 10.0, rtol=1e-5)
            np.testing.assert_allclose(found.speed_loss, 1.0 / 3.0, rtol=1e-5)
            assert found.overshoots == ()


def test_overshoots_are_what_the_heading_goes_on_after_a_reversal() -> None:
    psi = np.concatenate([np.linspace(0, 13, 131), np.linspace(13, -14, 271)[1:], np.linspace(-14, 0, 141)[1:]])
    states = np.zeros((len(psi), 6))
    states[:, 2], states[:, 3] = np.deg2rad(psi), 1.0
    rudder = np.full(len(psi) - 1, 0.2)
    rudder[100:360] = -0.2  # at 10 degrees, and at -10 on the way down
    rudder[98:100] = 0.0
    found = manoeuvre(states, rudder)
    np.testing.assert_allclose(np.rad2deg(found.overshoots), [3.0, 4.0], atol=0.1)
    gone = manoeuvre(states[:131], rudder[:130])  # it ends before the ship comes back
    assert len(gone.overshoots) == 1
    assert np.isnan(gone.overshoots[0])
    assert execution(np.concatenate([np.full(50, -0.14), rudder]), np.concatenate([np.zeros(50), states[:, 2]])) == 50
    assert np.isnan(found.advance)


def test_a_trial_of_the_model_itself_has_no_gap() -> None:
    rng = np.random.default_rng(0)
    c, dt = coefficients(rng, 0.2), 0.2
    control = np.stack(
        [np.r_[np.zeros(20), np.full(20, -0.5), np.zeros(10), np.full(600, 0.5)], np.full(650, 10.0)], -1
    )
    air, start = np.zeros((650, 4)), np.array([0.0, 0.0, 1.0, 0.4, 0.0, 0.0])
    states = simulate(start, control, air, c, SHIP.vector(), dt)
    assert execution(control[:, 0], states[:, 2]) == 50
    assert execution(np.zeros(10), np.zeros(11)) is None
    ship = MeasuredShip.assumed(SHIP)
    predict = predictors(replace(ship, coefficients=c), dt, {})["identified model"]
    found = compare(predict, Trial("turn", dt, 0.0, states, control, air))
    part = executed(Trial("turn", dt, 0.0, states, control, air))
    assert part is not None
    np.testing.assert_array_equal(track_errors(predict, part, [1.0, 5.0]), 0.0)
    assert found is not None
    assert np.isfinite([found[0].advance, found[0].tactical_diameter, found[0].speed_loss]).all()
    assert found[0] == found[1]


def turning(rate: float, speed: float = 0.0, dt: float = 0.1) -> Predict:
    """A ship that turns at once, at a rate [rad/s] in proportion to the sine of her rudder, and advances north."""

    def predict(state: np.ndarray, control: np.ndarray, air: np.ndarray) -> np.ndarray:
        steps = np.zeros((len(control), *state.shape))
        steps[..., 0], steps[..., 2] = speed * dt, rate * dt * np.sign(control[..., 0])
        return state + np.concatenate([np.zeros_like(steps[:1]), np.cumsum(steps, 0)])

    return predict


def zigzag(angle: float = 10.0, legs: int = 6) -> Trial:
    """A zig-zag of a ship that turns at 1 degree/s and advances at 1 m/s: her period is four times the angle [s]."""
    count = round(20.0 * angle)
    side = np.concatenate([np.ones(count // 2), *(np.full(count, (-1.0) ** (k + 1)) for k in range(legs))])
    control = np.stack([0.3 * side, np.full_like(side, 10.0)], -1)
    predict = turning(np.deg2rad(1.0), 1.0)
    states = predict(np.zeros((1, 6)), control[:, None], np.zeros((len(side), 1, 4)))[:, 0]
    return Trial("zigzag", 0.1, 0.0, states, control, np.zeros((len(side), 4)))


def test_periods_are_those_of_triangles_and_half_as_long_for_a_ship_that_turns_twice_as_fast() -> None:
    part = zigzag()
    for factor in (1.0, 2.0, 0.5):
        measured, simulated = periods(turning(factor * np.deg2rad(1.0)), part)
        np.testing.assert_allclose(measured, [40.0] * 4, atol=1e-9)
        np.testing.assert_allclose(simulated, 40.0 / factor, atol=0.25)  # a step at each reversal


def test_a_ship_that_does_not_reach_the_heading_has_no_period() -> None:
    _, simulated = periods(turning(np.deg2rad(0.2)), zigzag())
    assert np.isnan(simulated).all()


def test_a_track_is_off_by_what_a_faster_ship_gains() -> None:
    found = track_errors(turning(0.0, 1.2), zigzag(), [5.0, 20.0, 1e4])
    np.testing.assert_allclose(found, [1.0, 4.0, np.nan], rtol=1e-6)
