"""What the equations of an underwater vehicle are held against: inertia and energy from its coefficients."""

import numpy as np

from vessel_gym.vehicles.segorogeni import Coefficients

DRAG = ("X_uu", "Y_vv", "Y_rr", "Z_ww", "Z_qq", "K_pp", "M_ww", "M_qq", "N_vv", "N_rr")
LIFT = ("Y_uv", "Y_ur", "Z_uw", "Z_uq", "M_uw", "M_uq", "N_uv", "N_ur", "K_up")


def inertia(c: np.ndarray) -> np.ndarray:
    """Inertia ``(..., 6, 6)`` of body and added mass for coefficients ``(..., k)``."""
    M = np.zeros(c.shape[:-1] + (6, 6))
    diagonal = np.arange(6)
    M[..., diagonal, diagonal] = c[..., :6]
    of = Coefficients(*np.moveaxis(c, -1, 0))
    S, e, d = of.mass_z_g, of.sway_yaw, of.heave_pitch
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
    of = Coefficients(*np.moveaxis(c, -1, 0))
    return kinetic - of.net_weight * depth - of.righting_moment * upright


def power(state: np.ndarray, rates: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Rate of change ``(...)`` [W] of `energy`, by the chain rule."""
    phi, theta = state[..., 9], state[..., 10]
    kinetic = np.vecdot(state[..., :6], np.matvec(inertia(c), rates[..., :6]))
    tilt = (
        np.sin(phi) * np.cos(theta) * rates[..., 9] + np.cos(phi) * np.sin(theta) * rates[..., 10]
    )
    of = Coefficients(*np.moveaxis(c, -1, 0))
    return kinetic - of.net_weight * rates[..., 8] + of.righting_moment * tilt
