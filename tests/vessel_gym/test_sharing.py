"""Environments that are built alike share what no episode changes, and nobody can tell."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vessel_gym.disturbances import Disturbance, Sea
from vessel_gym.envs import ItsunusaAUVEnv, SigmaCorvetteEnv, ThesisCorvetteEnv
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sharing import shared
from vessel_gym.simulation.core import Core

SYSTEM = SigmaCorvetteEnv.system
STEPS = 12
OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {"observe": "mean+std", "estimator": "ekf", "sensors": "degraded"},
    {"observe": "measurement", "guidance": True, "mismatch": 0.1},
    {"termination": "task", "estimator_options": {"assume": {"Q": 2.0}}},
)
ENVS = (SigmaCorvetteEnv, ThesisCorvetteEnv, ItsunusaAUVEnv)


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


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("env", ENVS)
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


def test_two_in_two_threads_fly_as_each_alone() -> None:
    alone = [flown(Core(ItsunusaAUVEnv.system, 20), seed) for seed in range(4)]
    cores = [Core(ItsunusaAUVEnv.system, 20) for _ in range(4)]
    assert len({id(core.config.estimation.filter) for core in cores}) == 1
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(flown, cores, range(4)))
    assert all(map(same, together, alone))


DIFFERENT: tuple[dict[str, Any], ...] = (
    {"sensors": "degraded"},
    {"disturbance": "rough"},
    {"disturbance": replace(SigmaCorvetteEnv.system.disturbances["moderate"], current=0.31)},
    {"sensors": [replace(each, dropout=0.2) for each in SigmaCorvetteEnv.system.vehicle.sensors]},
    {
        "sensor_faults": [
            SensorFault(SigmaCorvetteEnv.system.vehicle.sensors[0].name, "off", begin=3.0)
        ]
    },
    {"estimator": "kf"},
    {"estimator_options": {"assume": {"Q": 1.5}}},
    {"estimator_options": {"assume": {"Q": 1.25}}},
    {"estimator_options": {"late": "discarded"}},
)


def test_what_is_built_otherwise_is_another_one() -> None:
    cores = [Core(SigmaCorvetteEnv.system, 1, **options) for options in ({}, *DIFFERENT)]
    again = [Core(SigmaCorvetteEnv.system, 1, **options) for options in ({}, *DIFFERENT)]
    assert all(
        one.config.estimation is other.config.estimation
        for one, other in zip(cores, again, strict=True)
    )
    assert len({id(core.config.estimation) for core in cores}) == len(cores)
    system = replace(
        SigmaCorvetteEnv.system, task=replace(SigmaCorvetteEnv.system.task, horizon=77)
    )
    assert Core(system).config.world is not cores[0].config.world


def test_changes_of_an_array_are_seen() -> None:
    told = {"input_prior": np.array([[1e-6]])}
    before = flown(Core(SigmaCorvetteEnv.system, 1, estimator_options=told), 0)
    assert same(before, flown(Core(SigmaCorvetteEnv.system, 1, estimator_options=told), 0))
    told["input_prior"][:] = 1e-2
    changed = flown(Core(SigmaCorvetteEnv.system, 1, estimator_options=told), 0)
    assert not same(before, changed)
    told["input_prior"][:] = 1e-6
    assert same(before, flown(Core(SigmaCorvetteEnv.system, 1, estimator_options=told), 0))


@pytest.mark.parametrize("value", [0, "a", (1, "b"), np.sin, Sea, Disturbance, SYSTEM])
def test_equal_arguments_share_one_object(value: Any) -> None:
    build = shared(lambda each: [each])
    assert build(value) is build(value)


def test_arguments_that_cannot_be_hashed_are_built_anew() -> None:
    build = shared(lambda each: [each])
    for value in (np.zeros(1), [1], {"a": 1}):
        assert build(value) is not build(value)


def test_an_error_while_building_comes_alone() -> None:
    @shared
    def refusing(value: Any) -> Any:
        raise TypeError("no")

    for value in (0, [0]):
        with pytest.raises(TypeError, match="no") as caught:
            refusing(value)
        assert caught.value.__context__ is None
