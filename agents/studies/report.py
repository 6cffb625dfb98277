"""The report of a study: one page that needs nothing but itself, a Markdown file, and the table."""

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from agents.episodes import Episode
from agents.files import replacing, write_text
from agents.jobs import versions
from agents.metrics import NEES, SCORE, UNHEALTHY, Metric, mean, metrics
from agents.page import Block, iframe, listed, text, write_page
from agents.plotting import learning_figure
from agents.statistics import crossed_interval
from agents.studies.answer import answer
from agents.studies.figures import conditions_figure
from agents.studies.ranking import ALL, policy_score, rankings
from agents.studies.records import ORACLE
from agents.studies.results import FLIGHT, Results, at
from agents.studies.tables import (
    choices_table,
    code,
    conditions_table,
    differences_table,
    effects_table,
    heading,
    legend,
    markdown,
    ranking_table,
    summary,
    tuned_table,
)
from agents.studies.worlds import system_of
from agents.tuning.arm import LIKELIHOOD


def write_report(
    results: Results, out: Path, pages: Mapping[str, dict[str, object]], command: str = ""
) -> Path:
    """Write ``report.html``, ``ranking.md`` and ``results.parquet``, each whole or not at all.

    Args:
        results: Of a run, perhaps of a part of it.
        out: The folder.
        pages: Data of the example episode of each environment, see `agents.episodes.Episode`.
        command: The command that runs the study again, if there is one.

    Returns:
        The page.

    Raises:
        OSError: if a file cannot be written.
        ModuleNotFoundError: without Matplotlib, Jinja or PyArrow.
    """
    with replacing(out / "results.parquet") as path:
        results.table.to_parquet(path, index=False)
    write_text(out / "ranking.md", markdown(results))
    study = results.plan.study
    subtitle = f"{listed(study.environments)}, {study.episodes} evaluation seeds"
    blocks = [_effects(results), *_ranked(results)]
    for environment in results.environments:
        blocks += _environment(results, environment)
    blocks += [*_learned(results), *(_episode(name, page) for name, page in pages.items())]
    blocks += [*_left_out(results), _limits(), _run(results, command)]
    blocks = [block for block in blocks if block.table is None or len(block.table)]
    return write_page(out / "report.html", study.title, subtitle, answer(results), blocks)


def _effects(results: Results) -> Block:
    """The table of the factors."""
    return Block(
        "How much each factor moves the score",
        effects_table(results),
        f"Score of {results.who} at the best and at the worst level minus that at the reference,"
        " the first of the study or the one that it names. All other factors are equal; their"
        " combinations count alike, where both levels have a result. The 95 % intervals hold"
        " for all levels of a factor at once. Raw measurements are no level of the estimator.",
    )


def _ranked(results: Results) -> list[Block]:
    """Blocks about normalised scores."""
    if not (columns := rankings(results)):
        return []
    head, ranking = next(iter(columns.items()))
    return [
        Block(
            "What to use under each condition",
            choices_table(results),
            "The estimator with the highest normalised score; in brackets others that are not"
            " significantly worse.",
        ),
        Block(
            "Code for the best estimator of each environment, run here",
            code="\n".join(code(results)),
        ),
        Block(
            f"The best estimators for {results.who}, {head}",
            summary(ranking),
            "Normalised score, share of completed episodes with its 95 % interval for other seeds,"
            f" and mean score of the worst tenth of the episodes. {legend(results)}",
        ),
        Block(
            "Normalised score in each condition",
            figures={"Normalised score in each condition": conditions_figure(results)},
            note="The scale is that of each condition; the 95 % intervals are individual.",
        ),
        Block(
            "Normalised score, and the verdict against the best of each column",
            ranking_table(results),
            "A dash: not used there, or not in every condition.",
        ),
        Block(
            "Difference from the reference",
            differences_table(results),
            "Normalised score minus that on the reference estimator, paired by evaluation seed; the"
            " 95 % hold for all pairs of a column at once.",
        ),
    ]


def _environment(results: Results, environment: str) -> list[Block]:
    """The tables of an environment: tunings, conditions, costs and consistency."""
    first = results.conditions(environment)[0]
    who = results.who + ", tuned" * bool(tuning := results.plan.study.tune)
    how = "estimator and controller tuned together"
    if tuning and tuning.by == LIKELIHOOD:
        how = "Q and R tuned for likely measurements"
    chosen = [SCORE, *(m for m in metrics(system_of(environment)) if m.cost)]
    meanings = " ".join(f"{m.label}: {m.meaning}" for m in chosen)
    return [
        Block(
            f"{environment}: tuned for {first}",
            tuned_table(results, environment),
            f"Score with everything as delivered, and with {how}, each estimator with equal"
            " effort. The gain's interval is crossed over tunings and"
            " evaluation seeds. Overfitting: the gain on tuning seeds minus that on other seeds. At"
            " a bound: parameters at an end of their range in some tuning.",
        ),
        Block(
            heading(results, environment),
            conditions_table(results, environment),
            f"Of {who}.",
        ),
        Block(
            f"{environment}: secondary metrics, {first}",
            costs(results, environment, chosen),
            f"Of {who} on {ORACLE}, and on the others the differences from that, paired by"
            f" evaluation seed. {meanings}",
        ),
        Block(
            f"{environment}: consistency, {first}",
            consistency(results, environment),
            f"{NEES.label}: {NEES.meaning} In band: share of times at which the mean NEES over the"
            f" episodes lies in its 95 % chi-square band. {UNHEALTHY.label}: {UNHEALTHY.meaning}",
        ),
    ]


def costs(results: Results, environment: str, chosen: Sequence[Metric]) -> pd.DataFrame:
    """Score and costs of `Results.compared` in the first condition, minus those on the truth.

    Differences are of the tunings that both have, with crossed intervals. Empty without the truth.
    """
    columns, first = {}, results.conditions(environment)[0]
    for m in chosen:
        wide = at(results.wide(m.key), environment=environment, condition=first)
        truth = at(wide, policy=results.reference_policy, estimator=ORACLE)
        if truth.empty:
            break
        column = columns[m.title] = {ORACLE: text(mean(m, truth.to_numpy()), m.decimals)}
        tuned = results.reference_policy == results.compared
        for name in results.estimators(environment=environment):
            if name != ORACLE:
                ours = at(wide, policy=results.compared, estimator=name)
                more = (ours - (truth if tuned else truth.iloc[0])).dropna(how="all").dropna(axis=1)
                column[name] = text(crossed_interval(more.to_numpy()), m.decimals, True)
    return pd.DataFrame(columns).rename_axis("estimator")


def consistency(results: Results, environment: str) -> pd.DataFrame:
    """Claimed uncertainty of the classical agent's estimators in the first condition."""
    place = [environment, results.conditions(environment)[0], results.compared]
    here = (results.table[FLIGHT[:3]] == place).all(axis=1)
    own = results.table[here].groupby("estimator", sort=False)
    columns = {NEES.key: NEES.label, "nees_in_band": "In band", UNHEALTHY.key: UNHEALTHY.label}
    found = own[[key for key in columns if key in results.table]].mean().rename(columns=columns)
    return found.map(lambda value: text(value, 2))


def _learned(results: Results) -> list[Block]:
    """Normalised scores of learned policies on every estimator, and their learning curves."""
    environments, episodes = [e for e in rankings(results) if e != ALL], results.table
    rows = {
        (policy, estimator): {e: policy_score(results, e, policy, estimator) for e in environments}
        for policy in results.learned
        for estimator in episodes[episodes.policy == policy].estimator.unique()
    }
    found = pd.DataFrame.from_dict(rows, orient="index").map(text)
    found = found.loc[:, (found != "–").any()]
    if found.empty:
        return []
    runs = results.plan.study.training_seeds
    return [
        Block(
            "Normalised scores of learned agents",
            found.rename_axis(["policy", "estimator"]),
            f"Means over training runs ({runs}), conditions and evaluation seeds, with 95 %"
            " intervals for other runs, if there are several, on other seeds. Fewer than five say"
            " little of what another training would give. Policies learn in the first condition.",
        ),
        *(
            Block(
                title := f"Learning curves in {environment}",
                figures={title: learning_figure(curves, "return of training episodes")},
                note="Mean and range over training runs of the return of the last training"
                " episodes, whose actions are drawn at random about the policy's own.",
            )
            for environment in results.environments
            if (curves := results.curves(environment))
        ),
    ]


def _episode(environment: str, page: dict[str, object]) -> Block:
    """The example episode of an environment, which plays."""
    title = f"An episode in {environment}"
    note = (
        "The recommended estimator, the reference and the truth in the first condition, at the seed"
        " whose scores lie nearest to their means over all evaluation seeds."
    )
    return Block(title, note=note, html=iframe(title, Episode(page).html()))


def _left_out(results: Results) -> list[Block]:
    """Estimators and agents that an environment refuses, and jobs that failed."""
    found = [f"{each.what} in {each.environment}: {each.reason}." for each in results.plan.skipped]
    for why in results.outcome.failures.values():
        label, _, reason = why.strip().partition(": ")
        found.append(f"{label} failed: {reason.splitlines()[-1]}")
    return [Block("Left out and failed", items=found)] if found else []


def _limits() -> Block:
    """Assumptions behind the numbers."""
    return Block("Assumptions and limits", items=[
        "Intervals are for other evaluation seeds and other training runs; seeds are the same for"
        " everybody, so that differences are paired. Environments and conditions count alike.",
        "The truth is a reference: it knows the present state, but not what the disturbance will do"
        " next. A filter that smooths may steer better.",
        "Estimators are tuned by their environments' authors, who know the disturbance's"
        " statistics: what is compared is an estimator with its tuning.",
        "Everything is simulated. Nothing here was measured in the world.",
    ])  # fmt: skip


def _run(results: Results, command: str) -> Block:
    """All that is needed to run the study again."""
    study = results.plan.study
    minutes = sum(results.outcome.seconds.values()) / 60.0
    return Block("To run it again", items=[
        *filter(None, [command]),
        f"Evaluation seeds {study.seeds[0]} to {study.seeds[-1]}, termination {study.termination},"
        f" margin of equivalence {study.margin:g}. The folder jobs has the settings, source and"
        " versions behind each result.",
        f"{platform.system()} {platform.machine()}, Python {platform.python_version()}, "
        + ", ".join(f"{name} {version}" for name, version in versions().items()),
        f"{minutes:.1f} CPU minutes for {len(results.outcome.seconds)} jobs",
    ])  # fmt: skip
