"""Example episodes of a study: one seed, whose scores are the most typical, on estimators."""

from typing import Any

import numpy as np

from agents.episodes.recording import page_of, typical_seed
from agents.jobs import Job
from agents.rollouts import Rollout, rollout
from agents.studies.plan import Plan
from agents.studies.records import FLOOR, ORACLE
from agents.studies.worlds import (
    classical_controller,
    environment_options,
    import_own,
    registered_id,
    system_of,
)


def examples(plan: Plan) -> dict[str, Job]:
    """The job of each environment's example.

    The classical agent flies the first condition on the environment's default estimator, on the
    first and the last of the study's others, and on dead reckoning, at the study's `typical_seed`.
    """
    chosen: dict[str, Job] = {}
    classical = next(agent.name for agent in plan.study.agents if not agent.learned)
    condition = plan.study.conditions[0].name
    for environment in plan.study.environments:
        flights = {
            f.estimator: f.job.arguments
            for f in plan.flights
            if (f.environment, f.condition, f.policy) == (environment, condition, classical)
        }
        default = system_of(environment).estimator
        others = [e.name for e in plan.study.estimators if e.name in flights]
        others = [name for name in others if name not in (default, ORACLE, FLOOR)]
        names = [
            name
            for name in dict.fromkeys([default, *others[:1], *others[-1:], FLOOR])
            if name in flights
        ]
        if names:
            arguments = {
                "environment": environment,
                "estimators": [(name, flights[name]["options"]) for name in names],
                "agent": flights[names[0]]["agent"],
                "seeds": list(plan.study.seeds),
                "own": {
                    module: digest
                    for name in names
                    for module, digest in flights[name]["own"].items()
                },
            }
            label = f"example episodes in {environment}"
            chosen[environment] = Job("agents.studies.examples:example", arguments, label)
    return chosen


def example(
    environment: str,
    estimators: list[tuple[str, dict[str, Any]]],
    agent: str,
    seeds: list[int],
    own: dict[str, str],
) -> dict[str, Any]:
    """Fly the typical episode on several estimators, and keep the data of its page.

    Args:
        environment: As in the study, and so is the agent.
        estimators: The study's name of each, and the environment's options with it.
        agent: As `agents.controllers.make_controller` takes it.
        seeds: Of which the typical one is shown.
        own: Source digests of the user's own modules, see `agents.studies.flying.fly`.

    Returns:
        The data of `agents.episodes.recording.page_of`.
    """
    import_own(own)

    def fly(seeds: list[int], record: bool) -> list[Rollout]:
        return [
            rollout(
                classical_controller(agent, environment), registered_id(environment), seeds,
                environment_options(environment, options), record=record, ensembles=record,
            )
            for _, options in estimators
        ]  # fmt: skip

    scores = np.array([flight.score for flight in fly(seeds, False)])
    return page_of(fly([typical_seed(scores, seeds)], True), [name for name, _ in estimators])
