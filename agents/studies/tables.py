"""Tables of a study's report, of texts."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from agents.page import markdown_table, mean_and_half, text
from agents.statistics import (
    CLEARLY_WORSE,
    SLIGHTLY_WORSE,
    UNDECIDED,
    Interval,
    crossed_interval,
    mean_interval,
    share_interval,
)
from agents.studies.answer import answer
from agents.studies.effects import Effect, effects
from agents.studies.ranking import Ranking, rankings
from agents.studies.results import FLIGHT, Results, values

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


def effects_table(results: Results) -> pd.DataFrame:
    """Factors with their reference, best and worst levels, and what these change in the score."""
    table = pd.DataFrame(effects(results), columns=Effect._fields).set_index("factor")
    table = table.drop(columns="trend")
    changes = table[["gain", "loss"]].map(lambda c: text(c, 3, True) if c.mean else "–")
    return table.assign(gain=changes.gain, loss=changes.loss)


def tuned_table(results: Results, environment: str) -> pd.DataFrame:
    """Score in the first condition as delivered and tuned, and what the tunings found.

    The gain is crossed over tunings and seeds. Overfitting is the gain on tuning seeds less that on
    other seeds.
    """
    first, compared = results.conditions(environment)[0], results.compared
    tunings: dict[str, list[dict[str, Any]]] = {}
    for flight in results.plan.where(environment=environment, condition=first, policy=compared):
        if found := results.needed(flight):
            tunings.setdefault(flight.estimator, []).append(found)
    rows = {}
    for name, each in tunings.items():
        old, new = (
            values(results.score, environment, first, policy, name)
            for policy in (results.classical, compared)
        )
        if len(old):
            over, nees, bounds = tuning_findings(each)
            rows[name] = {
                "delivered": mean_and_half(old),
                "tuned": mean_and_half(new),
                "gain": text(crossed_interval(new - old[:1]), 3, True),
                "overfitting": text(over, 3, True) if len(each) > 1 else "–",
                "Position NEES/n": nees,
                "at a bound": bounds,
            }
    return _table(rows)


def tuning_findings(tunings: Sequence[dict[str, Any]]) -> tuple[Interval, str, str]:
    """Overfitting of an arm's tunings, its NEES/n of the position, and parameters at a bound."""
    over = [found["after"] - found["before"] - found["gain"][0] for found in tunings]
    nees = text(float(np.mean([found["position_nees"] for found in tunings])), 2)
    bounds = sorted({name for found in tunings for name in found["at_bound"]})
    return mean_interval(over), nees, ", ".join(bounds) or "–"


def choices_table(results: Results) -> pd.DataFrame:
    """The estimator with the highest normalised score in each condition, a column an environment.

    In brackets are others that are not significantly worse there.
    """
    columns: dict[str, dict[str, str]] = {}
    for (environment, condition), scale in results.scales.groupby(FLIGHT[:2], sort=False):
        if (ranking := Ranking(results, scale)).scores:
            worse = SLIGHTLY_WORSE, CLEARLY_WORSE
            rivals = [name for name, word in ranking.verdicts.items() if word not in worse]
            beside = f" ({', '.join(rivals[:2])}{', ...' * (len(rivals) > 2)})" * bool(rivals)
            cell = f"{ranking.best} {text(ranking.score(ranking.best), 2)}{beside}"
            columns.setdefault(environment, {})[condition] = cell
    return pd.DataFrame(columns).fillna("–").rename_axis("condition")


def code(results: Results) -> list[str]:
    """A line for each environment that makes it with its best estimator, as tuned if it is."""
    lines = []
    for environment, ranking in rankings(results).items():
        flights = results.plan.where(environment=environment, estimator=ranking.best)
        needs = [need.key + need.artifact for flight in flights for need in flight.job.needs]
        if tuned := [name for name in needs if name.endswith(".toml")]:
            options = f'**agents.load_tuned("jobs/{tuned[0]}").env_options'
            lines.append(f'gym.make("{environment}", {options})  # {ranking.best}')
        elif flights:
            made = flights[0].job.arguments["options"]
            _, module, name = made["estimator"].rpartition(":")
            kind, chosen = name if module else f'"{name}"', made.get("estimator_options")
            options = f", estimator_options={chosen}" if chosen else ""
            lines.append(f'gym.make("{environment}", estimator={kind}{options})')
    return lines


def summary(ranking: Ranking) -> pd.DataFrame:
    """The best estimators of some environments: their scores, and the tails of these."""
    table, rows = ranking.results.table, {}
    own = table[table.environment.isin(ranking.environments)]
    own = own[own.policy == ranking.results.compared]
    for name in list(ranking.scores)[:BEST]:
        episodes = own[own.estimator == name]
        hits = episodes.groupby("seed").completed.mean()
        rows[name] = {
            "normalised score": text(ranking.score(name)),
            "completed [%]": text(share_interval(hits.sum(), len(hits)).times(100.0), 1),
            "worst tenth": text(episodes.score.nsmallest(-(-len(episodes) // 10)).mean(), 3),
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
    """Normalised score of `Results.compared` on each estimator in each condition.

    Both are in the file's order. Without a scale it is the score.
    """
    wide = results.normalised if environment in rankings(results) else results.score
    rows = {}
    for name in results.estimators(environment=environment):
        rows[name] = {
            condition: mean_and_half(values(wide, environment, condition, results.compared, name))
            for condition in results.conditions(environment)
        }
    return _table(rows)


def ranking_table(results: Results) -> pd.DataFrame:
    """Normalised score of each estimator and its verdict against the best, by environment."""
    found = {
        head: {
            name: f"{text(ranking.score(name))}, {_verdict(ranking, name)}"
            for name in ranking.scores
        }
        for head, ranking in rankings(results).items()
    }
    return pd.DataFrame(found).fillna("–").rename_axis("estimator")


def _verdict(ranking: Ranking, name: str) -> str:
    """The verdict against the best; with it, about how many more episodes would decide."""
    word = ranking.verdicts.get(name, "best")
    more = f" ({ranking.episodes_to_decide(name):.0f} more)" if word == UNDECIDED else ""
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
    """The answer, the score in each condition and the ranking as Markdown."""
    tables = {heading(results, e): conditions_table(results, e) for e in results.environments}
    blocks = [f"# {results.plan.study.title}", "\n".join(answer(results)), legend(results)]
    if rankings(results):
        tables["All conditions"] = ranking_table(results)
    for head, table in tables.items():
        blocks += [f"## {head}", markdown_frame(table)]
    return "\n\n".join(blocks) + "\n"


def markdown_frame(table: pd.DataFrame) -> str:
    """A table of texts as Markdown."""
    cells = table.reset_index()
    heading, *rows = [
        [str(cell).replace("|", "\\|") for cell in row]
        for row in (cells.columns, *cells.itertuples(index=False))
    ]
    return markdown_table(heading, rows, len(heading))
