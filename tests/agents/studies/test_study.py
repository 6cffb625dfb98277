"""Study files: what is written is run, and every mistake is found at once, with its line."""

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from agents.commands.ablate import STUDIES
from agents.seeds import evaluation_seeds
from agents.studies.plan import plan
from agents.studies.records import Agent, Condition, Estimator, Study
from agents.studies.study import StudyError, read_study
from agents.studies.worlds import environment_options, system_of

SMALL = """
title = "A small study"
episodes = 3
training_seeds = 2

[environments]
SigmaCorvette-v0 = {}
SegorogeniAUV-v0 = {}

[estimators]
kf = {}
"plain enkf" = { estimator = "enkf", options = { members = "none" }, environments = ["SegorogeniAUV-v0"] }

[conditions]
nominal = {}
rough = { disturbance = "rough", mismatch = 0.1 }

[agents]
PPO = { kind = "ppo", trained_on = ["truth"], steps = { SigmaCorvette-v0 = 1000 }, settings = { gamma = 0.9 } }
raw = { kind = "ppo", observe = "measurement", memory = "lstm", environments = ["SegorogeniAUV-v0"] }
"""


def read(tmp_path: Path, text: str) -> Study:
    path = tmp_path / "study.toml"
    path.write_text(text, encoding="utf-8")
    return read_study(path)


def mistakes(tmp_path: Path, text: str) -> list[tuple[int, str]]:
    with pytest.raises(StudyError) as raised:
        read(tmp_path, text)
    return sorted(raised.value.mistakes)


def expect(found: list[tuple[int, str]], expected: dict[int, str]) -> None:
    for line, words in expected.items():
        assert any(number == line and words in text for number, text in found), (line, found)
    assert {line for line, _ in found} == set(expected)


def test_a_study_is_what_its_file_says(tmp_path):
    study = read(tmp_path, SMALL)
    assert (study.title, study.training_seeds, study.termination) == ("A small study", 2, "task")
    assert study.seeds == evaluation_seeds(3)
    assert study.environments == ("SigmaCorvette-v0", "SegorogeniAUV-v0")
    assert [e.name for e in study.estimators] == ["truth", "dead-reckoning", "kf", "plain enkf"]
    assert study.estimators[-1] == Estimator(
        "plain enkf", "enkf", {"members": None}, ("SegorogeniAUV-v0",)
    )
    assert study.conditions[1] == Condition("rough", disturbance="rough", mismatch=0.1)
    assert study.agents[0] == Agent("autopilot", "autopilot")
    assert study.agents[1] == Agent(
        "PPO",
        "ppo",
        trained_on=("truth",),
        steps={"SigmaCorvette-v0": 1000},
        settings={"gamma": 0.9},
    )
    assert json.loads(json.dumps(asdict(study)))["conditions"][0]["sensors"] == "nominal"
    assert read(tmp_path, SMALL + "autopilot = {}\n").agents[-1].kind == "autopilot"
    least = read(tmp_path, "[environments]\nItsunusaAUV-v0 = {}\n")
    assert least.conditions == (Condition("nominal"),)
    assert (least.episodes, least.training_seeds, least.termination) == (100, 10, "belief")


@pytest.mark.parametrize("name", STUDIES)
def test_studies_of_package_are_read_and_give_no_input_cov(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.syspath_prepend(STUDIES[name].parent)  # as `ablate` does
    study = read_study(STUDIES[name])
    assert study.title
    assert all("input_cov" not in estimator.options for estimator in study.estimators)


@pytest.mark.parametrize("chosen", ["belief", "task"])
def test_all_arms_end_by_one_termination(tmp_path, chosen):
    text = f'termination = "{chosen}"\n' + SMALL
    jobs = plan(read(tmp_path, text)).jobs
    found = [each.arguments["options"] for job in jobs for each in (job, *job.needs)]
    assert {options["termination"] for options in found} == {chosen}


def test_mistakes_in_settings_are_reported_with_line(tmp_path):
    text = """first_seed = -1
margin = 0
termination = "beleif"
[environments]
SegorogeniAUV-v0 = {}
[agents]
mine = { kind = "autopilot", memory = "lstm" }
PPO = { kind = "ppo", observe = 1, settings = { gama = 0.9 } }
flat = { kind = "ppo", settings = { net_arch = [32] } }
"""
    expected = {
        1: "first_seed must be a whole number of at least 0",
        2: "margin must be a share between 0 and 1",
        3: "termination must be belief or task",
        7: "is of kind autopilot: only agents that learn",
        8: "observe must be one of",
        9: "unknown setting 'net_arch'",
    }
    expect(mistakes(tmp_path, text), expected)


@pytest.mark.parametrize("name", ["measurement", "truth", "kff"])
def test_a_study_is_compared_to_one_of_its_filters(tmp_path, name):
    text = f'compare_to = "{name}"\n' + SMALL.replace("kf = {}", "kf = {}\nmeasurement = {}")
    expect(mistakes(tmp_path, text), {1: f"unknown filter of the study '{name}'"})
    study = read(tmp_path, 'compare_to = "kf"\n' + SMALL)
    assert study.compare_to == "kf"


def test_condition_may_have_late_faulty_and_graded_sensors(tmp_path):
    text = """[environments]
SegorogeniAUV-v0 = {}
SigmaCorvette-v0 = {}
[conditions]
late = { sensors = "degraded", latency = { "acoustic position" = 1.0, receiver = 2.0 } }
spoofed = { faults = [{ sensor = "receiver", kind = "drift", size = [0.5, -0.2], begin = [20, 40], duration = inf }] }
slow = { sensors = { receiver = "SBAS at 0.5 Hz", "rate gyro" = "consumer MEMS" } }
"""
    late, spoofed, slow = read(tmp_path, text).conditions
    for world, delays in (("SegorogeniAUV-v0", [0, 0, 0, 0, 10]), ("SigmaCorvette-v0", [0, 0, 4])):
        own = environment_options(world, late.options)
        assert [sensor.delay(system_of(world).vehicle.dt) for sensor in own["sensors"]] == delays
        assert all(sensor.dropout > 0.0 for sensor in own["sensors"])  # of the suite, all the same
        nominal = system_of(world).nominal_sensors
        graded = environment_options(world, slow.options)["sensors"]
        changed = [one.name for one, other in zip(graded, nominal, strict=True) if one != other]
        assert changed == ([] if "AUV" in world else ["rate gyro", "receiver"])
    assert graded[-1].rate == 0.5
    denied = environment_options("SigmaCorvette-v0", spoofed.options | {"sensors": "denied"})
    assert [each.kind for each in denied["sensor_faults"]] == ["drift", "off"]  # of the suite, too
    assert environment_options("SegorogeniAUV-v0", spoofed.options)["sensor_faults"] == []


def test_mistakes_in_sensors_of_conditions_have_their_line(tmp_path):
    text = """[environments]
SegorogeniAUV-v0 = {}
[conditions]
a = { latency = { "acoustic positon" = 1.0 } }
b = { latency = { "acoustic position" = 0.25 } }
c = { latency = 1.0 }
d = { faults = [{ sensor = "gyroscope" }] }
e = { faults = [{ sensor = "gyroscope", kind = "bias", size = [1.0, 2.0] }] }
f = { faults = { sensor = "gyroscope" } }
g = { sensors = { gyroscope = "consumer MEMZ" } }
h = { sensors = { gyroscope = "consumer MEMS at 3 Hz" } }
i = { sensors = { gyroscope = 3 } }
"""
    found = mistakes(tmp_path, text)
    expected = {
        4: "unknown sensor 'acoustic positon' (did you mean 'acoustic position'?)",
        5: (
            "SegorogeniAUV-v0 refuses the condition b: latency of acoustic position is 0.25 s,"
            " which is no whole number"
        ),
        6: "latency must be a table of seconds by sensor, got 1.0",
        7: "faults must be tables of sensor, kind and perhaps size, begin, duration, got",
        8: "gyroscope has 3 channels, so size of the fault 'bias' of gyroscope must be one number or 3",
        9: "faults must be a list of tables",
        10: "unknown grade of gyroscope 'consumer MEMZ' (did you mean 'consumer MEMS'?)",
        11: "gyroscope reads at 3 Hz, which does not divide",
        12: "sensors must be a name, or a table of grades by sensor, got {'gyroscope': 3}",
    }
    expect(found, expected)


def test_every_mistake_is_reported_at_once_with_its_line(tmp_path):
    text = """episodess = 20
episodes = 1
[environments]
SegorogeniAUV-v0 = {}
[estimators]
enkff = {}
kf = {}
enkf = { options = { memberss = 10 } }
etkf = { options = { members = 1 } }
[conditions]
a = { sensors = "nominl", disturbance = "ruogh" }
b = { mismatch = 0.5 }
[agents]
PPO = { kind = "ppo", trained_on = ["elkf"], memory = "lst" }
[agents.raw]
kind = "ppo"
observe = "measurement"
trained_on = ["enkf"]
"""
    found = mistakes(tmp_path, text)
    expected = {
        1: "did you mean 'episodes'",
        2: "at least 2",
        6: "did you mean 'enkf'",
        7: "kf needs a LinearModel",
        8: "no option 'memberss'",
        9: "members must be",
        12: "between 0 and 0.25",
        18: "trained and flown on no estimator",
    }
    expect(found, expected | {11: "nominl", 14: "elkf"})
    assert [line for line, _ in found].count(11) == [line for line, _ in found].count(14) == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "needs environments"),
        ("[environments]\nSegorogeniAUV = {}\n", "did you mean 'SegorogeniAUV-v0'"),
        ('[environments]\n"CartPole-v1" = {}\n', "no estimator in the loop"),
        ('[environments]\n"nowhere:Env-v0" = {}\n', "cannot import 'nowhere'"),
        ('[environments]\n"vessel_gym.envs:VesselVectorEnv" = {}\n', "unknown environment"),
        ("[environments]\nPunaUAV-v0 = {}\n[agents.x]\nkind = 'ppo'\nsteps = { PunaUAV-v0 = 2 }\n", "at least 256"),
        ("episodes = true\n[environments]\nPunaUAV-v0 = {}\n", "whole number"),
        ("episodes = 2000000\n[environments]\nPunaUAV-v0 = {}\n", "there are 1000000 evaluation seeds"),
        ('[environments]\nPunaUAV-v0 = {}\n[agents]\na = { kind = "ppo", trained_on = "enkf" }\n', "list of names"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_study_says_what_to_do(tmp_path, text, words):
    with pytest.raises(StudyError, match=r"study\.toml") as raised:
        read(tmp_path, text)
    assert words in str(raised.value)


ONE = "[environments]\nSigmaCorvette-v0 = {}\n"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('[estimators]\ntruth = { estimator = "measurement" }', "the name 'truth' is taken: give this 'measurement'"),
        ("[estimators]\ntruth = { options = { late = 'as new' } }", "truth is an end of the scale: leave it as it is"),
        ('[conditions]\na = { environments = ["SigmaCorvette-v0"] }', "the first condition is that of trainings"),
        ('[agents]\na = { kind = "ppo", flown_on = ["default"] }', "unknown estimator 'default'"),
        ('\n"vessel_gym:SigmaCorvette-v0" = {}', "are one environment: leave one of them out"),
        ("[estimators]\n'' = { estimator = 'ekf' }", "names of estimators must be text in a line, got ''"),
        ("[estimators]\nekf = { environments = [] }", "environments must be a list of names, one or more"),
        ('[agents]\nautopilot = { kind = "ppo" }', "the name 'autopilot' is taken: give this 'ppo' another one"),
        ('[agents]\nx = { kind = "math:pi" }', "'math:pi' makes no agent: it cannot be called"),
        ("[agents]\nx = { kind = 3 }", "kind must be a name, got 3"),
        ('[agents]\nPPO = { kind = "ppo", trained_on = [] }', "trained_on must be a list of names, one or more"),
        ('[conditions]\nx = { sensors = "math:pi" }', "sensors must be the name of a suite, or Sensor"),
        ('[tune]\nconditions = ["each", "nominal"]', 'conditions must be names of conditions, or ["each"] alone'),
        ('[conditions]\nx = { disturbance = "math:pi" }', "disturbance must be one of calm, moderate, rough, or a"),
    ],
)  # fmt: skip
def test_silent_change_of_study_is_refused_with_line(tmp_path, line, words):
    found = mistakes(tmp_path, f"{ONE}{line}\n")
    assert (4, True) in [(number, words in text) for number, text in found], found
    assert all(number == 4 and "\n" not in text for number, text in found)


def test_agent_that_cannot_be_trained_is_left_out(tmp_path):
    text = """[environments]
SigmaCorvette-v0 = {}
SegorogeniAUV-v0 = {}
[estimators]
ekf = { environments = ["SegorogeniAUV-v0"] }
[agents]
PPO = { kind = "ppo", trained_on = ["ekf"] }
"""
    out = [each for each in plan(read(tmp_path, text)).skipped if each.what == "PPO"]
    assert [each.environment for each in out] == ["SigmaCorvette-v0"]
    here = '["ekf"], environments = ["S'
    steps = here + 'egorogeniAUV-v0"], steps = { SigmaCorvette-v0 = 9000 }'
    expect(
        mistakes(tmp_path, text.replace('["ekf"]', steps)),
        {7: "unknown environment of PPO 'SigmaCorvette-v0': choose from SegorogeniAUV-v0"},
    )
