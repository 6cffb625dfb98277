"""The page on Hermawan's five simulations."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.page import Entry, Table, entry, words
from agents.statistics import Interval, mean_interval, paired_difference
from studies.papers.corvette.experiment import MODELS, PRIOR, QUANTITIES, TRIAL, explain
from studies.papers.measures import EXPLORATORY, Comparison, Report, comparison_table, row, rows
from studies.papers.template import fill
from vessel_gym.tasks.turning_trial import SWITCH
from vessel_gym.vehicles.corvette_thesis import NOISE, SIMULATIONS

_TELLING = 0.05
"""Share of an error by which it must change for a claim to count it."""
_STEPS = (
    ("A larger Q alone changes nothing significant", "sec. 4.5, II", "I", "II"),
    (
        "A larger R alone raises the error, if not significantly",
        "secs. 4.5, III, and 5.1",
        "I",
        "III",
    ),
    ("A larger Q and R raise the error", "secs. 4.5, IV, and 5.1", "I", "IV"),
    ("A larger d raises the error", "secs. 4.5, V, and 5.1", "I", "V"),
)


def report(settings: Mapping[str, Any], results: Mapping[str, Mapping[str, Any]]) -> Report:
    """Page and measures, from the values of every job."""
    open_, printed = settings["open"], settings["printed"]
    rmse = {
        (simulation, model): np.asarray(results[f"{simulation}, {model}"]["rmse"])
        for simulation in SIMULATIONS for model in MODELS
    }  # fmt: skip
    choices = {name: choice["believed"] for name, choice in open_.items()}
    believed = explain(choices, settings["runs"], settings["seed"])
    before = _comparisons(printed, {s: rmse[s, MODELS[0]] for s in SIMULATIONS}, circular=True)
    after = _comparisons(printed, believed)
    columns = {"before the search": before, "believed": after}
    tables = {
        "published": comparison_table(columns),
        "choices": _choices(open_),
        "models": _models(rmse),
    }
    least = sum(float(p["means"][1]) < np.sqrt(SIMULATIONS[s].R / 2.0) for s, p in printed.items())
    way = (
        f"{settings['paper']}, believed ({EXPLORATORY}, of {settings['search']['combinations']:,})"
    )
    counted = row(way, "simulations I to V", after)
    page, opening = fill(
        Path(__file__).parent, tables, settings=settings, noise=f"{NOISE:g}",
        choices=len(open_), prior=PRIOR, switch=SWITCH,
        helm=np.rad2deg(TRIAL.helm), step=TRIAL.dt,
        factor=_factor(printed, believed), factor_before=_factor(printed, {s: rmse[s, MODELS[0]] for s in SIMULATIONS}),
        claims=[_claim(rmse, *step) for step in _STEPS], order=_order(rmse), least=least, near=counted.near,
        small=_small(rmse), driven=_driven(results), ratio=_ratio_law(rmse), believed=choices,
        left={s: _left(SIMULATIONS[s].R, choices["prior"]) for s in ("I", "III")},
    )  # fmt: skip
    return Report(page, [*rows(settings["paper"], before), counted], opening)


def _comparisons(
    printed: Mapping[str, Any], ours: Mapping[str, np.ndarray], circular: bool = False
) -> list[Comparison]:
    """The ten means of Table 4.9 beside ours ``(2, runs)``; the d of II gave the noise, so that it is circular."""
    return [
        Comparison(
            f"simulation {s}", quantity, "rad", printed[s]["means"][i], printed[s]["where"], ours[s][i], averaged=3,
            reason="the noise was taken from it" if circular and (s, i) == ("II", 1) else "",
        )
        for s in SIMULATIONS for i, quantity in enumerate(QUANTITIES)
    ]  # fmt: skip


def _factor(printed: Mapping[str, Any], ours: Mapping[str, np.ndarray]) -> float:
    """Exp of the mean absolute log ratio over all ten means."""
    logs = [
        np.log(ours[s][i].mean() / float(printed[s]["means"][i]))
        for s in SIMULATIONS
        for i in range(2)
    ]
    return float(np.exp(np.abs(logs).mean()))


def _left(R: float, prior: float) -> float:
    """Share of a wrong first heading that goes into the first estimate of d: ``R / (prior + 2 R)``, in %."""
    return 100.0 * R / (prior + 2.0 * R)


# --- claims ---------------------------------------------------------------------------------------


def _claim(
    rmse: Mapping[tuple[str, str], np.ndarray], text: str, where: str, before: str, after: str
) -> dict[str, str]:
    """Verdict on a rise of the errors of heading and d, paired over the runs."""
    pairs = [(rmse[before, MODELS[0]][i], rmse[after, MODELS[0]][i]) for i in range(2)]
    rises = [paired_difference(second, first) for first, second in pairs]
    shares = [
        0.0 if i is None else i.mean / first.mean()
        for i, (first, _) in zip(rises, pairs, strict=True)
    ]
    signs = {int(np.sign(share)) if abs(share) > _TELLING else 0 for share in shares}
    verdicts = {
        frozenset({1}): "raises both",
        frozenset({-1}): "lowers both",
        frozenset({0}): "changes neither by 5 %",
    }
    changes = ", ".join(
        f"{q} × {b.mean() / a.mean():#.3g}" for q, (a, b) in zip(QUANTITIES, pairs, strict=True)
    )
    evidence = "; ".join(f"{q} {_mrad(rise)}" for q, rise in zip(QUANTITIES, rises, strict=True))
    true = {1} if "raise" in text else {0}
    outcome = verdicts.get(frozenset(signs), "differs between heading and d")
    return {
        "text": f"{text} ({before} to {after}; {where})", "evidence": f"{changes}; {evidence}",
        "verdict": f"{'true' if signs == true else 'false'}, at a fixed noise it {outcome}",
    }  # fmt: skip


def _mrad(interval: Interval | None) -> str:
    """A difference in words, rounding errors being none."""
    scaled = interval and Interval(
        *(round(1e3 * x, 6) + 0.0 for x in (interval.mean, interval.low, interval.high))
    )
    return f"{words(scaled, 3, signed=True)} mrad"


def _order(rmse: Mapping[tuple[str, str], np.ndarray]) -> dict[str, str]:
    """The remark below Table 4.8, that d errs less than the heading."""
    differences = {s: paired_difference(*rmse[s, MODELS[0]]) for s in SIMULATIONS}
    shown = sum(i is not None and i.low > 0.0 for i in differences.values())
    return {
        "verdict": "true" if shown == len(SIMULATIONS) else "undecided",
        "evidence": "; ".join(f"{s} {_mrad(i)}" for s, i in differences.items()),
    }


def _small(rmse: Mapping[tuple[str, str], np.ndarray]) -> int:
    """In how many simulations the heading errs by less than the difference of the two measurements, √2 of the noise."""
    intervals = [mean_interval(rmse[s, MODELS[0]][0] - np.sqrt(2.0) * NOISE) for s in SIMULATIONS]
    return sum(i is not None and i.high < 0.0 for i in intervals)


def _driven(results: Mapping[str, Any]) -> float:
    """Largest difference [rad] of errors in I and V where d drives the heading as well."""
    small, large = (np.asarray(results[f"driven, {name}"]["rmse"]) for name in ("I", "V"))
    return float(np.abs(small - large).max())


def _ratio_law(rmse: Mapping[tuple[str, str], np.ndarray]) -> list[str]:
    """Heading errors of I and IV, whose Q and R have the same ratio."""
    return [words(mean_interval(rmse[s, MODELS[0]][0]), 5) for s in ("I", "IV")]


# --- tables -----------------------------------------------------------------------------


def _choices(open_: Mapping[str, Any]) -> Table:
    head = [("before the search", ""), ("believed", ""), ("where", "")]
    lines = [
        (
            name.replace("_", " "),
            [Entry(str(c["first"])), Entry(str(c["believed"])), Entry(c["where"])],
        )
        for name, c in open_.items()
    ]
    return Table("", "", "choice", head, [("", lines)], "choices")


def _models(rmse: Mapping[tuple[str, str], np.ndarray]) -> Table:
    """Both filter models as they were set up before the search."""
    lines = [
        (s, [entry(mean_interval(rmse[s, model][i]), 5) for model in MODELS for i in range(2)])
        for s in SIMULATIONS
    ]
    head = [(f"{quantity}, {model}", "rad") for model in MODELS for quantity in QUANTITIES]
    return Table("", "", "simulation", head, [("", lines)], "models")
