"""Tables and sentences of docs/logs-findings.md, from the stored results."""

import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from agents.page import listed
from studies.logs.accuracy import accuracies, largest, met
from studies.tables.markdown import ROOT, WITHOUT, interval, put, table

PAGE, STORED = ROOT / "docs/logs-findings.md", Path(__file__).with_name("summary.json")
KINDS = {"turn": "turns", "zigzag": "zig-zags", "random": "random", "berthing": "berthing"}
"""Beginnings of the runs' names, and what they are called."""


@cache
def stored() -> dict[str, Any]:
    """Results of the last computation."""
    found: dict[str, Any] = json.loads(STORED.read_text(encoding="utf-8"))
    return found


def turns() -> str:
    """Advance, tactical diameter and speed loss of the turns."""
    rows = [
        (
            _label(run),
            *(_pair(run[key], decimals) for key, decimals in _TURN.items()),
            _cell(run["track error"][_MODEL][2], 2),
        )
        for run in _runs("turn")
    ]
    heads = ("turn", "advance [L]", "tactical diameter [L]", "speed loss [%]", "track error after 10 L [L]")
    return table(heads, rows)


_TURN = {"advance": 2, "tactical diameter": 2, "speed loss": 0}
_MODEL = "identified model"


def zigzags() -> str:
    """Overshoots and periods of the zig-zags."""
    rows = []
    for run in _runs("zigzag"):
        overshoots, periods = (_paired(run[key]) for key in ("overshoots", "periods"))
        rows.append((
            _label(run), str(overshoots.shape[1]), _pair(_means(overshoots), 1),
            _cell(np.abs(np.diff(overshoots, axis=0)).max(initial=0.0), 1), _pair(_means(periods), 1),
            _cell(run["track error"][_MODEL][2], 2),
        ))  # fmt: skip
    heads = ("zig-zag", "overshoots", "their mean [°]", "largest difference [°]", "mean period [s]",
             "track error after 10 L [L]")  # fmt: skip
    return table(heads, rows)


def tracks() -> str:
    """Median and largest track errors by kind of run, beside those of simpler models."""
    rows = []
    for kind, name in KINDS.items():
        runs = _runs(kind)
        of = {each: np.array([run["track error"][each] for run in runs], float) for each in (_MODEL, *_RIVALS)}
        after = ("; ".join(_cell(each, 2) for each in _ends(of[_MODEL][:, k])) for k in (1, 2))
        rivals = (_cell(_ends(of[each][:, 1])[0], 2) for each in _RIVALS)
        rows.append((f"{name} ({len(runs)})", *after, *rivals))
    heads = ("runs", "model, 5 L; largest", "model, 10 L; largest", *(f"{each}, 5 L" for each in _RIVALS))
    return table(heads, rows)


_RIVALS = ("without wind", "Nomoto, order 2", "goes on as it goes")


def filters() -> str:
    """Consistency of filters at sea and in simulation."""
    rows = []
    for name, runs in stored()["filters"].items():
        if not (both := _both(runs)):
            rows.append((f"`{name}`", runs[0]["error"], *[WITHOUT] * 4))
            continue
        inside = {place: 100.0 * np.array([each[place]["inside"] for each in both]) for place in _PLACES}
        ratio = {place: np.array([each[place]["ratio"] for each in both]) for place in _PLACES}
        near = {place: int(((ratio[place] > 0.5) & (ratio[place] < 2.0)).sum()) for place in _PLACES}
        rows.append((
            f"`{name}`", *(f"{inside[place].mean():.0f} %" for place in _PLACES), interval(_difference(runs), 1),
            f"{near['measured']} / {near['simulated']} of {len(both)}",
            _pair([np.median([each[place]["lag"] for each in both]) for place in _PLACES], 2),
        ))  # fmt: skip
    heads = ("filter", "NIS inside, at sea", "simulated", "difference [points]", "runs within a factor 2",
             "lag 1, median")  # fmt: skip
    return table(heads, rows)


_PLACES = ("measured", "simulated")
_SENSORS = {
    "position": (1.0, "m"),
    "heading": (float(np.rad2deg(1.0)), "°"),
    "yaw rate": (float(np.rad2deg(1.0)), "°/s"),
}


def withheld() -> str:
    """Shares of each withheld sensor's measurements within two standard deviations, with their median."""
    rows = []
    for name, runs in stored()["filters"].items():
        if not (both := _both(runs)):
            continue
        of = {key: {each: np.array([run["measured"][key][each] for run in both], float) for each in _SENSORS}
              for key in ("withheld", "deviations")}  # fmt: skip
        low = "; ".join(str(int((each < 0.75).sum())) for each in of["withheld"].values())
        shares = (
            f"{100.0 * _pooled(both, each):.0f} % of ± {2.0 * scale * np.median(of['deviations'][each]):.2g} {unit}"
            for each, (scale, unit) in _SENSORS.items()
        )
        rows.append((f"`{name}`", *shares, f"{low} of {len(both)}"))
    return table(("filter", *_SENSORS, "runs below 75 %"), rows)


def targets() -> str:
    """Targets of the errors that are met, and those that are not."""
    within, beyond = met(stored()["runs"])
    errors = _overshoot_errors()
    (within if (errors < 2.0).mean() >= 0.8 and errors.max() < 4.0 else beyond).append("overshoots")
    return fill(
        f"Targets that are met: {'; '.join(within)}. Targets that are not met: {'; '.join(beyond)}. The target for "
        "overshoots: differences below 2 degrees in 80 % of cases, below 4 in all.",
        140,
        break_on_hyphens=False,
    )


def trusted() -> str:
    """Targets of the filters that are met, and by which they are not."""
    sentences = []
    for key, (low, high) in {"NIS": (85.0, 98.0), **dict.fromkeys(_SENSORS, (92.0, 98.0))}.items():
        shares = {f"`{name}`": 100.0 * _pooled(both, key)
                  for name, runs in stored()["filters"].items() if (both := _both(runs))}  # fmt: skip
        bad = [name for name, share in shares.items() if not low <= share <= high]
        by = "all filters" if not bad else "no filter" if len(bad) == len(shares) else f"all filters but {listed(bad)}"
        which = "NIS inside" if key == "NIS" else f"the withheld {key}"
        found = f"{min(shares.values()):.1f} to {max(shares.values()):.1f} %"
        sentences.append(f"The target of {which}, {low:.0f} to {high:.0f} %, is met by {by} ({found}).")
    return fill(" ".join(sentences), 140, break_on_hyphens=False)


def _pooled(runs: Sequence[dict[str, Any]], key: str) -> float:
    """Share over all steps of NIS inside, or of a withheld sensor's measurements."""
    of = [run["measured"]["inside"] if key == "NIS" else run["measured"]["withheld"][key] for run in runs]
    return float(np.average(of, weights=[run["steps"] for run in runs]))


def largest_errors() -> str:
    """Runs with the largest errors of the model in words."""
    counts = largest(stored()["runs"])
    parts = [f"{count} {'is' if count == 1 else 'are'} of `{name}`" for name, count in counts.items()]
    return fill(f"Of the {sum(counts.values())} largest errors {listed(parts)}.", 140, break_on_hyphens=False)


def lowest() -> str:
    """Runs in words on which no filter foretells a withheld sensor."""
    judged = [both for runs in stored()["filters"].values() if (both := _both(runs))]
    sentences = []
    for each in _SENSORS:
        low = [{run["run"] for run in both if run["measured"]["withheld"][each] < 0.75} for both in judged]
        if names := sorted(set.intersection(*low)):
            runs = listed([f"`{name}`" for name in names])
            sentences.append(f"In {runs}, every filter covers less than 75 % of the withheld {each}.")
    found = " ".join(sentences) or "In no run does every filter cover less than 75 % of a withheld sensor."
    return fill(found, 140, break_on_hyphens=False)


def widths() -> str:
    """Standard deviations in words: of a withheld position, and of ensembles beside other filters."""
    from studies.logs.results import SHIP
    from vessel_gym.identification.filtering import ENSEMBLES

    of = {
        name: np.median([[run["measured"]["deviations"][each] for each in _SENSORS] for run in both], 0)
        for name, runs in stored()["filters"].items()
        if (both := _both(runs))
    }
    ends = dict.fromkeys(f"{end(each[0] for each in of.values()) / SHIP.length:.1f}" for end in (min, max))
    sentences = [f"The standard deviation of a withheld position is {' to '.join(ends)} ship lengths in the median."]
    members, others = ([of[name] for name in of if (name in ENSEMBLES) == which] for which in (True, False))
    if members and others:
        ratio = np.mean(members, 0) / np.mean(others, 0)
        parts = [f"{value:.2f} ({each})" for each, value in zip(_SENSORS, ratio, strict=True)]
        sentences.append(f"Ensembles' standard deviations are {listed(parts)} times those of other filters.")
    return fill(" ".join(sentences), 140, break_on_hyphens=False)


def consistency() -> str:
    """The answer in words: filters that are as consistent at sea as in simulation, and those that are not."""
    alike: list[tuple[str, Any]] = []
    apart: list[tuple[str, Any]] = []
    lost = []
    for name, runs in stored()["filters"].items():
        found = _difference(runs)
        failed = sum("error" in run for run in runs)
        if failed:
            lost.append(f"`{name}` on {failed} of {len(runs)} runs")
        if found is not None:
            (apart if found.excludes_zero else alike).append((f"`{name}`", found))
    first = (
        "No filter is as consistent at sea as in simulation"
        if not alike
        else (
            f"As consistent at sea as in simulation, within the interval, {'is' if len(alike) == 1 else 'are'} "
            f"{listed([name for name, _ in alike])}"
        )
    )
    sentences = [first + "."]
    if apart:
        ends = dict.fromkeys(f"{-end(found.mean for _, found in apart):.0f}" for end in (max, min))
        sentences.append(
            f"{listed([name for name, _ in apart])} {'has' if len(apart) == 1 else 'have'} {' to '.join(ends)} "
            "percentage points less NIS inside the interval at sea than in simulation."
        )
    if lost:
        sentences.append(f"Estimates are lost by {listed(lost)}.")
    return fill(" ".join(sentences), 140, break_on_hyphens=False)


def gap() -> str:
    """The gap of manoeuvres in words: median and largest differences of simulated from measured numbers."""
    turning = {key: np.array([run[key] for run in _runs("turn")], float) for key in _TURN}
    share = {key: 100.0 * np.abs(pair[:, 1] / pair[:, 0] - 1.0) for key, pair in turning.items()}
    loss = np.abs(np.diff(turning["speed loss"])[:, 0])
    runs = _runs("zigzag")
    overshoots = _overshoot_errors()
    both = np.concatenate([_paired(run["periods"]) for run in runs], 1).T
    period = 100.0 * np.abs(both[:, 1] / both[:, 0] - 1.0)
    sentences = (
        f"Advance differs by {_spread(share['advance'], 0)} %, tactical diameter by "
        f"{_spread(share['tactical diameter'], 0)} %, and speed loss by {_spread(loss, 0)} points.",
        f"Of {len(overshoots)} overshoots above 1 degree {100.0 * (overshoots < 2.0).mean():.0f} % differ by less than "
        f"2 degrees, and all by less than {np.ceil(10.0 * overshoots.max()) / 10.0:.1f}.",
        f"Periods differ by {_spread(period, 0)} %.",
    )
    return fill(" ".join(sentences), 140, break_on_hyphens=False)


def _overshoot_errors() -> np.ndarray:
    """Of all measured overshoots above 1 degree [degrees]."""
    overshoots = np.concatenate([_paired(run["overshoots"]) for run in _runs("zigzag")], 1)
    found: np.ndarray = np.abs(np.diff(overshoots[:, overshoots[0] > 1.0], axis=0))[0]
    return found


def sensors() -> str:
    """Errors of the sensors in words, from all logs together: weighted by the inverse squares of their intervals."""
    found = []
    for key, factor, decimals in (("surge's lag", 1.0, 2), ("gyro's scale", 100.0, 1)):
        of = factor * np.array([each[key] for each in stored()["sensors"] if each[key] is not None])
        weight = 1.0 / of[:, 1] ** 2
        mean, half = float((weight * of[:, 0]).sum() / weight.sum()), float(1.0 / np.sqrt(weight.sum()))
        said = int((np.abs(of[:, 0]) > of[:, 1]).sum())
        found.append((f"{mean:.{decimals}f} ± {half:.{decimals}f}", f"{said} of {len(of)}"))
    (late, late_in), (off, off_in) = found
    text = (
        f"Surge lags the derivative of the position by {late} s in all logs together; in {late_in} logs the interval "
        f"excludes zero. The heading turns {off} % faster than the gyro says, and in {off_in} logs the interval "
        "excludes zero."
    )
    return fill(text, 140, break_on_hyphens=False)


TABLES: dict[str, Callable[[], str]] = {
    "logs, turns": turns, "logs, zig-zags": zigzags, "logs, tracks": tracks, "logs, filters": filters,
    "logs, withheld": withheld, "logs, accuracy": lambda: accuracies(stored()["runs"]),
}  # fmt: skip
TEXTS: dict[str, Callable[[], str]] = {
    "logs, gap": gap, "logs, sensors": sensors, "logs, consistency": consistency, "logs, targets": targets,
    "logs, filters' targets": trusted, "logs, largest errors": largest_errors, "logs, lowest": lowest,
    "logs, widths": widths,
}  # fmt: skip


def write() -> None:
    """Write them into the page."""
    stored.cache_clear()
    for kind, made in (("table", TABLES), ("text", TEXTS)):
        for name, function in made.items():
            put(PAGE, f"{kind}: {name}", function())


def _runs(kind: str) -> list[dict[str, Any]]:
    return [run for run in stored()["runs"] if run["name"].startswith(kind)]


def _label(run: dict[str, Any]) -> str:
    """Date and time of a run."""
    _, date, *time = run["name"].replace("_cut", "").split("_")
    return f"{date}, {':'.join(time)}"


def _both(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Runs on which a filter kept its estimates."""
    return [run for run in runs if "error" not in run]


def _difference(runs: Sequence[dict[str, Any]]) -> Any:
    """Share of NIS inside [%], measured minus simulated, with its interval over runs."""
    from agents.statistics import paired_difference

    measured, simulated = (100.0 * np.array([run[place]["inside"] for run in _both(runs)], float) for place in _PLACES)
    return paired_difference(measured, simulated) if len(measured) else None


def _pair(values: Sequence[float | None], decimals: int) -> str:
    """Measured and simulated."""
    return " / ".join(_cell(each, decimals) for each in values)


def _paired(values: list[list[float | None]]) -> np.ndarray:
    """Measured and simulated ``(2, n)``, those that are both there."""
    both = np.array(values, float)
    return both[:, np.isfinite(both).all(0)]


def _means(both: np.ndarray) -> Sequence[float]:
    """Of measured and of simulated numbers ``(2, n)``."""
    return both.mean(1).tolist() if both.size else (np.nan, np.nan)


def _cell(value: Any, decimals: int) -> str:
    return WITHOUT if value is None or np.isnan(value) else f"{value:.{decimals}f}"


def _spread(values: np.ndarray, decimals: int) -> str:
    """Median, and the largest value."""
    median, largest = _ends(values)
    return f"{median:.{decimals}f} (at most {largest:.{decimals}f})"


def _ends(values: np.ndarray) -> tuple[float, float]:
    """Median and largest value; NaN of none."""
    known = values[np.isfinite(values)]
    return (float(np.median(known)), float(known.max())) if len(known) else (np.nan, np.nan)
