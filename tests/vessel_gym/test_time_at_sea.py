"""Measurements that come late, and sensors that fail.

That without either nothing changes is what every other test says: they are of such environments.
"""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    FEW_MEMBERS,
    SPREAD,
    assert_apart,
    assert_same_tree,
    every_environment,
    make_core,
    observations_when_truth_is_altered,
    random_walk,
    replayed,
    single_class,
)
from gymnasium.vector import AutoresetMode
from refusals import refusal
from scipy.stats import chi2
from test_autoreset import assert_same_as_gymnasium_s_loop

from vessel_gym.sensor_faults import KINDS, SensorFault
from vessel_gym.sensors import LONGEST, SUITES, Sensor, Sensors, in_quality, plain
from vessel_gym.simulation.core import Core
from vessel_gym.simulation.state import State

AUV, VERTICAL, ROWS = "SegorogeniAUV-v0", "ItsunusaAUV-v0", 3
FIX = "acoustic position"


def sensors_of(env_id: str, suite: str = "nominal", **late: float) -> list[Sensor]:
    """An environment's sensors, each of them late by so many steps."""
    system = single_class(env_id).system
    late = {name: steps * system.vehicle.dt for name, steps in late.items()}
    each = system.vehicle.sensors if system.sensors is None else system.sensors
    return [replace(sensor, **late) for sensor in in_quality(each, **SUITES[suite])]


def late_fix(**late: float) -> list[Sensor]:
    """ITSUNUSA's sensors, whose fix alone is late by so many seconds."""
    each = in_quality(single_class(VERTICAL).system.vehicle.sensors, **SUITES["nominal"])
    return [replace(sensor, **late) if sensor.name == FIX else sensor for sensor in each]


def every_fault(env_id: str) -> list[SensorFault]:
    """One of each kind, now and then, on this sensor or that."""
    names = [sensor.name for sensor in sensors_of(env_id)]
    dt = single_class(env_id).system.vehicle.dt
    sizes = {"bias": 0.1, "drift": 0.02, "scale": 1.1, "garbage": 0.5}
    return [
        SensorFault(names[i % len(names)], kind, sizes.get(kind), (2 * dt, 6 * dt), 7 * dt)
        for i, kind in enumerate(KINDS)
    ]


def at_sea(env_id: str) -> dict[str, Any]:
    """All at once: sensors are late by 2 and 6 steps in turn."""
    late = zip(*(sensors_of(env_id, "degraded", latency=steps) for steps in (2, 6)), strict=True)
    sensors = [pair[i % 2] for i, pair in enumerate(late)]
    return {
        "sensors": sensors,
        "sensor_faults": every_fault(env_id),
        "disturbance": "rough",
        "mismatch": 0.2,
    }


def flown(core: Core, steps: int, seed: int = 5) -> list[tuple[np.ndarray, np.ndarray]]:
    """What has come after the start and each step."""
    core.start(seed)
    walk, come = random_walk(0, core.num_envs, core.config.action_size), []
    for step in range(steps + 1):
        if step:
            core.step(next(walk))
        come.append(core.now.arrived or (core.now.y, core.now.available))
    return come


# --- time -----------------------------------------------------------------------------------------


@every_environment
def test_latency_delays_each_measurement_and_tells_its_age(env_id: str):
    late, steps = 3, 12
    now = flown(make_core(env_id, ROWS, estimator="truth", sensors=sensors_of(env_id)), steps)
    come = flown(
        make_core(env_id, ROWS, estimator="truth", sensors=sensors_of(env_id, latency=late)), steps
    )
    for step, (y, available) in enumerate(come):
        assert not np.delete(available, late, 1).any()
        if step < late:
            assert not available.any()
            continue
        np.testing.assert_array_equal(y[:, late], now[step - late][0])
        np.testing.assert_array_equal(available[:, late], now[step - late][1])


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "estimator"), [pair for pair in SPREAD if pair[1] != "truth"])
def test_late_fusion_equals_fusion_in_time_to_last_bit(
    env_id: str, estimator: str, monkeypatch: pytest.MonkeyPatch
):
    late, steps, options = (
        4,
        14,
        {"estimator": estimator, "estimator_options": FEW_MEMBERS.get(estimator)},
    )
    one = make_core(env_id, ROWS, sensors=sensors_of(env_id, "degraded", latency=late), **options)
    other = make_core(env_id, ROWS, sensors=sensors_of(env_id, "degraded"), **options)
    records: list[State] = []  # a known input may follow from what the filter believes
    estimate = one.config.estimators[0].step

    def recorded(now: State) -> None:
        records.append(now)
        estimate(now)

    monkeypatch.setattr(one.config.estimators[0], "step", recorded)
    come = flown(one, steps)
    flown(other, 0)
    nothing = np.zeros((ROWS, other.config.sensors.size))
    for step, now in enumerate(records, 1):
        there = step + late <= steps
        y, available = (
            (values[:, late] for values in come[step + late])
            if there
            else (nothing, nothing != 0.0)
        )
        other.now = other.now.but(u=now.u, steps=now.steps, y=y, available=available)
        other.config.estimators[0].step(other.now)
    np.testing.assert_array_equal(one.now.belief.mean, other.now.belief.mean)
    np.testing.assert_array_equal(one.now.belief.cov, other.now.belief.cov)


def test_discarded_measurements_are_as_if_lost():
    discards = {"estimator": "ekf", "estimator_options": {"late": "discarded"}}
    one = make_core(VERTICAL, ROWS, sensors=late_fix(latency=0.3), **discards)
    other = make_core(VERTICAL, ROWS, estimator="ekf", sensors=[replace(s, dropout=1.0) if s.name == FIX else s
                                                           for s in late_fix()])  # fmt: skip
    come = flown(one, 45)
    flown(other, 45)
    np.testing.assert_array_equal(one.now.belief.mean, other.now.belief.mean)
    assert sum(available[:, 1:].sum((1, 2)) for _, available in come).all()


def test_late_measurement_as_new_is_as_if_read_when_it_came():
    one = make_core(
        VERTICAL,
        ROWS,
        sensors=late_fix(latency=0.3),
        estimator="ekf",
        estimator_options={"late": "as new"},
    )
    other = make_core(VERTICAL, ROWS, sensors=late_fix(), estimator="ekf")
    one.start(5)
    replay = replayed(other)
    replay.given = one.now.y, one.now.available, None
    other.start(5)
    walk = random_walk(0, ROWS, one.config.action_size)
    for _ in range(45):
        actions = next(walk)
        one.step(actions)
        replay.given = one.now.y, one.now.available, None
        other.step(actions)
        np.testing.assert_array_equal(one.now.belief.mean, other.now.belief.mean)


@pytest.mark.slow
@every_environment
@pytest.mark.parametrize("estimator", ["measurement", "enkf"])
def test_rows_equal_single_environments_with_latency_and_faults(env_id: str, estimator: str):
    assert_same_as_gymnasium_s_loop(
        env_id, AutoresetMode.SAME_STEP, estimator=estimator, **at_sea(env_id)
    )


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["ekf", "enkf", "measurement"])
def test_latency_and_faults_do_not_leak_truth(estimator: str):
    """Replayed to another truth, which is put elsewhere before each step, they give the same observations."""
    options = at_sea(AUV) | {
        "estimator": estimator,
        "estimator_options": FEW_MEMBERS.get(estimator),
    }
    one, other, distance = observations_when_truth_is_altered(AUV, **options)
    assert_apart(distance)
    assert_same_tree(one, other)


# --- faults ---------------------------------------------------------------------------------------


def faulty_and_healthy(
    *faults: SensorFault, steps: int = 12
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Measurements and their mask ``(steps + 1, ROWS, p)``, with faults and without."""
    each = [
        flown(make_core(AUV, ROWS, estimator="truth", sensor_faults=list(f)), steps)
        for f in (faults, ())
    ]
    return tuple(np.stack(values) for come in each for values in zip(*come, strict=True))  # type: ignore[return-value]


GYROSCOPE, ATTITUDE = slice(7, 10), slice(4, 7)


@pytest.mark.parametrize(
    ("kind", "size", "wrong"),
    [
        ("bias", 0.2, lambda y, t: y + 0.2),
        ("bias", (0.1, 0.0, -0.3), lambda y, t: y + np.array([0.1, 0.0, -0.3])),
        ("drift", (0.5, 0.0, 1.0), lambda y, t: y + t * np.array([0.5, 0.0, 1.0])),
        ("scale", 1.5, lambda y, t: 1.5 * y),
    ],
)
def test_fault_acts_by_its_size_in_its_time_on_its_sensor_alone(kind: str, size: Any, wrong: Any):
    faulty, came, healthy, arrived = faulty_and_healthy(
        SensorFault("gyroscope", kind, size, begin=0.4, duration=0.5)
    )
    np.testing.assert_array_equal(came, arrived)
    for step, (y, expected) in enumerate(zip(faulty, healthy, strict=True)):
        if 4 <= step < 9:
            expected[:, GYROSCOPE] = wrong(expected[:, GYROSCOPE], 0.1 * step - 0.4)
        np.testing.assert_allclose(y, expected, rtol=0, atol=1e-15)


def test_sensor_off_reads_nothing_and_stuck_sensor_repeats():
    off = SensorFault("attitude", "off", begin=0.3, duration=0.3)
    stuck = SensorFault("gyroscope", "stuck", begin=0.5)
    faulty, came, healthy, arrived = faulty_and_healthy(off, stuck)
    arrived[3:6, :, ATTITUDE] = False
    healthy[3:6, :, ATTITUDE] = 0.0
    healthy[5:, :, GYROSCOPE] = healthy[4, :, GYROSCOPE]
    np.testing.assert_array_equal(came, arrived)
    np.testing.assert_array_equal(faulty, healthy)


def test_garbage_is_noise_of_its_size_whatever_there_is_to_read():
    rows, steps = 500, 20
    core = make_core(
        AUV, rows, estimator="truth", sensor_faults=[SensorFault("depth gauge", "garbage", 4.0)]
    )
    z = np.stack([y[:, 3] for y, _ in flown(core, steps)])
    low, high = chi2.ppf([5e-7, 1 - 5e-7], z.size) * 16.0 / z.size
    assert low < (z**2).mean() < high
    assert abs(np.corrcoef(z[1:].ravel(), z[:-1].ravel())[0, 1]) < 5.0 / np.sqrt(z.size)


def test_times_of_fault_are_drawn_in_each_episode():
    fault = SensorFault("gyroscope", "bias", 0.1, begin=(1.0, 2.0), duration=1.5)
    core, episodes = make_core(AUV, 400, estimator="truth", sensor_faults=[fault]), []
    for seed in (0, None):
        core.start(seed)
        acting = []
        for _ in range(49):
            acting.append(core.info()["sensor_faults"][:, 0])
            core.step(np.zeros((400, 3)))
        episodes.append((np.argmax(acting, 0), len(acting) - np.argmax(acting[::-1], 0)))
    (begun, ended), (again, _) = episodes
    assert (begun != again).any()
    np.testing.assert_array_equal(ended - begun, 15)
    # uniform numbers in steps of 0.1 s, rounded up; their mean to within 5 standard errors
    assert 10 <= begun.min() <= begun.max() <= 20
    assert abs(begun.mean() - 15.5) < 5.0 * 10.0 / np.sqrt(12.0 * 400.0)


def test_fault_acts_when_measurement_is_taken():
    fault = SensorFault(FIX, "bias", 100.0, begin=2.0, duration=0.1)  # the second fix
    sensors = [replace(each, dropout=0.0) for each in late_fix(latency=1.0)]
    core = make_core(VERTICAL, ROWS, estimator="truth", sensors=sensors, sensor_faults=[fault])
    come = flown(core, 60)
    x = np.stack([y[:, 10, -1] for y, _ in come])
    assert (x[30] > 50.0).all()
    assert (np.abs(np.delete(x, 30, 0)) < 50.0).all()


# --- what is no such thing ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("latency", "sentence"),
    [(-0.1, "latency of log must be a number of at least 0, got -0.1"),
     (0.101, "latency of log is 0.101 s, which is no whole number of steps of 0.1 s"),
     (1e6, f"latency of log is 1e+07 steps, of {LONGEST} at most")],
)  # fmt: skip
def test_a_latency_that_is_none_is_refused_in_a_sentence(latency: float, sentence: str):
    def made(latency: float) -> Sensors:
        sensor = Sensor("log", ("u",), plain((0,)), (0.1,), latency=latency)
        return Sensors([sensor], ("u",), (), 0.1)

    assert refusal(ValueError, made, latency).startswith(sentence)
    made(0.3)  # which is 2.9999999999999996 steps


@pytest.mark.parametrize(
    ("kind", "options", "sentence"),
    [
        ("of", {}, "unknown kind of sensor fault 'of' (did you mean 'off'?): choose from off, stuck, "),
        ("bias", {}, "size of the fault 'bias' of gyroscope must be what is added, one for all channels or "),
        ("garbage", {"size": -1.0}, "size of the fault 'garbage' of gyroscope must be 0 or more, got -1.0"),
        ("off", {"size": 1.0}, "the fault 'off' of gyroscope has no size, got 1.0"),
        ("off", {"begin": (2.0, 1.0)}, "begin of the fault 'off' of gyroscope must be 0 s or more, or two "),
        ("off", {"duration": 0.0}, "duration of the fault 'off' of gyroscope must be"),
    ],
)  # fmt: skip
def test_a_fault_that_makes_no_sense_is_refused_in_a_sentence(
    kind: str, options: dict[str, Any], sentence: str
):
    assert refusal(ValueError, SensorFault, "gyroscope", kind, **options).startswith(sentence)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"sensor_faults": "off"}, "sensor_faults must be a list of SensorFault objects"),
        ({"sensor_faults": [SensorFault("sextant", "off")]}, "unknown sensor of sensor_faults 'sextant'"),
        ({"sensor_faults": [SensorFault("gyroscope", "bias", (1.0,) * 9)]}, "gyroscope has 3 channels, so size of "),
        ({"estimator_options": {"late": "newest"}}, "unknown value of late 'newest': choose from fused, as new, disc"),
    ],
)  # fmt: skip
def test_environment_refuses_unknown_faults_and_late(options: dict[str, Any], sentence: str):
    assert refusal((TypeError, ValueError), gym.make, AUV, **options).startswith(sentence)
