"""The record of environments: it holds all that a step changes, and steps leave it as it is."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contract import make_batch, random_walk, single_class
from gymnasium.vector import AutoresetMode

from vessel_gym.sensor_faults import SensorFault

OURS = (
    "SigmaCorvette-v0", "SigmaChannel-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0",
    "ThesisCorvette-v0",
)  # fmt: skip


def late_and_faulty(env_id: str) -> dict[str, Any]:
    """Options with every sensor two steps late, and the first one stuck."""
    vehicle = single_class(env_id).system.vehicle
    sensors = [replace(each, latency=2.0 * vehicle.dt) for each in vehicle.sensors]
    fault = SensorFault(sensors[0].name, "stuck", begin=3.0 * vehicle.dt, end=9.0 * vehicle.dt)
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
    core.now.over = np.array([False, True, False])  # the next step begins another episode
    before, runs = core.now, list[np.ndarray]()
    for _ in range(2):
        core.now = before
        seen = [env.step(action)[:2] for action in actions[6:]]
        runs.append(np.array([[*each.ravel(), *reward] for each, reward in seen]))
    np.testing.assert_array_equal(*runs)
    assert np.ptp(runs[0], axis=0).max() > 0.0
