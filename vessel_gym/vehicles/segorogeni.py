"""Underwater vehicles in six degrees of freedom, such as Segorogeni (data/segorogeni.toml).

Frames: north-east-down; body x forward, y starboard, z down, origin at the centre of buoyancy.
Positive rudder turns to starboard (yaw rate r > 0), as for the corvette and opposite to Prestero
(2001). A positive stern plane makes the vehicle dive, as in Prestero.

Sources: the EnKF paper on this vehicle (eqs. 1-10) for dimensions and structure; it prints no
hydrodynamic coefficient, and its printed inverse inertia matrix has negative eigenvalues. Prestero
(2001) for symbols; Fossen (2011) for Kirchhoff's equations and the kinematics.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

from estimators.engine import compiled, sincos
from vessel_gym.sensors import Sensor, plain
from vessel_gym.vehicles.auv import AUV, UNCERTAIN, AUVParameters
from vessel_gym.vehicles.files import load

STATE = ("u", "v", "w", "p", "q", "r", "x", "y", "z", "phi", "theta", "psi")
"""Components of the state.

They are velocities through the water [m/s], angular velocities [rad/s], position [m] and Euler
angles [rad].
"""

I = IntEnum("I", (
    "surge_mass", "sway_mass", "heave_mass", "roll_inertia", "pitch_inertia", "yaw_inertia",
    "mass_z_g", "sway_yaw", "heave_pitch",
    "inverse_uu", "inverse_uw", "inverse_uq", "inverse_ww", "inverse_wq", "inverse_qq",
    "inverse_vv", "inverse_vp", "inverse_vr", "inverse_pp", "inverse_pr", "inverse_rr",
    "X_uu", "Y_vv", "Y_rr", "Z_ww", "Z_qq", "K_pp", "M_ww", "M_qq", "N_vv", "N_rr",
    "Y_uv", "Y_ur", "Z_uw", "Z_uq", "M_uw", "M_uq", "N_uv", "N_ur", "K_up",
    "Y_rudder", "N_rudder", "Z_uuds", "M_uuds", "propeller_torque",
    "net_weight", "righting_moment",
), start=0)  # fmt: skip
"""Index of each coefficient in the vector of the equations of motion."""

COEFFICIENTS = tuple(I.__members__)


@dataclass(frozen=True)
class SegorogeniParameters(AUVParameters):
    """Particulars of a vehicle in six degrees of freedom, SI units."""

    propeller_torque: float = 0.0  # m, torque per thrust

    TABLES = AUVParameters.TABLES | {
        "propulsion": (*AUVParameters.TABLES["propulsion"], "propeller_torque"),
    }

    names = COEFFICIENTS

    def values(self, factors: np.ndarray) -> dict[str, Any]:
        """Parameters of the equations of motion by name."""
        values = super().values(factors)
        return values | {
            "Y_rudder": -values["Y_uudr"],
            "N_rudder": -values["N_uudr"],
            "propeller_torque": self.propeller_torque,
        }


def _momentum(velocity: list[np.ndarray], c: np.ndarray) -> tuple[np.ndarray, ...]:
    """Momentum and angular momentum of body and water in axes that turn and move (Kirchhoff).

    Their rates contain every bracket and every added-mass term of the printed equations, X_wq to
    N_uv, and conserve energy to the last digit.
    """
    u, v, w, p, q, r = velocity
    S, e, d = c[I.mass_z_g], c[I.sway_yaw], c[I.heave_pitch]
    return (
        c[I.surge_mass] * u + S * q,
        c[I.sway_mass] * v - S * p + e * r,
        c[I.heave_mass] * w + d * q,
        c[I.roll_inertia] * p - S * v,
        c[I.pitch_inertia] * q + S * u + d * w,
        c[I.yaw_inertia] * r + e * v,
    )


def _accelerations(
    velocity: list[np.ndarray], control: np.ndarray, gravity: tuple[np.ndarray, ...], c: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Accelerations by eqs. (5)-(10); ``gravity`` is the direction of down in body axes.

    Lift is proportional to |u| and the fins' force to u |u|, so that hull and fins also brake a
    vehicle going astern. The fins' lift in roll, K_up, is not in the paper: without it the vehicle
    would roll for minutes after a push.
    """
    u, v, w, p, q, r = velocity
    rudder, stern, thrust = control
    Px, Py, Pz, Lx, Ly, Lz = _momentum(velocity, c)
    U, V, W, P, Q, R = np.abs(u), *(x * np.abs(x) for x in (v, w, p, q, r))
    inflow = u * U
    weight, righting = c[I.net_weight], c[I.righting_moment]
    X = Py * r - Pz * q + weight * gravity[0] + c[I.X_uu] * inflow + thrust
    Y = (
        Pz * p - Px * r + weight * gravity[1] + c[I.Y_vv] * V + c[I.Y_rr] * R
        + U * (c[I.Y_uv] * v + c[I.Y_ur] * r) + c[I.Y_rudder] * inflow * rudder
    )  # fmt: skip
    Z = (
        Px * q - Py * p + weight * gravity[2] + c[I.Z_ww] * W + c[I.Z_qq] * Q
        + U * (c[I.Z_uw] * w + c[I.Z_uq] * q) + c[I.Z_uuds] * inflow * stern
    )  # fmt: skip
    K = (
        Ly * r - Lz * q + Py * w - Pz * v - righting * gravity[1]
        + c[I.K_pp] * P + U * c[I.K_up] * p - c[I.propeller_torque] * thrust
    )  # fmt: skip
    M = (
        Lz * p - Lx * r + Pz * u - Px * w + righting * gravity[0] + c[I.M_ww] * W + c[I.M_qq] * Q
        + U * (c[I.M_uw] * w + c[I.M_uq] * q) + c[I.M_uuds] * inflow * stern
    )  # fmt: skip
    N = (
        Lx * q - Ly * p + Px * v - Py * u + c[I.N_vv] * V + c[I.N_rr] * R
        + U * (c[I.N_uv] * v + c[I.N_ur] * r) + c[I.N_rudder] * inflow * rudder
    )  # fmt: skip
    return (
        c[I.inverse_uu] * X + c[I.inverse_uw] * Z + c[I.inverse_uq] * M,
        c[I.inverse_vv] * Y + c[I.inverse_vp] * K + c[I.inverse_vr] * N,
        c[I.inverse_uw] * X + c[I.inverse_ww] * Z + c[I.inverse_wq] * M,
        c[I.inverse_vp] * Y + c[I.inverse_pp] * K + c[I.inverse_pr] * N,
        c[I.inverse_uq] * X + c[I.inverse_wq] * Z + c[I.inverse_qq] * M,
        c[I.inverse_vr] * Y + c[I.inverse_pr] * K + c[I.inverse_rr] * N,
    )


Attitude = list[tuple[np.ndarray, np.ndarray]]
"""Sines and cosines ``(...)`` of roll, pitch and yaw."""


def attitude(state: np.ndarray) -> Attitude:
    """Sines and cosines ``(...)`` of roll, pitch and yaw of states ``(..., 12)``."""
    return [sincos(state[..., i]) for i in (9, 10, 11)]


def kinematics(
    velocity: list[np.ndarray], angles: Attitude, current: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Rates ``(...)`` of position and Euler angles.

    Arguments are velocities in body axes, `attitude` and the current ``(..., 2)``.
    """
    u, v, w, p, q, r = velocity
    (sin_phi, cos_phi), (sin_theta, cos_theta), (sin_psi, cos_psi) = angles
    down = v * sin_phi + w * cos_phi
    ahead, aside = u * cos_theta + down * sin_theta, v * cos_phi - w * sin_phi
    # Euler angles have a pole at 90 deg of pitch: within 1 deg of the pole their rates are those at
    # 1 deg.
    bounded = np.where(
        np.abs(cos_theta) > 0.0175, cos_theta, np.where(cos_theta >= 0.0, 0.0175, -0.0175)
    )
    turn = (q * sin_phi + r * cos_phi) / bounded
    return (
        ahead * cos_psi - aside * sin_psi + current[..., 0],
        ahead * sin_psi + aside * cos_psi + current[..., 1],
        down * cos_theta - u * sin_theta, p + turn * sin_theta, q * cos_phi - r * sin_phi, turn,
    )  # fmt: skip


def yaw_kinematics(
    velocity: list[np.ndarray], angles: Attitude, current: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Rates ``(...)`` of position and Euler angles as printed, eqs. 1-4: only yaw turns.

    Arguments are velocities in body axes, `attitude` and the current ``(..., 2)``.
    """
    (u, v, w, _, _, r), (sin_psi, cos_psi) = velocity, angles[2]
    north, east = current[..., 0], current[..., 1]
    level = np.zeros_like(r)
    return u * cos_psi - v * sin_psi + north, u * sin_psi + v * cos_psi + east, w, level, level, r


@compiled
def segorogeni_rates(
    state: np.ndarray, control: np.ndarray, current: np.ndarray, c: np.ndarray
) -> np.ndarray:
    """Rates ``(..., 12)`` of velocities through the water, position and Euler angles.

    Args:
        state: ``(..., 12)``, `STATE`.
        control: Rudder, stern plane [rad], thrust [N] ``(..., 3)``.
        current: North and east [m/s] ``(..., 2)``.
        c: ``(..., k)``, `COEFFICIENTS`.
    """
    return _rates(state, control, current, c, kinematics)


@compiled
def printed_rates(
    state: np.ndarray, control: np.ndarray, current: np.ndarray, c: np.ndarray
) -> np.ndarray:
    """Rates ``(..., 12)`` with the printed kinematics, for arguments as of `segorogeni_rates`."""
    return _rates(state, control, current, c, yaw_kinematics)


def _rates(
    state: np.ndarray, control: np.ndarray, current: np.ndarray, c: np.ndarray,
    motion: Callable[..., tuple[np.ndarray, ...]],
) -> np.ndarray:  # fmt: skip
    """Rates ``(..., 12)``, those of position and Euler angles by ``motion``."""
    velocity, angles = list(np.moveaxis(state, -1, 0)[:6]), attitude(state)
    (sin_phi, cos_phi), (sin_theta, cos_theta), _ = angles
    gravity = (-sin_theta, cos_theta * sin_phi, cos_theta * cos_phi)
    accelerations = _accelerations(
        velocity, np.moveaxis(control, -1, 0), gravity, np.moveaxis(c, -1, 0)
    )
    return np.stack([*accelerations, *motion(velocity, angles, current)], -1)


@compiled
def _over_ground(state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    """Velocity over ground in body axes ``(..., 3)``."""
    u, v, w = np.moveaxis(state[..., :3], -1, 0)
    north, east = exogenous[..., 6], exogenous[..., 7]
    (sin_phi, cos_phi), (sin_theta, cos_theta) = sincos(state[..., 9]), sincos(state[..., 10])
    sin_psi, cos_psi = sincos(state[..., 11])
    # horizontal components of the current
    ahead, aside = north * cos_psi + east * sin_psi, east * cos_psi - north * sin_psi
    return np.stack([
        u + ahead * cos_theta,
        v + ahead * sin_theta * sin_phi + aside * cos_phi,
        w + ahead * sin_theta * cos_phi - aside * sin_phi,
    ], -1)  # fmt: skip


@compiled
@dataclass(frozen=True)
class Segorogeni(AUV):
    """The Segorogeni in six degrees of freedom, or with the printed kinematics, eqs. 1-4."""

    body: SegorogeniParameters = field(
        default_factory=lambda: load("segorogeni", SegorogeniParameters)
    )
    as_printed: bool = False

    kinds = ("nonlinear", "as_printed")
    state_names = STATE
    equations = staticmethod(segorogeni_rates)
    printed_equations = staticmethod(printed_rates)
    parameter_names = COEFFICIENTS
    action_names = ("rudder", "stern plane", "thrust")
    angles = ("phi", "theta", "psi")
    incremented = STATE[:6]
    ambient_flows = ("current north", "current east")
    rates = {"p": "phi", "q": "theta", "r": "psi"}
    sensors = (
        Sensor(
            "Doppler log", ("u over ground", "v over ground", "w over ground"),
            _over_ground,
            (0.01,) * 3, dropout=0.10, scale=(0.5, 0.25, 0.25), gives=("u", "v", "w"),
        ),
        Sensor("depth gauge", ("z",), plain((8,)), (0.02,), scale=(5.0,), gives=("z",)),
        Sensor(
            "attitude", ("phi", "theta", "psi"), plain((9, 10, 11)), (0.01, 0.01, 0.03),
            angles=(0, 1, 2), scale=(0.25, 0.5, 1.0), gives=("phi", "theta", "psi"),
        ),
        Sensor(
            "gyroscope", ("p", "q", "r"), plain((3, 4, 5)), (0.005,) * 3,
            scale=(0.5,) * 3, gives=("p", "q", "r"),
        ),
        Sensor(
            "acoustic position", ("x", "y"), plain((6, 7)), (0.5, 0.5), rate=0.5, dropout=0.10,
            scale=(10.0, 10.0), gives=("x", "y"),
        ),
    )  # fmt: skip
    grades = "auv"
    normals = len(UNCERTAIN)

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Initial state ``(..., 12)`` and actuators ``(..., 3)``; 5 deg of rudder, as printed."""
        state, actuators = super().start(x)
        return state, actuators + np.deg2rad([5.0, 0.0, 0.0])
