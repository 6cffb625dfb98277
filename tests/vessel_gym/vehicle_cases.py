"""The vehicles, what they can meet, and what tests hold their equations against."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from stepping import step

from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.itsunusa import Itsunusa
from vessel_gym.vehicles.puna import Puna
from vessel_gym.vehicles.segorogeni import Segorogeni
from vessel_gym.vehicles.ship import Ship


@dataclass(frozen=True)
class Case:
    """A vehicle, what it can meet, and a hard step.

    Attributes:
        vehicle: The vehicle.
        nominal: Its coefficients.
        low: Smallest states, actuators and flows; None: the negative of the largest.
        high: Largest states, actuators and flows.
        hard: State, actuators before and after, and flow of a step with all that the vehicle can
            do.
        errors: Of that step by the vehicle's parts, and by 32 times as many.
    """

    vehicle: Any
    nominal: np.ndarray
    low: tuple[Any, Any, Any]
    high: tuple[Any, Any, Any]
    hard: tuple[Any, Any, Any, Any]
    errors: tuple[float, float]

    def draw(self, rng: np.random.Generator, *shape: int) -> list[np.ndarray]:
        """States, actuators and flows of a shape."""
        pairs = zip(self.low, self.high, strict=True)
        ranges = [(-np.array(high) if low is None else low, high) for low, high in pairs]
        return [rng.uniform(low, high, (*shape, len(high))) for low, high in ranges]

    def step(self, state: Any, moving: Any, flow: Any, c: Any, dt: float, parts: int) -> np.ndarray:
        """States after a step of so many parts; ``moving`` holds the actuators before and after."""
        return step(self.vehicle.equations, state, moving, flow, c, dt, parts)

    def exact(self, c: np.ndarray, dt: float) -> np.ndarray:
        """The hard step by SciPy's integrator, the actuators moving linearly."""
        state, before, after, flow = map(np.array, self.hard)
        solution = solve_ivp(
            lambda t, s: self.vehicle.equations(s, before + (after - before) * t / dt, flow, c),
            (0.0, dt), state, method="DOP853", rtol=1e-13, atol=1e-13,
        )  # fmt: skip
        return solution.y[:, -1]

    def hard_step(self, c: np.ndarray, dt: float, parts: int) -> np.ndarray:
        """The hard step in so many parts."""
        state, before, after, flow = map(np.array, self.hard)
        return self.step(state, np.concatenate([before, after]), flow, c, dt, parts)


def ship(name: str) -> Case:
    """A ship under rudder in wind, waves and current."""
    vehicle = Ship(load(name))
    return Case(
        vehicle, vehicle.ship.vector(),
        low=([-500, -500, -4, 2, -5, -0.08, -0.5, -0.2], None, None),
        high=([500, 500, 4, 18, 5, 0.08, 0.5, 0.2], [0.61], [1, 1, 2e5, 4e5, 1e7, 5e6, 0.5]),
        hard=([3.0, -4.0, 0.7, 13.0, -1.5, 0.03, -0.1, 0.02], [0.5], [0.54],
              [0.3, -0.5, 1e5, -2e5, 5e6, 1e6, 0.2]),
        errors=(1e-5, 1e-11),
    )  # fmt: skip


CASES = {
    "segorogeni": Case(
        Segorogeni(), load("segorogeni").vector(),
        low=(None, [-0.35, -0.35, 0.0], None),
        high=([2, 1, 1, 2, 1.5, 1.5, 50, 50, 20, 2, 1.3, 4], [0.35, 0.35, 8.0], [0.5, 0.5]),
        hard=([1.0, -0.1, 0.05, 0.2, -0.1, 0.3, 3.0, -4.0, 2.0, 0.1, -0.3, 0.7], [0.30, -0.20, 3.0],
              [0.35, -0.10, 6.0], [0.2, -0.1]),
        errors=(2e-5, 1e-8),
    ),
    "itsunusa": Case(
        Itsunusa(), load("itsunusa").vector(),
        low=(None, [-0.35, 0.0], None), high=([3, 1, 1, 50, 20, 4], [0.35, 40.0], [0.5]),
        hard=([1.5, 0.05, -0.1, 3.0, 2.0, -0.3], [-0.2, 10.0], [-0.1, 20.0], [0.2]),
        errors=(2e-6, 1e-9),
    ),
    "puna": Case(
        Puna(), load("puna").vector(),
        low=([-500, -500, 0, -30, -30, -15, -0.9], [0.0, -0.07, -0.6], None),
        high=([500, 500, 300, 30, 30, 15, 0.9], [16.0, 0.2, 0.6], [5, 5, 2]),
        hard=([3.0, -4.0, 100.0, 14.743, 9.733, 2.877, 0.4], [4.0, 0.02, -0.6], [7.0, 0.07, 0.6], [2.0, -1.0, 0.5]),
        errors=(5e-4, 1e-8),
    ),
    "corvette": ship("corvette"),
    "thesis' corvette": ship("corvette-thesis"),
}  # fmt: skip


REMUS = dict(
    X_udot=-0.93, Y_vdot=-35.5, Y_rdot=1.93, Z_wdot=-35.5, Z_qdot=-1.93, K_pdot=-0.0704, M_wdot=-1.93, M_qdot=-4.88,
    N_vdot=1.93, N_rdot=-4.88, X_uu=-1.62, Y_vv=-131.0, Y_rr=0.632, Z_ww=-131.0, Z_qq=-0.632, K_pp=-0.0013,
    M_ww=3.18, M_qq=-9.4, N_vv=-3.18, N_rr=-9.4, Y_uv=-28.6, Y_ur=6.15, Z_uw=-28.6, Z_uq=-6.15, M_uw=-10.6,
    M_uq=-3.93, N_uv=10.6, N_ur=-3.93, Y_uudr=9.64, N_uudr=-6.15, Z_uuds=-9.64, M_uuds=-6.15,
)  # fmt: skip
"""A body with other couplings: Prestero (2001), drag in yaw without its misprints, moments of lift for both sides."""
WITH_REMUS = replace(load("segorogeni"), given=tuple(REMUS.items()))
"""The Segorogeni's mass with REMUS' hydrodynamics."""
