"""The report of a study: one page that needs nothing but itself, a Markdown file, and the table."""

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from agents.episodes import Episode
from agents.files import replacing
from agents.jobs import versions
from agents.metrics import NEES, SCORE, UNHEALTHY, Metric, mean, metrics
from agents.page import Block, bullets, frame, listed, picture, table, text, write_page
from agents.plotting import data_uri
from agents.statistics import mean_interval
from agents.studies.answer import (
    answer,
    conditions_table,
    heading,
    legend,
    markdown,
    ranking_table,
    summary,
    to_copy,
)
from agents.studies.figures import robustness_figure, shares_figure
from agents.studies.records import ORACLE
from agents.studies.results import Results
from agents.studies.shares import ALL, kept, rankings
from agents.studies.worlds import system_of
from vessel_gym.extras import require


def write_report(results: Results, out: Path, pages: Mapping[str, dict[str, object]]) -> Path:
    """Write ``report.html``, ``ranking.md`` and ``results.parquet``, each whole or not at all.

    Args:
        results: Of a run, perhaps of a part of it.
        out: The folder.
        pages: Data of the example episode of each environment, see `agents.episodes.Episode`.

    Returns:
        The page.

    Raises:
        OSError: if a file cannot be written.
        ModuleNotFoundError: without Matplotlib, Jinja or PyArrow.
    """
    require("matplotlib", "jinja2", "pyarrow")
    with replacing(out / "results.parquet") as path:
        results.table.to_parquet(path, index=False)
    with replacing(out / "ranking.md") as path:
        path.write_text(markdown(results), encoding="utf-8")
    study = results.plan.study
    subtitle = f"{listed(study.environments)}, {study.episodes} evaluation seeds"
    blocks = [*_ranked(results), *_environments(results), *_learned(results)]
    blocks += [_episode(results, name, page) for name, page in pages.items()]
    blocks += [*_left_out(results), _limits(), _run(results, out)]
    return write_page(out / "report.html", study.title, subtitle, answer(results), blocks)


def _ranked(results: Results) -> list[Block]:
    """Blocks about the share kept in all conditions together."""
    if not (columns := rankings(results)):
        return []
    head, ranking = next(iter(columns.items()))
    return [
        table("To copy", to_copy(results).set_index("where"), legend(results)),
        table(
            f"The best estimators for {results.who}, {head}",
            summary(ranking),
            "Means over conditions and evaluation seeds with 95 % intervals for other seeds, the"
            f" first two for all estimators at once: the share kept of {ORACLE} over dead"
            f" reckoning, the score lost against {ORACLE}, completed episodes, and the mean score"
            " of the worst tenth of them.",
        ),
        picture("Share of the oracle's performance kept", data_uri(shares_figure(results))),
        table(
            "Share kept, and the verdict against the best of each column",
            ranking_table(results),
            "In each environment and condition, the score on dead reckoning is 0 and that on the"
            " truth 1, in the same episodes. Intervals and verdicts as above. A dash: not used"
            " there, or not in every condition.",
        ),
        table(
            "Difference from the best",
            _differences(results),
            "Share kept minus that on the best, paired by evaluation seed; the 95 % hold for all"
            " pairs of a column at once.",
        ),
        picture(
            "Share kept in each condition",
            data_uri(robustness_figure(results)),
            "The scale is that of each condition; the 95 % intervals are individual.",
        ),
    ]


def _differences(results: Results) -> pd.DataFrame:
    columns = {
        head: {
            name: f"{text(ranking.gap(name, ranking.best), 3, True)}, {word}"
            for name, word in ranking.verdicts.items()
        }
        for head, ranking in rankings(results).items()
    }
    return pd.DataFrame(columns).fillna("–").rename_axis("estimator")


def _environments(results: Results) -> list[Block]:
    """The tables of each environment: conditions, costs and consistency."""
    blocks = []
    for environment in results.environments:
        first = results.conditions(environment)[0]
        cells = conditions_table(results, environment)
        blocks.append(table(heading(results, environment), cells, f"Of {results.who}."))
        chosen = [SCORE, *(m for m in metrics(system_of(environment)) if m.cost)]
        meanings = " ".join(f"{m.label}: {m.meaning}" for m in chosen)
        if (environment, first) in results.rows(results.wide("score"), ORACLE).index:
            blocks.append(
                table(
                    f"{environment}: costs, {first}",
                    costs(results, environment, chosen),
                    f"Of {results.who} on {ORACLE}, and on the others the differences from that,"
                    f" paired by evaluation seed. {meanings}",
                )
            )
        blocks.append(
            table(
                f"{environment}: consistency, {first}",
                consistency(results, environment),
                f"{NEES.label}: {NEES.meaning} In band: share of times at which the mean NEES over"
                " the episodes lies in its 95 % chi-square band."
                f" {UNHEALTHY.label}: {UNHEALTHY.meaning}",
            )
        )
    return blocks


def costs(results: Results, environment: str, chosen: Sequence[Metric]) -> pd.DataFrame:
    """Score and costs of the classical agent in the first condition, beyond those on the truth."""
    columns, place = {}, (environment, results.conditions(environment)[0])
    for m in chosen:
        each = {
            name: rows.loc[place].to_numpy()
            for name in results.estimators(environment)
            if place in (rows := results.rows(results.wide(m.key), name)).index
        }
        truth = each.pop(ORACLE)
        column = columns[m.title] = {ORACLE: text(mean(m, truth[None]), m.decimals)}
        for name, ours in each.items():
            column[name] = text(mean_interval(ours - truth), m.decimals, True)
    return pd.DataFrame(columns).rename_axis("estimator")


def consistency(results: Results, environment: str) -> pd.DataFrame:
    """Claimed uncertainty of the classical agent's estimators in the first condition."""
    table, first = results.table, results.conditions(environment)[0]
    here = (table.environment == environment) & (table.condition == first)
    own = table[here & (table.policy == results.classical)].groupby("estimator", sort=False)
    columns = {NEES.key: NEES.label, "nees_in_band": "In band", UNHEALTHY.key: UNHEALTHY.label}
    found = own[[key for key in columns if key in table]].mean().rename(columns=columns)
    return found.map(lambda value: text(value, 2))


def _learned(results: Results) -> list[Block]:
    """Shares that learned policies keep, at home and on other estimators."""
    rows = {}
    for policy in results.learned:
        shares = {e: kept(results, e, policy) for e in rankings(results) if e != ALL}
        flown = results.table[results.table.policy == policy].estimator.unique()
        rows[policy, "that of its training"] = shares
        for estimator in flown if len(flown) > 1 else ():
            rows[policy, estimator] = {e: kept(results, e, policy, estimator) for e in shares}
    found = pd.DataFrame.from_dict(rows, orient="index").dropna(axis=1, how="all")
    if found.empty:
        return []
    runs = results.plan.study.training_seeds
    found = found.map(lambda share: text(share, 3)).rename_axis(["policy", "estimator"])
    return [
        table(
            "Share kept by learned agents",
            found,
            f"Means over training runs ({runs}), conditions and evaluation seeds, with 95 %"
            " intervals for other runs, if there are several, on other seeds. Fewer than five say"
            " little of what another training would give. Policies learn in the first condition.",
        )
    ]


def _episode(results: Results, environment: str, page: dict[str, object]) -> Block:
    """The example episode of an environment, which plays."""
    title = f"An episode in {environment}, {results.conditions(environment)[0]}"
    note = "The seed whose scores lie nearest to their means over all evaluation seeds."
    return frame(title, Episode(page).html(), note)


def _left_out(results: Results) -> list[Block]:
    """Estimators and agents that an environment refuses, and jobs that failed."""
    found = [f"{each.what} in {each.environment}: {each.reason}." for each in results.plan.skipped]
    for why in results.outcome.failures.values():
        label, _, reason = why.strip().partition(": ")
        found.append(f"{label} failed: {reason.splitlines()[-1]}")
    return [bullets("Left out and failed", found)] if found else []


def _limits() -> Block:
    """Assumptions behind the numbers."""
    return bullets("Assumptions and limits", [
        "Intervals are for other evaluation seeds and other training runs; seeds are the same for"
        " everybody, so that differences are paired. Environments and conditions count alike.",
        "The truth is the state, not what the disturbance will do next: a ceiling for estimators,"
        " not for agents.",
        "Estimators are tuned by their environments' authors, who know the disturbance's"
        " statistics: what is compared is an estimator with its tuning.",
        "Everything is simulated. Nothing here was measured in the world.",
    ])  # fmt: skip


def _run(results: Results, out: Path) -> Block:
    """All that is needed to run the study again; its settings are in the files beside the page."""
    study = results.plan.study
    minutes = sum(results.outcome.seconds.values()) / 60.0
    return bullets("To run it again", [
        f"vessel-gym ablate {out}/study.toml --out {out}",
        f"Evaluation seeds {study.seeds[0]} to {study.seeds[-1]}, termination {study.termination},"
        f" margin of equivalence {study.margin:g}; every setting, and the source and"
        " versions that a result depends on, are in jobs.",
        f"{platform.system()} {platform.machine()}, Python {platform.python_version()}, "
        + ", ".join(f"{name} {version}" for name, version in versions().items()),
        f"{minutes:.1f} CPU minutes for {len(results.outcome.seconds)} jobs",
    ])  # fmt: skip
