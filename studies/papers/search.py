"""Likeliest settings of a paper: every combination of what it leaves open, with its log likelihood."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.special import logsumexp

from agents.page import Entry, Table, number


@dataclass(frozen=True)
class Search:
    """Log likelihoods of all combinations of alternatives.

    Attributes:
        choices: The alternatives of each choice, by name; the first is the one made before the search.
        believed: The alternative of each choice that the page believes.
        values: Log likelihoods, an axis a choice.
    """

    choices: Mapping[str, Sequence[Any]]
    believed: Mapping[str, Any]
    values: np.ndarray

    @classmethod
    def of(cls, open_: Mapping[str, Mapping[str, Any]], values: Any) -> "Search":
        """The search over a table of settings whose entries have ``tried`` and ``believed``.

        ``values`` are an array, or a function of a combination.
        """
        choices = {name: choice["tried"] for name, choice in open_.items()}
        if callable(values):
            values = [values(dict(zip(choices, each, strict=True))) for each in product(*choices.values())]
        shape = [len(tried) for tried in choices.values()]
        return cls(choices, {name: c["believed"] for name, c in open_.items()}, np.reshape(values, shape))

    @property
    def first(self) -> dict[str, Any]:
        """The combination made before the search."""
        return {name: tried[0] for name, tried in self.choices.items()}

    def best(self, n: int = 1) -> list[dict[str, Any]]:
        """The most likely combinations."""
        order = np.argsort(-self.values, axis=None, kind="stable")[:n]
        return [self._combination(int(flat)) for flat in order]

    def _combination(self, flat: int) -> dict[str, Any]:
        index = np.unravel_index(flat, self.values.shape)
        return {name: tried[int(i)] for (name, tried), i in zip(self.choices.items(), index, strict=True)}

    def value(self, combination: Mapping[str, Any]) -> float:
        """Log likelihood of a combination.

        Raises:
            ValueError: if it has an alternative that was not tried.
        """
        for name, tried in self.choices.items():
            if combination[name] not in tried:
                raise ValueError(f"{name} = {combination[name]!r} was not tried: add it to {list(tried)}")
        return float(self.values[tuple(list(tried).index(combination[name]) for name, tried in self.choices.items())])

    def below_best(self, combination: Mapping[str, Any]) -> float:
        """Log likelihood below that of the best."""
        return float(self.values.max() - self.value(combination))

    def rank(self, combination: Mapping[str, Any]) -> int:
        """1 for the best."""
        return 1 + int((self.values > self.value(combination)).sum())

    @property
    def verdict(self) -> str:
        """Rank and likelihood of what is believed, in words."""
        below = self.below_best(self.believed)
        return f"rank {self.rank(self.believed):,} of {self.values.size:,}, log likelihood {below:.1f} below the best"

    def drops(self, name: str) -> dict[Any, float]:
        """For each alternative of a choice, how far its best combination is below the best of all."""
        best = self.values.max(axis=self._others(name))
        return dict(zip(self.choices[name], map(float, self.values.max() - best), strict=True))

    def cost(self, name: str, alternative: Any) -> str:
        """The drop of an alternative in words; a dash if it was not tried."""
        return number(self.drops(name).get(alternative, np.nan), 1)

    def shares(self, name: str) -> list[float]:
        """For each alternative, its share of the likelihood if all combinations are equally likely beforehand."""
        sums = logsumexp(self.values, axis=self._others(name))
        return list(np.exp(sums - logsumexp(self.values)))

    def _others(self, name: str) -> tuple[int, ...]:
        """The axes of the other choices."""
        return tuple(i for i, each in enumerate(self.choices) if each != name)

    def ranking(self, n: int, columns: Mapping[str, Sequence[str]]) -> Table:
        """The best, the believed and the first combination by the choices in which they differ.

        Args:
            n: How many of the best.
            columns: Further columns by heading, in the same order.
        """
        shown = [*self.best(n), dict(self.believed), self.first]
        names = [*(f"{i + 1}" for i in range(n)), f"believed ({self.rank(shown[-2]):,})",
                 f"before ({self.rank(shown[-1]):,})"]  # fmt: skip
        differing = [name for name in self.choices if len({str(each[name]) for each in shown}) > 1]
        rows = []
        for i, (name, each) in enumerate(zip(names, shown, strict=True)):
            entries = [Entry(number(self.below_best(each), 1)), *(Entry(column[i]) for column in columns.values())]
            rows.append((name, [*entries, *(Entry(words(each[choice])) for choice in differing)]))
        head = [(label, "") for label in ("below best", *columns, *(name.replace("_", " ") for name in differing))]
        return Table("", "", "rank", head, [("", rows)], "ranking")

    def sensitivity(self) -> Table:
        """Each alternative: its best combination below the best of all, and its share of the likelihood."""
        sections = []
        for name in self.choices:
            lines = [
                (words(each) + (" (believed)" if each == self.believed[name] else ""),
                 [Entry(number(drop, 1)), Entry(number(100.0 * share, 1))])
                for (each, drop), share in zip(self.drops(name).items(), self.shares(name), strict=True)
            ]  # fmt: skip
            sections.append((name.replace("_", " "), lines))
        head = [("best combination below the best of all", "log"), ("share of the likelihood", "%")]
        return Table("", "", "alternative", head, sections, "sensitivity")


def words(alternative: Any) -> str:
    """An alternative as it is shown."""
    return {True: "yes", False: "no"}[alternative] if isinstance(alternative, bool) else str(alternative)
