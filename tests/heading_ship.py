"""A ship of three or four states in a simple random sea, which holds a commanded turning circle: a system for tests.

Linear filters estimate (v, r, psi), nonlinear ones u besides. With d the yaw increment that waves
and gusts give in a step, ``psi+ = psi + dt r + d``, ``y1 = psi + d`` and ``y2 = d``.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from estimators import Gaussian
from estimators.engine import compiled
from vessel_gym.disturbances import Sea
from vessel_gym.envs.own import register_environment
from vessel_gym.models.estimation import tuning
from vessel_gym.system import System
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.tasks.task import Workspace
from vessel_gym.tasks.turning import TurningTrial
from vessel_gym.vehicles.corvette import COMPASS, MOTION_UNIT, linear_matrices
from vessel_gym.vehicles.corvette_equations import STATE
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.ship import Ship

DEG = np.pi / 180.0
SEAS = {
    "calm": Sea(wave=0.05 * DEG, peak=0.9, gust=0.02 * DEG, current=0.1),
    "moderate": Sea(wave=0.4 * DEG, peak=0.8, gust=0.1 * DEG, current=0.3),
    "rough": Sea(wave=1.0 * DEG, peak=0.6, gust=0.2 * DEG, current=0.6),
}


@dataclass(frozen=True)
class HeadingShip(Ship):
    """The thesis' ship, of which heading and yaw increment are measured. Known input: rudder, commanded yaw rate."""

    kinds = ("nonlinear", "corrected")
    linear_kinds = ("corrected",)
    sensors = (COMPASS, MOTION_UNIT)
    process_sd = np.array([0.08, 1.5e-3, 1e-4, 0.05])
    cruise = (np.array([0.0, 0.0, 0.0, 15.4]), np.zeros(2))

    def estimated(self, kind: str) -> tuple[str, ...]:
        return ("v", "r", "psi", "u")[: 4 if kind == "nonlinear" else 3]

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        v, r, psi, u = np.moveaxis(x, -1, 0)
        zero = np.zeros_like(v)
        return np.stack([zero, zero, psi, u, v, r, zero, zero], -1), zero[..., None]

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        (state, _), rudder = self.start(x), u[..., :1]
        exogenous = np.concatenate([np.zeros_like(flow[..., :1]), flow], -1)
        moved = self.step(state, rudder, rudder, exogenous, self.nominal_parameters)
        return moved[..., [STATE.index(name) for name in self.estimated("nonlinear")]]

    def known_input(
        self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None
    ) -> np.ndarray:
        return super().known_input(before, after, commanded)[..., :2]

    def linear(self, kind: str) -> tuple[Any, ...]:
        flows = len(self.ambient_flows)
        return *linear_matrices(self.ship, self.dt), np.zeros((3, flows))


@compiled
@dataclass(frozen=True)
class TurningCircle(TurningTrial):
    """The commanded heading leads into a steady turn: straight, a ramp of the yaw rate, a circle.

    A scenario is ``(initial heading, commanded yaw rate)``, a reference ``(heading, yaw rate now, ahead and at last)``.
    """

    pace: float = 1.0
    horizon: int = 600

    uniforms = 3
    prior_sd = (0.2, 0.002, 0.03, 0.2)

    @cached_property
    def track(self) -> CircleTrack:
        return CircleTrack(self.ship, self.pace)

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        return self.track.scenario(uniforms, options)[:, :2]

    def prior(self, scenario: np.ndarray) -> Gaussian:
        mean = np.zeros((len(scenario), 4))
        mean[:, 2], mean[:, 3] = scenario[:, 0], self.ship.speed
        return self._spread.about(mean)

    @compiled(axes=(1, 0))
    def command(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray:
        heading, rate = scenario[..., 0], scenario[..., 1]
        elapsed, ramp = step * self.dt - self.track.lead, self.track.ramp
        share = np.clip(elapsed / ramp, 0.0, 1.0)
        ahead = np.clip((elapsed + self.preview) / ramp, 0.0, 1.0)
        turned = 0.5 * ramp * share * share + np.maximum(elapsed - ramp, 0.0)
        return np.stack([heading + rate * turned, rate * share, rate * ahead, rate], -1)

    def commanded(
        self, scenario: np.ndarray, step: np.ndarray, reference: np.ndarray
    ) -> np.ndarray:
        return reference[..., 1:2]

    def workspace(self, scenario: np.ndarray) -> Workspace:
        options = {"radius": self.ship.speed / scenario[1]}
        return self.track.workspace(self.track.scenario(np.zeros((1, 3)), options)[0])

    def exogenous(self, scenario: np.ndarray, step: np.ndarray) -> np.ndarray:
        return np.zeros((*scenario.shape[:-1], 1 + len(Ship.ambient_flows)))


SHIP = load("corvette-thesis")
HEADING_SHIP = System(
    name="HeadingShip-v0",
    vehicle=HeadingShip(SHIP),
    task=TurningCircle(SHIP),
    disturbances=SEAS,
    estimator="kf-umv-ui",
    filter_model="corrected",
    filter_models=dict.fromkeys(("ekf", "ukf", "enkf", "enkf-sr", "etkf", "pf"), "nonlinear"),
    tuning=tuning,
)
register_environment(HEADING_SHIP)
