"""Sensor suites: grades with their sources, correlated errors, and the loss of the position fix.

Statistical tests have fixed seeds; the false-alarm rate of each band is 1e-6 if nothing else is
said.
"""

import re
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contract import (
    ENVIRONMENTS,
    FEW_MEMBERS,
    assert_sound,
    every_environment,
    make_core,
    single_class,
)
from scipy.stats import kstest

from agents.budget.sensors import total_error
from vessel_gym.sensor_faults import LOSS
from vessel_gym.sensors import SUITE_NAMES, SUITES, Sensor, plain
from vessel_gym.sensors.grades import NOMINAL, grades_of, read_grades

FALSE_ALARM = 1e-6
SHIP, AUV, THESIS, AIRCRAFT = (
    "SigmaCorvette-v0",
    "SegorogeniAUV-v0",
    "ThesisCorvette-v0",
    "PunaUAV-v0",
)
GRADED = [
    env_id for env_id in ENVIRONMENTS if hasattr(single_class(env_id).system.vehicle, "grades")
]
every_graded = pytest.mark.parametrize("env_id", GRADED)
FIXES = ("receiver", "GNSS", "acoustic position", "USBL", "gyro compass")
"""Sensors of a position; the last where a vehicle has none of the others."""


def system_of(env_id: str) -> Any:
    return single_class(env_id).system


def same(one: Sensor, other: Sensor) -> bool:
    return all(getattr(one, each.name) == getattr(other, each.name) for each in fields(Sensor))


# --- the loss of the fix --------------------------------------------------------------------------


def test_fix_is_lost_for_exactly_120_seconds():
    core = make_core(SHIP, 2000, estimator="truth", sensors="denied")
    core.start(41)
    active = core.config.delivery.active
    lost = np.stack([active(core.now.but(steps=np.full(2000, k)))[:, 0] for k in range(841)])
    np.testing.assert_array_equal(lost.sum(0), 240)
    assert (lost[:601].sum(0) == 240).all()
    # drawn between 0 and 180 s and seen at the next step: uniform within a step
    # (Kolmogorov-Smirnov)
    assert kstest((lost.argmax(0) - 0.5) * 0.5 / 180.0, "uniform").pvalue > FALSE_ALARM


@every_graded
def test_denied_sensors_are_nominal_but_for_a_lost_fix(env_id: str):
    """In a short episode the fix never returns, and is lost in the first half."""
    system = system_of(env_id)
    sensors, seconds = system.sensors_of("denied"), system.task.horizon * system.vehicle.dt
    assert all(map(same, sensors.each, system.nominal_sensors))
    (fault,), names = sensors.faults, [sensor.name for sensor in sensors.each]
    assert fault.sensor == next(name for name in FIXES if name in names)
    assert (fault.kind, fault.duration) == ("off", LOSS)
    latest = seconds - LOSS if seconds > LOSS else 0.5 * seconds
    assert fault.begin == (0.0, pytest.approx(latest))


def test_without_a_fix_there_is_none_to_lose():
    log = Sensor("log", ("u",), plain((0,)), (0.1,))
    with pytest.raises(
        ValueError,
        match='has no sensors="denied": none of its sensors measures a state x or psi, so',
    ):
        replace(system_of(AUV), name="Blind-v0", sensors=(log,)).sensors_of("denied")


# --- grades ---------------------------------------------------------------------------------------


@every_graded
def test_the_nominal_suite_is_the_vehicle_s_own_sensors(env_id: str):
    system = system_of(env_id)
    for sensor, grades in zip(system.nominal_sensors, grades_of(system).values(), strict=True):
        assert grades[NOMINAL] is sensor
    for one, own in zip(system.sensors_of("nominal").each, system.nominal_sensors, strict=True):
        assert same(one, own)


WITH_GRADES = (SHIP, AUV, THESIS, AIRCRAFT, "ItsunusaAUV-v0")
every_file = pytest.mark.parametrize("env_id", WITH_GRADES)


def all_grades(env_id: str) -> Iterator[tuple[str, str, Sensor, str, tuple[str, ...]]]:
    """Sensor's name, grade, the sensor in it, source and keys of the assumed figures."""
    grades = read_grades(system_of(env_id))
    for name, of in grades.sensors.items():
        for grade, sensor in of.items():
            given = grades.tables[name][grade]
            yield name, grade, sensor, given["source"], tuple(given.get("assumed", ()))


@every_file
def test_grades_are_sorted_by_total_error_of_every_channel(env_id: str):
    """Two to four of each sensor. A minimum standard is never the best."""
    grades = read_grades(system_of(env_id))
    assert list(grades.sensors) == [sensor.name for sensor in system_of(env_id).vehicle.sensors]
    for name, of in grades.sensors.items():
        assert 2 <= len(of) <= 4, name
        assert list(of)[-1] == grades.suites["budget"][name]  # the cheapest
        assert "IMO" not in next(iter(of)), name
        errors = np.array([total_error(sensor) for sensor in of.values()])
        assert (np.diff(errors, axis=0) >= 0.0).all(), (name, errors)
        assert (errors[0] < errors[-1]).any(), name


def figures_of(sensor: Sensor) -> set[str]:
    """Keys of the figures that a sensor has."""
    held = {"sd": True, "rate": sensor.rate is not None, "dropout": sensor.dropout > 0.0}
    for key in ("start", "pace", "time", "constant") if sensor.bias is not None else ():
        held[key] = bool(np.any(np.asarray(getattr(sensor.bias, key) or 0.0)))
    return {key for key, there in held.items() if there}


@every_file
def test_figure_without_document_is_called_assumed(env_id: str):
    """Of what is not, the source names a document, and a correlation time has its number there."""
    for name, grade, sensor, source, assumed in all_grades(env_id):
        label, figures = f"{name}, {grade}: {source}", figures_of(sensor)
        assert set(assumed) <= figures, label
        assert not assumed or "assumed" in source, label
        if set(assumed) < figures:
            assert re.search(r"datasheet|manual|leaflet|README|forum|test|\d{4}", source), label
        if "time" in figures - set(assumed):
            assert f"{sensor.bias.time:g} s" in source, label


DEGREE, MINUTE, CEP = np.pi / 180.0, 60.0, np.sqrt(2.0 * np.log(2.0))
RMS, BANDWIDTH = np.sqrt(0.5), np.sqrt(50.0)  # of an amplitude; of a noise density, sqrt(Hz)
HARD_TURN, STEP = 111.0 / MINUTE, 0.8  # degrees/s; s, of the thesis' ship
COMPASSES = {
    "IMO gyro-compass": {"sd": 0.2 / 2 * DEGREE, "start": 0.25 * DEGREE, "constant": 0.75 / 2 * DEGREE},
    "magnetic": {
        "sd": np.hypot(0.2 / 2, 0.5 / 2 * RMS) * DEGREE, "start": 1.5 / 2 * RMS * DEGREE, "constant": 1.0 / 2 * DEGREE
    },
}  # fmt: skip
BMI055 = {"sd": 0.014 * BANDWIDTH * DEGREE, "start": 1.0 * DEGREE}
MTI_300 = {"sd": 0.01 * BANDWIDTH * DEGREE, "start": 0.5 / 2 * DEGREE}
AHRS = {"industrial AHRS": {"start": 0.2 * DEGREE}, "MEMS AHRS": {"start": 2.0 * DEGREE}}
DOCUMENTED: dict[str, dict[str, dict[str, dict[str, float]]]] = {
    SHIP: {
        "gyro compass": COMPASSES,
        "rate gyro": {
            "fibre-optic": {
                "sd": 0.0667 / 60 * BANDWIDTH * DEGREE,
                "start": np.hypot(20 / 2 / 3600, 1.5e-3 * HARD_TURN) * DEGREE,
            },
            "IMO rate-of-turn indicator": {"start": (0.5 / MINUTE + 0.05 * HARD_TURN) / 2 * DEGREE},
            "consumer MEMS": BMI055,
        },
        "receiver": {
            "RTK": {"sd": (0.01 + 5e-3) / CEP},
            "SBAS": {"start": np.sqrt((1.0 / CEP) ** 2 - 0.4**2)},
        },
    },
    THESIS: {
        "gyro compass": COMPASSES,
        "motion reference unit": {
            "industrial MEMS": {key: STEP * value for key, value in MTI_300.items()},
            "consumer MEMS": {key: STEP * value for key, value in BMI055.items()},
        },
    },
    AUV: {
        "Doppler log": {"0.1 per cent": {"start": 0.001 / 2}, "one per cent": {"start": 0.01 / 2}},
        "depth gauge": {"quartz": {"start": 1e-4 * 100 / 2}, "piezoresistive": {"start": 0.51 / 2}},
        "attitude": AHRS,
        "inclinometer": AHRS,
        "gyroscope": {"industrial MEMS": MTI_300, "consumer MEMS": BMI055},
        "acoustic position": {
            "survey USBL": {"sd": np.hypot(50 * 0.1 * DEGREE, 0.02)},
            "miniature USBL": {"start": 50 * 2.0 / 2 * DEGREE * RMS},
        },
    },
    AIRCRAFT: {
        "GNSS": {"RTK": {"sd": (0.01 + 5e-3) / CEP}, "single-frequency": {"start": 2.5 / CEP}},
        "barometer": {
            "barometer of 0.08 hPa": {"start": 0.66 / 2},
            "barometer of 1.5 hPa": {"start": 12.7 / 2},
        },
        "pitot tube": {
            "thermal": {"start": 0.3},
            "piezoresistive": {"start": 0.01 * 13.8e3 / (1.225 * 20.0) / 2},
        },
        "attitude": AHRS,
    },
}
"""Figures of documents by environment, sensor, grade and key: what the rules of docs/sensor-suites.md make of them.

A limit is two standard deviations; a typical value, a standard deviation and an r.m.s. are one; an
amplitude's r.m.s. is the root of a half of it; a noise density counts in a bandwidth of 50 Hz.
"""


@every_file
def test_figures_of_grades_follow_from_documents(env_id: str):
    """All white noises and biases that are not assumed, of the first channel; within 3 %, for they are rounded."""
    for name, grade, sensor, _, assumed in all_grades(env_id):
        if grade == NOMINAL:
            continue
        looked_up = DOCUMENTED[AUV if "AUV" in env_id else env_id].get(name, {}).get(grade, {})
        assert set(looked_up) == figures_of(sensor) & {"sd", "start", "constant"} - set(assumed), (
            name,
            grade,
        )
        for key, expected in looked_up.items():
            values = sensor.sd if key == "sd" else getattr(sensor.bias, key)
            assert values[0] == pytest.approx(expected, rel=0.03), (name, grade, key)


@every_file
def test_budget_sensors_err_slowly_and_filters_know_it(env_id: str):
    sensors = system_of(env_id).sensors_of("budget")
    assert all(sensor.bias is not None and any(sensor.bias.start) for sensor in sensors.each)
    assert sensors.faults == ()
    core = make_core(env_id, 1, estimator="dead-reckoning", sensors="budget")
    assert core.config.estimation.space.names[-len(sensors.bias_names) :] == sensors.bias_names


def test_rates_and_latencies_of_grade_fall_on_steps(tmp_path: Path):
    file = tmp_path / "mine.toml"
    file.write_text(
        '[receiver.mine]\nsd = [1.0, 2.0]\nrate = 0.3\nlatency = 0.6\nsource = "mine"\n',
        encoding="utf-8",
    )
    for env_id, rate, latency in ((SHIP, 1.0 / 3.5, 0.5), ("vessel_gym/Ship-v0", None, None)):
        system = system_of(env_id)
        nominal, mine = grades_of(system, file)["receiver"].values()
        assert nominal is system.vehicle.sensors[2]
        assert (mine.sd, mine.bias, mine.dropout) == ((1.0, 2.0), None, 0.0)
        system.sensors_of([mine])
        if rate is not None:
            assert (mine.rate, mine.latency) == (pytest.approx(rate), latency)


WRONG = {
    '[suites.b]\n"rate giro" = "x"': (2, "unknown sensor 'rate giro' (did you mean 'rate gyro'?)"),
    "[receiver.good]\nsource = 'x'": (1, "receiver of the grade 'good' needs a 'sd'"),
    "[receiver.nominal]\nsource = 'x'\nsd = 3.0": (3, "unknown key of receiver of the grade 'nominal' 'sd'"),
    "[receiver.good]\nsource = 'x'\nsd = 1.0\nbias = 3": (4, "bias of receiver must be a table of start, and pace,"),
    "[receiver.good]\nsource = 'x'\nsd = 1.0\nassumed = ['colour']": (
        4, "unknown assumed figure of receiver of the grade 'good' 'colour'",
    ),
    "[suites.budget]\nreceiver = 'best'": (2, "unknown grade of receiver 'best'"),
}  # fmt: skip


@pytest.mark.parametrize("text", WRONG, ids=range(len(WRONG)))
def test_mistake_in_file_of_grades_is_one_sentence_with_line(tmp_path: Path, text: str):
    file, (line, sentence) = tmp_path / "mine.toml", WRONG[text]
    file.write_text(text + "\n", encoding="utf-8")
    with pytest.raises(ValueError, match=re.escape(f"{file}, line {line}: {sentence}")) as caught:
        grades_of(system_of(SHIP), file)
    assert "\n" not in str(caught.value)


# --- every environment on every suite -------------------------------------------------------------


def fly(env_id: str, estimator: str, suite: str) -> None:
    """Forty steps, in which all must be sound and the filter healthy."""
    few = FEW_MEMBERS.get(estimator)
    core = make_core(
        env_id,
        2,
        estimator=estimator,
        estimator_options=few,
        sensors=suite,
        observe="mean+std",
    )
    core.start(6)
    rng = np.random.default_rng(6)
    for _ in range(40):
        core.step(rng.uniform(-0.3, 0.3, (2, core.config.action_size)))
        assert_sound(core, core.observe(), None, core.info())
    assert core.now.belief.healthy.all() or estimator == "pf"  # of 20 particles


@pytest.mark.parametrize("suite", [name for name in SUITE_NAMES if name not in SUITES])
@every_environment
def test_the_default_estimator_carries_every_suite(env_id: str, suite: str):
    if suite == "budget" and env_id not in GRADED:
        pytest.skip("a vehicle without grades")
    fly(env_id, system_of(env_id).estimator, suite)


def test_the_page_of_suites_names_every_grade():
    from studies.filters import GRADED, sensor_grades

    cells = {cell for line in sensor_grades().splitlines() for cell in line.split(" | ")}
    for env_id in GRADED:
        for grades in read_grades(system_of(env_id)).sensors.values():
            assert {grade.partition(" (")[0] for grade in grades} <= {
                cell.partition(" (")[0] for cell in cells
            }
