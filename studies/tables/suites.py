"""Tables of estimators by sensor suite, from studies whose conditions are suites, or seas and suites."""

import csv
from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import cache
from math import comb
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

import numpy as np

from agents.page import listed
from agents.refusal import Refusal
from agents.statistics import Interval, crossed_interval, paired_difference
from agents.studies.records import FLOOR, ORACLE
from agents.studies.worlds import system_of
from studies.tables.markdown import WITHOUT, interval, table

SUITES = ("nominal", "budget", "denied")
HELD, TRAVEL = "measurement", "steering_travel"
PLAIN, INFORMED, LINEAR = "ekf", "ekf assuming waves", "kf"
"""The filter that others are compared with on its model; it, with waves in its model; and on the linear model."""
MARGIN = 0.05
"""Difference of scores above which estimators count as different in sentences and bold cells."""


class Column(NamedTuple):
    """Scores of an environment in a condition by estimator, ``(runs, seeds)`` each.

    ``comparisons`` is the number of pairs of estimators in all columns of its environment.
    """

    environment: str
    condition: str
    scores: dict[str, np.ndarray]
    comparisons: int

    @property
    def suite(self) -> str:
        """The sensor suite, without the sea."""
        return self.condition.rpartition(", ")[2]

    def gap(self, one: str, other: str) -> Interval:
        """Difference of two estimators' scores on the same seeds; 95 % hold for all pairs of the environment."""
        found = paired_difference(
            self.scores[one][0], self.scores[other][0], comparisons=self.comparisons
        )
        assert found is not None
        return found

    def best(self, without: Sequence[str] = ()) -> str:
        """The filter with the highest mean score: neither the truth, dead reckoning nor held measurements."""
        filters = [name for name in self.scores if name not in (ORACLE, FLOOR, HELD, *without)]
        return max(filters, key=lambda name: self.scores[name].mean())

    def rival_of_plain(self) -> str:
        """The best of the other filters that assume what `ekf` does: its model of the vehicle, and nothing of waves."""
        return self.best((PLAIN, INFORMED, LINEAR))

    @property
    def default(self) -> str:
        """The environment's default estimator."""
        return system_of(self.environment).estimator


@cache
def stored(path: Path) -> list[dict[str, str]]:
    """Episodes of a study, from its folder or one of its files, in the order of their seeds."""
    with (path / "episodes.csv" if path.is_dir() else path).open(encoding="utf-8") as file:
        return sorted(csv.DictReader(file), key=lambda one: int(one["seed"]))


def environments(results: Path) -> list[str]:
    """Environments of a study."""
    return list(dict.fromkeys(one["environment"] for one in stored(results)))


@cache
def flown(
    results: Path, environment: str, agent: str, key: str = "score"
) -> dict[tuple[str, str], np.ndarray]:
    """A metric of a study ``(runs, seeds)`` by condition and estimator, dead reckoning last.

    Raises:
        Refusal: if the agent flew nothing there.
    """
    values: dict[tuple[str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for one in stored(results):
        if (one["environment"], one["agent"]) == (environment, agent):
            values[one["condition"], one["estimator"]][one["training_seed"]].append(
                float(one[key] or "nan")
            )
    if not values:
        raise Refusal(f"{agent} flew nothing in {environment} of {results}")
    found = {place: np.array(list(runs.values())) for place, runs in values.items()}
    return dict(sorted(found.items(), key=lambda item: item[0][1] == FLOOR))


def by_suite(
    results: Path,
    environment: str,
    sea: str = "",
    agent: str = "autopilot",
    estimators: Sequence[str] = (),
) -> str:
    """Score and steering travel of estimators (none: all) in each suite; 95 % hold for all scores of the table."""
    scores, travels = (flown(results, environment, agent, key) for key in ("score", TRAVEL))
    places = [f"{sea}, {suite}" if sea else suite for suite in SUITES]
    names = estimators or list(dict.fromkeys(name for place, name in scores if place in places))
    rows = []
    for name in names:
        cells = []
        for place in places:
            score, travel = (of.get((place, name)) for of in (scores, travels))
            if score is None or travel is None:
                cells.append(WITHOUT)
                continue
            cells.append(
                f"{interval(crossed_interval(score, len(names) * len(places)))};"
                f" {np.nanmean(travel):.0f}"
            )
        rows.append((f"`{name}`", *cells))
    return table(("Score; steering travel [°/min]", *SUITES), rows)


def columns(results: Path) -> Iterator[Column]:
    """Columns of the autopilot, by environment and condition."""
    for environment in environments(results):
        of = flown(results, environment, "autopilot")
        conditions = list(dict.fromkeys(condition for condition, _ in of))
        each = {
            place: {name: of[place, name] for at, name in of if at == place} for place in conditions
        }
        pairs = sum(comb(len(scores), 2) for scores in each.values())
        yield from (Column(environment, place, scores, pairs) for place, scores in each.items())


def differences(results: Path) -> str:
    """The best filter of each column against its rivals and the truth, and the best other on the model of `ekf`."""
    rows = []
    for at in columns(results):
        best = at.best()
        pairs = [(best, HELD), (at.rival_of_plain(), PLAIN), (best, at.default), (ORACLE, best)]
        gaps = [
            at.gap(*pair) if pair[1] in at.scores and pair[0] != pair[1] else None for pair in pairs
        ]
        cells = [_bold(interval(gap), gap is not None and gap.low > MARGIN) for gap in gaps]
        rows.append((f"{at.environment}, {at.condition}", f"`{best}`", *cells))
    heads = (
        "best − `measurement`",
        "best other on its model − `ekf`",
        "best − default",
        "`truth` − best",
    )
    return table(("", "best filter", *heads), rows)


def _bold(text: str, strong: bool) -> str:
    return f"**{text}**" if strong else text


def found(results: Path) -> str:
    """Sentences on a study: where filters differ, where no filter is needed, and where the truth is not first."""
    every = environments(results)
    beaten: dict[str, dict[str, None]] = {}
    ahead: list[str] = []
    for at in columns(results):
        best = at.best()
        for what, name in (("held measurements", HELD), ("the environment's default", at.default)):
            wide = at.suite != SUITES[0] and name in at.scores and at.gap(best, name).low > MARGIN
            beaten.setdefault(what, {}).update({f"`{at.environment}`": None} if wide else {})
        for name in (HELD, FLOOR):
            if (gap := at.gap(name, best)).low > 0.0:
                ahead.append(f"`{name}` in {at.environment}, {at.condition}, by {interval(gap)}")
    text = (
        f"{filter_and_model(results)} Gains are counted on `budget` and `denied` sensors, above"
        f" {MARGIN:g} of the "
    )
    text += "score and beyond chance. "
    for what, where in beaten.items():
        text += f"Against {what} the best filter gains in {len(where)} of {len(every)} environments"
        text += f" ({listed(list(where))}). " if where else ". "
    text += f"Scores without any filter are higher than on the best one with {listed(ahead)}. " if ahead else (
        "No filter is beaten by held measurements or dead reckoning beyond chance. "
    )  # fmt: skip
    return fill(text + truth_first(results), 140, break_on_hyphens=False)


def filter_and_model(results: Path) -> str:
    """Sentences on what filters gain over `ekf` on its model, and what a better model gains."""
    every = list(columns(results))
    wide = [
        (at, at.rival_of_plain(), PLAIN)
        for at in every
        if at.gap(at.rival_of_plain(), PLAIN).low > MARGIN
    ]
    text = (
        f"On the same model a filter gains more than {MARGIN:g} over `ekf` beyond chance in"
        f" {len(wide)} of "
    )
    text += f"{len(every)} columns" + (
        f": {listed([_gained(*one) for one in wide])}." if wide else "."
    )
    models = [(at, INFORMED, PLAIN) for at in every if INFORMED in at.scores]
    models += [(at, PLAIN, LINEAR) for at in every if LINEAR in at.scores]
    most = max(models, key=lambda one: one[0].gap(*one[1:]).mean)
    return f"{text} The largest gain of a model is that of {_gained(*most)}."


def _gained(at: Column, one: str, other: str) -> str:
    return (
        f"`{one}` over `{other}` in {at.environment}, {at.condition}, by"
        f" {interval(at.gap(one, other))}"
    )


def truth_first(results: Path) -> str:
    """Test that no estimator scores more than the truth beyond chance, in a sentence that names the exceptions."""
    every, first, beyond = 0, 0, []
    for at in columns(results):
        gaps = {name: at.gap(name, ORACLE) for name in at.scores if name != ORACLE}
        every, first = every + 1, first + all(gap.mean <= 0.0 for gap in gaps.values())
        where = f"in {at.environment}, {at.condition}"
        beyond += [
            f"`{name}` {where} by {interval(gap)}" for name, gap in gaps.items() if gap.low > 0.0
        ]
    text = f"The truth has the highest mean in {first} of {every} columns"
    if beyond:
        return f"{text}. Significantly higher than on the truth are the scores of {listed(beyond)}."
    return f"{text}, and no estimator scores significantly more than it in any."


def headline(results: Path, environment: str, sea: str) -> str:
    """Sentences on the worth of a filter in each suite: score lost against the truth, and steering."""
    travels = flown(results, environment, "autopilot", TRAVEL)
    chosen = [
        at
        for at in columns(results)
        if (at.environment, at.condition) == (environment, f"{sea}, {at.suite}")
    ]
    best = [at.best() for at in chosen]
    lost = {
        who: listed(
            [f"{at.gap(ORACLE, name).mean:.3f}" for at, name in zip(chosen, names, strict=True)]
        )
        for who, names in (("best", best), ("held", [HELD] * len(chosen)))
    }
    ratios = [
        float(np.nanmean(travels[at.condition, HELD]) / np.nanmean(travels[at.condition, name]))
        for at, name in zip(chosen, best, strict=True)
    ]
    wins = [
        f"`{at.suite}`"
        for at, name in zip(chosen, best, strict=True)
        if at.gap(name, HELD).low <= 0.0
    ]
    text = (
        f"With {listed([f'`{at.suite}`' for at in chosen])} sensors the autopilot loses"
        f" {lost['best']} of the score against the truth on the best filter, and {lost['held']} on"
        f" held measurements (`measurement`), which steer {min(ratios):.1f} to {max(ratios):.1f}"
        " times as much."
    )
    text += (
        f" No filter beats held measurements beyond chance with {listed(wins)} sensors."
        if wins
        else ""
    )
    return fill(text, 140, break_on_hyphens=False)
