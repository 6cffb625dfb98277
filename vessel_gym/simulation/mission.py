"""A task as two stages, the start and a step: reference, score and observation."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from vessel_gym.checks import is_compiled
from vessel_gym.models.estimation import Estimation
from vessel_gym.models.state_space import StateSpace
from vessel_gym.simulation.state import Changes, Stage, State
from vessel_gym.tasks.task import Estimate


class Mission:
    """Reference, score and observation of a task, from an estimate and the truth.

    Args:
        task: Task.
        estimation: Filter, and its model with its parts.
        termination: One of `vessel_gym.simulation.configuration.TERMINATIONS`.
        prior_index: Indices of the true state's components that the prior describes.
        observe: One of `vessel_gym.simulation.configuration.OBSERVE`. If raw measurements are
            observed, the reference is evaluated at the true state.
        guidance: Do observations describe the mission relative to what is observed?
        raw: Estimation from raw measurements, for guidance from them; None without it.

    Attributes:
        begin: Stage that starts episodes.
        step: Stage that scores a step.
        observes: Does each step give the observation? It does for estimates with guidance.
    """

    def __init__(
        self, task: Any, estimation: Estimation, termination: str, prior_index: Sequence[int],
        observe: str, guidance: bool, raw: Estimation | None,
    ) -> None:  # fmt: skip
        self.task, self.space, self.prior_index = task, estimation.space, list(prior_index)
        self.observe, self.guidance, self.raw = observe, guidance, raw
        self.true_end, self.measured = termination == "task", observe == "measurement"
        self.observes = guidance and not self.measured
        compiled = is_compiled(task) and is_compiled(self.space.disturbance)
        self.step, self.begin = Stage(self._step, compiled), Stage(self._begin, compiled)

    def _step(self, now: State) -> Changes:
        """Reference, reward, end, score state and, if ``observes``, the observation."""
        task, acting = self.task, now.exogenous[..., : self.space.increments_and_flows]
        reference = self._reference(now, self.measured)
        ending = reference
        if self.true_end != self.measured:
            ending = self._reference(now, self.true_end)
        reward, end, score_state = task.score(
            now.state, acting, now.scenario, reference, task.over(now.scenario, ending),
            now.actuators, now.action, now.score_state,
        )  # fmt: skip
        scored = {"reward": reward, "total": now.total + reward, "end": end}
        scored |= {"score_state": score_state} | self.asked(now, now.steps + 1, reference)
        return scored | self._seen(now, reference)

    def _begin(self, now: State) -> Changes:
        """Reference at an episode's start and, if ``observes``, the observation."""
        reference = self._reference(now, self.measured)
        start = {"score_state": self.task.initial_score_state(now.state, now.scenario)}
        return start | self.asked(now, now.steps + 1, reference) | self._seen(now, reference)

    def asked(self, now: State, step: Any, reference: np.ndarray) -> Changes:
        """Commands and additions to increments and flows, which the world's next step reads.

        Args:
            now: The record.
            step: Number of the step that the additions act in.
            reference: Reference at the end of the last step; before the first, at the prior's mean.
        """
        commanded = self.task.commanded(now.scenario, now.steps, reference)
        asked = {"commanded": commanded, "imposed": self.task.exogenous(now.scenario, step)}
        return {name: each for name, each in asked.items() if each is not None}

    def _reference(self, now: State, true: bool) -> np.ndarray:
        """Reference at the true or the estimated state."""
        state = now.state[..., self.prior_index] if true else now.belief.mean
        return self.task.reference(now.scenario, now.steps, state)

    def _seen(self, now: State, reference: np.ndarray) -> Changes:
        """The reference and, if ``observes``, the observation."""
        observed = {"observation": self.observation(now, reference)} if self.observes else {}
        return {"reference": reference} | observed

    def observation(self, now: State, reference: np.ndarray) -> np.ndarray:
        """Observations ``(B, k)``, clipped to the task's bound."""
        task = self.task
        with np.errstate(over="ignore", invalid="ignore"):  # diverged estimates are clipped
            parts = self._of_measurements(now) if self.measured else self._of_belief(now, reference)
            return np.clip(np.concatenate(parts, -1), -task.BOUND, task.BOUND)

    def _of_belief(self, now: State, reference: np.ndarray) -> list[np.ndarray]:
        """Parts of an observation of estimates."""
        task, std = self.task, self.observe == "mean+std"
        estimate = estimate_of(self.space, now.belief, std)
        if self.guidance:
            parts = [task.observe(estimate, now.scenario, reference, now.actuators)]
        else:
            mission = task.observe_mission(now.scenario, now.steps, now.actuators)
            parts = [task.observe_state(estimate, now.scenario), mission]
        return [*parts, task.observe_std(estimate)] if std else parts

    def _of_measurements(self, now: State) -> list[np.ndarray]:
        """Parts of an observation of raw measurements."""
        task, scenario, steps = self.task, now.scenario, now.steps
        measured = task.observe_measurements(self.space.sensors, now.y, scenario, steps)
        parts = [
            np.where(now.available, measured, 0.0),
            now.available,
            task.observe_mission(scenario, steps, now.actuators),
        ]
        if self.raw is None:
            return parts
        estimate = estimate_of(self.raw.space, now.raw)
        reference = task.reference(scenario, steps, estimate.state)
        return [task.observe(estimate, scenario, reference, now.actuators), *parts]


def estimate_of(space: StateSpace, belief: Any, std: bool = False) -> Estimate:
    """Part of a belief that the task observes, with standard deviations if asked."""
    mean, d = belief.mean, belief.input_mean
    d = d if d is not None and d.shape[-1] else None
    estimate = Estimate(mean[..., : len(space.vehicle_states)], space.flow(mean, d), d)
    if std:
        estimate.sd, estimate.scale = standard_deviations(belief.cov), space.scale
        if d is not None and belief.input_cov is not None:
            estimate.input_sd = standard_deviations(belief.input_cov)
    return estimate


def standard_deviations(cov: np.ndarray) -> np.ndarray:
    """Standard deviations of covariances ``(B, n, n)``; 0 for variances rounded below 0."""
    sd: np.ndarray = np.sqrt(np.maximum(cov.diagonal(0, -2, -1), 0.0))
    return sd
