"""Score an agent over many seeds: ``vessel-gym evaluate --agent autopilot --disturbance rough``."""

import csv
from contextlib import closing
from dataclasses import astuple
from pathlib import Path
from typing import Any

from agents.commands.console import asked, print_table, progress
from agents.commands.options import acting

DEFAULT = "default"
"""Stands for the environment's own estimator."""
COLUMNS = (
    "environment", "agent", "episodes", "estimator", "metric", "unit", "mean", "low", "high",
    "reference", "difference", "difference_low", "difference_high",
)  # fmt: skip
"""Columns of the file; low and high are the ends of 95 % intervals."""


OPTIONS = {
    "estimator": "one or more estimators; default is the environment's own",
    "compare_to": "estimator from which differences of the others are taken; if not given, truth or"
    " else the first",
    "episodes": "episodes for each estimator",
    "out": "file for all means, differences and their intervals (.csv)",
}


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    agent: str = "autopilot",
    estimator: tuple[str, ...] = (DEFAULT,),
    compare_to: str | None = None,
    episodes: int = 100,
    first_seed: int = 0,
    out: Path | None = None,
    **options: Any,
) -> None:
    """Run an agent with one or several estimators, over the same seeds, and print its metrics."""
    from agents import load_agent
    from agents.files import check_file
    from agents.rollouts import batch
    from agents.seeds import evaluation_seeds
    from agents.studies.worlds import registered_id, system_of
    from vessel_gym.checks import one_of

    agent = acting(agent, options)
    with asked():
        system = system_of(env_id := registered_id(env_id))
        seeds = evaluation_seeds(episodes, first_seed)
        worlds = dict(_world(env_id, name, options) for name in estimator)
        for world in worlds.values():
            with closing(batch(env_id, 1, world)) as env:
                load_agent(agent, env)
        compare_to = compare_to or ("truth" if "truth" in worlds else next(iter(worlds)))
        one_of("estimator to compare to", compare_to, worlds)
        if out:
            one_of("kind of file", out.suffix.lower(), (".csv",))
            check_file(out)
    given = "".join(f", {name}={value}" for name, value in options.items())
    title = f"{env_id}, {agent}: means and 95 % intervals, episodes: {episodes}{given}"
    columns = _run(title, agent, env_id, seeds, worlds)
    if len(columns) > 1:
        _compare(agent, {name: column["score"] for name, column in columns.items()}, compare_to)
    if out:
        _write(out, (env_id, agent, episodes), system, columns, compare_to)


def _world(env_id: str, estimator: str, options: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Name of an estimator, and the options of the environment with it."""
    from agents.studies.worlds import environment_options, system_of

    if estimator != DEFAULT:
        return estimator, environment_options(env_id, options | {"estimator": estimator})
    world = environment_options(env_id, options)
    default = world.get("estimator", system_of(env_id).estimator or "no estimator")
    return getattr(default, "__name__", default), world


def _run(
    title: str, agent: str, env_id: str, seeds: list[int], worlds: dict[str, Any]
) -> dict[str, dict[str, Any]]:
    """Run the seeds with each estimator, print a table of the metrics, and return their values."""
    import numpy as np

    from agents import rollout
    from agents.metrics import SCORE, metrics, scores

    columns = {}
    with progress("estimators") as show:
        for name, options in worlds.items():
            run = rollout(agent, env_id, seeds, options)
            columns[name] = scores(run)
            show(len(columns), len(worlds))
    first = sorted(metrics(run.config.system), key=lambda m: not (m.cost or m.key == SCORE.key))
    values = [(m, [column[m.key] for column in columns.values()]) for m in first]
    rows = [_row(metric, each) for metric, each in values if np.isfinite(each).any()]
    print_table(title, ["metric", *columns], rows)
    return columns


def _compare(agent: str, scores: dict[str, Any], reference: str) -> None:
    """Print the differences of scores from the reference; warn of those beyond the truth's."""
    from agents.page import text
    from agents.statistics import paired_difference
    from agents.studies.records import ORACLE, beyond_the_truth

    others, said, beyond = [name for name in scores if name != reference], [], []
    for name in others:
        more = paired_difference(scores[name], scores[reference], comparisons=len(others))
        said.append(f"{name} {text(more, 3, True)}")
        if reference == ORACLE and more.low > 0.0:
            beyond.append(name)
    print(f"Score minus that with {reference}, paired by seed: {', '.join(said)}")
    if beyond:
        print(beyond_the_truth(beyond, agent))


def _write(
    out: Path, about: tuple[Any, ...], system: Any, columns: dict[str, Any], reference: str
) -> None:
    """Write the mean of every metric with each estimator, and its difference from the reference."""
    from agents.files import replacing
    from agents.metrics import mean, metrics
    from agents.statistics import mean_interval

    with replacing(out) as path, path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for metric in metrics(system):
            for name, column in columns.items():
                values = column[metric.key]
                more = values - columns[reference][metric.key]
                difference = astuple(mean_interval(more, max(len(columns) - 1, 1)))
                average = astuple(mean(metric, values[None]))
                cells = name, metric.key, metric.unit, *average, reference, *difference
                writer.writerow((*about, *cells))


def _row(metric: Any, columns: list[Any]) -> list[str]:
    """Name of a metric, and its mean with each estimator; of one episode, its value."""
    from agents.metrics import mean
    from agents.page import text

    of = f"{metric.label} error, RMS" if metric.key.endswith("_rmse") else metric.label
    means = (text(mean(metric, values[None]), metric.decimals) for values in columns)
    return [metric.title.replace(metric.label, of), *means]
