"""The answer to a study: one computed sentence, and the tables that stand behind it."""

import re
from collections.abc import Sequence
from itertools import pairwise

import pandas as pd

from agents.page import listed, markdown_table, text, words
from agents.statistics import (
    EQUIVALENT,
    LOWER,
    UNDECIDED,
    WORSE,
    Interval,
    crossed_interval,
    episodes_for,
    mean_interval,
)
from agents.studies.records import Condition, beyond_the_truth
from agents.studies.results import Results
from agents.studies.shares import ALL, Ranking, learned_differences, rankings

BEST = 5
"""Number of estimators in the table at the head of a report."""
_GAIN = "of the truth's gain over dead reckoning"


def answer(results: Results) -> list[str]:
    """Sentences that answer the question of a study: the first its title, then what was learned.

    The last say what is missing.
    """
    if not results.environments:
        return ["Nothing has a result yet.", *_missing(results)]
    found = dict(rankings(results))
    together = found.pop(ALL, None)
    asked = [together] if together else found.values()
    sentences = [_trend(ranking) or _advice(ranking) for ranking in asked]
    if rest := [e for e in results.plan.study.environments if e not in found]:
        sentences.append(
            f"No estimator can be ranked in {listed(rest)}: for that {results.who} needs results on"
            " the truth, on dead reckoning and on an estimator between them, and a higher score on"
            " the truth."
        )
    suspicious = [
        f"{name} in {environment} ({amount(kept)})"
        for environment, ranking in found.items()
        for name in ranking.shares
        if (kept := ranking.kept(name)) and kept.low > 1.0
    ]
    warning = [beyond_the_truth(suspicious, results.who)] if suspicious else []
    learned = [_learned(results, environment) for environment in found]
    return [" ".join(sentences), *warning, *filter(None, learned), *_missing(results)]


def _advice(ranking: Ranking) -> str:
    """The estimator to use: the best, with its share and the others' verdicts."""
    best, where, who = ranking.best, _where(ranking.environments), ranking.results.who
    if enough := ranking.episodes_to_tell():
        more = f"; by their scatter it takes at least {enough:.0f} to tell" if enough > 0 else ""
        return (
            f"{ranking.results.plan.study.episodes} episodes cannot tell which estimator to use in"
            f" {where}: so far {best} keeps the largest share {_GAIN}{more}."
        )
    share, lost = amount(ranking.kept(best)), amount(ranking.price(best))
    return (
        f"Use {best} in {where}: on it {who} keeps {share} {_GAIN}, and loses {lost} of score"
        f" against the truth{_standing(ranking)}.{_elsewhere(ranking)}"
    )


def _where(environments: Sequence[str]) -> str:
    few = {1: environments[0], 2: "both environments"}
    return few.get(len(environments), f"all {len(environments)} environments")


def _standing(ranking: Ranking) -> str:
    """Verdicts on the other estimators against the best."""
    found = ranking.verdicts
    each = [
        f"{word} on {listed(names)}"
        for word in (EQUIVALENT, UNDECIDED, LOWER)
        if (names := [name for name in found if found[name] == word])
    ]
    rest = ["worse on all others"] if WORSE in found.values() else []
    against = f". Against {ranking.best}: {'; '.join(each + rest)}"
    return against if found else "; no other estimator was compared"


def _elsewhere(ranking: Ranking) -> str:
    """Environments in which another estimator is shown to keep more than the best of all."""
    better, best = [], ranking.best
    for environment in ranking.environments:
        own = Ranking(ranking.results, [environment])
        if own.verdicts.get(best) in (LOWER, WORSE):
            more = amount(own.gap(own.best, best))
            better.append(f"in {environment} {own.best} keeps {more} more")
    return f" But {listed(better)}." if better else ""


# --- conditions that are numbers ------------------------------------------------------------------


def ordered(conditions: Sequence[Condition]) -> bool:
    """True for conditions whose names are numbers that only rise or only fall: 10 Hz, 5 Hz, 1 Hz.

    The first may have another name.
    """
    names = [c.name for c in conditions]
    steps = [b - a for a, b in pairwise(_numbers(names) or _numbers(names[1:]))]
    return bool(steps) and (min(steps) > 0.0 or max(steps) < 0.0)


def _numbers(names: Sequence[str]) -> list[float]:
    """The numbers in names that differ in one number alone; none for other names."""
    number = r"\d*\.?\d+"
    if len({re.sub(number, "", name) for name in names}) != 1:
        return []
    each = zip(*(re.findall(number, name) for name in names), strict=True)
    varying = [values for values in each if len(set(values)) > 1]
    return [float(value) for value in varying[0]] if len(varying) == 1 else []


def _trend(ranking: Ranking) -> str | None:
    """The best estimator's share over `ordered` conditions that all environments have, or None.

    Changes from the first condition are paired by seed; their intervals hold for all estimators at
    once. Then come the first condition with a significant loss and the one before it.
    """
    results, environments, pick = ranking.results, ranking.environments, ranking.best
    conditions = [c for c in results.plan.study.conditions if all(map(c.is_in, environments))]
    places = [[(e, c.name) for e in environments] for c in conditions]
    if not ordered(conditions) or not all(p in results.scales.index for at in places for p in at):
        return None
    kept = results.rows(results.kept, pick)
    first, *others = [kept.loc[at].mean().to_numpy() for at in places]
    names = [
        c.name if re.fullmatch(r"[\d.]+ ?\S*", c.name) else f'"{c.name}"'  # a number and a unit
        for c in conditions
    ]
    changes, comparisons = [shares - first for shares in others], len(ranking.shares) * len(others)
    found = [mean_interval(change, comparisons) for change in changes]
    each = [
        f"{amount(change, signed=True)} at {name}"
        for name, change in zip(names[1:], found, strict=True)
    ]
    margin, more = results.plan.study.margin, ""
    if any(change and change.half > margin for change in found):
        enough = max(episodes_for(change, margin, comparisons) for change in changes)
        enough = max(enough, len(first) + 1.0)
        more = f"; a difference of {margin:g} takes at least {enough:.0f} episodes to show"
    most = f" {pick} has the largest share kept overall. At" if ranking.verdicts else ", at"
    return (
        f"In {_where(environments)}{most} {names[0]} {results.who} on {pick} keeps"
        f" {amount(mean_interval(first))} {_GAIN}. From there the share changes by"
        f" {listed(each)}. {_last(names, found, more)}"
    )


def _last(names: Sequence[str], changes: Sequence[Interval | None], more: str) -> str:
    """Sentence on the first condition whose change is a significant loss.

    If no change is significant, the sentence ends with ``more``.
    """
    for i, change in enumerate(changes):
        if change and change.high < 0.0:
            if i == 0:
                return f"Already the loss at {names[1]} is significant."
            return (
                f"The first significant loss is at {names[i + 1]}; up to {names[i]} none is"
                " significant."
            )
    more = "" if any(change and change.low > 0.0 for change in changes) else more
    return f"No loss against {names[0]} is significant{more}."


# --- learned policies, and what is missing --------------------------------------------------------


def _learned(results: Results, environment: str) -> str:
    """A sentence on the learned policies that have results in an environment."""
    each = [
        f"{policy} against {other}: {amount(gap, signed=True)}"
        + ("" if isinstance(gap, Interval) else " (one run, no interval)")
        for (policy, other), gap in learned_differences(results, environment).items()
        if gap is not None
    ]
    start = f"In {environment}, each on the estimator of its training, in the share kept: "
    return f"{start}{'; '.join(each)}." if each else ""


def _missing(results: Results) -> list[str]:
    missing, flights = results.missing, results.plan.flights
    if not missing:
        return []
    failed = [f.job.label for f in missing if f.job.key in results.outcome.failures]
    why = f"; {len(failed)} failed, the first: {failed[0]}" if failed else ""
    return [f"{len(missing)} of {len(flights)} results are missing{why}. Run the study again."]


def amount(value: Interval | float | None, signed: bool = False) -> str:
    """A share or score in a sentence, with a digit more where its interval is small."""
    wide = isinstance(value, Interval) and value.half >= 0.095
    return words(value, 2 if wide else 3, signed)


# --- tables ---------------------------------------------------------------------------------------


def heading(results: Results, environment: str) -> str:
    """Title of `conditions_table`."""
    unit = "share kept" if environment in rankings(results) else "score"
    return f"{environment}: {unit} (individual 95 % intervals)"


def legend(results: Results) -> str:
    """Sentences on the intervals and verdicts of all other tables."""
    margin = f"{results.plan.study.margin:g}"
    return (
        "For each environment, and for all together, 95 % intervals and verdicts hold"
        " simultaneously for all estimators. A verdict is on the interval of the difference from"
        f" the best. Equivalent: all of it within ±{margin}. Worse: all of it below -{margin}."
        " Lower: all of it below 0. Not decided: none of these."
    )


def summary(ranking: Ranking) -> pd.DataFrame:
    """The best estimators of some environments: what they keep, lose, and how their tails are."""
    rows = {
        name: {
            "share kept": text(ranking.kept(name), 3),
            "score lost": text(ranking.price(name), 3),
            "completed [%]": text(ranking.completed(name), 1),
            "worst tenth": text(ranking.worst_decile(name), 3),
        }
        for name in list(ranking.shares)[:BEST]
    }
    return _table(rows)


def _table(rows: dict[str, dict[str, str]]) -> pd.DataFrame:
    """A table of texts with a row for each estimator."""
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("estimator")


def to_copy(results: Results) -> pd.DataFrame:
    """The estimator to use in each environment, its share, and the line that makes it.

    The last row is the estimator not to use: the one that keeps least, if it keeps significantly
    less than the one before it, and is worse than the best.
    """
    rows, worst = [], []
    for environment, ranking in rankings(results).items():
        if environment != ALL:
            pick, (*before, least) = ranking.best, ranking.shares
            line = _line(results, environment, pick)
            rows.append((environment, pick, text(ranking.kept(pick), 3), line))
            gap = ranking.gap(before[-1], least) if before else None
            if gap and gap.low > 0.0 and ranking.verdicts[least] == WORSE:
                worst.append((float(ranking.shares[least].mean()), least, environment))
    for share, name, environment in sorted(worst)[:1]:
        if all(name != pick for _, pick, *_ in rows):
            rows.append((f"avoid in {environment}", name, text(share, 3), ""))
    return pd.DataFrame(rows, columns=["where", "estimator", "share kept", "to copy"])


def _line(results: Results, environment: str, name: str) -> str:
    """The line that makes an environment with an estimator of the study."""
    flown = (f for f in results.plan.flights if (f.environment, f.estimator) == (environment, name))
    made = next(flown).job.arguments["options"]
    _, own, name = made["estimator"].rpartition(":")
    kind = name if own else f'"{name}"'
    chosen = made.get("estimator_options")
    options = f", estimator_options={chosen}" if chosen else ""
    return f'gym.make("{environment}", estimator={kind}{options})'


def conditions_table(results: Results, environment: str) -> pd.DataFrame:
    """Share kept by the classical agent on each estimator in each condition, in the file's order.

    Without a scale it is the score.
    """
    values = results.kept if environment in rankings(results) else results.wide("score")
    names, rows = results.conditions(environment), {}
    for estimator in results.estimators(environment):
        own = results.rows(values, estimator)
        found = own[own.index.isin([(environment, name) for name in names])]
        cells = [text(crossed_interval(row[None]), 3) for row in found.to_numpy()]
        rows[estimator] = dict(zip(found.index.get_level_values("condition"), cells, strict=True))
    return _table(rows).reindex(columns=names).fillna("–")


def ranking_table(results: Results) -> pd.DataFrame:
    """Share kept on each estimator and its verdict against the best, a column an environment."""
    found = {
        head: {
            name: f"{text(ranking.kept(name), 3)}, {ranking.verdicts.get(name, 'best')}"
            for name in ranking.shares
        }
        for head, ranking in rankings(results).items()
    }
    return pd.DataFrame(found).fillna("–").rename_axis("estimator")


def markdown(results: Results) -> str:
    """The answer and its tables as Markdown."""
    blocks = [f"# {results.plan.study.title}", "\n".join(answer(results))]
    ranked = bool(rankings(results))
    if ranked:
        lines = to_copy(results).set_index("where")
        lines["to copy"] = [f"`{line}`" if line else "" for line in lines["to copy"]]
        blocks += [markdown_frame(lines), legend(results)]
    for environment in results.environments:
        table = conditions_table(results, environment)
        blocks += [f"## {heading(results, environment)}", markdown_frame(table)]
    if ranked:
        blocks += ["## All conditions", markdown_frame(ranking_table(results))]
    return "\n\n".join(blocks) + "\n"


def markdown_frame(table: pd.DataFrame) -> str:
    """A table of texts as Markdown."""
    cells = table.reset_index()
    heading, *rows = [
        [str(cell).replace("|", "\\|") for cell in row]
        for row in (cells.columns, *cells.itertuples(index=False))
    ]
    return markdown_table(heading, rows, len(heading))
