"""The step that all vehicles share: the solution of their rates, and the same for many states as for each."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.errors import TypingError
from scipy.integrate import solve_ivp

from estimators.compiled import inlined
from vessel_gym.vehicles.corvette_equations import corvette_forced, corvette_rates, corvette_sloped, corvette_step
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.integration import Kernels, kernels
from vessel_gym.vehicles.itsunusa import itsunusa_forced, itsunusa_rates, itsunusa_step
from vessel_gym.vehicles.puna import puna_forced, puna_rates, puna_step
from vessel_gym.vehicles.segorogeni import segorogeni_forced, segorogeni_rates, segorogeni_step


@dataclass(frozen=True)
class Case:
    """A vehicle in a hard manoeuvre, along which no velocity changes sign: v |v| has no second derivative there."""

    kernels: Kernels
    c: np.ndarray
    state: list[float]
    control: list[float]  # before and after
    flow: list[float]
    dt: float  # s


CASES = {
    "corvette": Case(
        Kernels(corvette_rates, corvette_step, corvette_forced, corvette_sloped), load("corvette").vector(),
        [3.0, -4.0, 0.7, 13.0, -1.5, 0.03, -0.1, 0.02], [0.3, 0.5], [0.3, -0.5, 1e5, -2e5, 5e6, 1e6, 0.2], 4.0,
    ),
    "segorogeni": Case(
        Kernels(segorogeni_rates, segorogeni_step, segorogeni_forced, None), load("segorogeni").vector(),
        [1.2, 0.5, -0.4, -1.5, 0.8, -1.0, 5.0, -3.0, 4.0, 0.4, -0.5, 2.0], [0.1, -0.2, 2.0, 0.2, 0.3, 7.0], [0.3, -0.2],
        0.1,
    ),
    "itsunusa": Case(
        Kernels(itsunusa_rates, itsunusa_step, itsunusa_forced, None), load("itsunusa").vector(),
        [1.4, -0.1, 0.2, 5.0, 4.0, -0.5], [-0.2, 10.0, 0.3, 35.0], [0.3], 0.2,
    ),
    "puna": Case(
        Kernels(puna_rates, puna_step, puna_forced, None), load("puna").vector(),
        [3.0, -4.0, 100.0, 14.0, 11.0, 3.0, 0.4], [4.0, 0.02, -0.6, 7.0, 0.07, 0.6], [2.0, -1.0, 0.5], 1.0,
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", CASES)
def test_a_step_nears_the_solution_of_the_rates_with_the_fourth_power_of_its_length(vehicle: str):
    case = CASES[vehicle]
    rates, step = case.kernels[:2]
    state, control, flow = np.array(case.state), np.array(case.control), np.array(case.flow)
    before, after = np.split(control, 2)
    solution = solve_ivp(
        lambda t, s: rates(s, before + (after - before) * t / case.dt, flow, case.c),
        (0.0, case.dt), state, method="DOP853", rtol=1e-13, atol=1e-13,
    )  # fmt: skip
    exact = solution.y[:, -1]
    errors = [np.abs(step(state, control, flow, case.c, case.dt, n) - exact).max() for n in (8, 16, 32)]
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ((ratios > 13.0) & (ratios < 20.0)).all()
    finest = step(state, control, flow, case.c, case.dt, 512)
    np.testing.assert_allclose(finest, exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize("rows", [1, 3, 15, 16, 17, 40])
@pytest.mark.parametrize("vehicle", CASES)
def test_rows_side_by_side_step_as_each_alone(vehicle: str, rows: int):
    case, rng = CASES[vehicle], np.random.default_rng(0)
    step = case.kernels.step
    states = np.array(case.state) * rng.uniform(0.5, 1.5, (3, rows, len(case.state)))
    controls = np.array(case.control) * rng.uniform(0.5, 1.5, (3, rows, len(case.control)))
    flows = rng.normal(size=(3, rows, len(case.flow)))
    c = case.c * rng.uniform(0.9, 1.1, (rows, len(case.c)))
    stepped, together = (
        step(states, controls, flows, c, case.dt, 2), step(states, controls[:, :1], flows, case.c, case.dt, 2)
    )  # fmt: skip
    for i, j in np.ndindex(3, rows):
        alone = step(states[i, j], controls[i, j], flows[i, j], c[j], case.dt, 2)
        np.testing.assert_array_equal(stepped[i, j], alone)
        alone = step(states[i, j], controls[i, 0], flows[i, j], case.c, case.dt, 2)
        np.testing.assert_array_equal(together[i, j], alone)
    assert (stepped != states).all()
    rows_last = states.swapaxes(1, 2).copy().swapaxes(1, 2)
    np.testing.assert_array_equal(step(rows_last, controls, flows, c, case.dt, 2, np.empty_like(rows_last)), stepped)


@pytest.mark.parametrize("vehicle", CASES)
def test_a_forced_step_is_a_step_with_kicks_added_at_its_end(vehicle: str):
    case, rng = CASES[vehicle], np.random.default_rng(0)
    state, control, flow, c = (np.tile(x, (5, 1)) for x in (case.state, case.control, case.flow, case.c))
    kicks, after = rng.normal(size=(5, 2)), np.empty((5, len(case.state)))
    expected = case.kernels.step(state, control, flow, c, case.dt, 2)
    expected[:, [3, 1]] += kicks
    forcing, kicked = np.hstack([kicks, flow]), np.array([3, 1])
    case.kernels.forced(state, *np.split(control, 2, -1), forcing, c, case.dt, 2, kicked, after)
    np.testing.assert_array_equal(after, expected)


def test_slopes_are_those_of_the_step():
    case, rng = CASES["corvette"], np.random.default_rng(0)
    step, sloped = case.kernels.step, case.kernels.sloped
    states = np.array(case.state) * rng.uniform(0.5, 1.5, (3, len(case.state)))
    before, after = np.array(case.control)[None, :1], np.array(case.control)[None, 1:]
    flow, c, n = np.array(case.flow)[None], case.c[None], len(case.state)
    columns, by = np.array([2, 3, 5, n, n + 4]), np.array([1e-3, 1e-2, 1e-4, 1e-2, 1e3]) * [[1.0], [0.5], [2.0]]
    out, slopes = np.empty((3, n)), np.empty((3, n, 5))
    sloped(states, before, after, flow, c, case.dt, 2, columns, by, out, slopes)
    control = np.concatenate([before, after], -1)
    np.testing.assert_array_equal(out, step(states, control, flow, c, case.dt, 2))
    both = np.concatenate([states, flow.repeat(3, 0)], -1)
    for j, column in enumerate(columns):
        offset = 0.3 * by[:, j : j + 1] * np.eye(both.shape[1])[column]
        one, other = (step(x[:, :n], control, x[:, n:], c, case.dt, 2) for x in (both + offset, both - offset))
        size = np.abs(slopes[:, :, j]).max()
        np.testing.assert_allclose(slopes[:, :, j], (one - other) / (0.6 * by[:, j : j + 1]), rtol=0, atol=1e-6 * size)
        assert size > 0.0


def test_rows_that_do_not_go_with_the_states_are_refused():
    case = CASES["corvette"]
    states, control, flow = (np.tile(x, (4, 1)) for x in (case.state, case.control, case.flow))
    with pytest.raises(ValueError, match="a row of control, flow and coefficients for each state, or one for all"):
        case.kernels.step(states, control[:3], flow, case.c, case.dt, 1)
    with pytest.raises(ValueError, match="must be as long as the equations say"):
        case.kernels.step(states, control, flow, np.append(case.c, 1.0), case.dt, 1)
    given = states, control[:, :1], flow, case.c
    for i in range(4):
        for wrong in (given[i][..., :-1], np.concatenate([given[i], given[i]], -1)):
            with pytest.raises(ValueError, match="must be as long as the equations say"):
                case.kernels.rates(*given[:i], wrong, *given[i + 1 :])


OWN = """
from estimators.compiled import inlined
from vessel_gym.vehicles.integration import kernels

@inlined
def _rates(s, control, flow, c):
    return (FACTOR * s[0] + control[0] + flow[0],)

own_rates, own_step, own_forced, own_sloped = kernels("own", _rates, 1, 1, 1, 1)
"""


@pytest.mark.slow
def test_a_change_of_one_s_own_rates_is_seen(tmp_path: Path):
    for factor in (1.0, 20.0, 300.0):  # files of another size each: times of files may be coarse
        (tmp_path / "own.py").write_text(OWN.replace("FACTOR", str(factor)))
        program = "import own, numpy as np; print(own.own_rates(np.ones(1), *np.zeros((3, 1)))[0])"
        told = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
        assert float(told.stdout) == factor


def rates_of(factor: float, count: int) -> Any:
    if count == 1:
        return inlined(lambda s, control, flow, c: (factor * s[0] + control[0],))
    return inlined(lambda s, control, flow, c: (factor * s[0], 1.0))


def test_vehicles_of_one_name_have_the_kernels_of_their_own_rates():
    made = [kernels("boat", rates_of(factor, 1), 1, 1, 1, 1) for factor in (1.0, 5.0)]
    assert [each.rates(np.ones(1), *np.zeros((3, 1)))[0] for each in made] == [1.0, 5.0]


def test_sizes_that_do_not_fit_are_refused():
    with pytest.raises(TypingError, match="there are 2 rates of a state of 1 numbers"):
        kernels("boat", rates_of(1.0, 2), 1, 1, 1, 1).rates(np.ones(1), *np.zeros((3, 1)))
    with pytest.raises(ValueError, match=r"^still needs a state, actuators, a flow and coefficients of one number"):
        kernels("still", rates_of(1.0, 1), 1, 1, 0, 1)
