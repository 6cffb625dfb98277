"""Results of a study by environment, condition, agent and estimator."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from agents.controllers import AUTOPILOT
from agents.jobs import Outcome
from agents.metrics import SCORE, Metric, mean, metrics
from agents.page import csv_text
from agents.statistics import Interval, crossed_interval, normalise, share_interval, skewed_interval
from agents.studies.plan import Plan
from agents.studies.records import DEFAULT, FLOOR, ORACLE, RAW, Agent
from agents.studies.worlds import system_of


class Policy(NamedTuple):
    """An agent and, if it learned, the estimator of its training."""

    agent: str
    trained_on: str = ""

    def __str__(self) -> str:
        return (
            f"{self.agent} trained on {self.trained_on}"
            if self.trained_on not in ("", RAW)
            else self.agent
        )


class Place(NamedTuple):
    """An environment in a condition."""

    environment: str
    condition: str


@dataclass(frozen=True, eq=False)
class Results:
    """Everything that was flown.

    A figure is an array ``(runs, episodes)``: training runs (one, for an agent that does not learn)
    by evaluation seeds, which are the same for everybody.

    Attributes:
        plan: What was asked.
        values: Of every job that has a result, by its key.
        failures: Why the others have none, by their keys.
        seconds: CPU seconds of jobs, by their keys.
        timings: What `agents.studies.flying.step_times` gave, by the keys of jobs that were timed.
    """

    plan: Plan
    values: dict[str, dict[str, Any]]
    failures: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    timings: dict[str, list[tuple[int, float, float]]] = field(default_factory=dict)

    @classmethod
    def of(cls, plan: Plan, outcome: Outcome) -> "Results":
        """The results of a run."""
        timings = {
            key: values["timing"] for key, values in outcome.values.items() if "timing" in values
        }
        return cls(plan, outcome.values, outcome.failures, outcome.seconds, timings)

    # --- who, where, on what ----------------------------------------------------------------------

    @cached_property
    def _flown(self) -> dict[tuple[Place, Policy, str], dict[int | None, str]]:
        """The jobs that have results, by place, policy and estimator: their keys by training seed."""
        found: dict[tuple[Place, Policy, str], dict[int | None, str]] = {}
        for f in self.plan.flights:
            if f.job.key in self.values:
                key = Place(f.environment, f.condition), Policy(f.agent, f.trained_on), f.flown_on
                found.setdefault(key, {})[f.training_seed] = f.job.key
        return found

    @cached_property
    def environments(self) -> list[str]:
        """Environments in which something was flown."""
        return _unique(place.environment for place, _, _ in self._flown)

    @cached_property
    def conditions(self) -> list[str]:
        """Conditions of the study; the first is that of the training."""
        return [condition.name for condition in self.plan.study.conditions]

    @cached_property
    def classical(self) -> Policy:
        """The agent that does not learn: its scores on `FLOOR` and `ORACLE` are 0 and 1 of every other."""
        return Policy(next(agent.name for agent in self.plan.study.agents if not agent.learned))

    @cached_property
    def who(self) -> str:
        """The classical agent in a sentence."""
        return "the autopilot" if self.classical.agent == AUTOPILOT else self.classical.agent

    def policies(self, environment: str | None = None) -> list[Policy]:
        """The policies of an environment, or of all; the classical agents first."""
        flown = _unique(
            policy for place, policy, _ in self._flown if environment in (None, place.environment)
        )
        return sorted(flown, key=lambda policy: bool(policy.trained_on))

    def estimators(self, environment: str | None = None, policy: Policy | None = None) -> list[str]:
        """Estimators flown, in the order of the study; without an environment, those flown in every one."""
        if environment is None:
            each = [self.estimators(name, policy) for name in self.environments]
            return [
                name
                for name in _unique(name for names in each for name in names)
                if all(name in e for e in each)
            ]
        return self._in_order(
            name
            for place, who, name in self._flown
            if place.environment == environment and policy in (None, who)
        )

    def flown_on(self) -> list[str]:
        """Every estimator that flew anywhere, in the order of the study."""
        return self._in_order(name for _, _, name in self._flown)

    def _in_order(self, names: Iterable[str]) -> list[str]:
        order = [e.name for e in self.plan.study.estimators]
        return sorted(
            _unique(names), key=lambda name: order.index(name) if name in order else len(order)
        )

    def own(self, environment: str, policy: Policy) -> str:
        """Estimator of a policy at home: that of its training, or else the environment's default."""
        return self.here(environment, policy).trained_on or system_of(environment).estimator

    def here(self, environment: str, policy: Policy) -> Policy:
        """A policy of `schools` in an environment, in which `DEFAULT` has a name."""
        name = (
            system_of(environment).estimator if policy.trained_on == DEFAULT else policy.trained_on
        )
        return Policy(policy.agent, name)

    def schools(self) -> list[Policy]:
        """Policies flown, by one name for all environments: `DEFAULT` stands for each one's own default.

        In the order of the study, the agents that do not learn first.
        """
        found = []
        for agent in sorted(self.plan.study.agents, key=lambda agent: agent.learned):
            names = ("",) if not agent.learned else (RAW,) if agent.raw else agent.trained_on
            found += [Policy(agent.name, name) for name in names]
        return [
            p for p in found if any(self.here(e, p) in self.policies(e) for e in self.environments)
        ]

    def agent(self, policy: Policy) -> Agent:
        """The study's agent of a policy."""
        return next(agent for agent in self.plan.study.agents if agent.name == policy.agent)

    # --- figures ----------------------------------------------------------------------------------

    def runs_of(
        self, place: Place, policy: Policy, estimator: str
    ) -> dict[int | None, dict[str, Any]]:
        """Values of `agents.studies.flying.fly` by training seed; None stands for an agent that does not learn."""
        keys = self._flown.get((place, policy, estimator), {})
        return {seed: self.values[key] for seed, key in keys.items()}

    def rows(
        self, place: Place, policy: Policy, estimator: str, key: str = "score"
    ) -> dict[int | None, np.ndarray]:
        """A metric of `agents.metrics.scores` in each run ``(episodes,)``, by training seed; empty if not flown."""
        runs = self.runs_of(place, policy, estimator)
        return {seed: np.array(values["figures"][key], float) for seed, values in runs.items()}

    def figure(
        self, place: Place, policy: Policy, estimator: str, key: str = "score"
    ) -> np.ndarray | None:
        """The `rows` of all runs, ``(runs, episodes)``; None if that was not flown."""
        rows = self.rows(place, policy, estimator, key)
        return np.array(list(rows.values())) if rows else None

    def scale(self, place: Place) -> tuple[np.ndarray, np.ndarray] | None:
        """The scores ``(episodes,)`` whose means are 0 and 1: the classical agent's on `FLOOR` and on `ORACLE`.

        None if either was not flown, or the oracle is no better than the floor.
        """
        low, high = (self.figure(place, self.classical, name) for name in (FLOOR, ORACLE))
        return (
            None
            if low is None or high is None or not high.mean() > low.mean()
            else (low[0], high[0])
        )

    def kept(self, place: Place, policy: Policy, estimator: str) -> np.ndarray | None:
        """Share of the oracle's performance that is kept, ``(runs, episodes)``, as `agents.statistics.normalise`."""
        ends, scores = self.scale(place), self.figure(place, policy, estimator)
        return None if ends is None or scores is None else normalise(scores, *ends)

    def shares(
        self, environments: Iterable[str], policy: Policy, estimator: str | None = None
    ) -> np.ndarray | None:
        """Share kept by each run at each evaluation seed ``(runs, episodes)``: means over environments.

        Of each environment the mean over its `scaled` conditions. A run that lacks a flight is left
        out; None if no run is left. The policy may be of `schools`; it flies on the estimator, or
        (None) on what it was trained on or the environment's default.
        """
        found = self._by_run(environments, policy, estimator)
        return np.mean(list(found.values()), axis=1) if found else None

    def runs(
        self, environments: Iterable[str], policy: Policy, estimator: str | None = None
    ) -> np.ndarray | None:
        """`shares` of each run in each environment ``(runs, environments)``: means over evaluation seeds."""
        found = self._by_run(environments, policy, estimator)
        return np.mean(list(found.values()), axis=2) if found else None

    def paired_shares(
        self,
        environments: Iterable[str],
        one: tuple[Policy, str | None],
        other: tuple[Policy, str | None],
    ) -> np.ndarray | None:
        """`shares` of one minus those of another, each on an estimator ``(runs, episodes)``; None if they share no run.

        Runs of the same training seed are paired, and an agent that does not learn is paired with
        each.
        """
        names = list(environments)
        ours, theirs = (self._by_run(names, *each) for each in (one, other))
        if list(theirs) == [None]:
            theirs = dict.fromkeys(ours, theirs[None])
        both = [np.mean(ours[seed] - theirs[seed], axis=0) for seed in ours if seed in theirs]
        return np.array(both) if both else None

    def _by_run(
        self, environments: Iterable[str], policy: Policy, estimator: str | None
    ) -> dict[int | None, np.ndarray]:
        """Share kept in each environment at each evaluation seed, by training seed."""
        each = []
        for environment in environments:
            who = self.here(environment, policy)
            on = self.own(environment, policy) if estimator is None else estimator
            shares = (
                (self.rows(p, who, on), self.kept(p, who, on)) for p in self.scaled([environment])
            )
            found = [
                {} if kept is None else dict(zip(rows, kept, strict=True)) for rows, kept in shares
            ]
            each.append({seed: rows.mean(axis=0) for seed, rows in _in_all(found).items()})
        return _in_all(each)

    def price(
        self, places: Iterable[Place], policy: Policy, estimator: str, comparisons: int = 1
    ) -> Interval | float | None:
        """Score lost against the truth at the same seed, mean over places; None if one was not flown.

        A number where one training run has no interval. Of an agent that does not learn the
        interval follows the skewness: most episodes cost little, and some much.
        """
        found = []
        for place in places:
            truth, ours = (self.rows(place, policy, name) for name in (ORACLE, estimator))
            found.append({seed: truth[seed] - ours[seed] for seed in truth if seed in ours})
        lost = [rows.mean(axis=0) for rows in _in_all(found).values()]
        if lost and not self.agent(policy).learned:
            return skewed_interval(lost[0], comparisons)
        return self.interval(policy, np.array(lost), comparisons) if lost else None

    def interval(
        self, policy: Policy, values: np.ndarray, comparisons: int = 1
    ) -> Interval | float | None:
        """The mean of ``(runs, episodes)`` with its interval; a number for one training run, which has none."""
        if self.agent(policy).learned and len(values) == 1:
            return float(values.mean())
        return crossed_interval(values, comparisons)

    def mean(
        self, place: Place, policy: Policy, estimator: str, metric: Metric = SCORE
    ) -> Interval | None:
        """A metric's mean over runs and evaluation seeds."""
        values = self.figure(place, policy, estimator, metric.key)
        return None if values is None else mean(metric, values)

    def completed(
        self, places: Sequence[Place], policy: Policy, estimator: str
    ) -> Interval | float | None:
        """Share [%] of episodes that end as the task asks, by each seed its mean over places; None without flights."""
        found = []
        for place in places:
            success, runs = (
                system_of(place.environment).task.success,
                self.runs_of(place, policy, estimator),
            )
            found.append(
                {seed: np.array(values["ends"]) == success for seed, values in runs.items()}
            )
        each = 100.0 * np.array([ends.mean(axis=0) for ends in _in_all(found).values()])
        if not each.size:
            return None
        if self.agent(policy).learned:
            return self.interval(policy, each)
        return share_interval(0.01 * each.mean() * each.size, each.size).times(100.0)

    def worst_decile(self, places: Iterable[Place], policy: Policy, estimator: str) -> float | None:
        """Mean score of the worst tenth of the episodes of all runs in all places; None without flights."""
        found = [
            score.ravel()
            for p in places
            if (score := self.figure(p, policy, estimator)) is not None
        ]
        if not found:
            return None
        scores = np.sort(np.concatenate(found))
        return float(scores[: -(-len(scores) // 10)].mean())

    def step_times(self, environment: str, estimator: str) -> list[tuple[int, float, float]]:
        """Rows of a batch, and CPU time [µs] of a step of the classical agent on an estimator and on the truth."""
        keys = self._flown.get(
            (Place(environment, self.conditions[0]), self.classical, estimator), {}
        )
        times = self.timings.get(keys.get(None, ""), [])
        return [(rows, 1e6 * own, 1e6 * truth) for rows, own, truth in times]

    def places(self, environments: Iterable[str] | None = None) -> list[Place]:
        """Every condition of every environment, or of some."""
        chosen = self.environments if environments is None else environments
        conditions = self.plan.study.conditions
        return [
            Place(name, each.name) for name, each in product(chosen, conditions) if each.is_in(name)
        ]

    def scaled(self, environments: Iterable[str] | None = None) -> list[Place]:
        """The `places` that have a `scale`: shares are kept of nothing elsewhere."""
        return [place for place in self.places(environments) if self.scale(place) is not None]

    # --- files ------------------------------------------------------------------------------------

    def episodes_csv(self) -> str:
        """One row an episode: who flew where on what, the seed, and every metric; empty where there is no value."""
        keys = _unique(m.key for name in self.environments for m in metrics(system_of(name)))
        who = ["environment", "condition", "agent", "trained_on", "training_seed", "estimator"]
        rows = [[*who, "seed", "end", "is_success", *keys]]
        nothing = [float("nan")] * self.plan.study.episodes
        for f in (f for f in self.plan.flights if f.job.key in self.values):
            values, success = self.values[f.job.key], system_of(f.environment).task.success
            flown = [f.environment, f.condition, f.agent, f.trained_on, f.training_seed, f.flown_on]
            figures = [values["figures"].get(key, nothing) for key in keys]
            for seed, end, *measured in zip(
                self.plan.study.seeds, values["ends"], *figures, strict=True
            ):
                numbers = [f"{value:.6g}" if np.isfinite(value) else "" for value in measured]
                rows.append([*flown, seed, end, end == success, *numbers])
        return csv_text(rows)


def _unique(items: Iterable[Any]) -> list[Any]:
    return list(dict.fromkeys(items))


def _in_all(each: Sequence[Mapping[int | None, np.ndarray]]) -> dict[int | None, np.ndarray]:
    """The rows of every run that all have, ``(len(each), episodes)``."""
    seeds = [seed for seed in (each[0] if each else ()) if all(seed in found for found in each)]
    return {seed: np.array([found[seed] for found in each]) for seed in seeds}
