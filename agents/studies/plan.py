"""A study as jobs: who is trained on what, who is steered on what, and what is left out and why."""

import os
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
        metrics: Compute all metrics and CPU times; else scores alone.
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
        self.estimators: list[Estimator] = []
        for estimator in self._wanted():
            chosen = options(study, study.conditions[0], estimator, environment)
            if error := refusal(environment, chosen):
                self._skip(estimator.name, str(error))
            else:
                self.estimators.append(estimator)

    def _wanted(self) -> list[Estimator]:
        """The study's estimators for this environment; what is called default has its own name."""
        trained = any(a.learned and DEFAULT in a.trained_on for a in self.study.agents)
        default = [Estimator(DEFAULT, DEFAULT)] if trained else []
        found: dict[str, Estimator] = {}
        for each in (*self.study.estimators, *default):
            if not each.environments or self.environment in each.environments:
                name = self._real(each.name)
                kind = self._real(each.estimator)
                found.setdefault(name, Estimator(name, kind, each.options, each.environments))
        return list(found.values())

    def _real(self, name: str) -> str:
        return self.system.estimator if name == DEFAULT else name

    def _skip(self, what: str, reason: str) -> None:
        self.skipped.append(Skipped(self.environment, what, reason))

    def flights(self) -> Iterator[Flight]:
        """Every flight of the agents that the environment has."""
        for agent in self.study.agents:
            if agent.environments and self.environment not in agent.environments:
                continue
            acts = is_controller(agent.kind, self.system) or os.path.isfile(agent.kind)
            if not agent.learned and not acts:
                self._skip(agent.name, unknown_controller(agent.kind, self.system))
                continue
            policies = list(self._policies(agent))
            if not policies:
                self._skip(agent.name, "no estimator that it is trained on can be used here")
            for condition in self.study.conditions:
                if condition.is_in(self.environment):
                    for policy in policies:
                        yield from self._flights_of(agent, condition, *policy)

    def _policies(self, agent: Agent) -> Iterator[tuple[str, str, int, Job | None]]:
        """Name, home estimator, run and training of every policy of an agent."""
        if not agent.learned:
            yield agent.name, self.system.estimator, 0, None
            return
        known = {RAW: _RAW_MEASUREMENTS} if agent.raw else {e.name: e for e in self.estimators}
        schools = (RAW,) if agent.raw else agent.trained_on
        for school, run in product(schools, range(self.study.training_seeds)):
            if self._real(school) in known:
                home = known[self._real(school)]
                yield agent.policy(school), home.name, run, self._train(agent, home, run)

    def _flights_of(
        self, agent: Agent, condition: Condition, policy: str, home: str, run: int, job: Job | None
    ) -> Iterator[Flight]:
        """The flights of a policy in a condition."""
        for each in [_RAW_MEASUREMENTS] if agent.raw else self.estimators:
            if not agent.flown_on or each.name in (home, *agent.flown_on):
                flight = self._fly(agent, condition, each, job)
                at_home = each.name == home
                yield Flight(
                    self.environment, condition.name, policy, each.name, run, at_home, flight
                )

    def _options(self, agent: Agent, condition: Condition, estimator: Estimator) -> dict[str, Any]:
        """The options of the environment for an agent, with those that decide what it is shown."""
        chosen = options(self.study, condition, estimator, self.environment)
        guidance = {} if agent.guidance is None else {"guidance": agent.guidance}
        return chosen | ({"observe": agent.observe} | guidance if agent.learned else {})

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
        env, study = self.environment, self.study
        controller = "checkpoint" if training else agent.kind
        own = digests(env, estimator.estimator, controller, *condition.own)
        arguments = {
            "environment": env,
            "options": self._options(agent, condition, estimator),
            "agent": controller,
            "first_seed": study.first_seed,
            "episodes": study.episodes,
            "own": own | registered(env, controller),
        }
        if not self.metrics:
            arguments["metrics"] = False
        elif not training and condition == study.conditions[0]:
            arguments["timed_beside"] = ORACLE
        label = f"{agent.name if training else controller} on {estimator.name} in {env}"
        label += f", {condition.name}"
        return Job("agents.studies.flying:fly", arguments, label, (training,) if training else ())
