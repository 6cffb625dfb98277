"""Equations of the tasks: compiled they equal their NumPy functions, for any leading axes and each row alone."""

from typing import Any

import numpy as np
import pytest

from vessel_gym.core import Core
from vessel_gym.envs import ItsunusaAUVEnv, SegorogeniAUVEnv
from vessel_gym.envs.fixed_wing import PUNA_UAV
from vessel_gym.envs.ship import SIGMA_CORVETTE
from vessel_gym.envs.thesis_corvette import THESIS_CORVETTE
from vessel_gym.system import System

SYSTEMS = [THESIS_CORVETTE, SIGMA_CORVETTE, ItsunusaAUVEnv.system, SegorogeniAUVEnv.system, PUNA_UAV]
ROWS = 12


def calls(system: System) -> list[tuple[Any, tuple[np.ndarray, ...]]]:
    """Methods and arguments of a step, some rows far away and some diverged."""
    core, task = Core(system, ROWS, "truth"), system.task
    core.start(0)
    for _ in range(40):
        core.step(np.full(core.action_shape, 0.3))
    mean, state = core.belief.mean.copy(), core.state.copy()
    mean[1], mean[2], state[1], state[2] = mean[1] * 30.0, 1e12, state[1] * 30.0, 1e12
    assert core.config.mission is not None
    reference = task.reference(core.scenario, core.steps, mean)
    over = np.arange(ROWS) % 3 == 0
    exogenous = core.exogenous[:, : core.forces.outside]
    return [
        (task.reference, (core.scenario, core.steps, mean)),
        (task.initial_score_state, (state, core.scenario)),
        (task.score, (state, exogenous, reference, over, core.actuators, core.action, core.now.score_state)),
        (core.config.mission.begin, (core.scenario, core.steps, mean, np.zeros((ROWS, 0)), state, core.actuators)),
    ]


def results(method: Any, arguments: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    with np.errstate(all="ignore"):
        found = method(*arguments)
    return found if isinstance(found, tuple) else (found,)


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
def test_compiled_they_are_their_numpy_functions(system: System) -> None:
    for method, arguments in calls(system):
        plain = getattr(method, "__wrapped__", method)
        for one, other in zip(results(method, arguments), results(plain, arguments), strict=True):
            assert one.dtype == other.dtype
            np.testing.assert_allclose(one[3:], other[3:], rtol=1e-11, atol=1e-11)
            np.testing.assert_array_equal(np.isfinite(one), np.isfinite(other))


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
def test_rows_alone_and_under_two_axes_give_the_same_bits(system: System) -> None:
    for method, arguments in calls(system):
        whole = results(method, arguments)
        folded = results(method, tuple(a.reshape(3, ROWS // 3, *a.shape[1:]) for a in arguments))
        for all_rows, under_two in zip(whole, folded, strict=True):
            np.testing.assert_array_equal(under_two.reshape(all_rows.shape), all_rows)
        for row in range(ROWS):
            for all_rows, alone in zip(whole, results(method, tuple(a[row] for a in arguments)), strict=True):
                np.testing.assert_array_equal(alone, all_rows[row])
