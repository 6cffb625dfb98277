"""Errors of open-loop simulations of runs, and the targets of their median and largest values."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from studies.tables.markdown import WITHOUT, table
from vessel_gym.identification.score import Predict, ahead
from vessel_gym.identification.trial import Trial

TESTS = ("turn", "zigzag")
"""Beginnings of the names of runs that begin where the rudder is put over."""
AHEAD = 60.0
"""Time [s] of predictions from every second moment."""


class _Figure(NamedTuple):
    """An error of runs: beginnings of their names, its name and decimals, targets of its median and largest value."""

    title: str
    runs: tuple[str, ...]
    name: str
    decimals: int
    targets: tuple[float, float | None]


_FIGURES = (
    _Figure("steady yaw rate [%]", ("turn",), "steady yaw rate", 1, (2.5, 5.0)),
    _Figure("steady surge [%]", ("turn",), "steady surge", 1, (4.0, 10.0)),
    _Figure("yaw rate, turns", ("turn",), "yaw rate", 3, (0.06, 0.10)),
    _Figure("yaw rate, zig-zags", ("zigzag",), "yaw rate", 2, (0.15, 0.25)),
    _Figure("yaw rate, random and berthing", ("random", "berthing"), "yaw rate", 2, (0.30, 0.45)),
    _Figure("position after one circle [L]", ("turn",), "circle", 2, (0.5, 1.0)),
    _Figure("heading after 60 s [°]", ("",), "heading", 1, (9.0, None)),
    _Figure("position after 60 s [L]", ("",), "position", 2, (0.40, None)),
)
_MODEL, _RIVALS = "identified model", ("without wind", "Nomoto, order 2", "goes on as it goes")


def accuracy(predict: Predict, run: Trial, part: Trial, length: float) -> dict[str, float]:
    """Errors of a simulation that begins at the first state of a part of a run; NaN of what it does not show.

    That of a turn or zig-zag ends where the propeller stops for good, if it turns at all. Steady values are means over
    whole circles after the first half of one, or over what follows it if that is less.

    Args:
        predict: The model.
        run: The whole run.
        part: The run from where the rudder is put over, or the whole run.
        length: Of the ship [m].
    """
    turns = run.name.startswith("turn")
    turning = np.flatnonzero(part.control[:, 1])
    if run.name.startswith(TESTS) and turning.size:
        part = part.part(0, 1 + int(turning[-1]))
    states, measured = predict(part.states[:1], part.control[:, None], part.air[:, None])[:, 0], part.states
    turned = np.abs(measured[:, 2] - measured[0, 2])
    rate = measured[:, 5]
    error = np.sqrt(np.mean((states[:, 5] - rate) ** 2))
    heading, position = ahead(predict, run, length, AHEAD)
    found = {
        "yaw rate": error / (np.sqrt(np.mean(rate**2)) if turns else rate.std()),
        "heading": np.rad2deg(heading), "position": position,
        "steady yaw rate": np.nan, "steady surge": np.nan, "circle": np.nan,
    }  # fmt: skip
    first = int(np.argmax(turned >= np.pi))
    if turns and first:
        circles = int((turned[-1] - np.pi) / (2.0 * np.pi))
        last = int(np.argmax(turned >= (1.0 + 2.0 * circles) * np.pi)) if circles > 0 else len(turned)
        for name, i in (("steady yaw rate", 5), ("steady surge", 3)):
            found[name] = 100.0 * abs(states[first:last, i].mean() / measured[first:last, i].mean() - 1.0)
    if turns and turned.max() >= 2.0 * np.pi:
        once = int(np.argmax(turned >= 2.0 * np.pi))
        found["circle"] = np.hypot(*(states - measured)[once, :2]) / length
    return {name: float(value) for name, value in found.items()}


def accuracies(runs: Sequence[dict[str, Any]]) -> str:
    """Median and largest errors of the model beside their targets, and medians of simpler models."""
    rows = []
    for each in _FIGURES:
        of = {name: _values(runs, each, name) for name in (_MODEL, *_RIVALS)}
        model = "; ".join(_cell(value, each.decimals) for value in (np.median(of[_MODEL]), np.max(of[_MODEL])))
        targets = "; ".join(WITHOUT if value is None else f"{value:g}" for value in each.targets)
        rows.append((each.title, model, targets, *(_cell(np.median(of[name]), each.decimals) for name in _RIVALS)))
    return table(("error", "model", "target", *_RIVALS), rows)


def met(runs: Sequence[dict[str, Any]]) -> tuple[list[str], list[str]]:
    """Medians and largest values within their targets, and those beyond."""
    within: list[str] = []
    beyond: list[str] = []
    for each in _FIGURES:
        values = _values(runs, each, _MODEL)
        for word, value, target in zip(
            ("median", "largest"), (np.median(values), values.max()), each.targets, strict=True
        ):
            if target is not None and not np.isnan(value):
                (within if value <= target else beyond).append(f"{each.title.split(' [')[0]} ({word})")
    return within, beyond


def largest(runs: Sequence[dict[str, Any]]) -> dict[str, int]:
    """Names of the runs with the largest errors of the model, and how many of them each has, most first."""
    counts: Counter[str] = Counter()
    for each in _FIGURES:
        of = {run["name"]: run["accuracy"][_MODEL][each.name] for run in runs if run["name"].startswith(each.runs)}
        if known := {name: value for name, value in of.items() if value is not None}:
            counts[max(known, key=lambda name: known[name])] += 1
    return dict(counts.most_common())


def _values(runs: Sequence[dict[str, Any]], figure: _Figure, model: str) -> np.ndarray:
    """Of the runs that show it; NaN of none."""
    of = [run["accuracy"][model][figure.name] for run in runs if run["name"].startswith(figure.runs)]
    return np.array([each for each in of if each is not None] or [np.nan])


def _cell(value: float, decimals: int) -> str:
    return WITHOUT if np.isnan(value) else f"{value:.{decimals}f}"
