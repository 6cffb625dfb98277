"""Keep a ship between the edges of a channel: along a straight leg, or a route of waypoints."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators import Gaussian
from estimators.checks import integer
from estimators.engine import compiled, sincos
from vessel_gym.checks import one_of
from vessel_gym.guidance.dubins import COLUMNS, pose_along
from vessel_gym.guidance.path_following import NEAREST, locate, padded
from vessel_gym.guidance.routes import route
from vessel_gym.tasks.task import SCORE_AXES, Workspace, at_depth, closeness, first_reason
from vessel_gym.tasks.track import HEADING, Track, in_frame

OFFSET, ERROR, LENGTH = 1, 2, 3
"""Columns of a scenario after the first direction.

They are distance to starboard [m] and heading error [rad] at the start, and length of the channel
[m]. Waypoints and the path follow.
"""
ALONG = 3
"""Column of a reference with the distance along the channel [m]."""
_POINTS = LENGTH + 1


@compiled
@dataclass(frozen=True)
class Channel(Track):
    """A channel with lateral margins, along a straight leg or along legs joined by arcs.

    The channel begins at the origin. A scenario (the episode's parameters, drawn at reset) is
    ``(direction of the first leg [rad], distance to starboard and heading error at the start [m,
    rad], length [m])``, then the waypoints after the first one (north, east [m]; the last is
    repeated) and the segments of the path (x, y, heading, curvature, length; padded by segments of
    length 0). Scenarios and observations have room for a fixed number of ``waypoints``.

    A reference belongs to the point of the axis nearest to the estimated position. It is ``(heading
    to steer in still water [rad], mean yaw rates over the next half of PREVIEW and the PREVIEW
    after it [rad/s], distance along the channel [m], to starboard of its axis [m], direction of the
    axis [rad], surge of the steady turn [m/s], estimated heading [rad])``.

    The margin follows the concept design of PIANC Report 121 (2014), for a one-way outer channel: a
    width of 5 beams, of which the ship's middle may use 4. The width is the sum of 1.5 beams for
    the manoeuvring lane (moderate), 0.1 for a fast ship, 0.3 for cross wind up to 33 kn, 0.5 for
    cross current up to 1.5 kn, 1.0 for waves above 3 m, 0.2 for aids to navigation (good), and 0.7
    of bank clearance on either side. The last three have not been compared with the report itself.
    """

    waypoints: int = 8  # largest number in a route

    leg = 40.0  # length of the straight channel, ship lengths
    margin_beams = 2.0  # beams by which the ship's middle may be off the axis
    turn = 4.0  # ship lengths, radius of the arcs between waypoints
    angle = 0.25 * np.pi  # rad, of a straight channel from north, along which waves run
    spread = float(np.deg2rad(10.0))  # rad, largest deviation from that angle
    offset = 0.5  # largest initial offset, share of the margin
    error = 0.05  # rad, largest initial error of the heading

    def __post_init__(self) -> None:
        super().__post_init__()
        integer("waypoints of Channel", self.waypoints, 2)

    uniforms = 4
    end_reasons = ("", "aground", "arrived")
    success = "arrived"
    perfect = 1.0
    """A perfect episode has the score 1."""

    @property
    def margin(self) -> float:
        """Greatest distance [m] of the ship's middle from the axis."""
        return self.margin_beams * self.ship.beam

    @property
    def track_scale(self) -> float:
        """Scale [m] of distances from the axis; 20 m for the corvette."""
        return self.margin / 1.4

    @property
    def _first_segment(self) -> int:
        """Column of a scenario in which the segments of the path begin."""
        return _POINTS + 2 * (self.waypoints - 1)

    # --- what is drawn ----------------------------------------------------------------------------

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Draw scenarios ``(B, k)`` from uniforms ``(B, 4)``.

        Args:
            uniforms: Random numbers for side and angle of the leg, and offset and heading error at
                the start.
            options: ``{"waypoints": [(north, east), ...]}`` sets the channel's axis [m], relative
                to the first waypoint.

        Raises:
            ValueError: for an unknown option, more than ``waypoints``, or an invalid route, see
                `vessel_gym.guidance.routes`.
        """
        scenarios = self._drawn(uniforms)
        for option, value in options.items():
            one_of("reset option", option, ("waypoints",))
            radius, width = self.turn * self.ship.length, 2.0 * self.margin + self.ship.beam
            points, path = route(value, radius, width)
            if len(points) > self.waypoints:
                raise ValueError(
                    f"waypoints must be {self.waypoints} at most, got {len(points)}: channel_system"
                    " makes room for more"
                )
            scenarios[:, HEADING], scenarios[:, LENGTH] = path.segments[0, 2], path.length
            last, first = points[-1:].repeat(self.waypoints - len(points), 0), self._first_segment
            scenarios[:, _POINTS:first] = np.concatenate([points[1:], last]).ravel()
            scenarios[:, first:] = padded(path.segments, 2 * self.waypoints - 3)
        return scenarios

    @compiled
    def _drawn(self, uniforms: np.ndarray) -> np.ndarray:
        """Scenarios ``(..., k)`` of straight legs."""
        centred = 2.0 * uniforms - 1.0
        heading = np.copysign(self.angle + self.spread * centred[..., 1], centred[..., 0])
        zero, length = np.zeros_like(heading), np.zeros_like(heading) + self.leg * self.ship.length
        sin, cos = sincos(heading)
        offset, error = self.offset * self.margin * centred[..., 2], self.error * centred[..., 3]
        points = [length * cos, length * sin] * (self.waypoints - 1)
        path = [zero, zero, heading, zero, length, *[zero] * (COLUMNS * 2 * (self.waypoints - 2))]
        return np.stack([heading, offset, error, length, *points, *path], -1)

    def prior(self, scenario: np.ndarray) -> Gaussian:
        """Prior of (x, y, psi, u, v, r): mean ``(B, 6)`` and covariance ``(6, 6)``."""
        mean, (sin, cos) = np.zeros((len(scenario), 6)), sincos(scenario[:, HEADING])
        mean[:, 0], mean[:, 1] = -scenario[:, OFFSET] * sin, scenario[:, OFFSET] * cos
        mean[:, 2], mean[:, 3] = scenario[:, HEADING] + scenario[:, ERROR], self.ship.speed
        return self._spread.about(mean)

    # --- where the ship is ------------------------------------------------------------------------

    @compiled(axes=(1, 1))
    def _nearest(self, scenario: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Position ``(..., 6)`` relative to the axis of states ``(..., n)``, see `locate`."""
        ahead = np.array([0.5, 1.5]) * self.preview * self.ship.speed  # to average curvatures
        return locate(state, NEAREST, scenario[..., self._first_segment :], ahead)

    @compiled(axes=(1, 0, 1))
    def reference(self, scenario: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Reference ``(..., 8)`` for a ship in a state ``(..., n)``."""
        place = self._nearest(scenario, state)
        along, off, direction, soon, later = (place[..., i] for i in range(5))
        rate = self.turning(soon)
        heading, surge = self.steady_course(rate, direction)
        own = [heading, rate, self.turning(later), along, off, direction, surge, state[..., 2]]
        return np.stack(own, -1)

    def workspace(self, scenario: np.ndarray) -> Workspace:
        """The ship, the axis, and the channel's outline half a beam outside the margins."""
        along = np.linspace(0.0, scenario[LENGTH], 200)
        segments = np.tile(scenario[self._first_segment :], (len(along), 1))
        x, y, direction = pose_along(along, segments)
        half = self.margin + 0.5 * self.ship.beam
        starboard = half * np.stack([-np.sin(direction), np.cos(direction)], -1)
        axis = np.stack([x, y], -1)
        edges = np.concatenate([axis + starboard, (axis - starboard)[::-1]])
        return Workspace("ship", self.ship.length, at_depth(axis), at_depth(edges))

    def on_track(self, scenario: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances along and to starboard of the axes [m], of states ``(T, B, n)``."""
        place = self._nearest(scenario, state)
        return place[..., 0], place[..., 1]

    def observe_mission(
        self, scenario: np.ndarray, step: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        """Rudder, then waypoints ahead and to starboard in ten ship lengths ``(..., k)``."""
        columns = range(_POINTS, self._first_segment, 2)
        points = [in_frame(scenario, scenario[..., i : i + 2]) for i in columns]
        scale = 10.0 * self.ship.length
        return np.concatenate(
            [actuators / self.ship.rudder_limit, *(each / scale for each in points)], -1
        )

    # --- how it is scored -------------------------------------------------------------------------

    COURSE_TOLERANCE = 0.05  # rad between course over ground and axis that halve its share
    DISTANCE_TOLERANCE = 0.25  # share of the margin off the axis that halves the reward

    score_states = 3
    """Farthest distance along the channel so far, rudder and its rate."""

    @compiled(axes=SCORE_AXES)
    def score(
        self, state: np.ndarray, exogenous: np.ndarray, scenario: np.ndarray,
        reference: np.ndarray, over: np.ndarray, actuators: np.ndarray, action: np.ndarray,
        score_state: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Reward ``(...)``, end ``(...)`` and score state ``(..., 3)``, from the truth.

        The reward is the share of the channel that a step is the first to cover, times factors for
        the distance from the axis, the course over ground and the steering. The score is at most 1,
        and neither loitering nor ending early pays.
        """
        farthest = score_state[..., 0]
        place = self._nearest(scenario, state)
        along, off, direction = (place[..., i] for i in range(3))
        aside = self.course_error(state, exogenous, direction)
        length, aground = scenario[..., LENGTH], np.abs(off) > self.margin
        covered = np.maximum(farthest, np.minimum(along, length))
        value = 0.7 + 0.3 * closeness(aside, self.COURSE_TOLERANCE)
        value = value * closeness(off, self.DISTANCE_TOLERANCE * self.margin)
        smooth, steered = self.smooth(actuators, score_state[..., 1:])
        reward = np.where(aground, 0.0, value * smooth * (covered - farthest) / length)
        end = first_reason(aground, along >= length)
        return reward, end, np.concatenate([np.stack([covered], -1), steered], -1)
