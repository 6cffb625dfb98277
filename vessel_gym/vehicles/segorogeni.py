"""Underwater vehicles in six degrees of freedom; the Segorogeni ITS is one (data/segorogeni.toml).

Frames: North-East-Down, body x forward, y starboard, z down, origin at the centre of buoyancy. Positive rudder turns
to starboard (yaw rate r > 0), as on the corvette and against Prestero (2001); a positive stern plane dives, as his.

Sources: the EnKF paper on this vehicle (eqs. 1-10) for dimensions and structure; it prints no hydrodynamic coefficient,
and the inverse inertia matrix that it prints has negative eigenvalues. Prestero (2001) for its symbols; Fossen
(2011) for Kirchhoff's equations and the kinematics.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from vessel_gym.compiled import gufunc, inlined, sincos
from vessel_gym.sensors import Instrument
from vessel_gym.vehicles.auv import AUV, UNCERTAIN, AUVParameters
from vessel_gym.vehicles.files import load

TRUTH = (
    "u", "v", "w", "p", "q", "r", "x", "y", "z", "phi", "theta", "psi", "current north", "current east",
)  # fmt: skip
"""Truth state: velocity through the water [m/s], angular velocity [rad/s], position [m], Euler angles [rad] and current
[m/s]."""

COEFFICIENTS = (
    "surge_mass", "sway_mass", "heave_mass", "roll_inertia", "pitch_inertia", "yaw_inertia",
    "mass_z_g", "sway_yaw", "heave_pitch",
    "inverse_uu", "inverse_uw", "inverse_uq", "inverse_ww", "inverse_wq", "inverse_qq",
    "inverse_vv", "inverse_vp", "inverse_vr", "inverse_pp", "inverse_pr", "inverse_rr",
    "X_uu", "Y_vv", "Y_rr", "Z_ww", "Z_qq", "K_pp", "M_ww", "M_qq", "N_vv", "N_rr",
    "Y_uv", "Y_ur", "Z_uw", "Z_uq", "M_uw", "M_uq", "N_uv", "N_ur", "K_up",
    "Y_rudder", "N_rudder", "Z_uuds", "M_uuds", "propeller_torque",
    "net_weight", "righting_moment", "printed_kinematics",
)  # fmt: skip


@dataclass(frozen=True)
class SegorogeniParameters(AUVParameters):
    """Particulars of a vehicle in six degrees of freedom, SI units."""

    propeller_torque: float = 0.0  # m, torque per thrust
    printed_kinematics: bool = False  # eqs. 1-4 of the paper, which ignore roll and pitch

    TABLES: ClassVar = AUVParameters.TABLES | {
        "propulsion": (*AUVParameters.TABLES["propulsion"], "propeller_torque"),
    }

    def values(self, factors: np.ndarray) -> dict[str, Any]:
        """Everything that the equations of motion need, by name."""
        values = super().values(factors)
        return values | {
            "Y_rudder": -values["Y_uudr"],
            "N_rudder": -values["N_uudr"],
            "propeller_torque": self.propeller_torque,
            "printed_kinematics": float(self.printed_kinematics),
        }

    def vector(self, factors: np.ndarray | None = None) -> np.ndarray:
        """The coefficients of the compiled equations ``(..., k)``, in the order of `COEFFICIENTS`.

        Args:
            factors: ``(..., 10)`` on the `UNCERTAIN` ones, 1 if not given.
        """
        return self.stacked(COEFFICIENTS, np.ones(len(UNCERTAIN)) if factors is None else factors)


@inlined
def _accelerations(
    u: float, v: float, w: float, p: float, q: float, r: float, sin_phi: float, cos_phi: float, sin_theta: float,
    cos_theta: float, rudder: float, stern: float, thrust: float, c: np.ndarray,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Eqs. (5)-(10), with lift on |u| and fins on u |u|, so that hull and fins also brake a vehicle going astern.

    The fins' lift in roll, K_up, is not in print: without it the vehicle would roll for minutes after a push.
    """
    mu, mv, mw, Jp, Jq, Jr, S, e, d = c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8]
    uu, uw, uq, ww, wq, qq = c[9], c[10], c[11], c[12], c[13], c[14]
    vv, vp, vr, pp, pr, rr = c[15], c[16], c[17], c[18], c[19], c[20]
    X_uu, Y_vv, Y_rr, Z_ww, Z_qq = c[21], c[22], c[23], c[24], c[25]
    K_pp, M_ww, M_qq, N_vv, N_rr = c[26], c[27], c[28], c[29], c[30]
    Y_uv, Y_ur, Z_uw, Z_uq, M_uw, M_uq, N_uv, N_ur = c[31], c[32], c[33], c[34], c[35], c[36], c[37], c[38]
    K_up, Y_rudder, N_rudder, Z_stern, M_stern, torque = c[39], c[40], c[41], c[42], c[43], c[44]
    net_weight, righting = c[45], c[46]
    # Kirchhoff: the momentum of body and water, in axes that turn and move. It holds every bracket and
    # every added-mass term of the printed equations, X_wq to N_uv, and takes no energy to the last digit.
    Px, Py, Pz = mu * u + S * q, mv * v - S * p + e * r, mw * w + d * q
    Lx, Ly, Lz = Jp * p - S * v, Jq * q + S * u + d * w, Jr * r + e * v
    U, V, W, P, Q, R = abs(u), v * abs(v), w * abs(w), p * abs(p), q * abs(q), r * abs(r)
    inflow = u * U
    X = Py * r - Pz * q - net_weight * sin_theta + X_uu * inflow + thrust
    Y = (
        Pz * p - Px * r + net_weight * cos_theta * sin_phi
        + Y_vv * V + Y_rr * R + U * (Y_uv * v + Y_ur * r) + Y_rudder * inflow * rudder
    )  # fmt: skip
    Z = (
        Px * q - Py * p + net_weight * cos_theta * cos_phi
        + Z_ww * W + Z_qq * Q + U * (Z_uw * w + Z_uq * q) + Z_stern * inflow * stern
    )  # fmt: skip
    K = (
        Ly * r - Lz * q + Py * w - Pz * v - righting * cos_theta * sin_phi
        + K_pp * P + U * K_up * p - torque * thrust
    )  # fmt: skip
    M = (
        Lz * p - Lx * r + Pz * u - Px * w - righting * sin_theta
        + M_ww * W + M_qq * Q + U * (M_uw * w + M_uq * q) + M_stern * inflow * stern
    )  # fmt: skip
    N = (
        Lx * q - Ly * p + Px * v - Py * u
        + N_vv * V + N_rr * R + U * (N_uv * v + N_ur * r) + N_rudder * inflow * rudder
    )  # fmt: skip
    return (
        uu * X + uw * Z + uq * M, vv * Y + vp * K + vr * N, uw * X + ww * Z + wq * M,
        vp * Y + pp * K + pr * N, uq * X + wq * Z + qq * M, vr * Y + pr * K + rr * N,
    )  # fmt: skip


@inlined
def _derivative(
    s: np.ndarray | tuple[float, ...], rudder: float, stern: float, thrust: float, north: float, east: float,
    c: np.ndarray,
) -> tuple[float, ...]:  # fmt: skip
    u, v, w, p, q, r = s[0], s[1], s[2], s[3], s[4], s[5]
    (sin_phi, cos_phi), (sin_theta, cos_theta), (sin_psi, cos_psi) = sincos(s[9]), sincos(s[10]), sincos(s[11])
    du, dv, dw, dp, dq, dr = _accelerations(
        u, v, w, p, q, r, sin_phi, cos_phi, sin_theta, cos_theta, rudder, stern, thrust, c
    )
    if c[47] != 0.0:
        return (
            du, dv, dw, dp, dq, dr,
            u * cos_psi - v * sin_psi + north, u * sin_psi + v * cos_psi + east, w, 0.0, 0.0, r,
        )  # fmt: skip
    down = v * sin_phi + w * cos_phi
    ahead, aside = u * cos_theta + down * sin_theta, v * cos_phi - w * sin_phi
    # Euler angles have a pole at 90 deg of pitch: within 1 deg of it they turn at the rate of 1 deg.
    bounded = cos_theta if abs(cos_theta) > 0.0175 else (0.0175 if cos_theta >= 0.0 else -0.0175)
    turn = (q * sin_phi + r * cos_phi) / bounded
    return (
        du, dv, dw, dp, dq, dr,
        ahead * cos_psi - aside * sin_psi + north, ahead * sin_psi + aside * cos_psi + east,
        down * cos_theta - u * sin_theta, p + turn * sin_theta, q * cos_phi - r * sin_phi, turn,
    )  # fmt: skip


@inlined
def _moved(s: tuple[float, ...], h: float, rate: tuple[float, ...]) -> tuple[float, ...]:
    return (
        s[0] + h * rate[0], s[1] + h * rate[1], s[2] + h * rate[2], s[3] + h * rate[3], s[4] + h * rate[4],
        s[5] + h * rate[5], s[6] + h * rate[6], s[7] + h * rate[7], s[8] + h * rate[8], s[9] + h * rate[9],
        s[10] + h * rate[10], s[11] + h * rate[11],
    )  # fmt: skip


@gufunc("void(float64[:], float64[:], float64[:], float64[:])", "(n),(m),(k)->(n)")
def segorogeni_derivative(state: np.ndarray, control: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
    """Time derivative of the truth state, the current constant; control is (rudder, stern plane, thrust)."""
    rate = _derivative(state, control[0], control[1], control[2], state[12], state[13], c)
    out[0], out[1], out[2], out[3], out[4], out[5] = rate[0], rate[1], rate[2], rate[3], rate[4], rate[5]
    out[6], out[7], out[8], out[9], out[10], out[11] = rate[6], rate[7], rate[8], rate[9], rate[10], rate[11]
    out[12], out[13] = 0.0, 0.0


@inlined
def _substep(
    s: tuple[float, ...], i: int, h: float, rudder: float, stern: float, thrust: float, d_rudder: float,
    d_stern: float, d_thrust: float, north: float, east: float, c: np.ndarray,
) -> tuple[float, ...]:  # fmt: skip
    """RK4 over the ``i``-th ``h``; actuators at the start of the first, and what they move in half of each."""
    delta, sigma, force = rudder + 2 * i * d_rudder, stern + 2 * i * d_stern, thrust + 2 * i * d_thrust
    k1 = _derivative(s, delta, sigma, force, north, east, c)
    delta, sigma, force = delta + d_rudder, sigma + d_stern, force + d_thrust
    k2 = _derivative(_moved(s, 0.5 * h, k1), delta, sigma, force, north, east, c)
    k3 = _derivative(_moved(s, 0.5 * h, k2), delta, sigma, force, north, east, c)
    delta, sigma, force = delta + d_rudder, sigma + d_stern, force + d_thrust
    k4 = _derivative(_moved(s, h, k3), delta, sigma, force, north, east, c)
    return _moved(_moved(_moved(_moved(s, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)


@gufunc("void(float64[:], float64[:], float64[:], float64, int64, float64[:])", "(n),(m),(k),(),()->(n)")
def segorogeni_step(
    state: np.ndarray, control: np.ndarray, c: np.ndarray, dt: float, substeps: int, out: np.ndarray
) -> None:
    """RK4 over ``dt``, the current constant; control is (rudder, stern plane, thrust) at the start, then at the end.

    Actuators move linearly within the step, so that the fins' rate limit is integrated exactly.
    """
    north, east = state[12], state[13]
    s: tuple[float, ...] = (
        state[0], state[1], state[2], state[3], state[4], state[5],
        state[6], state[7], state[8], state[9], state[10], state[11],
    )  # fmt: skip
    rudder, stern, thrust = control[0], control[1], control[2]
    half = 0.5 / substeps
    d_rudder, d_stern = half * (control[3] - rudder), half * (control[4] - stern)
    d_thrust = half * (control[5] - thrust)
    for i in range(substeps):
        s = _substep(s, i, dt / substeps, rudder, stern, thrust, d_rudder, d_stern, d_thrust, north, east, c)
    out[0], out[1], out[2], out[3], out[4], out[5] = s[0], s[1], s[2], s[3], s[4], s[5]
    out[6], out[7], out[8], out[9], out[10], out[11] = s[6], s[7], s[8], s[9], s[10], s[11]
    out[12], out[13] = north, east


_LANES = 16  # states that are stepped side by side: a number that the compiler knows, to see that they are independent


@gufunc("void(float64[:, :], float64[:], float64[:], float64, int64, float64[:, :])", "(N,n),(m),(k),(),()->(N,n)")
def segorogeni_steps(
    states: np.ndarray, control: np.ndarray, c: np.ndarray, dt: float, substeps: int, out: np.ndarray
) -> None:
    """`segorogeni_step` of many states ``(N, 14)`` under one control: the same numbers, several times as fast."""
    rudder, stern, thrust = control[0], control[1], control[2]
    half = 0.5 / substeps
    d_rudder, d_stern = half * (control[3] - rudder), half * (control[4] - stern)
    d_thrust = half * (control[5] - thrust)
    a = np.empty((14, _LANES))
    for first in range(0, len(states), _LANES):
        size = min(_LANES, len(states) - first)
        for j in range(_LANES):
            for k in range(14):
                a[k, j] = states[first + min(j, size - 1), k]
        for i in range(substeps):
            for j in range(_LANES):
                s: tuple[float, ...] = (
                    a[0, j], a[1, j], a[2, j], a[3, j], a[4, j], a[5, j],
                    a[6, j], a[7, j], a[8, j], a[9, j], a[10, j], a[11, j],
                )  # fmt: skip
                s = _substep(
                    s, i, dt / substeps, rudder, stern, thrust, d_rudder, d_stern, d_thrust, a[12, j], a[13, j], c
                )
                a[0, j], a[1, j], a[2, j], a[3, j], a[4, j], a[5, j] = s[0], s[1], s[2], s[3], s[4], s[5]
                a[6, j], a[7, j], a[8, j], a[9, j], a[10, j], a[11, j] = s[6], s[7], s[8], s[9], s[10], s[11]
        for j in range(size):
            for k in range(14):
                out[first + j, k] = a[k, j]


@gufunc("void(float64[:], float64[:], float64[:])", "(n),(p)->(p)")
def segorogeni_readings(state: np.ndarray, template: np.ndarray, out: np.ndarray) -> None:
    """What perfect instruments read ``(12,)``, in their order; ``template (12,)`` only tells how many they are."""
    (sin_phi, cos_phi), (sin_theta, cos_theta) = sincos(state[9]), sincos(state[10])
    sin_psi, cos_psi = sincos(state[11])
    # the current ahead and to starboard of the heading
    ahead, aside = state[12] * cos_psi + state[13] * sin_psi, state[13] * cos_psi - state[12] * sin_psi
    out[0] = state[0] + ahead * cos_theta
    out[1] = state[1] + ahead * sin_theta * sin_phi + aside * cos_phi
    out[2] = state[2] + ahead * sin_theta * cos_phi - aside * sin_phi
    out[3] = state[8]
    out[4], out[5], out[6] = state[9], state[10], state[11]
    out[7], out[8], out[9] = state[3], state[4], state[5]
    out[10], out[11] = state[6], state[7]


def inertia(c: np.ndarray) -> np.ndarray:
    """Inertia ``(..., 6, 6)`` of body and added mass for coefficients ``(..., k)``."""
    M = np.zeros(c.shape[:-1] + (6, 6))
    diagonal = np.arange(6)
    M[..., diagonal, diagonal] = c[..., :6]
    for row, column, value in ((0, 4, c[..., 6]), (1, 3, -c[..., 6]), (1, 5, c[..., 7]), (2, 4, c[..., 8])):
        M[..., row, column] = M[..., column, row] = value
    return M


def energy(state: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Kinetic energy of body and water and potential energy [J] of states ``(..., 14)``, ``(...)``.

    In water at rest, or seen from water that moves steadily.
    """
    nu, depth = state[..., :6], state[..., 8]
    net_weight, righting = c[..., COEFFICIENTS.index("net_weight")], c[..., COEFFICIENTS.index("righting_moment")]
    upright = np.cos(state[..., 9]) * np.cos(state[..., 10])
    return 0.5 * np.vecdot(nu, np.matvec(inertia(c), nu)) - net_weight * depth - righting * upright


@dataclass(frozen=True)
class Segorogeni(AUV):
    """The vehicle in batches, as an environment uses it.

    Figures of the instruments are from public vehicle configurations.
    """

    body: SegorogeniParameters = field(default_factory=lambda: load("segorogeni", SegorogeniParameters))

    truth_names: ClassVar = TRUTH
    parameter_names: ClassVar = COEFFICIENTS
    action_names: ClassVar = ("rudder", "stern plane", "thrust")
    instruments: ClassVar = (
        Instrument("Doppler log", ("u over ground", "v over ground", "w over ground"), (0.01,) * 3, dropout=0.10),
        Instrument("depth gauge", ("z",), (0.02,)),
        Instrument("attitude", ("phi", "theta", "psi"), (0.01, 0.01, 0.03)),
        Instrument("gyroscope", ("p", "q", "r"), (0.005,) * 3),
        Instrument("acoustic position", ("x", "y"), (0.5, 0.5), period=20, dropout=0.10),
    )
    velocities: ClassVar = 6
    unknown_inputs: ClassVar = 8
    normals: ClassVar = len(UNCERTAIN)
    state_angles: ClassVar = (9, 10, 11)
    measurement_angles: ClassVar = (4, 5, 6)

    def vector(self, factors: np.ndarray) -> np.ndarray:
        """Coefficients ``(..., k)`` with ``factors (..., 10)`` on the uncertain ones."""
        return self.body.vector(factors)

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Truth ``(B, 14)`` and actuators ``(B, 3)`` from the state: 5 deg of rudder, as in the paper."""
        truth, actuators = super().start(x)
        actuators[:, 0] = np.deg2rad(5.0)
        return truth, actuators

    def advance(self, truth: np.ndarray, control: np.ndarray, c: np.ndarray) -> np.ndarray:
        """A step of the equations of motion; control ``(..., 6)``: actuators before and after."""
        if truth.ndim > 1 and control.shape[-2:-1] == (1,) and c.ndim == 1:  # an ensemble's members share both
            return segorogeni_steps(truth, control[..., 0, :], c, self.dt, self.substeps)
        return segorogeni_step(truth, control, c, self.dt, self.substeps)

    def exact_readings(self, truth: np.ndarray) -> np.ndarray:
        """What perfect instruments read ``(..., 12)``."""
        return segorogeni_readings(truth, np.empty(12))

    def from_readings(
        self, readings: np.ndarray, previous: np.ndarray, interval: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State ``(..., 14)`` and unknown input ``(..., 8)`` from the readings alone, current and kicks as zero.

        Every component has an instrument but the current, so that nothing is differenced.

        Args:
            readings: ``(..., 12)``.
            previous: the readings before, not needed.
            interval: seconds between the two, not needed.
        """
        x = np.zeros(readings.shape[:-1] + (14,))
        x[..., [0, 1, 2, 8, 9, 10, 11, 3, 4, 5, 6, 7]] = readings
        return x, np.zeros(readings.shape[:-1] + (8,))
