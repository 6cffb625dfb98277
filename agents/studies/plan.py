"""A study as jobs: who is trained on what, who flies what, and what is left out and why."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

from agents.controllers import is_controller, unknown_controller
from agents.jobs import Job
from agents.studies.records import DEFAULT, ORACLE, RAW, Agent, Condition, Estimator, Study
from agents.studies.worlds import digests, environment_id, refusal, registered, system_of
from agents.training.algorithms import describe

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
    places = [_EnvironmentPlan(study, name) for name in study.environments]
    flights = tuple(flight for place in places for flight in place.flights())
    return Plan(study, flights, tuple(skipped for place in places for skipped in place.skipped))


def estimators_in(study: Study, environment: str) -> list[Estimator]:
    """The estimators of a study for an environment; what is called default is the environment's own."""
    default = system_of(environment).estimator
    found: dict[str, Estimator] = {}
    trained = [
        Estimator(name, name)
        for agent in study.agents
        if agent.learned
        for name in agent.trained_on
    ]
    for estimator in (*study.estimators, *(e for e in trained if e.name == DEFAULT)):
        if estimator.environments and environment not in estimator.environments:
            continue
        if estimator.estimator == DEFAULT:
            name = default if estimator.name == DEFAULT else estimator.name
            estimator = Estimator(name, default, estimator.options, estimator.environments)
        found.setdefault(estimator.name, estimator)
    return list(found.values())


def options(
    study: Study, condition: Condition, estimator: Estimator, environment: str
) -> dict[str, Any]:
    """The options of an environment, as plain data."""
    name = (
        system_of(environment).estimator if estimator.estimator == DEFAULT else estimator.estimator
    )
    chosen = {"estimator_options": estimator.options} if estimator.options else {}
    return {"estimator": name} | chosen | condition.options | {"termination": study.termination}


def _seen(agent: Agent) -> dict[str, Any]:
    """The options of an environment that decide what a learned agent is shown."""
    guidance = {} if agent.guidance is None else {"guidance": agent.guidance}
    return {"observe": agent.observe} | guidance if agent.learned else {}


Training = tuple[Estimator, int | None, Job | None]
"""Estimator of a training, its training seed, and its job; neither of an agent that does not learn."""


class _EnvironmentPlan:
    """An environment of a study: the estimators that fly there, and what is left out."""

    def __init__(self, study: Study, environment: str) -> None:
        self.study, self.environment, self.system = study, environment, system_of(environment)
        self.skipped: list[Skipped] = []
        self.flyable: list[Estimator] = []
        for estimator in estimators_in(study, environment):
            error = refusal(
                environment, options(study, study.conditions[0], estimator, environment)
            )
            if error is None:
                self.flyable.append(estimator)
            else:
                self._skip(estimator.name, str(error))

    def _skip(self, what: str, reason: str) -> None:
        self.skipped.append(Skipped(self.environment, what, reason))

    def flights(self) -> Iterator[Flight]:
        """Every flight of the agents that fly there."""
        for agent in self.study.agents:
            if agent.environments and self.environment not in agent.environments:
                continue
            if not agent.learned and not is_controller(agent.kind, self.system):
                self._skip(agent.name, unknown_controller(agent.kind, self.system))
                continue
            trainings = self._trainings(agent)
            if not trainings:
                self._skip(agent.name, "no estimator that it is trained on flies here")
            flown_on = [_RAW_MEASUREMENTS] if agent.raw else self.flyable
            conditions = (each for each in self.study.conditions if each.is_in(self.environment))
            for condition, (school, seed, training), estimator in product(
                conditions, trainings, flown_on
            ):
                if not agent.flown_on or estimator.name in (school.name, *agent.flown_on):
                    names = (
                        self.environment,
                        condition.name,
                        agent.name,
                        school.name,
                        estimator.name,
                    )
                    yield Flight(*names, seed, self._fly(agent, condition, estimator, training))

    def _trainings(self, agent: Agent) -> list[Training]:
        """Every training of an agent; one without a job for an agent that does not learn."""
        if not agent.learned:
            return [(Estimator(""), None, None)]
        wanted = [self.system.estimator if name == DEFAULT else name for name in agent.trained_on]
        schools = (
            [_RAW_MEASUREMENTS] if agent.raw else [e for e in self.flyable if e.name in wanted]
        )
        seeds = range(self.study.training_seeds)
        return [
            (school, seed, self._train(agent, school, seed))
            for school, seed in product(schools, seeds)
        ]

    def _options(self, agent: Agent, condition: Condition, estimator: Estimator) -> dict[str, Any]:
        return options(self.study, condition, estimator, self.environment) | _seen(agent)

    def _train(self, agent: Agent, school: Estimator, seed: int) -> Job:
        env, first = self.environment, self.study.conditions[0]
        steps = agent.steps.get(env)
        described = describe(environment_id(env), None, seed, steps, agent.memory, agent.settings)
        arguments = {
            "environment": env,
            "options": self._options(agent, first, school),
            "memory": agent.memory,
            "changed": agent.settings,
            "steps": steps,
            "seed": seed,
            "settings": {key: described[key] for key in ("hyperparameters", "versions")},
            "own": digests(env, school.estimator, *first.own),
        }
        label = f"train {agent.name} on {school.name} in {env}"
        return Job("agents.studies.training:train_agent", arguments, label, artifact=".npz")

    def _fly(
        self, agent: Agent, condition: Condition, estimator: Estimator, training: Job | None
    ) -> Job:
        env, study, controller = (
            self.environment,
            self.study,
            "checkpoint" if training else agent.kind,
        )
        arguments = {
            "environment": env,
            "options": self._options(agent, condition, estimator),
            "agent": controller,
            "first_seed": study.first_seed,
            "episodes": study.episodes,
            "own": (
                digests(env, estimator.estimator, controller, *condition.own)
                | registered(env, controller)
            ),
        }
        if not training and condition == study.conditions[0]:
            arguments["timed_beside"] = ORACLE
        label = f"fly {agent.name if training else controller} on {estimator.name} in {env}"
        return Job("agents.studies.flying:fly", arguments, label, (training,) if training else ())
