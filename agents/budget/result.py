"""A search as a study whose conditions are the suites; no result is computed twice."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import agents.jobs
from agents.agent import load_agent
from agents.budget.search import TRUTH, Request, Search, confirm
from agents.budget.suites import Suite
from agents.controllers import PPO
from agents.policies.checkpoint import packaged, policy_path
from agents.refusal import Refusal
from agents.rollouts import batch
from agents.studies.plan import options, plan
from agents.studies.records import ORACLE, Agent, Condition, Estimator, Study
from agents.studies.results import Results
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
        "The cheapest sensors that do",
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


@dataclass(eq=False)
class Budget:
    """A search with its confirmation.

    Attributes:
        study: See `budget_study`.
        suites: The cheapest first; other attributes name them by their numbers.
        keep: Share of the truth's score that is asked for.
        folder: Keeps the results.
        processes: Processes on this machine.
        search: As far as it is.
        tables: Results of what was flown, see `agents.studies.results.long_table`.
        refusals: Reasons of the environment against suites.
        confirmed: After `run`: shares on fresh seeds, in the order of the confirmation.
        answer: After `run`: the cheapest suite that is confirmed; None if there is none.
    """

    study: Study
    suites: Sequence[Suite]
    keep: float
    folder: Path
    processes: int = 1

    def __post_init__(self) -> None:
        costs, ranks = ([getattr(s, name) for s in self.suites] for name in ("cost", "ranks"))
        self.search = Search(costs, np.array(ranks), self.keep, self.fly, self.study.episodes)
        self.tables: list[pd.DataFrame] = []
        self.refusals: set[str] = set()

    def run(self, progress: Callable[[int, int], None]) -> None:
        """Search the cheapest suite that keeps the share, and confirm it on fresh seeds.

        Raises:
            ValueError: if the truth scores nothing, so that there is no share of it.
            Refusal: if a flight failed.
            OSError: if the results cannot be written.
        """
        search, episodes = self.search, self.study.episodes
        search.run(progress)
        found = confirm(search.sequence, self.keep, self.fly, FRESH, episodes)
        self.confirmed, self.answer = found
        for suite, share in self.confirmed.items():
            search.verdicts[suite] = "confirmed" if share.low >= self.keep else "not confirmed"

    @property
    def nearest(self) -> int:
        """The answer; else the suite that is nearest to one in the search."""
        shares = self.search.shares
        best = max(shares, key=lambda i: shares[i].low, default=len(self.suites) - 1)
        return best if self.answer is None else self.answer

    def fly(self, requests: Sequence[Request]) -> list[Any]:
        """Scores of each request, see `agents.budget.search.Fly`; a flight has no other metrics."""
        study, plans = self.study, []
        for suite, first, episodes in requests:
            part = replace(
                study,
                estimators=(study.estimators[suite == TRUTH],),
                conditions=(study.conditions[suite + 1],),
                episodes=episodes,
                first_seed=study.first_seed + first,
            )
            plans.append(plan(part, metrics=False))
            self.refusals |= {skipped.reason for skipped in plans[-1].skipped}
        jobs = (job for each in plans for job in each.jobs)
        outcome = agents.jobs.run(jobs, self.folder, self.processes)
        for failure in outcome.failures.values():
            raise Refusal(f"a flight failed:\n{failure}")
        tables = [Results.of(each, outcome).table for each in plans]
        self.tables += tables
        return [table.score.to_numpy(float) if len(table) else None for table in tables]
