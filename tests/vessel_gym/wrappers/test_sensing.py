"""Rates, delays and faults of sensors around environments of other packages."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from anybody import cart_pole, flown, pendulum

from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Sensor
from vessel_gym.wrappers.vector import EstimatedObservation as EstimatedObservations


def _positions(latency: float) -> list[Sensor]:
    read = [("cart", 0, 0.02), ("pole", 2, 0.01)]
    return [
        Sensor(name, (name,), lambda x, u, i=i: x[..., i : i + 1], (sd,), latency=latency)
        for name, i, sd in read
    ]


@pytest.mark.parametrize("estimator", ["ekf", "enkf", "huber-kf"])
def test_measurements_that_come_late_are_fused_where_they_belong(estimator: str):
    """When the last has come, the belief is that of the measurements in time; rows of a batch are as single ones."""
    options = {"members": 20} if estimator == "enkf" else {}
    given = {"estimator": estimator, "estimator_options": options}
    late, timely = (cart_pole(sensors=_positions(delay), **given) for delay in (5.0, 0.0))
    for env in (late, timely):
        env.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(12):
        action = int(rng.integers(2))
        infos = [env.step(action)[-1] for env in (late, timely)]
        np.testing.assert_array_equal(infos[0]["truth"], infos[1]["truth"])
    assert np.abs(infos[0]["estimate"] - infos[1]["estimate"]).max() > 0.0
    # all that was taken then has come: the same before it
    assert late.watch.now.belief.steps[-1 - 5].available.all()


def test_faults_of_sensors_act_and_stand_in_info():
    fault = SensorFault("y1", "bias", size=0.5, begin=5.0, duration=4.0)
    flights = [flown(cart_pole(sensor_faults=faults), steps=12) for faults in ((), [fault])]
    for k, (one, other) in enumerate(zip(*flights, strict=True)):
        on = 5 <= k < 9
        np.testing.assert_allclose(
            other["measurement"] - one["measurement"], [0.0, 0.5 * on], rtol=0, atol=1e-12
        )
        assert bool(other["sensor_faults"][0]) is on
    with pytest.raises(ValueError, match="unknown sensor of sensor_faults 'y3'"):
        cart_pole(sensor_faults=[SensorFault("y3", "off")])


@pytest.mark.parametrize("many", ["", "sync", "async"])
def test_rates_are_in_hz_where_the_environment_has_a_time_step(many: str):
    """Pendulum's steps take 0.05 s: at 4 Hz every fifth has a measurement, as late as 0.1 s is in steps."""
    own = [
        Sensor(
            "angle",
            ("angle",),
            lambda x, u: x[..., :1],
            (0.05,),
            rate=4.0,
            latency=0.1,
            angles=(0,),
        )
    ]
    env: Any = pendulum(sensors=own)
    if many:
        model, prior = env.watch.model, env.watch.prior
        batch = gym.make_vec("Pendulum-v1", 2, vectorization_mode=many)
        env = EstimatedObservations(
            batch, model, prior, state=lambda env, seen: np.stack([np.arctan2(seen[:, 1], seen[:, 0]), seen[:, 2]], -1),
            observation=lambda x: np.stack([np.cos(x[..., 0]), np.sin(x[..., 0]), x[..., 1]], -1), sensors=own,
        )  # fmt: skip
    infos = [env.reset(seed=0)[1], *(env.step(env.action_space.sample())[-1] for _ in range(12))]
    assert [k for k, info in enumerate(infos) if info["available"].all()] == [2, 7, 12]
    env.close()
