"""Dive along a smooth path to a goal, and recognise the arrival from the estimate."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from estimators import Gaussian
from estimators.angles import ahead_and_aside
from estimators.checks import finite_array, integer, short_repr
from estimators.engine import compiled
from vessel_gym.checks import check_numbers, instance, one_of
from vessel_gym.guidance.dive_path import arc_to, follow, path_point
from vessel_gym.system import Estimate
from vessel_gym.tasks.task import (
    SCORE_AXES,
    Task,
    Workspace,
    closeness,
    first_reason,
    smoothness,
    three_numbers,
    wrapped,
)
from vessel_gym.vehicles.auv import AUVParameters


@compiled
@dataclass(frozen=True)
class Dive(Task):
    """Common part of all dives: path, scenarios and score.

    The path is that of `vessel_gym.guidance.dive_path`. A scenario (the episode's parameters, drawn
    at reset) is ``(angle, length, depth)`` of the path, then the speed at the start [m/s]. A
    reference ``(B, 8)`` is the estimated position on the path: progress, cross-track and depth
    error [m], heading and slope of the path there, and the vector to the path's point ``ahead``
    (north, east, down). The dive ends when the estimated position has covered the path; if no
    estimate is observed, the true position counts (see `vessel_gym.simulation.core.Core`).
    """

    auv: AUVParameters
    goal: tuple[float, float, float]  # m north, east and down of the start
    goal_spread: tuple[float, float, float]  # m, half widths of the intervals of random goals
    ahead: float  # m, look-ahead distance
    horizon: int  # steps

    dt = 0.1  # s
    launch_depth = 2.0  # m of water above the start
    margin = 3.0  # m below the goal at which the vehicle is too deep
    tightest = 4.0  # vehicle lengths, least radius of an option
    widest = 1.5 * np.pi  # rad, widest turn of an option
    steepest = np.deg2rad(35.0)  # rad, steepest path of an option

    def __post_init__(self) -> None:
        title = type(self).__name__
        instance(f"auv of {title}", self.auv, AUVParameters)
        for name in ("goal", "goal_spread"):
            finite_array(f"{name} of {title}", getattr(self, name), 3)
        integer(f"horizon of {title}", self.horizon, 1)
        check_numbers(self, positive="ahead")

    uniforms = 3
    """Number of uniform random numbers that `scenario` needs."""
    end_reasons = (
        "", "arrived", "missed the goal", "pitched over", "too deep", "surfaced", "off the path",
    )  # fmt: skip
    success = "arrived"
    perfect = 1.0
    """A perfect episode has the score 1."""

    # --- what is drawn ----------------------------------------------------------------------------

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Draw scenarios ``(B, 4)`` from uniforms ``(B, 3)``.

        Args:
            uniforms: Random numbers for the goal.
            options: ``{"goal": (x, y, z)}`` sets the goal [m]: north, east and down of the start.
                ``{"at_rest": True}`` starts from rest, as in the papers, not at cruise speed.

        Raises:
            ValueError: for an unknown option or a goal that the vehicle cannot dive to.
        """
        for option in options:
            one_of("reset option", option, ("goal", "at_rest"))
        at_rest = options.get("at_rest", False)
        if not isinstance(at_rest, bool):
            raise ValueError(f"at_rest must be True or False, got {short_repr(at_rest)}")
        if "goal" in options:
            arcs = arc_to(self._checked(options["goal"])[None]).repeat(len(uniforms), 0)
        else:
            arcs = self._drawn(uniforms)
        speeds = np.full((len(uniforms), 1), 0.0 if at_rest else self.auv.cruise_speed)
        return np.concatenate([arcs, speeds], -1)

    @compiled
    def _drawn(self, uniforms: np.ndarray) -> np.ndarray:
        return arc_to(np.array(self.goal) + np.array(self.goal_spread) * (2.0 * uniforms - 1.0))

    def _checked(self, value: object) -> np.ndarray:
        """A goal within the vehicle's reach."""
        goal = three_numbers("goal", value, "metres north, east and down of the start")
        angle, length, depth = arc_to(goal)
        farthest = 0.8 * self.horizon * self.dt * self.auv.cruise_speed
        least, turn = self.tightest * self.auv.length, abs(angle)
        for what, size, low, high, unit in (
            ("turn", np.rad2deg(turn), 0.0, np.rad2deg(self.widest), "deg"),
            ("length", length, least, farthest, "m"),
            ("radius", length / max(turn, 1e-9), least, np.inf, "m"),
            ("depth", depth, 0.0, length * np.tan(self.steepest) / 1.5, "m"),
        ):
            if not low <= size <= high:
                raise ValueError(
                    f"the {what} of the path to the goal must be {low:.1f} to {high:.1f} {unit},"
                    f" got {size:.1f} {unit}"
                )
        return goal

    def prior(self, scenario: np.ndarray) -> Gaussian:
        """Prior at the beginning of the path, level at the speed of the start."""
        mean = np.zeros((len(scenario), len(self.prior_sd)))
        mean[:, 0] = scenario[:, 3]
        return self._spread.about(mean)

    @compiled(axes=(1, 0, 1))
    def reference(self, scenario: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Position ``(..., 8)`` relative to the path, for states ``(..., n)``."""
        return follow(self.position(state), scenario, self.ahead)

    def workspace(self, scenario: np.ndarray) -> Workspace:
        """The vehicle, its path, the goal and the surface of the water."""
        path = path_point(np.linspace(0.0, scenario[1], 121), scenario)[:, :3]
        north, east, down = path[-1]
        goal = north, east, down, self.GOAL_TOLERANCE
        return Workspace("torpedo", self.auv.length, path, goal=goal, surface=-self.launch_depth)

    # --- what the agent sees ----------------------------------------------------------------------

    flow_scale = 0.25

    def errors(
        self, estimate: Estimate, scenario: np.ndarray, reference: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Estimated errors and motion in SI by name, ``(...)`` each; vectors are in body axes."""
        progress, cross, depth, heading, slope, *look = (reference[..., i] for i in range(8))
        u, v, w, p, q, r, _, _, _, roll, pitch, yaw = self.motion(estimate.state)
        zero, flow = np.zeros_like(u), estimate.flow
        angle, length = scenario[..., 0], scenario[..., 1]
        vectors = {
            "path": (cross * np.sin(heading), -cross * np.cos(heading), -depth),
            "look": look,
            "current": (flow[..., 0], flow[..., 1] if flow.shape[-1] > 1 else zero, zero),
        }
        seen = {
            "heading error": wrapped(heading - yaw), "pitch error": -np.arctan(slope) - pitch,
            "remaining": length - progress, "curvature": angle / length,
            "surge error": u - self.auv.cruise_speed, "sway": v, "heave": w,
            "roll rate": p, "pitch rate": q, "yaw rate": r, "roll": roll, "pitch": pitch,
        }  # fmt: skip
        for name, (north, east, down) in vectors.items():
            ahead, aside = ahead_and_aside(north, east, yaw)
            ahead, above = ahead_and_aside(ahead, -down, pitch)
            aside, below = ahead_and_aside(aside, -above, roll)
            seen |= {f"{name} ahead": ahead, f"{name} to starboard": aside, f"{name} below": below}
        return seen

    def observe(
        self, estimate: Estimate, scenario: np.ndarray, reference: np.ndarray,
        actuators: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Observation ``(..., k)`` of mode ``"mean"``: errors by name, and the actuators."""
        errors = self.errors(estimate, scenario, reference)
        seen = [errors[name] / scale for name, scale in self.observed.items()]
        return np.concatenate([np.stack(seen, -1), self.scaled(actuators)], -1)

    actuators: ClassVar[int]
    """Number of actuators: fins, then thrust."""
    mission_scale: ClassVar[tuple[float, ...]]
    """Scales of the path's last numbers in an observation of raw measurements."""

    def observe_mission(
        self, scenario: np.ndarray, step: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        """Scenario and actuators ``(..., k)``."""
        mission = scenario[..., 3 - len(self.mission_scale) : 3] / self.mission_scale
        return np.concatenate([mission, self.scaled(actuators)], -1)

    components: ClassVar[tuple[int | None, ...]]
    """Indices in a state of u, v, w, p, q, r, x, y, z, phi, theta, psi; None where it lacks one."""

    def motion(self, state: np.ndarray) -> list[np.ndarray]:
        """The twelve ``components`` of states in SI, ``(...)`` each; 0 where a state lacks one."""
        zero = np.zeros_like(state[..., 0])
        return [zero if i is None else state[..., i] for i in self.components]

    def position(self, state: np.ndarray) -> np.ndarray:
        """North, east and down [m] ``(..., 3)`` of states."""
        return np.stack(self.motion(state)[6:9], -1)

    def scaled(self, actuators: np.ndarray) -> np.ndarray:
        """Fins relative to their limits, and thrust from -1 (none) to 1 (full)."""
        thrust = 2.0 * actuators[..., -1:] / self.auv.thrust_limit - 1.0
        return np.concatenate([actuators[..., :-1] / self.auv.fin_limit, thrust], -1)

    # --- how it is scored -------------------------------------------------------------------------

    TRACKING = 0.7  # share of the score for following the path; the rest is for arriving
    TRACK_TOLERANCE = 0.25  # m off the path that halve the reward of a metre
    FIN_PRICE = 1.0 / 3.0
    """Price of effort: full rate takes fins over in 0.7 s, and a ship's rudder in 14 s."""
    GOAL_TOLERANCE = 0.5  # m off the goal, still arrived, that halve the reward of arriving
    LOST = 5.0  # m off the path at which the episode ends
    PITCH_LIMIT = np.deg2rad(75.0)  # rad: Euler angles have their pole at 90 deg
    HOTEL = 2.0  # power of all but the propeller, relative to the propeller's at cruise speed
    FASTEST = 3.0  # largest progress that counts, relative to cruise speed

    def over(self, scenario: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Has the position covered the path ``(...)``?"""
        return reference[..., 0] >= scenario[..., 1]

    def power(self, actuators: np.ndarray) -> np.ndarray:
        """Power ``(...)`` of propeller and hotel load relative to cruise."""
        propeller = (actuators[..., -1] / self.auv.cruise_thrust) ** 1.5
        return (self.HOTEL + propeller) / (self.HOTEL + 1.0)

    @compiled
    def initial_score_state(self, state: np.ndarray, scenario: np.ndarray) -> np.ndarray:
        """Farthest progress [m], energy [s of cruise], fins [rad] and their rates ``(..., k)``."""
        progress = follow(self.position(state), scenario, 0.0)[..., 0]
        used = np.stack([np.clip(progress, 0.0, scenario[..., 1]), np.zeros_like(progress)], -1)
        return np.concatenate([used, np.zeros_like(state[..., : 2 * (self.actuators - 1)])], -1)

    @compiled(axes=SCORE_AXES)
    def score(
        self, state: np.ndarray, exogenous: np.ndarray, scenario: np.ndarray,
        reference: np.ndarray, over: np.ndarray, actuators: np.ndarray, action: np.ndarray,
        score_state: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Reward in [0, 1] ``(...)``, end ``(...)`` and score state ``(..., k)``, from the truth.

        Every metre of the path pays once, when it is first covered. The pay rises with the
        closeness to the path and the steadiness of the fins; staying, going back and circling pay
        nothing. Arriving pays by the distance to the goal, and by the energy of a dive at cruise
        speed over the energy used, so that waiting costs. Ending early forgoes the rest.
        """
        position, farthest, speed = self.position(state), score_state[..., 0], self.auv.cruise_speed
        length, depth = scenario[..., 1], scenario[..., 2]
        place = follow(position, scenario, 0.0)
        off = np.hypot(place[..., 1], place[..., 2] / np.sqrt(1.0 + place[..., 4] ** 2))
        most = self.FASTEST * speed * self.dt
        fresh = np.clip(np.minimum(place[..., 0], length) - farthest, 0.0, most)
        energy = score_state[..., 1] + self.dt * self.power(actuators)
        full = self.auv.fin_rate * self.dt
        smooth, fins = smoothness(actuators[..., :-1], score_state[..., 2:], full, self.FIN_PRICE)
        quality = smooth * closeness(off, self.TRACK_TOLERANCE)
        tracking = self.TRACKING * fresh / length * quality

        goal = path_point(length, scenario)[..., :3]
        miss = np.sqrt(((position - goal) ** 2).sum(-1))
        economy = np.minimum(np.hypot(length, depth) / speed / energy, 1.0)
        arriving = (1.0 - self.TRACKING) * economy * closeness(miss, self.GOAL_TOLERANCE)
        reward = tracking + np.where(over, arriving, 0.0)

        down, pitch = position[..., 2], self.motion(state)[10]
        end = first_reason(
            over & (miss <= self.GOAL_TOLERANCE), over, np.abs(pitch) > self.PITCH_LIMIT,
            down > depth + self.margin, down < -self.launch_depth, off > self.LOST,
        )  # fmt: skip
        covered = np.stack([farthest + fresh, energy], -1)
        return reward, end, np.concatenate([covered, fins], -1)


# --- six degrees of freedom -----------------------------------------------------------------------


@compiled
@dataclass(frozen=True)
class SpatialDive(Dive):
    """Dive with six degrees of freedom; the state is `vessel_gym.vehicles.segorogeni.STATE`."""

    components = tuple(range(12))
    prior_sd = (0.05,) * 3 + (0.02,) * 3 + (0.2,) * 3 + (0.05,) * 3
    state_scale = (0.5, 0.25, 0.25) + (0.5,) * 3 + (10.0, 10.0, 5.0) + (0.25, 0.5, 1.0)
    std_scale = (0.05,) * 6 + (0.5,) * 3 + (0.05,) * 3
    actuators = 3
    mission_scale = (1.0, 10.0, 5.0)
    observed = {
        "path ahead": 0.25, "path to starboard": 0.25, "path below": 0.25,
        "look ahead": 2.5, "look to starboard": 2.5, "look below": 2.5,
        "current ahead": 0.25, "current to starboard": 0.25, "current below": 0.25,
        "heading error": 0.25, "pitch error": 0.25, "remaining": 10.0, "curvature": 0.1,
        "surge error": 0.25, "sway": 0.25, "heave": 0.25,
        "roll rate": 0.5, "pitch rate": 0.5, "yaw rate": 0.5, "roll": 0.25, "pitch": 0.5,
    }  # fmt: skip


# --- the vertical plane ---------------------------------------------------------------------------


@compiled
@dataclass(frozen=True)
class VerticalDive(Dive):
    """Dive in the vertical plane; the state is `vessel_gym.vehicles.itsunusa.STATE`."""

    components = 0, None, 1, None, 2, None, 3, None, 4, None, 5, None
    prior_sd = (0.05, 0.05, 0.02, 0.2, 0.2, 0.05)
    state_scale = (0.5, 0.25, 0.5, 20.0, 10.0, 0.5)
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
                "the goal must lie ahead, (x, 0, z) with x > 0: the vehicle does not turn, got"
                f" {short_repr(value)}"
            )
        return goal

    @compiled(axes=(1, 0, 1))
    def commanded(
        self, scenario: np.ndarray, step: np.ndarray, reference: np.ndarray
    ) -> np.ndarray:
        """Path angle [rad] ``(..., 1)``, upwards, at the place of a vehicle at cruise speed."""
        point = path_point(step * (self.dt * self.auv.cruise_speed), scenario)
        return -np.arctan(point[..., 4:])
