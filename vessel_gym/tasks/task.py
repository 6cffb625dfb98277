"""The interface of a task, with defaults for all but its score: the start of one of your own (docs/own-task.md)."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators import Gaussian
from estimators.checks import numbers, short_repr
from estimators.factory import unknown
from vessel_gym.sensors import Sensors
from vessel_gym.vehicles.vehicle import Vehicle
from vessel_gym.verified import Verified

FARTHEST = 1e5
"""m: a place beyond is a slip, in the unit or the origin."""


@dataclass(slots=True, eq=False)
class Estimate:
    """Part of a belief that a task observes.

    Attributes:
        state: ``(B, n)`` the vehicle's state, as in the prior.
        flow: ``(B, f)`` what carries it; 0 where the filter knows of none.
        input_mean: ``(B, q)`` the unknown input; None: the filter estimates none.
        sd: ``(B, m)`` standard deviations of the state, then of all else that the filter estimates;
            like the next two only where they are observed.
        input_sd: ``(B, q)`` of the unknown input.
        scale: ``(m - n,)`` sizes of all else that count as 1.
    """

    state: np.ndarray
    flow: np.ndarray
    input_mean: np.ndarray | None = None
    sd: np.ndarray | None = None
    input_sd: np.ndarray | None = None
    scale: np.ndarray | None = None


class Task(Verified):
    """A mission. This one draws nothing, guides nobody and goes on until time is up.

    `score` is yours, and so is the rest. Where no others are given, observations are the estimate
    or the measurements, the scenario and the actuators, as they are but for the scales. ``observe``
    has no parameter through which truth could come; ``score`` alone reads it.

    A task may have ``exogenous(scenario, step)``, too: what it adds to the increments and flows of
    the disturbance over the coming step ``(B, f)``.
    """

    vehicle: Vehicle
    horizon: int = 500
    """Steps of a full episode."""
    uniforms: int = 0
    """Uniform numbers that `scenario` needs."""
    end_reasons: tuple[str, ...] = ("",)
    """Reasons for an episode's end by number; number 0 is that it goes on."""
    success: str = ""
    """The one of ``end_reasons`` that means success; empty where success is to go on to the time limit."""
    commanding: ClassVar[slice | list[int] | None] = None
    """Columns of a reference that hold what is `commanded`, for verified tasks; None: none do."""
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

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Draw scenarios at reset, ``(B, k)``: the uniform numbers ``(B, uniforms)`` themselves; there are no options.

        Raises:
            ValueError: for an option.
        """
        for option in options:
            raise ValueError(unknown("reset option", option, ()))
        return uniforms

    @cached_property
    def _spread(self) -> Gaussian:
        """The prior's covariance, about zero."""
        return Gaussian(np.zeros(len(self.prior_sd)), np.diag(self.prior_sd) ** 2)

    def prior(self, scenario: np.ndarray) -> Gaussian:
        """Prior of the vehicle's state: mean ``(B, n)``, covariance ``(n, n)``.

        Where it cruises, within ``prior_sd``.
        """
        mean, _ = self.vehicle.cruise
        return Gaussian(np.tile(mean, (len(scenario), 1)), np.diag(self.prior_sd) ** 2)

    def reference(self, scenario: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Reference at a step, for a vehicle that is (or is estimated to be) in a state ``(B, n)``, as in the prior.

        The scenario ``(B, k)``.
        """
        return scenario

    def commanded(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray | None:
        """Commands that filters know besides the actuators; None: none."""
        return None

    def sizes(self, measurements: int, states: int) -> dict[str, int]:
        """Lengths of the parts of observations, by what follows, of so many measurements and states of the filter.

        By looking at them.
        """
        vehicle = self.vehicle
        scenario = self.scenario(np.full((1, self.uniforms), 0.5), {})
        mean = np.array(self.prior(scenario).mean)
        actuators = np.zeros((1, len(vehicle.start(vehicle.cruise[0][None])[1][0])))
        step, estimate = np.zeros(1, int), Estimate(mean, np.zeros((1, len(vehicle.ambient_flows))))
        mission = self.observe_mission(scenario, step, actuators).shape[-1]
        return {
            "guided": (
                self.observe(estimate, self.reference(scenario, step, mean), actuators).shape[-1]
            ),
            "unguided": self.observe_state(estimate, scenario).shape[-1] + mission,
            "std": states,
            "measurements": 2 * measurements,
            "mission": mission,
        }

    def observe(
        self, estimate: Estimate, reference: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        """``"guided"``: how to go on from the estimate, and the actuators.

        The estimated state and flow, the reference and the actuators.
        """
        return np.concatenate([self.observe_state(estimate, reference), reference, actuators], -1)

    def observe_state(self, estimate: Estimate, scenario: np.ndarray) -> np.ndarray:
        """The estimate as it is, which together with the mission is ``"unguided"``.

        The estimated state, scaled, and the flow.
        """
        scale = getattr(self, "state_scale", np.ones(estimate.state.shape[-1]))
        return np.concatenate([estimate.state / scale, estimate.flow], -1)

    def observe_std(self, estimate: Estimate) -> np.ndarray:
        """``"std"``: what mode ``"mean+std"`` appends.

        The standard deviations ``(B, m)`` of all that the filter estimates, scaled.
        """
        assert estimate.sd is not None
        assert estimate.scale is not None
        scale = getattr(self, "std_scale", np.ones(estimate.state.shape[-1]))
        return estimate.sd / np.concatenate([scale, estimate.scale])

    def observe_measurements(
        self,
        sensors: Sensors,
        measurements: np.ndarray,
        available: np.ndarray,
        scenario: np.ndarray,
        step: np.ndarray,
    ) -> np.ndarray:
        """``"measurements"``: as they come, with their mask, ``(B, 2 p)``: no filter."""
        return np.concatenate([measurements / sensors.scale, available], -1)

    def observe_mission(
        self, scenario: np.ndarray, step: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        """``"mission"``: what is asked, which is the scenario, and the actuators."""
        return np.concatenate([scenario, actuators], -1)

    def over(self, reference: np.ndarray) -> np.ndarray:
        """Is the mission complete? ``(...)``. Default: never, it goes on until time is up."""
        return np.zeros(reference.shape[:-1], bool)

    def initial_score_state(self, state: np.ndarray, scenario: np.ndarray) -> np.ndarray:
        """Initial score state ``(..., k)``: empty."""
        return np.zeros((*state.shape[:-1], 0))

    def score(
        self, state: np.ndarray, exogenous: np.ndarray, reference: np.ndarray, over: np.ndarray, actuators: np.ndarray,
        action: np.ndarray, score_state: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Score of a step, from the truth: yours.

        The score of an episode, in ``info``, is the sum of its rewards over ``perfect``, clipped to
        [0, 1]: of a cost that is subtracted it would be 0, so make it a factor such as ``1 / (1 +
        cost)``.

        Returns:
            Reward ``(B,)``, the number in ``end_reasons`` of why the episode ends (0: it goes on)
            ``(B,)``, and the next score state.
        """
        raise NotImplementedError(
            f"{type(self).__name__} needs a method score: what is a step worth?"
        )


def three_numbers(name: str, value: object, what: str, within: str) -> np.ndarray:
    """A place or a pose ``(3,)`` that somebody asks for.

    Raises:
        ValueError: if it is none, saying ``what`` it must be, or lies beyond `FARTHEST`, saying
            ``within`` what.
    """
    three = numbers(value)
    if three is None or three.shape != (3,) or not np.isfinite(three).all():
        raise ValueError(f"{name} must be three finite numbers, {what}, got {short_repr(value)}")
    if np.abs(three).max() > FARTHEST:
        raise ValueError(
            f"{name} must lie within {FARTHEST:.0f} m {within}, got {short_repr(value)}"
        )
    return three
