"""Hold a turning circle over ground: a straight, a clothoid and rounds."""

from typing import Any

import numpy as np

from estimators.angles import ahead_and_aside
from estimators.checks import as_number, short_repr
from estimators.engine import compiled, sincos
from vessel_gym.checks import one_of
from vessel_gym.tasks.task import SCORE_AXES, Workspace, at_depth, closeness, first_reason, wrapped
from vessel_gym.tasks.track import HEADING, Track
from vessel_gym.vehicles.corvette import steady_turns

RATE, CURVATURE, SPEED = range(HEADING + 1, 4)
"""Columns of a scenario after the first direction."""
_ABSURD = 1e9  # m: the square of a diverged position stays finite


def _clothoid(length: np.ndarray, sharpness: np.ndarray) -> tuple[np.ndarray, ...]:
    """Position and direction on a clothoid, whose curvature is ``sharpness`` [1/m2] times length.

    Series of the Fresnel integrals, with errors of 1e-5 of the length for turns up to 0.6 rad.
    """
    angle = 0.5 * sharpness * length * length
    square = angle * angle
    ahead = 1.0 - square * (1.0 / 10.0 - square * (1.0 / 216.0 - 1.0 / 9360.0 * square))
    aside = angle * (1.0 / 3.0 - square * (1.0 / 42.0 - 1.0 / 1320.0 * square))
    return length * ahead, length * aside, angle


@compiled
class CircleTrack(Track):
    """The commanded track leads into a circle over ground: a straight, a clothoid, rounds.

    The track begins at the ship's start. A scenario (the episode's parameters, drawn at reset) is
    ``(initial heading [rad], yaw rate of the turn [rad/s], its curvature [1/m], its speed [m/s])``.
    A reference belongs to the track's point nearest to the estimated position. It is ``(heading to
    steer in still water [rad], yaw rate now, yaw rate PREVIEW seconds ahead, final yaw rate
    [rad/s], distance to starboard of the track [m], its direction [rad], surge of the steady turn
    [m/s], estimated heading [rad])``.
    """

    radius = 3.0, 6.0  # radius of the circle in ship lengths, either side
    tightest = 2.5  # ship lengths, least radius of an option: nearly full rudder

    uniforms = 3
    """Number of uniform random numbers that `scenario` needs."""
    end_reasons = ("", "turn lost")
    WIDEST = 1e5  # m, largest radius of an option; a larger number is an error of the unit

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Draw scenarios ``(B, 4)`` from uniforms ``(B, 3)``.

        Args:
            uniforms: Random numbers for the initial heading, the radius and the side.
            options: ``{"radius": r}`` sets the radius of the circle [m], positive to starboard.

        Raises:
            ValueError: for an unknown option or a radius that the ship cannot hold.
        """
        radius = np.nan
        for option, value in options.items():
            one_of("reset option", option, ("radius",))
            low, radius = self.tightest * self.ship.length, as_number(value)
            if not low <= abs(radius) <= self.WIDEST:
                raise ValueError(
                    f"radius must be {low:.0f} to {self.WIDEST:.0f} m to either side, got"
                    f" {short_repr(value)}"
                )
        return self._drawn(uniforms, np.full(len(uniforms), radius))

    @compiled(axes=(1, 0))
    def _drawn(self, uniforms: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Scenarios ``(..., 4)`` with a signed radius [m], which is drawn where it is NaN."""
        shortest, longest = self.radius
        drawn = self.ship.length * (shortest + (longest - shortest) * uniforms[..., 1])
        drawn = np.copysign(drawn, uniforms[..., 2] - 0.5)
        most = 1.0 / steady_turns(self.ship).radius[-1]
        curvature = np.clip(1.0 / np.where(np.isnan(radius), drawn, radius), -most, most)
        heading, rate = np.pi * (1.0 - 2.0 * uniforms[..., 0]), self.turning(curvature)
        return np.stack([heading, rate, curvature, rate / curvature], -1)

    @property
    def lead(self) -> float:
        """Time [s] before the turn begins."""
        return 5.0 * self.pace

    @property
    def ramp(self) -> float:
        """Time [s] in which the yaw rate rises to its final value."""
        return 25.0 * self.pace

    @compiled(axes=(1, 0, 1))
    def reference(self, scenario: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Reference ``(..., 8)`` at a step ``(...)`` for a ship in a state ``(..., n)``."""
        rate, curvature = scenario[..., RATE], scenario[..., CURVATURE]
        slower = scenario[..., SPEED] - self.ship.speed
        lead, ramp = self._lengths(scenario)
        along, off, direction, bent = self._nearest(
            scenario, state, self.nominal_distance(scenario, step)
        )
        share = bent / curvature
        speed = self.ship.speed + share * slower
        share_ahead = np.clip((along + self.preview * speed - lead) / ramp, 0.0, 1.0)
        rate_now = bent * speed
        rate_ahead = share_ahead * curvature * (self.ship.speed + share_ahead * slower)
        heading, surge = self.steady_course(rate_now, direction)
        own = heading, rate_now, rate_ahead, rate, off, direction, surge, state[..., 2]
        return np.stack(own, -1)

    def _lengths(self, scenario: np.ndarray) -> tuple[float, np.ndarray]:
        """Lengths [m] of the straight and of the clothoid."""
        return self.lead * self.ship.speed, 0.5 * self.ramp * (
            self.ship.speed + scenario[..., SPEED]
        )

    def nominal_distance(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Distance [m] along the track of a ship that keeps to track and speed.

        The speed falls over the ramp.
        """
        elapsed = np.maximum(step * self.dt, 0.0)
        ramping = np.clip(elapsed - self.lead, 0.0, self.ramp)
        circling = np.maximum(elapsed - self.lead - self.ramp, 0.0)
        turning = 0.5 * ramping * ramping / self.ramp + circling
        return elapsed * self.ship.speed + (scenario[..., SPEED] - self.ship.speed) * turning

    @compiled(axes=(1, 1, 0))
    def _nearest(
        self, scenario: np.ndarray, state: np.ndarray, guess: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Point of the track nearest to a ship in a state ``(..., n)``.

        Args:
            scenario: ``(..., 4)``.
            state: ``(..., n)``, from the position north and east of the track's beginning [m].
            guess: Approximate distance along the track [m], which selects among rounds and the
                approach.

        Returns:
            Distance along the track [m], distance of the place to starboard of the track [m],
            direction [rad] and curvature [1/m] of the track.
        """
        heading, curvature = scenario[..., HEADING], scenario[..., CURVATURE]
        lead, ramp = self._lengths(scenario)
        radius, sharpness = 1.0 / curvature, curvature / ramp
        north, east = (np.clip(state[..., i], -_ABSURD, _ABSURD) for i in range(2))
        ahead, aside = ahead_and_aside(north, east, heading)
        # The circle: among the rounds, take the nearest point that is closest to the guess.
        forward, sideways, turned = _clothoid(ramp, sharpness)
        sin, cos = sincos(turned)
        # x and y relative to the circle's centre
        x, y = ahead - (lead + forward - radius * sin), aside - (sideways + radius * cos)
        expected = turned + curvature * (guess - (lead + ramp))
        round_to = expected + wrapped(np.arctan2(x * curvature, -y * curvature) - expected)
        along = lead + ramp + radius * (round_to - turned)
        on_circle, off_circle = along >= lead + ramp, np.abs(radius) - np.sqrt(x**2 + y**2)
        # The clothoid by Newton's method; before its beginning the length stays at 0, where the
        # clothoid continues the straight.
        length = np.clip(ahead - lead, 0.0, ramp)
        for _ in range(4):
            forward, sideways, direction = _clothoid(length, sharpness)
            missing, off = ahead_and_aside(ahead - lead - forward, aside - sideways, direction)
            slope = np.maximum(1.0 - off * sharpness * length, 0.2)
            length = np.clip(length + missing / slope, 0.0, ramp)
        return (
            np.where(on_circle, along, np.where(ahead <= lead, ahead, lead + length)),
            np.where(on_circle, np.sign(curvature) * off_circle, off),
            heading + np.where(on_circle, round_to, direction),
            np.where(on_circle, curvature, sharpness * length),
        )

    @compiled(axes=(1, 0))
    def track(self, scenario: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Positions [m] and directions [rad] ``(..., 3)`` at distances ``along (...)`` [m]."""
        curvature = scenario[..., CURVATURE]
        lead, ramp = self._lengths(scenario)
        length = np.clip(along - lead, 0.0, ramp)
        forward, sideways, turned = _clothoid(length, curvature / ramp)
        direction = turned + np.maximum(along - lead - ramp, 0.0) * curvature
        sin, cos = sincos(turned)
        sin_after, cos_after = sincos(direction)
        forward = forward + np.minimum(along, lead) + (sin_after - sin) / curvature
        sideways = sideways + (cos - cos_after) / curvature
        heading = scenario[..., HEADING]
        x, y = ahead_and_aside(forward, sideways, -heading)
        return np.stack([x, y, heading + direction], -1)

    def on_track(self, scenario: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances along and to starboard of the tracks [m], of states ``(T, B, n)``."""
        found, along = [], np.zeros(len(scenario))
        for now in state:
            along, off, _, _ = self._nearest(scenario, now, along)
            found.append((along, off))
        each, off_track = np.swapaxes(found, 0, 1)
        return each, off_track

    def workspace(self, scenario: np.ndarray) -> Workspace:
        """The ship and its track, one circle long."""
        lead = self.ship.speed * (self.lead + self.ramp)
        along = np.linspace(0.0, lead + 2.0 * np.pi / abs(scenario[CURVATURE]), 200)
        poses = self.track(np.tile(scenario, (len(along), 1)), along)
        return Workspace("ship", self.ship.length, at_depth(poses[:, :2]))

    # --- what the agent sees ----------------------------------------------------------------------

    def observe_mission(
        self, scenario: np.ndarray, step: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        """Rudder and yaw rate of the turn ``(..., 2)``."""
        return np.concatenate([actuators, scenario[..., [RATE]]], -1) / self._known_scales[:2]

    # --- how it is scored -------------------------------------------------------------------------

    RATE_TOLERANCE = 0.15  # relative error that halves the yaw rate's share
    DISTANCE_TOLERANCE = 10.0  # m from the track that halve the reward
    COURSE_TOLERANCE = 0.05  # rad between course over ground and track that halve its share
    COURSE_SHARE = 0.6  # share of the course in the factor of course and yaw rate
    FAR = 3.0  # ship lengths from the track at which the turn is lost
    ENOUGH = 0.85  # share of the nominal progress that earns the full reward

    score_states = 4
    """Distance along the track and farthest one [m], rudder and its rate."""

    @compiled(axes=SCORE_AXES)
    def score(
        self, state: np.ndarray, exogenous: np.ndarray, scenario: np.ndarray,
        reference: np.ndarray, over: np.ndarray, actuators: np.ndarray, action: np.ndarray,
        score_state: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Reward in [0, 1] ``(...)``, end ``(...)`` and score state ``(..., 4)``, from the truth.

        The reward has four factors: distance from the track, motion, steering, and progress along
        the track. The factor of motion is six tenths for the course over ground and four tenths for
        the yaw rate. Neither loitering nor ending early pays.
        """
        before, farthest = score_state[..., 0], score_state[..., 1]
        u, v, r = (state[..., i] for i in range(3, 6))
        along, off, direction, bent = self._nearest(scenario, state, before)
        aside = self.course_error(state, exogenous, direction)
        turning = (r - bent * np.sqrt(u * u + v * v)) / scenario[..., RATE]
        speed = self.ship.speed + bent / scenario[..., CURVATURE] * (
            scenario[..., SPEED] - self.ship.speed
        )
        fresh = np.maximum(along - farthest, 0.0)
        progress = np.minimum(fresh / (self.ENOUGH * (self.dt * speed)), 1.0)
        value = self.COURSE_SHARE * closeness(aside, self.COURSE_TOLERANCE)
        value = value + (1.0 - self.COURSE_SHARE) * closeness(turning, self.RATE_TOLERANCE)
        smooth, steered = self.smooth(actuators, score_state[..., 2:])
        reward = value * closeness(off, self.DISTANCE_TOLERANCE) * smooth * progress
        place = np.stack([along, np.maximum(farthest, along)], -1)
        end = first_reason(np.abs(off) > self.FAR * self.ship.length)
        return reward, end, np.concatenate([place, steered], -1)
