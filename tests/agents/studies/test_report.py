"""The report of a study: it says what the numbers say, whatever was flown, and leaves nothing out in silence."""

import csv
import io
import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from types import SimpleNamespace

import invented
import numpy as np
import pytest
from invented import (
    CLASSICAL,
    CONDITIONS,
    CORVETTE,
    LEARNED,
    QUALITY,
    SEGOROGENI,
    results,
    study,
    without,
)

from agents.metrics import SCORE, STEERING, metrics
from agents.page import entry, render
from agents.statistics import LOWER, UNDECIDED, WORSE, crossed_interval, paired_difference, verdict
from agents.studies.answer import answer, summary
from agents.studies.learning import transfer_figure
from agents.studies.plan import plan
from agents.studies.records import Agent
from agents.studies.report import page, write_report
from agents.studies.results import Policy
from agents.studies.shares import verdicts
from agents.studies.worlds import system_of

OUT = Path("results")


@pytest.fixture(scope="module")
def classical():
    return results(study())


@pytest.fixture(scope="module")
def plain(classical):
    return page(classical, OUT)


@pytest.fixture(scope="module")
def small():
    return results(study((CORVETTE,)))


@pytest.fixture(scope="module")
def short(small):
    return page(small, OUT)


@pytest.fixture(scope="module")
def learned():
    return invented.learned()


@pytest.fixture(scope="module")
def taught(learned):
    return page(learned, OUT)


def table(report, name):
    return next(t for t in report.tables if t.name == name)


def rows(report, name):
    """Entries in plain text by row and heading."""
    found = table(report, name)
    heads = [label for label, _ in found.head]
    return {
        (title, row): dict(zip(heads, map(str, entries), strict=True))
        for title, each in found.sections
        for row, entries in each
    }


def test_the_advice_is_the_estimator_on_which_most_is_kept_wherever_that_is():
    planned = plan(study((CORVETTE,)))
    for best in ("kf", "ekf", "kf-umv-ui"):
        told = answer(results(planned, QUALITY | {best: 0.99}))
        assert told[0].startswith(f"Fly {best} in {CORVETTE}")
        assert told[1].startswith("Every other is worse")


@pytest.mark.slow
def test_conditions_of_one_environment_leave_dashes_in_the_rows_of_others():
    conditions = (CONDITIONS[0], replace(CONDITIONS[1], environments=(SEGOROGENI,)))
    report = page(results(study(agents=LEARNED[:2], conditions=conditions)), OUT)
    render(report)
    for each in report.tables:
        assert {len(entries) for _, listed in each.sections for _, entries in listed} == {
            len(each.head)
        }
    priced = rows(report, "price")
    assert all((row["calm"] == "–") == (title == CORVETTE) for (title, _), row in priced.items())


@pytest.mark.slow
def test_a_small_table_at_the_head_begins_with_the_advice_and_agrees_with_the_large_one():
    found = results(plan(study((CORVETTE,))), QUALITY | {"ekf": 0.99})
    head = summary(found)
    (_, lines), *none = head.sections
    assert not none
    assert lines[0][0] == "ekf"
    assert answer(found)[0].startswith("Fly ekf")
    assert len(lines) <= 5
    ranking = rows(page(found, OUT), "ranking")
    for name, (share, *_) in lines:
        assert str(share) == ranking["", name][CORVETTE]
    losses = [float(str(lost).split(" ")[0].replace("−", "-")) for _, (_, lost, *_) in lines]
    assert losses == sorted(losses)


def test_where_nothing_can_be_ranked_the_head_has_no_table():
    assert (
        summary(results(study((CORVETTE,)), QUALITY | {"truth": 0.1, "dead-reckoning": 0.9}))
        is None
    )


def test_estimators_that_differ_by_chance_are_said_to():
    told = " ".join(
        answer(
            results(
                study((CORVETTE,)),
                dict.fromkeys(QUALITY, 0.9) | {"truth": 1.0, "dead-reckoning": 0.0},
            )
        )
    )
    assert "Worse" not in told
    assert re.search(r"(Equivalent to \S+ \(within ±0.01\)|Not decided): .* and .*", told)


def test_of_equivalent_estimators_the_advice_is_the_cheapest_and_says_so():
    planned = plan(study((CORVETTE,), episodes=100))
    planned = replace(planned, study=replace(planned.study, margin=0.05))
    alike = QUALITY | {
        "kf-umv-ui": 0.95,
        "ekf": 0.949,
    }  # invented times grow with the length of a name
    cheap, standing, *_ = answer(results(planned, alike, noise=1e-3))
    assert cheap.startswith(
        f"Fly ekf in {CORVETTE}. It is equivalent to kf-umv-ui, which keeps most, and its step is"
    )
    assert standing.startswith("Equivalent to kf-umv-ui (within ±0.05)")
    untimed = replace(results(planned, alike, noise=1e-3), timings={})
    assert answer(untimed)[0].startswith(f"Fly kf-umv-ui in {CORVETTE}: on it")
    assert answer(results(planned, alike | {"ekf": 0.8}, noise=1e-3))[0].startswith(
        f"Fly kf-umv-ui in {CORVETTE}: on it"
    )


def test_below_the_best_but_not_by_the_margin_is_lower_and_not_equivalent_on_few_episodes(small):
    lead, standing, *_ = answer(results(small.plan, QUALITY | {"ekf": 0.945}, noise=1e-3))
    assert lead.startswith(f"Fly kf-umv-ui in {CORVETTE}: on it")
    assert standing == "Lower, perhaps by less than 0.01: ekf."
    assert "Worse, by more than 0.01: enkf and kf." in answer(
        results(small.plan, QUALITY | {"ekf": 0.945}, noise=1e-3)
    )


@pytest.mark.parametrize(("episodes", "noise"), [(4, 0.5), (20, 0.5)])
def test_few_episodes_end_in_no_advice_but_in_a_number_of_episodes_that_give_one(episodes, noise):
    def said(number):
        return answer(
            results(study((CORVETTE,), conditions=CONDITIONS[:1], episodes=number), noise=noise)
        )[0]

    few = said(episodes)
    assert few.startswith(f"{episodes} episodes cannot tell which estimator to fly in {CORVETTE}")
    enough = int(
        re.search(r"; by their scatter it takes at least (\d+) episodes to tell\.", few)[1]
    )
    assert enough > episodes
    assert said(enough).startswith("Fly ")


def test_of_one_episode_not_even_that_number_is_known():
    one = answer(results(study((CORVETTE,), conditions=CONDITIONS[:1], episodes=1)))[0]
    assert one.startswith("1 episode cannot tell")
    assert one.endswith("keeps most.")


@pytest.mark.slow
def test_over_all_environments_only_estimators_count_that_flew_in_each(classical, plain):
    told = answer(classical)
    assert (
        "in both environments, take enkf" in told[0]
    )  # kf-umv-ui keeps more, but only the corvette carries it
    assert re.search(f"in {CORVETTE} kf-umv-ui keeps 0.1.* more than enkf", told[2])
    shown = rows(plain, "ranking")
    assert shown["", "kf-umv-ui"]["All"] == shown["", "kf-umv-ui"][SEGOROGENI] == "–"
    assert shown["", "enkf"]["All"] != "–"


@pytest.mark.slow
def test_where_less_than_two_estimators_flew_everywhere_each_environment_has_its_own_advice(
    classical,
):
    common = ("truth", "dead-reckoning", "enkf")
    found = without(classical, lambda f: f.environment == SEGOROGENI and f.flown_on not in common)
    told = answer(found)
    assert told[0].startswith(f"Fly kf-umv-ui in {CORVETTE}")
    assert any(sentence.startswith(f"Fly enkf in {SEGOROGENI}") for sentence in told)
    assert not any("one estimator" in sentence for sentence in told)
    shown = rows(page(found, OUT), "ranking")
    assert next(iter(shown)) == ("", "kf-umv-ui")
    assert set(shown["", "kf-umv-ui"]) == {CORVETTE, SEGOROGENI}


@pytest.mark.slow
def test_shares_in_the_ranking_are_those_of_the_statistics(classical, plain, learned, taught):
    everywhere = (CORVETTE, SEGOROGENI)
    interval = crossed_interval(
        classical.shares(everywhere, classical.classical, "ekf"), comparisons=2
    )  # and enkf
    shown = rows(plain, "ranking")
    assert shown["", "ekf"]["All"] == f"{interval.mean:.3f} ± {interval.half:.3f}"
    interval = crossed_interval(learned.shares(everywhere, Policy("PPO", "ekf")))
    assert (
        rows(taught, "agents")["", "PPO trained on ekf"]["All"]
        == f"{interval.mean:.3f} ± {interval.half:.3f}"
    )


@pytest.mark.slow
def test_a_cell_of_the_heatmap_is_the_number_of_the_table(learned, taught):
    shown, drawn = rows(taught, "ranking-learned"), 0
    for panel in transfer_figure(learned, "PPO").axes:
        environment = panel.get_title(loc="left")
        default = {CORVETTE: "kf-umv-ui", SEGOROGENI: "enkf"}[environment]
        on, trained = (
            [label.get_text() for label in labels]
            for labels in (panel.get_xticklabels(), panel.get_yticklabels())
        )
        for text in panel.texts:
            column, row = (round(each) for each in text.get_position())
            school = trained[row].replace(default, "default")
            told = shown[f"PPO trained on {school}", on[column]][environment].split()[0]
            numbers = [float(number.replace("−", "-")) for number in (told, text.get_text())]
            assert numbers[0] == pytest.approx(numbers[1], abs=0.0051)
            drawn += 1
    assert drawn > 10


def eight_controllers() -> np.ndarray:
    """Flights ``(8, 500)`` of eight autopilots, moved so that all are equally good."""
    flown = np.load(Path(invented.__file__).parents[1] / "flights.npz")["runs"][8:16].astype(float)
    return flown - flown.mean(axis=1, keepdims=True)


def eight_strangers() -> np.ndarray:
    """Normal scores that have nothing in common."""
    return np.random.default_rng(42).normal(size=(8, 100_000))


@pytest.mark.parametrize(
    ("population", "uncorrected"), [(eight_controllers, 0.12), (eight_strangers, 0.38)]
)
def test_of_eight_estimators_that_are_equal_one_study_in_twenty_names_a_loser(
    population, uncorrected
):
    """400 studies of 20 seeds: at 5 % more than 8.5 % of them do once in a thousand times."""
    flown, named = population(), np.zeros(2)
    scaled = SimpleNamespace(plan=SimpleNamespace(study=SimpleNamespace(margin=0.01)), scaled=list)
    scaled.scale = lambda place: (np.zeros(1), np.ones(1))
    for seeds in np.random.default_rng(40).integers(flown.shape[1], size=(400, 20)):
        ranked = {str(i): flown[i, seeds] for i in np.argsort(-flown[:, seeds].mean(axis=1))}
        best, *others = ranked
        gaps = [paired_difference(ranked[best], ranked[other]) for other in others]
        losers = {LOWER, WORSE} & set(verdicts(scaled, [CORVETTE], ranked).values())
        named += bool(losers), any(gap.excludes_zero for gap in gaps)
    assert named[0] <= 0.085 * 400
    assert named[1] > uncorrected * 400  # what it would be without a correction


def test_a_loser_that_only_one_comparison_of_many_would_name_is_not_decided():
    rng = np.random.default_rng(41)
    level = rng.normal(size=20)
    worse = level - level.mean() + rng.normal(size=20)
    worse -= worse.mean() + 0.6 * worse.std(ddof=1)  # t = 2.7, of which 2.1 would do alone
    assert verdict(worse, 0.01, 1.0) == WORSE
    assert verdict(worse, 0.01, 1.0, comparisons=21) == UNDECIDED


@pytest.mark.slow
def test_the_floor_keeps_nothing_and_the_truth_everything(plain):
    shown = rows(plain, "ranking")
    for head in ("All", CORVETTE, SEGOROGENI):
        assert shown["", "dead-reckoning"][head].startswith("0.000 ±")
        assert shown["", "truth"][head].startswith("1.000 ±")


def test_whether_a_filter_beats_memory_is_decided_by_the_runs_of_each_environment(learned):
    def verdicts(**quality):
        found = results(learned.plan, QUALITY | quality)
        told = " ".join(answer(found))
        return dict(
            re.findall(r"In (\S+) a filter in the loop (.*?) learning on raw measurements", told)
        )

    raw = "raw measurements"
    assert verdicts() == {CORVETTE: "beats", SEGOROGENI: "beats"}
    assert verdicts(**{raw: 1.2}) == {CORVETTE: "is beaten by", SEGOROGENI: "is beaten by"}
    between = verdicts(
        **{raw: 0.875}
    )  # the mean of the two defaults: level on average, and nowhere
    assert between == {CORVETTE: "beats", SEGOROGENI: "is beaten by"}
    level = verdicts(**{raw: 0.8})  # as the default of Segorogeni
    assert level[SEGOROGENI] not in ("beats", "is beaten by")


@pytest.mark.slow
def test_few_training_runs_are_warned_of_and_one_has_no_interval(taught):
    single = page(results(study((CORVETTE,), LEARNED, training_seeds=1)), OUT)
    html = render(single)
    assert "Warning: 1 training run of each agent" in html
    assert "one run, no interval" in " ".join(single.answer)
    assert all(
        "±" not in entry
        for (_, row), e in rows(single, "agents").items()
        if "PPO" in row
        for entry in e.values()
    )
    assert "Warning" not in render(taught)


@pytest.mark.slow
def test_studies_without_learning_do_not_speak_of_it(plain):
    html = render(plain)
    assert "PPO" not in html
    assert "training" not in " ".join(plain.answer)


@pytest.mark.slow
def test_a_failed_job_is_named_with_the_last_line_of_its_traceback(small):
    broken = without(
        small,
        lambda f: (f.flown_on, f.condition, f.environment) == ("ekf", "rough", CORVETTE),
        "Traceback (most recent call last):\n  File x\nFloatingPointError: it <burst>",
    )
    report = page(broken, OUT)
    html = render(report)
    assert (
        f"fly autopilot on ekf in {CORVETTE} (rough, nominal, 0.0): FloatingPointError: it"
        " &lt;burst&gt;" in html
    )
    assert "File x" not in html
    assert rows(report, "ranking")["", "ekf"][CORVETTE] == "–"
    assert "1 of" in report.answer[-1]
    assert "have no result" in report.answer[-1]


def test_what_an_environment_refuses_is_listed_with_the_reason(classical, plain):
    html = unescape(render(plain))
    for skipped in classical.plan.skipped:
        assert skipped.reason in html
        assert f"{skipped.what} in {skipped.environment}" in html


def test_where_the_truth_is_worth_nothing_there_is_no_share_and_the_page_says_so():
    flat = results(study((CORVETTE,)), QUALITY | {"truth": -1.0})
    ranked, scores, *_ = answer(flat)
    assert ranked.startswith("No estimator can be ranked")
    assert re.search(
        r"scores −0\.7\d* ± .* on truth, 0\.1\d* ± .* on dead-reckoning and 0\.8\d* ± .* on"
        r" kf-umv-ui",
        scores,
    )
    assert "No scale" in render(page(flat, OUT))


@pytest.mark.slow
def test_a_missing_end_takes_its_condition_out_of_every_share(classical):
    partial = without(classical, lambda f: (f.flown_on, f.condition) == ("truth", "calm"))
    report = page(partial, OUT)
    assert f"left out of every share: {CORVETTE}, calm; {SEGOROGENI}, calm" in render(report)
    assert rows(report, "ranking")["", "ekf"]["All"] != "–"
    assert "Not computed yet" in render(report)


def test_a_study_of_which_nothing_is_flown_still_makes_a_page(learned):
    report = page(without(learned, lambda f: True, "OSError: no"), OUT)
    assert report.answer == ["Nothing has a result yet."]
    assert "OSError: no" in render(report)
    assert not report.tables


def test_an_agent_of_ones_own_may_be_the_classical_one():
    mine = Agent("mine", "agents.controllers.dive:DiveAutopilot")
    found = results(study((SEGOROGENI,), (mine,), conditions=CONDITIONS[:1]))
    assert "on it mine keeps" in answer(found)[0]
    assert (
        "The study varies no disturbance, sensor suite, mismatch of the model, latency and faults"
        " of sensors" in render(page(found, OUT))
    )


def test_the_price_is_what_the_score_on_the_truth_is_higher(classical, plain):
    truth, ours = (
        classical.figure(classical.places()[0], classical.classical, name)[0]
        for name in ("truth", "kf")
    )
    shown = rows(plain, "price")[CORVETTE, "kf"]["nominal"]
    assert shown.startswith(f"+{np.mean(truth - ours):.3f} [+")


def test_tails_stand_beside_means_in_report_and_file(small, short):
    who, places = small.classical, small.places()
    flight = next(f for f in small.plan.flights if f.flown_on == "kf")
    values = small.values[flight.job.key]
    figures = values["figures"] | {"score": [0.0, *values["figures"]["score"][1:]]}
    lost = values | {"ends": ["lost", *values["ends"][1:]], "figures": figures}
    found = replace(small, values=small.values | {flight.job.key: lost})
    shown = rows(page(found, OUT), "tails")[CORVETTE, "kf"]
    scores = np.sort(np.concatenate([found.figure(p, who, "kf").ravel() for p in places]))
    assert scores[0] == 0.0
    assert shown["Worst decile"] == f"{scores[:4].mean():.3f}"  # of 8 seeds in 4 conditions
    assert shown["Completed"].startswith("96.9 [")
    assert rows(short, "tails")[CORVETTE, "kf"]["Completed"].startswith("100.0 [")
    episodes = list(csv.DictReader(io.StringIO(found.episodes_csv())))
    failed = [e for e in episodes if e["is_success"] == "False"]
    assert [(e["estimator"], e["condition"], e["end"]) for e in failed] == [
        ("kf", flight.condition, "lost")
    ]


def test_costs_of_steering_stand_beside_the_score_as_differences_from_the_truth(small, short):
    place, *_ = small.places()
    shown, head = rows(short, "costs-sigmacorvette-v0"), table(short, "costs-sigmacorvette-v0").head
    chosen = [SCORE, *(m for m in metrics(system_of(CORVETTE)) if m.cost)]
    assert [label for label, _ in head] == [m.label for m in chosen]
    assert len(head) <= 8
    for metric in chosen:
        ours, truth = (
            small.figure(place, small.classical, name, metric.key) for name in ("kf", "truth")
        )
        assert shown["On the truth", "truth"][metric.label].startswith(
            f"{truth.mean():.{metric.decimals}f} ±"
        )
        expected = entry(crossed_interval(ours - truth), metric.decimals, signed=True)
        assert shown["More than on the truth", "kf"][metric.label] == str(expected)


def test_costs_of_learned_agents_stand_beside_those_of_the_classical_one(learned, taught):
    shown, place = rows(taught, "costs-sigmacorvette-v0"), learned.places([CORVETTE])[0]
    metric, policy = STEERING[0], Policy("PPO", "ekf")
    ours, truth = (
        learned.figure(place, *each, metric.key)
        for each in ((policy, "ekf"), (learned.classical, "truth"))
    )
    expected = entry(learned.interval(policy, ours - truth), metric.decimals, signed=True)
    row = shown["More than on the truth", "PPO trained on ekf, on ekf"]
    assert row[metric.label] == str(expected)
    assert row["Score"] != "–"


def test_the_answer_names_what_steering_costs_on_the_best_of_one_environment(small, classical):
    truth = small.mean(small.places()[0], small.classical, "truth", STEERING[0])
    (told,) = (line for line in answer(small) if line.startswith("Costs of steering in nominal"))
    assert f"°/min of travel (from {truth.mean:.1f})" in told
    assert not any(line.startswith("Costs of steering") for line in answer(classical))


def test_costs_are_beyond_the_truth_that_flew_in_turns_in_a_batch_and_alone(short):
    shown = {
        name: [*map(str, entries)]
        for _, rows_ in table(short, "cost").sections
        for name, entries in rows_
    }
    assert shown["kf"] == ["30.0", "20.0", "200", "100"]
    assert shown["truth"][1::2] == ["–", "–"]


def test_the_tails_of_learned_agents_are_shown_too(taught):
    assert ("SigmaCorvette-v0", "PPO trained on ekf, on ekf") in rows(taught, "tails")


def test_all_columns_have_one_ruler_and_the_report_names_it(short):
    assert "One ruler for all columns: by termination 'belief'" in render(short).replace(
        "&#39;", "'"
    )


@pytest.mark.slow
def test_every_setting_of_the_study_is_on_the_page(taught, learned):
    html = render(taught)
    for words in (
        "vessel-gym ablate",
        "numpy",
        "SHA-256",
        "1000000000 to 1000000007",
        "1000 environment steps",
        "input prior",
    ):
        assert words in html.replace("<span>", "").replace("</span>", "")
    for condition in learned.conditions:
        assert condition in html


@pytest.mark.slow
def test_everything_is_written_and_every_table_in_two_forms(small, tmp_path):
    report, path = page(small, tmp_path), write_report(small, tmp_path)
    assert path == tmp_path / "report.html"
    assert path.read_text(encoding="utf-8") == render(report)
    assert not re.search(r'(?:src|href)="(?!data:)', render(report))
    names = [t.name for t in report.tables]
    files = {p.name for p in (tmp_path / "tables").iterdir()}
    assert files == {f"{name}{suffix}" for name in names for suffix in (".csv", ".md")}
    episodes = list(
        csv.reader(io.StringIO((tmp_path / "episodes.csv").read_text(encoding="utf-8")))
    )
    assert len(episodes) == 1 + 8 * len(small.plan.flights)


def test_every_table_has_a_name_of_its_own(taught):
    names = [t.name for t in taught.tables]
    assert len(names) == len(set(names))
    assert all(re.fullmatch("[a-z0-9-]+", name) for name in names)


@pytest.mark.slow
def test_the_same_results_give_the_same_page(small, short):
    assert render(page(small, OUT)) == render(short)


@pytest.mark.slow
def test_the_classical_agent_may_keep_more_than_the_truth_and_nothing_is_clipped():
    found = results(
        replace(study((CORVETTE,)), agents=(CLASSICAL,)), QUALITY | {"ekf": 1.3, "kf": -0.5}
    )
    shown = rows(page(found, OUT), "ranking")
    assert float(shown["", "ekf"][CORVETTE].split()[0]) > 1.2
    assert shown["", "kf"][CORVETTE].startswith("−0.")
