"""Ship-v0: any ship of a vehicle file holds a turning circle on what a filter believes."""

from pathlib import Path
from typing import Any

import numpy as np

from vessel_gym.composition import Composition
from vessel_gym.disturbances import Sea
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.system import System
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette import Corvette
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.files import load

_DEG = np.pi / 180.0
_NONLINEAR = ("ekf", "ukf", "enkf", "enkf-sr", "etkf")


def seas(dt: float) -> dict[str, Sea]:
    """Calm, moderate and rough seas at steps of ``dt`` [s]: as the corvette meets them, whatever the ship."""
    return {
        "calm": Sea(wave=0.05 * _DEG, peak=0.9, gust=0.02 * _DEG, current=0.1, dt=dt),
        "moderate": Sea(wave=0.4 * _DEG, peak=0.8, gust=0.1 * _DEG, current=0.3, dt=dt),
        "rough": Sea(wave=1.0 * _DEG, peak=0.6, gust=0.2 * _DEG, current=0.6, dt=dt),
    }


def _tuning(name: str, told: Composition) -> dict[str, Any]:
    if name in ("kf-umv-ui", "ulise"):
        return {"input_prior": told.forces.kick_cov}
    return {}


def ship_system(vessel: str | Path, name: str = "vessel_gym/Ship-v0") -> System:
    """A ship that turns, as an environment.

    All times are those of the corvette, times as long as the ship takes to sail its own length: a slow ship gets longer
    steps, not more of them.

    Args:
        vessel: A vehicle file of a ship, or the name of one that comes with the package.
        name: The environment's id.

    Raises:
        ValueError: for anything wrong in the file, in one sentence with its line.
        OSError: if the file cannot be read.
    """
    ship, corvette = load(vessel, CorvetteParameters), load("corvette", CorvetteParameters)
    pace = (ship.length / ship.speed) / (corvette.length / corvette.speed)
    task = TurningCircle(ship, pace)
    return System(
        name=name,
        vehicle=Corvette(ship, task.dt),
        task=task,
        disturbances=seas(task.dt),
        estimator="kf-umv-ui",
        filter_model="corrected",
        filter_models=dict.fromkeys(_NONLINEAR, "nonlinear"),
        tuning=_tuning,
    )


class ShipEnv(VesselEnv):
    """Hold a turning circle with a ship of one's own on what an estimator believes.

    `SigmaCorvetteEnv` documents spaces, rewards and arguments; times, yaw rates and the steps' length are in proportion
    to the time in which the ship sails its own length, and the corvette's file gives the corvette's environment.

    Args:
        vessel: A vehicle file of a ship (docs/vehicles.md), or the name of one that comes with the package.
        options: As `VesselEnv`.

    Raises:
        ValueError: for anything wrong in the file, in one sentence with its line; otherwise as `VesselEnv`.
    """

    system = ship_system("mariner")

    def __init__(self, vessel: str | Path = "mariner", **options: Any) -> None:
        self.system = ship_system(vessel)  # type: ignore[misc]
        super().__init__(**options)


class ShipVectorEnv(VesselVectorEnv):
    """The native batch of `ShipEnv`, which documents the arguments."""

    system = ShipEnv.system

    def __init__(self, num_envs: int = 1, vessel: str | Path = "mariner", **options: Any) -> None:
        self.system = ship_system(vessel)  # type: ignore[misc]
        super().__init__(num_envs, **options)
