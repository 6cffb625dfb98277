"""The answer to a study: one computed sentence, and the tables that stand behind it."""

import re
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from agents.page import listed, markdown_table, text, words
from agents.statistics import (
    BETTER,
    EQUIVALENT,
    HIGHER,
    LOWER,
    UNDECIDED,
    WORSE,
    Interval,
    crossed_interval,
    verdict,
)
from agents.studies import shares
from agents.studies.records import Condition
from agents.studies.results import Results

BEST = 5
"""Number of estimators in the table at the head of a report."""
ALL = "All"
"""Heading of what holds for all environments together."""
_WORTH = "of what knowing the truth is worth over dead reckoning"


def answer(results: Results) -> list[str]:
    """Sentences that answer the question of a study: the first its title, then what was learned.

    The last say what is missing.
    """
    return [_first(results), *_suspicious(results), *_learned(results), *_missing(results)]


def _first(results: Results) -> str:
    environments = shares.ruled(results)
    if not results.environments:
        return "Nothing has a result yet."
    groups = [environments] if shares.common(results) else [[e] for e in environments]
    sentences = [_trend(results, group) or _advice(results, group) for group in groups]
    if rest := [e for e in results.plan.study.environments if e not in environments]:
        sentences.append(
            f"No estimator can be ranked in {listed(rest)}: for that {results.who} needs results on"
            " the truth, on dead reckoning and on an estimator between them, and a higher score on"
            " the truth."
        )
    return " ".join(sentences)


def _advice(results: Results, environments: Sequence[str]) -> str:
    """The estimator to use: the cheapest of the best, with its share and the others' verdicts."""
    ranked = shares.rankable(results, environments)
    best, where = next(iter(ranked)), _where(environments)
    if enough := shares.episodes_to_tell(results, environments, ranked):
        more = f"; by their scatter it takes at least {enough:.0f} to tell" if enough > 0 else ""
        return (
            f"{results.plan.study.episodes} episodes cannot tell which estimator to use in {where}:"
            f" so far {best} keeps most{more}."
        )
    pick = shares.cheapest(results, environments, ranked)
    share, lost = (
        amount(of(results, environments, results.classical, pick, len(ranked)))
        for of in (shares.kept, shares.price)
    )
    cheaper = f", equivalent to {best}, which keeps most, and cheaper" if pick != best else ""
    return (
        f"Use {pick} in {where}{cheaper}: on it {results.who} keeps {share} {_WORTH}, and loses"
        f" {lost} of score against the truth{_standing(results, environments, ranked)}."
        f"{_elsewhere(results, environments, pick)}"
    )


def _where(environments: Sequence[str]) -> str:
    few = {1: environments[0], 2: "both environments"}
    return few.get(len(environments), f"all {len(environments)} environments")


def _standing(results: Results, environments: Sequence[str], ranked: shares.Ranked) -> str:
    """Verdicts on the other estimators against the best."""
    best, *others = ranked
    if not others:
        return "; no other estimator was compared"
    found = shares.verdicts(results, environments, ranked)
    if set(found.values()) == {WORSE}:
        behind = amount(shares.gap(ranked, best, others[0]))
        return f"; every other is worse, the next, {others[0]}, by {behind}"
    each = []
    for word in (EQUIVALENT, UNDECIDED, LOWER):
        if names := [name for name in others if found[name] == word]:
            each.append(f"{listed(names)} {'is' if len(names) == 1 else 'are'} {word}")
    rest = ["the others are worse"] if WORSE in found.values() else []
    return f". Against {best}, {listed(each + rest)}"


def _elsewhere(results: Results, environments: Sequence[str], pick: str) -> str:
    """Environments in which their best is shown to keep more than the pick for all of them."""
    better = []
    for environment in environments if len(environments) > 1 else ():
        ranked = shares.rankable(results, [environment])
        best = next(iter(ranked))
        if shares.verdicts(results, [environment], ranked).get(pick) in (LOWER, WORSE):
            more = amount(shares.gap(ranked, best, pick))
            better.append(f"in {environment} {best} keeps {more} more")
    return f" But {listed(better)}." if better else ""


# --- conditions that are numbers ------------------------------------------------------------------


def ordered(conditions: Sequence[Condition]) -> bool:
    """True for conditions that are numbers which only rise or only fall.

    Their names are, perhaps but for the first, such as 10 Hz, 5 Hz, 1 Hz; or they differ in the
    mismatch or the latency alone.
    """
    names = [c.name for c in conditions]
    axes = {
        axis for axis in _AXES for c in conditions if _AXES[axis](c) != _AXES[axis](conditions[0])
    }
    alone = [_AXES[axis](c) for axis in axes & {"mismatch", "latency"} for c in conditions]
    series = (_numbers(names) or _numbers(names[1:]), alone if len(axes) == 1 else [])
    return any(_monotonic(numbers) for numbers in series)


_AXES: dict[str, Callable[[Condition], Any]] = {
    "sensors": lambda c: c.sensors,
    "disturbance": lambda c: c.disturbance,
    "faults": lambda c: c.faults,
    "mismatch": lambda c: c.mismatch,
    "latency": lambda c: max(c.latency.values(), default=0.0),
}


def _numbers(names: Sequence[str]) -> list[float]:
    """The numbers in names that differ in one number alone; none for other names."""
    parts = [re.split(r"(\d*\.?\d+)", name) for name in names]
    if len({(len(each), *each[::2]) for each in parts}) != 1:
        return []
    varying = [set(each) for each in zip(*(each[1::2] for each in parts), strict=True)]
    differ = [i for i, values in enumerate(varying) if len(values) > 1]
    return [float(each[1 + 2 * differ[0]]) for each in parts] if len(differ) == 1 else []


def _monotonic(numbers: Sequence[float]) -> bool:
    steps = [b - a for a, b in pairwise(numbers)]
    return bool(steps) and (min(steps) > 0.0 or max(steps) < 0.0)


def _trend(results: Results, environments: Sequence[str]) -> str | None:
    """The best estimator's share over `ordered` conditions that all environments have, or None."""
    conditions = [c for c in results.plan.study.conditions if all(map(c.is_in, environments))]
    ranked = shares.rankable(results, environments)
    pick, names = next(iter(ranked)), [c.name for c in conditions]
    there = all((e, name) in results.scales.index for e in environments for name in names)
    if not ordered(conditions) or not there:
        return None
    each = {name: in_condition(results, environments, pick, name) for name in names}
    at_first, at_last = (amount(crossed_interval(each[n][None])) for n in (names[0], names[-1]))
    found = _over_conditions(results, environments, each, len(ranked))
    against = listed([f"{word} at {listed([*map(_called, at)])}" for word, at in found.items()])
    first, last = _called(names[0]), _called(names[-1])
    most = ", which keeps most over all conditions," if len(ranked) > 1 else ""
    return (
        f"In {_where(environments)} on {pick}{most} {results.who} keeps {at_first} {_WORTH} at"
        f" {first} and {at_last} at {last}; against {first}: {against}."
    )


def _called(name: str) -> str:
    """The name of a condition in a sentence: in quotation marks unless it is a number and a unit."""
    return name if re.fullmatch(r"[\d.]+ ?\S*", name) else f'"{name}"'


def in_condition(
    results: Results, environments: Sequence[str], estimator: str, condition: str
) -> np.ndarray:
    """Share that the classical agent keeps ``(seeds,)`` in one condition."""
    each = [results.flight(results.kept, e, condition, estimator) for e in environments]
    return np.concatenate([row for row in each if row is not None]).mean(axis=0)


def _over_conditions(
    results: Results, environments: Sequence[str], each: Mapping[str, np.ndarray], estimators: int
) -> dict[str, list[str]]:
    """Conditions by their verdict against the first; these hold for all estimators at once."""
    first, *others = each
    scale = results.scales.loc[list(environments)].mean(axis=1)
    span = float((1.0 / scale.groupby("environment").min()).mean())
    margin, comparisons = results.plan.study.margin, estimators * len(others)
    found: dict[str, list[str]] = {}
    for name in others:
        word = verdict(each[name] - each[first], margin, span, comparisons)
        found.setdefault(word, []).append(name)
    order = (BETTER, HIGHER, EQUIVALENT, UNDECIDED, LOWER, WORSE)
    return {word: found[word] for word in order if word in found}


def _suspicious(results: Results) -> list[str]:
    """A warning where an estimator beats the truth beyond chance."""
    found = []
    for environment in shares.ruled(results):
        ranked = shares.rankable(results, [environment])
        for name in ranked:
            kept = shares.kept(results, [environment], results.classical, name, len(ranked))
            if isinstance(kept, Interval) and kept.low > 1.0:
                found.append(f"{name} in {environment} ({amount(kept)})")
    text = "beats the truth beyond chance: check the task's score, and what its reward pays for"
    return [f"On {listed(found)} {results.who} {text}."] if found else []


# --- learned policies, and what is missing --------------------------------------------------------


def _learned(results: Results) -> list[str]:
    """A sentence for each environment in which learned policies have results."""
    sentences = []
    for environment in shares.ruled(results):
        gaps = shares.learned_differences(results, environment)
        each = [
            f"{policy} {_more(gap)} than {results.who if other == results.classical else other}"
            for (policy, other), gap in gaps.items()
            if gap is not None
        ]
        if each:
            sentences.append(
                f"In {environment}, each on the estimator of its training: {'; '.join(each)}."
            )
    return sentences


def _more(gap: Interval | float) -> str:
    """A difference in words: how much more is kept, or less."""
    mean = gap.mean if isinstance(gap, Interval) else gap
    word = "less" if mean < 0.0 else "more"
    if not isinstance(gap, Interval):
        return f"keeps {text(abs(gap), 3)} {word} (one run, no interval)"
    size = amount(gap.times(-1.0) if mean < 0.0 else gap)
    return f"keeps {size} {word}" + ("" if gap.excludes_zero else " (not significant)")


def _missing(results: Results) -> list[str]:
    missing, flights = results.missing, results.plan.flights
    if not missing:
        return []
    failed = [f for f in missing if f.job.key in results.failures]
    why = f"; {len(failed)} failed, the first: {failed[0].job.label}" if failed else ""
    return [f"{len(missing)} of {len(flights)} results are missing{why}. Run the study again."]


def amount(value: Interval | float | None) -> str:
    """A share or score in a sentence, with a digit more where its interval is small."""
    wide = isinstance(value, Interval) and value.half >= 0.095
    return words(value, 2 if wide else 3)


# --- tables ---------------------------------------------------------------------------------------


def summary(results: Results, environments: Sequence[str]) -> pd.DataFrame:
    """The best estimators of some environments: what they keep, lose, and how their tails are."""
    ranked, who = shares.rankable(results, environments), results.classical
    rows = {
        name: {
            "share kept": text(shares.kept(results, environments, who, name, len(ranked)), 3),
            "score lost": text(shares.price(results, environments, who, name, len(ranked)), 3),
            "completed [%]": text(shares.completed(results, environments, name), 1),
            "worst tenth": text(shares.worst_decile(results, environments, name), 3),
        }
        for name in list(ranked)[:BEST]
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("estimator")


def to_copy(results: Results) -> pd.DataFrame:
    """The estimator to use in each environment, its share, and the line that makes it.

    The last row is the estimator to avoid: the one that keeps least, if that is shown.
    """
    rows: list[tuple[str, ...]] = []
    worst = ("", "", np.inf)
    for environment in shares.ruled(results):
        ranked = shares.rankable(results, [environment])
        pick = shares.cheapest(results, [environment], ranked)
        share = text(shares.kept(results, [environment], results.classical, pick, len(ranked)), 3)
        rows.append((environment, pick, share, _line(results, environment, pick)))
        least = list(ranked)[-1]
        if shares.verdicts(results, [environment], ranked).get(least) in (LOWER, WORSE):
            found = environment, least, float(ranked[least].mean())
            worst = min(worst, found, key=lambda w: w[2])
    if worst[1] not in {"", *(pick for _, pick, *_ in rows)}:
        rows.append(("avoid", worst[1], f"{text(worst[2], 3)} in {worst[0]}", ""))
    return pd.DataFrame(rows, columns=["where", "use", "share kept", "to copy"])


def _line(results: Results, environment: str, name: str) -> str:
    """The line that makes an environment with an estimator of the study."""
    flown = (f for f in results.plan.flights if (f.environment, f.estimator) == (environment, name))
    made = next(flown).job.arguments["options"]
    own = made["estimator"].rpartition(":")
    kind = own[2] if own[1] else f'"{own[2]}"'
    chosen = made.get("estimator_options")
    options = f", estimator_options={chosen}" if chosen else ""
    return f'gym.make("{environment}", estimator={kind}{options})'


def conditions_table(results: Results, environment: str) -> pd.DataFrame:
    """Share kept by the classical agent on each estimator in each condition, in the file's order.

    Without a scale it is the score.
    """
    scaled = environment in shares.ruled(results)
    values = results.kept if scaled else results.wide("score")
    names = results.conditions(environment)

    def cell(condition: str, estimator: str) -> str:
        row = results.flight(values, environment, condition, estimator)
        return "–" if row is None else text(crossed_interval(row), 3)

    found = {
        estimator: {name: cell(name, estimator) for name in names}
        for estimator in results.estimators(environment)
    }
    return pd.DataFrame.from_dict(found, orient="index", columns=names).rename_axis("estimator")


def ranking_table(results: Results) -> pd.DataFrame:
    """Share kept on each estimator and its verdict against the best, a column an environment."""
    columns = groups(results)
    found = {
        head: {
            name: f"{text(shares.kept(results, column, results.classical, name, among), 3)}, {word}"
            for name, word, among in _verdicts(results, column)
        }
        for head, column in columns.items()
    }
    order = dict.fromkeys(name for column in found.values() for name in column)
    return pd.DataFrame(found, index=list(order)).fillna("–").rename_axis("estimator")


def _verdicts(results: Results, environments: Sequence[str]) -> list[tuple[str, str, int]]:
    ranked = shares.rankable(results, environments)
    words = {next(iter(ranked)): "best"} | shares.verdicts(results, environments, ranked)
    return [(name, word, len(ranked)) for name, word in words.items()]


def groups(results: Results) -> dict[str, list[str]]:
    """The environments that each column of a table stands for: perhaps all, and every one."""
    environments = shares.ruled(results)
    together = {ALL: environments} if shares.common(results) else {}
    return together | {e: [e] for e in environments}


def markdown(results: Results) -> str:
    """The answer and its tables as Markdown."""
    blocks = [f"# {results.plan.study.title}", "\n".join(answer(results))]
    if shares.ruled(results):
        lines = to_copy(results).set_index("where")
        lines["to copy"] = [f"`{line}`" if line else "" for line in lines["to copy"]]
        blocks.append(markdown_frame(lines))
    for environment in results.environments:
        table = conditions_table(results, environment)
        blocks += [f"## {environment}", markdown_frame(table)]
    if shares.ruled(results):
        blocks += ["## All conditions", markdown_frame(ranking_table(results))]
    return "\n\n".join(blocks) + "\n"


def markdown_frame(table: pd.DataFrame) -> str:
    """A table of texts as Markdown."""
    cells = table.reset_index()
    heading, *rows = [
        [str(cell).replace("|", "\\|") for cell in row]
        for row in (cells.columns, *cells.itertuples(index=False))
    ]
    return markdown_table(heading, rows, 1)
