"""A study as jobs: all fly the same seeds, what cannot fly is left out with its reason, nothing is done twice."""

from dataclasses import replace

import pytest

from agents.studies.plan import plan
from agents.studies.records import RAW, Agent, Condition, Estimator, Study
from agents.studies.worlds import digests

CORVETTE, SEGOROGENI = "SigmaCorvette-v0", "SegorogeniAUV-v0"
STUDY = Study(
    "t",
    (CORVETTE, SEGOROGENI),
    (
        Estimator("truth", "truth"),
        Estimator("dead-reckoning", "dead-reckoning"),
        Estimator("kf", "kf"),
        Estimator("plain", "enkf", {"inflation": 1.0, "members": None}, (SEGOROGENI,)),
    ),
    (
        Agent("autopilot", "autopilot"),
        Agent("PPO", "ppo", trained_on=("truth", "default"), steps={CORVETTE: 1000}),
        Agent("LSTM", "ppo", observe="measurement", memory="lstm"),
    ),
    (Condition("nominal"), Condition("rough", disturbance="rough")),
    episodes=3,
    training_seeds=2,
)


@pytest.fixture(scope="module")
def planned():
    return plan(STUDY)


def flights(planned, **wanted):
    return [
        f for f in planned.flights if all(getattr(f, key) == value for key, value in wanted.items())
    ]


def test_estimator_without_model_is_skipped_with_reason(planned):
    assert [(s.environment, s.what) for s in planned.skipped] == [(SEGOROGENI, "kf")]
    assert "LinearModel" in planned.skipped[0].reason
    assert not flights(planned, environment=SEGOROGENI, estimator="kf")
    assert flights(planned, environment=CORVETTE, estimator="kf")


def test_classical_agent_flies_every_estimator_once(planned):
    own = [(f.environment, f.condition, f.estimator) for f in flights(planned, policy="autopilot")]
    corvette = [
        "truth",
        "dead-reckoning",
        "kf",
        "kf-umv-ui",
    ]  # the default is there because an agent is trained on it
    segorogeni = ["truth", "dead-reckoning", "plain", "enkf"]
    expected = {(CORVETTE, c, e) for c in ("nominal", "rough") for e in corvette}
    assert set(own) == expected | {
        (SEGOROGENI, c, e) for c in ("nominal", "rough") for e in segorogeni
    }
    assert len(own) == len(set(own))


def test_policy_flies_every_estimator_and_is_trained_once(planned):
    crossed = flights(
        planned, environment=CORVETTE, condition="rough", policy="PPO trained on default"
    )
    assert {(f.estimator, f.run) for f in crossed} == {
        (e, seed) for e in ("truth", "dead-reckoning", "kf", "kf-umv-ui") for seed in (0, 1)
    }
    trainings = {need.key: need for f in planned.flights for need in f.job.needs}
    assert len(trainings) == 2 * (2 + 1) * 2  # environments, schools, seeds
    for training in trainings.values():
        assert training.arguments["options"]["disturbance"] == "moderate"
        assert training.artifact == ".npz"
    steps = {
        (t.arguments["environment"], t.arguments["steps"])
        for t in trainings.values()
        if "PPO" in t.label
    }
    assert steps == {(CORVETTE, 1000), (SEGOROGENI, 2_500_000)}


def test_agent_on_raw_measurements_sees_no_estimator(planned):
    raw = flights(planned, policy="LSTM")
    assert {(f.home, f.estimator) for f in raw} == {(True, RAW)}
    for flight in raw:
        for job in (flight.job, *flight.job.needs):
            assert job.arguments["options"]["observe"] == "measurement"
            assert job.arguments["options"]["estimator"] == "measurement"


def test_everybody_flies_the_same_seeds_of_the_same_worlds(planned):
    assert {f.job.arguments["episodes"] for f in planned.flights} == {3}
    for flight in planned.flights:
        options = flight.job.arguments["options"]
        assert options["disturbance"] == ("rough" if flight.condition == "rough" else "moderate")
        assert (options["sensors"], options["mismatch"]) == ("nominal", 0.0)


def test_more_of_a_study_keeps_the_jobs_that_were_there(planned):
    more = plan(
        replace(
            STUDY,
            conditions=(*STUDY.conditions, Condition("calm", disturbance="calm")),
            title="other",
        )
    )
    before, after = ({job.key for job in p.jobs} for p in (planned, more))
    assert before < after
    other = plan(replace(STUDY, episodes=4))
    assert not before & {job.key for job in other.jobs}


def test_a_condition_of_one_environment_is_flown_there_alone():
    rough = Condition("rough", disturbance="rough", environments=(SEGOROGENI,))
    planned = plan(replace(STUDY, conditions=(STUDY.conditions[0], rough)))
    assert {f.environment for f in flights(planned, condition="rough")} == {SEGOROGENI}
    assert {f.environment for f in flights(planned, condition="nominal")} == {CORVETTE, SEGOROGENI}


def test_policy_flies_estimators_that_its_agent_names():
    some = Agent("PPO", "ppo", trained_on=("truth", "default"), flown_on=("dead-reckoning",))
    planned = plan(replace(STUDY, agents=(STUDY.agents[0], some)))
    schools = {"PPO trained on truth": "truth", "PPO trained on default": "kf-umv-ui"}
    for policy, own in schools.items():
        found = flights(planned, environment=CORVETTE, policy=policy)
        assert {(f.estimator, f.home) for f in found} == {(own, True), ("dead-reckoning", False)}
    found = flights(planned, environment=CORVETTE, policy="autopilot")
    assert {f.estimator for f in found} > {"kf"}


def test_the_source_of_what_is_the_users_own_is_part_of_a_job(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    text = "from estimators.kalman import KalmanFilter as Mine\n"
    (tmp_path / "own_filters_1.py").write_text(text)
    (tmp_path / "own_filters_2.py").write_text(f"{text}x = 1\n")
    one, two = (
        digests(CORVETTE, "autopilot", {"estimator": f"own_filters_{i}:Mine"}) for i in (1, 2)
    )
    assert list(one) == ["own_filters_1"]
    assert list(one.values()) != list(two.values())
