"""Score an agent over many seeds: ``vessel-gym evaluate --agent autopilot --disturbance rough``."""

from contextlib import closing
from typing import Any

from agents.commands.console import asked, print_table, progress
from agents.commands.options import acting

DEFAULT = "default"
"""Stands for the environment's own estimator."""


OPTIONS = {
    "estimator": "one or more estimators; default is the environment's own",
    "episodes": "episodes for each estimator",
}


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    agent: str = "autopilot",
    estimator: tuple[str, ...] = (DEFAULT,),
    episodes: int = 100,
    first_seed: int = 0,
    **options: Any,
) -> None:
    """Fly an agent on one or several estimators, over the same seeds, and print its metrics."""
    from agents import load_agent
    from agents.rollouts import batch
    from agents.seeds import evaluation_seeds
    from agents.studies.worlds import environment_options, registered_id, system_of

    agent = acting(agent, options)
    with asked():
        default = system_of(env_id := registered_id(env_id)).estimator or "no estimator"
        seeds = evaluation_seeds(episodes, first_seed)
        worlds = {}
        for name in estimator:
            chosen = options if name == DEFAULT else options | {"estimator": name}
            world = environment_options(env_id, chosen)
            label = world.get("estimator", default) if name == DEFAULT else name
            worlds[label] = world
            with closing(batch(env_id, 1, world)) as env:
                load_agent(agent, env)
    given = "".join(f", {name}={value}" for name, value in options.items())
    title = f"{env_id}, {agent}: means and 95 % intervals, episodes: {episodes}{given}"
    _fly(title, agent, env_id, seeds, worlds)


def _fly(title: str, agent: str, env_id: str, seeds: list[int], worlds: dict[str, Any]) -> None:
    """Fly the seeds with each estimator's options, and print a table of the metrics."""
    import numpy as np

    from agents import rollout
    from agents.metrics import SCORE, metrics, scores

    columns = {}
    with progress("estimators") as show:
        for name, options in worlds.items():
            flown = rollout(agent, env_id, seeds, options)
            columns[name] = scores(flown)
            show(len(columns), len(worlds))
    sections: tuple[list[list[str]], list[list[str]]] = ([], [])
    for metric in metrics(flown.config.system):
        values = [column[metric.key] for column in columns.values()]
        if np.isfinite(values).any():
            sections[not (metric.cost or metric.key == SCORE.key)].append(_row(metric, values))
    print_table(title, ["metric", *columns], sections)
    _warn(agent, {name: column[SCORE.key] for name, column in columns.items()})


def _warn(agent: str, columns: dict[str, Any]) -> None:
    """Print a warning if the scores on an estimator are higher than on the truth beyond chance."""
    from agents.page import words
    from agents.statistics import paired_difference
    from agents.studies.records import ORACLE, beyond_the_truth

    truth, found = columns.pop(ORACLE, None), []
    for name, ours in columns.items() if truth is not None else ():
        more = paired_difference(ours, truth, comparisons=len(columns))
        if more and more.low > 0.0:
            found.append(f"{name} ({words(more, 3, True)})")
    if found:
        print(beyond_the_truth(found, agent))


def _row(metric: Any, columns: list[Any]) -> list[str]:
    """Name of a metric, and its mean on each estimator; of one episode, its value."""
    import numpy as np

    from agents.metrics import mean
    from agents.page import words

    def cell(values: Any) -> str:
        if len(values) == 1 and np.isfinite(values[0]) and not metric.yes_or_no:
            return f"{values[0]:.{metric.decimals}f}"
        return words(mean(metric, values[None]), metric.decimals)

    of = f"{metric.label} error, RMS" if metric.key.endswith("_rmse") else metric.label
    return [metric.title.replace(metric.label, of), *map(cell, columns)]
