"""Results of a study as one long table, and the normalised scores in it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from agents.controllers import AUTOPILOT
from agents.jobs import Outcome
from agents.statistics import normalise
from agents.studies.plan import Flight, Plan
from agents.studies.records import DEFAULT, FLOOR, ORACLE, TUNED
from agents.studies.worlds import system_of
from agents.tuning.arm import LIKELIHOOD

FLIGHT = ["environment", "condition", "policy", "estimator", "run"]
"""Columns of a table that name a flight; with the seed they name an episode."""


def long_table(plan: Plan, outcome: Outcome) -> pd.DataFrame:
    """One row an episode: `FLIGHT`, seed, how it ended, score and every other metric of its task.

    ``home`` is true where the policy was trained on that estimator, or it is the environment's
    default. The other columns are those of `agents.studies.flying.fly`. What an episode does not
    have is NaN.
    """
    found = [pd.DataFrame(columns=[*FLIGHT, "home", "seed", "score"])]
    for f in plan.flights:
        if values := outcome.values.get(f.job.key):
            rows = {name: getattr(f, name) for name in (*FLIGHT, "home")}
            found.append(pd.DataFrame(rows | {"seed": plan.study.seeds} | values))
    return pd.concat(found[1:] or found, ignore_index=True)


def at(wide: pd.DataFrame, **levels: str) -> pd.DataFrame:
    """Rows of a frame at some levels of its index, which it then lacks."""
    for name, level in levels.items():
        wide = wide[wide.index.get_level_values(name) == level].droplevel(name)
    return wide


def values(wide: pd.DataFrame, *flight: str) -> np.ndarray:
    """Values ``(runs, seeds)`` of a frame such as `Results.wide` at the first four of `FLIGHT`."""
    return at(wide, **dict(zip(FLIGHT, flight, strict=False))).to_numpy()


@dataclass(frozen=True, eq=False)
class Results:
    """The table of a study, and what its run left besides.

    Attributes:
        plan: What was asked.
        table: See `long_table`.
        outcome: CPU seconds of jobs, failures, and what the table lacks of their values.
    """

    plan: Plan
    table: pd.DataFrame
    outcome: Outcome = field(default_factory=Outcome)

    @classmethod
    def of(cls, plan: Plan, outcome: Outcome) -> "Results":
        """The results of a run."""
        return cls(plan, long_table(plan, outcome), outcome)

    def needed(self, flight: Flight) -> dict[str, Any]:
        """Values of the training or tuning that a flight needs; empty without a result."""
        return next((self.outcome.values.get(job.key, {}) for job in flight.job.needs), {})

    @property
    def missing(self) -> list[Flight]:
        """Flights that have no result."""
        return [f for f in self.plan.flights if f.job.key not in self.outcome.values]

    @cached_property
    def environments(self) -> list[str]:
        """Environments that have results."""
        return list(self.table.environment.unique())

    @cached_property
    def classical(self) -> str:
        """The agent that does not learn; its scores on `FLOOR` and `ORACLE` are 0 and 1."""
        return next(agent.name for agent in self.plan.study.agents if not agent.learned)

    @cached_property
    def compared(self) -> str:
        """The policy by which estimators are compared: tuned with each, if the study tunes."""
        return f"{self.classical}, {TUNED}" if self.plan.study.tune else self.classical

    @cached_property
    def reference_policy(self) -> str:
        """The policy whose score on the truth is 1: `compared`, if it can be tuned on the truth."""
        tuning = self.plan.study.tune
        return self.classical if tuning and tuning.by == LIKELIHOOD else self.compared

    @cached_property
    def who(self) -> str:
        """The classical agent in a sentence."""
        return "the autopilot" if self.classical == AUTOPILOT else self.classical

    @cached_property
    def learned(self) -> list[str]:
        """Policies that learned, in the order of the study."""
        agents, found = self.plan.study.agents, set(self.table.policy)
        names = [a.policy(school) for a in agents if a.learned for school in a.schools]
        return [name for name in names if name in found]

    def reference(self, environment: str, names: Sequence[str]) -> str:
        """The estimator among some names that others are compared with, see `Study.compare_to`."""
        asked = self.plan.study.compare_to
        asked = system_of(environment).estimator if asked == DEFAULT else asked
        return asked if asked in names else names[0]

    def conditions(self, environment: str) -> list[str]:
        """The conditions of an environment, in the order of the study."""
        return [c.name for c in self.plan.study.conditions if c.is_in(environment)]

    def estimators(self, **where: str) -> list[str]:
        """Estimators on which `compared` was steered, in the order of the study."""
        return list(at(self.score, policy=self.compared, **where).index.unique("estimator"))

    def filters(self, environment: str) -> list[str]:
        """Filters among the `estimators` of an environment."""
        study = self.plan.study
        others = {each.name for each in study.estimators}.difference(study.filters)
        return [name for name in self.estimators(environment=environment) if name not in others]

    def curves(self, environment: str) -> dict[str, list[Any]]:
        """Steps and returns of the runs of each policy, see `train_agent`."""
        found: dict[str, dict[int, Any]] = {}
        for flight in self.plan.where(environment=environment):
            if curve := self.needed(flight).get("curve"):
                found.setdefault(flight.policy, {})[flight.run] = np.transpose(curve)
        return {policy: list(runs.values()) for policy, runs in found.items()}

    # --- a flight a row, a seed a column ----------------------------------------------------------

    def wide(self, metric: str) -> pd.DataFrame:
        """A metric with a row for each flight, named by `FLIGHT`, and a column for each seed."""
        rows = self.table.set_index([*FLIGHT, "seed"])[metric]
        return rows.unstack("seed", sort=False).astype(float)

    @cached_property
    def score(self) -> pd.DataFrame:
        """Score as `wide`."""
        return self.wide("score")

    @cached_property
    def scales(self) -> pd.DataFrame:
        """Score on the truth minus that on dead reckoning, a row for each place with a scale.

        A place is an environment in a condition. It has a scale if the classical agent was steered
        on both ends there, and scored higher on the truth, see `reference_policy`.
        """
        low = at(self.score, policy=self.classical, estimator=FLOOR).droplevel("run")
        high = at(self.score, policy=self.reference_policy, estimator=ORACLE)
        high = high.groupby(FLIGHT[:2], sort=False).mean()
        scales = (high - low.reindex(high.index)).dropna()
        return scales[scales.mean(axis=1) > 0.0]

    @cached_property
    def normalised(self) -> pd.DataFrame:
        """Normalised score as `wide`, where there is a scale."""
        found = [self.score.iloc[:0]]
        for (*place, _, _), runs in self.score.groupby(FLIGHT[:4], sort=False):
            if tuple(place) in self.scales.index:
                (floor,) = values(self.score, *place, self.classical, FLOOR)
                ceiling = floor + self.scales.loc[tuple(place)].to_numpy()
                scores = normalise(runs.to_numpy(), floor, ceiling)
                found.append(pd.DataFrame(scores, runs.index, runs.columns))
        return pd.concat(found)

    def home(self, environment: str, policy: str) -> str:
        """The home estimator of a policy, see `agents.studies.plan.Flight`."""
        here = self.plan.where(environment=environment, policy=policy)
        return next((f.estimator for f in here if f.home), system_of(environment).estimator)
