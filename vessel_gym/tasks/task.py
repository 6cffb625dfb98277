"""The interface of a task, with defaults for all but the score; see docs/own-task.md."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators import Gaussian
from estimators.checks import finite_array, numbers, short_repr
from vessel_gym.checks import check_numbers, one_of
from vessel_gym.sensors import Sensors
from vessel_gym.vehicles.vehicle import Vehicle

HULLS = ("ship", "torpedo", "aircraft", "dot")
"""Outlines of vehicles for images."""
FARTHEST = 1e5
"""Farthest place [m]; a larger number is an error of the unit or the origin."""
TRAVEL = 1.25
"""Cost of the full rate in every step; a good autopilot in moderate seas needs a tenth of that."""
REVERSALS = 4.0
"""Cost of a reversal between full rates in every step; smaller changes cost in proportion."""

SCORE_AXES = 1, 1, 1, 1, 0, 1, 1, 1
"""Axes of a row of each argument of `Task.score`, for `estimators.engine.compiled`."""


@dataclass(frozen=True)
class Workspace:
    """Path, goal, obstacles and other bounds of one episode, in metres north, east and down.

    Attributes:
        hull: Outline of the vehicle, one of `HULLS`.
        size: Length of the vehicle; span of an aircraft.
        path: ``(k, 3)`` path to follow.
        fairway: ``(k, 3)`` outline of the permitted water.
        goal: Position of the goal, and the distance that counts as arrival; None: no goal.
        obstacles: ``(m, 3)`` north, east and radius of upright cylinders.
        surface: Depth of the water surface; None: no surface in the image.

    Raises:
        ValueError: for an unknown hull, or numbers that are not finite.
    """

    hull: str = "dot"
    size: float = 1.0
    path: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    fairway: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    goal: tuple[float, float, float, float] | None = None
    obstacles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    surface: float | None = None

    def __post_init__(self) -> None:
        one_of("hull", self.hull, HULLS)
        check_numbers(self, positive="size", finite="surface?")
        for name in ("path", "fairway", "obstacles"):
            finite_array(f"{name} of Workspace", getattr(self, name), "k", 3)
        if self.goal is not None:
            finite_array("goal of Workspace", self.goal, 4)

    @property
    def landmarks(self) -> np.ndarray:
        """Points of path and goal ``(n, 3)``, which every map shows."""
        goal = [] if self.goal is None else [self.goal[:3]]
        return np.concatenate([self.path, np.reshape(goal, (-1, 3))])


def at_depth(points: np.ndarray, down: float = 0.0) -> np.ndarray:
    """Points ``(k, 2)`` north and east as points ``(k, 3)`` at one depth."""
    return np.pad(points, ((0, 0), (0, 1)), constant_values=down)


@dataclass(slots=True, eq=False)
class Estimate:
    """Part of a belief that a task observes.

    Attributes:
        state: ``(B, n)`` state of the vehicle, with the components of the prior.
        flow: ``(B, f)`` ambient flow; 0 where the filter estimates none.
        input_mean: ``(B, q)`` unknown input; None if the filter estimates none.
        sd: ``(B, m)`` standard deviations of all that the filter estimates, the state first; None
            unless observed.
        input_sd: ``(B, q)`` standard deviations of the unknown input; None unless observed.
        scale: ``(m - n,)`` divisors for the standard deviations in ``sd`` after the first n; None
            unless observed.
    """

    state: np.ndarray
    flow: np.ndarray
    input_mean: np.ndarray | None = None
    sd: Any = None
    input_sd: np.ndarray | None = None
    scale: Any = None


class Task:
    """Base class of missions; by default without scenario, guidance, or end before the time limit.

    A subclass must define `score` and may override all else. Default observations are the estimate
    or the measurements, the scenario and the actuators, divided by their scales. Only `score`,
    `reference` and `over` can receive the truth. No argument of an ``observe`` method contains the
    truth.
    """

    vehicle: Vehicle
    horizon: int = 500
    """Steps of a full episode."""
    uniforms: int = 0
    """Number of uniform random numbers that `scenario` needs."""
    end_reasons: tuple[str, ...] = ("",)
    """Reasons for an episode's end by number; number 0 means that the episode goes on."""
    success: str = ""
    """Entry of ``end_reasons`` that means success; empty if it means to last for the horizon."""
    BOUND = 10.0
    """Observations are scaled to be of order 1 and clipped to +-10."""
    prior_sd: ClassVar[tuple[float, ...]]
    """Standard deviations of the vehicle's estimated components at the start."""
    observed: ClassVar[dict[str, float]] = {}
    """Names and scales [SI] of the first components of an observation of mode ``"mean"``."""
    state_offset: ClassVar[tuple[float, ...]] = (0.0,)
    """Values of the vehicle's estimated components that observations show as 0."""
    state_scale: ClassVar[tuple[float, ...]] = (1.0,)
    """Divisors of the vehicle's estimated components in observations."""
    flow_scale: ClassVar[float] = 1.0
    """Divisor of flows in observations."""
    std_scale: ClassVar[tuple[float, ...]]
    """Divisors of the estimated components' standard deviations in observations."""

    @property
    def perfect(self) -> float:
        """Sum of the rewards of a perfect episode, by default 1 for each step of the horizon."""
        return float(self.horizon)

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Scenarios ``(B, k)``, drawn at reset; default: the uniform numbers ``(B, uniforms)``.

        Args:
            uniforms: ``(B, uniforms)`` random numbers in [0, 1].
            options: Reset options; the default has none.

        Raises:
            ValueError: for an option that the task does not have.
        """
        for option in options:
            one_of("reset option", option, ())
        return uniforms

    @cached_property
    def _spread(self) -> Gaussian:
        """Prior about zero."""
        return Gaussian(np.zeros(len(self.prior_sd)), np.diag(self.prior_sd) ** 2)

    def prior(self, scenario: np.ndarray) -> Gaussian:
        """Prior of the vehicle's state: mean ``(B, n)`` and covariance ``(n, n)``.

        Default: the cruising vehicle, with standard deviations ``prior_sd``.
        """
        mean, _ = self.vehicle.cruise
        return self._spread.about(np.tile(mean, (len(scenario), 1)))

    def reference(self, scenario: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Reference ``(B, r)`` at a step, for a vehicle in a true or estimated state ``(B, n)``.

        Default: the scenario ``(B, k)``. The state has the components of the prior.
        """
        return scenario

    def commanded(
        self, scenario: np.ndarray, step: np.ndarray, reference: np.ndarray
    ) -> np.ndarray | None:
        """Commands ``(B, c)`` that filters know besides the actuators; default: None.

        The reference ``(B, r)`` is that of the step; before the first step, at the prior's mean.
        """
        return None

    def exogenous(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray | None:
        """Addition ``(B, f)`` to increments and flows over the coming step; default: None."""
        return None

    def observe(
        self, estimate: Estimate, scenario: np.ndarray, reference: np.ndarray,
        actuators: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Guidance ``(B, k)`` from the estimate, and the actuators.

        Default: the estimated state and flow, the reference and the actuators.

        Args:
            estimate: Estimate of the filter.
            scenario: ``(B, k)``.
            reference: ``(B, r)`` as `reference` returns it.
            actuators: ``(B, a)``.
        """
        return np.concatenate([self.observe_state(estimate, scenario), reference, actuators], -1)

    def named(self, observations: np.ndarray) -> dict[str, np.ndarray]:
        """Components ``(...)`` in SI of observations ``(..., k)`` of mode ``"mean"``, by name."""
        scales = enumerate(self.observed.items())
        return {name: scale * observations[..., i] for i, (name, scale) in scales}

    def observe_state(self, estimate: Estimate, scenario: np.ndarray) -> np.ndarray:
        """The estimate ``(B, k)`` in observations without guidance; `observe_mission` follows it.

        Default: the scaled state, with the vehicle's angles in (-pi, pi], and the scaled flow.
        """
        state = estimate.state - np.array(self.state_offset)
        angular = self._are_angles[: state.shape[-1]]
        if any(angular):
            state = np.where(angular, wrapped(state), state)
        state = state / np.array(self.state_scale)
        return np.concatenate([state, estimate.flow / self.flow_scale], -1)

    @cached_property
    def _are_angles(self) -> list[bool]:
        """For each of the vehicle's estimated components, is it an angle? Empty without one."""
        vehicle: Any = getattr(self, "vehicle", None)
        names = () if vehicle is None else vehicle.estimated(vehicle.kinds[0])
        return [name in vehicle.angles for name in names]

    def observe_std(self, estimate: Estimate) -> np.ndarray:
        """Standard deviations ``(B, k)``, which mode ``"mean+std"`` appends.

        Default: the scaled standard deviations ``(B, m)`` of all that the filter estimates.
        """
        scale = getattr(self, "std_scale", np.ones(estimate.state.shape[-1]))
        return estimate.sd / np.concatenate([scale, estimate.scale])

    def observe_measurements(
        self, sensors: Sensors, measurements: np.ndarray, scenario: np.ndarray, step: np.ndarray
    ) -> np.ndarray:
        """Scaled measurements ``(B, p)`` of raw observations, which their mask completes.

        The observation holds 0 where a measurement is missing, whatever this method returns there.

        Args:
            sensors: Sensors of the environment.
            measurements: ``(B, p)``, 0 where missing.
            scenario: ``(B, k)``.
            step: ``(B,)`` steps since the episode's start.
        """
        return measurements / sensors.scale

    def observe_mission(
        self, scenario: np.ndarray, step: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        """Mission ``(B, k)`` in observations of raw measurements or without guidance.

        Default: the scenario and the actuators.
        """
        return np.concatenate([scenario, actuators], -1)

    def workspace(self, scenario: np.ndarray) -> Workspace:
        """Workspace that images and pages show; default: the vehicle alone.

        Args:
            scenario: ``(k,)``, of one episode.
        """
        return Workspace()

    def over(self, scenario: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Mask ``(...)`` of the references ``(..., r)`` at which the mission is complete.

        Default: never. Scenarios are ``(..., k)``.
        """
        return np.zeros(reference.shape[:-1], bool)

    score_states: ClassVar[int] = 0
    """Number k of components of the score state, if they are 0 at the start."""

    def initial_score_state(self, state: np.ndarray, scenario: np.ndarray) -> np.ndarray:
        """Score state ``(..., k)`` at the start; default: ``score_states`` zeros."""
        return np.zeros((*state.shape[:-1], self.score_states))

    def score(
        self, state: np.ndarray, exogenous: np.ndarray, scenario: np.ndarray,
        reference: np.ndarray, over: np.ndarray, actuators: np.ndarray, action: np.ndarray,
        score_state: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Reward of a step, from the truth; every subclass must define this method.

        The score of an episode, in ``info``, is the sum of its rewards divided by ``perfect``,
        clipped to [0, 1]. Negative sums count as 0, so express a cost as a factor such as ``1 / (1
        + cost)``.

        Args:
            state: ``(B, n)`` true state of the vehicle after the step, with the components
                ``vehicle.state_names``.
            exogenous: ``(B, f)`` true exogenous input over the next step: ``vehicle.increments``,
                then ``vehicle.ambient_flows``.
            scenario: ``(B, k)``.
            reference: ``(B, r)`` as `reference` returns it. It is evaluated at the estimated state,
                so a reward that depends on it scores the estimate; if raw measurements are
                observed, it is evaluated at the true state.
            over: ``(B,)`` as `over` returns it for the reference at the estimated state or, with
                ``termination="task"``, at the true state.
            actuators: ``(B, a)`` after the step.
            action: ``(B, a)``, clipped to [-1, 1].
            score_state: ``(B, k)`` of the step before; see `initial_score_state`.

        Returns:
            Reward ``(B,)``, number of the end reason ``(B,)``, 0 where the episode goes on,
            and the next score state.
        """
        raise NotImplementedError(
            f"{type(self).__name__} needs a method score: what is a step worth?"
        )


def three_numbers(name: str, value: object, what: str) -> np.ndarray:
    """A place or a pose ``(3,)`` from a reset option.

    Args:
        name: Name of the option, for error messages.
        value: Value of the option.
        what: Meaning of the three numbers, for error messages.

    Raises:
        ValueError: if the value is not three numbers of at most `FARTHEST` in size.
    """
    three = numbers(value)
    if three is None or three.shape != (3,) or not (np.abs(three) <= FARTHEST).all():
        raise ValueError(
            f"{name} must be three numbers within +-{FARTHEST:.0f}, {what}, got {short_repr(value)}"
        )
    return three


def closeness(error: np.ndarray, tolerance: float) -> np.ndarray:
    """Factor of a reward: 1 without an error, 1/2 at the tolerance, 0 far off."""
    return 1.0 / (1.0 + (error / tolerance) ** 2)


def smoothness(
    position: np.ndarray, kept: np.ndarray, full: float, price: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Factor of a reward ``(...)`` for steady actuators, and the next ``kept`` ``(..., 2 k)``.

    The factor is `1 / (1 + price (TRAVEL |rate| + REVERSALS |rate - last rate| / 2))`, with means
    over the actuators. The terms are linear, so that their sum over an episode counts the travel,
    and the reversals times their size. The factor has no lower bound but 0: more effort always
    costs more.

    Args:
        position: ``(..., k)`` positions of actuators.
        kept: ``(..., 2 k)`` positions after the last step, then rates as shares of the full rate.
        full: Change of a position in a step at the full rate.
        price: Cost relative to a ship's rudder.
    """
    last, last_rate = np.split(kept, 2, -1)
    rate = (position - last) / full
    effort = TRAVEL * np.abs(rate) + 0.5 * REVERSALS * np.abs(rate - last_rate)
    factor = 1.0 / (1.0 + price / rate.shape[-1] * effort.sum(-1))
    return factor, np.concatenate([position, rate], -1)


def first_reason(*masks: np.ndarray) -> np.ndarray:
    """Number ``(...)``, from 1, of the first mask that holds; 0 where none does."""
    number: Any = 0
    for i in range(len(masks), 0, -1):
        number = np.where(masks[i - 1], i, number)
    found: np.ndarray = number
    return found


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Angle in (-pi, pi]; angles within half a turn of 0 keep all digits."""
    return angle + 2.0 * np.pi * np.floor(0.5 - 0.5 / np.pi * angle)
