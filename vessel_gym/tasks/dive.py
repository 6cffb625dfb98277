"""Dive along a smooth path to a goal, and say when you are there."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators import Gaussian
from estimators.checks import finite_array, shown, whole, writable
from estimators.compiled import inlined, part, rowwise
from vessel_gym.checks import check_numbers, instance, one_of
from vessel_gym.guidance import dive_path
from vessel_gym.guidance.dive_path import course_to
from vessel_gym.system import Estimate
from vessel_gym.tasks.task import Task, three_numbers
from vessel_gym.vehicles.auv import AUVParameters

ENDS = ("", "arrived", "missed the goal", "off the path", "surfaced", "too deep", "pitched over")
_ARRIVED, _MISSED, _OFF, _SURFACED, _DEEP, _PITCHED = range(1, len(ENDS))


_on_path: Any = part(dive_path._follow.__wrapped__)


@inlined
def _position(state: np.ndarray, row: int, where: np.ndarray, position: np.ndarray) -> None:
    """North, east and down out of a row's state, which has them at ``where``; -1: it is 0."""
    for i in range(3):
        position[i] = state[row, where[i]] if where[i] >= 0 else 0.0


@rowwise("void(f8[:,:],i8[::1],f8[:,:],f8,f8[:,::1])")
def dive_reference(state: np.ndarray, where: np.ndarray, course: np.ndarray, ahead: float, out: np.ndarray) -> None:
    """Where on their paths vehicles in these states are ``(B, 11)``."""
    position = np.empty(3)
    for row in range(len(out)):
        _position(state, row, where, position)
        _on_path(position, course[row], ahead, out[row, :8], out[row, :8])
        for i in range(3):
            out[row, 8 + i] = course[row, i]


@inlined
def _scaled(first: int, actuators: np.ndarray, gains: np.ndarray, seen: np.ndarray) -> None:
    """Put the actuators behind the ``first`` numbers that are seen of a dive, and scale all of them."""
    for i in range(len(actuators)):
        seen[first + i] = actuators[i]
    for i in range(len(seen)):
        seen[i] = (seen[i] - gains[0, i]) * gains[1, i]


@rowwise("void(f8[:,:],i8[::1],f8[:,:],b1[:],f8[:,:],f8[:,:],f8[::1],f8[::1],i8[::1],f8[:,::1])")
def dive_score(
    state: np.ndarray, where: np.ndarray, reference: np.ndarray, over: np.ndarray, actuators: np.ndarray,
    tally: np.ndarray, figures: np.ndarray, reward: np.ndarray, end: np.ndarray, after: np.ndarray,
) -> None:  # fmt: skip
    """Reward and end ``(B,)`` and the next tally ``(B, 2)``, see `Dive.score`; ``figures`` are `Dive._figures`."""
    tracking, track_tolerance, goal_tolerance, lost, pitch_limit, hotel = figures[:6]
    most, speed, dt, thrust, launch_depth, margin = figures[6:]
    position, true = np.empty(3), np.empty(8)
    for row in range(len(reward)):
        _position(state, row, where, position)
        course = reference[row, 8:]
        length, depth = course[1], course[2]
        _on_path(position, course, 0.0, true, true)
        off = np.hypot(true[1], true[2] / np.sqrt(1.0 + true[4] ** 2))
        farthest = tally[row, 0]
        fresh = min(max(min(true[0], length) - farthest, 0.0), most)
        power = (hotel + (actuators[row, -1] / thrust) ** 1.5) / (hotel + 1.0)
        energy = tally[row, 1] + dt * power
        after[row, 0], after[row, 1] = farthest + fresh, energy
        reward[row] = tracking * fresh / length / (1.0 + (off / track_tolerance) ** 2)
        end[row] = _OFF if off > lost else 0
        if position[2] < -launch_depth:
            end[row] = _SURFACED
        if position[2] > depth + margin:
            end[row] = _DEEP
        if abs(state[row, where[3]]) > pitch_limit:
            end[row] = _PITCHED
        if over[row]:
            x, y, z, _, _ = dive_path._point(length, dive_path._curvature(course[0], length), length, depth)
            miss = np.sqrt((position[0] - x) ** 2 + (position[1] - y) ** 2 + (position[2] - z) ** 2)
            economy = min(np.hypot(length, depth) / speed / energy, 1.0)
            reward[row] += (1.0 - tracking) * economy / (1.0 + (miss / goal_tolerance) ** 2)
            end[row] = _ARRIVED if miss <= goal_tolerance else _MISSED


@dataclass(frozen=True)
class Dive(Task):
    """What all dives share: the path, how it is drawn, and how a dive is scored.

    The path is `vessel_gym.guidance.dive_path`'s. A course (what is drawn at reset) is ``(angle, length, depth)`` of
    the path; a reference is where the vehicle believes to be on it, ``(B, 11)``: progress, cross-track and depth error
    [m], heading and slope of the path there, the vector to the path's point ``ahead`` (north, east, down), and the
    course.
    The dive is over when the vehicle believes to have covered the path, or has covered it where nobody sees what it
    believes (see `vessel_gym.core.Core`).

    `score` and `observe` are compiled: they do not ask other methods, so a subclass that scales or pays otherwise
    writes these two itself.
    """

    auv: AUVParameters
    goal: tuple[float, float, float]  # m north, east and down of the start
    goal_spread: tuple[float, float, float]  # m, half of the interval from which each is drawn
    ahead: float  # m, look-ahead distance
    horizon: int  # steps
    dt: float = 0.1  # s
    launch_depth: float = 2.0  # m of water above the start
    margin: float = 3.0  # m below the goal at which the vehicle is too deep
    tightest: float = 4.0  # vehicle lengths, least radius that may be asked for
    widest: float = 1.5 * np.pi  # rad, widest turn that may be asked for
    steepest: float = np.deg2rad(35.0)  # rad, steepest path that may be asked for

    def __post_init__(self) -> None:
        title = type(self).__name__
        instance(f"auv of {title}", self.auv, AUVParameters)
        for name in ("goal", "goal_spread"):
            finite_array(f"{name} of {title}", getattr(self, name), 3)
        whole(f"horizon of {title}", self.horizon, 1)
        check_numbers(self, positive="ahead dt margin tightest widest steepest", not_negative="launch_depth")
        check_numbers(self, direction="widest", deflection="steepest")

    uniforms = 3
    """Uniform numbers that `course` needs."""
    ends = ENDS
    success = "arrived"
    perfect = 1.0
    """Rewards are shares of the score."""

    # --- what is drawn ----------------------------------------------------------------------------

    def course(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Draw courses ``(B, 3)`` from uniforms ``(B, 3)``.

        Args:
            uniforms: for the goal.
            options: ``{"goal": (x, y, z)}`` sets the goal [m]: north, east and down of the start.

        Raises:
            ValueError: for an unknown option or a goal that the vehicle cannot dive to.
        """
        goal = np.array(self.goal) + np.array(self.goal_spread) * (2.0 * uniforms - 1.0)
        for option, value in options.items():
            one_of("reset option", option, ("goal",))
            goal = np.tile(self._checked(value), (len(uniforms), 1))
        return course_to(goal)

    def _checked(self, value: object) -> np.ndarray:
        """A goal that can be dived to."""
        goal = three_numbers("goal", value, "metres north, east and down", "of the start each way")
        angle, length, depth = course_to(goal) if np.hypot(goal[0], goal[1]) > 0.0 else (0.0, 0.0, goal[2])
        if abs(angle) > self.widest:
            widest, wanted = np.rad2deg([self.widest, abs(angle)])
            raise ValueError(f"the path to the goal may turn through {widest:.0f} deg at most, got {wanted:.0f} deg")
        farthest = 0.8 * self.horizon * self.dt * self.auv.cruise_speed
        least = self.tightest * self.auv.length
        if not least <= length <= farthest:
            raise ValueError(f"the path to the goal must be {least:.1f} to {farthest:.0f} m long, got {length:.1f} m")
        if abs(angle) * least > length:
            radius = length / abs(angle)
            raise ValueError(f"the path to the goal must turn on {least:.1f} m at least, got {radius:.1f} m")
        if not 0.0 <= 1.5 * depth <= length * np.tan(self.steepest):
            deepest = length * np.tan(self.steepest) / 1.5
            raise ValueError(f"the goal must lie 0 to {deepest:.1f} m below the start, got {depth:.1f} m")
        return goal

    def prior(self, course: np.ndarray) -> Gaussian:
        """What is known at the start, level at the path's beginning at cruising speed: mean ``(B, n)``, covariance."""
        mean = np.zeros((len(course), len(self.prior_sd)))
        mean[:, 0] = self.auv.cruise_speed
        return self._spread.about(mean)

    @cached_property
    def _spread(self) -> Gaussian:
        return Gaussian(np.zeros(len(self.prior_sd)), np.diag(self.prior_sd) ** 2)

    def reference(self, course: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Where on the path a vehicle in a state ``(B, n)`` is, ``(B, 11)``."""
        reference = np.empty((len(state), 11))
        dive_reference(writable(state), self.where, course, self.ahead, reference)
        return reference

    # --- what the agent sees ----------------------------------------------------------------------

    observed: ClassVar[dict[str, float]]
    """What an observation of mode ``"mean"`` holds, in order, and the size that counts as 1 [SI]; actuators follow."""

    @cached_property
    def _gains(self) -> np.ndarray:
        """What counts as 0 and one over what counts as 1 of an observation, then of the actuators, ``(2, k)``."""
        fin, thrust = self.auv.fin_limit, 0.5 * self.auv.thrust_limit
        zeros = [self.auv.cruise_speed * (name == "surge error") for name in self.observed]
        sizes = [*self.observed.values(), *(fin,) * (self.actuators - 1), thrust]
        return np.array([[*zeros, *(0.0,) * (self.actuators - 1), thrust], 1.0 / np.array(sizes)])

    def named(self, observations: np.ndarray) -> dict[str, np.ndarray]:
        """What observations ``(B, k)`` of mode ``"mean"`` say, by the names of ``observed``, ``(B,)`` each in SI."""
        return {name: scale * observations[:, i] for i, (name, scale) in enumerate(self.observed.items())}

    def sizes(self, readings: int, states: int) -> dict[str, int]:
        """The lengths of the parts of observations."""
        known = len(self.mission_scale) + self.actuators
        return {
            "guided": len(self.observed) + self.actuators,
            "unguided": len(self.std_scale) + self.flows + known,
            "std": states,
            "readings": 2 * readings,
            "mission": known,
        }

    actuators: ClassVar[int]
    """How many there are: fins, then thrust."""
    flows: ClassVar[int]
    """Components of the current."""
    mission_scale: ClassVar[tuple[float, ...]]
    """Sizes that count as 1 of the last components of a course, which an observation of raw readings holds."""

    def observe_mission(self, course: np.ndarray, step: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        """What is asked, and the actuators: the course and they ``(B, k)``."""
        mission = course[:, -len(self.mission_scale) :] / self.mission_scale
        return np.concatenate([mission, self.scaled(actuators)], -1)

    def observe_state(self, estimate: Estimate, course: np.ndarray) -> np.ndarray:
        """The estimated state and current ``(B, n + f)`` as they are, without guidance."""
        return np.concatenate([estimate.state / self.state_scale, estimate.flow / 0.25], -1)

    where: ClassVar[np.ndarray]
    """Which components of a state are north, east and down [m] and the pitch [rad]; -1: there is none, it is 0."""

    def position(self, state: np.ndarray) -> np.ndarray:
        """North, east and down [m] out of a state, ``(B, 3)``."""
        return np.where(self.where[:3] < 0, 0.0, state[:, self.where[:3]])

    def scaled(self, actuators: np.ndarray) -> np.ndarray:
        """Fins relative to their limit and thrust from -1 (none) to 1 (all)."""
        scaled = actuators / self.auv.fin_limit
        scaled[:, -1] = 2.0 * actuators[:, -1] / self.auv.thrust_limit - 1.0
        return scaled

    # --- how it is scored -------------------------------------------------------------------------

    TRACKING = 0.7  # share of the score that following the path is worth; arriving is worth the rest
    TRACK_TOLERANCE = 0.25  # m off the path that halve what a metre of it is worth
    GOAL_TOLERANCE = 0.5  # m off the goal that still count as arrived, and halve what arriving is worth
    LOST = 5.0  # m off the path at which it is lost
    PITCH_LIMIT = np.deg2rad(75.0)  # rad: Euler angles have their pole at 90 deg
    HOTEL = 2.0  # power of everything but the propeller, relative to the propeller's at cruising speed
    FASTEST = 3.0  # progress that counts, relative to cruising speed

    def course_of(self, reference: np.ndarray) -> np.ndarray:
        """The course ``(..., 3)`` out of references ``(..., 11)``."""
        return reference[..., 8:]

    def over(self, reference: np.ndarray) -> np.ndarray:
        """Whether who is there has covered the path ``(B,)``."""
        return reference[:, 0] >= reference[:, 9]

    def power(self, actuators: np.ndarray) -> np.ndarray:
        """Power ``(...)`` of propeller and hotel load for actuators ``(..., a)``, relative to cruising."""
        propeller = (actuators[..., -1] / self.auv.cruise_thrust) ** 1.5
        return (self.HOTEL + propeller) / (self.HOTEL + 1.0)

    def begin(self, state: np.ndarray, course: np.ndarray) -> np.ndarray:
        """The farthest progress [m] and the energy used [s at cruising power], ``(B, 2)``."""
        tally, place = np.zeros((len(state), 2)), np.empty((len(state), 11))
        dive_reference(writable(state), self.where, course, 0.0, place)
        tally[:, 0] = np.minimum(np.maximum(place[:, 0], 0.0), course[:, 1])
        return tally

    def score(
        self, state: np.ndarray, forcing: np.ndarray, reference: np.ndarray, over: np.ndarray, actuators: np.ndarray,
        action: np.ndarray, tally: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Reward in [0, 1], end of the episode ``(B,)`` and tally ``(B, 2)``: the only reader of truth.

        Every metre of the path pays once, when it is first covered, and the more the closer the vehicle is to the path:
        staying, going back and circling pay nothing. Arriving pays by the distance to the goal and by the energy that
        a dive at cruising speed would take over that used, so that waiting costs. Ending early forgoes the rest.
        """
        reward, end, after = np.empty(len(state)), np.empty(len(state), int), np.empty((len(state), 2))
        dive_score(state, self.where, reference, over, actuators, tally, self._figures, reward, end, after)
        return reward, end, after

    @cached_property
    def _figures(self) -> np.ndarray:
        speed = self.auv.cruise_speed
        return np.array([
            self.TRACKING, self.TRACK_TOLERANCE, self.GOAL_TOLERANCE, self.LOST, self.PITCH_LIMIT, self.HOTEL,
            self.FASTEST * speed * self.dt, speed, self.dt, self.auv.cruise_thrust, self.launch_depth, self.margin,
        ])  # fmt: skip


# --- six degrees of freedom -------------------------------------------------------------------------


@inlined
def _spatial_errors(x: np.ndarray, flow: np.ndarray, reference: np.ndarray, out: np.ndarray) -> None:
    """In body axes: vector to the path, vector to the point ahead, current; then heading and pitch error."""
    sin_phi, cos_phi, sin_theta, cos_theta = np.sin(x[9]), np.cos(x[9]), np.sin(x[10]), np.cos(x[10])
    sin_psi, cos_psi = np.sin(x[11]), np.cos(x[11])
    cross, heading = reference[1], reference[3]
    vectors = (
        (cross * np.sin(heading), -cross * np.cos(heading), -reference[2]),
        (reference[5], reference[6], reference[7]),
        (flow[0], flow[1], 0.0),
    )
    for i in range(3):
        north, east, down = vectors[i]
        ahead, aside = north * cos_psi + east * sin_psi, east * cos_psi - north * sin_psi
        below = ahead * sin_theta + down * cos_theta
        out[3 * i] = ahead * cos_theta - down * sin_theta
        out[3 * i + 1] = aside * cos_phi + below * sin_phi
        out[3 * i + 2] = below * cos_phi - aside * sin_phi
    turn = heading - x[11]
    out[9] = turn - 2.0 * np.pi * np.floor(turn / (2.0 * np.pi) + 0.5)
    out[10] = -np.arctan(reference[4]) - x[10]


@rowwise("void(f8[:,:],f8[:,:],f8[:,:],f8[:,:],f8[:,::1],f8[:,::1])")
def spatial_view(
    state: np.ndarray, flow: np.ndarray, reference: np.ndarray, actuators: np.ndarray, gains: np.ndarray,
    out: np.ndarray,
) -> None:  # fmt: skip
    """What is seen of a dive ``(B, 24)``; ``gains`` are `Dive._gains`."""
    for row in range(len(out)):
        x, place, seen = state[row], reference[row], out[row]
        _spatial_errors(x, flow[row], place, seen)
        seen[11], seen[12] = place[9] - place[0], place[8] / place[9]
        for i in range(6):
            seen[13 + i] = x[i]
        seen[19], seen[20] = x[9], x[10]
        _scaled(21, actuators[row], gains, seen)


@dataclass(frozen=True)
class SpatialDive(Dive):
    """A dive of a vehicle with six degrees of freedom, whose state is `vessel_gym.vehicles.segorogeni.STATE`."""

    where = np.array([6, 7, 8, 10])
    prior_sd = (0.05,) * 3 + (0.02,) * 3 + (0.2,) * 3 + (0.05,) * 3
    state_scale = (0.5, 0.25, 0.25) + (0.5,) * 3 + (10.0, 10.0, 5.0) + (0.25, 0.5, 1.0)
    flows = 2
    std_scale = (0.05,) * 6 + (0.5,) * 3 + (0.05,) * 3
    actuators = 3
    mission_scale = (1.0, 10.0, 5.0)
    observed = {
        "path ahead": 0.25, "path to starboard": 0.25, "path below": 0.25,
        "look ahead": 2.5, "look to starboard": 2.5, "look below": 2.5,
        "current ahead": 0.25, "current to starboard": 0.25, "current below": 0.25,
        "heading error": 0.25, "pitch error": 0.25, "remaining": 10.0, "curvature": 0.1,
        "surge error": 0.25, "sway": 0.25, "heave": 0.25, "roll rate": 0.5, "pitch rate": 0.5, "yaw rate": 0.5,
        "roll": 0.25, "pitch": 0.5,
    }  # fmt: skip

    def observe(self, estimate: Estimate, reference: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        """The observation ``(B, 24)`` of mode ``"mean"``, before clipping: errors, estimates, actuators."""
        seen = np.empty((len(reference), 24))
        spatial_view(writable(estimate.state), writable(estimate.flow), reference, actuators, self._gains, seen)
        return seen


# --- the vertical plane -----------------------------------------------------------------------------


@inlined
def _vertical_errors(x: np.ndarray, flow: np.ndarray, reference: np.ndarray, out: np.ndarray) -> None:
    """In body axes, ahead and down: vector to the path, vector to the point ahead, current; then the pitch error."""
    sin_theta, cos_theta = np.sin(x[5]), np.cos(x[5])
    out[0], out[1] = reference[2] * sin_theta, -reference[2] * cos_theta
    out[2] = reference[5] * cos_theta - reference[7] * sin_theta
    out[3] = reference[5] * sin_theta + reference[7] * cos_theta
    out[4], out[5] = flow[0] * cos_theta, flow[0] * sin_theta
    out[6] = -np.arctan(reference[4]) - x[5]


@rowwise("void(f8[:,:],f8[:,:],f8[:,:],f8[:,:],f8[:,::1],f8[:,::1])")
def vertical_view(
    state: np.ndarray, flow: np.ndarray, reference: np.ndarray, actuators: np.ndarray, gains: np.ndarray,
    out: np.ndarray,
) -> None:  # fmt: skip
    """What is seen of a dive ``(B, 14)``; ``gains`` are `Dive._gains`."""
    for row in range(len(out)):
        x, place, seen = state[row], reference[row], out[row]
        _vertical_errors(x, flow[row], place, seen)
        seen[7] = place[9] - place[0]
        for i in range(3):
            seen[8 + i] = x[i]
        seen[11] = x[5]
        _scaled(12, actuators[row], gains, seen)


@rowwise("void(f8[:],f8[:,:],f8[:,::1])")
def path_angle(covered: np.ndarray, course: np.ndarray, out: np.ndarray) -> None:
    """Angles of paths ``(B, 1)`` [rad], upwards, at so many metres in plan ``(B,)``; their ends are level."""
    for row in range(len(out)):
        length, depth = course[row, 1], course[row, 2]
        share = min(covered[row] / length, 1.0)
        out[row, 0] = -np.arctan(6.0 * depth * share * (1.0 - share) / length)


@dataclass(frozen=True)
class VerticalDive(Dive):
    """A dive in the vertical plane, of a vehicle whose state is `vessel_gym.vehicles.itsunusa.STATE`."""

    where = np.array([3, -1, 4, 5])
    prior_sd = (0.05, 0.05, 0.02, 0.2, 0.2, 0.05)
    state_scale = (0.5, 0.25, 0.5, 20.0, 10.0, 0.5)
    flows = 1
    std_scale = (0.05,) * 3 + (0.5,) * 2 + (0.05,)
    actuators = 2
    mission_scale = (20.0, 10.0)
    observed = {
        "path ahead": 0.25, "path below": 0.25, "look ahead": 5.0, "look below": 5.0,
        "current ahead": 0.25, "current below": 0.25, "pitch error": 0.25, "remaining": 10.0,
        "surge error": 0.25, "heave": 0.25, "pitch rate": 0.5, "pitch": 0.5,
    }  # fmt: skip

    def _checked(self, value: object) -> np.ndarray:
        goal = super()._checked(value)
        if goal[1] != 0.0:
            raise ValueError(
                f"the goal must lie ahead, (x, 0, z) with x > 0: the vehicle does not turn, got {shown(value)}"
            )
        return goal

    def commanded(self, course: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The angle of the path [rad] where a vehicle at the cruising speed would be, upwards, ``(B, 1)``."""
        angle = np.empty((len(course), 1))
        path_angle(step * (self.dt * self.auv.cruise_speed), course, angle)
        return angle

    def observe(self, estimate: Estimate, reference: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        """The observation ``(B, 14)`` of mode ``"mean"``, before clipping: errors, estimates, actuators."""
        seen = np.empty((len(reference), 14))
        vertical_view(writable(estimate.state), writable(estimate.flow), reference, actuators, self._gains, seen)
        return seen
