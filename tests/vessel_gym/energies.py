"""What the equations of underwater vehicles are held against: inertia and energy from their coefficients."""

import numpy as np

from vessel_gym.vehicles.itsunusa import I as Plane
from vessel_gym.vehicles.segorogeni import I

DRAG = ("X_uu", "Y_vv", "Y_rr", "Z_ww", "Z_qq", "K_pp", "M_ww", "M_qq", "N_vv", "N_rr")
LIFT = ("Y_uv", "Y_ur", "Z_uw", "Z_uq", "M_uw", "M_uq", "N_uv", "N_ur", "K_up")


def inertia(c: np.ndarray) -> np.ndarray:
    """Inertia ``(..., 6, 6)`` of body and added mass for coefficients ``(..., k)``."""
    M = np.zeros(c.shape[:-1] + (6, 6))
    diagonal = np.arange(6)
    M[..., diagonal, diagonal] = c[..., :6]
    S, e, d = c[..., I.mass_z_g], c[..., I.sway_yaw], c[..., I.heave_pitch]
    for row, column, value in ((0, 4, S), (1, 3, -S), (1, 5, e), (2, 4, d)):
        M[..., row, column] = M[..., column, row] = value
    return M


def energy(state: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Kinetic energy of body and water and potential energy [J] of states ``(..., 12)``, ``(...)``.

    In water at rest, or seen from water that moves steadily.
    """
    nu, depth = state[..., :6], state[..., 8]
    upright = np.cos(state[..., 9]) * np.cos(state[..., 10])
    kinetic = 0.5 * np.vecdot(nu, np.matvec(inertia(c), nu))
    return kinetic - c[..., I.net_weight] * depth - c[..., I.righting_moment] * upright


def inertia_in_the_plane(c: np.ndarray) -> np.ndarray:
    """Inertia ``(..., 3, 3)`` of body and added mass for coefficients ``(..., k)``."""
    M = np.zeros(c.shape[:-1] + (3, 3))
    M[..., [0, 1, 2], [0, 1, 2]] = c[..., :3]
    M[..., [0, 1, 2, 2], [2, 2, 0, 1]] = c[
        ..., [Plane.mass_z_g, Plane.heave_pitch, Plane.mass_z_g, Plane.heave_pitch]
    ]
    return M


def energy_in_the_plane(state: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Kinetic energy of body and water and potential energy [J] of states ``(..., 6)``, ``(...)``.

    In water at rest, or seen from water that moves steadily.
    """
    nu, depth, theta = state[..., :3], state[..., 4], state[..., 5]
    kinetic = 0.5 * np.vecdot(nu, np.matvec(inertia_in_the_plane(c), nu))
    return (
        kinetic - c[..., Plane.net_weight] * depth - c[..., Plane.righting_moment] * np.cos(theta)
    )
