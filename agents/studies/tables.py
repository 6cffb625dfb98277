"""Tables of a study's report, of texts."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd

from agents.page import markdown_table, text
from agents.statistics import (
    CLEARLY_WORSE,
    SLIGHTLY_WORSE,
    UNDECIDED,
    crossed_interval,
    mean_interval,
)
from agents.studies.answer import answer
from agents.studies.effects import effects
from agents.studies.ranking import Ranking, rankings
from agents.studies.results import Results

BEST = 5
"""Number of rows of a table that argues."""


def legend(results: Results) -> str:
    """Sentences on the intervals and verdicts of all tables of estimators."""
    margin = f"{results.plan.study.margin:g}"
    return (
        "Normalised score: 1 with perfect state knowledge (truth), 0 on dead reckoning, in the same"
        " episodes; it may pass 1. For each environment, and for all together, 95 % intervals and"
        " verdicts hold simultaneously for all estimators. A verdict is on the interval of the"
        f" difference. Equivalent: all of it within ±{margin}. Clearly worse: all of it below"
        f" -{margin}. Slightly worse: all of it below 0. Better: the same on the other side."
        " Undecided: about as many more episodes as the number says are needed."
    )


def effects_table(results: Results, most: int | None = None) -> pd.DataFrame:
    """Factors with their reference, best and worst levels, and what these change in the score."""
    rows = [
        (e.factor, e.best, text(e.gain, 3, True), e.worst, text(e.loss, 3, True), e.reference)
        for e in effects(results)[:most]
    ]
    return pd.DataFrame(rows, columns=["factor", "best", "gain", "worst", "loss", "reference"])


def tuned_table(results: Results, environment: str) -> pd.DataFrame:
    """Score in the first condition as delivered and tuned, and what the tunings found.

    The gain is crossed over tunings and seeds. Overfitting is the gain on tuning seeds less that on
    other seeds.
    """
    place = environment, results.conditions(environment)[0]
    score, rows = results.wide("score"), {}
    tuned = [
        f
        for f in results.plan.flights
        if (f.environment, f.condition, f.policy) == (*place, results.compared)
    ]
    for name in dict.fromkeys(flight.estimator for flight in tuned):
        jobs = {f.job.needs[0].key for f in tuned if f.estimator == name}
        found = [results.outcome.values[key] for key in jobs if key in results.outcome.values]
        before, after = (
            results.rows(score, name, p).sort_index() for p in (results.classical, results.compared)
        )
        if not found or place not in before.index or place not in after.index:
            continue
        old, new = (each.loc[place].to_numpy() for each in (before, after))
        over = np.array([f["after"] - f["before"] - f["gain"][0] for f in found])
        rows[name] = {
            "delivered": text(crossed_interval(old), 3), "tuned": text(crossed_interval(new), 3),
            "gain": text(crossed_interval(new - old), 3, True),
            "overfitting": text(mean_interval(over), 3, True),
            "Position NEES/n": text(float(np.mean([f["position_nees"] for f in found])), 2),
            "at a bound": ", ".join(sorted({n for f in found for n in f["at_bound"]})) or "–",
        }  # fmt: skip
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("estimator")


@lru_cache(1)
def choices_table(results: Results) -> pd.DataFrame:
    """The estimator with the highest normalised score in each condition, a column an environment.

    In brackets are others that are not significantly worse there.
    """
    columns: dict[str, dict[str, str]] = {}
    for condition in results.plan.study.conditions:
        under = replace(results, table=results.table[results.table.condition == condition.name])
        for environment, _ in under.scales.index:
            if (ranking := Ranking(under, [environment])).scores:
                worse = SLIGHTLY_WORSE, CLEARLY_WORSE
                rivals = [name for name, word in ranking.verdicts.items() if word not in worse]
                beside = f" ({', '.join(rivals[:2])}{', ...' * (len(rivals) > 2)})" * bool(rivals)
                cell = f"{ranking.best} {text(ranking.score(ranking.best), 2)}{beside}"
                columns.setdefault(environment, {})[condition.name] = cell
    return pd.DataFrame(columns).fillna("–").rename_axis("condition")


def code(results: Results) -> list[str]:
    """A line for each environment that makes it with the best estimator, and its tuned file."""
    lines = []
    for environment, ranking in rankings(results).items():
        own = [
            f.job
            for f in results.plan.flights
            if (f.environment, f.estimator) == (environment, ranking.best)
        ]
        if own:
            made = own[0].arguments["options"]
            _, module, name = made["estimator"].rpartition(":")
            kind, chosen = name if module else f'"{name}"', made.get("estimator_options")
            options = f", estimator_options={chosen}" if chosen else ""
            lines.append(f'gym.make("{environment}", estimator={kind}{options})')
        tuned = [need.key + need.artifact for job in own for need in job.needs]
        tuned = [name for name in tuned if name.endswith(".toml")]
        if tuned:
            lines.append(f"vessel-gym evaluate {environment} --tuned jobs/{tuned[0]}")
    return lines


def summary(ranking: Ranking) -> pd.DataFrame:
    """The best estimators of some environments: their scores, and how their tails are."""
    rows = {
        name: {
            "normalised score": text(ranking.score(name), 3),
            "below truth": text(ranking.loss(name), 3),
            "completed [%]": text(ranking.completed(name), 1),
            "worst tenth": text(ranking.worst_decile(name), 3),
        }
        for name in list(ranking.scores)[:BEST]
    }
    return _table(rows)


def _table(rows: dict[str, dict[str, str]]) -> pd.DataFrame:
    """A table of texts with a row for each estimator."""
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("estimator")


def heading(results: Results, environment: str) -> str:
    """Title of `conditions_table`."""
    unit = "normalised score" if environment in rankings(results) else "score"
    return f"{environment}: {unit} (individual 95 % intervals)"


def conditions_table(results: Results, environment: str) -> pd.DataFrame:
    """Normalised score of the classical agent on each estimator in each condition.

    Both are in the file's order. Without a scale it is the score.
    """
    values = results.normalised if environment in rankings(results) else results.wide("score")
    names, rows = results.conditions(environment), {}
    for estimator in results.estimators(environment):
        own = results.rows(values, estimator)
        found = own[own.index.isin([(environment, name) for name in names])]
        cells = [text(crossed_interval(row[None]), 3) for row in found.to_numpy()]
        rows[estimator] = dict(zip(found.index.get_level_values("condition"), cells, strict=True))
    return _table(rows).reindex(columns=names).fillna("–")


def ranking_table(results: Results) -> pd.DataFrame:
    """Normalised score of each estimator and its verdict against the best, by environment."""
    found = {
        head: {
            name: f"{text(ranking.score(name), 3)}, {_verdict(ranking, name)}"
            for name in ranking.scores
        }
        for head, ranking in rankings(results).items()
    }
    return pd.DataFrame(found).fillna("–").rename_axis("estimator")


def _verdict(ranking: Ranking, name: str) -> str:
    """The verdict against the best; with it, about how many more episodes would decide."""
    word = ranking.verdicts.get(name, "best")
    more = f" ({ranking.episodes_to_decide(name):.2g})" if word == UNDECIDED else ""
    return word + more


def differences_table(results: Results) -> pd.DataFrame:
    """Difference of the normalised score from that on the reference, and the verdict on it."""
    columns = {}
    for head, ranking in rankings(results).items():
        first = ranking.reference
        columns[head] = {first: "reference"} | {
            name: f"{text(ranking.gap(name, first), 3, True)}, {ranking.verdict(name, first)}"
            for name in ranking.scores
            if name != first
        }
    return pd.DataFrame(columns).fillna("–").rename_axis("estimator")


def markdown(results: Results) -> str:
    """The answer and its tables as Markdown."""
    blocks = [f"# {results.plan.study.title}", "\n".join(answer(results))]
    ranked = bool(rankings(results))
    if not (found := effects_table(results).set_index("factor")).empty:
        blocks.append(markdown_frame(found))
    if ranked:
        lines = "\n".join(code(results))
        blocks += [markdown_frame(choices_table(results)), f"```python\n{lines}\n```"]
        blocks.append(legend(results))
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
