"""The task of an environment over a step, as one function of a row: reference, score and observation."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.engine import compiled
from vessel_gym.composition import Composition
from vessel_gym.system import Estimate, Task


class Mission:
    """What the task makes of an estimate and of the truth, where estimates alone are observed, with guidance.

    Args:
        task: One of this package.
        told: What the filter estimates.
        ends: Whose estimate or word completes a mission: one of `vessel_gym.configuration.ENDS`.
        based: Which components of the true state stand where the filter has them.
    """

    def __init__(self, task: Task, told: Composition, ends: str, based: Sequence[int]) -> None:
        self.task, self.told, self.ends, self.based = task, told, ends, list(based)

    @compiled(axes=(1, 0, 0, 1, 1, 1, 1, 1, 1, 1))
    def step(
        self, course: np.ndarray, steps: np.ndarray, declared: np.ndarray, mean: np.ndarray, input_mean: np.ndarray,
        state: np.ndarray, forcing: np.ndarray, actuators: np.ndarray, action: np.ndarray, tally: np.ndarray,
    ) -> tuple[np.ndarray, ...]:  # fmt: skip
        """Reference ``(..., k)``, reward and end ``(...)``, score state and observation of mode ``"mean"``.

        Args:
            course: What the task drew ``(..., c)``.
            steps: ``(...)`` since the episode's start.
            declared: ``(...)`` where the agent says that the mission is complete.
            mean: Estimated state ``(..., n)``,
            input_mean: and unknown input ``(..., q)``; q may be 0.
            state: True state.
            forcing: True exogenous input ``(..., f)``.
            actuators: ``(..., a)``.
            action: ``(..., a)``.
            tally: Score state of the step before.
        """
        task: Any = self.task
        reference = task.reference(course, steps, mean)
        over = declared
        if self.ends == "belief":
            over = task.over(reference)
        elif self.ends == "task":
            over = task.over(task.reference(course, steps, state[..., self.based]))
        reward, end, tally = task.score(state, forcing, reference, over, actuators, action, tally)
        return reference, reward, end, tally, self.observe(mean, input_mean, reference, actuators)

    @compiled
    def observe(
        self, mean: np.ndarray, input_mean: np.ndarray, reference: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        """The observation of mode ``"mean"``, within bounds."""
        known = input_mean if input_mean.shape[-1] else None
        estimate = Estimate(mean[..., : self.told.base], self.told.flow(mean, known), known)
        bound = self.task.BOUND
        return np.clip(self.task.observe(estimate, reference, actuators), -bound, bound)
