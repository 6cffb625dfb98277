"""A study as jobs: who is trained on what, who flies what, and what is left out and why."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from typing import Any

from agents.controllers import is_controller, unknown_controller
from agents.jobs import Job
from agents.studies.records import DEFAULT, ORACLE, RAW, Agent, Condition, Estimator, Study
from agents.studies.worlds import digests, environment_id, refusal, registered, system_of
from agents.training.ppo import describe

_RAW_MEASUREMENTS = Estimator(RAW, "measurement")


@dataclass(frozen=True)
class Flight:
    """One agent on one estimator in one world, and the job that computes it.

    Estimators may be `RAW`; an agent that does not learn is trained on "", with the seed None.
    """

    environment: str
    condition: str
    agent: str
    trained_on: str
    flown_on: str
    training_seed: int | None
    job: Job


@dataclass(frozen=True)
class Skipped:
    """Something that is left out, with the reason."""

    environment: str
    what: str
    reason: str


@dataclass(frozen=True)
class Plan:
    """Everything that a study flies, and what it leaves out."""

    study: Study
    flights: tuple[Flight, ...]
    skipped: tuple[Skipped, ...]

    @property
    def jobs(self) -> list[Job]:
        """The jobs of all flights."""
        return [flight.job for flight in self.flights]


def plan(study: Study) -> Plan:
    """Every flight of a study. What an environment cannot carry is left out there, with the reason.

    That is an estimator that does not fit its model, or a controller that its task does not have.
    """
    flights: list[Flight] = []
    skipped: list[Skipped] = []
    for environment in study.environments:
        flyable = []
        for estimator in estimators_in(study, environment):
            error = refusal(environment, options(study, study.conditions[0], estimator, environment))
            if error is None:
                flyable.append(estimator)
            else:
                skipped.append(Skipped(environment, estimator.name, str(error)))
        for agent in _here(study.agents, environment):
            if not agent.learned and not is_controller(agent.kind, system_of(environment)):
                skipped.append(Skipped(environment, agent.name, unknown_controller(agent.kind, system_of(environment))))
                continue
            trainings = _trainings(study, environment, agent, flyable)
            if agent.learned and not trainings:
                skipped.append(Skipped(environment, agent.name, "no estimator that it is trained on flies here"))
            for condition in (each for each in study.conditions if each.is_in(environment)):
                flights += _flights(study, environment, agent, condition, flyable, trainings)
    return Plan(study, tuple(flights), tuple(skipped))


def estimators_in(study: Study, environment: str) -> list[Estimator]:
    """The estimators of a study for an environment; what is called default is the environment's own."""
    default = system_of(environment).estimator
    found: dict[str, Estimator] = {}
    trained = [Estimator(name, name) for agent in study.agents if agent.learned for name in agent.trained_on]
    for estimator in (*study.estimators, *(e for e in trained if e.name == DEFAULT)):
        if estimator.environments and environment not in estimator.environments:
            continue
        if estimator.estimator == DEFAULT:
            name = default if estimator.name == DEFAULT else estimator.name
            estimator = Estimator(name, default, estimator.options, estimator.environments)
        found.setdefault(estimator.name, estimator)
    return list(found.values())


def options(study: Study, condition: Condition, estimator: Estimator, environment: str) -> dict[str, Any]:
    """The options of an environment, as plain data."""
    name = system_of(environment).estimator if estimator.estimator == DEFAULT else estimator.estimator
    chosen = {"estimator_options": estimator.options} if estimator.options else {}
    return {"estimator": name} | chosen | condition.options | {"termination": study.termination}


def _seen(agent: Agent) -> dict[str, Any]:
    """The options of an environment that decide what a learned agent is shown."""
    guidance = {} if agent.guidance is None else {"guidance": agent.guidance}
    return {"observe": agent.observe} | guidance if agent.learned else {}


Training = tuple[Estimator, int | None, Job | None]
"""Estimator of a training, its training seed, and its job; neither of an agent that does not learn."""


def _trainings(study: Study, environment: str, agent: Agent, flyable: list[Estimator]) -> list[Training]:
    """Every training of an agent in an environment; none for an agent that does not learn."""
    if not agent.learned:
        return []
    default = system_of(environment).estimator
    wanted = [default if name == DEFAULT else name for name in agent.trained_on]
    schools = [_RAW_MEASUREMENTS] if agent.raw else [e for e in flyable if e.name in wanted]
    return [
        (school, seed, _train(study, environment, agent, school, seed))
        for school, seed in product(schools, range(study.training_seeds))
    ]


def _flights(
    study: Study,
    environment: str,
    agent: Agent,
    condition: Condition,
    flyable: list[Estimator],
    trainings: list[Training],
) -> Iterable[Flight]:
    runs = trainings if agent.learned else [(Estimator(""), None, None)]
    for (school, seed, training), estimator in product(runs, [_RAW_MEASUREMENTS] if agent.raw else flyable):
        if agent.flown_on and estimator.name not in (school.name, *agent.flown_on):
            continue
        job = _fly(study, environment, agent, condition, estimator, training)
        yield Flight(environment, condition.name, agent.name, school.name, estimator.name, seed, job)


def _train(study: Study, environment: str, agent: Agent, school: Estimator, seed: int) -> Job:
    steps, critic = agent.steps.get(environment), None if agent.critic == "none" else agent.critic
    described = describe(environment_id(environment), None, seed, steps, agent.memory, critic, agent.settings)
    return Job(
        "agents.studies.training:train_agent",
        {
            "environment": environment,
            "options": options(study, study.conditions[0], school, environment) | _seen(agent),
            "memory": agent.memory,
            "critic": critic,
            "changed": agent.settings,
            "steps": steps,
            "seed": seed,
            "settings": {key: described[key] for key in ("hyperparameters", "versions")},
            "own": digests(environment, school.estimator, *study.conditions[0].own),
        },
        f"train {agent.name} on {school.name} in {environment}",
        artifact=".zip",
    )


def _fly(
    study: Study,
    environment: str,
    agent: Agent,
    condition: Condition,
    estimator: Estimator,
    training: Job | None,
) -> Job:
    controller = "checkpoint" if training else agent.kind
    return Job(
        "agents.studies.flying:fly",
        {
            "environment": environment,
            "options": options(study, condition, estimator, environment) | _seen(agent),
            "agent": controller,
            "first_seed": study.first_seed,
            "episodes": study.episodes,
            "own": digests(environment, estimator.estimator, controller, *condition.own)
            | registered(environment, controller),
        }
        | ({} if training or condition != study.conditions[0] else {"timed_beside": ORACLE}),
        f"fly {agent.name if training else controller} on {estimator.name} in {environment}",
        needs=(training,) if training else (),
    )


def _here(agents: Iterable[Agent], environment: str) -> list[Agent]:
    return [agent for agent in agents if not agent.environments or environment in agent.environments]
