"""Underwater vehicles in six degrees of freedom, such as Segorogeni (data/segorogeni.toml).

Frames: north-east-down; body x forward, y starboard, z down, origin at the centre of buoyancy.
Positive rudder turns to starboard (yaw rate r > 0), as for the corvette and opposite to Prestero
(2001). A positive stern plane makes the vehicle dive, as in Prestero.

Sources: the EnKF paper on this vehicle (eqs. 1-10) for dimensions and structure; it prints no
hydrodynamic coefficient, and its printed inverse inertia matrix has negative eigenvalues. Prestero
(2001) for symbols; Fossen (2011) for Kirchhoff's equations and the kinematics.
"""

from collections import namedtuple
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from estimators.angles import ahead_and_aside
from estimators.engine import compiled, sincos
from vessel_gym.sensors import Sensor, plain
from vessel_gym.vehicles.auv import AUV, UNCERTAIN, AUVParameters, vertical_accelerations
from vessel_gym.vehicles.files import load

STATE = ("u", "v", "w", "p", "q", "r", "x", "y", "z", "phi", "theta", "psi")
"""Components of the state.

They are velocities through the water [m/s], angular velocities [rad/s], position [m] and Euler
angles [rad].
"""

Coefficients = namedtuple("Coefficients", (
    "surge_mass", "sway_mass", "heave_mass", "roll_inertia", "pitch_inertia", "yaw_inertia",
    "mass_z_g", "sway_yaw", "heave_pitch",
    "inverse_uu", "inverse_uw", "inverse_uq", "inverse_ww", "inverse_wq", "inverse_qq",
    "inverse_vv", "inverse_vp", "inverse_vr", "inverse_pp", "inverse_pr", "inverse_rr",
    "X_uu", "Y_vv", "Y_rr", "Z_ww", "Z_qq", "K_pp", "M_ww", "M_qq", "N_vv", "N_rr",
    "Y_uv", "Y_ur", "Z_uw", "Z_uq", "M_uw", "M_uq", "N_uv", "N_ur", "K_up",
    "Y_uudr", "N_uudr", "Z_uuds", "M_uuds", "propeller_torque",
    "net_weight", "righting_moment",
))  # fmt: skip
"""Coefficients of the equations of motion, in the order of their vector."""

COEFFICIENTS = Coefficients._fields


@dataclass(frozen=True)
class SegorogeniParameters(AUVParameters):
    """Particulars of a vehicle in six degrees of freedom, SI units."""

    names = COEFFICIENTS


Attitude = list[Any]
"""Pairs of sine and cosine ``(...)`` of roll, pitch and yaw."""


def _momentum(velocity: list[np.ndarray], c: Coefficients) -> tuple[np.ndarray, ...]:
    """Momentum and angular momentum of body and water in axes that turn and move (Kirchhoff).

    Their rates contain every bracket and every added-mass term of the printed equations, X_wq to
    N_uv.
    """
    u, v, w, p, q, r = velocity
    S, e, d = c.mass_z_g, c.sway_yaw, c.heave_pitch
    return (
        c.surge_mass * u + S * q,
        c.sway_mass * v - S * p + e * r,
        c.heave_mass * w + d * q,
        c.roll_inertia * p - S * v,
        c.pitch_inertia * q + S * u + d * w,
        c.yaw_inertia * r + e * v,
    )


def coriolis(momentum: Sequence[Any], velocity: Sequence[Any]) -> tuple[Any, ...]:
    """Forces and moments ``(...)`` of momentum in moving axes, Fossen's ``-C(nu) nu``.

    They conserve energy to the last digit. Both arguments are along and about the body axes.
    """
    (Px, Py, Pz, Lx, Ly, Lz), (u, v, w, p, q, r) = momentum, velocity
    return (
        Py * r - Pz * q,
        Pz * p - Px * r,
        Px * q - Py * p,
        Ly * r - Lz * q + Py * w - Pz * v,
        Lz * p - Lx * r + Pz * u - Px * w,
        Lx * q - Ly * p + Px * v - Py * u,
    )


def _accelerations(
    velocity: list[np.ndarray], angles: Attitude, control: np.ndarray, c: Coefficients
) -> tuple[np.ndarray, ...]:
    """Accelerations ``(...)`` by eqs. (5)-(10), with lift and fins as `vertical_accelerations`.

    The fins' lift in roll, K_up, is not in the paper: without it the vehicle would roll for minutes
    after a push.
    """
    u, v, w, p, q, r = velocity
    rudder, stern, thrust = np.moveaxis(control, -1, 0)
    (sin_phi, cos_phi), (sin_theta, cos_theta), _ = angles
    X, Y, Z, K, M, N = coriolis(_momentum(velocity, c), velocity)
    gravity = sin_theta, cos_theta * cos_phi
    surge, heave, pitch = vertical_accelerations((X, Z, M), (u, w, q), gravity, stern, thrust, c)
    U, V, P, R = np.abs(u), *(x * np.abs(x) for x in (v, p, r))
    inflow = u * U
    Y = (
        Y + c.net_weight * (cos_theta * sin_phi) + c.Y_vv * V + c.Y_rr * R
        + U * (c.Y_uv * v + c.Y_ur * r) - c.Y_uudr * inflow * rudder
    )  # fmt: skip
    K = (
        K - c.righting_moment * (cos_theta * sin_phi) + c.K_pp * P + U * c.K_up * p
        - c.propeller_torque * thrust
    )  # fmt: skip
    N = N + c.N_vv * V + c.N_rr * R + U * (c.N_uv * v + c.N_ur * r) - c.N_uudr * inflow * rudder
    return (
        surge, c.inverse_vv * Y + c.inverse_vp * K + c.inverse_vr * N,
        heave, c.inverse_vp * Y + c.inverse_pp * K + c.inverse_pr * N,
        pitch, c.inverse_vr * Y + c.inverse_pr * K + c.inverse_rr * N,
    )  # fmt: skip


def kinematics(
    velocity: Sequence[Any], angles: Attitude, current: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Rates ``(...)`` of position and Euler angles.

    Arguments are velocities in body axes, `Attitude` and the current ``(..., 2)``.
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


@compiled
def segorogeni_rates(
    state: np.ndarray, control: np.ndarray, current: np.ndarray, coefficients: np.ndarray, *,
    as_printed: bool = False,
) -> np.ndarray:  # fmt: skip
    """Rates ``(..., 12)`` of velocities through the water, position and Euler angles.

    Args:
        state: ``(..., 12)``, `STATE`.
        control: Rudder, stern plane [rad], thrust [N] ``(..., 3)``.
        current: North and east [m/s] ``(..., 2)``.
        coefficients: ``(..., k)``, `COEFFICIENTS`.
        as_printed: True for the kinematics of eqs. 1-4.
    """
    columns = list(np.moveaxis(state, -1, 0))
    velocity, angles = columns[:6], [sincos(angle) for angle in columns[9:]]
    accelerations = _accelerations(
        velocity, angles, control, Coefficients(*np.moveaxis(coefficients, -1, 0))
    )
    if as_printed:  # only yaw turns
        level = 0.0, 1.0
        velocity, angles = [*velocity[:3], 0.0, 0.0, velocity[5]], [level, level, angles[2]]
    return np.stack([*accelerations, *kinematics(velocity, angles, current)], -1)


printed_rates = compiled(partial(segorogeni_rates.function, as_printed=True))
"""`segorogeni_rates` with the printed kinematics."""


@compiled
def _over_ground(state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    """Velocity over ground in body axes ``(..., 3)``."""
    u, v, w = np.moveaxis(state[..., :3], -1, 0)
    north, east = exogenous[..., 6], exogenous[..., 7]
    (sin_phi, cos_phi), (sin_theta, cos_theta) = sincos(state[..., 9]), sincos(state[..., 10])
    ahead, aside = ahead_and_aside(north, east, state[..., 11])
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
