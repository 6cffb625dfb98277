"""Environments that are built alike share what no episode changes, and nobody can tell."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vessel_gym.caching import cached
from vessel_gym.disturbances import Disturbance
from vessel_gym.envs import ItsunusaAUVEnv, SigmaCorvetteEnv, ThesisCorvetteEnv
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.simulation.core import Core

SYSTEM = SigmaCorvetteEnv.system
STEPS = 12
TWO = [
    (SigmaCorvetteEnv, {"observe": "mean+std", "estimator": "ekf", "sensors": "degraded"}),
    (ThesisCorvetteEnv, {"termination": "task", "estimator_options": {"assume": {"Q": 2.0}}}),
    (ItsunusaAUVEnv, {"observe": "measurement", "guidance": True, "mismatch": 0.1}),
]


def begun(core: Core, seed: int) -> Core:
    core.start(seed)
    return core


def stepped(core: Core, step: int) -> list[np.ndarray]:
    """All that a step gives."""
    action = np.random.default_rng(step).uniform(-1.0, 1.0, core.action_shape)
    now = core.step(action)
    return [
        core.observe(),
        now.reward,
        now.end,
        core.truth.copy(),
        now.belief.mean,
        now.belief.cov,
    ]


def flown(core: Core, seed: int, steps: int = STEPS) -> list[np.ndarray]:
    begun(core, seed)
    return [each for step in range(steps) for each in stepped(core, step)]


def same(one: list[np.ndarray], other: list[np.ndarray]) -> bool:
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize(("env", "options"), TWO)
def test_two_in_turns_fly_as_each_alone(env: Any, options: dict[str, Any]) -> None:
    alone = [flown(Core(env.system, 2, **options), seed) for seed in (3, 4)]
    cores = [begun(Core(env.system, 2, **options), seed) for seed in (3, 4)]
    assert cores[0].config.world is cores[1].config.world
    assert cores[0].config.estimation is cores[1].config.estimation
    turns: list[list[np.ndarray]] = [[], []]
    for step in range(STEPS):
        for core, taken in zip(cores, turns, strict=True):
            taken += stepped(core, step)
    assert same(turns[0], alone[0])
    assert same(turns[1], alone[1])
    assert not same(turns[0], turns[1])


DIFFERENT: tuple[dict[str, Any], ...] = (
    {}, {"sensors": "degraded"}, {"disturbance": "rough"}, {"estimator": "kf"},
    {"disturbance": replace(SYSTEM.disturbances["moderate"], current=0.31)},
    {"sensors": [replace(each, dropout=0.2) for each in SYSTEM.vehicle.sensors]},
    {"sensor_faults": [SensorFault(SYSTEM.vehicle.sensors[0].name, "off", begin=3.0)]},
    {"estimator_options": {"assume": {"Q": 1.5}}}, {"estimator_options": {"assume": {"Q": 1.25}}},
    {"estimator_options": {"late": "discarded"}},
)  # fmt: skip


def test_what_is_built_otherwise_is_another_one() -> None:
    one, other = ([Core(SYSTEM, 1, **options).config for options in DIFFERENT] for _ in range(2))
    assert all(a.estimation is b.estimation for a, b in zip(one, other, strict=True))
    assert len({id(config.estimation) for config in one}) == len(DIFFERENT)
    longer = replace(SYSTEM, task=replace(SYSTEM.task, horizon=77))
    assert Core(longer).config.world is not one[0].world


def test_only_arguments_that_can_be_hashed_share_one_object() -> None:
    build = cached(lambda each: [each])
    for value in (0, (1, "b"), np.sin, Disturbance, SYSTEM):
        assert build(value) is build(value)
    for value in (np.zeros(1), [1], {"a": 1}):
        assert build(value) is not build(value)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [2, 70])  # in one program, and in stages
def test_filters_with_other_records_share_a_world(rows: int) -> None:
    system = replace(ItsunusaAUVEnv.system)  # whose stages no other test has traced
    begun(Core(system, rows, "enkf"), 1).step(np.zeros((rows, 2)))
    alone = begun(Core(replace(system), rows, "ekf"), 1)
    shares = begun(Core(system, rows, "ekf"), 1)
    for step in range(3):
        for one, other in zip(stepped(alone, step), stepped(shares, step), strict=True):
            np.testing.assert_array_equal(one, other)
