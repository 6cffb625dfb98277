"""The report of a study: one page that needs nothing but itself, a Markdown file, and the table."""

import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path

import numpy as np
import pandas as pd

import vessel_gym
from agents.episodes import Episode
from agents.files import replacing
from agents.metrics import NEES, SCORE, UNHEALTHY, Metric, mean, metrics
from agents.page import Block, bullets, frame, listed, many, picture, table, text, write_page
from agents.plotting import data_uri
from agents.source import source_digest
from agents.statistics import Interval
from agents.studies.answer import (
    answer,
    conditions_table,
    groups,
    markdown,
    ranking_table,
    summary,
    to_copy,
)
from agents.studies.examples import examples
from agents.studies.figures import robustness_figure, shares_figure
from agents.studies.records import FEW_SEEDS, ORACLE
from agents.studies.results import FLIGHT, Results
from agents.studies.shares import (
    gap,
    interval,
    kept,
    rankable,
    ruled,
    shares,
    verdicts,
)
from agents.studies.worlds import system_of
from vessel_gym.extras import require

_LIBRARIES = ("numpy", "scipy", "llvmlite", "gymnasium", "torch", "stable-baselines3")


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
    counts = {
        "environment": len(study.environments),
        "estimator": len(study.estimators),
        "agent": len(study.agents),
        "condition": len(study.conditions),
        "evaluation seed": study.episodes,
    }
    runs = f", {many(study.training_seeds, 'training run')} each" if study.learned else ""
    subtitle = listed([many(count, noun) for noun, count in counts.items()]) + runs
    blocks = [*_ranked(results), *_environments(results), *_learned(results)]
    blocks += [_episode(results, name, page) for name, page in pages.items()]
    blocks += [*_left_out(results), _limits(results), _run(results, out)]
    return write_page(out / "report.html", study.title, subtitle, answer(results), blocks)


def _ranked(results: Results) -> list[Block]:
    """Blocks about the share kept in all conditions together."""
    if not (columns := groups(results)):
        return []
    margin, (head, column) = results.plan.study.margin, next(iter(columns.items()))
    return [
        table("To copy", to_copy(results).set_index("where")),
        table(
            f"The best estimators for {results.who}{', ' + head if len(columns) > 1 else ''}",
            summary(results, column),
            f"Means over conditions and evaluation seeds with 95 % intervals for other seeds: the"
            f" share kept of {ORACLE} over dead reckoning, the score lost against {ORACLE},"
            " completed episodes, and the mean score of the worst tenth of them.",
        ),
        picture("Share of the oracle's performance kept", data_uri(shares_figure(results))),
        table(
            "Share kept, and the verdict against the best of each column",
            ranking_table(results),
            "In each environment and condition, the score on dead reckoning is 0 and that on the"
            " truth 1, in the same episodes. Intervals and verdicts of a column hold for all its"
            f" estimators at once. Equivalent: within ±{margin:g} of the best. Worse: more than"
            f" {margin:g} below it; lower: below it. A dash: not used there, or not in every"
            " condition.",
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
            "The scale is that of each condition; intervals stand each for itself.",
        ),
    ]


def _differences(results: Results) -> pd.DataFrame:
    columns = {}
    for head, column in groups(results).items():
        ranked = rankable(results, column)
        best, found = next(iter(ranked)), verdicts(results, column, ranked)
        columns[head] = {n: f"{text(gap(ranked, n, best), 3, True)}, {found[n]}" for n in found}
    order = ranking_table(results).index
    return pd.DataFrame(columns, index=order).dropna(how="all").fillna("–")


def _environments(results: Results) -> list[Block]:
    """The tables of each environment: conditions, costs, consistency and CPU time."""
    blocks = []
    for environment in results.environments:
        first = results.conditions(environment)[0]
        unit = "Share kept" if environment in ruled(results) else "Score"
        note = f"Of {results.who}; 95 % intervals over evaluation seeds, each for itself."
        blocks.append(
            table(f"{environment}: {unit.lower()}", conditions_table(results, environment), note)
        )
        chosen = [SCORE, *(m for m in metrics(system_of(environment)) if m.cost)]
        meanings = " ".join(f"{m.label}: {m.meaning}" for m in chosen)
        if (environment, first, results.classical, ORACLE, 0) in results.wide("score").index:
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
                f"{environment}: consistency and CPU time, {first}",
                consistency(results, environment),
                f"{NEES.label}: {NEES.meaning} In band: share of times at which NEES and NIS lie in"
                " their 95 % chi-square bands. Diverged: episodes in which the truth was beyond the"
                f" filter's bounds for half of the time. {UNHEALTHY.label}: {UNHEALTHY.meaning} CPU"
                " time of a step, vehicle and agent included: in a batch, and one vehicle alone.",
            )
        )
    return blocks


def costs(results: Results, environment: str, chosen: Sequence[Metric]) -> pd.DataFrame:
    """Score and costs of the classical agent in the first condition, beyond those on the truth."""
    rows, place = {}, (environment, results.conditions(environment)[0])
    for estimator in (ORACLE, *(n for n in results.estimators(environment) if n != ORACLE)):
        cells = {}
        for m in chosen:
            wide = results.wide(m.key)
            ours, truth = (results.flight(wide, *place, name) for name in (estimator, ORACLE))
            if ours is None or truth is None:
                break
            value: Interval | float | None = None
            if estimator == ORACLE:
                value = mean(m, ours)
            else:
                more = ours - truth
                more = more[:, np.isfinite(more).all(axis=0)]
                value = interval(results, results.classical, more) if more.size else value
            cells[_head(m)] = text(value, m.decimals, estimator != ORACLE)
        if cells:
            rows[estimator] = cells
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("estimator")


def _head(metric: Metric) -> str:
    return f"{metric.label} [{metric.unit}]" if metric.unit else metric.label


def consistency(results: Results, environment: str) -> pd.DataFrame:
    """Claimed uncertainty of the classical agent's estimators in the first condition, and times."""
    first = results.conditions(environment)[0]
    here = results.table.set_index(FLIGHT).sort_index()
    rows = {}
    for name in results.estimators(environment):
        if (flight := (environment, first, results.classical, name, 0)) not in here.index:
            continue
        own = here.loc[[flight]]
        claims = own[NEES.key].notna().any()
        count = f"{int(own.diverged.sum())} of {len(own)}"
        cells = {_head(m): text(mean(m, own[m.key].to_numpy(float)[None]), m.decimals)
                 for m in (SCORE, NEES)}  # fmt: skip
        cells |= {"NEES in band": text(own.nees_in_band.iloc[0], 2)}
        cells |= {"NIS in band": text(own.nis_in_band.iloc[0], 2)}
        cells |= {"Diverged": count if claims else "–"}
        failed = own[UNHEALTHY.key].to_numpy(float)[None] if UNHEALTHY.key in own else None
        cells |= {_head(UNHEALTHY): "–" if failed is None else text(mean(UNHEALTHY, failed), 1)}
        times = results.timings.get((environment, name), [])
        for label, k in (("batch [µs]", 0), ("alone [µs]", -1)):
            cells[label] = text(times[k][1], 1) if times else "–"
        rows[name] = cells
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("estimator")


def _learned(results: Results) -> list[Block]:
    """Shares that learned policies keep, at home and on other estimators."""
    rows = {}
    for policy in results.learned:
        environments = [e for e in ruled(results) if shares(results, [e], policy) is not None]
        flown = results.table[results.table.policy == policy].estimator.unique()
        for estimator in (None, *(flown if len(flown) > 1 else ())):
            cells = {e: text(kept(results, [e], policy, estimator), 3) for e in environments}
            rows[policy, estimator or "that of its training"] = cells
    if not any(rows.values()):
        return []
    runs = results.plan.study.training_seeds
    few = " Fewer than five runs say little of what another training would give."
    index = pd.MultiIndex.from_tuples(list(rows), names=["policy", "estimator"])
    found = pd.DataFrame(list(rows.values()), index=index).fillna("–")
    note = f"Means over {many(runs, 'training run')}, conditions and evaluation seeds, with 95 %"
    note += " intervals for other runs on other seeds. Policies learn in the first condition."
    return [table("Share kept by learned agents", found, note + few * (runs < FEW_SEEDS))]


def _episode(results: Results, environment: str, page: dict[str, object]) -> Block:
    """The example episode of an environment, which plays."""
    title = f"An episode in {environment}, {results.conditions(environment)[0]}"
    note = "The seed whose scores lie nearest to their means over all evaluation seeds."
    return frame(title, Episode(page).html(), note)


def _left_out(results: Results) -> list[Block]:
    """Estimators and agents that an environment refuses, and jobs that failed."""
    found = []
    for reason in dict.fromkeys(each.reason for each in results.plan.skipped):
        each = [f"{s.what} in {s.environment}" for s in results.plan.skipped if s.reason == reason]
        found.append(f"{listed(each)}: {reason}.")
    jobs = [*results.plan.jobs, *examples(results.plan).values()]
    labels = {job.key: job.label for last in jobs for job in (*last.needs, last)}
    for key, why in results.failures.items():
        last = (why.strip().splitlines() or ["no reason given"])[-1]
        found.append(f"{labels.get(key, key)} failed: {last}")
    return [bullets("Left out and failed", list(dict.fromkeys(found)))] if found else []


def _limits(results: Results) -> Block:
    """Assumptions behind the numbers."""
    first = results.plan.study.conditions[0].name
    return bullets("Assumptions and limits", [
        "Intervals are for other evaluation seeds and other training runs; seeds are the same for"
        " everybody, so that differences are paired. Environments and conditions count alike.",
        "The truth is the state, not what the disturbance will do next: a ceiling for estimators,"
        " not for agents.",
        "Estimators are tuned by their environments' authors, who know the disturbance's"
        " statistics: what is compared is an estimator with its tuning.",
        *([f"Agents learn in the first condition, {first}, and meet the others as they are."]
          if results.plan.study.learned else []),
        "Everything is simulated. Nothing here was measured in the world.",
    ])  # fmt: skip


def _run(results: Results, out: Path) -> Block:
    """All that is needed to run the study again; its settings are in the files beside the page."""
    study = results.plan.study
    jobs = [each for job in results.plan.jobs for each in (job, *job.needs)]
    modules = sorted({job.function.partition(":")[0] for job in jobs})
    versions = {"vessel-gym": vessel_gym.__version__}
    for name in _LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    minutes = sum(results.seconds.values()) / 60.0
    return bullets("To run it again", [
        f"vessel-gym ablate {out}/study.toml --out {out}",
        f"Evaluation seeds {study.seeds[0]} to {study.seeds[-1]}, termination {study.termination},"
        f" margin of equivalence {study.margin:g}; every setting is in study.json.",
        f"{platform.system()} {platform.machine()}, Python {platform.python_version()}, "
        + ", ".join(f"{name} {version}" for name, version in versions.items()),
        f"{minutes:.1f} CPU minutes for {len(results.seconds)} jobs",
        *(f"SHA-256 of {name} and what it imports: {source_digest(name)}" for name in modules),
    ])  # fmt: skip
