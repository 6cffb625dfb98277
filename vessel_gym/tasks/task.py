"""What a task has that says nothing else: the start of one of your own (docs/own-task.md)."""

from typing import Any, ClassVar

import numpy as np

from estimators import Gaussian
from estimators.factory import unknown
from vessel_gym.sensors import Sensors
from vessel_gym.system import Estimate, Vehicle


class Task:
    """A task that draws nothing, guides nobody and goes on until time is up; `score` is yours, and so is the rest.

    See `vessel_gym.system.Task` for what each method is for. Where no others are given, observations are the estimate
    or the readings, the course and the actuators, as they are but for the scales.
    """

    vehicle: Vehicle
    horizon: int = 500
    """Steps of a full episode."""
    uniforms: int = 0
    """Uniform numbers that `course` needs."""
    ends: tuple[str, ...] = ("",)
    """Why an episode may end, by number; number 0 is that it goes on."""
    success: str = ""
    """Which of ``ends`` means success; empty where success is to go on to the time limit."""
    BOUND = 10.0
    """Observations are scaled to be of order 1 and clipped to +-10."""
    prior_sd: ClassVar[tuple[float, ...]]
    """Standard deviations of what filters estimate of the vehicle, at the start."""
    state_scale: ClassVar[tuple[float, ...]]
    """Sizes that count as 1 of these."""
    std_scale: ClassVar[tuple[float, ...]]
    """Standard deviations of them that count as 1."""

    @property
    def perfect(self) -> float:
        """Sum of the rewards of a perfect episode: 1 a step."""
        return float(self.horizon)

    def course(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """The uniform numbers themselves ``(B, uniforms)``; there are no options.

        Raises:
            ValueError: for an option.
        """
        for option in options:
            raise ValueError(unknown("reset option", option, ()))
        return uniforms

    def prior(self, course: np.ndarray) -> Gaussian:
        """Where the vehicle cruises, within ``prior_sd``."""
        mean, _ = self.vehicle.cruise
        return Gaussian(np.tile(mean, (len(course), 1)), np.diag(self.prior_sd) ** 2)

    def reference(self, course: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The course ``(B, k)``."""
        return course

    def commanded(self, course: np.ndarray, step: np.ndarray) -> np.ndarray | None:
        """Nothing that filters are told of."""
        return None

    def sizes(self, readings: int, states: int) -> dict[str, int]:
        """The lengths of the parts of observations: by looking at them."""
        vehicle = self.vehicle
        course = self.course(np.full((1, self.uniforms), 0.5), {})
        mean, actuators = self.prior(course).mean, np.zeros((1, len(vehicle.start(vehicle.cruise[0][None])[1][0])))
        step, estimate = np.zeros(1, int), Estimate(mean, np.zeros((1, len(vehicle.flows))))
        mission = self.observe_mission(course, step, actuators).shape[-1]
        return {
            "guided": self.observe(estimate, self.reference(course, step, mean), actuators).shape[-1],
            "unguided": self.observe_state(estimate, course).shape[-1] + mission,
            "std": states,
            "readings": 2 * readings,
            "mission": mission,
        }

    def observe(self, estimate: Estimate, reference: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        """The estimated state and flow, the reference and the actuators."""
        return np.concatenate([self.observe_state(estimate, reference), reference, actuators], -1)

    def observe_state(self, estimate: Estimate, course: np.ndarray) -> np.ndarray:
        """The estimated state, scaled, and the flow."""
        scale = getattr(self, "state_scale", np.ones(estimate.state.shape[-1]))
        return np.concatenate([estimate.state / scale, estimate.flow], -1)

    def observe_std(self, estimate: Estimate) -> np.ndarray:
        """The standard deviations ``(B, m)`` of all that the filter estimates, scaled."""
        assert estimate.sd is not None
        assert estimate.scale is not None
        scale = getattr(self, "std_scale", np.ones(estimate.state.shape[-1]))
        return estimate.sd / np.concatenate([scale, estimate.scale])

    def observe_readings(
        self, sensors: Sensors, readings: np.ndarray, available: np.ndarray, course: np.ndarray, step: np.ndarray
    ) -> np.ndarray:
        """Raw readings ``(B, 2 p)``: readings and mask, no filter."""
        return np.concatenate([readings / sensors.scale, available], -1)

    def observe_mission(self, course: np.ndarray, step: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        """The course and the actuators."""
        return np.concatenate([course, actuators], -1)

    def over(self, reference: np.ndarray) -> np.ndarray:
        """Never ``(B,)``: it goes on until time is up."""
        return np.zeros(len(reference), bool)

    def begin(self, state: np.ndarray, course: np.ndarray) -> np.ndarray:
        """Nothing to remember: ``(B, 0)``."""
        return np.zeros((len(state), 0))

    def score(
        self,
        state: np.ndarray,
        forcing: np.ndarray,
        reference: np.ndarray,
        over: np.ndarray,
        actuators: np.ndarray,
        action: np.ndarray,
        tally: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Yours: reward in [0, 1] ``(B,)``, number in ``ends`` ``(B,)`` and the next tally, from the truth."""
        raise NotImplementedError(f"{type(self).__name__} needs a method score: what is a step worth?")
