"""The answer to a study: a sentence that says what the numbers say, whatever there is of them."""

import re
from dataclasses import replace
from math import comb

import gymnasium as gym
import numpy as np
import pytest
from invented import (
    CLASSICAL,
    CONDITIONS,
    CORVETTE,
    ENDS,
    QUALITY,
    SEGOROGENI,
    results,
    study,
    without,
)

from agents.statistics import crossed_interval
from agents.studies.answer import answer
from agents.studies.ranking import Ranking, rankings
from agents.studies.records import DEFAULT, Agent, Estimator, Tuning
from agents.studies.report import write_report
from agents.studies.tables import (
    choices_table,
    code,
    conditions_table,
    markdown,
    ranking_table,
    summary,
)


@pytest.fixture(scope="module")
def classical():
    return results(study())


@pytest.fixture(scope="module")
def small():
    return results(study((CORVETTE,)))


def advice(found):
    """The sentences on the estimator to use."""
    (text,) = (line for line in answer(found) if line.startswith("Use "))
    return text


@pytest.mark.parametrize("best", ["kf", "ekf", "kf-umv-ui"])
def test_the_advice_is_the_estimator_with_the_highest_score(small, best):
    told = advice(results(small.plan, QUALITY | {best: 0.99}))
    assert told.startswith(
        f"Use {best} in {CORVETTE}: with it the autopilot reaches 99 % of the way "
    )
    worse = re.search(r" Clearly worse: (.*)\.$", told)
    assert worse is not None
    assert all(name in worse[1] for name in {"kf", "ekf", "kf-umv-ui", "enkf"} - {best})


def test_estimators_that_differ_by_chance_are_not_called_worse(small):
    level = dict.fromkeys(QUALITY, 0.9) | {"truth": 1.0, "dead-reckoning": 0.0}
    told = advice(results(small.plan, level))
    assert "worse" not in told
    assert re.search(r"(Equivalent|Undecided): \S+ ", told)


def test_undecided_estimators_say_how_many_episodes_decide(small):
    level = QUALITY | {"ekf": 0.94}
    told = advice(results(study((CORVETTE,), episodes=20), level, noise=0.06))
    more = re.search(r"Undecided: ekf \(at most about (\d+) more episodes needed\)", told)
    longer = results(study((CORVETTE,), episodes=20 + 3 * int(more[1])), level, noise=0.06)
    assert rankings(longer)[CORVETTE].verdicts["ekf"] != "undecided"


def test_below_the_best_but_not_by_the_margin_is_slightly_worse(small):
    told = advice(results(small.plan, QUALITY | {"ekf": 0.945}, noise=1e-3))
    assert " Slightly worse: ekf. Clearly worse: " in told


@pytest.mark.parametrize(("episodes", "noise"), [(1, 0.1), (2, 0.1), (4, 0.5), (20, 0.5)])
def test_few_episodes_give_no_advice(episodes, noise):
    def said(number):
        short = study((CORVETTE,), conditions=CONDITIONS[:1], episodes=number)
        return next(t for t in answer(results(short, noise=noise)) if f" {CORVETTE}" in t)

    few = said(episodes)
    assert few.startswith(f"{episodes} episodes cannot tell which estimator to use in {CORVETTE}")
    assert said(1000).startswith("Use ")


def test_an_estimator_that_beats_the_truth_is_warned_of(small):
    told = answer(results(small.plan, QUALITY | {"ekf": 1.3}))
    (warning,) = (line for line in told if "check the task's score" in line)
    assert warning.startswith(f"On ekf in {CORVETTE} (1.30")
    assert not any("check the task" in line for line in answer(small))


def test_only_estimators_of_all_environments_count(classical):
    assert advice(classical).startswith(f"Use enkf in {CORVETTE} and {SEGOROGENI}: with it")
    table = ranking_table(classical)
    assert table.loc["kf-umv-ui"].tolist()[::2] == ["–", "–"]
    assert table.loc["kf-umv-ui", CORVETTE].endswith(", best")
    common = ("truth", "dead-reckoning", "enkf")
    alone = without(classical, lambda f: f.environment == SEGOROGENI and f.estimator not in common)
    told = answer(alone)
    assert any(line.startswith(f"Use kf-umv-ui in {CORVETTE}") for line in told)
    (single,) = (line for line in told if line.startswith(f"Use enkf in {SEGOROGENI}"))
    assert single.endswith("No other estimator was compared.")
    assert list(ranking_table(alone)) == [CORVETTE, SEGOROGENI]
    assert told[-1] == "4 of 40 results are missing. Run the study again."


def test_answer_says_what_a_ranking_takes(small):
    flat = results(small.plan, QUALITY | {"truth": -1.0})
    assert any(
        line.startswith(f"No estimator can be ranked in {CORVETTE}: for that the autopilot needs")
        for line in answer(flat)
    )
    scores = conditions_table(flat, CORVETTE)
    assert scores.loc["truth", "nominal"].startswith("−0.7")


def test_an_environment_without_the_agent_of_the_scale_is_named(tmp_path):
    ours = Agent("lqg", "lqg", environments=(CORVETTE,))
    found = results(study(agents=(ours, CLASSICAL), conditions=CONDITIONS[:1]))
    told = answer(found)
    assert advice(found).startswith(f"Use kf-umv-ui in {CORVETTE}: with it lqg reaches")
    assert any(
        line.startswith(f"No estimator can be ranked in {SEGOROGENI}: for that lqg needs")
        for line in told
    )
    assert conditions_table(found, SEGOROGENI).empty
    assert write_report(found, tmp_path, {}).exists()


def test_a_study_without_results_or_with_failures_says_so(small):
    first, missing = answer(without(small, lambda f: True, "Traceback\nOSError: no"))
    assert first == "Nothing has a result yet."
    assert missing == (
        f"24 of 24 results are missing; 24 failed, the first: autopilot on truth in {CORVETTE},"
        " nominal. Run the study again."
    )
    broken = without(small, lambda f: (f.estimator, f.condition) == ("ekf", "rough"), "x: y")
    assert answer(broken)[-1].startswith("1 of 24 results are missing; 1 failed, the first: ")
    assert "ekf" not in ranking_table(broken).index
    assert conditions_table(broken, CORVETTE).loc["ekf", "rough"] == "–"


def test_a_controller_of_ones_own_is_named():
    mine = Agent("mine", "agents.controllers.dive:DiveAutopilot")
    found = results(study((SEGOROGENI,), (mine,), conditions=CONDITIONS[:1]))
    assert "with it mine reaches" in advice(found)


# --- tables ---------------------------------------------------------------------------------------


def test_tables_stand_in_the_order_of_the_file_and_say_the_same(small):
    table = conditions_table(small, CORVETTE)
    assert list(table) == [c.name for c in CONDITIONS]
    assert list(table.index) == ["truth", "dead-reckoning", "kf-umv-ui", "kf", "ekf", "enkf"]
    page = markdown(small)
    assert page.startswith(f"# Which one?\n\n{answer(small)[0]}")
    for name, cells in table.iterrows():
        assert f"| {name} | {' | '.join(cells)} |" in page
    best = summary(rankings(small)[CORVETTE])
    assert next(iter(best.index)) == "kf-umv-ui"
    for name, row in best.iterrows():
        assert ranking_table(small).loc[name, CORVETTE].startswith(row["normalised score"] + ", ")


def test_code_makes_environment_with_best_estimator(classical):
    lines = code(classical)
    assert len(lines) == 2
    for line, environment, name in zip(
        lines, (CORVETTE, SEGOROGENI), ("kf-umv-ui", "enkf"), strict=True
    ):
        env = eval(line, {"gym": gym})
        assert (env.spec.id, env.spec.kwargs["estimator"]) == (environment, name)
        env.close()


def test_code_names_estimator_behind_default():
    asked = replace(
        study(conditions=CONDITIONS[:1]), estimators=(*ENDS, Estimator("mine", DEFAULT))
    )
    assert code(results(asked, QUALITY | {"mine": 0.9})) == [
        f'gym.make("{CORVETTE}", estimator="kf-umv-ui")',
        f'gym.make("{SEGOROGENI}", estimator="enkf")',
    ]


def test_choice_under_each_condition_is_its_best_and_its_equals(small):
    changed = {"ekf_in_rough": 0.99, "enkf_in_calm": 0.95}
    table = choices_table(results(small.plan, noise=1e-3, **changed))[CORVETTE]
    assert list(table.index) == [c.name for c in CONDITIONS]
    assert table["rough"].startswith("ekf 0.99")
    assert re.match(r"(kf-umv-ui|enkf) 0.95\d* ± \S+ \((enkf|kf-umv-ui)\)$", table["calm"])
    assert re.match(r"kf-umv-ui 0.95\d* ± \S+$", table["nominal"])


# --- verdicts -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("times", "decided"), [(0.99, False), (1.01, True)])
def test_differences_of_a_ranking_hold_for_all_pairs_at_once(small, monkeypatch, times, decided):
    ranking = rankings(small)[CORVETTE]
    values = np.random.default_rng(40).normal(size=(1, 20))
    half = crossed_interval(values, comb(len(ranking.scores), 2)).half
    values += times * half - values.mean()
    monkeypatch.setattr(Ranking, "differences", lambda *_: values)
    assert ranking.gap("ekf", "kf").excludes_zero == decided
    assert (ranking.verdict("ekf", "kf") != "undecided") == decided


def test_a_failed_tuning_leaves_the_others_compared():
    planned = replace(study((CORVETTE,)), tune=Tuning(tunings=3))
    whole = results(planned, noise=1e-3)
    lost = "autopilot, tuned", "ekf", 2
    some = without(whole, lambda f: (f.policy, f.estimator, f.run) == lost, "an error")
    means = []
    for found in (whole, some):
        ranking = Ranking(found, found.scales)
        gap = ranking.gap("ekf", "kf")
        assert gap.excludes_zero
        assert ranking.verdict("ekf", "kf") == "clearly better"
        means.append(gap.mean)
    assert means[0] != means[1]
    assert answer(some)
