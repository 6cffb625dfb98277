"""The step that all vehicles share: the solution of their rates, and the same for many states as for each."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from stepping import step

from vessel_gym.vehicles.corvette_equations import corvette_rates
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.integration import Rates, incremented
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
