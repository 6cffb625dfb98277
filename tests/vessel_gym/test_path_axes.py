"""The constant gain of `steady-kf` in environments: it turns with the path, and biases have none."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import make_core

from estimators import Gaussian
from vessel_gym.models.steady import path_axes

HEADED = ["SigmaCorvette-v0", "SegorogeniAUV-v0", "PunaUAV-v0"]


def estimation(env_id: str, **options: Any) -> Any:
    return make_core(env_id, 1, estimator="steady-kf", **options).config.estimation


def towards(space: Any, angle: float) -> np.ndarray:
    """The cruising vehicle's state ``(n,)``, headed by an angle [rad] from north."""
    x, names = np.zeros(len(space.names)), space.names
    own = len(space.vehicle_states)
    x[:own] = space.vehicle.cruise[0][:own]
    x[0] += 3.0 * (names[0] == "x")
    if "psi" in names:
        x[names.index("psi")] = angle
    else:
        speed = x[names.index("north")]
        x[names.index("north")], x[names.index("east")] = (
            speed * np.cos(angle),
            speed * np.sin(angle),
        )
    return x


@pytest.mark.parametrize("angle", [0.7, 2.5, -1.6])
@pytest.mark.parametrize("env_id", HEADED)
def test_corrections_turn_with_the_path(env_id: str, angle: float):
    found = estimation(env_id)
    filter, names = found.filter, found.space.names
    north, turned = (towards(found.space, each) for each in (0.0, angle))
    T = path_axes(names)(turned)
    angles = np.isin(names, ("psi",)) * angle
    turned = T @ north + angles
    error = 0.01 * np.random.default_rng(0).normal(size=len(north))
    u, shifts = found.space.vehicle.cruise[1], []
    for start, truth in ((north, north + error), (turned, T @ (north + error) + angles)):
        belief = filter.predict(filter.init(Gaussian(start, np.eye(len(start)))), u)
        mean = filter.model.transition(truth, u)
        y = filter.model.measurement(mean, u)
        shifts.append(filter.update(belief, y).mean - belief.mean)
    np.testing.assert_allclose(shifts[1], T @ shifts[0], rtol=0, atol=1e-7)
    assert np.abs(shifts[0]).max() > 1e-4


@pytest.mark.parametrize("suite", ["nominal", "budget"])
@pytest.mark.parametrize("env_id", [*HEADED, "ItsunusaAUV-v0", "ThesisCorvette-v0"])
def test_biases_alone_go_without_a_gain(env_id: str, suite: str):
    found = estimation(env_id, sensors=suite)
    without = np.array(found.space.names)[found.filter._fixed.diagonal()]
    assert {*without} <= {*found.space.sensors.bias_names}


def test_states_that_no_sensor_determines_are_named():
    compass = make_core("SigmaCorvette-v0", 1).config.world.sensors.each[:2]
    with pytest.raises(ValueError, match=r"^there is no steady state: .* determine x, y: "):
        gym.make("SigmaCorvette-v0", estimator="steady-kf", sensors=compass)


def test_rates_that_hardly_ever_meet_are_refused():
    sensors = make_core("SigmaCorvette-v0", 1).config.world.sensors.each
    sensors = [replace(each, rate=2.0 / k) for each, k in zip(sensors, (7, 101, 103), strict=True)]
    with pytest.raises(ValueError, match=r"^all sensors report together once in 72821 steps"):
        gym.make("SigmaCorvette-v0", estimator="steady-kf", sensors=sensors)


def test_states_without_a_direction_do_not_turn():
    assert path_axes(("u", "w", "x", "z")) is None
    assert path_axes(("psi", "r")) is None
