"""Bases of tasks: a ship is steered by its rudder, and follows a track."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators import Gaussian
from estimators.angles import ahead_and_aside
from estimators.checks import integer
from vessel_gym.checks import check_numbers, instance
from vessel_gym.sensors import Sensors
from vessel_gym.system import Estimate
from vessel_gym.tasks.task import Task, smoothness, wrapped
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.corvette_equations import CorvetteParameters

HEADING = 0
"""Column of a scenario with the first direction of the track."""
WANTED, RATE_NOW, RATE_AHEAD, _, OFF, TRACK, SURGE, BELIEVED = range(8)
"""Columns of a reference.

They are heading to steer in still water [rad], yaw rate now and `Steering.preview` seconds ahead
[rad/s], a column of the task's own, distance to starboard of the track [m], direction of the track
[rad], surge of the steady turn [m/s], and estimated heading [rad].
"""


def in_frame(scenario: np.ndarray, place: np.ndarray) -> np.ndarray:
    """North and east ``(..., 2)`` turned to ahead and to starboard of the first direction."""
    return np.stack(ahead_and_aside(place[..., 0], place[..., 1], scenario[..., HEADING]), -1)


def first_component(estimates: np.ndarray | None, like: np.ndarray) -> np.ndarray:
    """First component ``(...)`` of estimates ``(..., k)``; 0, shaped as ``like``, without any."""
    return np.zeros_like(like) if estimates is None else estimates[..., 0]


@dataclass(frozen=True)
class Steering(Task):
    """Base of the tasks in which a ship is steered by its rudder."""

    ship: CorvetteParameters
    pace: float = 1.0  # time to sail the ship's own length, relative to the corvette's
    horizon: int = 600  # steps

    def __post_init__(self) -> None:
        instance(f"ship of {type(self).__name__}", self.ship, CorvetteParameters)
        check_numbers(self, positive="pace")
        integer(f"horizon of {type(self).__name__}", self.horizon, 1)

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return 0.5 * self.pace

    @property
    def preview(self) -> float:
        """Time [s] by which the observed command is ahead."""
        return 10.0 * self.pace

    def smooth(self, actuators: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Factor of the reward for the steering ``(...)``, and next ``kept``, see `smoothness`."""
        return smoothness(actuators, kept, self.ship.rudder_rate * self.dt, self.RUDDER_PRICE)

    RUDDER_PRICE = 1.0  # of effort, in `smooth`
    SWAY_SCALE = 2.0  # m/s
    HEADING_SCALE = 0.1  # rad, errors and uncertainty
    INPUT_SCALE = 0.01  # rad

    @property
    def rate_scale(self) -> float:
        """Scale [rad/s] of errors and standard deviations of the yaw rate."""
        return 0.01 / self.pace

    @property
    def command_scale(self) -> float:
        """Scale [rad/s] of the commanded yaw rate."""
        return 0.04 / self.pace

    commands: ClassVar[tuple[int, ...]]
    """Columns of a reference with the commands that filters know."""

    def commanded(
        self, scenario: np.ndarray, step: np.ndarray, reference: np.ndarray
    ) -> np.ndarray:
        """Commands ``(..., k)`` that filters know besides the rudder, from a reference."""
        return reference[..., list(self.commands)]

    std_scales: ClassVar[Any]
    """Scales of observed standard deviations, by index in the estimated state."""

    def observe_std(self, estimate: Estimate) -> np.ndarray:
        """Scaled standard deviations of the components in `std_scales`, and of d, ``(..., k)``."""
        sd = [estimate.sd[..., i] for i in self.std_scales]
        d = first_component(estimate.input_sd, sd[0])
        return np.stack([*sd, d], -1) / [*self.std_scales.values(), self.INPUT_SCALE]

    @cached_property
    def _known_scales(self) -> list[float]:
        return [self.ship.rudder_limit, self.command_scale, self.command_scale]

    @cached_property
    def _mean_scales(self) -> list[float]:
        errors = self.HEADING_SCALE, self.rate_scale, self.SWAY_SCALE, self.INPUT_SCALE
        return [*errors, *self._known_scales]


class Track(Steering):
    """A track over ground, which begins at the origin."""

    prior_sd: ClassVar[tuple[float, ...]] = (2.0, 2.0, 0.03, 0.2, 0.2, 0.002)

    def prior(self, scenario: np.ndarray) -> Gaussian:
        """Prior of (x, y, psi, u, v, r): mean ``(B, 6)`` and covariance ``(6, 6)``."""
        mean = np.zeros((len(scenario), 6))
        mean[:, 2], mean[:, 3] = scenario[:, HEADING], self.ship.speed
        return self._spread.about(mean)

    def turning(self, curvature: np.ndarray) -> np.ndarray:
        """Yaw rate [rad/s] of the steady turn with a signed curvature [1/m]."""
        turns = steady_turns(self.ship)
        rate = np.interp(np.abs(curvature), 1.0 / turns.radius, turns.yaw_rate)
        return np.copysign(rate, curvature)

    def steady_course(
        self, rate: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Heading [rad] and surge [m/s] ``(...)`` of a steady turn with a given course.

        The heading is the direction of the track plus the drift angle of the steady turn.
        """
        turns = steady_turns(self.ship)
        surge, sway = (turns.interpolated(each, rate) for each in (turns.speed, turns.sway))
        return direction - np.arctan2(np.where(rate >= 0.0, sway, -sway), surge), surge

    commands = RATE_NOW, BELIEVED

    def course_error(
        self, state: np.ndarray, exogenous: np.ndarray, direction: np.ndarray
    ) -> np.ndarray:
        """True course over ground relative to a direction [rad] ``(...)``."""
        psi, u, v = (state[..., i] for i in range(2, 5))
        north, east = ahead_and_aside(u, v, -psi)
        course = np.arctan2(east + exogenous[..., 2], north + exogenous[..., 1])
        return wrapped(course - direction)

    # --- what the agent sees ----------------------------------------------------------------------

    SPEED_SCALE = 2.0  # m/s
    FLOW_SCALE = 1.0  # m/s

    @property
    def track_scale(self) -> float:
        """Scale [m] of distances from the track."""
        return 20.0

    def observe(
        self, estimate: Estimate, scenario: np.ndarray, reference: np.ndarray,
        actuators: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Observation ``(..., 11)`` of mode ``"mean"`` before clipping.

        Error of the heading that holds the track in the estimated current, error of the yaw rate,
        sway, d, rudder, commanded yaw rate now and ahead, distance to starboard of the track, surge
        minus that of the steady turn, and current along the track and to starboard.
        """
        psi, u, v, r = (estimate.state[..., i] for i in range(2, 6))
        columns = WANTED, RATE_NOW, RATE_AHEAD, OFF, SURGE
        heading, rate, rate_ahead, off, surge = (reference[..., i] for i in columns)
        d = first_component(estimate.input_mean, v)
        flow = estimate.flow[..., 0], estimate.flow[..., 1]
        along, across = ahead_and_aside(*flow, reference[..., TRACK])
        crab = np.arcsin(np.clip(across / surge, -0.5, 0.5))
        errors = wrapped(heading - crab - psi), rate * (1.0 + 2.0 * along / surge) - r
        seen = [*errors, v, d, actuators[..., 0], rate, rate_ahead, off, u - surge, along, across]
        scales = self.track_scale, self.SPEED_SCALE, self.FLOW_SCALE, self.FLOW_SCALE
        return np.stack(seen, -1) / [*self._mean_scales, *scales]

    def observe_state(self, estimate: Estimate, scenario: np.ndarray) -> np.ndarray:
        """Estimate ``(..., 10)`` in the frame of the first heading, without guidance.

        Position, sine and cosine of the heading, surge minus service speed, sway, yaw rate, d and
        current.
        """
        psi, u, v, r = (estimate.state[..., i] for i in range(2, 6))
        d = first_component(estimate.input_mean, v)
        turned, surge = psi - scenario[..., HEADING], (u - self.ship.speed) / self.SPEED_SCALE
        rest = v / self.SWAY_SCALE, r / self.command_scale, d / self.INPUT_SCALE
        own = np.sin(turned), np.cos(turned), surge, *rest
        place = in_frame(scenario, estimate.state[..., :2]) / self._place_scale
        current = in_frame(scenario, estimate.flow[..., :2]) / self.FLOW_SCALE
        return np.concatenate([place, np.stack(own, -1), current], -1)

    @property
    def _place_scale(self) -> float:
        """Scale of a position on the map [m]."""
        return 2.0 * self.ship.length

    @property
    def std_scales(self) -> dict[int, float]:
        """Scales of position, heading, sway and yaw rate."""
        place = 0.25 * self.track_scale
        motion = {2: self.HEADING_SCALE, 4: self.SWAY_SCALE, 5: self.rate_scale}
        return {0: place, 1: place} | motion

    def observe_measurements(
        self, sensors: Sensors, measurements: np.ndarray, scenario: np.ndarray, step: np.ndarray
    ) -> np.ndarray:
        """Measurements ``(..., p)``; heading and position are relative to the first ones."""
        gives, measured = list(sensors.gives), measurements / sensors.scale
        turned = wrapped(measurements - scenario[..., :1])
        measured = np.where([state == "psi" for state in gives], turned, measured)
        if "x" in gives and "y" in gives:
            x, y = gives.index("x"), gives.index("y")
            place = in_frame(scenario, measurements[..., [x, y]])
            measured[..., [x, y]] = place / self._place_scale
        return measured
