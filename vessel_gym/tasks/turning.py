"""The turning circle trial of the thesis.

Rudder angle, time step, switch of d and prior variance of the trial are inferred or our choice;
docs/environments/thesis-corvette.md states what the thesis prints instead.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from estimators.engine import compiled, lookup
from vessel_gym.checks import one_of
from vessel_gym.sensors import Sensors
from vessel_gym.tasks.task import (
    SCORE_AXES,
    Estimate,
    Workspace,
    at_depth,
    closeness,
    first_reason,
    wrapped,
)
from vessel_gym.tasks.track import Steering, first_component
from vessel_gym.vehicles.corvette_thesis import SIMULATIONS, ThesisCorvette

SAMPLES = 195
"""Samples of the thesis' record (Section 4.5): one at reset, one after each step."""
SWITCH = 98
"""First sample with negative d, halfway.

Inferred: the thesis prints a switch after one sample (Section 4.3.1).
"""


@compiled
@dataclass(frozen=True)
class TurningTrial(Steering):
    """Follow the heading of a turning circle trial in which the rudder was put over to ``helm``.

    The trial begins on a straight course. A scenario is ``(initial heading [rad], final yaw rate
    [rad/s], simulation)``. A reference is ``(heading [rad], yaw rate now, yaw rate PREVIEW seconds
    ahead, final yaw rate [rad/s], simulation)``.
    """

    pace: float = 1.6  # for steps of 0.8 s
    horizon: int = SAMPLES - 1
    helm = float(np.deg2rad(28.0))  # rad, our choice: more hardly helps; 35 deg is printed

    prior_sd = (1e-3**0.5,) * 3  # of sway, yaw rate, heading; inferred: equal to those of Q

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Scenarios ``(B, 3)`` without random values.

        Args:
            uniforms: ``(B, 0)``.
            options: ``{"simulation": "II"}`` chooses one of `SIMULATIONS`; the default is the
                first.

        Raises:
            ValueError: for another option or simulation.
        """
        scenarios = np.tile([0.0, self.record[-1, 5], 0.0], (len(uniforms), 1))
        for option, value in options.items():
            one_of("reset option", option, ("simulation",))
            scenarios[:, 2] = list(SIMULATIONS).index(one_of("simulation", value, SIMULATIONS))
        return scenarios

    @cached_property
    def vehicle(self) -> ThesisCorvette:  # type: ignore[override]
        """The ship, whose straight course is the mean of the prior."""
        return ThesisCorvette(self.ship, self.dt)

    @cached_property
    def record(self) -> np.ndarray:
        """States ``(k, 8)`` of the ship in the trial, up to the end of the preview."""
        vessel = self.vehicle
        parameters, still = vessel.nominal_parameters[None], np.zeros((1, 1))
        state, rudder = vessel.start(np.zeros((1, 3)))
        states = [state[0]]
        for _ in range(self.horizon + self._ahead):
            before, put = rudder, still + self.helm / self.ship.rudder_limit
            rudder = vessel.actuate(before, put)
            state = vessel.step(state, before, rudder, still, parameters)
            states.append(state[0])
        return np.array(states)

    @property
    def _ahead(self) -> int:
        return round(self.preview / self.dt)

    @compiled(axes=(1, 0))
    def command(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Reference ``(..., 5)`` at a step ``(...)`` of the trial."""
        heading, rate = self.record.T[[2, 5]]
        rate_ahead = lookup(rate, step + float(self._ahead))
        now = lookup(heading, step), lookup(rate, step)
        return np.stack([*now, rate_ahead, scenario[..., 1], scenario[..., 2]], -1)

    def reference(self, scenario: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Reference ``(..., 5)`` at a step ``(...)``, independent of the ship's state."""
        return self.command(scenario, step)

    commands = 3, 4
    """Yaw rate of the turn, and the number of the simulation."""

    def workspace(self, scenario: np.ndarray) -> Workspace:
        """The ship and its positions in the trial."""
        path = at_depth(self.record[: self.horizon + 1, :2])
        return Workspace("ship", self.ship.length, path)

    @compiled(axes=(1, 0))
    def exogenous(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The step d [rad] ``(..., 1)``: positive at first, negative from `SWITCH` on."""
        size = lookup(np.array([each.size for each in SIMULATIONS.values()]), scenario[..., 2])
        return np.where(step < SWITCH, size, -size)[..., None]

    # --- what the agent sees ----------------------------------------------------------------------

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
        seen = [*errors, v, d, actuators[..., 0], rate, rate_ahead]
        return np.stack(seen, -1) / self._mean_scales

    @property
    def std_scales(self) -> dict[int, float]:
        """Scales of sway, yaw rate and heading."""
        return {0: self.SWAY_SCALE, 1: self.rate_scale, 2: self.HEADING_SCALE}

    def observe_measurements(
        self, sensors: Sensors, measurements: np.ndarray, scenario: np.ndarray, step: np.ndarray
    ) -> np.ndarray:
        """Measurements ``(..., p)``.

        A measured heading becomes its error to the commanded one, on the scale of such an error.
        """
        heading = self.command(scenario, step)[..., :1]
        error = wrapped(heading - measurements) / self.HEADING_SCALE
        are_headings = [state == "psi" for state in sensors.gives]
        return np.where(are_headings, error, measurements / sensors.scale)

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

    score_states = 2
    """Rudder and its rate."""

    @compiled(axes=SCORE_AXES)
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
        value = 0.8 + 0.2 * closeness(rate, self.RATE_TOLERANCE)
        value = value * closeness(heading, self.HEADING_TOLERANCE)
        smooth, steered = self.smooth(actuators, score_state)
        return value * smooth, first_reason(np.abs(heading) > self.LOST), steered
