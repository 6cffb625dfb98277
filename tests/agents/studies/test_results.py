"""The long table of a study, and the normalised scores that are computed of it."""

from dataclasses import replace

import numpy as np
import pytest
from invented import CONDITIONS, CORVETTE, QUALITY, SEGOROGENI, learned, results, study, without

from agents.jobs import run
from agents.metrics.dive import METRICS
from agents.page import text
from agents.statistics import crossed_interval, mean_interval
from agents.studies import ranking
from agents.studies.plan import plan
from agents.studies.records import RAW
from agents.studies.results import Results
from agents.studies.tables import summary
from agents.studies.worlds import system_of

PPO, ITSUNUSA = "PPO trained on default", "ItsunusaAUV-v0"


@pytest.fixture(scope="module")
def found():
    return learned()


def here(found):
    """Rows of the scale in the corvette's environment."""
    return found.scales.loc[[CORVETTE]]


def by_hand(found, environment, policy, estimator):
    """Normalised score ``(runs, seeds)``, from the table: the ratio of means, linearised by seed."""
    table, each = found.table[found.table.environment == environment], []
    for condition in found.conditions(environment):
        at = table[table.condition == condition]

        def scores(policy, estimator, at=at):
            rows = at[(at.policy == policy) & (at.estimator == estimator)]
            return np.array([one.score.to_numpy(float) for _, one in rows.groupby("run")])

        low, high = (scores("autopilot", name)[0] for name in ("dead-reckoning", "truth"))
        own, scale = scores(policy, estimator), high.mean() - low.mean()
        share = (own.mean() - low.mean()) / scale
        each.append(share + (own - low - share * (high - low)) / scale)
    return np.mean(each, axis=0)


@pytest.mark.parametrize(
    ("policy", "estimator"), [("autopilot", "ekf"), ("PPO trained on ekf", "enkf"), (PPO, "ekf")]
)
def test_score_is_mean_over_environments_and_conditions(found, policy, estimator):
    each = [by_hand(found, e, policy, estimator) for e in (CORVETTE, SEGOROGENI)]
    together = ranking.normalised(found, found.scales, policy, estimator)
    np.testing.assert_allclose(together, np.mean(each, axis=0), rtol=0, atol=1e-12)
    runs = 1 if policy == "autopilot" else 3
    assert together.shape == (runs, 8)


def test_policies_have_one_name_and_a_home_in_each_environment(found):
    assert found.learned == [PPO, "PPO trained on ekf", "PPO, raw", "PPO, LSTM"]
    assert [found.home(e, PPO) for e in (CORVETTE, SEGOROGENI)] == ["kf-umv-ui", "enkf"]
    assert found.home(CORVETTE, "PPO trained on ekf") == "ekf"
    assert found.home(CORVETTE, "PPO, raw") == RAW
    assert found.home(CORVETTE, "autopilot") == "kf-umv-ui"


def test_missing_or_flat_scale_leaves_condition_out(found):
    partial = without(found, lambda f: (f.estimator, f.condition) == ("truth", "calm"))
    assert [*partial.scales.index] == [each for each in found.scales.index if each[1] != "calm"]
    kept = ranking.normalised(partial, here(partial), "autopilot", "ekf").to_numpy()
    rest = found.normalised.xs((CORVETTE, "autopilot", "ekf"), level=[0, 2, 3])
    rest = rest[rest.index.get_level_values("condition") != "calm"]
    np.testing.assert_allclose(kept[0], rest.mean(), atol=1e-12)
    flat = results(study((CORVETTE,)), QUALITY | {"truth": -1.0})
    assert ranking.rankings(flat) == {}


def test_incomplete_run_is_left_out_and_others_stay_paired(found):
    def lost(f):
        return (f.environment, f.condition, f.policy, f.run) == (CORVETTE, "rough", PPO, 2)

    partial = without(found, lost)
    whole = ranking.normalised(found, found.scales, PPO, "enkf").mean(axis=1)
    left = ranking.normalised(partial, found.scales, PPO, "enkf").mean(axis=1)
    np.testing.assert_allclose(left, whole.drop(2), atol=1e-12)
    gone = without(found, lambda f: f.condition == "rough" and f.policy == PPO)
    assert ranking.normalised(gone, here(gone), PPO, "ekf").empty
    assert np.isnan(ranking.policy_score(gone, CORVETTE, PPO, "ekf").mean)


def test_intervals_are_over_seeds_or_over_runs_and_seeds(found):
    values = ranking.normalised(found, here(found), "autopilot", "ekf").to_numpy()
    assert ranking.policy_score(found, CORVETTE, "autopilot", "ekf") == mean_interval(values[0])
    own = ranking.rankings(found)[CORVETTE]
    assert own.score("ekf") == mean_interval(values[0], len(own.scores))
    runs = ranking.normalised(found, here(found), PPO, "kf-umv-ui").to_numpy()
    assert ranking.policy_score(found, CORVETTE, PPO, "kf-umv-ui") == crossed_interval(runs)
    assert text(ranking.interval(found, PPO, runs[:1])) == text(float(runs[0].mean()))


def test_completed_and_worst_tenth_are_over_all_conditions(found):
    table = found.table.copy()
    first = (table.estimator == "kf") & (table.condition == "nominal") & (table.seed == 10**9)
    table.loc[first, ["score", "completed"]] = 0.0, False
    lost = replace(found, table=table)
    shown = summary(ranking.rankings(lost)[CORVETTE]).loc["kf"]
    assert shown["completed [%]"].startswith(f"{100.0 * 23 / 24:.1f} [")
    own = table[(table.estimator == "kf") & (table.policy == "autopilot")]
    worst = np.sort(own.score.to_numpy(float))[:3].mean()  # of 8 seeds in 3 conditions
    assert shown["worst tenth"] == text(worst, 3)


def test_the_episodes_of_a_run_are_those_of_its_jobs(tmp_path):
    planned = plan(study((ITSUNUSA,), conditions=CONDITIONS[:1], episodes=2))
    outcome = run(planned.jobs, tmp_path)
    found = Results.of(planned, outcome)
    assert not found.missing
    flight = next(f for f in planned.flights if f.estimator == "ekf")
    rows = found.table[found.table.estimator == "ekf"]
    figures = outcome.values[flight.job.key]
    assert {m.key for m in METRICS} <= set(rows)
    assert rows.score.tolist() == figures["score"]
    assert rows.nees_in_band.between(0.0, 1.0).all()
    success = system_of(ITSUNUSA).task.success
    assert rows.completed.tolist() == [end == success for end in figures["end"]]
