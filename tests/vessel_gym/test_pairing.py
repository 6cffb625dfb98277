"""A random number of an environment is a function of seed, episode, purpose, part, step and component, and no other.

That batches and resets do not matter is in test_contract and test_autoreset, to the last bit.
"""

import numpy as np
import pytest
from contract import FEW_MEMBERS, OURS, SPREAD, make_core, random_walk, single_class

from estimators import RandomKeys
from vessel_gym.sensors import SUITES, Bias, Sensor, in_quality
from vessel_gym.simulation.core import Core

SEED, ROWS, STEPS = 5, 3, 12

every_environment = pytest.mark.parametrize("env_id", OURS)


def nature(core: Core) -> dict[str, np.ndarray]:
    """What is drawn in a step, or follows from what was."""
    now, count = core.now, len(core.config.system.vehicle.increments)
    names = "state", "slow", "parameters", "scenario", "y", "available"
    drawn = {name: getattr(now, name).copy() for name in names}
    read = now.exogenous_before[:, :count], now.exogenous[:, count:]  # by sensors
    return drawn | {"exogenous": np.concatenate(read, -1)}


def flown(core: Core, actions: int = 0) -> list[dict[str, np.ndarray]]:
    """Every step of the second episode, under the actions of a seed."""
    core.start(SEED)
    core.start()
    walk, steps = random_walk(actions, ROWS, core.config.action_size), [nature(core)]
    for _ in range(STEPS):
        core.step(next(walk))
        steps.append(nature(core))
    return steps


@every_environment
def test_the_measurements_of_a_step_can_be_had_by_themselves(env_id: str):
    core = make_core(env_id, ROWS, sensors="degraded", disturbance="rough")
    episode, sensors = RandomKeys.seeded(range(SEED, SEED + ROWS)).of(1), core.config.sensors
    keys = np.stack([episode.of(f"sensor {sensor.name}").keys for sensor in sensors.each], 1)
    for step, now in reversed(list(enumerate(flown(core)))):
        steps = np.full(ROWS, step)
        biases = now["slow"][:, core.config.world.size :]
        y, available = sensors.read(now["state"], now["exogenous"], biases, steps, keys)
        np.testing.assert_array_equal(y, now["y"])
        np.testing.assert_array_equal(available, now["available"])


@every_environment
@pytest.mark.parametrize("place", [0, 1])
def test_one_sensor_more_moves_the_numbers_of_no_other(env_id: str, place: int):
    own = in_quality(single_class(env_id).system.vehicle.sensors, **SUITES["degraded"])
    bias = Bias(("more bias",), start=(1.0,), pace=(0.1,))
    quality = {"sd": (1.0, 1.0), "dropout": 0.3, "outliers": 0.2, "bias": bias}
    more = Sensor(
        "one more", ("one", "other"), lambda x, _: np.zeros((*x.shape[:-1], 2)), **quality
    )
    others = [*own[:place], more, *own[place:]]
    one, other = (
        make_core(env_id, ROWS, sensors=s, disturbance="rough", estimator="truth")
        for s in (own, others)
    )
    kept = [
        i
        for i, channel in enumerate(other.config.sensors.channels)
        if channel in one.config.sensors.channels
    ]
    size, names = one.config.world.size, other.config.sensors.bias_names
    slow = [*range(size), *(size + names.index(name) for name in one.config.sensors.bias_names)]
    for told, beside in zip(flown(one), flown(other), strict=True):
        beside["slow"] = beside["slow"][:, slow]
        beside |= {name: beside[name][:, kept] for name in ("y", "available")}
        for name, values in told.items():
            np.testing.assert_array_equal(values, beside[name], err_msg=name)


@pytest.mark.parametrize(("env_id", "estimator"), SPREAD)
def test_nature_is_paired_between_estimators(env_id: str, estimator: str):
    options = {"sensors": "degraded", "disturbance": "rough", "mismatch": 0.2}
    few = FEW_MEMBERS.get(estimator)
    one = flown(make_core(env_id, ROWS, estimator="measurement", **options))
    other = flown(make_core(env_id, ROWS, estimator=estimator, estimator_options=few, **options))
    for told, beside in zip(one, other, strict=True):
        for name, values in told.items():
            np.testing.assert_array_equal(values, beside[name], err_msg=name)


@every_environment
def test_what_is_drawn_does_not_depend_on_actions(env_id: str):
    """The field of waves about a ship depends on her place, but not its numbers."""
    options = {"sensors": "degraded", "disturbance": "rough", "mismatch": 0.2}
    one, other = (flown(make_core(env_id, ROWS, **options), actions=seed) for seed in (0, 1))
    assert (one[-1]["state"] != other[-1]["state"]).any(-1).all()
    for told, beside in zip(one, other, strict=True):
        for name in ("slow", "parameters", "scenario", "available"):
            np.testing.assert_array_equal(told[name], beside[name], err_msg=name)
