"""Score an agent over many seeds: ``vessel-gym evaluate --agent autopilot --disturbance rough``."""

from contextlib import closing
from typing import Any

import tyro

from agents.commands.console import asked, in_range, print_table, progress_bar
from agents.commands.world import World


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    agent: str = "autopilot",
    estimator: tuple[str | None, ...] = (None,),
    world: tyro.conf.OmitArgPrefixes[World] = World(),  # noqa: B008  (frozen)
    episodes: int = 100,
    first_seed: int = 0,
    trust: bool = False,
) -> None:
    """Fly an agent on one or several estimators, over the same seeds, and print its metrics.

    Args:
        env_id: Registered environment.
        agent: A controller of the task (autopilot, lqg, pid), ppo (comes with the package), random,
            the path of a checkpoint, or your own as module:object, whose code is run.
        estimator: One or more estimators; the environment's default if not given.
        world: Options of the environment.
        episodes: Episodes for each estimator.
        first_seed: Number of the first evaluation seed, counted from 0.
        trust: Load a checkpoint that vessel-gym did not write, although it can run any code.
    """
    from agents import load_agent
    from agents.rollouts import batch
    from agents.seeds import evaluation_seeds
    from agents.studies.worlds import options_of_command, registered_id

    with asked():
        if not estimator:
            raise ValueError("--estimator needs the name of at least one estimator")
        env_id = registered_id(env_id)
        in_range("--episodes", episodes, 1)
        in_range("--first-seed", first_seed, 0)
        seeds = evaluation_seeds(episodes, first_seed)
        worlds = [options_of_command(env_id, world.options(name)) for name in estimator]
        for options in worlds:
            with closing(batch(env_id, 1, options)) as env:
                load_agent(agent, env, trust)
    over = "one episode" if episodes == 1 else f"mean and 95 % interval over {episodes} episodes"
    conditions = f", {world.disturbance} {world.sensors}" if "mismatch" in worlds[0] else ""
    _fly(f"{env_id}, {agent}: {over}{conditions}", agent, env_id, seeds, worlds, trust)


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
            core = core_of(flown)
            chosen = metrics(core.system)
            header.append(core.estimator or "no estimator")
            advance()
    given = [
        metric
        for metric in chosen
        if any(np.isfinite(column[metric.key]).any() for column in columns)
    ]
    beside = [metric for metric in given if metric.cost or metric.key == SCORE.key]
    sections = beside, [metric for metric in given if metric not in beside]
    print_table(
        title, header, ([_row(metric, columns) for metric in section] for section in sections)
    )


def _row(metric: Any, columns: list[dict[str, Any]]) -> list[str]:
    """Name of a metric, and its mean on each estimator; of one episode, its value."""
    import numpy as np

    from agents.metrics import mean
    from agents.page import words

    def cell(values: Any) -> str:
        alone = len(values) == 1 and np.isfinite(values[0]) and not metric.yes_or_no
        return (
            f"{values[0]:.{metric.decimals}f}"
            if alone
            else words(mean(metric, values[None]), metric.decimals)
        )

    name = f"{metric.label} [{metric.unit}]" if metric.unit else metric.label
    return [name, *(cell(column[metric.key]) for column in columns)]
