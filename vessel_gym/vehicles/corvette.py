"""Steady turns of a ship, filters' linear models about them, its propulsion, and two sensors.

For particulars and equations of motion, with frames and sources, see
`vessel_gym.vehicles.corvette_equations`.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from estimators import Schedule, zero_order_hold
from estimators.engine import compiled
from vessel_gym.processes import interpolated
from vessel_gym.sensors import Sensor, plain
from vessel_gym.vehicles.corvette_equations import (
    Coefficients,
    CorvetteParameters,
    propelled_rudder,
)
from vessel_gym.vehicles.simulated import root


class SteadyTurn(NamedTuple):
    """Steady turns at rising yaw rates, with speeds, drift and rudder, ``(k,)`` each."""

    yaw_rate: np.ndarray  # rad/s
    speed: np.ndarray  # surge, m/s
    sway: np.ndarray  # m/s
    rudder: np.ndarray  # rad
    radius: np.ndarray  # m, of the track; infinite for the straight course

    def interpolated(self, values: np.ndarray, yaw_rate: np.ndarray) -> np.ndarray:
        """Values ``(k,)`` of the turns, interpolated at yaw rates ``(...)`` of either sign."""
        at = np.minimum(np.abs(yaw_rate) / self.yaw_rate[1], len(values) - 1.0)
        return interpolated(values, at)


@cache
def steady_turns(ship: CorvetteParameters) -> SteadyTurn:
    """Steady turns at 165 yaw rates in equal steps, up to that of 80 % of the rudder limit.

    With more rudder the yaw rate hardly rises, and could not be controlled. Of two turns with one
    yaw rate that of the smaller rudder counts.

    Turns are followed from the straight course by pseudo-arclength continuation (Keller 1977), as
    in Bech's reverse spiral test (1968). So a directionally unstable ship has steady turns, too. In
    the wide ones its rudder is to the other side.

    Raises:
        RuntimeError: if the ship has no steady turn at that rudder.
    """
    U = ship.speed
    units = np.array([U, U, U / ship.length, 0.8 * ship.rudder_limit])

    def residual(turn: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """Accelerations ``(..., 3)``, and distance from a plane of a normal and an offset."""
        off = (turn * plane[..., :4]).sum(-1, keepdims=True) - plane[..., 4:]
        return np.concatenate([ship.accelerations(turn * units) / units[:3], off], -1)

    turns = [np.array([1.0, 0.0, 0.0, 0.0])]  # surge, sway, yaw rate, rudder
    ahead, step = np.array([0.0, 0.0, 1.0, 0.0]), 1e-4
    while turns[-1][3] < 1.0 and len(turns) < 200:  # 25 for the corvette
        turns.append(root(residual, turns[-1], np.append(ahead, ahead @ turns[-1] + step)))
        ahead, step = turns[-1] - turns[-2], 0.05
        ahead = ahead / np.linalg.norm(ahead)
    tightest = root(residual, turns[-1], np.array([0.0, 0.0, 0.0, 1.0, 1.0]))
    planes = np.zeros((165, 5))  # of equal yaw rates
    planes[:, 2], planes[:, 4] = 1.0, np.linspace(0.0, tightest[2], 165)
    rising = np.maximum.accumulate(np.array(turns)[:, 2])
    guess = [np.interp(planes[:, 4], rising, each) for each in np.transpose(turns)]
    speed, sway, yaw, rudder = (root(residual, np.stack(guess, -1), planes) * units).T
    if not np.isfinite(rudder).all():
        raise RuntimeError("the ship has no steady turn at 80 % of the rudder limit")
    with np.errstate(divide="ignore"):
        radius = np.hypot(speed, sway) / yaw
    return SteadyTurn(yaw, speed, sway, rudder, radius)


@cache
def secant_models(ship: CorvetteParameters, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Discrete ``A (k, 3, 3)`` and ``B (k, 3, 1)`` of (v, r, psi) for each of `steady_turns`.

    The linear model at service speed fails in a hard turn, where the ship has lost a third of its
    speed and most of the hull force is cross-flow drag. The secant model is the mean Jacobian on
    the ray from zero to the equilibrium of the commanded turn, at the speed of that turn (8-point
    Gauss-Legendre). It is exact at both ends.
    """
    turns = steady_turns(ship)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    mean: Any = 0.0
    for node, weight in zip(0.5 * (nodes + 1.0), 0.5 * weights, strict=True):
        drift = node * np.array([turns.sway, turns.yaw_rate, turns.rudder])
        mean = mean + weight * ship.jacobian(np.column_stack([turns.speed, *drift]))[:, 1:]
    A, B = np.zeros((len(mean), 3, 3)), np.zeros((len(mean), 3, 1))
    A[:, :2, :2], B[:, :2], A[:, 2, 1] = mean[..., 1:3], mean[..., 3:], 1.0
    return zero_order_hold(A, B, dt)


@cache
def surge_models(ship: CorvetteParameters, dt: float) -> np.ndarray:
    """Share ``(k,)`` of a deviation from each turn's speed that remains after a step."""
    turns = steady_turns(ship)
    moving = np.column_stack([turns.speed, turns.sway, turns.yaw_rate, turns.rudder])
    return np.exp(dt * ship.jacobian(moving)[:, 0, 0])


def linear_matrices(
    ship: CorvetteParameters, dt: float, inputs: int = 2
) -> tuple[Schedule, Schedule]:
    """A and B of (v, r, psi) for the commanded turn, as schedules of the known input u.

    Args:
        ship: Parameters of the ship.
        dt: Time step [s].
        inputs: Number of components of ``u = (rudder, commanded yaw rate, ...)``; the rudder alone
            moves the ship.
    """
    # turns to port mirror those to starboard
    A, B = (np.concatenate([each[:0:-1], each]) for each in secant_models(ship, dt))
    middle, scale = len(A) // 2 + 0.5, 1.0 / steady_turns(ship).yaw_rate[1]
    B = np.pad(B, ((0, 0), (0, 0), (0, inputs - 1)))
    return Schedule(A, 1, scale, middle), Schedule(B, 1, scale, middle)


# --- propulsion -----------------------------------------------------------------------------------


def propulsion(
    state: np.ndarray, rudder: np.ndarray, coefficients: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Load of the propellers and added resistance of steering ``(...)``, as shares of a thrust.

    The unit is the thrust on a straight course at service speed. The load is the thrust in the
    surge equation, and the added resistance is the rudder's drag with the centripetal terms of
    drift and turning (Norrbin 1972). On a straight course at service speed in calm water the load
    is 1 and the added resistance 0.

    Args:
        state: ``(..., 8)``, `vessel_gym.vehicles.corvette_equations.STATE`.
        rudder: ``(...)`` rad.
        coefficients: ``(..., k)``, `vessel_gym.vehicles.corvette_equations.COEFFICIENTS`.
    """
    (u, v, r), c = (
        np.moveaxis(state[..., 3:6], -1, 0),
        Coefficients(*np.moveaxis(coefficients, -1, 0)),
    )
    load, force, sin_rudder, _ = propelled_rudder(u, v, r, rudder, c)
    turning = c.sway_inertia * v * r + c.sway_yaw_inertia * r * r
    return load, (force * sin_rudder - turning) / c.thrust


def straight_course(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed [m/s] and load of the propellers ``(...)`` on a straight course in calm water.

    They are the service speed and 1, unless ``mismatch`` has changed the ship's resistance: thrust
    and resistance then balance at another speed.

    Args:
        coefficients: ``(..., k)``, `vessel_gym.vehicles.corvette_equations.COEFFICIENTS`.
    """
    c = Coefficients(*np.moveaxis(coefficients, -1, 0))
    falling = c.thrust * c.thrust_rise / c.service_speed
    most = c.thrust * (1.0 + c.thrust_rise)
    root = np.sqrt(falling * falling + 4.0 * c.resistance * most)
    speed = (root - falling) / (2.0 * c.resistance)
    return speed, 1.0 + c.thrust_rise * (1.0 - speed / c.service_speed)


# --- sensors of its heading -----------------------------------------------------------------------


COMPASS = Sensor(
    # 0.11 deg
    "gyro compass", ("heading [rad]",), plain((2,)), (2e-3,), angles=(0,), gives=("psi",)
)  # fmt: skip


@compiled
def _increment(state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    """Yaw increment ``(..., 1)`` by waves and gusts over the step that has ended."""
    return exogenous[..., :1]


MOTION_UNIT = Sensor(
    "motion reference unit", ("wave-band yaw increment [rad]",), _increment, (1e-3,),  # 0.06 deg
    scale=(0.01,), gives=("yaw increment",),
)  # fmt: skip
