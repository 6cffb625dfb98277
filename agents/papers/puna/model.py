"""The PUNA as its paper writes it, in the vertical plane.

It resolves lift along the body and drag along the velocity. For the package's own aircraft see
`vessel_gym.vehicles.puna`.
"""

from dataclasses import dataclass, field

import numpy as np

from estimators.engine import sincos
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.puna import Coefficients, PunaParameters, forces, printed_axes


def planar_derivative(
    state: np.ndarray, control: np.ndarray, coefficients: np.ndarray, as_printed: bool = False
) -> np.ndarray:
    """Rates of (gamma, v, x, h) by thrust and angle of attack, eqs. 19 and 21; as printed: eq. 1.

    Eq. 1 has g sin alpha in the rate of the speed, where eqs. 19 and 21 have g sin gamma.
    """
    gamma, v, _, h = np.moveaxis(state, -1, 0)
    thrust, alpha = np.moveaxis(control, -1, 0)
    c = Coefficients(*np.moveaxis(coefficients, -1, 0))
    (sin_alpha, cos_alpha), (sin_gamma, cos_gamma) = sincos(alpha), sincos(gamma)
    along, across = printed_axes(thrust, *forces(h, v, alpha, c), (sin_alpha, cos_alpha))
    weight = c.gravity * (sin_alpha if as_printed else sin_gamma)
    turning = across / (c.mass * v) - c.gravity * cos_gamma / v
    return np.stack([turning, along / c.mass - weight, v * cos_gamma, v * sin_gamma], -1)


@dataclass(frozen=True)
class PlanarPuna:
    """The paper's model in the vertical plane: state (gamma, v, x, h), thrust and angle of attack.

    Drag along the velocity, but lift along the body's normal, as printed: what comes with lift
    brakes twice. Subchan & Zbikowski (2009), whose constants are those of axial and normal force,
    have both along the body. No wind, no actuators, and nothing is bounded.
    """

    body: PunaParameters = field(default_factory=lambda: load("puna", PunaParameters))
    dt: float = 0.01  # s, assumed: the paper prints none

    def step(self, state: np.ndarray, control: np.ndarray) -> np.ndarray:
        """Eqs. (19) and (21), forward Euler, with "+ v_k" for "+ gamma_k" in the second row.

        Args:
            state: ``(..., 4)``.
            control: ``(..., 2)`` thrust [N] and angle of attack [rad].
        """
        return state + self.dt * planar_derivative(state, control, self.body.vector())
