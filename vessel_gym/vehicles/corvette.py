"""A SIGMA-class corvette as an environment uses it: its steady turns, the models that filters use, the vehicle.

Its particulars and equations of motion, with their frames and sources: `vessel_gym.vehicles.corvette_equations`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np
from scipy.optimize import root

from estimators import LinearModel, NonlinearModel, wrap, zero_order_hold
from estimators.checks import shown
from vessel_gym.disturbances import Sea
from vessel_gym.sensors import Instrument, nominal_sd
from vessel_gym.vehicles.corvette_equations import (
    COEFFICIENTS,
    TRUTH,
    UNCERTAIN,
    CorvetteParameters,
    corvette_rates,
    corvette_step,
)

_CALM = np.zeros(2)  # no current


@dataclass(frozen=True, eq=False)
class SteadyTurn:
    """Steady turns at rising yaw rates: what helm, speed and drift hold them, shape ``(k,)`` each."""

    yaw_rate: np.ndarray  # rad/s
    speed: np.ndarray  # surge, m/s
    sway: np.ndarray  # m/s
    rudder: np.ndarray  # rad
    radius: np.ndarray  # m, of the track; infinite for the straight course


@cache
def steady_turns(ship: CorvetteParameters, points: int = 165) -> SteadyTurn:
    """Steady turns at equal steps of yaw rate, up to the one that 80 % of the rudder holds.

    Beyond, the yaw rate hardly rises with the rudder any more, and a command there could not be steered to.

    Raises:
        RuntimeError: if the ship has no steady turns (it is directionally unstable).
    """
    c, scale = ship.vector(), np.array([ship.speed, ship.speed, ship.speed / ship.length])

    def accelerations(motion: np.ndarray, rudder: float) -> np.ndarray:
        state = np.concatenate([np.zeros(3), motion])
        return corvette_rates(state, np.array([rudder]), _CALM, c)[3:] / scale

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
    c = ship.vector()
    state, rudder = np.asarray(state, float), np.asarray(rudder, float)
    points = np.concatenate([state, rudder[..., None]], -1)  # (u, v, r, rudder)
    step = np.array([1e-6, 1e-8, 1e-6])
    offsets = np.zeros((3, 4))
    offsets[[0, 1, 2], [1, 2, 3]] = step

    def rates(p: np.ndarray) -> np.ndarray:
        full = np.zeros(p.shape[:-1] + (6,))
        full[..., 3:] = p[..., :3]
        return corvette_rates(full, p[..., 3:], _CALM, c)[..., 4:]

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


def linear_model(
    ship: CorvetteParameters, dt: float, Q: np.ndarray, R: np.ndarray, kind: str = "corrected"
) -> LinearModel:
    """The model that the linear filters use: x = (v, r, psi), y = (compass, wave-band yaw increment).

    ``psi+ = psi + dt r + d + w``, ``y1 = psi + d + v1``, ``y2 = d + v2``: d is what waves and gusts do to
    the heading in one step, and a motion reference unit gives it in its own noise (eq. 4.5).

    The known input is ``u = (rudder, commanded yaw rate)``; A and B follow the commanded turn by
    `secant_models`.

    Args:
        ship: Parameters.
        dt: Step [s].
        Q: ``(3, 3)`` process noise covariance.
        R: ``(2, 2)`` measurement noise covariance.
        kind: ``"corrected"``, or ``"as-printed"`` for eq. 4.3 of the thesis to the digit, kept for
            reproduction: it is neither the ship's nor dimensionally consistent.
    """
    C = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    G = np.array([[0.0], [0.0], [1.0]])
    H = np.array([[1.0], [1.0]])
    angles = {"state_angles": (2,), "measurement_angles": (0,)}
    if kind == "as-printed":
        A = np.array([[0.4159, 0.1811, 0.0], [5.4795e-10, 1.0, 0.0], [0.0, 0.5, 1.0]])
        B = np.array([[-2.6189e-7, 0.0], [2.4075e-7, 0.0], [0.0, 0.0]])
        return LinearModel(A, C, Q, R, B=B, G=G, H=H, **angles)
    if kind != "corrected":
        raise ValueError(
            f"unknown filter model {shown(kind)}: choose corrected or as-printed, or nonlinear for a nonlinear filter"
        )
    A_table, B_table = secant_models(ship, dt)
    A_table = np.concatenate([A_table[:0:-1], A_table])  # the same turn to port
    B_table = np.concatenate([B_table[:0:-1], B_table])
    B_table = np.concatenate([B_table, np.zeros_like(B_table)], -1)
    middle, scale = len(A_table) // 2 + 0.5, 1.0 / steady_turns(ship).yaw_rate[1]

    def follow(table: np.ndarray) -> Callable[[np.ndarray | None], np.ndarray]:
        def matrix(u: np.ndarray | None) -> np.ndarray:
            if u is None:
                raise ValueError("the corrected model needs u = (rudder, commanded yaw rate)")
            return table.take((u[..., 1] * scale + middle).astype(np.intp), axis=0, mode="clip")

        return matrix

    return LinearModel(follow(A_table), C, Q, R, B=follow(B_table), G=G, H=H, **angles)


def nonlinear_model(ship: CorvetteParameters, dt: float, Q: np.ndarray, R: np.ndarray) -> NonlinearModel:
    """The ship's own equations for nonlinear filters: x = (v, r, psi, u), otherwise as `linear_model`.

    Args:
        ship: Parameters.
        dt: Step [s].
        Q: ``(4, 4)`` process noise covariance.
        R: ``(2, 2)`` measurement noise covariance.
    """
    c = ship.vector()

    def transition(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        assert u is not None
        state = np.zeros(x.shape[:-1] + (6,))
        state[..., 2], state[..., 3], state[..., 4], state[..., 5] = x[..., 2], x[..., 3], x[..., 0], x[..., 1]
        return corvette_step(state, u[..., [0, 0]], _CALM, c, dt, 1)[..., [4, 5, 2, 3]]

    def measurement(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        reading = np.zeros(x.shape[:-1] + (2,))
        reading[..., 0] = x[..., 2]
        return reading

    G = np.array([[0.0], [0.0], [1.0], [0.0]])
    H = np.array([[1.0], [1.0]])
    return NonlinearModel(transition, measurement, Q, R, G=G, H=H, state_angles=(2,), measurement_angles=(0,))


# --- the vehicle ----------------------------------------------------------


@dataclass(frozen=True)
class Corvette:
    """The ship in batches: actuator, truth, exact readings, filter models.

    The action is the rudder *rate*: with an angle as action, the estimate's noise would saturate
    the steering gear.
    """

    ship: CorvetteParameters = field(default_factory=CorvetteParameters)
    dt: float = 0.5  # s
    substeps: int = 1  # one RK4 step of 0.5 s is converged to 0.002 %

    truth_names = TRUTH
    parameter_names = COEFFICIENTS
    action_names = ("rudder rate",)
    instruments = (
        Instrument("gyro compass", ("heading [rad]",), (2e-3,)),  # 0.11 deg
        Instrument("motion reference unit", ("wave-band yaw increment [rad]",), (1e-3,)),  # 0.06 deg
    )
    unknown_inputs = 1
    process_sd = np.array([0.08, 1.5e-3, 1e-4, 0.05])  # of (v, r, psi, u) a step: what the models leave out
    normals = len(UNCERTAIN)
    """Normal numbers that `parameters` needs."""

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """Coefficients ``(B, k)`` of the truth: the filter's, with a relative spread on the uncertain ones."""
        c = np.tile(self.ship.vector(), (len(normals), 1))
        c[:, UNCERTAIN] *= 1.0 + mismatch * np.clip(normals, -2.0, 2.0)
        return c

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Truth ``(B, 6)`` and actuators ``(B, 1)`` from (v, r, psi, u)."""
        truth = np.zeros((len(x), 6))
        truth[:, [4, 5, 2, 3]] = x
        return truth, np.zeros((len(x), 1))

    def filter_state(self, truth: np.ndarray, n: int = 4) -> np.ndarray:
        """The part of the truth that filters estimate: (v, r, psi) and, for n = 4, u."""
        return truth[..., [4, 5, 2, 3][:n]]

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """The rudder ``(B, 1)`` after a step of rudder rate ``action`` in [-1, 1]."""
        limit = self.ship.rudder_limit
        return np.minimum(np.maximum(actuators + (self.ship.rudder_rate * self.dt) * action, -limit), limit)

    def step(
        self,
        truth: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        forcing: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:
        """The truth one step later; forcing is (yaw kick d of waves and gusts, current north, current east)."""
        control = np.concatenate([before, after], -1)
        truth = corvette_step(truth, control, forcing[:, 1:], parameters, self.dt, self.substeps)
        truth[:, 2] += forcing[:, 0]
        return truth

    def readings(self, truth: np.ndarray, forcing: np.ndarray) -> np.ndarray:
        """What perfect sensors would read ``(B, 2)``: compass and yaw increment (eq. 4.5)."""
        exact = np.empty((len(truth), 2))
        exact[:, 0] = truth[:, 2] + forcing[:, 0]
        exact[:, 1] = forcing[:, 0]
        return exact

    def model(self, kind: str, noise: float, sea: Sea) -> LinearModel | NonlinearModel:
        """The filter's model: ``"corrected"``, ``"as-printed"`` or ``"nonlinear"``.

        Args:
            kind: which one.
            noise: standard deviation of the readings relative to nominal.
            sea: not used: what a filter knows of d is an option of its own.
        """
        R = np.diag((noise * nominal_sd(self.instruments)) ** 2)
        Q = np.diag(self.process_sd**2)
        if kind == "nonlinear":
            return nonlinear_model(self.ship, self.dt, Q, R)
        return linear_model(self.ship, self.dt, Q[:3, :3], R, kind)

    def from_readings(
        self, readings: np.ndarray, previous: np.ndarray, interval: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(v, r, psi) and d from two successive sets of readings: no model, the compass differenced.

        Args:
            readings: ``(..., 2)``.
            previous: ``(..., 2)`` the readings before.
            interval: ``(..., 2)`` seconds between the two.
        """
        change = wrap(readings[..., 0] - previous[..., 0])
        x = np.zeros(readings.shape[:-1] + (3,))
        x[..., 1] = change / interval[..., 0]
        x[..., 2] = readings[..., 0]
        return x, readings[..., 1:2]
