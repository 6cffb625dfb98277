"""Score an agent over many seeds: ``python -m scripts.evaluate --agent autopilot --disturbance rough``."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from agents.page import words
from scripts.console import command, progress_bar


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    agent: str = "autopilot",
    estimator: tuple[str | None, ...] = (None,),
    sensors: str = "nominal",
    disturbance: str = "moderate",
    mismatch: float = 0.0,
    observe: str = "mean",
    episodes: int = 100,
    first_seed: int = 0,
) -> None:
    """Fly an agent on one or several estimators, over the same seeds, and print what it was worth.

    Args:
        env_id: Registered environment.
        agent: autopilot, random, or the path of a PPO checkpoint.
        estimator: One or more estimators; the environment's default if not given.
        sensors: clean, nominal or degraded.
        disturbance: calm, moderate or rough.
        mismatch: Relative spread of the truth's parameters.
        observe: mean, mean+std or measurement.
        episodes: Episodes for each estimator.
        first_seed: First evaluation seed.
    """
    from agents import rollout
    from agents.scores import mean, metrics, scores
    from agents.seeds import evaluation_seeds

    seeds = evaluation_seeds(episodes, first_seed)
    table = Table(title=f"{env_id}, {agent}: mean and 95 % interval over {episodes} episodes, {disturbance} {sensors}")
    table.add_column("metric")
    columns = []
    with progress_bar("flying", len(estimator)) as advance:
        for name in estimator:
            options = {
                "estimator": name,
                "sensors": sensors,
                "disturbance": disturbance,
                "mismatch": mismatch,
                "observe": observe,
            }
            flown = rollout(agent, env_id, seeds, options)
            columns.append(scores(flown))
            shown = metrics(flown.env.unwrapped.core.task)
            table.add_column(flown.env.unwrapped.core.estimator, justify="right")
            advance()
    for metric in shown:
        cells = [words(mean(metric, column[metric.key][None]), metric.decimals) for column in columns]
        table.add_row(escape(f"{metric.label} [{metric.unit}]" if metric.unit else metric.label), *map(escape, cells))
    Console().print(table)


if __name__ == "__main__":
    command(main)
