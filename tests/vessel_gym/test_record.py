"""The record of environments, and the program that fills it in as the stages one by one do."""

import sys
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import make_batch, make_core, random_walk, single_class
from gymnasium.vector import AutoresetMode

from estimators.engine import Function
from vessel_gym.sensor_faults import SensorFault

OURS = (
    "SigmaCorvette-v0", "SigmaChannel-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0",
    "ThesisCorvette-v0",
)  # fmt: skip


def late_and_faulty(env_id: str) -> dict[str, Any]:
    """Options with every sensor two steps late, and the first one stuck."""
    vehicle = single_class(env_id).system.vehicle
    sensors = [replace(each, latency=2.0 * vehicle.dt) for each in vehicle.sensors]
    fault = SensorFault(sensors[0].name, "stuck", begin=3.0 * vehicle.dt, duration=6.0 * vehicle.dt)
    return {"sensors": sensors, "sensor_faults": [fault]}


@pytest.mark.parametrize("late", [False, True], ids=["in time", "late"])
@pytest.mark.parametrize("env_id", OURS)
def test_record_put_back_is_stepped_to_the_same_bits(env_id: str, late: bool):
    options = late_and_faulty(env_id) if late else {}
    batch: Any = make_batch(env_id, 3, autoreset_mode=AutoresetMode.NEXT_STEP, **options)
    env, core = batch.unwrapped, batch.unwrapped.core
    batch.reset(seed=4)
    walk = random_walk(0, 3, core.config.action_size)
    actions = [next(walk).astype(np.float32) for _ in range(14)]
    for action in actions[:6]:
        env.step(action)
    over = np.array([False, True, False])
    core.now = core.now.but(over=over)  # the next step begins another episode
    before, runs = core.now, list[np.ndarray]()
    for _ in range(2):
        core.now = before
        seen = [env.step(action)[:2] for action in actions[6:]]
        runs.append(np.array([[*each.ravel(), *reward] for each, reward in seen]))
    np.testing.assert_array_equal(*runs)
    assert np.ptp(runs[0], axis=0).max() > 0.0


@pytest.mark.parametrize("rows", [1, 5])
@pytest.mark.parametrize(
    "options",
    [{}, {"estimator": "ekf"}, {"estimator": "ukf"}, {"observe": "mean+std"}],
    ids=["default", "ekf", "ukf", "mean+std"],
)
@pytest.mark.parametrize("env_id", OURS)
def test_one_program_gives_the_bits_of_the_stages(env_id: str, options: dict[str, Any], rows: int):
    core = make_core(env_id, rows, disturbance="rough", **options)
    core.start(2)
    walk, apart = random_walk(0, rows, core.config.action_size), core.now
    for _ in range(8):
        action = next(walk)
        core.now = apart
        moment, made = core.config.whole_steps[1](apart, action[0] if rows == 1 else action)
        assert moment is not None
        together, apart = moment.record(), core._stages(action, None)
        core.now = apart
        expected = core.info()
        for name, shown in core.info(made).items():
            np.testing.assert_array_equal(shown, expected[name], name)
            assert shown.flags.writeable
        for name, array in vars(apart).items():
            if isinstance(array, np.ndarray):
                np.testing.assert_array_equal(getattr(together, name), array, name)
        for name in apart.belief.names():
            each = getattr(together.belief, name), getattr(apart.belief, name)
            np.testing.assert_array_equal(*each, name)


def test_a_step_takes_few_calls_in_few_files():
    env: Any = gym.make("SigmaCorvette-v0").unwrapped
    env.reset(seed=0)
    action, calls = env.action_space.sample(), list[str]()
    env.step(action)

    def count(frame: Any, event: str, _: Any) -> None:
        file = frame.f_code.co_filename
        if event == "call" and ("/vessel_gym/" in file or "/estimators/" in file):
            calls.append(file)

    sys.setprofile(count)
    try:
        env.step(action)
    finally:
        sys.setprofile(None)
    assert len(calls) <= 15
    assert len({*calls}) <= 8


@pytest.mark.parametrize("rows", [1, 65])  # one program, and stages
@pytest.mark.parametrize(
    ("env_id", "estimator"),
    [*((each, None) for each in OURS), *((OURS[0], each) for each in ("truth", "measurement"))],
)
def test_no_warm_step_takes_the_slow_call(env_id: str, estimator: str | None, rows: int):
    core = make_core(env_id, rows, estimator=estimator)
    core.start(0)
    actions = np.zeros(core.action_shape)
    for _ in range(4):
        core.step(actions)
    before = Function.computed
    for _ in range(4):
        core.step(actions)
    assert Function.computed == before
