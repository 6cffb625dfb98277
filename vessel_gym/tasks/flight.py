"""Fly a planned path round obstacles to a goal, at a commanded altitude and airspeed."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators import Gaussian
from estimators.angles import ahead_and_aside
from estimators.checks import integer, number, short_repr
from estimators.engine import compiled
from vessel_gym.checks import check_numbers, check_pair, instance, one_of
from vessel_gym.guidance.dubins import COLUMNS, Path, path_of
from vessel_gym.guidance.path_following import ANYWHERE, LEAD, end_pose, locate, padded
from vessel_gym.guidance.planner import checked_obstacles, plan
from vessel_gym.guidance.scenes import scene
from vessel_gym.system import Estimate
from vessel_gym.tasks.task import (
    FARTHEST,
    SCORE_AXES,
    Task,
    Workspace,
    at_depth,
    closeness,
    first_reason,
    smoothness,
    three_numbers,
)
from vessel_gym.vehicles.puna import PunaParameters, airspeed

SEGMENTS = 16
"""Largest number of arcs and straights in a path."""
OBSTACLES = 5
"""Largest number of obstacles."""
LENGTH = COLUMNS * SEGMENTS
ALTITUDE = LENGTH + 1
"""Columns of a scenario with the length of the path and the commanded altitude [m]."""
_MISSION_GAINS = 1.0 / np.concatenate([
    np.tile([100.0, 100.0, 3.0, 0.01, 100.0], SEGMENTS), [100.0],
    np.tile([100.0, 100.0, 50.0], OBSTACLES),
])  # fmt: skip
"""Factors of path, altitude and obstacles in observations."""
_SIMILAR = 0.5  # rad between headings of a path that are hard to tell apart
_SPACING = 5.0  # m between the places of a path that are compared
_ALTITUDES = np.nextafter(50.0, 0.0), np.nextafter(1000.0, 2000.0)  # m, both left out
_SPAN = 2.1  # m, wing span of the Skywalker X8, Gryte (2018), because a point mass has none
_OPTIONS = ("start", "goal", "obstacles", "altitude", "radius")


@compiled
@dataclass(frozen=True)
class Flight(Task):
    """Flight along a Dubins path round obstacles; the state is `vehicles.puna.STATE`.

    A scenario ``(97,)`` (the episode's parameters, drawn at reset) has 16 segments of the path (x,
    y, heading, curvature, length; padded by segments of length 0), the length of the path, the
    commanded altitude, and 5 obstacles (x, y, radius; radius 0: none). A reference ``(6,)`` is
    the estimated position on the path: progress, cross-track and altitude error [m], heading of the
    path there, and mean curvatures of the path ahead (over the next 20 m, and from 20 to 60 m).

    The flight ends when the estimated position has covered the path; if no estimate is observed,
    the true position replaces the estimate (see `vessel_gym.simulation.core.Core`).
    """

    body: PunaParameters
    radius: float = 130.0  # m, of turns of the path: 26 deg of bank of 35 in a tail wind of 5 m/s
    distance: tuple[float, float] = (600.0, 900.0)  # m from start to goal
    obstacle_radius: tuple[float, float] = (30.0, 60.0)  # m
    ahead: tuple[float, float] = (20.0, 60.0)  # m, look-ahead; in the first, the bank can follow
    horizon: int = 900  # steps

    altitudes = 80.0, 120.0  # m, commanded
    dt = 0.1  # s

    def __post_init__(self) -> None:
        instance("body of Flight", self.body, PunaParameters)
        integer("horizon of Flight", self.horizon, 1)
        check_numbers(self, positive="radius")
        for name in ("distance", "obstacle_radius", "ahead"):
            check_pair(f"{name} of Flight", getattr(self, name))

    prior_sd = (1.0, 1.0, 1.0, 0.5, 0.5, 0.3, 0.02)
    uniforms = 14
    """Number of uniform random numbers that `scenario` needs."""
    end_reasons = (
        "", "hit an obstacle", "crashed", "arrived", "missed the goal", "stalled", "off the path",
        "off the altitude",
    )  # fmt: skip
    success = "arrived"
    perfect = 1.0
    """A perfect episode has the score 1."""

    # --- what is drawn ----------------------------------------------------------------------------

    @property
    def margin(self) -> float:
        """Distance [m] of the path from obstacles; 20 m for the PUNA."""
        return self.radius / 6.5

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Draw scenarios ``(B, 97)`` from uniforms ``(B, 14)``.

        The start is the origin, on any heading. The goal lies within 90 deg of that heading, and
        its heading within 90 deg of the direct way. One of three obstacles is in the way of the
        shortest path, and the path leads round it; the others lie beside the path.

        Args:
            uniforms: Random numbers for the poses, the altitude and the obstacles.
            options: ``{"start": (x, y, heading), "goal": (x, y, heading), "obstacles": [(x, y,
                radius), ...]}`` give a scene, in which a path is planned. Without one of these, the
                start is (0, 0, 0), the goal (750, 0, 0), and there are no obstacles.
                ``{"altitude": h}`` replaces the random altitude. ``{"radius": 100.0}`` sets the
                radius of the path's turns [m], 100 in the paper.

        Raises:
            ValueError: for an unknown option, a value out of range, poses that no path joins, or
                given poses whose path comes back to where it was on the same heading.
        """
        for option in options:
            one_of("reset option", option, _OPTIONS)
        given, radius = {"start", "goal", "obstacles"} & set(options), self.radius
        if "radius" in options:
            # drawn scenes are made for turns about as wide as the task's own
            low, high = (0.5 * radius, 5.0 * radius) if given else (0.74 * radius, 1.01 * radius)
            what = f"between {low:.0f} and {high:.0f} m"
            radius = number("radius", options["radius"], low, high, what)
        if given:
            scenarios = np.tile(self._planned(options, radius), (len(uniforms), 1))
        else:
            scenarios = self._drawn(uniforms, np.array(radius))
        low, high = self.altitudes
        scenarios[:, ALTITUDE] = low + (high - low) * uniforms[:, 13]
        if "altitude" in options:
            scenarios[:, ALTITUDE] = number(
                "altitude", options["altitude"], *_ALTITUDES, "between 50 and 1000 m"
            )
        return scenarios

    @compiled(axes=(1, 0))
    def _drawn(self, uniforms: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Scenarios ``(..., 97)`` without altitudes, whose paths have turns of a radius [m]."""
        heading, bearing, distance, turned = (uniforms[..., i] for i in range(4))
        along, across, size = (uniforms[..., i:13:3] for i in (4, 5, 6))
        nowhere, (near, far), (low, high) = 0.0 * heading, self.distance, self.obstacle_radius
        start = np.stack([nowhere, nowhere, np.pi * (2.0 * heading - 1.0)], -1)
        bearing = start[..., 2] + np.pi * (bearing - 0.5)
        distance = near + (far - near) * distance
        north, east = distance * np.cos(bearing), distance * np.sin(bearing)
        goal = np.stack([north, east, bearing + np.pi * (turned - 0.5)], -1)
        radius = low + (high - low) * size
        across = 2.0 * across - 1.0
        return _listed(*scene(start, goal, turn, along, across, radius, np.array(self.margin)))

    def _planned(self, options: dict[str, Any], radius: float) -> np.ndarray:
        """Scenario ``(97,)`` without an altitude, from given poses and obstacles."""
        poses = {"start": (0.0, 0.0, 0.0), "goal": (750.0, 0.0, 0.0)}
        start, goal = (
            three_numbers(name, options.get(name, pose), "metres x and y and rad")
            for name, pose in poses.items()
        )
        value = options.get("obstacles", ())
        obstacles = checked_obstacles(value)
        if len(obstacles) > OBSTACLES:
            raise ValueError(f"there may be {OBSTACLES} obstacles at most, got {len(obstacles)}")
        if np.abs(obstacles).max(initial=0.0) > FARTHEST:
            raise ValueError(
                f"obstacles must lie within {FARTHEST:.0f} m of the origin, got {short_repr(value)}"
            )
        path = plan(start, goal, radius, obstacles, self.margin)
        if len(path.segments) > SEGMENTS:
            raise ValueError(
                f"the path has {len(path.segments)} pieces, more than {SEGMENTS}: leave out"
                " obstacles"
            )
        longest = 0.8 * self.horizon * self.dt * self.body.cruise_speed
        if not radius <= path.length <= longest:
            wanted = f"{radius:.0f} to {longest:.0f} m long, got {path.length:.0f} m"
            raise ValueError(f"the path to the goal must be {wanted}")
        if _comes_back(path, radius):
            raise ValueError(
                "the path comes back to where it was on the same heading: move the start or the"
                " goal"
            )
        return _listed(path.segments, obstacles)

    def prior(self, scenario: np.ndarray) -> Gaussian:
        """Prior at the beginning of the path, level at cruise speed: mean ``(B, 7)``, covariance.

        The aircraft moves along the path through the air; an unknown wind carries it.
        """
        mean = np.zeros((len(scenario), 7))
        mean[:, :2], mean[:, 2] = scenario[:, :2], scenario[:, ALTITUDE]
        mean[:, 3] = self.body.cruise_speed * np.cos(scenario[:, 2])
        mean[:, 4] = self.body.cruise_speed * np.sin(scenario[:, 2])
        return self._spread.about(mean)

    @compiled(axes=(1, 0, 1))
    def reference(self, scenario: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Position ``(..., 6)`` relative to the path, for states ``(..., n)``."""
        pose = np.stack(
            [state[..., 0], state[..., 1], np.arctan2(state[..., 4], state[..., 3])], -1
        )
        place = locate(pose, ANYWHERE, scenario[..., :LENGTH], np.array(self.ahead))
        above = state[..., 2:3] - scenario[..., ALTITUDE, None]
        return np.concatenate([place[..., :2], above, place[..., 2:5]], -1)

    # --- what the agent sees ----------------------------------------------------------------------

    observed = {
        "cross-track": 10.0, "altitude error": 5.0, "course sine": 0.5, "course cosine": 1.0,
        "curvature": 0.01, "curvature later": 0.01, "bank of the path": 0.5,
        "ground speed error": 5.0, "airspeed error": 2.0, "climb": 1.0, "wind down": 1.0,
        "bank": 0.5, "obstacles ahead": 1.0, "obstacles to starboard": 1.0, "remaining": 500.0,
    }  # fmt: skip
    state_offset = (0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 0.0)
    state_scale = (100.0, 100.0, 20.0, 20.0, 20.0, 1.0, 0.5)
    flow_scale = 5.0
    std_scale = (1.0,) * 3 + (0.2,) * 3 + (0.02,)

    def observe(
        self, estimate: Estimate, scenario: np.ndarray, reference: np.ndarray,
        actuators: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Observation ``(..., 18)`` of mode ``"mean"``: errors, estimates, actuators."""
        north, east, climb, bank = (estimate.state[..., i] for i in range(3, 7))
        wind_north, wind_east, wind_down = (estimate.flow[..., i] for i in range(3))
        progress, cross, above, heading = (reference[..., i] for i in range(4))
        curvature, later = reference[..., 4], reference[..., 5]
        ground, course = np.hypot(north, east), np.arctan2(east, north)
        through_north, through_east = north - wind_north, east - wind_east
        # Lift turns the velocity through the air; over ground its share across the course counts.
        across = np.maximum(np.cos(course - np.arctan2(through_east, through_north)), 0.5)
        turning = ground * np.minimum(ground, 1e3) * curvature
        through_air, cruise = airspeed(estimate.state, estimate.flow), self.body.cruise_speed
        path_bank = np.arctan(turning / self.body.gravity / across)
        seen = [
            cross, above, np.sin(heading - course), np.cos(heading - course), curvature, later,
            path_bank, ground - cruise, through_air - cruise, climb, wind_down, bank,
            *_obstacles_near(estimate.state, scenario), scenario[..., LENGTH] - progress,
        ]  # fmt: skip
        scaled = np.stack(seen, -1) / np.array([*self.observed.values()])
        return np.concatenate([scaled, self.body.actions(actuators)], -1)

    def observe_mission(
        self, scenario: np.ndarray, step: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        """Path, altitude, obstacles and actuators ``(..., 99)``."""
        mission = np.concatenate([scenario[..., :LENGTH], scenario[..., ALTITUDE:]], -1)
        return np.concatenate([mission * _MISSION_GAINS, self.body.actions(actuators)], -1)

    # --- how it is scored -------------------------------------------------------------------------

    TRACKING = 0.7  # share of the score for following the path; the rest is for arriving
    TRACK_TOLERANCE = 3.0  # m off the path in plan that halve the reward of a metre
    ALTITUDE_TOLERANCE = 1.5  # m off the commanded altitude that halve the reward of a metre
    BERTH = 10.0  # m from an obstacle within which the reward of a metre falls to 0
    GOAL_TOLERANCE = 8.0  # m off the goal in plan, still arrived, that halve its reward
    LOST = 100.0  # m off the path in plan at which the episode ends
    HEIGHT_LOST = 40.0  # m off the commanded altitude at which the episode ends
    STALL = 10.0  # m/s of airspeed: level flight takes 9
    FASTEST = 2.0  # largest progress that counts, relative to cruise speed
    WINDOW = 50.0  # m of path about the farthest progress in which the nearest point is sought

    @compiled
    def initial_score_state(self, state: np.ndarray, scenario: np.ndarray) -> np.ndarray:
        """Farthest progress [m], last commands and their changes ``(..., 7)``."""
        zero = np.zeros_like(state[..., 0])
        progress = np.maximum(self.track(state, scenario, zero)[..., 0], 0.0)
        return np.stack([progress, *(zero,) * 6], -1)

    @compiled(axes=SCORE_AXES)
    def score(
        self, state: np.ndarray, exogenous: np.ndarray, scenario: np.ndarray,
        reference: np.ndarray, over: np.ndarray, actuators: np.ndarray, action: np.ndarray,
        score_state: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Reward in [0, 1] ``(...)``, end ``(...)`` and score state ``(..., 7)``, from the truth.

        Every metre of the path pays once, when it is first covered. The pay rises with the
        closeness to path and altitude, the smoothness of commands and the distance from obstacles;
        waiting, circling and short cuts pay nothing. Arriving pays by the distance to the goal and
        the covered share of the path.
        """
        farthest = score_state[..., 0]
        x, y, altitude = (state[..., i] for i in range(3))
        length, above = scenario[..., LENGTH], altitude - scenario[..., ALTITUDE]
        place, clearance = self.track(state, scenario, farthest), self.clearance(state, scenario)
        off, most = place[..., 5], self.FASTEST * self.body.cruise_speed * self.dt
        fresh = np.clip(np.minimum(place[..., 0], length) - farthest, 0.0, most)
        berth = np.clip(clearance / self.BERTH, 0.0, 1.0)
        smooth, commands = smoothness(action, score_state[..., 1:], 2.0)  # of a range from -1 to 1
        quality = smooth * berth
        near = closeness(off, self.TRACK_TOLERANCE) * closeness(above, self.ALTITUDE_TOLERANCE)
        tracking = self.TRACKING * fresh / length * quality * near

        goal = self.goal(scenario)
        miss = np.hypot(x - goal[..., 0], y - goal[..., 1])
        covered = np.minimum((farthest + fresh + self.GOAL_TOLERANCE) / length, 1.0)
        arriving = (1.0 - self.TRACKING) * covered * closeness(miss, self.GOAL_TOLERANCE)
        crashed, hit = altitude <= 0.0, clearance < 0.0
        reward = np.where(hit | crashed, 0.0, tracking + np.where(over, arriving, 0.0))

        end = first_reason(
            hit, crashed, over & (miss <= self.GOAL_TOLERANCE), over,
            airspeed(state, exogenous[..., 4:]) < self.STALL, off > self.LOST,
            np.abs(above) > self.HEIGHT_LOST,
        )  # fmt: skip
        return reward, end, np.concatenate([np.stack([farthest + fresh], -1), commands], -1)

    @compiled(axes=(1, 1, 0))
    def track(self, state: np.ndarray, scenario: np.ndarray, farthest: np.ndarray) -> np.ndarray:
        """Positions of states ``(..., n)`` on the path, near the farthest progress [m]."""
        zero = np.zeros_like(farthest)
        window = np.stack([farthest - self.WINDOW, farthest + self.WINDOW, zero], -1)
        return locate(state, window, scenario[..., :LENGTH], np.array(self.ahead))

    def over(self, scenario: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Has the position covered the path ``(...)``?"""
        return reference[..., 0] >= scenario[..., LENGTH]

    @compiled
    def clearance(self, state: np.ndarray, scenario: np.ndarray) -> np.ndarray:
        """Distance [m] of states ``(..., n)`` from the nearest obstacle; infinite without one."""
        radius, north, east = _obstacles_from(state, scenario)
        return np.where(radius > 0.0, np.hypot(north, east) - radius, np.inf).min(-1)

    @compiled
    def goal(self, scenario: np.ndarray) -> np.ndarray:
        """End of the path ``(..., 3)``: x, y [m], heading [rad]."""
        return np.stack(end_pose(scenario[..., :LENGTH]), -1)

    def workspace(self, scenario: np.ndarray) -> Workspace:
        """The aircraft, its path, the obstacles and the goal, at the commanded altitude."""
        down, path = -scenario[ALTITUDE], path_of(scenario[:LENGTH].reshape(-1, COLUMNS))
        north, east, _ = self.goal(scenario)
        obstacles = scenario[-3 * OBSTACLES :].reshape(-1, 3)
        return Workspace(
            "aircraft", _SPAN, at_depth(path.sample(3.0)[:, :2], down),
            goal=(north, east, down, self.GOAL_TOLERANCE),
            obstacles=obstacles[obstacles[:, 2] > 0.0],
        )  # fmt: skip


def _comes_back(path: Path, radius: float) -> bool:
    """Does the path come near an earlier place on a similar heading?

    Places count as different if a quarter of a circle or more lies between them, and as near
    within the straight that prolongs the path.
    """
    x, y, heading = path.sample(_SPACING).T
    i, j = np.nonzero((x[:, None] - x) ** 2 + (y[:, None] - y) ** 2 <= LEAD**2)
    later = (j - i) * _SPACING > 0.5 * np.pi * radius
    return bool((np.cos(heading[j[later]] - heading[i[later]]) > np.cos(_SIMILAR)).any())


def _listed(path: np.ndarray, obstacles: np.ndarray) -> np.ndarray:
    """Scenarios without altitudes of segments ``(..., k, 5)`` and obstacles ``(..., m, 3)``."""
    length = path[..., 4].cumsum(-1)[..., -1]
    figures = np.stack([length, 0.0 * length], -1)
    return np.concatenate([padded(path, SEGMENTS), figures, padded(obstacles, OBSTACLES)], -1)


def _obstacles_from(state: np.ndarray, scenario: np.ndarray) -> tuple[np.ndarray, ...]:
    """Radii of the obstacles, and vectors north and east from states to them, ``(..., 5)`` each."""
    x, y, radius = (scenario[..., i::3] for i in range(-3 * OBSTACLES, 3 - 3 * OBSTACLES))
    return radius, x - state[..., :1], y - state[..., 1:2]


def _obstacles_near(state: np.ndarray, scenario: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums of vectors to obstacles, ahead and to starboard.

    A vector is the longer the nearer the obstacle's edge is, and 0 beyond 100 m.
    """
    radius, north, east = _obstacles_from(state, scenario)
    course = np.arctan2(state[..., 4:5], state[..., 3:4])
    distance = np.hypot(north, east)
    near = np.clip(1.0 - (distance - radius) / 100.0, 0.0, 2.0) / np.maximum(distance, 1e-9)
    near = np.where(radius > 0.0, near, 0.0)
    ahead, aside = ahead_and_aside(north, east, course)
    return (near * ahead).sum(-1), (near * aside).sum(-1)
