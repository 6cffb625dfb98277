"""A search as a study whose conditions are the suites; no result is computed twice."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

import agents.jobs
from agents.agent import load_agent
from agents.budget.search import TRUTH, Search
from agents.budget.suites import Suite, no_better
from agents.controllers import PPO
from agents.policies.checkpoint import packaged, policy_path
from agents.refusal import Refusal
from agents.rollouts import batch
from agents.studies.plan import Plan, options, plan
from agents.studies.records import ORACLE, TUNED, Agent, Condition, Estimator, Study
from agents.studies.results import long_table
from agents.studies.worlds import environment_id, environment_options, system_of

FRESH = 500_000
"""Number of seeds from the first one of the search to the first one of the confirmation."""


def budget_study(
    environment: str, estimator: str, agent: str, disturbance: str, suites: Sequence[Suite]
) -> Study:
    """The study of a search: an estimator, then the truth; nominal sensors, then each suite.

    Raises:
        ValueError: if the environment refuses the estimator, the disturbance or the agent.
    """
    nominal = Condition("nominal", disturbance=disturbance)
    policy = packaged(system_of(environment).name) if agent == PPO else policy_path(agent)
    study = Study(
        "The cheapest sensors that suffice",
        (environment,),
        (Estimator(estimator, estimator), Estimator(ORACLE, ORACLE)),
        (Agent(agent, str(policy)),),
        (nominal, *(replace(nominal, name=str(s), sensors=s.grades) for s in suites)),
    )
    chosen = options(study, nominal, study.estimators[0], environment)
    made = environment_options(environment, chosen)
    with closing(batch(environment_id(environment), 1, made)) as env:
        load_agent(agent, env)
    return study


class Budget(Search):
    """A search of the cheapest suite with its confirmation, whose simulations are jobs.

    Args:
        study: See `budget_study`.
        suites: The cheapest first; other attributes name them by their numbers.
        keep: Share of the reference score that is asked for.
        folder: Keeps the results.
        processes: Processes on this machine.

    Attributes:
        tables: Results of all simulations, see `agents.studies.results.long_table`.
        refusals: Reasons of the environment against suites.
    """

    def __init__(
        self, study: Study, suites: Sequence[Suite], keep: float, folder: Path, processes: int = 1
    ) -> None:
        costs = [suite.cost for suite in suites]
        super().__init__(costs, no_better(suites), keep, self.flights, study.episodes)
        self.study, self.suites, self.folder, self.processes = study, suites, folder, processes
        self.tables: list[pd.DataFrame] = []
        self.refusals: set[str] = set()

    @property
    def nearest(self) -> int:
        """The answer; else the suite that is nearest to one in the search."""
        best = max(self.shares, key=lambda i: self.shares[i].low, default=len(self.suites) - 1)
        return best if self.answer is None else self.answer

    def flights(self, suites: Sequence[int], first: int, episodes: int) -> list[Any]:
        """Scores of suites, see `agents.budget.search.Fly`; a flight has no other metrics.

        Raises:
            Refusal: if a flight failed.
            OSError: if the results cannot be written.
        """
        part = replace(self.study, episodes=episodes, first_seed=self.study.first_seed + first)
        plans = [_plan(part, suite) for suite in suites]
        self.refusals |= {skipped.reason for each in plans for skipped in each.skipped}
        jobs = [job for each in plans for job in each.jobs]
        outcome = agents.jobs.run(jobs, self.folder, self.processes)
        for failure in outcome.failures.values():
            raise Refusal(f"a flight failed:\n{failure}")
        tables = [long_table(each, outcome) for each in plans]
        self.tables += tables
        return [table.score.to_numpy(float) if len(table) else None for table in tables]


def _plan(study: Study, suite: int) -> Plan:
    """The flights of a suite; of an arm that is tuned, those as tuned."""
    estimator, condition = study.estimators[suite == TRUTH], study.conditions[suite + 1]
    every = plan(replace(study, estimators=(estimator,), conditions=(condition,)), metrics=False)
    policy = study.agents[0].name + (f", {TUNED}" if study.tune else "")
    return replace(every, flights=tuple(every.where(policy=policy)))
