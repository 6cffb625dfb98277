"""Underwater vehicles in the vertical plane: surge, heave and pitch; the ITSUNUSA is one (data/itsunusa.toml).

Frames: x along the course, z down, body x forward and z down, origin at the centre of buoyancy. A positive stern plane
dives, as Prestero's (2001).

Sources: the EnKF-SR paper on this vehicle (eqs. 1-3) for dimensions and structure, with its misprints mended:
``u^2 u^2`` is u^2 delta_s, ``z_C(q)``, ``x_C(-q)`` and ``z_C(u + wq)`` have lost the dots of q and u, and
the pitch moment is a difference, no fraction. It prints no hydrodynamic coefficient. Prestero (2001) for the symbols;
Fossen (2011) for Kirchhoff's equations and the kinematics.
"""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numba import njit

from vessel_gym.compiled import gufunc
from vessel_gym.sensors import Instrument
from vessel_gym.vehicles.auv import AUV, VERTICAL, AUVParameters
from vessel_gym.vehicles.files import load

TRUTH = ("u", "w", "q", "x", "z", "theta", "current")
"""Truth state: velocity through the water [m/s], pitch rate [rad/s], position [m], pitch [rad], current along x
[m/s]."""

COEFFICIENTS = (
    "surge_mass", "heave_mass", "pitch_inertia", "mass_z_g", "heave_pitch",
    "inverse_uu", "inverse_uw", "inverse_uq", "inverse_ww", "inverse_wq", "inverse_qq",
    "X_uu", "Z_ww", "Z_qq", "M_ww", "M_qq", "Z_uw", "Z_uq", "M_uw", "M_uq", "Z_uuds", "M_uuds",
    "net_weight", "righting_moment",
)  # fmt: skip


@dataclass(frozen=True)
class ItsunusaParameters(AUVParameters):
    """Particulars of a vehicle in the vertical plane, SI units."""

    def vector(self, factors: np.ndarray | None = None) -> np.ndarray:
        """The coefficients of the compiled equations ``(..., k)``, in the order of `COEFFICIENTS`.

        Args:
            factors: ``(..., 7)`` on the first `VERTICAL` of the uncertain ones, 1 if not given.
        """
        return self.stacked(COEFFICIENTS, np.ones(VERTICAL) if factors is None else factors)


@njit(cache=True)
def _derivative(
    s: np.ndarray | tuple[float, ...], stern: float, thrust: float, current: float, c: np.ndarray
) -> tuple[float, ...]:
    """Eqs. (1)-(3), with lift on |u| and fins on u |u|, so that hull and fins also brake a vehicle going astern."""
    u, w, q, theta = s[0], s[1], s[2], s[5]
    mu, mw, S, d = c[0], c[1], c[3], c[4]
    uu, uw, uq, ww, wq, qq = c[5], c[6], c[7], c[8], c[9], c[10]
    X_uu, Z_ww, Z_qq, M_ww, M_qq = c[11], c[12], c[13], c[14], c[15]
    Z_uw, Z_uq, M_uw, M_uq, Z_stern, M_stern = c[16], c[17], c[18], c[19], c[20], c[21]
    net_weight, righting = c[22], c[23]
    sin_theta, cos_theta = np.sin(theta), np.cos(theta)
    # Kirchhoff: the momentum of body and water holds the brackets and all added-mass terms of the printed equations.
    Px, Pz = mu * u + S * q, mw * w + d * q
    U, W, Q = abs(u), w * abs(w), q * abs(q)
    inflow = u * U
    X = -Pz * q - net_weight * sin_theta + X_uu * inflow + thrust
    Z = (
        Px * q + net_weight * cos_theta
        + Z_ww * W + Z_qq * Q + U * (Z_uw * w + Z_uq * q) + Z_stern * inflow * stern
    )  # fmt: skip
    M = (
        Pz * u - Px * w - righting * sin_theta
        + M_ww * W + M_qq * Q + U * (M_uw * w + M_uq * q) + M_stern * inflow * stern
    )  # fmt: skip
    return (
        uu * X + uw * Z + uq * M, uw * X + ww * Z + wq * M, uq * X + wq * Z + qq * M,
        u * cos_theta + w * sin_theta + current, w * cos_theta - u * sin_theta, q,
    )  # fmt: skip


@njit(cache=True)
def _moved(s: tuple[float, ...], h: float, rate: tuple[float, ...]) -> tuple[float, ...]:
    return (
        s[0] + h * rate[0], s[1] + h * rate[1], s[2] + h * rate[2],
        s[3] + h * rate[3], s[4] + h * rate[4], s[5] + h * rate[5],
    )  # fmt: skip


@gufunc("void(float64[:], float64[:], float64[:], float64[:])", "(n),(m),(k)->(n)")
def itsunusa_derivative(state: np.ndarray, control: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
    """Time derivative of the truth state, the current constant; control is (stern plane, thrust)."""
    out[0], out[1], out[2], out[3], out[4], out[5] = _derivative(state, control[0], control[1], state[6], c)
    out[6] = 0.0


@gufunc("void(float64[:], float64[:], float64[:], float64, int64, float64[:])", "(n),(m),(k),(),()->(n)")
def itsunusa_step(
    state: np.ndarray, control: np.ndarray, c: np.ndarray, dt: float, substeps: int, out: np.ndarray
) -> None:
    """RK4 over ``dt``, the current constant; control is (stern plane, thrust) at the start, then at the end.

    Actuators move linearly within the step, so that the fins' rate limit is integrated exactly.
    """
    current = state[6]
    h = dt / substeps
    s: tuple[float, ...] = (state[0], state[1], state[2], state[3], state[4], state[5])
    stern, thrust = control[0], control[1]
    # what they move in half a substep
    d_stern, d_thrust = 0.5 * (control[2] - stern) / substeps, 0.5 * (control[3] - thrust) / substeps
    for i in range(substeps):
        sigma, force = stern + 2 * i * d_stern, thrust + 2 * i * d_thrust
        k1 = _derivative(s, sigma, force, current, c)
        sigma, force = sigma + d_stern, force + d_thrust
        k2 = _derivative(_moved(s, 0.5 * h, k1), sigma, force, current, c)
        k3 = _derivative(_moved(s, 0.5 * h, k2), sigma, force, current, c)
        k4 = _derivative(_moved(s, h, k3), sigma + d_stern, force + d_thrust, current, c)
        s = _moved(_moved(_moved(_moved(s, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)
    out[0], out[1], out[2], out[3], out[4], out[5] = s
    out[6] = current


@gufunc("void(float64[:], float64[:], float64[:])", "(n),(p)->(p)")
def itsunusa_readings(state: np.ndarray, template: np.ndarray, out: np.ndarray) -> None:
    """What perfect instruments read ``(6,)``, in their order; ``template (6,)`` only tells how many they are."""
    out[0] = state[0] + state[6] * np.cos(state[5])
    out[1] = state[1] + state[6] * np.sin(state[5])
    out[2], out[3], out[4], out[5] = state[4], state[5], state[2], state[3]


def inertia(c: np.ndarray) -> np.ndarray:
    """Inertia ``(..., 3, 3)`` of body and added mass for coefficients ``(..., k)``."""
    M = np.zeros(c.shape[:-1] + (3, 3))
    M[..., [0, 1, 2], [0, 1, 2]] = c[..., :3]
    M[..., [0, 1, 2, 2], [2, 2, 0, 1]] = c[..., [3, 4, 3, 4]]
    return M


def energy(state: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Kinetic energy of body and water and potential energy [J] of states ``(..., 7)``, ``(...)``.

    In water at rest, or seen from water that moves steadily.
    """
    nu, depth, theta = state[..., :3], state[..., 4], state[..., 5]
    net_weight, righting = c[..., COEFFICIENTS.index("net_weight")], c[..., COEFFICIENTS.index("righting_moment")]
    return 0.5 * np.vecdot(nu, np.matvec(inertia(c), nu)) - net_weight * depth - righting * np.cos(theta)


@dataclass(frozen=True)
class Itsunusa(AUV):
    """The vehicle in batches, as an environment uses it.

    Figures of the instruments are from public vehicle configurations.
    """

    body: ItsunusaParameters = field(default_factory=lambda: load("itsunusa", ItsunusaParameters))

    truth_names: ClassVar = TRUTH
    parameter_names: ClassVar = COEFFICIENTS
    action_names: ClassVar = ("stern plane", "thrust")
    instruments: ClassVar = (
        Instrument("Doppler log", ("u over ground", "w over ground"), (0.01, 0.01), dropout=0.10),
        Instrument("depth gauge", ("z",), (0.02,)),
        Instrument("inclinometer", ("theta",), (0.01,)),
        Instrument("gyroscope", ("q",), (0.005,)),
        Instrument("acoustic position", ("x",), (0.5,), period=20, dropout=0.10),
    )
    velocities: ClassVar = 3
    unknown_inputs: ClassVar = 4
    normals: ClassVar = VERTICAL
    state_angles: ClassVar = (5,)
    measurement_angles: ClassVar = (3,)

    def vector(self, factors: np.ndarray) -> np.ndarray:
        """Coefficients ``(..., k)`` with ``factors (..., 7)`` on the uncertain ones."""
        return self.body.vector(factors)

    def advance(self, truth: np.ndarray, control: np.ndarray, c: np.ndarray) -> np.ndarray:
        """A step of the equations of motion; control ``(..., 4)``: actuators before and after."""
        return itsunusa_step(truth, control, c, self.dt, self.substeps)

    def exact_readings(self, truth: np.ndarray) -> np.ndarray:
        """What perfect instruments read ``(..., 6)``."""
        return itsunusa_readings(truth, np.empty(6))

    def from_readings(
        self, readings: np.ndarray, previous: np.ndarray, interval: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State ``(..., 7)`` and unknown input ``(..., 4)`` from the readings alone, current and kicks as zero.

        Every component has an instrument but the current, so that nothing is differenced.

        Args:
            readings: ``(..., 6)``.
            previous: the readings before, not needed.
            interval: seconds between the two, not needed.
        """
        x = np.zeros(readings.shape[:-1] + (7,))
        x[..., [0, 1, 4, 5, 2, 3]] = readings
        return x, np.zeros(readings.shape[:-1] + (4,))
