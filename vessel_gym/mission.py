"""A task over a step, as one function of a row: reference, score and observation."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.engine import compiled
from vessel_gym.filter_models.build import Composition
from vessel_gym.foreign import CheckedMethods, refuse_not_finite
from vessel_gym.tasks.task import Estimate
from vessel_gym.verified import is_verified


class Mission:
    """Reference, score and observation of a task, from an estimate and the truth.

    Methods are compiled unless they call a user's function.

    Args:
        task: Task; a user's has `CheckedMethods`.
        composition: Filter's model and its parts.
        termination: One of `vessel_gym.configuration.TERMINATIONS`.
        based: Indices of the true state's components that the prior describes.
        guided: Are estimates with guidance, and nothing else, observed? Then each step returns the
            observation.
        measured: Are raw measurements observed? Then the reference is evaluated at the true state.
    """

    def __init__(
        self,
        task: Any,
        composition: Composition,
        termination: str,
        based: Sequence[int],
        guided: bool,
        measured: bool,
    ) -> None:
        self.task, self.composition, self.termination, self.based = (
            task,
            composition,
            termination,
            list(based),
        )
        self.guided, self.measured = guided, measured
        if isinstance(task, CheckedMethods) or not is_verified(composition.forces.disturbance):
            self.begin, self.step = self.begin.function, self.step.function

    @compiled(axes=(1, 0, 1, 1, 1, 1, 1, 1, 1))
    def step(
        self, scenario: np.ndarray, steps: np.ndarray, mean: np.ndarray, input_mean: np.ndarray,
        state: np.ndarray, exogenous: np.ndarray, actuators: np.ndarray, action: np.ndarray,
        score_state: np.ndarray,
    ) -> tuple[np.ndarray, ...]:  # fmt: skip
        """Reference ``(..., k)``, reward, end, score state and, if ``guided``, the observation.

        Args:
            scenario: Scenario ``(..., c)`` of the task.
            steps: ``(...)`` since the episode's start.
            mean: Estimated state ``(..., n)``.
            input_mean: Estimated unknown input ``(..., q)``; q may be 0.
            state: True state.
            exogenous: True exogenous input ``(..., f)``.
            actuators: ``(..., a)``.
            action: ``(..., a)``.
            score_state: Score state of the step before.
        """
        task, truth = self.task, state[..., self.based]
        reference = task.reference(scenario, steps, truth if self.measured else mean)
        true = self.termination == "task"
        alike = true == self.measured
        over = task.over(
            reference if alike else task.reference(scenario, steps, truth if true else mean)
        )
        reward, end, score_state = task.score(
            state, exogenous, reference, over, actuators, action, score_state
        )
        seen = self._seen(steps, mean, input_mean, state, reference, actuators)
        return reference, reward, end, score_state, *seen

    @compiled(axes=(1, 0, 1, 1, 1, 1))
    def begin(
        self, scenario: np.ndarray, steps: np.ndarray, mean: np.ndarray, input_mean: np.ndarray,
        state: np.ndarray, actuators: np.ndarray,
    ) -> tuple[np.ndarray, ...]:  # fmt: skip
        """Reference ``(..., k)`` at an episode's start and, if ``guided``, the observation."""
        reference = self.task.reference(
            scenario, steps, state[..., self.based] if self.measured else mean
        )
        return reference, *self._seen(steps, mean, input_mean, state, reference, actuators)

    def _seen(
        self, steps: np.ndarray, mean: np.ndarray, input_mean: np.ndarray, state: np.ndarray,
        reference: np.ndarray, actuators: np.ndarray,
    ) -> tuple[np.ndarray, ...]:  # fmt: skip
        """Observation of mode ``"mean"``, clipped, if ``guided``."""
        if not self.guided:
            return ()
        with np.errstate(over="ignore", invalid="ignore"):  # diverged estimates are clipped
            seen = self.task.observe(
                estimate_of(self.composition, mean, input_mean), reference, actuators
            )
            seen = np.clip(seen, -self.task.BOUND, self.task.BOUND)
        if isinstance(self.task, CheckedMethods):
            refuse_not_finite(
                f"the observation of {self.task.title}", seen, steps, None, mean, state
            )
        return (seen,)


def estimate_of(
    composition: Composition, mean: np.ndarray, input_mean: np.ndarray | None
) -> Estimate:
    """Estimate for the task, from means ``(..., n)`` of the state and ``(..., q)`` of d."""
    known = input_mean if input_mean is not None and input_mean.shape[-1] else None
    return Estimate(mean[..., : composition.base], composition.flow(mean, known), known)


def standard_deviations(cov: np.ndarray) -> np.ndarray:
    """Standard deviations of covariances ``(B, n, n)``; 0 for variances rounded below 0."""
    sd: np.ndarray = np.sqrt(np.maximum(cov.diagonal(0, -2, -1), 0.0))
    return sd
