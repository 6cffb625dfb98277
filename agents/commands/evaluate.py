"""Score an agent over many seeds: ``vessel-gym evaluate --agent autopilot --disturbance rough``."""

from contextlib import closing
from typing import Any

from agents.commands.console import asked, in_range, print_table, progress_bar

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
    trust: bool = False,
    **options: Any,
) -> None:
    """Fly an agent on one or several estimators, over the same seeds, and print its metrics."""
    from agents import load_agent
    from agents.rollouts import batch
    from agents.seeds import evaluation_seeds
    from agents.studies.worlds import options_of_command, registered_id

    with asked():
        env_id = registered_id(env_id)
        in_range("--episodes", episodes, 1)
        in_range("--first-seed", first_seed, 0)
        seeds = evaluation_seeds(episodes, first_seed)
        chosen = [{} if name == DEFAULT else {"estimator": name} for name in estimator]
        worlds = [options_of_command(env_id, options | each) for each in chosen]
        for world in worlds:
            with closing(batch(env_id, 1, world)) as env:
                load_agent(agent, env, trust)
    title = f"{env_id}, {agent}: " + (
        "one episode" if episodes == 1 else f"mean and 95 % interval over {episodes} episodes"
    )
    if hasattr(env.unwrapped, "core"):
        title += f", {options.get('disturbance', 'moderate')} {options.get('sensors', 'nominal')}"
    _fly(title, agent, env_id, seeds, worlds, trust)


def _fly(
    title: str, agent: str, env_id: str, seeds: list[int], worlds: list[dict[str, Any]], trust: bool
) -> None:
    """Fly the seeds with each of the environment's options, and print a table of the metrics."""
    import numpy as np

    from agents import rollout
    from agents.metrics import SCORE, core_of, metrics, scores

    header, columns = ["metric"], []
    with progress_bar("flying", len(worlds)) as advance:
        for options in worlds:
            flown = rollout(agent, env_id, seeds, options, trust=trust)
            columns.append(scores(flown))
            header.append(options.get("estimator") or core_of(flown).estimator or "no estimator")
            advance()
    sections: tuple[list[list[str]], list[list[str]]] = ([], [])
    for metric in metrics(core_of(flown).system):
        values = [column[metric.key] for column in columns]
        if np.isfinite(values).any():
            sections[not (metric.cost or metric.key == SCORE.key)].append(_row(metric, values))
    print_table(title, header, sections)


def _row(metric: Any, columns: list[Any]) -> list[str]:
    """Name of a metric, and its mean on each estimator; of one episode, its value."""
    import numpy as np

    from agents.metrics import mean
    from agents.page import words

    def cell(values: Any) -> str:
        if len(values) == 1 and np.isfinite(values[0]) and not metric.yes_or_no:
            return f"{values[0]:.{metric.decimals}f}"
        return words(mean(metric, values[None]), metric.decimals)

    name = f"{metric.label} [{metric.unit}]" if metric.unit else metric.label
    return [name, *map(cell, columns)]
