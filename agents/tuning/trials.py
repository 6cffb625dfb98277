"""Scores of candidates on equal seeds; where the filter allows it, in batches made once."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from agents.rollouts import rollout
from agents.studies.worlds import registered_id
from agents.tuning.arm import LIKELIHOOD, Arm, Values
from vessel_gym.simulation.configuration import Configuration
from vessel_gym.simulation.core import Core


class Trials:
    """Episodes of candidates of an arm, all on the same seeds.

    Args:
        arm: What is tuned.
        seeds: N seeds.
        processes: Processes that share the seeds; the scores do not depend on their number.
    """

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
        return np.concatenate(Parallel(self.processes, inner_max_num_threads=1)(jobs), -1)

    def _scores(self, values: Values) -> np.ndarray:
        """Scores ``(conditions, N)`` of a candidate."""
        arm, agent = self.arm, self._agent(values)
        if agent is None:
            return np.full((len(arm.conditions), len(self.seeds)), np.nan)
        if arm.by_rows:
            cores, by = self._cores, arm.by
            return np.array([
                _scored(core, agent, self.seeds, self._parameters(core, values), by)
                for core in cores
            ])  # fmt: skip
        env_id, own = registered_id(arm.env_id), arm.estimator_options(values)
        worlds = [world | ({"estimator_options": own} if own else {}) for world in arm.worlds]
        flown = [rollout(agent, env_id, self.seeds, each, record=False) for each in worlds]
        return np.array([each.score for each in flown])

    def _agent(self, values: Values) -> Any:
        """The agent of a candidate; None if its parameters allow no design."""
        try:
            return self.arm.made_agent(values)
        except (ArithmeticError, np.linalg.LinAlgError):
            return None

    @cached_property
    def _cores(self) -> list[Core]:
        """Cores for the seeds, one for each condition, whose filters have parameters by row."""
        system = self.arm.system
        cores = [Core(system, len(self.seeds), **world) for world in self.arm.worlds]
        for core in cores:
            core.config = Configuration(system, core.config.options, by_rows=True)
        return cores

    def _parameters(self, core: Core, values: Values) -> np.ndarray:
        """Parameters ``(N, k)`` of the filter in each row; its model has delivered factors."""
        filter, sensors = core.config.estimation.filter, core.config.sensors
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


def _share(arm: Arm, seeds: list[int], candidates: Sequence[Values]) -> np.ndarray:
    """Scores ``(C, conditions, N)`` of a process's share of the seeds."""
    return _KEPT.setdefault(repr((arm, seeds)), Trials(arm, seeds)).each(candidates)


def _scored(
    core: Core, agent: Any, seeds: Sequence[int], parameters: np.ndarray, by: str
) -> np.ndarray:
    """Scores ``(N,)`` of one episode for each seed.

    By "likelihood" a score is the mean log-likelihood of the measurements of a step.
    """
    core.config.estimators[0].parameters = parameters
    core.start(seeds)
    agent.reset(len(seeds))
    alive, score = np.ones(core.num_envs, bool), np.full(core.num_envs, np.nan)
    density, filter = np.zeros(core.num_envs), core.config.estimation.filter
    belief, horizon = core.now.belief, core.config.system.task.horizon
    while alive.any():
        actions = agent.act(core.observe())
        core.advance(actions, core.action_shape, ended=~alive, info=False)
        if by == LIKELIHOOD:
            before, belief = belief, core.now.belief
            predicted = belief if filter.random else filter.predict(before, belief.u)
            density += np.where(alive, filter.log_likelihood(predicted, belief), 0.0)
        done = alive & ((core.last.end != 0) | (core.last.steps >= horizon))
        if done.any():
            found = density / core.last.steps if by == LIKELIHOOD else core.score
            score[done], alive = found[done], alive & ~done
    return score
