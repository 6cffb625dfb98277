"""A study as jobs: who is trained on what, who is steered on what, and what is left out and why."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from agents.controllers import is_controller, unknown_controller
from agents.jobs import Job
from agents.studies.flying import NEEDED
from agents.studies.records import (
    DEFAULT,
    EACH,
    FLOOR,
    RAW,
    TUNED,
    Agent,
    Condition,
    Estimator,
    Study,
    Tuning,
)
from agents.studies.worlds import digests, environment_id, refusal, system_of
from agents.training.algorithms import describe
from agents.tuning.arm import Arm

_RAW_MEASUREMENTS = Estimator(RAW, "measurement")


@dataclass(frozen=True)
class Flight:
    """One policy on one estimator in one world, and the job that computes it.

    A policy that does not learn has the run 0. On its home estimator a policy was trained; one that
    does not learn is at home on the environment's default. Policies on raw measurements use `RAW`.
    """

    environment: str
    condition: str
    policy: str
    estimator: str
    run: int
    home: bool
    job: Job


@dataclass(frozen=True)
class Skipped:
    """Something that is left out, with the reason."""

    environment: str
    what: str
    reason: str


@dataclass(frozen=True)
class Plan:
    """Everything that a study computes, and what it leaves out."""

    study: Study
    flights: tuple[Flight, ...]
    skipped: tuple[Skipped, ...]

    @property
    def jobs(self) -> list[Job]:
        """The jobs of all flights."""
        return [flight.job for flight in self.flights]

    def where(self, **wanted: str) -> list[Flight]:
        """Flights whose fields have some values."""
        return [f for f in self.flights if all(getattr(f, k) == v for k, v in wanted.items())]


def plan(study: Study, metrics: bool = True) -> Plan:
    """Every flight of a study. What an environment cannot carry is left out there, with the reason.

    That is an estimator that does not fit its model, or a controller that its task does not have.

    Args:
        study: What is asked; the kind of an agent may be the path of a policy, too.
        metrics: Compute all metrics; else scores alone.
    """
    places = [_EnvironmentPlan(study, name, metrics) for name in study.environments]
    flights = tuple(flight for place in places for flight in place.flights())
    return Plan(study, flights, tuple(skipped for place in places for skipped in place.skipped))


def options(
    study: Study, condition: Condition, estimator: Estimator, environment: str
) -> dict[str, Any]:
    """The options of an environment, as plain data."""
    return _shared_options(study, estimator, environment) | condition.options


def _shared_options(study: Study, estimator: Estimator, environment: str) -> dict[str, Any]:
    """The options of an environment that all conditions share."""
    default = estimator.estimator == DEFAULT
    name = system_of(environment).estimator if default else estimator.estimator
    chosen = {"estimator_options": estimator.options} if estimator.options else {}
    return {"estimator": name} | chosen | {"termination": study.termination}


class _EnvironmentPlan:
    """An environment of a study: the estimators that it can carry, and what is left out."""

    def __init__(self, study: Study, environment: str, metrics: bool) -> None:
        self.metrics = metrics
        self.study, self.environment, self.system = study, environment, system_of(environment)
        self.conditions = [c for c in study.conditions if c.is_in(environment)]
        self.skipped: list[Skipped] = []
        self.estimators: dict[str, Estimator] = {}
        trained = any(a.learned and DEFAULT in a.trained_on for a in study.agents)
        default = [Estimator(DEFAULT, DEFAULT)] if trained else []
        for each in (*study.estimators, *default):
            name = self._real(each.name)
            if not each.is_in(environment) or name in self.estimators:
                continue
            chosen = options(study, study.conditions[0], each, environment)
            if error := refusal(environment, chosen):
                self._skip(each.name, str(error))
            else:
                self.estimators[name] = replace(each, name=name)

    def _real(self, name: str) -> str:
        """The name of an estimator; what is called default has its own."""
        return self.system.estimator if name == DEFAULT else name

    def _skip(self, what: str, reason: str) -> None:
        self.skipped.append(Skipped(self.environment, what, reason))

    def flights(self) -> Iterator[Flight]:
        """Every flight of the agents that the environment has."""
        for agent in (agent for agent in self.study.agents if agent.is_in(self.environment)):
            acts = is_controller(agent.kind, self.system) or os.path.isfile(agent.kind)
            if not agent.learned and not acts:
                self._skip(agent.name, unknown_controller(agent.kind, self.system))
                continue
            policies = list(self._policies(agent))
            if not policies:
                self._skip(agent.name, "no estimator that it is trained on can be used here")
            seen = [_RAW_MEASUREMENTS] if agent.raw else self.estimators.values()
            for condition, (policy, home, run, needed) in product(self.conditions, policies):
                for each in seen:
                    if not agent.flown_on or each.name in (home, *agent.flown_on):
                        yield self._flight(agent, policy, home, run, condition, each, needed)
            if self.study.tune and is_controller(agent.kind, self.system):
                yield from self._tuned_flights(agent, self.study.tune)

    def _tuned_flights(self, agent: Agent, tuning: Tuning) -> Iterator[Flight]:
        """Flights of a classical agent that is tuned with each estimator."""
        chosen = [c for c in self.conditions if c.name in tuning.conditions]
        once = [condition.options for condition in chosen or self.conditions[:1]]
        name, home = f"{agent.name}, {TUNED}", self.system.estimator
        for estimator in (each for each in self.estimators.values() if each.name != FLOOR):
            shared = _shared_options(self.study, estimator, self.environment)
            arm: dict[str, Any] = {"agent": agent.kind, "options": shared, "by": tuning.by}
            try:
                Arm(self.environment, conditions=tuple(once), **arm).parameters  # noqa: B018
            except ValueError as error:
                self._skip(f"{name} on {estimator.name}", str(error))
                continue
            for condition, run in product(self.conditions, range(tuning.tunings)):
                each = [condition.options] if EACH in tuning.conditions else once
                arguments = arm | {
                    "environment": self.environment, "seed": run,
                    "conditions": each,
                    "own": digests(self.environment, agent.kind, shared, *each),
                    "evaluations": tuning.evaluations, "episodes": tuning.episodes,
                }  # fmt: skip
                label = f"tune {agent.name} on {estimator.name} in {self.environment}"
                job = Job("agents.studies.tuning:tune_arm", arguments, label, artifact=".toml")
                yield self._flight(agent, name, home, run, condition, estimator, job)

    def _policies(self, agent: Agent) -> Iterator[tuple[str, str, int, Job | None]]:
        """Name, home estimator, run and training of every policy of an agent."""
        if not agent.learned:
            yield agent.name, self.system.estimator, 0, None
            return
        known = {RAW: _RAW_MEASUREMENTS, **self.estimators}
        for school, run in product(agent.schools, range(self.study.training_seeds)):
            if home := known.get(self._real(school)):
                yield agent.policy(school), home.name, run, self._train(agent, home, run)

    def _world(
        self, agent: Agent, condition: Condition, estimator: Estimator, controller: str
    ) -> dict[str, Any]:
        """Arguments of a job: the environment, its options, and the source of the user's own.

        Options are also those that decide what the agent is shown.
        """
        chosen = options(self.study, condition, estimator, self.environment)
        if agent.learned:
            chosen |= {"observe": agent.observe}
        own = digests(self.environment, controller, chosen)
        return {"environment": self.environment, "options": chosen, "own": own}

    def _train(self, agent: Agent, school: Estimator, seed: int) -> Job:
        env = self.environment
        asked = seed, agent.steps.get(env), agent.memory, agent.settings
        arguments = self._world(agent, self.study.conditions[0], school, "")
        arguments |= describe(environment_id(env), None, *asked)
        label = f"train {agent.name} on {school.name} in {env}"
        return Job("agents.studies.training:train_agent", arguments, label, artifact=".npz")

    def _flight(
        self, agent: Agent, policy: str, home: str, run: int, condition: Condition,
        estimator: Estimator, needed: Job | None,
    ) -> Flight:  # fmt: skip
        controller = NEEDED if needed else agent.kind
        arguments = self._world(agent, condition, estimator, controller) | {
            "agent": controller,
            "first_seed": self.study.first_seed,
            "episodes": self.study.episodes,
            "metrics": self.metrics,
        }
        name = agent.name if needed else controller
        label = f"{name} on {estimator.name} in {self.environment}, {condition.name}"
        job = Job("agents.studies.flying:fly", arguments, label, (needed,) if needed else ())
        place = self.environment, condition.name, policy, estimator.name
        return Flight(*place, run, estimator.name == home, job)
