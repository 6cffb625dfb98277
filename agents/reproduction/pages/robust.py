"""The page on the robust filters: the figures of the paper beside ours, and its claim put to the test."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from agents.page import Claim, Entry, Page, Table, entry, listed, number, words
from agents.reproduction.pages.comparison import geometric_ratio
from agents.reproduction.pages.robust_figures import figures
from agents.reproduction.pages.robust_results import (
    MODEL_ERRORS,
    NOTHING,
    OTHERS,
    ROBUST,
    SHOWN,
    SHOWN_TITLES,
    WHERE,
    Results,
    mean_ratio,
    percent,
    rmse_of_units,
    system_traits,
    unit_ratios,
)
from agents.reproduction.pages.template import fill
from agents.reproduction.settings import robust as settings
from agents.reproduction.settings.robust import Condition
from agents.statistics import Interval

_SIZE, _RATE = f"{settings.OUTLIERS.size:g}", percent(settings.OUTLIERS.rate)
_MODEL_ERRORS = [c for key in ("tolerance", "parameters") for c in settings.SWEEPS[key] if getattr(c, key)]
_OUTLIERS = list(dict.fromkeys(c for key in ("rate", "size") for c in settings.SWEEPS[key] if c.rate))


def page(results: Results) -> Page:
    """The page, from the values of every cell under the same names."""

    def to_kf(condition: Condition, name: str = "huber-kf") -> Interval:
        return mean_ratio(results, settings.RANDOM, condition, name)

    largest, traits, example = settings.SWEEPS["parameters"][-1], system_traits(), results["example"]
    hit_kf, free_kf = (rmse_of_units(results, settings.RANDOM, c, "kf") for c in (settings.OUTLIERS, NOTHING))
    hit = to_kf(settings.OUTLIERS)
    return fill(
        "robust", _tables(results), figures(results), settings=settings, random=settings.POPULATIONS[settings.RANDOM],
        pays="pays" if hit.high < 1.0 else "loses" if hit.low > 1.0 else "makes no certain difference",
        minimax=[
            {"c": c, "model_errors": _balance(results, _MODEL_ERRORS, name), "free": to_kf(NOTHING, name),
             "outliers": _balance(results, _OUTLIERS, name)}
            for name, c in zip(ROBUST, settings.TOLERANCES, strict=True)
        ],
        rate=_RATE, size=_SIZE, hit=hit, free=to_kf(NOTHING), wrong=to_kf(largest), largest=percent(largest.parameters),
        example=example, steady=example["steady"], lower=_lower_claims(results), crossed=_crossed_claims(results),
        costs=[_cost(name, to_kf(NOTHING, name)) for name in OTHERS], consistent=_consistency(results),
        seeds=settings.POPULATIONS[settings.RANDOM].seeds, disturbed=percent(settings.DISTURBANCE.rate),
        better=[_crossed_words(results, name) for name in settings.CROSSED],
        ranks=[
            f"{number(_spearman(traits[trait], unit_ratios(results, condition, name)), 2, signed=True)} between the "
            f"ratio of {name} ({SHOWN_TITLES[SHOWN.index(condition)]}) and the {label}"
            for name, condition, trait, label in WHERE
        ],
        hurt=_spearman(traits["doubt"], hit_kf / free_kf), **_figure_claims(results),
    )  # fmt: skip


# --- tables -----------------------------------------------------------------------------------------


def _tables(results: Results) -> dict[str, Table]:
    """The tables by name; most have the error of the KF and the ratios to it."""

    def labelled(key: str, form: str) -> list[tuple[str, Condition]]:
        shown = percent if key in ("rate", "parameters") else "{:g}".format
        return [(form.format(shown(getattr(c, key))), c) for c in settings.SWEEPS[key]]

    crossed = {
        MODEL_ERRORS[name]: [(f"{percent(c.rate)} outliers", c) for c in conditions]
        for name, conditions in settings.CROSSED.items()
    }
    alone = ("nothing wrong", f"{_RATE} outliers of {_SIZE} σ", f"A off by {percent(settings.PARAMETERS.parameters)}")
    compared: dict[str, Mapping[str, Sequence[tuple[str, Condition]]]] = {
        "outliers": {
            f"outliers of {_SIZE} σ": labelled("rate", "{} of readings"),
            f"{_RATE} outliers": labelled("size", "of {} σ"),
        },
        "model-error": {
            "least-favourable model": labelled("tolerance", "c = {}"), "error of A": labelled("parameters", "δ = {}")
        },
        "both": crossed,
        "one-reading": {"": list(zip(alone, settings.ALONE, strict=True))},
    }  # fmt: skip
    head = [("KF, RMSE", ""), *((f"{name} / KF", "") for name in OTHERS)]
    tables = {}
    for name, groups in compared.items():
        sections = [
            ("; ".join(filter(None, (settings.POPULATIONS[population].title, group))),
             [_row(results, population, *row) for row in rows])
            for population in (settings.RANDOM, settings.ONE_READING if name == "one-reading" else settings.PAPER)
            for group, rows in groups.items()
        ]  # fmt: skip
        tables[name] = Table("", "", "condition", head, sections, name)
    verdict = Entry("not comparable: no number is printed; shape as below")
    printed = [(name, [Entry(what), verdict]) for name, what in settings.FIGURES.items()]
    tables["figures"] = Table("", "", "figure", [("shows", ""), ("verdict", "")], [("", printed)])
    return tables | {"systems": _spread_table(results), "halves": _halves_table(results)}


def _row(results: Results, population: str, label: str, condition: Condition) -> tuple[str, list[Entry]]:
    kf = np.exp(np.log(rmse_of_units(results, population, condition, "kf")).mean())
    ratios = [_ratio_entry(mean_ratio(results, population, condition, name)) for name in OTHERS]
    return label, [Entry(number(float(kf), 2)), *ratios]


def _ratio_entry(ratio: Interval) -> Entry:
    """Bold where the interval excludes 1."""
    return replace(entry(ratio, 3), strong=ratio.high < 1.0 or ratio.low > 1.0)


def _spread_table(results: Results) -> Table:
    sections = []
    for title, condition in zip(SHOWN_TITLES, SHOWN, strict=True):
        rows = []
        for name in OTHERS:
            ratios = unit_ratios(results, condition, name)
            share = number(100.0 * float((ratios < 1.0).mean()), 0)
            quantiles = [number(float(q), 2) for q in np.quantile(ratios, (0.0, 0.1, 0.5, 0.9, 1.0))]
            rows.append((name, [Entry(value) for value in (share, *quantiles)]))
        sections.append((title, rows))
    head = [("systems below the KF", "%"), *((label, "") for label in ("best", "10 %", "median", "90 %", "worst"))]
    return Table("", "", "filter", head, sections, "systems")


def _halves_table(results: Results) -> Table:
    """Ratios in the systems whose readings show their weakest direction better, and worse, than the median's do."""
    weakest = system_traits()["weakest"]
    shown = weakest > np.median(weakest)

    def entries(condition: Condition, half: np.ndarray) -> list[Entry]:
        ratios = (unit_ratios(results, condition, name)[half] for name in OTHERS)
        return [_ratio_entry(geometric_ratio(each, np.ones(len(each)))) for each in ratios]

    sections = [
        (title, [(label, entries(condition, half)) for label, condition in zip(SHOWN_TITLES, SHOWN, strict=True)])
        for half, title in ((shown, "weakest direction shown better than the median"), (~shown, "shown worse"))
    ]
    return Table("", "", "condition", [(f"{name} / KF", "") for name in OTHERS], sections, "halves")


# --- claims -----------------------------------------------------------------------------------------


def _verdict(ratios: Sequence[Interval]) -> str:
    """Verdict on all ratios below 1: "true", "false" where one is above beyond chance, else "undecided"."""
    if all(ratio.high < 1.0 for ratio in ratios):
        return "true"
    below, above = sum(ratio.high < 1.0 for ratio in ratios), sum(ratio.low > 1.0 for ratio in ratios)
    return f"{'false' if above else 'undecided'}, below in {below} and above in {above} of {len(ratios)}"


def _lower(results: Results, text: str, name: str, sweep: Sequence[tuple[str, Condition]]) -> Claim:
    """The claim that a filter has less error than the KF in every condition, over the random systems."""
    ratios = [mean_ratio(results, settings.RANDOM, condition, name) for _, condition in sweep]
    evidence = "; ".join(f"{label}: {words(ratio, 3)}" for (label, _), ratio in zip(sweep, ratios, strict=True))
    return Claim(text, _verdict(ratios), evidence)


def _lower_claims(results: Results) -> list[Claim]:
    """The claims on one thing wrong at a time."""

    def lower(name: str, key: str, form: Callable[[float], str], where: str, every: str = "") -> Claim:
        sweep = [(form(getattr(c, key)), c) for c in settings.SWEEPS[key] if getattr(c, key)]
        return _lower(results, f"{where} {name} has less error than the KF{every}.", name, sweep)

    found = [
        lower("huber-kf", "rate", percent, "Under outliers of 10 σ", " at every rate"),
        lower("huber-kf", "size", "{:g} σ".format, "At 10 % outliers", " at every size"),
    ]
    for name in ROBUST:
        found += [
            lower(name, "tolerance", "c {:g}".format, "Under the least-favourable model"),
            lower(name, "parameters", percent, "With errors of A"),
            lower(name, "rate", percent, "Under outliers"),
        ]
    return [*found, lower("huber-kf", "parameters", percent, "With errors of A")]


def _crossed_claims(results: Results) -> list[Claim]:
    found = []
    for name, conditions in settings.CROSSED.items():
        sweep = [(f"{percent(c.rate)} outliers", c) for c in conditions if c.rate]
        for filter in ("huber-kf", ROBUST[0]):
            text = f"With outliers and {MODEL_ERRORS[name]}, {filter} has less error than the KF."
            found.append(_lower(results, text, filter, sweep))
    return found


def _cost(name: str, ratio: Interval) -> dict[str, Any]:
    """The claim that a filter costs nothing where nothing is wrong."""
    verdict = "false" if ratio.low > 1.0 else "true" if ratio.high < 1.0 else "undecided"
    return {"name": name, "verdict": verdict, "ratio": ratio}


def _consistency(results: Results) -> dict[str, str]:
    """The paper's word "consistently", taken system by system."""
    grounds = [(1, "huber-kf"), *((i, name) for i in (2, 3) for name in ROBUST)]
    shares = {
        f"{name}, {SHOWN_TITLES[i]}": float((unit_ratios(results, SHOWN[i], name) < 1.0).mean()) for i, name in grounds
    }
    everywhere = [label for label, share in shares.items() if share == 1.0]
    verdict = "false" + (f", only {listed(everywhere)}" if everywhere else "")
    return {
        "verdict": "true" if len(everywhere) == len(shares) else verdict,
        "evidence": "; ".join(f"{label}: {100 * share:.0f} %" for label, share in shares.items()),
    }


def _figure_claims(results: Results) -> dict[str, Any]:
    """Claims of the paper on its figures, for the system in its place; the printed algorithm is our kf."""
    kf = results["example"]["kf"]
    errors, gain, variance = (np.asarray(kf[key]) for key in ("rmse", "gain", "variance"))
    affected = {
        name: geometric_ratio(
            *(rmse_of_units(results, settings.PAPER, c, name) for c in (settings.DISTURBANCE, NOTHING))
        )
        for name in settings.FILTERS
    }
    return {
        "errors": errors, "start": np.sqrt(settings.PRIOR_VARIANCE * settings.STATES),
        "settled": np.sqrt(np.mean(errors[settings.SKIPPED :] ** 2)),
        "paper_runs": settings.POPULATIONS[settings.PAPER].runs, "gain": gain[[0, -1], 0],
        "falls": (variance[-1] < variance[0]).all(),
        "variance": [[f"{value:.2f}" for value in variance[k]] for k in (0, -1)],
        "unmoved": [name for name, ratio in affected.items() if ratio.low <= 1.0],
        "affected": "; ".join(f"{name} {words(ratio, 2)}" for name, ratio in affected.items()),
    }  # fmt: skip


# --- words ------------------------------------------------------------------------------------------


def _balance(results: Results, conditions: Sequence[Condition], name: str) -> str:
    """Of how many conditions a filter gains on the KF, of how many it loses, and by how many percent of the error."""
    ratios = [mean_ratio(results, settings.RANDOM, condition, name) for condition in conditions]
    found = []
    for verb, changes in (
        ("gains", [1.0 - ratio.mean for ratio in ratios if ratio.high < 1.0]),
        ("loses", [ratio.mean - 1.0 for ratio in ratios if ratio.low > 1.0]),
    ):
        if changes:
            sizes = dict.fromkeys(number(100.0 * pick(changes), 1) for pick in (min, max))
            found.append(f"{verb} {' to '.join(sizes)} % in {len(changes)}")
    return f"{' and '.join(found) or 'neither gains nor loses beyond chance in any'} of {len(ratios)}"


def _crossed_words(results: Results, name: str) -> str:
    """At which outliers on top of a model error huber-kf has less error than the KF."""
    conditions = settings.CROSSED[name]
    better = [
        percent(c.rate) for c in conditions if mean_ratio(results, settings.RANDOM, c, "huber-kf").high < 1.0
    ]  # fmt: skip
    return f"with the {name} " + (f"at {listed(better)} outliers" if better else "nowhere")


def _spearman(a: np.ndarray, b: np.ndarray) -> float:
    return float(spearmanr(a, b).statistic)
