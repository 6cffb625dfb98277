"""The states that a score reads; what it makes of them is in test_task_scores."""

import numpy as np
import pytest
from heading_ship import HEADING_SHIP

from vessel_gym.envs import (
    ItsunusaAUVEnv,
    PunaUAVEnv,
    SegorogeniAUVEnv,
    SigmaChannelEnv,
    SigmaCorvetteEnv,
)
from vessel_gym.simulation.core import Core
from vessel_gym.system import System

COURSE = ("x", "y", "psi", "u", "v", "current north", "current east", "wave sway")
READ = [
    (SegorogeniAUVEnv.system, ("x", "y", "z", "theta")), (ItsunusaAUVEnv.system, ("x", "z", "theta")),
    (HEADING_SHIP, ("psi", "r")), (SigmaChannelEnv.system, COURSE), (SigmaCorvetteEnv.system, (*COURSE, "r")),
    (PunaUAVEnv.system, ("x", "y", "h", "north", "east", "climb", "wind north", "wind east", "wind down")),
]  # fmt: skip
by_name = {"ids": lambda value: getattr(value, "name", None)}


@pytest.mark.parametrize(("system", "read"), READ, **by_name)
def test_score_reads_these_states_and_nothing_else(system: System, read: tuple[str, ...]):
    task, vehicle, core, rng = (
        system.task,
        system.vehicle,
        Core(system, 50),
        np.random.default_rng(4),
    )
    core.start(0)
    for _ in range(10):
        before = core.now.score_state.copy()
        core.step(rng.uniform(-1.0, 1.0, (50, core.config.action_size)))
    now, names = core.now, (vehicle.state_names, vehicle.increments + vehicle.ambient_flows)
    acting = now.state, now.exogenous
    others = [
        np.where(np.isin(name, read), x, rng.normal(size=x.shape))
        for name, x in zip(names, acting, strict=True)
    ]
    rest = (
        now.scenario,
        now.reference,
        np.zeros(50, bool),
        now.actuators,
        now.action,
        before,
    )
    scores = task.score(*acting, *rest), task.score(*others, *rest)
    assert scores[0][0].any()
    for one, other in zip(*scores, strict=True):
        np.testing.assert_array_equal(one, other)
    start = [task.initial_score_state(x, now.scenario) for x in (acting[0], others[0])]
    np.testing.assert_array_equal(*start)
