"""Example episodes of a study: what was flown and what was believed, at a seed that nobody chose."""

from typing import Any

from agents.cells import Cell
from agents.episodes.recording import page_of
from agents.rollouts import rollout
from agents.studies.plan import Plan
from agents.studies.study import FLOOR, ORACLE
from agents.studies.worlds import classical_pilot, environment_id, environment_options, import_own, system_of


def examples(plan: Plan) -> dict[str, Cell]:
    """The cell of each environment's example.

    The classical agent flies the first evaluation seed in the first condition on the environment's default estimator,
    on the first and the last of the study's others, and on dead reckoning.
    """
    chosen: dict[str, Cell] = {}
    classical = next(agent.name for agent in plan.study.agents if not agent.learned)
    condition = plan.study.conditions[0].name
    for environment in (e.id for e in plan.study.environments):
        flights = {
            f.flown_on: f.cell.arguments
            for f in plan.flights
            if (f.environment, f.condition, f.agent) == (environment, condition, classical)
        }
        default = system_of(environment).estimator
        others = [e.name for e in plan.study.estimators if e.name in flights]
        others = [name for name in others if name not in (default, ORACLE, FLOOR)]
        shown = [name for name in dict.fromkeys([default, *others[:1], *others[-1:], FLOOR]) if name in flights]
        if shown:
            told = {
                "environment": environment,
                "estimators": [(name, flights[name]["options"]) for name in shown],
                "agent": flights[shown[0]]["agent"],
                "seed": plan.study.seeds[0],
                "own": {module: digest for name in shown for module, digest in flights[name]["own"].items()},
            }
            label = f"example episodes in {environment}"
            chosen[environment] = Cell("agents.studies.examples:example", told, label)
    return chosen


def example(
    environment: str, estimators: list[tuple[str, dict[str, Any]]], agent: str, seed: int, own: dict[str, str]
) -> dict[str, Any]:
    """Fly one episode on several estimators, and keep what a page to touch shows of it.

    Args:
        environment: As in the study.
        estimators: The study's name of each, and the environment's options with it.
        agent: As `agents.pilots.make_pilot` takes it.
        seed: Of the episode.
        own: Source digests of the user's own modules, by name: part of the cell, and imported for what they register.

    Returns:
        What `agents.episodes.recording.page_of` gives.
    """
    import_own(own)
    flown = [
        rollout(
            classical_pilot(agent, environment), environment_id(environment), [seed],
            environment_options(environment, options), ensembles=True,
        )
        for _, options in estimators
    ]  # fmt: skip
    return page_of(flown, [name for name, _ in estimators])
