"""A ship at sea in an environment: sensors, and filters' models including the position."""

from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np

from estimators.engine import compiled, sincos
from vessel_gym.sensors import Sensor, plain
from vessel_gym.vehicles.corvette import (
    COMPASS,
    linear_matrices,
    steady_turns,
    surge_models,
)
from vessel_gym.vehicles.corvette_equations import (
    AROUND,
    COEFFICIENTS,
    STATE,
    UNCERTAIN,
    CorvetteParameters,
    corvette_rates,
)
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.simulated import (
    Actuator,
    SimulatedVehicle,
    resolving_substeps,
    runge_kutta,
)

_ESTIMATED = STATE[:6]  # all but roll


@compiled
@dataclass(frozen=True)
class Ship(SimulatedVehicle):
    """A ship at sea in batches, whose position is measured and estimated.

    The action is the rudder *rate*: with an angle as action, the estimate's noise would saturate
    the steering gear.

    All filters estimate (x, y, psi, u, v, r); roll, which has no effect on these, is not estimated.
    Their known input is ``u = (rudder, commanded yaw rate, estimated heading, 1)``: linear models
    follow the commanded turn, and the track along the heading. With d the yaw increment by waves in
    a step, ``psi+ = psi + dt r + d``; the compass reads psi, and the rate gyro ``r + d / dt`` with
    the d of the step that has ended.
    """

    ship: CorvetteParameters = field(default_factory=lambda: load("corvette", CorvetteParameters))
    dt: float = 0.5  # s

    state_names = STATE
    equations = staticmethod(corvette_rates)
    parameter_names = COEFFICIENTS
    angles = ("psi",)
    action_names = ("rudder rate",)
    steering = (0,)
    incremented: ClassVar[tuple[str, ...]] = ("psi",)
    grades = "ship"
    rates = {"r": "psi"}
    increments: ClassVar[tuple[str, ...]] = ("yaw increment",)
    faults = ()
    ambient_flows: ClassVar[tuple[str, ...]] = AROUND
    kinds = ("nonlinear", "linear")
    linear_kinds: ClassVar[tuple[str, ...]] = ("linear",)
    normals = len(UNCERTAIN)
    """Number of standard normal numbers that `parameters` needs."""

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """True coefficients ``(B, k)``; mismatch is their relative standard deviation."""
        c = np.tile(self.ship.vector(), (len(normals), 1))
        c[:, UNCERTAIN] *= 1.0 + mismatch * np.clip(normals, -2.0, 2.0)
        return c

    @cached_property
    def _actuators(self) -> np.ndarray:
        turn = self.ship.rudder_rate * self.dt
        return np.array([Actuator(turn, turn, kept=1.0, limit=self.ship.rudder_limit)])

    @cached_property
    def sensors(self) -> tuple[Sensor, ...]:
        """Gyro compass, rate gyro, and a receiver with a measurement in every other step."""
        return (
            COMPASS,
            Sensor(
                "rate gyro", ("yaw rate [rad/s]",), partial(_yaw_rate, dt=self.dt), (2e-3,),
                scale=(0.01,), gives=("r",),
            ),
            Sensor(
                "receiver", ("north [m]", "east [m]"), plain((0, 1)), (2.0, 2.0),
                rate=0.5 / self.dt, scale=(200.0, 200.0), gives=("x", "y"),
            ),
        )  # fmt: skip

    @property
    def process_sd(self) -> np.ndarray:
        """Standard deviations of the model error of (x, y, psi, u, v, r) in a step.

        The error is the waves' sway and the wind, which no model contains. It is white noise, whose
        variance grows with the length of the step. The figures are the corvette's in 0.5 s. Another
        ship's are those in 0.5 s times its `pace`, with the yaw rate in inverse proportion to its
        pace.
        """
        slower = pace(self.ship)
        in_half_second = np.array([0.2, 0.2, 1e-4, 0.03, 0.04, 6e-4 / slower])
        return in_half_second * np.sqrt(self.dt / (0.5 * slower))

    @cached_property
    def _plane_mode(self) -> float:
        """Largest modulus [1/s] of the eigenvalues of sway and yaw at service speed."""
        slopes = self.ship.jacobian(np.array([self.ship.speed, 0.0, 0.0, 0.0]))
        return float(np.abs(np.linalg.eigvals(slopes[1:, 1:3])).max())

    @cached_property
    def substeps(self) -> int:
        """RK4 steps in a step of the truth, which resolve roll, sway and yaw; the corvette has 1.

        Roll is the fastest mode of slow ships, whose steps are long.
        """
        roll = 2.0 * np.pi / self.ship.period_of_roll
        return resolving_substeps(self.dt, max(roll, self._plane_mode))

    def estimated(self, kind: str) -> tuple[str, ...]:
        """Components (x, y, psi, u, v, r)."""
        return _ESTIMATED

    @property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """Straight to the north at service speed."""
        return np.array([0.0, 0.0, 0.0, self.ship.speed, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State ``(..., 8)`` of an upright ship, and its rudder ``(..., 1)`` amidships."""
        return np.concatenate([x, np.zeros_like(x[..., :2])], -1), np.zeros((*x.shape[:-1], 1))

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """Estimated components a step later under ``u = (rudder, ...)``, constant over the step.

        Without roll, the substeps need to resolve only sway and yaw.
        """
        (state, _), rudder, still = self.start(x), u[..., :1], np.zeros(1)
        given = state, rudder, still, flow, self.nominal_parameters, self.dt
        substeps = resolving_substeps(self.dt, self._plane_mode)
        moved = runge_kutta(corvette_rates, *given, substeps)
        return moved[..., : len(_ESTIMATED)]

    def known_input(
        self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None
    ) -> np.ndarray:
        """Mean rudder over a step, commanded yaw rate, estimated heading, and 1.

        Without commands of a task, the yaw rate is that of the steady turn at this rudder, and the
        heading is north.
        """
        rudder, north = 0.5 * (before + after), np.zeros_like(before)
        if commanded is None:
            turns = steady_turns(self.ship)
            # the rudder is below 0 in wide turns of an unstable ship
            rising = np.maximum.accumulate(turns.rudder)
            rate = np.copysign(np.interp(np.abs(rudder), rising, turns.yaw_rate), rudder)
            commanded = np.concatenate([rate, north], -1)
        return np.concatenate([rudder, commanded, north + 1.0], -1)

    def linear(self, kind: str) -> tuple[Any, ...]:
        """A, B and the effect of flows: sway, yaw and surge about the commanded turn.

        The track follows the estimated heading. Of the flows, the model contains the current alone.
        """
        A, B = linear_matrices(self.ship, self.dt)
        turns, kept = steady_turns(self.ship), surge_models(self.ship, self.dt)
        n = len(_ESTIMATED)
        carried = np.zeros((n, len(self.ambient_flows)))
        carried[0, 0] = carried[1, 1] = self.dt

        @compiled
        def moving(u: np.ndarray) -> np.ndarray:
            zero, rate, heading = np.zeros_like(u[..., 0]), u[..., 1], u[..., 2]
            sin, cos = sincos(heading + 0.5 * self.dt * rate)  # in the middle of the step
            north, east, one = self.dt * cos, self.dt * sin, zero + 1.0
            surge, turning = turns.interpolated(kept, rate), np.moveaxis(A(u), (-2, -1), (0, 1))
            (v_v, v_r, v_psi), (r_v, r_r, r_psi), (psi_v, psi_r, psi_psi) = turning
            return np.stack([
                np.stack(row, -1) for row in (
                    (one, zero, zero, north, -east, zero),
                    (zero, one, zero, east, north, zero),
                    (zero, zero, psi_psi, zero, psi_v, psi_r),
                    (zero, zero, zero, surge, zero, zero),
                    (zero, zero, v_psi, zero, v_v, v_r),
                    (zero, zero, r_psi, zero, r_v, r_r),
                )
            ], -2)  # fmt: skip

        @compiled
        def known(u: np.ndarray) -> np.ndarray:
            (v, r, psi), zero = np.moveaxis(B(u)[..., 0], -1, 0), np.zeros_like(u[..., 0])
            lost = 1.0 - turns.interpolated(kept, u[..., 1])
            speed = turns.interpolated(turns.speed, u[..., 1])
            rudder, none = (zero, zero, psi, zero, v, r), n * (zero,)
            columns = rudder, none, none, (zero, zero, zero, lost * speed, zero, zero)
            return np.stack([np.stack(column, -1) for column in columns], -1)

        return moving, known, carried


def pace(ship: CorvetteParameters) -> float:
    """Time in which a ship sails its own length, as a multiple of the corvette's."""
    corvette = load("corvette", CorvetteParameters)
    return (ship.length / ship.speed) / (corvette.length / corvette.speed)


@compiled
def _yaw_rate(state: np.ndarray, exogenous: np.ndarray, *, dt: float) -> np.ndarray:
    """Yaw rate ``(..., 1)``, with the waves' mean yaw rate over the step that has ended."""
    return state[..., 5:6] + exogenous[..., :1] / dt
