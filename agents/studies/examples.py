"""Example episodes of a study: one seed, whose scores are the most typical, on estimators."""

from typing import Any

from agents.episodes.recording import typical_page
from agents.jobs import Job
from agents.studies.ranking import rankings
from agents.studies.records import ORACLE
from agents.studies.results import Results
from agents.studies.worlds import environment_options, import_own, registered_id


def examples(results: Results) -> dict[str, Job]:
    """The job of each environment's example.

    The classical agent acts in the first condition on the best estimator of the study, on its
    reference and on the truth, at the study's `typical_seed`.
    """
    chosen: dict[str, Job] = {}
    plan = results.plan
    where = {"condition": plan.study.conditions[0].name, "policy": results.classical}
    for environment, ranking in rankings(results).items():
        flights = plan.where(environment=environment, **where)
        jobs = {flight.estimator: flight.job.arguments for flight in flights}
        names = dict.fromkeys((ranking.best, ranking.reference, ORACLE))
        arms = {name: jobs[name] for name in names if name in jobs}
        if arms:
            arguments = {
                "environment": environment,
                "estimators": [(name, each["options"]) for name, each in arms.items()],
                "agent": next(iter(arms.values()))["agent"],
                "seeds": plan.study.seeds,
                "own": {k: v for each in arms.values() for k, v in each["own"].items()},
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
    """Run the typical episode on several estimators, and keep the data of its page.

    Args:
        environment: As in the study, and so is the agent.
        estimators: The study's name of each, and the environment's options with it.
        agent: As `agents.load_agent` takes it.
        seeds: Of which the typical one is shown.
        own: Source digests of the user's own modules, see `agents.studies.flying.fly`.

    Returns:
        The data of `agents.episodes.recording.typical_page`.
    """
    import_own(own)
    worlds = {name: environment_options(environment, options) for name, options in estimators}
    return typical_page(agent, registered_id(environment), worlds, seeds)
