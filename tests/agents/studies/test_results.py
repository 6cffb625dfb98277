"""What a study found, by place, policy and estimator."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from invented import CONDITIONS, CORVETTE, QUALITY, SEGOROGENI, learned, results, study, without

from agents.jobs import run
from agents.metrics.dive import METRICS
from agents.statistics import crossed_interval, mean_interval
from agents.studies import flying
from agents.studies.plan import plan
from agents.studies.records import RAW
from agents.studies.results import Place, Policy, Results
from agents.studies.worlds import system_of

NOMINAL = Place(CORVETTE, "nominal")


@pytest.fixture(scope="module")
def found():
    return learned()


def test_the_floor_and_the_oracle_are_0_and_1_of_the_scale(found):
    for name, end in (("dead-reckoning", 0.0), ("truth", 1.0)):
        assert np.mean(found.kept(NOMINAL, found.classical, name)) == pytest.approx(end)


def test_controllers_are_the_same_everywhere_by_the_name_of_their_school(found):
    schools = found.schools()
    assert [str(p) for p in schools] == [
        "autopilot", "PPO trained on default", "PPO trained on ekf", "PPO, raw", "PPO, LSTM",
    ]  # fmt: skip
    assert found.here(CORVETTE, schools[1]) == Policy("PPO", "kf-umv-ui")
    assert found.here(SEGOROGENI, schools[1]) == Policy("PPO", "enkf")
    assert [found.own(CORVETTE, p) for p in schools] == ["kf-umv-ui", "kf-umv-ui", "ekf", RAW, RAW]
    assert {found.here(CORVETTE, p) for p in schools} == set(found.policies(CORVETTE))


def test_runs_of_a_school_are_those_of_its_policy_in_each_environment(found):
    runs = found.runs([CORVETTE, SEGOROGENI], Policy("PPO", "default"))
    assert runs.shape == (5, 2)
    for column, environment, name in ((0, CORVETTE, "kf-umv-ui"), (1, SEGOROGENI, "enkf")):
        places = found.places([environment])
        kept = np.mean([found.kept(p, Policy("PPO", name), name).mean(1) for p in places], axis=0)
        np.testing.assert_allclose(runs[:, column], kept)


def test_a_run_that_lacks_a_flight_is_left_out_and_pairs_are_of_the_same_seeds(found):
    broken = without(
        found,
        lambda f: (
            (f.agent, f.trained_on, f.training_seed, f.condition)
            in [("PPO", "ekf", 2, "calm"), ("PPO, raw", RAW, 0, "rough")]
        ),
    )
    home, raw = Policy("PPO", "ekf"), Policy("PPO, raw", RAW)
    whole = [found.runs([CORVETTE], policy) for policy in (home, raw)]
    np.testing.assert_allclose(broken.runs([CORVETTE], home), whole[0][[0, 1, 3, 4]], atol=1e-12)
    lost = broken.paired_shares([CORVETTE], (home, None), (raw, None))
    np.testing.assert_allclose(lost.mean(1), (whole[0] - whole[1])[[1, 3, 4], 0], atol=1e-12)
    none = without(found, lambda f: f.agent == "PPO" and f.condition == "calm")
    assert none.runs([CORVETTE], home) is None
    assert none.paired_shares([CORVETTE], (home, None), (raw, None)) is None


def test_shares_are_paired_with_the_scale_seed_by_seed(found):
    for name, end in (("dead-reckoning", 0.0), ("truth", 1.0)):
        shares = found.shares([CORVETTE, SEGOROGENI], found.classical, name)
        np.testing.assert_allclose(shares, np.full((1, 8), end), atol=1e-12)


def test_who_does_not_learn_is_paired_with_every_training_run(found):
    policy = Policy("PPO", "ekf")
    gaps = found.paired_shares([CORVETTE], (policy, "ekf"), (found.classical, "ekf"))
    ours, theirs = (found.shares([CORVETTE], who, "ekf") for who in (policy, found.classical))
    np.testing.assert_allclose(gaps, ours - theirs, atol=1e-12)
    assert gaps.shape == (5, 8)


def test_a_share_of_yes_and_no_has_an_exact_interval_and_other_metrics_a_mean_over_seeds(found):
    place = Place(SEGOROGENI, "nominal")
    flight = next(
        f for f in found.plan.flights if (f.environment, f.condition, f.flown_on) == (*place, "ekf")
    )
    values = found.values[flight.job.key]
    figures = values["figures"] | {
        "arrived": [100.0] * 8,
        "miss": [1.0, *[float("nan")] * 4, 2.0, 4.0, 3.0],
    }
    changed = Results(found.plan, found.values | {flight.job.key: values | {"figures": figures}})
    arrived, miss = (next(m for m in METRICS if m.key == key) for key in ("arrived", "miss"))
    shown = changed.mean(place, found.classical, "ekf", arrived)
    assert (shown.mean, shown.high) == (100.0, 100.0)
    assert shown.low == pytest.approx(100.0 * 0.025 ** (1.0 / 8.0))
    assert changed.mean(place, found.classical, "ekf", miss) == mean_interval(
        np.array([1.0, 2.0, 4.0, 3.0])
    )


def test_places_without_a_scale_count_for_nothing(found):
    calm = without(found, lambda f: (f.flown_on, f.condition) == ("truth", "calm"))
    assert [p.condition for p in calm.scaled([CORVETTE])] == ["nominal", "rough", "all wrong"]
    assert calm.runs([CORVETTE], Policy("PPO", "ekf")).shape == (5, 1)
    flat = results(found.plan, QUALITY | {"truth": -0.1})
    assert flat.scaled() == []


def test_the_price_is_over_seeds_and_training_runs(found):
    assert found.price([NOMINAL], found.classical, "truth").mean == 0.0
    truth, ours = (found.figure(NOMINAL, found.classical, name)[0] for name in ("truth", "kf"))
    price = found.price([NOMINAL], found.classical, "kf")
    assert price.mean == pytest.approx(np.mean(truth - ours))
    policy = Policy("PPO", "ekf")
    truth, ours = (found.figure(NOMINAL, policy, name) for name in ("truth", "ekf"))
    assert found.price([NOMINAL], policy, "ekf") == crossed_interval(truth - ours)
    assert found.price([NOMINAL], Policy("PPO, raw", RAW), RAW) is None


def test_estimators_come_in_the_order_of_the_study(found):
    assert found.flown_on() == ["truth", "dead-reckoning", "kf-umv-ui", "kf", "ekf", "enkf", RAW]
    assert found.estimators(policy=found.classical) == ["truth", "dead-reckoning", "ekf", "enkf"]


@pytest.mark.slow
def test_times_of_steps_come_with_the_result_of_a_flight(tmp_path):
    planned = plan(study((CORVETTE,), conditions=CONDITIONS[:1], episodes=2))
    flight = next(f for f in planned.flights if f.flown_on == "kf")
    outcome = run([flight.job], tmp_path)
    assert set(outcome.values[flight.job.key]) == {
        "figures", "nees_in_band", "nis_in_band", "diverged", "ends", "steps", "timing",
    }  # fmt: skip
    found = Results.of(planned, outcome)
    assert [rows for rows, _, _ in found.step_times(CORVETTE, "kf")] == [2, 1]
    assert all(0.0 < each < 1e6 for _, *times in found.step_times(CORVETTE, "kf") for each in times)
    assert found.step_times(CORVETTE, "ekf") == []


def test_the_estimator_and_the_truth_fly_in_turns_and_only_steps_are_timed(monkeypatch):
    clock, flown = [0.0], []
    monkeypatch.setattr(
        flying,
        "classical_controller",
        lambda *_: SimpleNamespace(reset=lambda rows: None, act=lambda y: y),
    )
    monkeypatch.setattr(flying, "process_time", lambda: clock[0])

    class Env:
        def __init__(self, estimator, rows):
            self.estimator, self.rows = estimator, rows

        def reset(self, seed):
            clock[0] += 1000.0
            return np.zeros(len(seed)), {}

        def step(self, action):
            flown.append(self.estimator)
            first = flown.count(self.estimator) <= flying.STEPS
            clock[0] += {"kf": 3e-3, "truth": 1e-3}[self.estimator] * (
                100.0 if first and self.rows > 1 else 1.0
            )
            return action, 0.0

        def close(self):
            pass

    monkeypatch.setattr(flying, "batch", lambda env_id, rows, made: Env(made["estimator"], rows))
    options = {"estimator": "kf", "estimator_options": {"input_cov": 1.0}}
    [batch, alone] = flying.step_times(CORVETTE, options, "autopilot", 4, "truth")
    assert batch == (4, pytest.approx(3e-3 / 4), pytest.approx(1e-3 / 4))
    assert alone == (1, pytest.approx(3e-3), pytest.approx(1e-3))
    turns = [name for i, name in enumerate(flown[: 12 * flying.STEPS]) if i % flying.STEPS == 0]
    assert turns == ["kf", "truth"] * 6


def test_an_episode_is_completed_as_its_own_task_asks():
    """The corvette's success is to go on until time is up, a dive's is to arrive."""
    found = results(study())
    ends = {f.job.key: system_of(f.environment).task.success for f in found.plan.flights}
    values = {
        key: value | {"ends": [ends[key]] * len(value["ends"])}
        for key, value in found.values.items()
    }
    share = replace(found, values=values).completed(found.places(), found.classical, "truth")
    assert share.mean == pytest.approx(100.0)
