"""A SIGMA-class corvette as an environment uses it: its steady turns, the models that filters use, the vehicle.

Its particulars and equations of motion, with their frames and sources: `vessel_gym.vehicles.corvette_equations`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import root

from estimators import Schedule, zero_order_hold
from estimators.checks import finite_array, whole
from vessel_gym.checks import check_numbers, instance
from vessel_gym.processes import interpolated, linear
from vessel_gym.sensors import Sensor
from vessel_gym.vehicles.actuators import Actuator, figures
from vessel_gym.vehicles.corvette_equations import (
    AROUND,
    COEFFICIENTS,
    STATE,
    UNCERTAIN,
    CorvetteParameters,
    corvette_rates,
)
from vessel_gym.vehicles.files import check_vehicle, load
from vessel_gym.vehicles.integration import runge_kutta
from vessel_gym.vehicles.whole_state import Simulated

_CALM = np.zeros(len(AROUND))  # no current, no forces


@dataclass(frozen=True, eq=False)
class SteadyTurn:
    """Steady turns at rising yaw rates: what helm, speed and drift hold them, shape ``(k,)`` each."""

    yaw_rate: np.ndarray  # rad/s
    speed: np.ndarray  # surge, m/s
    sway: np.ndarray  # m/s
    rudder: np.ndarray  # rad
    radius: np.ndarray  # m, of the track; infinite for the straight course

    def interpolated(self, values: np.ndarray, yaw_rate: np.ndarray) -> np.ndarray:
        """Values ``(k,)`` of each turn, linearly interpolated at yaw rates ``(...)`` to either side."""
        return interpolated(values, np.minimum(np.abs(yaw_rate) / self.yaw_rate[1], len(values) - 1.0))


@cache
def steady_turns(ship: CorvetteParameters, points: int = 165) -> SteadyTurn:
    """Steady turns at equal steps of yaw rate, up to the one that 80 % of the rudder holds.

    Beyond, the yaw rate hardly rises with the rudder any more, and a command there could not be steered to.

    Raises:
        RuntimeError: if the ship has no steady turns (it is directionally unstable).
    """
    instance("ship of steady_turns", ship, CorvetteParameters)
    whole("points of steady_turns", points, 2)
    c, scale = ship.vector(), np.array([ship.speed, ship.speed, ship.speed / ship.length])

    def accelerations(motion: np.ndarray, rudder: float) -> np.ndarray:
        state = np.concatenate([np.zeros(3), motion, np.zeros(2)])
        return corvette_rates(state, np.array([rudder]), _CALM, c)[3:6] / scale

    def held_rudder(z: np.ndarray, rudder: float) -> np.ndarray:
        return accelerations(z * scale, rudder)

    def held_rate(z: np.ndarray, rate: float) -> np.ndarray:
        return accelerations(np.array([z[0] * scale[0], z[1] * scale[1], rate]), z[2])

    def solve(residual: Callable[[np.ndarray], np.ndarray], guess: np.ndarray) -> np.ndarray:
        found = root(residual, guess, tol=1e-13)
        if np.abs(found.fun).max() > 1e-9:
            raise RuntimeError("the ship has no steady turn at a rudder that it should hold")
        return found.x

    motion = np.array([1.0, 0.0, 0.0])  # surge, sway, yaw rate in units of scale
    for rudder in np.linspace(0.0, 0.8 * ship.rudder_limit, 57):
        motion = solve(partial(held_rudder, rudder=rudder), motion)
    rates = np.linspace(0.0, motion[2] * scale[2], points)
    solutions = np.empty((points, 3))  # surge, sway, rudder
    guess = np.array([1.0, 0.0, 0.0])
    for i, rate in enumerate(rates):
        guess = solve(partial(held_rate, rate=rate), guess)
        solutions[i] = guess * [scale[0], scale[1], 1.0]
    speed, sway, rudder = solutions.T
    with np.errstate(divide="ignore"):
        radius = np.hypot(speed, sway) / rates
    return SteadyTurn(rates, speed, sway, rudder, radius)


def sway_yaw_jacobian(state: np.ndarray, rudder: np.ndarray, ship: CorvetteParameters) -> tuple[np.ndarray, np.ndarray]:
    """d(v', r')/d(v, r) ``(..., 2, 2)`` and d(v', r')/d(rudder) ``(..., 2, 1)`` at ``(u, v, r)``.

    Central differences of the compiled equations: the linear models cannot drift away from the truth.
    """
    instance("ship of sway_yaw_jacobian", ship, CorvetteParameters)
    c = ship.vector()
    state, rudder = finite_array("state", state, "...", 3), finite_array("rudder", rudder, "...")
    points = np.concatenate([state, rudder[..., None]], -1)  # (u, v, r, rudder)
    step = np.array([1e-6, 1e-8, 1e-6])
    offsets = np.zeros((3, 4))
    offsets[[0, 1, 2], [1, 2, 3]] = step

    def rates(p: np.ndarray) -> np.ndarray:
        full = np.zeros(p.shape[:-1] + (len(STATE),))
        full[..., 3:6] = p[..., :3]
        return corvette_rates(full, p[..., 3:], _CALM, c)[..., 4:6]

    difference = rates(points[..., None, :] + offsets) - rates(points[..., None, :] - offsets)
    jacobian = np.swapaxes(difference / (2.0 * step[:, None]), -1, -2)
    return jacobian[..., :2], jacobian[..., 2:]


@cache
def secant_models(ship: CorvetteParameters, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Discrete ``A (k, 3, 3)`` and ``B (k, 3, 1)`` of (v, r, psi) for each of `steady_turns`.

    The linear model at the service speed is badly wrong in a hard turn, where the ship has lost a third of
    its speed and most of the hull force is cross-flow drag. The secant model is the mean Jacobian
    on the ray from zero to the commanded turn's equilibrium, at that turn's speed (8-point
    Gauss-Legendre): it is exact at both ends.
    """
    instance("ship of secant_models", ship, CorvetteParameters)
    check_numbers("secant_models", {"dt": dt}, positive="dt")
    turns = steady_turns(ship)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    A = np.zeros((len(turns.yaw_rate), 3, 3))
    B = np.zeros((len(turns.yaw_rate), 3, 1))
    for node, weight in zip(0.5 * (nodes + 1.0), 0.5 * weights, strict=True):
        state = np.stack([turns.speed, node * turns.sway, node * turns.yaw_rate], -1)
        a, b = sway_yaw_jacobian(state, node * turns.rudder, ship)
        A[:, :2, :2] += weight * a
        B[:, :2] += weight * b
    A[:, 2, 1] = 1.0
    return zero_order_hold(A, B, dt)


@cache
def surge_models(ship: CorvetteParameters, dt: float) -> np.ndarray:
    """Share of a deviation from the speed of each of `steady_turns` that is left after a step ``(k,)``."""
    instance("ship of surge_models", ship, CorvetteParameters)
    check_numbers("surge_models", {"dt": dt}, positive="dt")
    turns, c, step = steady_turns(ship), ship.vector(), 1e-4
    zero = np.zeros(len(turns.speed))

    def surge(speed: np.ndarray) -> np.ndarray:
        state = np.stack([zero, zero, zero, speed, turns.sway, turns.yaw_rate, zero, zero], -1)
        return corvette_rates(state, turns.rudder[:, None], _CALM, c)[:, 3]

    return np.exp(dt * (surge(turns.speed + step) - surge(turns.speed - step)) / (2.0 * step))


AS_PRINTED = (
    np.array([[0.4159, 0.1811, 0.0], [5.4795e-10, 1.0, 0.0], [0.0, 0.5, 1.0]]),
    np.array([[-2.6189e-7, 0.0], [2.4075e-7, 0.0], [0.0, 0.0]]),
)
"""A and B of eq. 4.3 of the thesis to the digit, kept for reproduction: neither the ship's nor consistent in units."""


def linear_matrices(ship: CorvetteParameters, dt: float) -> tuple[Schedule, Schedule]:
    """A and B of (v, r, psi) as functions of ``u = (rudder, commanded yaw rate)``: they follow the commanded turn.

    Args:
        ship: Parameters.
        dt: Step [s].
    """
    instance("ship of linear_matrices", ship, CorvetteParameters)
    A_table, B_table = secant_models(ship, dt)
    A_table = np.concatenate([A_table[:0:-1], A_table])  # the same turn to port
    B_table = np.concatenate([B_table[:0:-1], B_table])
    B_table = np.concatenate([B_table, np.zeros_like(B_table)], -1)
    middle, scale = len(A_table) // 2 + 0.5, 1.0 / steady_turns(ship).yaw_rate[1]

    return Schedule(A_table, 1, scale, middle), Schedule(B_table, 1, scale, middle)


# --- the vehicle as an environment uses it ----------------------------------------------------------


@linear
def _compass(state: np.ndarray, forcing: np.ndarray) -> np.ndarray:
    """The heading with what waves and gusts do to it over the step ``(..., 1)`` (eq. 4.5)."""
    return state[..., 2:3] + forcing[..., :1]


@linear
def _motion(state: np.ndarray, forcing: np.ndarray) -> np.ndarray:
    """Change of the heading by waves and gusts over the step ``(..., 1)``."""
    return forcing[..., :1]


COMPASS = Sensor("gyro compass", ("heading [rad]",), _compass, (2e-3,), angles=(0,), gives=("psi",))  # 0.11 deg
MOTION_UNIT = Sensor(
    "motion reference unit", ("wave-band yaw increment [rad]",), _motion, (1e-3,),  # 0.06 deg
    scale=(0.01,), gives=("yaw increment",),
)  # fmt: skip


@dataclass(frozen=True)
class Corvette(Simulated):
    """The ship as the thesis has it, in batches: actuator, state, sensors, and what filters know.

    The action is the rudder *rate*: with an angle as action, the estimate's noise would saturate
    the steering gear.

    Linear filters estimate (v, r, psi), nonlinear ones u besides; their known input is ``u = (rudder, commanded yaw
    rate)``. With d the yaw increment that waves and gusts give in a step, ``psi+ = psi + dt r + d``, ``y1 = psi + d``
    and ``y2 = d``: a motion reference unit gives it in its own noise (eq. 4.5).
    """

    ship: CorvetteParameters = field(default_factory=lambda: load("corvette-thesis", CorvetteParameters))
    dt: float = 0.5  # s
    substeps: int = 1  # one RK4 step of 0.5 s is converged to 0.002 %

    def __post_init__(self) -> None:
        check_vehicle(self, "ship", CorvetteParameters)

    state_names = STATE
    equations = staticmethod(corvette_rates)
    angles = ("psi",)
    parameter_names = COEFFICIENTS
    action_names = ("rudder rate",)
    kicks = ("yaw increment",)
    kicked = ("psi",)
    flows = AROUND
    sensors = (COMPASS, MOTION_UNIT)
    kinds: ClassVar[tuple[str, ...]] = ("nonlinear", "corrected", "as-printed")
    linear_kinds: ClassVar[tuple[str, ...]] = ("corrected", "as-printed")
    rates: ClassVar = {"r": "psi"}
    normals = len(UNCERTAIN)
    """Normal numbers that `parameters` needs."""

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """Coefficients ``(B, k)`` of the truth: the filter's, with a relative spread on the uncertain ones."""
        c = np.tile(self.ship.vector(), (len(normals), 1))
        c[:, UNCERTAIN] *= 1.0 + mismatch * np.clip(normals, -2.0, 2.0)
        return c

    @property
    def process_sd(self) -> np.ndarray:
        """Of (v, r, psi, u) in a step: what the models leave out; a ship that turns in more time changes less fast."""
        return np.array([0.08, 1.5e-3 * 0.5 / self.dt, 1e-4, 0.05])

    def estimated(self, kind: str) -> tuple[str, ...]:
        """(v, r, psi), and u in the nonlinear model."""
        return ("v", "r", "psi", "u") if kind == "nonlinear" else ("v", "r", "psi")

    def _placed(self, x: np.ndarray) -> np.ndarray:
        """The state ``(..., 8)`` out of (v, r, psi, u), at the origin and upright."""
        v, r, psi, u = np.moveaxis(x, -1, 0)
        zero = np.zeros_like(v)
        return np.stack([zero, zero, psi, u, v, r, zero, zero], -1)

    @property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """Straight on at service speed."""
        return np.array([0.0, 0.0, 0.0, self.ship.speed]), np.zeros(2)

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State ``(..., 8)`` and actuators ``(..., 1)`` from what is estimated."""
        return self._placed(x), np.zeros((*x.shape[:-1], 1))

    @cached_property
    def _actuators(self) -> np.ndarray:
        return figures(Actuator(self.ship.rudder_rate * self.dt, kept=1.0, limit=self.ship.rudder_limit))

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """Estimated components one step later under ``u = (rudder, ...)``, constant over the step."""
        rudder = u[..., :1]
        moved = runge_kutta(corvette_rates, self._placed(x), rudder, rudder, flow, self._nominal, self.dt)
        return moved[..., [STATE.index(name) for name in self.estimated("nonlinear")]]

    @cached_property
    def _nominal(self) -> np.ndarray:
        """The coefficients that filters know ``(k,)``."""
        return self.ship.vector()

    def known_input(self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None) -> np.ndarray:
        """The mean rudder over a step, and the commanded yaw rate, or that of the steady turn which it holds."""
        rudder = 0.5 * (before + after)
        if commanded is None:
            turns = steady_turns(self.ship)
            commanded = np.copysign(np.interp(np.abs(rudder), turns.rudder, turns.yaw_rate), rudder)
        return np.concatenate([rudder, commanded], -1)

    def linear(self, kind: str) -> tuple[Any, ...]:
        """A and B of (v, r, psi): ``"corrected"`` (see `linear_matrices`) or ``"as-printed"``."""
        return AS_PRINTED if kind == "as-printed" else linear_matrices(self.ship, self.dt)
