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
    default = estimator.estimator == DEFAULT
    name = system_of(environment).estimator if default else estimator.estimator
    chosen = {"estimator_options": estimator.options} if estimator.options else {}
    return {"estimator": name} | chosen | condition.options | {"termination": study.termination}


class _EnvironmentPlan:
    """An environment of a study: the estimators that it can carry, and what is left out."""

    def __init__(self, study: Study, environment: str, metrics: bool) -> None:
        self.metrics = metrics
        self.study, self.environment, self.system = study, environment, system_of(environment)
        self.skipped: list[Skipped] = []
        self.estimators: dict[str, Estimator] = {}
        trained = any(a.learned and DEFAULT in a.trained_on for a in study.agents)
        default = [Estimator(DEFAULT, DEFAULT)] if trained else []
        for each in (*study.estimators, *default):
            name = self._real(each.name)
            if not each.is_in(environment) or name in self.estimators:
                continue
            if error := refusal(
                environment, options(study, study.conditions[0], each, environment)
            ):
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
        env = self.environment
        conditions = [c for c in self.study.conditions if c.is_in(env)]
        for agent in (agent for agent in self.study.agents if agent.is_in(env)):
            acts = is_controller(agent.kind, self.system) or os.path.isfile(agent.kind)
            if not agent.learned and not acts:
                self._skip(agent.name, unknown_controller(agent.kind, self.system))
                continue
            policies = list(self._policies(agent))
            if not policies:
                self._skip(agent.name, "no estimator that it is trained on can be used here")
            seen = [_RAW_MEASUREMENTS] if agent.raw else list(self.estimators.values())
            for condition, (policy, home, run, training) in product(conditions, policies):
                for each in seen:
                    if not agent.flown_on or each.name in (home, *agent.flown_on):
                        job = self._fly(agent, condition, each, training)
                        at = env, condition.name, policy, each.name, run, each.name == home
                        yield Flight(*at, job)
            if self.study.tune and is_controller(agent.kind, self.system):
                yield from self._tuned_flights(agent, self.study.tune, conditions)

    def _tuned_flights(
        self, agent: Agent, tuning: Tuning, conditions: list[Condition]
    ) -> Iterator[Flight]:
        """Flights of a classical agent that is tuned with each estimator."""
        once = [c for c in conditions if c.name in tuning.conditions] or conditions[:1]
        for estimator in self.estimators.values():
            if estimator.name == FLOOR:
                continue
            if reason := self._untunable(agent, tuning, estimator, once):
                self._skip(f"{agent.tuned} on {estimator.name}", reason)
                continue
            home = estimator.name == self.system.estimator
            for condition, run in product(conditions, range(tuning.tunings)):
                chosen = [condition] if EACH in tuning.conditions else once
                needed = self._tune(agent, tuning, chosen, estimator, run)
                job = self._fly(agent, condition, estimator, needed)
                at = self.environment, condition.name, agent.tuned, estimator.name, run
                yield Flight(*at, home, job)

    def _arm(
        self, agent: Agent, tuning: Tuning, estimator: Estimator, conditions: list[Condition]
    ) -> dict[str, Any]:
        """Arguments of an `agents.tuning.arm.Arm`."""
        given = options(self.study, conditions[0], estimator, self.environment)
        shared = {k: v for k, v in given.items() if k not in conditions[0].options}
        each = [condition.options for condition in conditions]
        return {"agent": agent.kind, "options": shared, "conditions": each, "by": tuning.by}

    def _untunable(
        self, agent: Agent, tuning: Tuning, estimator: Estimator, conditions: list[Condition]
    ) -> str:
        """Reason why an agent cannot be tuned with an estimator; empty if it can be."""
        try:
            arm = Arm(self.environment, **self._arm(agent, tuning, estimator, conditions))
            arm.parameters  # noqa: B018
        except ValueError as error:
            return str(error)
        return ""

    def _tune(
        self, agent: Agent, tuning: Tuning, conditions: list[Condition], estimator: Estimator,
        seed: int,
    ) -> Job:  # fmt: skip
        """The tuning of a classical agent with an estimator."""
        own = dict[str, str]()
        for condition in conditions:
            own |= self._world(agent, condition, estimator, agent.kind)["own"]
        arguments = self._arm(agent, tuning, estimator, conditions) | {
            "environment": self.environment, "own": own, "seed": seed,
            "evaluations": tuning.evaluations, "episodes": tuning.episodes,
        }  # fmt: skip
        label = f"tune {agent.name} on {estimator.name} in {self.environment}"
        return Job("agents.studies.tuning:tune_arm", arguments, label, artifact=".toml")

    def _policies(self, agent: Agent) -> Iterator[tuple[str, str, int, Job | None]]:
        """Name, home estimator, run and training of every policy of an agent."""
        if not agent.learned:
            yield agent.name, self.system.estimator, 0, None
            return
        known = {RAW: _RAW_MEASUREMENTS, **self.estimators}
        schools = (RAW,) if agent.raw else agent.trained_on
        for school, run in product(schools, range(self.study.training_seeds)):
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
        names = estimator.estimator, condition.sensors, condition.disturbance
        texts = [name for name in names if isinstance(name, str)]
        own = digests(self.environment, controller, *texts)
        return {"environment": self.environment, "options": chosen, "own": own}

    def _train(self, agent: Agent, school: Estimator, seed: int) -> Job:
        env = self.environment
        asked = seed, agent.steps.get(env), agent.memory, agent.settings
        arguments = self._world(agent, self.study.conditions[0], school, "")
        arguments |= describe(environment_id(env), None, *asked)
        label = f"train {agent.name} on {school.name} in {env}"
        return Job("agents.studies.training:train_agent", arguments, label, artifact=".npz")

    def _fly(
        self, agent: Agent, condition: Condition, estimator: Estimator, training: Job | None
    ) -> Job:
        controller = NEEDED if training else agent.kind
        arguments = self._world(agent, condition, estimator, controller) | {
            "agent": controller,
            "first_seed": self.study.first_seed,
            "episodes": self.study.episodes,
            "metrics": self.metrics,
        }
        name = agent.name if training else controller
        label = f"{name} on {estimator.name} in {self.environment}, {condition.name}"
        return Job("agents.studies.flying:fly", arguments, label, (training,) if training else ())
