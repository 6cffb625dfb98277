"""The turning circle trial of the thesis: follow the heading of a ship with a constant rudder.

Rudder angle, time step, switch of d and prior variance are inferred or our choice;
docs/environments/thesis-corvette.md states what the thesis prints instead.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators import Gaussian
from estimators.engine import compiled, lookup
from vessel_gym.checks import one_of
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette_thesis import SIMULATIONS, ThesisCorvette

SAMPLES = 195
"""Samples of the thesis' record (Section 4.5): one at reset, one after each step."""
SWITCH = 98
"""First sample with negative d, halfway.

Inferred: the thesis prints a switch after one sample (Section 4.3.1).
"""


@compiled
@dataclass(frozen=True)
class TurningTrial(TurningCircle):
    """Follow the heading of a trial in which the rudder was put over to ``helm``.

    The trial begins on a straight course. A scenario is ``(initial heading [rad], final yaw rate
    [rad/s], simulation)``; a reference is that of `TurningCircle`, then the simulation.
    """

    pace: float = 1.6  # for steps of 0.8 s
    horizon: int = SAMPLES - 1
    helm: float = float(np.deg2rad(28.0))  # rad, our choice: more hardly helps; 35 deg is printed
    prior_variance: float = 1e-3  # filter's, of sway, yaw rate, heading; inferred: equal to Q's

    uniforms = 0
    commanding: ClassVar[slice | list[int]] = [3, 4]

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Scenarios ``(B, 3)`` without random values.

        Args:
            uniforms: ``(B, 0)``.
            options: ``{"simulation": "II"}`` chooses one of `SIMULATIONS`; the default is the
                first.

        Raises:
            ValueError: for another option or simulation.
        """
        scenarios = np.tile([0.0, self.record[-1, 5], 0.0], (len(uniforms), 1))
        for option, value in options.items():
            one_of("reset option", option, ("simulation",))
            scenarios[:, 2] = list(SIMULATIONS).index(one_of("simulation", value, SIMULATIONS))
        return scenarios

    @cached_property
    def _spread(self) -> Gaussian:
        return Gaussian(np.zeros(3), self.prior_variance * np.eye(3))

    def prior(self, scenario: np.ndarray) -> Gaussian:
        """Prior of (v, r, psi): mean ``(B, 3)`` and covariance ``(3, 3)``."""
        return self._spread.about(np.zeros((len(scenario), 3)))

    @cached_property
    def record(self) -> np.ndarray:
        """States ``(k, 8)`` of the ship in the trial, up to the end of the preview."""
        vessel = ThesisCorvette(self.ship, self.dt)
        parameters, still = vessel.parameters(0.0, np.zeros((1, vessel.normals))), np.zeros((1, 1))
        state, rudder = vessel.start(np.zeros((1, 3)))
        states = [state[0]]
        for _ in range(self.horizon + self._ahead):
            before, put = rudder, still + self.helm / self.ship.rudder_limit
            rudder = vessel.actuate(before, put)
            state = vessel.step(state, before, rudder, still, parameters)
            states.append(state[0])
        return np.array(states)

    @property
    def _ahead(self) -> int:
        return round(self.preview / self.dt)

    @compiled(axes=(1, 0))
    def command(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Reference ``(..., 5)`` at a step ``(...)`` of the trial."""
        heading, rate = self.record.T[[2, 5]]
        rate_ahead = lookup(rate, step + float(self._ahead))
        now = lookup(heading, step), lookup(rate, step)
        return np.stack([*now, rate_ahead, scenario[..., 1], scenario[..., 2]], -1)

    def path(self, scenario: np.ndarray) -> np.ndarray:
        """Positions of the ship in the trial ``(195, 2)``."""
        return self.record[: self.horizon + 1, :2]

    @compiled(axes=(1, 0))
    def exogenous(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The step d [rad] ``(..., 1)``: positive at first, negative from `SWITCH` on."""
        size = lookup(np.array([each.size for each in SIMULATIONS.values()]), scenario[..., 2])
        return np.where(step < SWITCH, size, -size)[..., None]
