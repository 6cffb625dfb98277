"""No sensor reads what has not happened; the compass of the thesis, as it is printed, does."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import vessel_gym  # noqa: F401  (registers the environments)
from estimators import LinearModel, UMVFilter
from vessel_gym.sensors import Sensor
from vessel_gym.simulation.core import Core
from vessel_gym.system import registered

SHIPS = "SigmaCorvette-v0", "SigmaChannel-v0", "vessel_gym/Ship-v0"
ALL = *SHIPS, "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0"
ROWS = 8


def _sensor_of_increments(system) -> Sensor:
    """A user's sensor without noise that reads every increment."""
    count = len(system.vehicle.increments)
    channels = tuple(f"increment {i}" for i in range(count))
    return Sensor(
        "increments", channels, lambda state, exogenous: exogenous[..., :count], (0.0,) * count
    )


def _flown(env_id: str, **options):
    system = registered(env_id)
    noiseless = [replace(each, sd=(0.0,) * len(each.channels)) for each in system.vehicle.sensors]
    core = Core(
        system, ROWS, estimator="measurement", disturbance="rough", sensors=[*noiseless, _sensor_of_increments(system)],
        **options,
    )  # fmt: skip
    core.start(3)
    return core


@pytest.mark.parametrize("env_id", ALL)
def test_a_sensor_of_an_increment_reads_what_it_did_to_the_state(env_id: str):
    """The state less the step of the state before without increments, to 1e-12; nothing has acted at a reset."""
    core, vehicle = _flown(env_id), registered(env_id).vehicle
    count = len(vehicle.increments)
    places = [vehicle.state_names.index(name) for name in vehicle.incremented]
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(core.now.y[:, -count:], 0.0)
    for _ in range(40):
        state, exogenous, actuators = (
            core.now.state.copy(),
            core.now.exogenous.copy(),
            core.now.actuators.copy(),
        )
        exogenous[:, :count] = 0.0
        core.step(rng.uniform(-0.3, 0.3, core.action_shape))
        still = vehicle.step(state, actuators, core.now.actuators, exogenous, core.now.parameters)
        scale = np.maximum(1.0, np.abs(core.now.state[:, places]))
        assert (
            np.abs((core.now.y[:, -count:] - (core.now.state - still)[:, places]) / scale).max()
            < 1e-12
        )


@pytest.mark.parametrize("env_id", ALL)
def test_measurements_do_not_depend_on_later_random_numbers(env_id: str):
    one, other = _flown(env_id), _flown(env_id)
    action = np.zeros(one.action_shape)
    for _ in range(5):
        one.step(action), other.step(action)
    other.now.keys = other.now.keys[::-1].copy()  # all numbers from now on are others
    one.step(action), other.step(action)
    np.testing.assert_array_equal(one.now.y, other.now.y)
    for _ in range(60):
        one.step(action), other.step(action)
    assert (one.now.y != other.now.y).any(-1).all()


def test_who_reads_a_mean_over_the_coming_step_is_refused():
    system = registered("SigmaCorvette-v0")
    for name in ("wave sway", "roll moment"):
        i = (*system.vehicle.increments, *system.vehicle.ambient_flows).index(name)
        peeping = Sensor(
            "peeping",
            (name,),
            lambda state, exogenous, i=i: exogenous[..., i : i + 1],
            (1.0,),
        )
        with pytest.raises(ValueError, match=f"peeping reads {name}, a mean over the coming step"):
            gym.make("SigmaCorvette-v0", sensors=[*system.vehicle.sensors, peeping])


def test_a_mean_over_the_coming_step_is_kept_from_sensors():
    system = registered("SigmaCorvette-v0")
    i = (*system.vehicle.increments, *system.vehicle.ambient_flows).index("roll moment")
    large = Sensor(
        "large",
        ("roll moment",),
        lambda s, x: np.where(abs(force := np.asarray(x[..., [i]], float)) > 10.0, force, 0.0),
        (1e-9,),
    )
    core = Core(system, ROWS, disturbance="rough", sensors=[*system.vehicle.sensors, large])
    core.start(0)
    core.step(np.zeros(core.action_shape))
    assert np.abs(core.now.exogenous[:, i]).min() > 10.0
    assert np.abs(core.now.y[:, -1]).max() < 1e-7


def _old_timing(model) -> UMVFilter:
    """KF-UMV-UI that takes what the gyro shows for the input of the coming step."""
    u = registered("SigmaCorvette-v0").vehicle.cruise[1]
    A, C = (
        getattr(model, name)(u) if callable(getattr(model, name)) else getattr(model, name)
        for name in "AC"
    )
    return UMVFilter(LinearModel(A, C, model.Q, model.R, B=model.B, G=model.G, H=model.H))


def test_a_filter_whose_model_has_the_old_timing_is_refused():
    with pytest.raises(ValueError, match="another time than measurements show it"):
        gym.make("SigmaCorvette-v0", estimator=_old_timing, estimator_options={"model": "linear"})
    with pytest.raises(ValueError, match="use EndedUMVFilter"):
        gym.make("SigmaCorvette-v0", estimator=UMVFilter)
