"""Tables of docs/: their places, their commands, and what the sentences and cells are made of."""

from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents.refusal import Refusal
from studies import comparisons, filters, results, tables
from studies.markdown import around, put
from studies.tables import BLOCKS


def stored(name: str) -> str:
    page, mark, _ = BLOCKS[name]
    before, after = around(page, mark)
    return page.read_text(encoding="utf-8")[len(before) : -len(after)].strip()


def cells(text: str) -> list[list[str]]:
    """The cells of a table's rows, the heading first."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [line[1:-1].strip().split(" | ") for line in (lines[0], *lines[2:])]


@pytest.mark.parametrize("name", BLOCKS)
def test_a_block_has_its_place_and_tables_are_whole(name: str):
    assert len(stored(name)) > 50
    if BLOCKS[name][1].startswith("table"):
        assert len({line.count("|") for line in stored(name).splitlines()}) == 1


COMPUTED = [
    name for name, (*_, made) in BLOCKS.items() if made.args[0] in ("comparisons", "filters")
]


@pytest.mark.nightly
@pytest.mark.parametrize("name", COMPUTED)
def test_a_command_writes_the_headings_and_labels_of_its_page(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(comparisons, "EPISODES", 2)
    for constant, few in {"RUNS": 20, "STEPS": 30}.items():
        monkeypatch.setattr(filters, constant, few)
    monkeypatch.setattr(
        filters, "analysis_rmse", lambda row, *_: row.published * np.array([0.9, 1.1])
    )
    made = BLOCKS[name][2]()
    found, page = (
        cells(made),
        cells(stored(name).replace("reached the end, of 100", "reached the end, of 2")),
    )
    assert found[0] == page[0]
    assert [row[:1] for row in found] == [row[:1] for row in page]
    assert {len(row) for row in found} == {len(row) for row in page}


def test_a_cell_is_a_mean_or_a_difference_of_two_arms(
    monkeypatch: pytest.MonkeyPatch,
):
    values = {"a": np.array([1.0, 3.0]), "b": np.array([2.0, 8.0])}
    monkeypatch.setattr(comparisons, "arm_metrics", lambda arm: {"score": values[arm]})
    plain = partial(comparisons.cell, arm="a", decimals=1, plain=True)
    found = plain(), plain(below="b"), plain(below="a"), plain(over="b")
    assert found == ("2.0", "3.0", "–", "0.4")
    assert comparisons.cell(arm="a", over="b").startswith("0.438 ± ")


def test_a_text_goes_between_its_own_marks(tmp_path: Path):
    page = tmp_path / "page.md"
    text = "a\n<!-- table: one -->\n{}\n<!-- end -->\nb\n<!-- table: two -->\nkept\n<!-- end -->\n"
    page.write_text(text.format("old"))
    put(page, "table: one", "new\n")
    assert page.read_text() == text.format("\nnew\n")
    for lacking in ("table: three", "table: "):
        with pytest.raises(Refusal, match="needs one line"):
            put(page, lacking, "new")
    with pytest.raises(Refusal, match="known are headline"):
        tables.main(("nobody",))


@pytest.mark.nightly
def test_a_constant_of_the_score_is_changed_alone(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(comparisons, "EPISODES", 2)
    usual = comparisons.arm_metrics("ekf", "SigmaCorvette-v0")["score"]
    same, yaw, course, dear = (
        results.variation("", scaled=scaled).scores["ekf"]
        for scaled in (
            {},
            {"COURSE_SHARE": 0.0},
            {"COURSE_SHARE": 1.0 / 0.6},
            {"RUDDER_PRICE": 9.0},
        )
    )
    np.testing.assert_array_equal(same, usual)
    np.testing.assert_allclose(0.4 * yaw + 0.6 * course, usual, rtol=1e-12)
    assert (dear < usual).all()


def test_worlds_in_which_a_sign_changes_are_named(
    monkeypatch: pytest.MonkeyPatch,
):
    means = {"kf-umv-ui": 0.55, "ekf-waves": 0.6, "ekf": 0.5, "huber-kf": 0.52,
             "measurement": 0.3}  # fmt: skip
    noise = np.random.default_rng(0).normal(0.0, 0.1, 100)

    def variation(condition: str, factor: float) -> results.Column:
        scores = {name: factor * mean + noise for name, mean in means.items()}
        return results.Column("", condition, scores)

    found = {str(factor): {"factor": factor} for factor in (1.0, 0.5, 2.0, -1.0, 0.0)}
    monkeypatch.setattr(results, "SETTINGS", {"overturn": found})
    monkeypatch.setattr(results, "variation", variation)
    _, first, *others = cells(results.overturn())
    assert first[0] == "best filter − `measurement`"
    usual = [row[1].split(" ± ")[0] for row in (first, *others)]
    assert usual == ["0.300", "0.050", "0.050", "0.020"]
    assert [row[2:] for row in others] == [["2 of 4", "-1.0", "0.0"]] * 3


# --- studies --------------------------------------------------------------------------------------

LOST = {"truth": 0.0, "dead-reckoning": 0.6, "ekf": 0.1, "enkf": 0.15, "huber-kf": 0.2,
        "measurement": 0.3}  # fmt: skip
"""Score lost on each estimator in the last suite; in the others a tenth of it."""
CORVETTE = "SigmaCorvette-v0"


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A study of the corvette in three suites, its episodes out of order."""
    keys = ["environment", "condition", "policy", "estimator", "seed"]
    places = [f"rough, {suite}" for suite in results.SUITE]
    frame = pd.DataFrame(product([CORVETTE], places, ["autopilot"], LOST, (1, 0, 2)), columns=keys)
    loss = frame.estimator.map(LOST) * np.where(frame.condition == places[2], 1.0, 0.1)
    own = 0.001 * (frame.seed == 2) * (frame.estimator == "ekf")
    frame["score"] = 0.8 - loss + 0.1 * frame.seed + own
    frame["steering_travel"] = 100.0 * loss + frame.seed
    folder = tmp_path / "results" / "mine"
    folder.mkdir(parents=True)
    frame.assign(run=0).to_parquet(folder / "results.parquet")
    monkeypatch.setattr(results, "ROOT", tmp_path)
    results.read_study.cache_clear()
    return "mine"


def test_a_study_of_suites_says_where_estimators_differ(study: str):
    rows = {row[0]: row[1:] for row in cells(results.by_suite(study, CORVETTE, "rough"))[1:]}
    assert [*rows][-1] == "`dead-reckoning`"
    # Student's, two degrees of freedom, of 18 intervals at once: 18.93 x 0.1 / sqrt(3)
    assert rows["`truth`"][0] == "0.900 ± 1.093; 1"
    assert rows["`ekf`"][2].endswith("; 11")
    with pytest.raises(Refusal, match="PPO flew nothing in SigmaCorvette-v0"):
        results.by_suite(study, CORVETTE, "rough", "PPO")
    assert [cell.split(" ± ")[0] for cell in cells(results.differences(study))[-1]] == [
        "SigmaCorvette-v0, rough, denied", "`ekf`", "**0.200", "–", "**0.100",
    ]  # fmt: skip
