"""Scores of candidates on equal seeds; where the filter allows it, in batches made once."""

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from agents.rollouts import Rollout, batch, flown, rollout, run_to_ends
from agents.studies.worlds import registered_id
from agents.tuning.arm import LIKELIHOOD, Arm, Values
from vessel_gym.simulation.configuration import Configuration


class Trials:
    """Episodes of candidates of an arm, all on the same seeds.

    Args:
        arm: What is tuned.
        seeds: N seeds.
        processes: Processes that share the seeds; the scores do not depend on their number.

    Attributes:
        elsewhere: CPU seconds that other processes have spent on scores, of all trials.
    """

    elsewhere: ClassVar[float] = 0.0

    def __init__(self, arm: Arm, seeds: Sequence[int], processes: int = 1) -> None:
        self.arm, self.seeds, self.processes = arm, list(seeds), min(processes, len(seeds))

    def scores(self, candidates: Sequence[Values]) -> np.ndarray:
        """Scores ``(C, conditions * N)`` of C candidates; NaN for one that cannot be designed."""
        found = self._shared(candidates) if self.processes > 1 else self.each(candidates)
        return found.reshape(len(candidates), -1)

    def each(self, candidates: Sequence[Values]) -> np.ndarray:
        """Scores ``(C, conditions, N)``, computed in this process."""
        return np.array([self._scores(values) for values in candidates])

    def _shared(self, candidates: Sequence[Values]) -> np.ndarray:
        """Scores ``(C, conditions, N)``, each process with its share of the seeds."""
        from joblib import Parallel, delayed

        shares, arm = np.array_split(self.seeds, self.processes), replace(self.arm)
        jobs = (delayed(_share)(arm, share.tolist(), candidates) for share in shares)
        found: Any = Parallel(self.processes, inner_max_num_threads=1)(jobs)
        scores, seconds, where = zip(*found, strict=True)
        here = os.getpid()  # joblib may run jobs in this process
        Trials.elsewhere += sum(s for s, pid in zip(seconds, where, strict=True) if pid != here)
        return np.concatenate(scores, -1)

    def _scores(self, values: Values) -> np.ndarray:
        """Scores ``(conditions, N)`` of a candidate."""
        agent = self._agent(values)
        if agent is None:
            return np.full((len(self.arm.conditions), len(self.seeds)), np.nan)
        if self.arm.by == LIKELIHOOD:
            envs = self._with_parameters(values)
            return np.array([_log_densities(env, agent, self.seeds) for env in envs])
        return np.array([each.score for each in self.flown(values, agent, record=False)])

    def flown(self, values: Values, agent: Any, record: bool) -> list[Rollout]:
        """Rollouts of a candidate with its agent, one for each condition."""
        arm, seeds = self.arm, self.seeds
        if arm.by_rows:
            envs = self._with_parameters(values)
            return [flown(agent, env, seeds, record=record) for env in envs]
        env_id, own = registered_id(arm.env_id), arm.estimator_options(values)
        worlds = [world | ({"estimator_options": own} if own else {}) for world in arm.worlds]
        return [rollout(agent, env_id, seeds, each, record=record) for each in worlds]

    def _agent(self, values: Values) -> Any:
        """The agent of a candidate; None if its parameters allow no design."""
        try:
            return self.arm.made_agent(values)
        except (ArithmeticError, np.linalg.LinAlgError):
            return None

    @cached_property
    def _envs(self) -> list[Any]:
        """Environments for the seeds, one for each condition, with filters of `Arm.by_rows`."""
        env_id, count = registered_id(self.arm.env_id), len(self.seeds)
        envs: list[Any] = [batch(env_id, count, world) for world in self.arm.worlds]
        for env, config in zip(envs, self.arm.by_rows, strict=True):
            env.core.config = config
        return envs

    def _with_parameters(self, values: Values) -> list[Any]:
        """The environments, with the parameters of a candidate from their next start on."""
        for env in self._envs:
            config = env.core.config
            config.estimators[0].parameters = self._parameters(config, values)
        return self._envs

    def _parameters(self, config: Configuration, values: Values) -> np.ndarray:
        """Parameters ``(N, k)`` of the filter in each row; its model has delivered factors."""
        filter, sensors = config.estimation.filter, config.sensors
        delivered, every = self.arm.delivered, self.arm.delivered | values
        channels = [sensors.of_channel(i).name for i in range(sensors.size)]
        factors = ["estimator.Q", *(f"estimator.R.{name}" for name in channels)]
        known = [every[name] / delivered[name] for name in factors if name in delivered]
        own = [every[f"estimator.{name}"] for name in filter.tunable]
        ratios = np.ones(1 + filter.model.p)  # the oracle has no factors
        ratios[: len(known)] = known
        return np.tile([*ratios, *own], (len(self.seeds), 1))


_KEPT: dict[str, Trials] = {}
"""Trials of a process, with their compiled programs, by arm and seeds."""


def _share(
    arm: Arm, seeds: list[int], candidates: Sequence[Values]
) -> tuple[np.ndarray, float, int]:
    """Scores ``(C, conditions, N)`` of a process's share of the seeds, its CPU seconds and id."""
    began = time.process_time()
    scores = _KEPT.setdefault(repr((arm, seeds)), Trials(arm, seeds)).each(candidates)
    return scores, time.process_time() - began, os.getpid()


def _log_densities(env: Any, agent: Any, seeds: Sequence[int]) -> np.ndarray:
    """Mean log-likelihood ``(N,)`` of the measurements of a step, in an episode for each seed."""
    core, total = env.core, np.zeros(len(seeds))
    filter = core.config.estimation.filter
    core.start(seeds)
    agent.reset(len(seeds))

    def watch(rows: np.ndarray, before: Any) -> None:
        belief = core.now.belief  # for which the core makes a record, of which it goes on
        predicted = belief if filter.random else filter.predict(before.belief, belief.u)
        total[rows] += filter.log_likelihood(predicted, belief)

    return total / run_to_ends(core, agent, env.max_episode_steps, watch)["length"]
