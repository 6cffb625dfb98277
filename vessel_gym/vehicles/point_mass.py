"""An aircraft as a point mass with lift, drag and thrust: constants and forces.

Sources: the paper on the PUNA (see `vessel_gym.vehicles.puna`) for the form of drag, lift and
density, without constants; Gryte (2018), the Skywalker X8, for the constants.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

I = IntEnum("I", (
    "mass", "area", "gravity", "drag_2", "drag_1", "drag_0", "lift_1", "lift_0",
    "density_2", "density_1", "density_0", "thrust", "bank_rate",
), start=0)  # fmt: skip
"""Index of each coefficient in the vector of the equations of motion."""

COEFFICIENTS = tuple(I.__members__)

_FACTORS = {
    "lift": ("lift_1", "lift_0"),
    "drag of the angle of attack": ("drag_2", "drag_1"),
    "drag at zero angle": ("drag_0",),
    "mass": ("mass",),
    "thrust": ("thrust",),
    "bank": ("bank_rate",),
}
UNCERTAIN = tuple(_FACTORS)
"""Parameters that `mismatch` spreads: one factor scales all coefficients of a kind."""


@dataclass(frozen=True)
class PointMass:
    """Constants of an aircraft's equations, SI units; angles of attack in rad.

    Eq. 2 of the paper: drag ``C_D = A1 a^2 + A2 a + A3``, lift ``C_L = B1 a + B2``, density ``C1
    h^2 + C2 h + C3``.
    """

    mass: float  # kg
    area: float  # m2, of the wing
    drag: tuple[float, float, float]  # A1, A2, A3
    lift: tuple[float, float]  # B1, B2
    density: tuple[float, float, float] = 4.319e-9, -1.1760e-4, 1.225  # C1, C2, C3: ISO 2533
    gravity: float = 9.81  # m/s2
    bank_rate: float = 2.0  # 1/s, b of phi' = b (phi_c - phi): Beard & McLain (2012), assumed

    def vector(self, factors: np.ndarray | None = None) -> np.ndarray:
        """Coefficients of the equations of motion ``(..., 13)``, in the order of `COEFFICIENTS`.

        Args:
            factors: Factors ``(..., 6)`` on the `UNCERTAIN` ones; default: 1.
        """
        c = np.array([
            self.mass, self.area, self.gravity, *self.drag, *self.lift, *self.density, 1.0,
            self.bank_rate,
        ])  # fmt: skip
        if factors is None:
            return c
        c = np.tile(c, factors.shape[:-1] + (1,))
        for i, names in enumerate(_FACTORS.values()):
            c[..., [COEFFICIENTS.index(name) for name in names]] *= factors[..., i : i + 1]
        return c


def forces(
    altitude: np.ndarray, speed: np.ndarray, alpha: np.ndarray, c: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lift and drag [N], eq. 2, with coefficients ``(k, ...)``; both have the sign of the speed."""
    density = (c[I.density_2] * altitude + c[I.density_1]) * altitude + c[I.density_0]
    pressure = 0.5 * density * speed * np.abs(speed) * c[I.area]
    lift = pressure * (c[I.lift_1] * alpha + c[I.lift_0])
    return lift, pressure * ((c[I.drag_2] * alpha + c[I.drag_1]) * alpha + c[I.drag_0])


def in_wind_axes(
    thrust: np.ndarray, lift: np.ndarray, drag: np.ndarray, angle: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Forces [N] along the velocity and across it, by sine and cosine of the angle of attack."""
    sin_alpha, cos_alpha = angle
    return thrust * cos_alpha - drag, lift + thrust * sin_alpha


def printed_axes(
    thrust: np.ndarray, lift: np.ndarray, drag: np.ndarray, angle: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Forces [N] along the velocity and across it, eq. 1: lift is along the body's normal."""
    sin_alpha, cos_alpha = angle
    return thrust * cos_alpha - drag - lift * sin_alpha, thrust * sin_alpha + lift * cos_alpha
