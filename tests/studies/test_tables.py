"""Tables of docs/, written anew."""

from functools import partialmethod
from pathlib import Path

import numpy as np
import pytest

from scripts.console import Refusal
from studies.tables import __main__ as tables
from studies.tables import faults as fault_tables
from studies.tables import filters as filter_tables
from studies.tables.markdown import around, put


@pytest.mark.parametrize("name", tables.TABLES)
def test_a_table_has_its_place_and_as_many_columns_as_before(name: str):
    page, _ = tables.TABLES[name]
    before, after = around(page, f"table: {name}")
    inside = page.read_text(encoding="utf-8")[len(before) : -len(after)].strip().splitlines()
    assert len(inside) > 2
    assert all(line.startswith("|") and line.endswith("|") for line in inside)
    assert len({line.count("|") for line in inside}) == 1


@pytest.mark.parametrize("name", tables.TEXTS)
def test_sentences_with_numbers_have_their_place(name: str):
    page, _ = tables.TEXTS[name]
    before, after = around(page, f"text: {name}")
    assert len(page.read_text(encoding="utf-8")[len(before) : -len(after)].strip()) > 50


def test_the_sentences_of_a_study_are_made_of_what_it_stored(tmp_path: Path):
    (tmp_path / "answer.md").write_text("Take ekf.\nA step on ekf takes 3 µs.\nWorse: enkf.\n")
    assert tables.advice(tmp_path) == "Take ekf. Worse: enkf."
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "ranking.md").write_text("| Estimator | All |\n| --- | ---: |\n| ekf | 0.9 ± 0.1 |\n")
    lines = ["environment,condition,estimator,seed,score"]
    for world in ("PunaUAV-v0", "ItsunusaAUV-v0", "SegorogeniAUV-v0"):
        for condition in ("bad sensors", "model 10 % off", "model 20 % off"):
            for name, score in (("truth", 0.9), ("huber-kf", 0.75), ("ekf", 0.5)):
                lines += [f"{world},{condition},{name},{seed},{score + seed}" for seed in (1, 0)]
    (tmp_path / "episodes.csv").write_text("\n".join(lines))
    told = " ".join(tables.exceptions(tmp_path).split())
    assert "than `ekf` by 0.250 ± 0.000 in `PunaUAV-v0`" in told
    assert "loses 0.400 ± 0.000 and 0.400 ± 0.000 of the score on `ekf`" in told
    assert "(Means over 2 seeds;" in told
    (tmp_path / "confirmation.csv").write_text("\n".join(lines))
    assert "(Means over 2 fresh seeds;" in " ".join(tables.exceptions(tmp_path).split())


def test_a_text_goes_between_its_own_marks(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- table: one -->\nold\n<!-- end -->\nb\n<!-- table: two -->\nkept\n<!-- end -->\n")
    put(page, "table: one", "new\n")
    assert page.read_text() == (
        "a\n<!-- table: one -->\n\nnew\n\n<!-- end -->\nb\n<!-- table: two -->\nkept\n<!-- end -->\n"
    )
    for lacking in ("table: three", "table: "):
        with pytest.raises(Refusal, match="needs one line"):
            put(page, lacking, "new")


def test_the_tables_of_journeys_show_each_way_once(monkeypatch: pytest.MonkeyPatch):
    ways = {label: way for way in tables.JOURNEYS["ItsunusaAUV-v0"] if (label := way.label) in ("`truth`", "`ekf`")}
    monkeypatch.setattr(tables.Arm, "fly", partialmethod(tables.Arm.fly, episodes=2))
    monkeypatch.setattr(tables, "JOURNEYS", {"ItsunusaAUV-v0": tuple(ways.values())})
    tables.flown.cache_clear()
    lines = tables.journeys("ItsunusaAUV-v0").splitlines()
    tables.flown.cache_clear()
    assert [line.split(" | ")[0].strip("| ") for line in lines] == ["estimates", "---", *ways]
    truth, ekf = (line.split(" | ") for line in lines[2:])
    assert truth[4] == "0.000"
    assert truth[5:7] == [tables.WITHOUT] * 2
    assert 0.0 < float(ekf[5]) < 20.0


def test_the_table_of_a_study_is_made_of_its_episodes(tmp_path: Path):
    lines = ["condition,agent,estimator,training_seed,seed,score"]
    names = (
        "truth", "kf-umv-ui", "ekf assuming waves", "ekf", "ekf, no current", "kf assuming d", "kf", "measurement",
        "dead-reckoning",
    )  # fmt: skip
    for sea in ("moderate", "rough"):
        for name in names:
            lines += [f'{sea},autopilot,"{name}",,{seed},{0.25 * seed}' for seed in range(3)]
            lines += [f'{sea},PPO,"{name}",{run},{seed},0.5' for run in range(2) for seed in range(3)]
    (tmp_path / "episodes.csv").write_text("\n".join(lines))
    table = tables.ablation(tmp_path).splitlines()
    assert table[2].split(" | ")[1] == "0.250 ± 0.621"  # Student's, two degrees of freedom: 4.303 x 0.25 / sqrt(3)
    assert table[3].split(" | ")[1] == "0.500 ± 0.000"


def test_a_table_that_does_not_exist_is_refused():
    with pytest.raises(Refusal, match="known are segorogeni"):
        tables.main(("nobody",))


def test_the_table_of_late_fixes_is_made_of_its_episodes(tmp_path: Path):
    lines = ["environment,condition,estimator,seed,score,position_rmse,position_nees", "A-v0,in time,truth,0,1.0,0.0,"]
    for estimator in ("ekf", "enkf"):
        for way, error in (("", 1.0), (", as new", 2.0), (", discarded", 3.0)):
            for condition in ("in time", "1 s late", "2 s late"):
                lines += [f'A-v0,{condition},"{estimator}{way}",{seed},0.5,{error + seed},1.5' for seed in range(2)]
    (tmp_path / "episodes.csv").write_text("\n".join(lines))
    rows = tables.latency(tmp_path).splitlines()
    assert len(rows) == 2 + 4
    cells = rows[2].strip("| ").split(" | ")
    assert cells[:2] == ["A, `ekf`", "1 s late"]
    assert [cell.split("; ")[1] for cell in cells[2:]] == ["1.50 m", "1.50 m", "2.50 m", "3.50 m"]
    assert cells[2].endswith("0.500 ± 0.000; 1.50 m; 1.50")


@pytest.mark.slow
def test_a_robust_filter_without_a_fix_is_moved_by_the_noise_of_its_other_measurements(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(fault_tables, "SEEDS", 8)
    ekf, *_, robust, quiet = (line.strip("| ").split(" | ") for line in fault_tables.gap().splitlines()[2:])
    (sure, gain), (doubtful, large), (_, same) = ((float(row[4]), float(row[6])) for row in (ekf, robust, quiet))
    assert doubtful > 10.0 * sure
    assert large > 500.0 * gain
    assert same == pytest.approx(large, rel=0.2)
    assert float(quiet[4]) < 0.3 * doubtful


@pytest.mark.slow
def test_the_table_of_alarms_shows_that_a_stuck_fix_is_found_and_a_silent_one_is_not(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(fault_tables, "EPISODES", 4)
    monkeypatch.setattr(fault_tables, "WATCHED", {"Segorogeni": fault_tables.WATCHED["Segorogeni"]})
    monkeypatch.setattr(fault_tables, "MONITORS", ("chi-square",))
    rows = dict(line.strip("| ").split(" | ") for line in fault_tables.alarms().splitlines()[2:])
    assert list(rows) == ["no fault, `ekf`", "no fault, `enkf`", *fault_tables.WRONG.values()]
    assert rows["no fault, `ekf`"] == "0.0 an hour"
    assert rows["off"] == "0 %"
    assert rows["stuck"].startswith("100 %; ")
    assert rows["stuck"].endswith(" s; 100 %")


@pytest.mark.slow
def test_the_tables_of_robust_filters_show_who_wins_where(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(filter_tables, "RUNS", 200)
    monkeypatch.setattr(filter_tables, "STEPS", 80)
    rows = {
        label: [float(cell.split(" ")[0]) for cell in cells]
        for label, *cells in (line.strip("| ").split(" | ") for line in filter_tables.robust_losses().splitlines()[2:])
    }
    assert rows["10 % of measurements at 10 σ"][1] < 0.6
    assert rows["10 % of measurements at 10 σ"][2] > 1.0
    assert rows["least-favourable model, 0.1"][3] < 1.0 < rows["least-favourable model, 0.1"][1]
    assert rows["as the model says"][1] > 1.0


def test_more_measurements_than_inputs_leave_no_unstable_zero():
    rows = [line.strip("| ").split(" | ") for line in filter_tables.unstable_zeros(20).splitlines()[2:]]
    assert len(rows) == 3
    assert all(float(one.split(" ")[0]) > 30.0 for _, one, *_ in rows)
    assert all(cell.startswith("0.0 %") for _, _, *more in rows for cell in more)


def test_pairing_saves_as_much_as_scores_have_in_common(tmp_path: Path):
    rng = np.random.default_rng(0)
    weather, own = rng.normal(size=(2, 2000)), rng.normal(size=(2, 2, 2000))
    lines = ["environment,condition,estimator,seed,score"]
    for vehicle, share in enumerate((3.0, 0.0)):  # of the weather; the factor is 1 + share^2
        for name, of in zip(("ekf", "ukf"), share * weather[vehicle] + own[vehicle], strict=True):
            lines += [f"{vehicle},nominal,{name},{seed},{score}" for seed, score in enumerate(of)]
    (tmp_path / "episodes.csv").write_text("\n".join(lines))
    common, alone = (line.strip("| ").split(" | ") for line in tables.pairing(tmp_path).splitlines()[2:])
    assert common[:2] == ["0", "1"]
    assert float(common[2]) == pytest.approx(10.0, rel=0.1)
    assert float(alone[2]) == pytest.approx(1.0, rel=0.1)
