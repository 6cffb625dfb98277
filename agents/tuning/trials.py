"""Scores of candidates on equal seeds, side by side in one batch where the filter allows it."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
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
        self._cores = cache(self._made_cores)

    def scores(self, candidates: Sequence[Values]) -> np.ndarray:
        """Scores ``(C, conditions * N)`` of C candidates; NaN for one that cannot be designed."""
        if self.processes > 1:
            return self._shared(candidates)
        agents = [self._agent(values) for values in candidates]
        found = np.full((len(candidates), len(self.arm.conditions) * len(self.seeds)), np.nan)
        designed = [i for i, agent in enumerate(agents) if agent is not None]
        if designed:
            chosen = [candidates[i] for i in designed], [agents[i] for i in designed]
            score = self._side_by_side if self.arm.by_rows else self._one_by_one
            found[designed] = score(*chosen)
        return found

    def _shared(self, candidates: Sequence[Values]) -> np.ndarray:
        """Scores ``(C, conditions * N)``, each process with its share of the seeds."""
        from joblib import Parallel, delayed

        shares, arm = np.array_split(self.seeds, self.processes), replace(self.arm)
        jobs = (delayed(_share)(arm, share.tolist(), candidates) for share in shares)
        found = Parallel(self.processes, inner_max_num_threads=1)(jobs)
        rows = len(candidates), len(self.arm.conditions), -1
        each = np.concatenate([part.reshape(rows) for part in found], -1)
        return each.reshape(len(candidates), -1)

    def _agent(self, values: Values) -> Any:
        """The agent of a candidate; None if its parameters allow no design."""
        try:
            return self.arm.made_agent(values)
        except (ArithmeticError, np.linalg.LinAlgError):
            return None

    def _one_by_one(self, candidates: Sequence[Values], agents: Sequence[Any]) -> np.ndarray:
        """Scores ``(C, conditions * N)``, by an environment for each candidate."""
        arm, env_id, rows = self.arm, registered_id(self.arm.env_id), []
        for values, agent in zip(candidates, agents, strict=True):
            own = arm.estimator_options(values)
            worlds = [world | ({"estimator_options": own} if own else {}) for world in arm.worlds]
            flown = [rollout(agent, env_id, self.seeds, each, record=False) for each in worlds]
            rows.append(np.concatenate([each.score for each in flown]))
        return np.array(rows)

    # --- side by side -----------------------------------------------------------------------------

    def _side_by_side(self, candidates: Sequence[Values], agents: Sequence[Any]) -> np.ndarray:
        """Scores ``(C, conditions * N)``, by one batch of all candidates for each condition."""
        found = [
            _scores(core, agents, self.seeds, self._rows(core, candidates), self.arm.by)
            for core in self._cores(len(candidates))
        ]
        return np.concatenate([each.reshape(len(agents), -1) for each in found], 1)

    def _made_cores(self, candidates: int) -> list[Core]:
        """Cores for so many candidates, one for each condition."""
        system, rows, cores = self.arm.system, candidates * len(self.seeds), []
        for world in self.arm.worlds:
            core = Core(system, rows, **world)
            core.config = Configuration(system, core.config.options, by_rows=True)
            cores.append(core)
        return cores

    def _rows(self, core: Core, candidates: Sequence[Values]) -> np.ndarray:
        """Parameters ``(C * N, k)`` of the filter in each row; its model has delivered factors."""
        filter, sensors = core.config.estimation.filter, core.config.sensors
        channels = [sensors.of_channel(i).name for i in range(sensors.size)]
        factors = ["estimator.Q", *(f"estimator.R.{name}" for name in channels)]
        own, delivered, size = filter.tunable, self.arm.delivered, 1 + filter.model.p

        def row(values: Values) -> list[float]:
            every = delivered | values
            ratios = [every[n] / delivered[n] for n in factors if n in delivered]
            ratios = [*ratios, *[1.0] * size][:size]  # the oracle has no factors
            return ratios + [every[f"estimator.{name}"] for name in own]

        return np.repeat(np.array([*map(row, candidates)]), len(self.seeds), 0)


_KEPT: dict[str, Trials] = {}
"""Trials of a process, with their compiled programs, by arm and seeds."""


def _share(arm: Arm, seeds: list[int], candidates: Sequence[Values]) -> np.ndarray:
    """Scores of a process's share of the seeds."""
    trials = _KEPT.setdefault(repr((arm, seeds)), Trials(arm, seeds))
    return trials.scores(candidates)


def _scores(
    core: Core, agents: Sequence[Any], seeds: Sequence[int], parameters: np.ndarray, by: str
) -> np.ndarray:
    """Scores ``(C * N,)`` of one episode for each seed with each of C agents.

    By "likelihood" a score is the mean log-likelihood of the measurements of a step.
    """
    core.config.estimators[0].parameters = parameters
    core.start([*seeds] * len(agents))
    rows = [slice(i * len(seeds), (i + 1) * len(seeds)) for i in range(len(agents))]
    for agent in agents:
        agent.reset(len(seeds))
    alive, score = np.ones(core.num_envs, bool), np.full(core.num_envs, np.nan)
    density, filter = np.zeros(core.num_envs), core.config.estimation.filter
    belief, horizon = core.now.belief, core.config.system.task.horizon
    while alive.any():
        observations = core.observe()
        actions = np.concatenate(
            [a.act(observations[own]) for a, own in zip(agents, rows, strict=True)]
        )
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
