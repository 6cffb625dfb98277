"""Tables of docs/: their places, their commands, and what the sentences and cells are made of."""

from pathlib import Path

import numpy as np
import pytest

from agents.refusal import Refusal
from studies import tables
from studies.tables import BLOCKS, around, put


@pytest.mark.parametrize("name", BLOCKS)
def test_a_block_has_its_place_and_tables_are_whole(name: str):
    page, mark, _ = BLOCKS[name]
    before, after = around(page, mark)
    inside = page.read_text(encoding="utf-8")[len(before) : -len(after)].strip()
    assert len(inside) > 50
    if mark.startswith("table"):
        lines = inside.splitlines()
        assert all(line.startswith("|") and line.endswith("|") for line in lines)
        assert len({line.count("|") for line in lines}) == 1


def cells(text: str) -> list[list[str]]:
    """The cells of a table's rows, the heading first."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [line[1:-1].strip().split(" | ") for line in (lines[0], *lines[2:])]


COMPUTED = (
    "itsunusa", "segorogeni, short", "moderate", "surface", "channel", "sensors", "insurance",
    "huber", "robust", "zeros", "faults found", "compass", "agents", "lorenz",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPUTED)
def test_a_command_writes_the_headings_and_labels_of_its_page(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    for constant, few in {"EPISODES": 2, "FEWER": 2, "RUNS": 20, "STEPS": 30}.items():
        monkeypatch.setattr(tables, constant, few)
    monkeypatch.setattr(
        tables, "analysis_rmse", lambda row, *_: row.published * np.array([0.9, 1.1])
    )
    page, mark, made = BLOCKS[name]
    before, after = around(page, mark)
    stored = page.read_text(encoding="utf-8")[len(before) : -len(after)]
    stored, found = cells(stored.replace("of 100", "of 2")), cells(made())
    assert stored[0] == found[0]
    assert [row[0] for row in found] == [row[0] for row in stored]
    if name == "lorenz":
        assert all(f"{float(row[-1].split()[0]):.3f} ± " in row[4] for row in found[1:])


def test_the_grades_on_the_page_are_those_of_the_files():
    page, mark, made = BLOCKS["grades"]
    before, after = around(page, mark)
    assert page.read_text(encoding="utf-8")[len(before) : -len(after)].strip() == made()


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


def test_another_memory_of_the_compass_leaves_all_else_of_the_sensors():
    for one, other in zip(tables.with_memory(30.0), tables.with_memory(3000.0), strict=True):
        changed = {"time": 3000.0} if one.name == "gyro compass" else {}
        assert vars(other.bias) == vars(one.bias) | changed
        assert vars(other) | {"bias": None} == vars(one) | {"bias": None}


def test_signs_of_differences_that_hold_flip_or_are_not_decided_are_counted(
    monkeypatch: pytest.MonkeyPatch,
):
    means = {"kf-umv-ui": 0.55, "ekf assuming waves": 0.6, "ekf": 0.5, "huber-kf": 0.52,
             "enkf-sr": 0.5003, "measurement": 0.3}  # fmt: skip
    others = {"calm sea": {"ekf assuming waves": 0.5},
              "controller `pid`": {"huber-kf": 0.5, "kf-umv-ui": 0.51}}  # fmt: skip
    noise = np.random.default_rng(0).normal(0.0, 0.001, (6, 1, 100))

    def varied(condition: str, **_):
        of = means | others.get(condition, {})
        scores = {name: of[name] + e for name, e in zip(of, noise, strict=True)}
        return tables.Column("", condition, scores)

    monkeypatch.setattr(tables, "varied", varied)
    text = tables.overturn()
    assert text.startswith("Means of `enkf-sr` and `ekf` differ by at most 0.000")
    _, first, calm, *_, total = cells(text)
    assert [each.split(" ± ")[0] for each in first[1:]] == [
        "`ekf assuming waves`", "0.300", "0.050", "0.050", "0.020",
    ]  # fmt: skip
    assert calm[:2] == ["calm sea", "`kf-umv-ui`"]
    assert total[2:] == ["23, 0, 0", "23, 0, 0", "22, 1, 0", "22, 0, 1"]


@pytest.mark.slow
def test_a_constant_of_the_score_is_changed_alone(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tables, "EPISODES", 2)
    usual = tables.fly("SigmaCorvette-v0", "ekf").score
    np.testing.assert_array_equal(tables.varied("as it is").scores["ekf"][0], usual)
    yaw, course, dear = (
        tables.varied("", **{name: value}).scores["ekf"][0]
        for name, value in (("COURSE_SHARE", 0.0), ("COURSE_SHARE", 1.0), ("RUDDER_PRICE", 2.0))
    )
    np.testing.assert_allclose(0.4 * yaw + 0.6 * course, usual, rtol=1e-12)
    assert (dear < usual).all()


@pytest.mark.slow
def test_a_robust_filter_without_a_fix_is_moved_by_the_noise_of_its_other_measurements(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(tables, "FEWER", 8)
    (sure, gain), (doubtful, large) = (
        (float(found[3]), float(found[5]))
        for found in (
            tables.without_a_fix("ekf", {}, "nominal"),
            tables.without_a_fix("robust-kf", {"radius": 1e-2}, "nominal"),
        )
    )
    assert doubtful > 10.0 * sure
    assert large > 500.0 * gain


def test_more_measurements_than_inputs_leave_no_unstable_zero():
    _, *rows = cells(tables.unstable_zeros(20))
    assert all(float(one.split(" ")[0]) > 30.0 for _, one, *_ in rows)
    assert all(cell.startswith("0.0 %") for _, _, *more in rows for cell in more)


# --- studies --------------------------------------------------------------------------------------


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for the episodes of the study `mine`."""
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    tables.stored.cache_clear()
    (tmp_path / "results" / "mine" / "tables").mkdir(parents=True)
    return tmp_path / "results" / "mine"


def study(folder: Path, better: float = -0.01) -> str:
    """A study of two environments: in the first filters differ where fixes are lost, else nowhere.

    In the first, the second filter is ``better`` than the truth by so much with nominal sensors.
    """
    lines = ["environment,condition,agent,estimator,training_seed,seed,score,steering_travel"]
    lost = {"truth": 0.0, "dead-reckoning": 0.6, "ekf": 0.1, "ukf": 0.15, "kf": 0.2,
            "measurement": 0.3}  # fmt: skip
    for world in ("SigmaCorvette-v0", "PunaUAV-v0"):
        for suite in tables.SUITE:
            for name, less in lost.items():
                far = (world, suite) == ("SigmaCorvette-v0", "denied") or name == "dead-reckoning"
                loss = less if far else 0.01 * bool(less)
                if (world, suite, name) == ("SigmaCorvette-v0", "nominal", "ekf"):
                    loss = -better
                for seed in (1, 0, 2):
                    score = 0.8 - loss + 0.1 * seed + 0.001 * (seed == 2) * (name == "ekf")
                    place = f'{world},"rough, {suite}",autopilot,"{name}",,{seed}'
                    lines.append(f"{place},{score},{100.0 * less + seed}")
    (folder / "episodes.csv").write_text("\n".join(lines))
    tables.stored.cache_clear()
    return "mine"


def test_a_table_of_suites_has_score_and_steering_of_each_estimator(results: Path):
    _, *rows = cells(tables.by_suite(study(results), "SigmaCorvette-v0", "rough"))
    assert [row[0] for row in rows] == [
        "`truth`", "`ekf`", "`ukf`", "`kf`", "`measurement`", "`dead-reckoning`",
    ]  # fmt: skip
    # Student's, two degrees of freedom, of 18 intervals at once: 18.93 x 0.1 / sqrt(3)
    assert rows[0][1] == "0.900 ± 1.093; 1"
    assert rows[1][3].startswith("0.800 ± ")
    assert rows[1][3].endswith("; 11")
    with pytest.raises(Refusal, match="PPO flew nothing in SigmaCorvette-v0"):
        tables.by_suite("mine", "SigmaCorvette-v0", "rough", "PPO")


def test_a_study_of_suites_says_where_filters_differ(results: Path):
    of = study(results)
    row = next(row for row in cells(tables.differences(of)) if row[0].endswith("rough, denied"))
    assert [cell.split(" ± ")[0] for cell in row[1:]] == [
        "`ekf`", "**0.200", "-0.050", "–", "**0.100",
    ]  # fmt: skip
    told = " ".join(tables.truth_first(of).split())
    assert told == (
        "The truth has the highest mean in 6 of 6 columns. Beyond chance above the truth: none."
        " Beyond chance above the best filter, without any: none."
    )
    text = " ".join(tables.headline(of, "SigmaCorvette-v0", "rough").split())
    assert "loses 0.010, 0.010 and 0.100 of the score against the truth on the best filter" in text
    assert "0.300 on held measurements (`measurement`), which steer 2.8 to 2.8 times" in text
    told = tables.truth_first(study(results, better=0.2))
    assert told.startswith("The truth has the highest mean in 5 of 6 columns.")
    assert "`ekf` in SigmaCorvette-v0, rough, nominal, by 0.200" in " ".join(told.split())


def test_pairing_saves_as_much_as_scores_have_in_common(results: Path):
    rng = np.random.default_rng(0)
    weather, own = rng.normal(size=(2, 2000)), rng.normal(size=(2, 2, 2000))
    lines = ["environment,condition,agent,estimator,training_seed,seed,score"]
    for vehicle, share in enumerate((3.0, 0.0)):  # of the weather; the factor is 1 + share^2
        for name, of in zip(("ekf", "ukf"), share * weather[vehicle] + own[vehicle], strict=True):
            lines += [f"v{vehicle},nominal,autopilot,{name},,{i},{s}" for i, s in enumerate(of)]
    (results / "episodes.csv").write_text("\n".join(lines))
    _, common, alone = cells(tables.pairing("mine"))
    assert common[:2] == ["v0", "1"]
    assert float(common[2]) == pytest.approx(10.0, rel=0.1)
    assert float(alone[2]) == pytest.approx(1.0, rel=0.1)


def test_late_fixes_and_exceptions_are_made_of_episodes(results: Path):
    lines = ["environment,agent,training_seed,condition,estimator,seed,score,position_rmse,"
             "position_nees"]  # fmt: skip
    for estimator in ("ekf", "enkf"):
        for way, error in (("", 1.0), (", as new", 2.0), (", discarded", 3.0)):
            for at in ("in time", "1 s late", "2 s late"):
                lines += [f'A-v0,autopilot,,{at},"{estimator}{way}",{i},0.5,{error + i},1.5'
                          for i in range(2)]  # fmt: skip
    for world in ("PunaUAV-v0", "ItsunusaAUV-v0", "SegorogeniAUV-v0"):
        for at in ("bad sensors", "model 10 % off", "model 20 % off"):
            for name, score in (("truth", 0.9), ("huber-kf", 0.75), ("ekf", 0.5)):
                lines += [f"{world},autopilot,,{at},{name},{i},{score + i},," for i in (1, 0)]
    (results / "episodes.csv").write_text("\n".join(lines))
    ranking = "| Estimator | All |\n| --- | ---: |\n| ekf | 0.9 |\n"
    (results / "tables" / "ranking.md").write_text(f"# Ranking\n\n{ranking}")
    (results / "answer.md").write_text("Take ekf.\nA step on ekf takes 3 µs.\nWorse: enkf.\n")
    with pytest.raises(KeyError):  # the other environments have no late fixes
        tables.latency("mine")
    assert tables.advice("mine") == "Take ekf. Worse: enkf."
    assert tables.shares("mine") == ranking.strip()
    _, *wild, ten, twenty = cells(tables.wild_and_wrong("mine"))
    assert wild[0] == ["PunaUAV-v0, bad sensors", "`huber-kf` − `ekf`", "0.250 ± 0.000"]
    assert ten[1:] == twenty[1:] == ["`truth` − `ekf`", "0.400 ± 0.000"]
    (results / "episodes.csv").write_text("\n".join(lines[:37]))
    tables.stored.cache_clear()
    _, late, *_ = cells(tables.latency("mine"))
    assert late[:3] == ["A, `ekf`", "1 s late", "0.500 ± 0.000; 1.50 m; 1.50"]
    assert [cell.split("; ")[1] for cell in late[3:]] == ["1.50 m", "2.50 m", "3.50 m"]
