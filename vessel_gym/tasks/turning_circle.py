"""Hold a commanded turning circle through one full turn and beyond."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators import Gaussian
from estimators.checks import as_number, short_repr
from estimators.engine import compiled
from vessel_gym.checks import check_numbers, check_pair, one_of
from vessel_gym.sensors import Sensors
from vessel_gym.system import Estimate
from vessel_gym.tasks.steering import Steering, first_component, wrapped
from vessel_gym.vehicles.corvette import steady_turns


def dead_reckoned(
    heading: np.ndarray, surge: np.ndarray, sway: np.ndarray, dt: float
) -> np.ndarray:
    """Positions ``(k, 2)`` north and east [m] by dead reckoning from the origin, through the water.

    The integral is the trapezoidal rule.

    Args:
        heading: ``(k,)`` rad.
        surge: ``(k,)`` m/s.
        sway: ``(k,)`` m/s.
        dt: Time between samples [s].
    """
    sin, cos = np.sin(heading), np.cos(heading)
    velocity = np.stack([surge * cos - sway * sin, surge * sin + sway * cos], -1)
    return np.concatenate(
        [np.zeros((1, 2)), np.cumsum(0.5 * dt * (velocity[1:] + velocity[:-1]), 0)]
    )


@compiled
@dataclass(frozen=True)
class TurningCircle(Steering):
    """The commanded heading leads into a steady turn: straight, a ramp of the yaw rate, a circle.

    A scenario (the episode's parameters, drawn at reset) is ``(initial heading [rad], commanded yaw
    rate [rad/s])``. A reference is ``(heading [rad], yaw rate now, yaw rate PREVIEW seconds ahead,
    final yaw rate [rad/s])``.
    """

    radius: tuple[float, float] = (3.0, 6.0)  # commanded radius in ship lengths, to either side
    tightest: float = 2.5  # ship lengths, least radius of an option: nearly full rudder

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, positive="tightest")
        check_pair(f"radius of {type(self).__name__}", self.radius)

    prior_sd: ClassVar[tuple[float, ...]] = (0.2, 0.002, 0.03, 0.2)
    uniforms = 3
    """Number of uniform random numbers that `scenario` needs."""
    commanding: ClassVar[slice | list[int]] = slice(1, 2)

    @property
    def lead(self) -> float:
        """Time [s] before the turn begins."""
        return 5.0 * self.pace

    @property
    def ramp(self) -> float:
        """Time [s] in which the commanded yaw rate rises to its final value."""
        return 25.0 * self.pace

    WIDEST = 1e5  # m, largest commanded radius; a larger number is an error of the unit

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Draw scenarios ``(B, 2)`` from uniforms ``(B, 3)``.

        Args:
            uniforms: Random numbers for the initial heading, the radius and the side.
            options: ``{"radius": r}`` sets the commanded radius [m], positive to starboard.

        Raises:
            ValueError: for an unknown option or a radius that the ship cannot hold.
        """
        scenarios = self._drawn(uniforms)
        for option, value in options.items():
            one_of("reset option", option, ("radius",))
            low = self.tightest * self.ship.length
            wanted = as_number(value)
            if not low <= abs(wanted) < np.inf:
                raise ValueError(
                    f"radius must be at least {low:.0f} m to either side, got {short_repr(value)}"
                )
            if abs(wanted) > self.WIDEST:
                raise ValueError(
                    f"radius must be at most {self.WIDEST:.0f} m to either side, got"
                    f" {short_repr(value)}"
                )
            scenarios[:, 1] = self.yaw_rate(np.array(wanted))
        return scenarios

    @compiled
    def _drawn(self, uniforms: np.ndarray) -> np.ndarray:
        """Scenarios ``(..., 2)`` without options."""
        shortest, longest = self.radius
        radius = self.ship.length * (shortest + (longest - shortest) * uniforms[..., 1])
        rate = self.yaw_rate(np.copysign(radius, uniforms[..., 2] - 0.5))
        return np.stack([np.pi * (1.0 - 2.0 * uniforms[..., 0]), rate], -1)

    def prior(self, scenario: np.ndarray) -> Gaussian:
        """Prior of (v, r, psi, u): mean ``(B, 4)`` and covariance ``(4, 4)``."""
        mean = np.zeros((len(scenario), 4))
        mean[:, 2], mean[:, 3] = scenario[:, 0], self.ship.speed
        return self._spread.about(mean)

    def reference(self, scenario: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Reference ``(..., 4)`` at a step ``(...)``, independent of the ship's position."""
        return self.command(scenario, step)

    @compiled(axes=(1, 0))
    def command(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Reference ``(..., 4)`` at a step ``(...)``; the yaw rate rises linearly over the ramp."""
        heading, rate = scenario[..., 0], scenario[..., 1]
        elapsed = step * self.dt - self.lead
        share = np.clip(elapsed / self.ramp, 0.0, 1.0)
        share_ahead = np.clip((elapsed + self.preview) / self.ramp, 0.0, 1.0)
        turned = 0.5 * self.ramp * share * share + np.maximum(elapsed - self.ramp, 0.0)
        return np.stack([heading + rate * turned, rate * share, rate * share_ahead, rate], -1)

    @compiled(axes=(1, 0))
    def commanded(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Commanded yaw rate ``(..., 1)``."""
        return self.command(scenario, step)[..., self.commanding]

    def path(self, scenario: np.ndarray) -> np.ndarray:
        """Path ``(k, 2)`` of a scenario ``(2,)``, one circle long, through the water.

        The path has the reference heading and the drift of the steady turn; a current carries the
        true ship away from it.
        """
        steps, turns = np.arange(self.horizon + 1), steady_turns(self.ship)
        reference = self.command(np.tile(scenario, (len(steps), 1)), steps)
        turned = np.abs(reference[:, 0] - scenario[0]) - 0.5 * self.ramp * abs(scenario[1])
        heading, rate, *_ = reference[: 2 + np.searchsorted(turned, 2.0 * np.pi)].T
        surge = np.interp(np.abs(rate), turns.yaw_rate, turns.speed)
        sway = np.interp(np.abs(rate), turns.yaw_rate, turns.sway)
        return dead_reckoned(heading, surge, np.sign(rate) * sway, self.dt)

    # --- what the agent sees ----------------------------------------------------------------------

    def sizes(self, measurements: int, states: int) -> dict[str, int]:
        """Lengths of the parts of an observation."""
        return {
            "guided": 7,
            "unguided": 8,
            "std": 4,
            "measurements": 2 * measurements,
            "mission": 3,
        }

    @cached_property
    def _std_gains(self) -> np.ndarray:
        scales = self.SWAY_SCALE, self.rate_scale, self.HEADING_SCALE, self.INPUT_SCALE
        return 1.0 / np.array(scales)

    def observe(
        self, estimate: Estimate, scenario: np.ndarray, reference: np.ndarray,
        actuators: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Observation ``(..., 7)`` of mode ``"mean"`` before clipping.

        Errors of heading and yaw rate, sway, d, rudder, commanded yaw rates now and ahead.
        """
        v, r, psi = (estimate.state[..., i] for i in range(3))
        heading, rate, rate_ahead = (reference[..., i] for i in range(3))
        d = first_component(estimate.input_mean, v)
        errors = wrapped(heading - psi), rate - r
        return np.stack([*errors, v, d, actuators[..., 0], rate, rate_ahead], -1) * self._mean_gains

    def observe_std(self, estimate: Estimate) -> np.ndarray:
        """Scaled standard deviations ``(..., 4)`` of sway, yaw rate, heading and unknown input."""
        assert estimate.sd is not None
        sd = [estimate.sd[..., i] for i in range(3)]
        return np.stack([*sd, first_component(estimate.input_sd, sd[0])], -1) * self._std_gains

    def observe_measurements(
        self,
        sensors: Sensors,
        measurements: np.ndarray,
        available: np.ndarray,
        scenario: np.ndarray,
        step: np.ndarray,
    ) -> np.ndarray:
        """Measurements and mask ``(..., 2 p)``.

        A measured heading becomes its error to the commanded one, on the scale of such an error.
        """
        heading = self.command(scenario, step)[..., :1]
        error = wrapped(heading - measurements) / self.HEADING_SCALE
        measured = np.where(
            [state == "psi" for state in sensors.gives], error, measurements / sensors.scale
        )
        return np.concatenate([np.where(available, measured, 0.0), available], -1)

    def observe_mission(
        self, scenario: np.ndarray, step: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        """Rudder, and commanded yaw rates now and ahead ``(..., 3)``."""
        commands = self.command(scenario, step)[..., 1:3]
        return np.concatenate([actuators, commands], -1) / self._known_scales

    def observe_state(self, estimate: Estimate, scenario: np.ndarray) -> np.ndarray:
        """Sway, yaw rate, sine and cosine of the heading relative to the first, d ``(..., 5)``."""
        v, r, psi = (estimate.state[..., i] for i in range(3))
        d = first_component(estimate.input_mean, v)
        turned = psi - scenario[..., 0]
        moving = v / self.SWAY_SCALE, r / self.command_scale
        return np.stack([*moving, np.sin(turned), np.cos(turned), d / self.INPUT_SCALE], -1)

    # --- how it is scored -------------------------------------------------------------------------

    HEADING_TOLERANCE = 0.05  # rad of heading error that halve the reward
    RATE_TOLERANCE = 0.15  # relative error that halves the yaw rate's fifth of the reward
    LOST = 0.5 * np.pi  # rad, heading error at which the turn is lost

    end_reasons = ("", "turn lost")
    """Success is holding the turn until time is up; a perfect reward is 1 in every step."""

    def initial_score_state(self, state: np.ndarray, scenario: np.ndarray) -> np.ndarray:
        """Rudder and its rate ``(..., 2)``."""
        return np.zeros_like(state[..., :2])

    @compiled(axes=(1, 1, 1, 1, 0, 1, 1, 1))
    def score(
        self, state: np.ndarray, exogenous: np.ndarray, scenario: np.ndarray,
        reference: np.ndarray, over: np.ndarray, actuators: np.ndarray, action: np.ndarray,
        score_state: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Reward in [0, 1] ``(...)``, end ``(...)`` and score state ``(..., 2)``, from the truth.

        The kernels are narrow because with wide ones an agent trades heading for rudder. Rewards
        are never negative, so ending early never pays; the reference moves with time, so loitering
        does not pay either.
        """
        heading = wrapped(reference[..., 0] - state[..., 2])
        rate = (reference[..., 1] - state[..., 5]) / reference[..., 3]
        value = 0.8 + 0.2 / (1.0 + (rate / self.RATE_TOLERANCE) ** 2)
        value = value / (1.0 + (heading / self.HEADING_TOLERANCE) ** 2)
        smooth, steered = self.smooth(actuators, score_state)
        return value * smooth, np.where(np.abs(heading) > self.LOST, 1, 0), steered
