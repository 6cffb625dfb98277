import csv
import re
from dataclasses import replace

import numpy as np
import pytest

from agents import rollout
from agents.ablation import AGENTS, PPO, Cell, Results, Study, prepare, run, train_agents
from agents.ppo import describe, description
from agents.report import answer, claims, render, tables, write_report
from agents.statistics import paired_difference
from agents.turning_scores import METRICS

STUDY = Study(episodes=4, training_seeds=1, steps=128 * 64 * 2, jobs=1)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return tmp_path_factory.mktemp("ablation") / "new" / "folder"


@pytest.fixture(scope="module")
def results(out) -> Results:
    found = run(STUDY, out)
    write_report(found, out)
    return found


def _scored(results: Results, **scores: float) -> Results:
    """The same results, had every agent scored this on these estimators (dashes as underscores), give or take."""
    spread = np.array([-0.01, 0.0, 0.0, 0.01])
    figures = {}
    for cell, runs in results.figures.items():
        score = scores.get(cell.estimator.replace("-", "_"), 0.1)
        figures[cell] = [figure | {"score": score + 0.1 * score * spread} for figure in runs]
    return replace(results, figures=figures)


def _verdicts(results: Results) -> dict[str, str]:
    return {claim.text: claim.verdict for claim in claims(results)}


# --- what is written --------------------------------------------------------------------------------


def test_a_study_leaves_checkpoints_episodes_and_a_report_and_nothing_else(results, out):
    assert sorted(path.relative_to(out).as_posix() for path in out.rglob("*")) == [
        "checkpoints", "checkpoints/ppo-0.zip", "episodes.csv", "report.html",
    ]  # fmt: skip


def test_the_table_of_episodes_has_a_row_for_every_episode(results, out):
    with (out / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(STUDY.seas) * len(AGENTS) * len(STUDY.estimators) * STUDY.episodes
    assert set(rows[0]) == {"sea", "agent", "training_seed", "estimator", "seed", *(m.key for m in METRICS)}
    for row in rows:
        assert (row["training_seed"] == "0") == (row["agent"] == PPO)
        assert (row["nees"] == "") == (row["estimator"] in ("truth", "measurement"))
        assert "nan" not in row.values()
    wanted = [r for r in rows if (r["sea"], r["agent"], r["estimator"]) == ("rough", "autopilot", "kf")]
    values = results.values(Cell("rough", "autopilot", "kf"), "score")
    np.testing.assert_allclose([float(row["score"]) for row in wanted], values, rtol=1e-5)
    assert [int(row["seed"]) for row in wanted] == STUDY.seeds


def test_the_report_needs_nothing_outside_itself(results, out):
    page = (out / "report.html").read_text()
    assert "http:" not in page
    assert "https:" not in page
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert len(sources) == 4
    assert all(source.startswith("data:image/svg+xml;base64,") for source in sources)
    assert "<script" not in page
    assert "<link" not in page


def test_the_report_says_dash_where_there_is_no_number(results, out):
    text = re.sub(r'src="[^"]*"', "", (out / "report.html").read_text())
    assert not re.search(r"\b(nan|NaN|None|inf)\b", text)
    (estimation,) = (table for table in tables(results) if table.title.startswith("How well"))
    truth = dict(estimation.sections[0][1])["truth"]
    assert [entry.value for entry in truth[-2:]] == ["–", "–"]


def test_the_report_holds_what_is_needed_to_run_it_again(results, out):
    text = render(results, out)
    for word in (str(STUDY.steps), "learning rate", describe(STUDY.env_id, {}, 0, None)["source"], "0 to 3"):
        assert word in text


# --- what is computed -------------------------------------------------------------------------------


def test_differences_are_paired_by_seed(results):
    kf, truth = Cell("rough", PPO, "kf"), Cell("rough", PPO, "truth")
    expected = paired_difference(results.figures[kf][0]["score"], results.figures[truth][0]["score"])
    assert results.difference(kf, truth, "score") == expected


def test_the_value_of_ppo_is_the_mean_over_its_training_runs(results):
    cell = Cell("rough", PPO, "kf")
    once = results.figures[cell][0]
    twice = replace(results, figures=results.figures | {cell: [once, once | {"score": once["score"] + 0.2}]})
    np.testing.assert_allclose(twice.values(cell, "score"), once["score"] + 0.1)
    np.testing.assert_allclose(twice.values(cell, "score", run=1), once["score"] + 0.2)


def test_the_answer_follows_the_data(results):
    assert answer(_scored(results, truth=0.9, kf_umv_ui=0.8, kf=0.5))[0].startswith("Fly kf-umv-ui:")
    assert answer(_scored(results, truth=0.9, kf_umv_ui=0.5, kf=0.8))[0].startswith("Fly kf:")


def test_the_answer_names_estimators_that_are_level(results):
    level = answer(_scored(results, truth=0.9, kf_umv_ui=0.8, measurement=0.8))
    assert level[1].startswith("Within chance of kf-umv-ui: measurement for the autopilot in moderate seas")


def test_the_answer_says_where_its_choice_is_beaten(results):
    mixed = _scored(results, truth=0.9, kf_umv_ui=0.8, kf=0.5)
    cell = Cell("rough", PPO, "kf")
    better = [figure | {"score": figure["score"] + 0.4} for figure in mixed.figures[cell]]
    mixed = replace(mixed, figures=mixed.figures | {cell: better})
    advice = answer(mixed)[0]
    assert advice.startswith("Fly kf-umv-ui, which has the highest mean score in 3 of 4 cases")
    assert "but is beaten by kf for PPO in rough seas (by 0.1" in advice


@pytest.mark.parametrize(("kf", "verdict"), [(0.5, "true"), (0.79, "true"), (0.8, "undecided"), (0.85, "false")])
def test_a_ranking_is_true_undecided_or_false_as_the_data_say(results, kf, verdict):
    found = _verdicts(_scored(results, truth=0.9, kf_umv_ui=0.8, kf=kf, dead_reckoning=0.1))
    assert found["In rough seas PPO scores higher on kf-umv-ui than on kf."] == verdict
    assert found["In rough seas PPO scores higher on kf than on dead-reckoning."] == "true"


@pytest.mark.parametrize(("truth", "verdict"), [(0.9, "true"), (0.8, "true"), (0.7, "false")])
def test_an_estimator_above_truth_is_told(results, truth, verdict):
    found = _verdicts(_scored(results, truth=truth, kf_umv_ui=0.8))
    assert found["In moderate seas the autopilot does not score higher on kf-umv-ui than on the truth."] == verdict


@pytest.mark.parametrize(("gain", "verdict"), [(0.01, "true"), (-0.019, "true"), (-0.03, "false")])
def test_ppo_is_the_autopilots_equal_within_the_margin(results, gain, verdict):
    level = _scored(results, truth=0.9, kf_umv_ui=0.8)
    cell = Cell("moderate", PPO, "kf-umv-ui")
    figures = [figure | {"score": figure["score"] + gain} for figure in level.figures[cell]]
    found = _verdicts(replace(level, figures=level.figures | {cell: figures}))
    (equal,) = (text for text in found if text.startswith("PPO of training seed 0"))
    assert found[equal] == verdict


def test_episodes_without_a_figure_are_counted_in_the_note(results):
    cell = Cell("rough", "autopilot", "dead-reckoning")
    figures = results.figures[cell][0]
    lost = figures | {"radius_error": np.where([True, False, False, False], np.nan, figures["radius_error"])}
    note = tables(replace(results, figures=results.figures | {cell: [lost]}))[0].note
    assert "radius error on dead-reckoning, rough sea, autopilot: 3" in note


# --- checkpoints ------------------------------------------------------------------------------------


def test_a_checkpoint_that_fits_is_used_again_and_another_is_not(results, out):
    folder, seen = out / "checkpoints", []

    def train(study: Study) -> int:
        (path,) = train_agents(study, folder, results.system, lambda *progress: seen.append(progress))
        return path.stat().st_mtime_ns

    before = (folder / "ppo-0.zip").stat().st_mtime_ns
    assert train(STUDY) == before
    assert seen == [("PPO 0", STUDY.steps, STUDY.steps, None)]
    assert train(replace(STUDY, steps=128 * 64)) > before
    assert description(folder / "ppo-0.zip")["steps"] == 128 * 64


def test_training_runs_in_parallel_are_those_trained_alone(results, tmp_path):
    study, seen = replace(STUDY, training_seeds=2, jobs=2), []
    first, second = train_agents(study, tmp_path, results.system, lambda *progress: seen.append(progress))
    (alone,) = train_agents(STUDY, tmp_path / "alone", results.system, lambda *progress: None)
    assert description(first)["seed"] == 0
    assert description(second)["seed"] == 1
    assert {what for what, *_ in seen} == {"PPO 0", "PPO 1"}
    assert seen[-1][1:3] == (STUDY.steps, STUDY.steps)
    flights = [rollout(str(path), STUDY.env_id, [0]).history["truth"] for path in (alone, first)]
    np.testing.assert_array_equal(*flights)


def test_a_checkpoint_says_how_it_was_trained(results):
    (trained,) = results.trained
    options = {"estimator": "kf-umv-ui", "disturbance": "moderate"}
    assert trained.items() >= describe(STUDY.env_id, options, 0, STUDY.steps).items()
    assert trained["trained_steps"] == STUDY.steps
    assert trained["trained_seconds"] > 0.0


def test_what_is_no_checkpoint_has_no_description(tmp_path):
    (tmp_path / "text.zip").write_text("no zip")
    assert description(tmp_path / "text.zip") is None
    assert description(tmp_path / "missing.zip") is None


# --- what cannot be run -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"episodes": 1}, "episodes must be at least 2"),
        ({"training_seeds": 0}, "training_seeds must be at least 1"),
        ({"jobs": 0}, "jobs must be at least 1"),
        ({"estimators": ("kf-umv-ui", "kf")}, "must include truth"),
        ({"seas": ("rough",)}, "must include moderate"),
        ({"env_id": "Nonsense-v0"}, "Nonsense"),
        ({"env_id": "CartPole-v1"}, "CartPole-v1"),
        ({"steps": 5}, "at least the 128 environments"),
        ({"seas": ("moderate", "stormy")}, "unknown sea 'stormy': choose from calm, moderate, rough"),
        ({"estimators": ("truth", "kf-umv-ui", "kalman")}, "unknown estimator 'kalman'"),
        ({"episodes": 2_000_000}, "evaluation seeds lie in"),
    ],
)
def test_a_study_that_cannot_be_run_is_refused_before_anything_is_written(tmp_path, change, words):
    with pytest.raises(ValueError, match=words):
        prepare(replace(STUDY, **change), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_output_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(NotADirectoryError, match="is a file, not a folder"):
            prepare(STUDY, out)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("name", ["report.html", "episodes.csv"])
def test_a_folder_in_the_place_of_a_result_is_refused(tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(IsADirectoryError, match=name):
        prepare(STUDY, tmp_path)


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, monkeypatch):
    def refuse(**kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("agents.ablation.tempfile.TemporaryFile", refuse)
    with pytest.raises(PermissionError, match=r"cannot write to .*: Permission denied"):
        prepare(STUDY, tmp_path)
