"""Tables of docs/, written anew."""

from functools import cache, partialmethod
from pathlib import Path

import numpy as np
import pytest

from agents import rollout
from agents.commands.console import Refusal
from studies.tables import __main__ as tables
from studies.tables import compass, overturn, suites
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


def test_the_sentences_of_a_study_are_made_of_what_it_study(tmp_path: Path):
    (tmp_path / "answer.md").write_text("Take ekf.\nA step on ekf takes 3 µs.\nWorse: enkf.\n")
    assert tables.advice(tmp_path) == "Take ekf. Worse: enkf."
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "ranking.md").write_text(
        "| Estimator | All |\n| --- | ---: |\n| ekf | 0.9 ± 0.1 |\n"
    )
    lines = ["environment,condition,agent,estimator,training_seed,seed,score"]
    for world in ("PunaUAV-v0", "ItsunusaAUV-v0", "SegorogeniAUV-v0"):
        for condition in ("bad sensors", "model 10 % off", "model 20 % off"):
            for name, score in (("truth", 0.9), ("huber-kf", 0.75), ("ekf", 0.5)):
                lines += [
                    f"{world},{condition},autopilot,{name},,{seed},{score + seed}"
                    for seed in (1, 0)
                ]
    (tmp_path / "episodes.csv").write_text("\n".join(lines))
    told = " ".join(tables.exceptions(tmp_path).split())
    assert "than `ekf` by 0.250 ± 0.000 in `PunaUAV-v0`" in told
    assert "loses 0.400 ± 0.000 and 0.400 ± 0.000 of the score on `ekf`" in told
    assert "(Means over 2 seeds;" in told


def test_another_memory_of_the_compass_leaves_all_else_of_the_sensors():
    """Size and constant of her error too, so that the figure shows the correlation time alone."""
    usual, long = (compass.sensors(time) for time in (30.0, 3000.0))
    for one, other in zip(usual, long, strict=True):
        changed = {"time": 3000.0} if one.name == compass.COMPASS else {}
        assert vars(other.bias) == vars(one.bias) | changed
        assert vars(other) | {"bias": None} == vars(one) | {"bias": None}


def test_a_claim_s_flips_and_doubts_are_named(monkeypatch: pytest.MonkeyPatch):
    means = {
        "kf-umv-ui": 0.55,
        "ekf assuming waves": 0.6,
        "ekf": 0.5,
        "huber-kf": 0.52,
        "enkf-sr": 0.5003,
    }
    others = {
        "calm sea": {"ekf assuming waves": 0.5},
        "controller `pid`": {"huber-kf": 0.5, "kf-umv-ui": 0.51},
    }
    noise = np.random.default_rng(0).normal(0.0, 0.001, (6, 1, 100))

    def flown(condition: str, **changes):
        of = means | {"measurement": 0.3} | others.get(condition, {})
        return suites.Column(
            "", condition, {name: of[name] + e for name, e in zip(of, noise, strict=True)}, 1
        )

    monkeypatch.setattr(overturn, "flown", flown)
    text, _, rows = overturn.overturn().partition("\n\n")
    text = " ".join(text.split())
    assert text.startswith(
        "`ekf assuming waves` has the highest mean, but in 1 (calm sea: `kf-umv-ui`). Means of"
    )
    told = "the sign of {} holds beyond chance in {}, flips in {} and is not decided in {}."
    assert told.format("best − `measurement`", 23, "none", "none") in text
    assert told.format("`ekf assuming waves` − `kf-umv-ui`", 22, "1 (calm sea)", "none") in text
    assert text.endswith(told.format("`huber-kf` − `ekf`", 22, "none", "1 (controller `pid`)"))
    first, calm = (row.strip("| ").split(" | ") for row in rows.splitlines()[2:4])
    assert [cell.split(" ± ")[0] for cell in first[1:]] == [
        "`ekf assuming waves`",
        "0.300",
        "0.050",
        "0.050",
        "0.020",
    ]
    assert calm[:2] == ["calm sea", "`kf-umv-ui`"]


def test_a_constant_of_the_score_is_changed_alone(monkeypatch: pytest.MonkeyPatch):
    """The same flights, scored otherwise."""
    on_truth = cache(
        lambda env_id: rollout("autopilot", env_id, [0, 1], {"estimator": "truth"}, record=False)
    )
    monkeypatch.setattr(overturn.Arm, "fly", lambda arm, env_id: on_truth(env_id))
    usual = on_truth("SigmaCorvette-v0").score
    np.testing.assert_array_equal(overturn.flown("as it is").scores["ekf"][0], usual)
    yaw, course, dear = (
        overturn.flown("", **{name: value}).scores["ekf"][0]
        for name, value in (("COURSE_SHARE", 0.0), ("COURSE_SHARE", 1.0), ("RUDDER_PRICE", 2.0))
    )
    np.testing.assert_allclose(0.4 * yaw + 0.6 * course, usual, rtol=1e-12)
    assert (dear < usual).all()


def test_a_text_goes_between_its_own_marks(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text(
        "a\n<!-- table: one -->\nold\n<!-- end -->\nb\n<!-- table: two -->\nkept\n<!-- end -->\n"
    )
    put(page, "table: one", "new\n")
    assert (
        page.read_text()
        == "a\n<!-- table: one -->\n\nnew\n\n<!-- end -->\nb\n<!-- table: two -->\nkept\n<!-- end"
        " -->\n"
    )
    for lacking in ("table: three", "table: "):
        with pytest.raises(Refusal, match="needs one line"):
            put(page, lacking, "new")


@pytest.mark.slow
def test_the_tables_of_journeys_show_each_way_once(monkeypatch: pytest.MonkeyPatch):
    ways = {
        label: way
        for way in tables.JOURNEYS["ItsunusaAUV-v0"]
        if (label := way.label) in ("`truth`", "`ekf`")
    }
    monkeypatch.setattr(tables.Arm, "fly", partialmethod(tables.Arm.fly, episodes=2))
    monkeypatch.setattr(tables, "JOURNEYS", {"ItsunusaAUV-v0": tuple(ways.values())})
    tables.journey.cache_clear()
    lines = tables.journeys("ItsunusaAUV-v0").splitlines()
    tables.journey.cache_clear()
    assert [line.split(" | ")[0].strip("| ") for line in lines] == ["estimates", "---", *ways]
    truth, ekf = (line.split(" | ") for line in lines[2:])
    assert truth[4] == "0.000"
    assert truth[5:7] == [tables.WITHOUT] * 2
    assert 0.0 < float(ekf[5]) < 20.0


def study(folder: Path, better: float = -0.01) -> Path:
    """A study of two environments: in the first filters differ where fixes are lost; in the second they never do.

    In the first, the second filter is ``better`` than the truth by so much with nominal sensors.
    """
    lines = ["environment,condition,agent,estimator,training_seed,seed,score,steering_travel"]
    lost = {
        "truth": 0.0,
        "dead-reckoning": 0.6,
        "ekf": 0.1,
        "ukf": 0.15,
        "kf": 0.2,
        "measurement": 0.3,
    }
    for world in ("SigmaCorvette-v0", "PunaUAV-v0"):
        for suite in suites.SUITES:
            for name, less in lost.items():
                loss = (
                    less
                    if (world, suite) == ("SigmaCorvette-v0", "denied") or name == "dead-reckoning"
                    else 0.01 * bool(less)
                )
                if (world, suite, name) == ("SigmaCorvette-v0", "nominal", "ekf"):
                    loss = -better
                for seed in (1, 0, 2):
                    score = 0.8 - loss + 0.1 * seed + 0.001 * (seed == 2) * (name == "ekf")
                    lines.append(
                        f'{world},"rough,'
                        f' {suite}",autopilot,"{name}",,{seed},{score},{100.0 * less + seed}'
                    )
    (folder / "episodes.csv").write_text("\n".join(lines))
    for function in (suites.flown, suites.stored):
        function.cache_clear()
    return folder


def test_a_table_of_suites_has_score_and_steering_of_each_estimator(tmp_path: Path):
    rows = suites.by_suite(study(tmp_path), "SigmaCorvette-v0", "rough").splitlines()
    assert [row.split(" | ")[0].strip("| ") for row in rows[2:]] == [
        "`truth`", "`ekf`", "`ukf`", "`kf`", "`measurement`", "`dead-reckoning`",
    ]  # fmt: skip
    # Student's, two degrees of freedom, of 18 intervals at once: 18.93 x 0.1 / sqrt(3)
    assert rows[2].split(" | ")[1] == "0.900 ± 1.093; 1"
    assert rows[3].split(" | ")[3].startswith("0.800 ± ")
    assert rows[3].strip("| ").endswith("; 11")
    (only,) = suites.by_suite(
        tmp_path, "SigmaCorvette-v0", "rough", estimators=["truth"]
    ).splitlines()[2:]
    assert only.startswith("| `truth` | 0.900 ± 0.4")
    with pytest.raises(Refusal, match="PPO flew nothing in SigmaCorvette-v0"):
        suites.by_suite(tmp_path, "SigmaCorvette-v0", "rough", "PPO")


def test_a_study_of_suites_says_where_filters_differ(tmp_path: Path):
    of = study(tmp_path)
    row = next(
        line
        for line in suites.differences(of).splitlines()
        if line.startswith("| SigmaCorvette-v0, rough, denied")
    )
    assert [cell.split(" ± ")[0] for cell in row.strip("| ").split(" | ")[1:]] == [
        "`ekf`", "**0.200", "-0.050", "–", "**0.100",
    ]  # fmt: skip
    told = " ".join(suites.found(of).split())
    assert told.startswith(
        "On the same model a filter gains more than 0.05 over `ekf` beyond chance in 0 of 6"
        " columns. The largest gain of a model is that of `ekf` over `kf` in SigmaCorvette-v0,"
        " rough, denied, by 0.100"
    )
    assert (
        "Against held measurements the best filter gains in 1 of 2 environments"
        " (`SigmaCorvette-v0`). " in told
    )
    assert (
        "Against the environment's default the best filter gains in 0 of 2 environments. No filter"
        " is beaten" in told
    )
    assert told.endswith("The truth has the highest mean in 6 of 6 columns, and no estimator scores significantly more "
                         "than it in any.")  # fmt: skip
    text = " ".join(suites.headline(of, "SigmaCorvette-v0", "rough").split())
    assert (
        "loses 0.010, 0.010 and 0.100 of the score against the truth on the best filter, and 0.010,"
        " 0.010 and " in text
    )
    assert (
        "0.300 on held measurements (`measurement`), which steer 2.8 to 2.8 times as much." in text
    )  # 31 of 11 degrees
    assert text.endswith(
        "No filter beats held measurements beyond chance with `nominal` and `budget` sensors."
    )


def test_an_estimator_that_beats_the_truth_beyond_chance_is_named(tmp_path: Path):
    told = suites.truth_first(study(tmp_path, better=0.2))
    assert told.startswith("The truth has the highest mean in 5 of 6 columns.")
    assert (
        "Significantly higher than on the truth are the scores of `ekf` in SigmaCorvette-v0, rough,"
        " nominal by 0.200" in told
    )


def test_a_table_that_does_not_exist_is_refused():
    with pytest.raises(Refusal, match="known are segorogeni"):
        tables.main(("nobody",))


def test_the_table_of_late_fixes_is_made_of_its_episodes(tmp_path: Path):
    lines = [
        "environment,agent,training_seed,condition,estimator,seed,score,position_rmse,position_nees",
        "A-v0,autopilot,,in time,truth,0,1.0,0.0,",
    ]
    for estimator in ("ekf", "enkf"):
        for way, error in (("", 1.0), (", as new", 2.0), (", discarded", 3.0)):
            for condition in ("in time", "1 s late", "2 s late"):
                lines += [
                    f'A-v0,autopilot,,{condition},"{estimator}{way}",{seed},0.5,{error + seed},1.5'
                    for seed in range(2)
                ]
    (tmp_path / "episodes.csv").write_text("\n".join(lines))
    rows = tables.latency(tmp_path).splitlines()
    assert len(rows) == 2 + 4
    cells = rows[2].strip("| ").split(" | ")
    assert cells[:2] == ["A, `ekf`", "1 s late"]
    assert [cell.split("; ")[1] for cell in cells[2:]] == ["1.50 m", "1.50 m", "2.50 m", "3.50 m"]
    assert cells[2].endswith("0.500 ± 0.000; 1.50 m; 1.50")


@pytest.mark.slow
def test_a_robust_filter_without_a_fix_is_moved_by_the_noise_of_its_other_measurements(
    monkeypatch: pytest.MonkeyPatch,
):
    flown = fault_tables._without_a_fix

    def shown(way, times):
        return flown(way, times) if "`ekf`" in way.label or "0.01" in way.label else [""] * 6

    monkeypatch.setattr(fault_tables, "SEEDS", 8)
    monkeypatch.setattr(fault_tables, "_without_a_fix", shown)
    ekf, *_, robust, quiet = (
        line.strip("| ").split(" | ") for line in fault_tables.gap().splitlines()[2:]
    )
    (sure, gain), (doubtful, large), (_, same) = (
        (float(row[4]), float(row[6])) for row in (ekf, robust, quiet)
    )
    assert doubtful > 10.0 * sure
    assert large > 500.0 * gain
    assert same == pytest.approx(large, rel=0.2)
    assert float(quiet[4]) < 0.3 * doubtful


@pytest.mark.slow
def test_the_tables_of_robust_filters_show_who_wins_where(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(filter_tables, "RUNS", 200)
    monkeypatch.setattr(filter_tables, "STEPS", 80)
    rows = {
        label: [float(cell.split(" ")[0]) for cell in cells]
        for label, *cells in (
            line.strip("| ").split(" | ") for line in filter_tables.robust_losses().splitlines()[2:]
        )
    }
    assert rows["10 % of measurements at 10 σ"][1] < 0.6
    assert rows["10 % of measurements at 10 σ"][2] > 1.0
    assert rows["least-favourable model, 0.1"][3] < 1.0 < rows["least-favourable model, 0.1"][1]
    assert rows["as the model says"][1] > 1.0


def test_the_table_of_lorenz_has_every_published_score_beside_ours(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        filter_tables, "analysis_rmse", lambda row, *_: row.published * np.array([0.9, 1.1])
    )
    lines = filter_tables.published_scores().splitlines()[2:]
    for line, row in zip(lines, filter_tables.BENCHMARKS, strict=True):
        assert all(name in line for name in row.filters)
        assert f"{row.published:.3f} ± " in line
        assert row.described in line
        assert ("reported" in line) == row.reported_only


def test_more_measurements_than_inputs_leave_no_unstable_zero():
    rows = [
        line.strip("| ").split(" | ") for line in filter_tables.unstable_zeros(20).splitlines()[2:]
    ]
    assert len(rows) == 3
    assert all(float(one.split(" ")[0]) > 30.0 for _, one, *_ in rows)
    assert all(cell.startswith("0.0 %") for _, _, *more in rows for cell in more)


def test_pairing_saves_as_much_as_scores_have_in_common(tmp_path: Path):
    rng = np.random.default_rng(0)
    weather, own = rng.normal(size=(2, 2000)), rng.normal(size=(2, 2, 2000))
    lines = ["environment,condition,agent,estimator,training_seed,seed,score"]
    for vehicle, share in enumerate((3.0, 0.0)):  # of the weather; the factor is 1 + share^2
        for name, of in zip(("ekf", "ukf"), share * weather[vehicle] + own[vehicle], strict=True):
            lines += [
                f"{vehicle},nominal,autopilot,{name},,{seed},{score}"
                for seed, score in enumerate(of)
            ]
    (tmp_path / "episodes.csv").write_text("\n".join(lines))
    common, alone = (
        line.strip("| ").split(" | ") for line in tables.pairing(tmp_path).splitlines()[2:]
    )
    assert common[:2] == ["0", "1"]
    assert float(common[2]) == pytest.approx(10.0, rel=0.1)
    assert float(alone[2]) == pytest.approx(1.0, rel=0.1)
