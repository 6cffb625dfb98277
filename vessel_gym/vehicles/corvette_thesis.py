"""The ship of A. E. Hermawan's thesis (ITS Surabaya, 2020), eqs. 4.3 to 4.6 and Section 4.5.

A linear filter of three states (sway, yaw rate, heading) follows a ship that turns under a constant
rudder, while a deterministic step d, the unknown input, enters both measurements ``(psi + d, d)``.
There is no sea. As printed, d(k) is in the measurements of step k and moves the heading of the
filter's model from k to k + 1: this compass foresees d.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from estimators import Schedule
from estimators.engine import compiled
from vessel_gym.vehicles.corvette import COMPASS, MOTION_UNIT, linear_matrices
from vessel_gym.vehicles.corvette_equations import AROUND, CorvetteParameters, corvette_rates
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.ship import Ship
from vessel_gym.vehicles.simulated import Actuator


class Simulation(NamedTuple):
    """One of the five simulations of Section 4.5.

    Attributes:
        Q: Assumed variance of process noise, a multiple of the identity.
        R: Assumed variance of measurement noise, a multiple of the identity.
        size: Height of the step d [rad], which is ``size`` first and ``-size`` later; inferred, see
            `SIMULATIONS`.
    """

    Q: float
    R: float
    size: float


SIMULATIONS = {
    "I": Simulation(1e-3, 1e-3, 0.01),
    "II": Simulation(1.0, 1e-3, 0.01),
    "III": Simulation(1e-3, 1.0, 0.01),
    "IV": Simulation(1.0, 1.0, 0.01),
    "V": Simulation(1e-3, 1e-3, 0.1),
}
"""Simulations by number, with inferred sizes.

The thesis prints 0.1 and 0.2 for V and calls these larger than the 1 and 2 of I to IV, which are
therefore read as 0.01.
"""
NOISE = 6e-4
"""Standard deviation [rad] of both measurements, inferred from the error of d in simulation II."""
A = np.array([[0.4159, 0.1811, 0.0], [5.4795e-10, 1.0, 0.0], [0.0, 0.5, 1.0]])
B = np.array([[-2.6189e-7], [2.4075e-7], [0.0]])
"""Eq. 4.3 to the digit, B of the rudder [rad]; neither the ship's nor consistent in units."""


@compiled
def _foreseeing(state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    """Heading plus the d of the coming step ``(..., 1)``, eq. 4.5."""
    return state[..., 2:3] + exogenous[..., :1]


@compiled
def _calm_rates(
    state: np.ndarray, control: np.ndarray, d: np.ndarray, coefficients: np.ndarray
) -> np.ndarray:
    """Rates ``(..., 8)`` of the ship in calm water; d ``(..., 1)`` does not move it."""
    return corvette_rates(state, control, np.zeros(len(AROUND)), coefficients)


@compiled
@dataclass(frozen=True)
class ThesisCorvette(Ship):
    """The ship in its turning circle trial, and the thesis' filter.

    The truth is this package's nonlinear ship, because the recorded trial is not public. The action
    is the rudder angle. Filters estimate (v, r, psi). Their known input is ``u = (rudder, commanded
    yaw rate, simulation)``, and the simulation chooses Q and R. Filters assume that d is a yaw
    increment that also moves the heading, ``psi+ = psi + dt r + d`` (eq. 4.4). d does not move the
    ship, because the thesis' record was made without d.
    """

    ship: CorvetteParameters = field(
        default_factory=lambda: load("corvette-thesis", CorvetteParameters)
    )
    dt: float = 0.8  # s: the printed 0.5 s leaves 195 samples no time for a full turn

    equations = staticmethod(_calm_rates)
    action_names = ("rudder",)
    grades = "corvette-thesis"
    increments = ()
    incremented = ()
    ambient_flows = ("yaw increment",)
    kinds = ("corrected", "as_printed")
    linear_kinds = kinds
    sensors = (
        replace(COMPASS, reads=_foreseeing, sd=(NOISE,)), replace(MOTION_UNIT, sd=(NOISE,))
    )  # fmt: skip
    cruise = (np.zeros(3), np.zeros(3))  # straight on

    def estimated(self, kind: str) -> tuple[str, ...]:
        """Components (v, r, psi)."""
        return ("v", "r", "psi")

    @property
    def process_sd(self) -> np.ndarray:
        """Standard deviations of simulation I's process noise, for models without ``noise``."""
        return np.sqrt(np.full(3, SIMULATIONS["I"].Q))

    @cached_property
    def noise(self) -> dict[str, Schedule]:
        """Q ``(3, 3)`` and R ``(2, 2)`` by simulation, the last component of the known input."""
        sizes = {"Q": 3, "R": 2}
        return {
            name: Schedule(
                np.array([getattr(each, name) * np.eye(n) for each in SIMULATIONS.values()]),
                2,
                1.0,
                0.5,
            )
            for name, n in sizes.items()
        }

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Straight on to the north at service speed; the prior is the filter's alone."""
        ahead, _ = super().cruise
        return super().start(np.broadcast_to(ahead, (*x.shape[:-1], len(ahead))))

    @cached_property
    def _actuators(self) -> np.ndarray:
        limit = self.ship.rudder_limit
        return np.array([Actuator(limit, limit, turn=self.ship.rudder_rate * self.dt, limit=limit)])

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """The corrected linear model."""
        A, B, driven = self.linear("corrected")
        return np.matvec(A(u), x) + np.matvec(B(u), u) + np.matvec(driven, flow)

    def known_input(
        self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None
    ) -> np.ndarray:
        """Mean rudder over a step, yaw rate of the commanded turn, and simulation."""
        return super().known_input(before, after, commanded)[..., :3]

    def linear(self, kind: str) -> tuple[Any, ...]:
        """A, B and the effect of d.

        The kind ``"corrected"`` is about the commanded turn, ``"as_printed"`` is eqs. 4.3 and 4.4.
        """
        printed = A, np.pad(B, ((0, 0), (0, 2)))
        own = printed if kind == "as_printed" else linear_matrices(self.ship, self.dt, 3)
        return *own, np.array([[0.0], [0.0], [1.0]])
