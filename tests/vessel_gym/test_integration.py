"""The step that all vehicles share: the solution of their rates, and the same for many states as for each."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from stepping import step

from vessel_gym.envs.ship import ship_system
from vessel_gym.vehicles.corvette_equations import CorvetteParameters, corvette_rates
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.integration import Rates, incremented, resolving_substeps, runge_kutta
from vessel_gym.vehicles.itsunusa import itsunusa_rates
from vessel_gym.vehicles.puna import puna_rates
from vessel_gym.vehicles.segorogeni import segorogeni_rates


@dataclass(frozen=True)
class Case:
    """A vehicle in a hard manoeuvre, along which no velocity changes sign: v |v| has no second derivative there."""

    rates: Rates
    c: np.ndarray
    state: list[float]
    control: list[float]  # before and after
    flow: list[float]
    dt: float  # s


CASES = {
    "corvette": Case(
        corvette_rates, load("corvette").vector(),
        [3.0, -4.0, 0.7, 13.0, -1.5, 0.03, -0.1, 0.02], [0.3, 0.5], [0.3, -0.5, 1e5, -2e5, 5e6, 1e6, 0.2], 4.0,
    ),
    "segorogeni": Case(
        segorogeni_rates, load("segorogeni").vector(),
        [1.2, 0.5, -0.4, -1.5, 0.8, -1.0, 5.0, -3.0, 4.0, 0.4, -0.5, 2.0], [0.1, -0.2, 2.0, 0.2, 0.3, 7.0], [0.3, -0.2],
        0.1,
    ),
    "itsunusa": Case(
        itsunusa_rates, load("itsunusa").vector(),
        [1.4, -0.1, 0.2, 5.0, 4.0, -0.5], [-0.2, 10.0, 0.3, 35.0], [0.3], 0.2,
    ),
    "puna": Case(
        puna_rates, load("puna").vector(),
        [3.0, -4.0, 100.0, 14.0, 11.0, 3.0, 0.4], [4.0, 0.02, -0.6, 7.0, 0.07, 0.6], [2.0, -1.0, 0.5], 1.0,
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", CASES)
def test_a_step_nears_the_solution_of_the_rates_with_the_fourth_power_of_its_length(vehicle: str):
    case = CASES[vehicle]
    state, control, flow = np.array(case.state), np.array(case.control), np.array(case.flow)
    before, after = np.split(control, 2)
    solution = solve_ivp(
        lambda t, s: case.rates(s, before + (after - before) * t / case.dt, flow, case.c),
        (0.0, case.dt), state, method="DOP853", rtol=1e-13, atol=1e-13,
    )  # fmt: skip
    exact = solution.y[:, -1]
    errors = [np.abs(step(case.rates, state, control, flow, case.c, case.dt, n) - exact).max() for n in (8, 16, 32)]
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ((ratios > 13.0) & (ratios < 20.0)).all()
    finest = step(case.rates, state, control, flow, case.c, case.dt, 512)
    np.testing.assert_allclose(finest, exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize("rows", [1, 3, 15, 16, 17, 40])
@pytest.mark.parametrize("vehicle", CASES)
def test_rows_of_a_batch_step_as_each_alone(vehicle: str, rows: int):
    case, rng = CASES[vehicle], np.random.default_rng(0)
    states = np.array(case.state) * rng.uniform(0.5, 1.5, (3, rows, len(case.state)))
    controls = np.array(case.control) * rng.uniform(0.5, 1.5, (3, rows, len(case.control)))
    ambient_flows = rng.normal(size=(3, rows, len(case.flow)))
    c = case.c * rng.uniform(0.9, 1.1, (rows, len(case.c)))
    stepped = step(case.rates, states, controls, ambient_flows, c, case.dt, 2)
    together = step(case.rates, states, controls[:, :1], ambient_flows, case.c, case.dt, 2)
    for i, j in np.ndindex(3, rows):
        alone = step(case.rates, states[i, j], controls[i, j], ambient_flows[i, j], c[j], case.dt, 2)
        np.testing.assert_array_equal(stepped[i, j], alone)
        alone = step(case.rates, states[i, j], controls[i, 0], ambient_flows[i, j], case.c, case.dt, 2)
        np.testing.assert_array_equal(together[i, j], alone)
    assert (stepped != states).all()


def test_increments_are_added_to_their_components_and_to_no_other():
    states, increments = np.random.default_rng(0).normal(size=(2, 5, 4))
    expected = states.copy()
    expected[:, [3, 1]] += increments[:, :2]
    np.testing.assert_array_equal(incremented(states, increments[:, :2], [3, 1]), expected)
    np.testing.assert_array_equal(
        incremented(states, increments[:, :2], [2, 2])[:, 2], states[:, 2] + increments[:, 0] + increments[:, 1]
    )


# --- modes ------------------------------------------------------------------------------------------


def of_size(length: float, speed: float, **changes: Any) -> CorvetteParameters:
    """A ship of the Mariner's form, of a length [m] and service speed [m/s]."""
    ship = load("mariner", CorvetteParameters)
    by, speeds = length / ship.length, speed / ship.speed
    return replace(
        ship, length=length, beam=by * ship.beam, draught=by * ship.draught, mass=by**3 * ship.mass,
        x_g=by * ship.x_g, speed=speed, resistance=(by * speeds) ** 2 * ship.resistance, **changes,
    )  # fmt: skip


SHIPS = {
    "corvette": load("corvette", CorvetteParameters),
    "mariner": load("mariner", CorvetteParameters),
    "320 m at 7.5 m/s": of_size(320.0, 7.5),
    "60 m at 6 m/s, roll of 6 s": of_size(60.0, 6.0, roll_period=6.0),
    "60 m at 1.6 m/s, roll of 6 s": of_size(60.0, 1.6, roll_period=6.0),
}


@pytest.mark.parametrize("phase", [0.5 * np.pi, 0.6 * np.pi, 0.9 * np.pi, np.pi])
@pytest.mark.parametrize("fastest", [0.01, 0.999, 1.001, 7.3])
def test_a_mode_is_resolved_to_a_tenth_of_a_percent(fastest: float, phase: float):
    """From an oscillation without damping to a decay without oscillation."""
    value = fastest * np.exp(1j * phase)
    matrix = np.array([[value.real, -value.imag], [value.imag, value.real]])  # it has this eigenvalue
    state, still = np.array([1.0, 0.0]), np.zeros(1)
    substeps = resolving_substeps(1.0, fastest)
    x, y = runge_kutta(lambda s, *_: matrix @ s, state, still, still, still, still, 1.0, substeps)
    growth = np.exp(-value) * (x + 1j * y)  # of the numerical solution in relation to the exact one
    assert abs(np.log(growth)) < 8e-4 * fastest


@pytest.mark.parametrize("name", SHIPS)
def test_a_ship_rolls_as_with_many_substeps(name: str):
    """In a moment at her natural frequency, where the amplitude hangs on damping the most."""
    ship, vehicle = SHIPS[name], ship_system(SHIPS[name]).vehicle
    c, dt, period = ship.vector()[None], vehicle.dt, ship.period_of_roll
    exogenous, amidships = np.zeros((1, 8)), np.zeros((1, 1))
    state, *_ = vehicle.start(vehicle.cruise[0][None])
    fine, rolls = state, []
    for k in range(round(30.0 * period / dt)):
        moment = 0.01 * vehicle.ship.mass * 9.81 * ship.stiffness * np.sin(2.0 * np.pi * (k + 0.5) * dt / period)
        exogenous[:, 1 + vehicle.ambient_flows.index("roll moment")] = moment
        state = vehicle.step(state, amidships, amidships, exogenous, c)
        fine = runge_kutta(vehicle.equations, fine, amidships, amidships, exogenous[:, 1:], c, dt, 48)
        rolls.append([state[0, 6], fine[0, 6]])
    rms, converged = np.std(rolls[len(rolls) // 2 :], axis=0)
    assert rms == pytest.approx(converged, rel=0.005)


@pytest.mark.parametrize("name", SHIPS)
def test_filters_follow_a_ship_in_the_plane_as_with_many_substeps(name: str):
    """Into a hard turn; filters leave roll out, and their steps are as few as sway and yaw allow."""
    vehicle = ship_system(SHIPS[name]).vehicle
    x, u, flow = vehicle.cruise[0], np.array([0.4, 0.0, 0.0, 1.0]), np.zeros(7)
    fine, _ = vehicle.start(x)
    for _ in range(40):
        x = vehicle.drift(x, u, flow)
        fine = runge_kutta(vehicle.equations, fine, u[:1], u[:1], flow, vehicle.ship.vector(), vehicle.dt, 32)
    scale = vehicle.ship.length * np.array([1.0, 1.0]), [1.0], np.full(2, vehicle.ship.speed), [fine[5]]
    np.testing.assert_allclose((x - fine[:6]) / np.concatenate(scale), 0.0, atol=5e-5)
