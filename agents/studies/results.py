"""Results of a study as one long table, and the share of the oracle's performance in it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd

from agents.controllers import AUTOPILOT
from agents.jobs import Outcome
from agents.statistics import normalise
from agents.studies.plan import Flight, Plan
from agents.studies.records import FLOOR, ORACLE
from agents.studies.worlds import system_of

FLIGHT = ["environment", "condition", "policy", "estimator", "run"]
"""Columns of a table that name a flight; with the seed they name an episode."""


def long_table(plan: Plan, outcome: Outcome) -> pd.DataFrame:
    """One row an episode: `FLIGHT`, seed, how it ended, score and every other metric of its task.

    ``home`` is true where the policy was trained on that estimator, or it is the environment's
    default; ``completed`` where the episode ended as the task asks; ``diverged`` where the truth
    was beyond the filter's bounds for half of the time. ``nees_in_band`` and ``nis_in_band`` are those
    of the flight, see `agents.studies.flying.fly`. What an episode does not have is NaN.
    """
    seeds = plan.study.seeds
    found = []
    for f in plan.flights:
        if (values := outcome.values.get(f.job.key)) is None:
            continue
        ends = np.array(values["ends"], object)
        rows = {name: getattr(f, name) for name in (*FLIGHT, "home")} | {"seed": seeds}
        rows |= {"end": ends, "completed": ends == system_of(f.environment).task.success}
        rows |= {"diverged": values["diverged"]}
        rows |= {name: _number(values[name]) for name in ("nees_in_band", "nis_in_band")}
        found.append(pd.DataFrame(rows | {k: _floats(v) for k, v in values["figures"].items()}))
    empty = pd.DataFrame(columns=[*FLIGHT, "home", "seed", "score"])
    return pd.concat(found, ignore_index=True) if found else empty


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _floats(values: Sequence[float | None]) -> np.ndarray:
    return np.array(values, float)


@dataclass(frozen=True, eq=False)
class Results:
    """The table of a study, and what its run left besides.

    Attributes:
        plan: What was asked.
        table: See `long_table`.
        timings: What `agents.studies.flying.step_times` gave, by environment and estimator: rows of
            a batch, CPU time [µs] of a step on the estimator, and of one on the truth beside it.
        failures: Why jobs have no result, by their keys.
        seconds: CPU seconds of jobs, by their keys.
    """

    plan: Plan
    table: pd.DataFrame
    timings: dict[tuple[str, str], list[tuple[int, float, float]]] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, plan: Plan, outcome: Outcome) -> "Results":
        """The results of a run."""
        timings = {}
        for f in plan.flights:
            if times := outcome.values.get(f.job.key, {}).get("timing"):
                each = [(rows, 1e6 * own, 1e6 * truth) for rows, own, truth in times]
                timings[f.environment, f.estimator] = each
        table = long_table(plan, outcome)
        return cls(plan, table, timings, outcome.failures, outcome.seconds)

    @property
    def missing(self) -> list[Flight]:
        """Flights that have no result."""
        there = set(self.wide("score").index)
        names = [tuple(getattr(f, name) for name in FLIGHT) for f in self.plan.flights]
        return [f for f, name in zip(self.plan.flights, names, strict=True) if name not in there]

    @cached_property
    def environments(self) -> list[str]:
        """Environments that have results."""
        return list(self.table.environment.unique())

    @cached_property
    def classical(self) -> str:
        """The agent that does not learn; its scores on `FLOOR` and `ORACLE` are 0 and 1."""
        return next(agent.name for agent in self.plan.study.agents if not agent.learned)

    @cached_property
    def who(self) -> str:
        """The classical agent in a sentence."""
        return "the autopilot" if self.classical == AUTOPILOT else self.classical

    @cached_property
    def learned(self) -> list[str]:
        """Policies that learned, in the order of the study."""
        names = [name for agent in self.plan.study.agents for name in agent.policies]
        there = set(self.table.policy)
        return [name for name in names if name in there]

    def conditions(self, environment: str) -> list[str]:
        """The conditions of an environment, in the order of the study."""
        return [c.name for c in self.plan.study.conditions if c.is_in(environment)]

    def estimators(self, environment: str | None = None) -> list[str]:
        """Estimators that the classical agent was steered on, in the order of the study."""
        own = self.table[self.table.policy == self.classical]
        there = own if environment is None else own[own.environment == environment]
        order = [e.name for e in self.plan.study.estimators]
        names = there.estimator.unique()
        return sorted(names, key=lambda n: order.index(n) if n in order else len(order))

    # --- a flight a row, a seed a column ----------------------------------------------------------

    def wide(self, metric: str) -> pd.DataFrame:
        """A metric with a row for each flight, named by `FLIGHT`, and a column for each seed."""
        if metric not in self._wide:
            rows = self.table.set_index([*FLIGHT, "seed"])[metric]
            self._wide[metric] = rows.unstack("seed", sort=False).astype(float)
        return self._wide[metric]

    @cached_property
    def _wide(self) -> dict[str, pd.DataFrame]:
        return {}

    @cached_property
    def kept(self) -> pd.DataFrame:
        """Share of the oracle's performance that is kept, as `wide`; places without a scale lack.

        A place is an environment in a condition; it has a scale if the classical agent was steered
        on both ends there, and scored higher on the oracle.
        """
        found = [self.wide("score").iloc[:0].astype(float)]
        for _, place in self.wide("score").groupby(FLIGHT[:2], sort=False):
            if (ends := self._ends(place)) is None:
                continue
            for _, runs in place.groupby(FLIGHT[2:4], sort=False):
                shares = normalise(runs.to_numpy(), *ends)
                found.append(pd.DataFrame(shares, runs.index, runs.columns))
        return pd.concat(found)

    def _ends(self, place: pd.DataFrame) -> tuple[np.ndarray, np.ndarray] | None:
        """Scores ``(seeds,)`` of the classical agent on `FLOOR` and `ORACLE`, if they are a scale."""
        own = place[place.index.get_level_values("policy") == self.classical].droplevel(
            [0, 1, 2, 4]
        )
        if FLOOR not in own.index or ORACLE not in own.index:
            return None
        low, high = own.loc[FLOOR].to_numpy(), own.loc[ORACLE].to_numpy()
        return (low, high) if high.mean() > low.mean() else None

    @cached_property
    def scales(self) -> pd.DataFrame:
        """Score on the truth minus that on dead reckoning, a row for each place with a scale."""
        found = {}
        for name, place in self.wide("score").groupby(FLIGHT[:2], sort=False):
            if ends := self._ends(place):
                found[name] = ends[1] - ends[0]
        index = pd.MultiIndex.from_tuples(list(found), names=FLIGHT[:2])
        return pd.DataFrame(list(found.values()), index=index)

    @cached_property
    def shares(self) -> dict[tuple[str, str, str], pd.DataFrame]:
        """Share kept by each run (row) at each seed, by environment, policy and estimator.

        Means over the conditions of the environment that have a scale; runs that lack one are left
        out.
        """
        each = self.kept.groupby([n for n in FLIGHT if n != "condition"], sort=False)
        conditions = self.scales.groupby(level="environment").size()
        there = each.size()
        wanted = conditions.reindex(there.index.get_level_values("environment"))
        means = each.mean()[there.to_numpy() == wanted.to_numpy()]
        levels = ["environment", "policy", "estimator"]
        return {key: rows.droplevel(levels) for key, rows in means.groupby(level=levels)}

    def flight(
        self, wide: pd.DataFrame, environment: str, condition: str, estimator: str
    ) -> np.ndarray | None:
        """Row ``(1, seeds)`` of the classical agent in a frame such as `wide`; None if not there."""
        name = environment, condition, self.classical, estimator, 0
        return wide.loc[[name]].to_numpy() if name in wide.index else None

    def home(self, environment: str, policy: str) -> str:
        """The home estimator of a policy, see `agents.studies.plan.Flight`."""
        here = [f for f in self.plan.flights if (f.environment, f.policy) == (environment, policy)]
        return next((f.estimator for f in here if f.home), system_of(environment).estimator)
