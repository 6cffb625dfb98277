"""The report of a study: what is computed is on the page, and nothing is left out in silence."""

import re
from dataclasses import replace
from html import unescape
from itertools import combinations

import invented
import numpy as np
import pandas as pd
import pytest
from invented import CONDITIONS, CORVETTE, ENDS, QUALITY, SEGOROGENI, results, study, without
from matplotlib.text import Text

from agents.metrics import NEES, SCORE, metrics
from agents.page import text
from agents.plotting import learning_figure, styled
from agents.statistics import crossed_interval
from agents.studies.answer import answer
from agents.studies.figures import conditions_figure
from agents.studies.records import Condition, Estimator, Tuning
from agents.studies.report import consistency, costs, write_report
from agents.studies.tables import conditions_table, effects_table, markdown, ranking_table
from agents.studies.worlds import system_of

TUNED = "autopilot, tuned"


@pytest.fixture(scope="module")
def small():
    return results(study((CORVETTE,), conditions=CONDITIONS[::2]))


def written(found, folder):
    return unescape(write_report(found, folder, {}).read_text(encoding="utf-8"))


def test_page_markdown_and_table_are_written_and_agree(small, tmp_path):
    html = written(small, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        "report.html",
        "ranking.md",
        "results.parquet",
        "tables",
    }
    assert (tmp_path / "ranking.md").read_text(encoding="utf-8") == markdown(small)
    assert len(pd.read_parquet(tmp_path / "results.parquet")) == 8 * len(small.plan.flights)
    for frame in (effects_table(small), conditions_table(small, CORVETTE), ranking_table(small)):
        for cell in frame.to_numpy().ravel():
            assert f"<td>{cell}</td>" in html
    for sentence in answer(small):
        assert sentence in html
    assert re.search(r"<td>−0\.4\d+ ± \S+, clearly worse</td>", html)  # of kf, behind the best
    assert html.count("data:image/svg") == 1
    assert not re.search(r'(?:src|href)="(?!data:)', html)
    assert html == written(small, tmp_path)


def test_failures_and_refusals_are_on_page_and_escaped(small, tmp_path):
    label = f"autopilot on ekf in {CORVETTE}, rough"
    why = f"{label}: Traceback (most recent call last):\n  File x\nFloatingPointError: it <burst>"
    broken = without(small, lambda f: (f.estimator, f.condition) == ("ekf", "rough"), why)
    page = write_report(broken, tmp_path, {}).read_text(encoding="utf-8")
    assert f"{label} failed: FloatingPointError: it &lt;burst&gt;" in page
    assert "File x" not in page
    nothing = written(without(small, lambda f: True), tmp_path)
    assert "Nothing has a result yet." in nothing
    both = results(study(conditions=CONDITIONS[:1]))
    html = written(both, tmp_path)
    assert both.plan.skipped
    for skipped in both.plan.skipped:
        assert skipped.reason in html
        assert f"{skipped.what} in {skipped.environment}" in html


def test_costs_are_beyond_those_on_the_truth_at_the_same_seeds(small):
    chosen = [SCORE, *(m for m in metrics(system_of(CORVETTE)) if m.cost)]
    table = costs(small, CORVETTE, chosen)
    assert table.shape == (len(small.estimators()), len(chosen))
    for metric, head in zip(chosen, table, strict=True):
        ours, truth = (
            small.wide(metric.key).loc[[(CORVETTE, "nominal", "autopilot", name, 0)]].to_numpy()
            for name in ("kf", "truth")
        )
        assert table.loc["kf", head] == text(crossed_interval(ours - truth), metric.decimals, True)
        assert table.loc["truth", head].startswith(text(float(truth.mean()), metric.decimals))


def test_costs_of_tuned_arms_pair_the_tunings_that_both_have():
    asked = replace(study((CORVETTE,), conditions=CONDITIONS[:1]), tune=Tuning(tunings=3))
    found = results(asked)
    cut = without(found, lambda f: (f.policy, f.estimator, f.run) == (TUNED, "ekf", 1))
    wide = cut.wide(SCORE.key)
    ours, truth = (
        wide.loc[[(CORVETTE, "nominal", TUNED, name, run) for run in (0, 2)]].to_numpy()
        for name in ("ekf", "truth")
    )
    table = costs(cut, CORVETTE, [SCORE])
    expected = text(crossed_interval(ours - truth), SCORE.decimals, True)
    assert table.loc["ekf", SCORE.title] == expected
    assert costs(without(found, lambda f: f.estimator == "truth"), CORVETTE, [SCORE]).empty


def test_arms_tuned_by_likelihood_are_beside_the_delivered_truth():
    tuning = Tuning(tunings=2, by="likelihood")
    asked = replace(study((CORVETTE,), conditions=CONDITIONS[:1]), tune=tuning)
    found = results(asked)
    scores = ranking_table(found)
    assert "ekf" in scores.index
    assert costs(found, CORVETTE, [SCORE]).loc["truth", SCORE.title] != "–"
    assert not any("No estimator can be ranked" in sentence for sentence in answer(found))


def test_arms_without_a_common_tuning_are_undecided_by_a_number():
    asked = replace(study((CORVETTE,), conditions=CONDITIONS[:1]), tune=Tuning(tunings=2))
    lost = (TUNED, "kf-umv-ui", 0), (TUNED, "enkf", 1)
    apart = without(results(asked), lambda f: (f.policy, f.estimator, f.run) in lost)
    sentences = " ".join(answer(apart))
    assert "Undecided: enkf" in sentences
    assert "nan" not in sentences


def test_consistency_is_of_first_condition_and_filters_alone(small):
    table = consistency(small, CORVETTE)
    assert table.loc["truth", NEES.label] == table.loc["truth", "In band"] == "–"
    assert table.loc["kf", "In band"] == "0.90"


def test_names_are_shown_as_they_are_written(tmp_path):
    odd = ("_first", "$_^$", 'a|b <i>, "c"')
    estimators = (*ENDS, *(Estimator(name, "kf") for name in odd))
    asked = replace(study((CORVETTE,), conditions=[Condition("$1_$")]), estimators=estimators)
    found = results(asked, QUALITY | dict.fromkeys(odd, 0.5))
    html = written(found, tmp_path)
    text = {each.get_text() for each in conditions_figure(found).findobj(Text)}
    assert text.issuperset((*odd, "$1_$"))
    assert all(f"<td>{name}</td>" in html for name in odd)


@pytest.mark.nightly
def test_no_text_of_a_figure_is_cut_or_covers_another():
    names = [f"huber-kf-nonlinear, number {i}" for i in range(12)]
    conditions = [Condition(f"a condition with a long name, {'abc'[i]}") for i in range(3)]
    environments = (CORVETTE, "SigmaChannel-v0", SEGOROGENI, "ItsunusaAUV-v0", "PunaUAV-v0")
    estimators = (*ENDS, *(Estimator(name, "ekf") for name in names))
    asked = replace(study(environments, conditions=conditions), estimators=estimators)
    found = results(asked, QUALITY | dict.fromkeys(names, 0.5))
    with styled():
        figure = conditions_figure(found)
        figure.draw_without_rendering()
    known = {*names, *environments, *(each.name for each in conditions)}
    texts = [t for t in figure.findobj(Text) if t.get_text() in known and t.get_visible()]
    boxes = [each.get_window_extent() for each in texts if not each.get_rotation()]
    assert len(boxes) > 15
    for box in boxes:
        assert figure.bbox.x0 <= box.x0
        assert box.x1 <= figure.bbox.x1
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)


def test_learning_curves_are_mean_and_range_over_runs():
    runs = [[(100.0, 200.0), (1.0, 2.0)], [(100.0, 200.0, 300.0), (3.0, 6.0, 7.0)]]
    panel = learning_figure({"PPO": runs}, "return").axes[0]
    np.testing.assert_array_equal(panel.lines[0].get_xydata(), [[100.0, 2.0], [200.0, 4.0]])
    edges = panel.collections[0].get_paths()[0].vertices
    assert {tuple(at) for at in edges} >= {(100.0, 1.0), (100.0, 3.0), (200.0, 2.0), (200.0, 6.0)}


@pytest.mark.nightly
def test_learned_policies_have_a_table(small, tmp_path):
    html = written(invented.learned(), tmp_path)
    assert "Normalised scores of learned agents" in html
    assert "training runs (3)" in html
    (learned,) = re.findall("learned agents</h2>.*?</table>", html, re.S)
    assert all(f"<td>{policy}</td>" in learned for policy in invented.learned().learned)
    assert html.count("Learning curves in ") == 4  # heading and alternative text of two
    assert "Normalised scores of learned agents" not in written(small, tmp_path)
