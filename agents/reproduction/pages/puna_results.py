"""Results of the cells of the PUNA paper: errors, and the printed numbers beside ours."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.page import number
from agents.reproduction.comparison import Comparison
from agents.reproduction.pages.comparison import mean_of
from agents.reproduction.puna import cell_name
from agents.reproduction.settings import puna as paper

Results = Mapping[str, Mapping[str, Any]]


def errors_of(results: Results, level: str, control: str, measured: str) -> np.ndarray:
    """RMS errors ``(sizes, runs, 4)``."""
    return np.asarray(results[cell_name(level, control, measured)]["rmse"])


def errors_of_size(results: Results, level: str, control: str, measured: str, members: int) -> np.ndarray:
    """RMS errors ``(runs, 4)`` of the ensembles of one size."""
    return errors_of(results, level, control, measured)[paper.MEMBERS.index(members)]


def runs(results: Results) -> int:
    """Number of flights behind a number."""
    return errors_of(results, "flight", "constant", "all").shape[1]


def keeps_flying(results: Results, level: str, control: str) -> np.ndarray:
    """Mask ``(runs,)`` of the flights that keep an airspeed of 2 m/s or more, where gamma's equation is sound."""
    return np.asarray(results[cell_name(level, control, "all")]["slowest"]) >= 2.0


def comparisons(results: Results, level: str) -> list[Comparison]:
    """The eight printed errors beside ours, at one noise level, for either set of measurements."""
    found = []
    for control in paper.CONTROLS:
        members = paper.PRINTED_MEMBERS[control]
        for i, (state, published) in enumerate(zip(paper.STATES, paper.PRINTED[control], strict=True)):
            for measured, name in paper.MEASURED.items():
                ours = mean_of(errors_of_size(results, level, control, measured, members)[:, i])
                row = f"{control} angle of attack, {members} members"
                why = _why_above(results, level, control, measured, i)
                found.append(Comparison(row, f"{state.symbol}, {name} measured", published, ours, above=why))
    return found


def _why_above(results: Results, level: str, control: str, measured: str, i: int) -> str:
    """Why an error may be above the printed one, with what was measured to support it."""
    members, decimals = paper.PRINTED_MEMBERS[control], 4
    if measured == "x":
        every = errors_of_size(results, level, control, "all", members)[:, i].mean()
        if paper.STATES[i].symbol == "x":
            other = next(name for name in paper.LEVELS if name != level)
            there = errors_of_size(results, other, control, "x", members)[:, i].mean()
            return f"Q and R are free: with the {paper.LEVELS[other].title} it is {number(there, decimals)}"
        return f"x hardly shows it; with every state measured, the same flights give {number(every, decimals)}"
    flying = keeps_flying(results, level, control)
    if i == 0 and not flying.all():
        there = errors_of_size(results, level, control, "all", members)[flying, i].mean() if flying.any() else np.nan
        return (
            f"in {100 * (1 - flying.mean()):.0f} % of the flights the airspeed falls below 2 m/s, and the equation "
            f"of γ divides by it; in the others it is {number(there, decimals)}, and Q and R are free"
        )
    scaled_errors = results[f"{level}, scaled"]
    halved = np.asarray(scaled_errors["rmse"])[paper.SCALES.index((0.5, 0.5)), :, i].mean()
    return f"Q and R are free: with both halved it is {number(halved, decimals)} (constant angle, 100 members)"
