"""What rewards weigh: states that they read, place, steering without bound, and estimates; what does not pay."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from heading_ship import HEADING_SHIP

from agents.controllers import make_controller
from vessel_gym.envs import (
    ItsunusaAUVEnv,
    PunaUAVEnv,
    SegorogeniAUVEnv,
    SigmaChannelEnv,
    SigmaCorvetteEnv,
)
from vessel_gym.simulation.core import Core
from vessel_gym.system import System
from vessel_gym.tasks.task import smoothness

TASK = SigmaCorvetteEnv.system.task
ROWS = 12


def steered(estimator: str = "truth", dither: float = 0.0) -> tuple[float, float]:
    """Score and rudder travel [rad] of the autopilot, with a square wave added to its actions."""
    core = Core(SigmaCorvetteEnv.system, ROWS, estimator)
    autopilot = make_controller("autopilot", SigmaCorvetteEnv.system)
    core.start(list(range(20_000, 20_000 + ROWS)))
    autopilot.reset(ROWS)
    travel = 0.0
    for k in range(TASK.horizon):
        before, action = core.now.actuators, autopilot.act(core.observe())
        core.step(np.clip(action + (dither if k % 4 < 2 else -dither), -1.0, 1.0))
        travel += np.abs(core.now.actuators - before).mean()
    return (core.now.total / TASK.horizon).mean(), travel


@pytest.mark.parametrize(
    "flights",
    [
        [("truth", dither) for dither in (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)],
        [(name, 0.0) for name in ("truth", "kf-umv-ui", "ekf", "measurement")],
    ],
    ids=["more rudder", "worse estimates"],
)
def test_more_rudder_and_worse_estimates_score_less(flights: list[tuple[str, float]]):
    scores, travels = zip(*(steered(*flight) for flight in flights), strict=True)
    assert scores[0] > 0.6
    assert (np.diff(travels) > 0.0).all()
    assert (np.diff(scores) < 0.0).all()


def test_effort_costs_without_bound_and_rest_nothing():
    rate = np.array([[0.0], [0.1], [1.0], [-1.0], [1e9]])
    one = smoothness(rate, rate)
    assert one[0] == 1.0
    assert (np.diff(one[[0, 1, 2, 4]]) < 0.0).all()
    assert one[2] == one[3]
    assert 0.0 < one[4] < 1e-8
    turned = smoothness(rate, -rate)
    assert (turned[1:] < one[1:]).all()
    np.testing.assert_allclose(1.0 / turned - 1.0, (1.25 + 4.0) * np.abs(rate[:, 0]))
    both = smoothness(np.array([[1.0, 0.0]]), np.array([[1.0, 0.0]]), 2.0)
    np.testing.assert_allclose(1.0 / both - 1.0, 1.25)


# --- every task -----------------------------------------------------------------------------------

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


# --- what does not pay on a track -----------------------------------------------------------------


def sailed(
    system: System, policy: Callable[[int, Core], np.ndarray], disturbance: str
) -> tuple[float, set[str]]:
    """Mean score and ends of sixteen ships on the truth."""
    core = Core(system, 16, estimator="truth", disturbance=disturbance)
    core.start(list(range(10_000, 10_016)))
    total, ends = np.zeros(16), np.zeros(16, int)
    for k in range(system.task.horizon):
        now = core.step(policy(k, core))
        total += now.reward * (ends == 0)
        ends = np.where(ends == 0, now.end, ends)
    return total.mean() / system.task.perfect, set(np.array(system.task.end_reasons)[ends])


IDLE: dict[str, Any] = {
    "hard over inwards": lambda k, core: np.sign(core.now.scenario[:, 1:2]),
    "hard over outwards": lambda k, core: -np.sign(core.now.scenario[:, 1:2]),
    "hands off": lambda k, core: np.zeros((16, 1)),
    "weaving": lambda k, core: np.full((16, 1), 1.0 if k // 14 % 2 == 0 else -1.0),
}


@pytest.mark.parametrize("policy", sorted(IDLE))
@pytest.mark.parametrize(
    ("system", "disturbance", "most"),
    [
        (SigmaCorvetteEnv.system, "moderate", 0.06), (SigmaCorvetteEnv.system, "rough", 0.06),
        (SigmaChannelEnv.system, "moderate", 0.1), (SigmaChannelEnv.system, "rough quartering", 0.1),
    ],
    **by_name,
)  # fmt: skip
def test_nothing_but_keeping_to_the_track_pays(
    system: System, disturbance: str, most: float, policy: str
):
    score, ends = sailed(system, IDLE[policy], disturbance)
    assert score <= most
    assert system.name != "SigmaChannel" or ends == {"aground"}
