"""Search for the best parameters by a derivative-free trust region: SciPy's COBYQA.

On common random numbers the mean score is nearly a smooth function of the parameters.
"""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.files import write_text
from agents.tuning.arm import Parameter, Values

RADIUS = 0.3
"""Radius of the trust region at the start, as a share of each range."""
SHRUNK = 0.1
"""Share of its first radius at which a trust region has done its work."""
SPREAD = 0.05
"""Standard deviation of the start of all searches but the first, as a share of each range."""


class Journal:
    """Evaluations of a search, in a file to which each is appended as soon as it is known.

    A search that begins with a journal of its own takes its scores from there first. It asks for
    the same points again, so that it ends as it would have without the interruption.

    Args:
        path: File; None: the journal is kept in memory.
        made_by: What decides the course of the search, as plain data.

    Attributes:
        points: Evaluations so far, as points of the unit cube and scores.

    Raises:
        ValueError: for a damaged file, or one of another search.
        OSError: if the file cannot be read or written.
    """

    def __init__(self, path: Path | None, made_by: Any) -> None:
        self.path, self.points = path, list[tuple[list[float], float]]()
        head = json.dumps(made_by, sort_keys=True)
        self._kept = list[tuple[list[float], float]]()
        if path is None:
            return
        if path.exists():
            self._kept = _evaluations(path, head)
        text = "".join(f"{line}\n" for line in (head, *map(json.dumps, self._kept)))
        write_text(path, text)

    @property
    def finite(self) -> list[tuple[list[float], float]]:
        """Evaluations that did not fail."""
        return [each for each in self.points if math.isfinite(each[1])]

    def score(self, point: np.ndarray, evaluate: Callable[[], float]) -> float:
        """The score of a point: as kept, or else evaluated and kept."""
        place, asked = len(self.points), point.tolist()
        if place < len(self._kept) and self._kept[place][0] == asked:
            found = self._kept[place][1]
        else:
            found = evaluate()
            if self.path is not None:
                with self.path.open("a", encoding="utf-8") as file:
                    file.write(f"{json.dumps([asked, found])}\n")
        self.points.append((asked, found))
        return found


def _evaluations(path: Path, head: str) -> list[tuple[list[float], float]]:
    """Points and scores in a journal; a line that a killed process left unfinished is not read.

    Raises:
        ValueError: as `Journal`.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    first, *lines = text.split("\n")[:-1] or [""]
    if first != head:
        raise ValueError(
            f"{path} is the journal of another tuning or of another version: remove it, or choose"
            " another --out"
        )
    try:
        return [([*map(float, point)], float(score)) for point, score in map(json.loads, lines)]
    except (ValueError, TypeError):
        raise ValueError(f"{path} is damaged: remove it, or choose another --out") from None


def search(
    score: Callable[[Values], float],
    parameters: Mapping[str, Parameter],
    evaluations: int,
    seed: int,
    journal: Journal,
    progress: Callable[[int, float], None] = lambda done, best: None,
) -> Values:
    """The best values of parameters that a search has seen.

    Whenever the trust region has shrunk, another one begins about the best so far: the second with
    half of the first radius, the third with a third of it. A score that is rough in the small, as
    where episodes end in a hit or a miss, makes a region shrink before its time.

    Args:
        score: Score of some values, to be maximised; not finite for values that fail. To the
            search these score 1 less than the worst so far; they are never the best.
        parameters: What is searched.
        evaluations: Largest number of scores.
        seed: 0: the search begins at the delivered values; else at a point near them that the seed
            draws. The result is never worse than the start, which is the first candidate: COBYQA
            itself moves it away from near bounds, or onto them.
        journal: Takes the evaluations.
        progress: Called after each with the number so far and the best score. A KeyboardInterrupt
            ends the search, and the best so far is returned.

    Raises:
        ValueError: if all values fail.
    """
    from scipy.optimize import minimize

    ranges = {name: each.range for name, each in parameters.items()}

    def values(point: np.ndarray) -> Values:
        return {
            name: r.from_unit(share) for (name, r), share in zip(ranges.items(), point, strict=True)
        }

    def loss(point: np.ndarray) -> float:
        point = np.clip(point, 0.0, 1.0)
        found = journal.score(point, lambda: score(values(point)))
        scores = [each for _, each in journal.finite]
        progress(len(journal.points), max(scores, default=math.nan))
        return -found if math.isfinite(found) else 1.0 - min(scores, default=0.0)

    start = np.array([r.to_unit(parameters[name].value) for name, r in ranges.items()])
    if seed:
        start = start + np.random.default_rng(seed).normal(0.0, SPREAD, len(start))
    region = 0
    try:
        loss(start)
        while left := evaluations - len(journal.points):
            region += 1
            first, bounds = RADIUS / region, [(0.0, 1.0)] * len(start)
            ends = {"initial_tr_radius": first, "final_tr_radius": SHRUNK * first, "maxfev": left}
            minimize(loss, np.clip(start, 0.0, 1.0), method="COBYQA", bounds=bounds, options=ends)
            start = _best(journal)
    except KeyboardInterrupt:
        if not journal.finite:
            raise
    return values(_best(journal))


def _best(journal: Journal) -> np.ndarray:
    """The point with the highest finite score so far."""
    if not journal.finite:
        raise ValueError("no candidate has a finite score: evaluate the arm before you tune it")
    return np.array(max(journal.finite, key=lambda each: each[1])[0])
