"""Ship-v0, SigmaCorvette-v0, SigmaChannel-v0: ships hold a turning circle or keep to a channel."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vessel_gym.checks import instance
from vessel_gym.envs.shared import documented
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.filter_models.build import BESIDE_BIASES, OF_UNKNOWN_INPUTS, Composition
from vessel_gym.seaway import Seaway
from vessel_gym.system import System
from vessel_gym.tasks.channel import Channel
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.ship import Ship, pace
from vessel_gym.verified import verified

_KNOT = 1852.0 / 3600.0
_LINEAR = ("kf", "kf-umv-ui-wdf", "ulise", "huber-kf", "robust-kf")


def seas(ship: CorvetteParameters, dt: float) -> dict[str, Seaway]:
    """NATO sea states 2, 4, 5 (Bales et al. 1981) at steps of ``dt`` [s]; currents are assumed."""
    return {
        "calm": Seaway(ship, height=0.3, period=6.9, wind=8.5 * _KNOT, current=0.1, dt=dt),
        "moderate": Seaway(ship, height=1.88, period=8.8, wind=19.0 * _KNOT, current=0.3, dt=dt),
        "rough": Seaway(ship, height=3.25, period=9.7, wind=24.5 * _KNOT, current=0.6, dt=dt),
    }


@verified
def input_tuning(name: str, composition: Composition) -> dict[str, Any]:
    """Options of filters: the variance of the yaw increment, and the radius of `robust-kf`."""
    if name == "robust-kf":
        return {"radius": BESIDE_BIASES}
    if name in OF_UNKNOWN_INPUTS and composition.inputs:
        return {"input_prior": composition.forces.input_cov}
    return {}


def ship_system(
    vessel: str | Path | CorvetteParameters, name: str = "vessel_gym/Ship-v0"
) -> System:
    """Environment in which a ship holds a turning circle.

    All times are those of the corvette, in proportion to the time in which the ship sails its own
    length. A slow ship gets longer steps, not more of them.

    Args:
        vessel: Vehicle file of a ship, the name of a ship of the package, or parameters of a ship.
        name: Id of the environment.

    Raises:
        ValueError: for an error in the file; the message names its line.
        OSError: if the file cannot be read.
    """
    instance("name", name, str)
    ship = vessel if isinstance(vessel, CorvetteParameters) else load(vessel, CorvetteParameters)
    task = CircleTrack(ship, pace(ship))
    return System(
        name=name,
        vehicle=Ship(ship, task.dt),
        task=task,
        disturbances=seas(ship, task.dt),
        estimator="kf-umv-ui",
        filter_model="nonlinear",
        filter_models=dict.fromkeys(_LINEAR, "linear"),
        tuning=input_tuning,
    )


class ShipEnv(VesselEnv):
    """Hold a turning circle with a ship of your own, with an estimator in the loop.

    Spaces, rewards and arguments are those of docs/environments/sigma-corvette.md. Times and the
    length of a step are in proportion to the time in which the ship sails its own length, and yaw
    rates in inverse proportion.

    Args:
        vessel: Vehicle file of a ship (docs/vehicles.md), or the name of a ship of the package.
        options: Arguments of `VesselEnv`.

    Raises:
        ValueError: for an error in the file; the message names its line. Otherwise as
            `VesselEnv`.
    """

    system = ship_system("mariner")

    def __init__(self, vessel: str | Path = "mariner", **options: Any) -> None:
        self.system = ship_system(vessel)  # type: ignore[misc]
        super().__init__(**options)


class ShipVectorEnv(VesselVectorEnv):
    """Vector environment of `ShipEnv`, which documents the arguments."""

    system = ShipEnv.system

    def __init__(self, num_envs: int = 1, vessel: str | Path = "mariner", **options: Any) -> None:
        self.system = ship_system(vessel)  # type: ignore[misc]
        super().__init__(num_envs, **options)


SIGMA_CORVETTE = ship_system("corvette", "SigmaCorvette-v0")
SEAS: Mapping[str, Any] = SIGMA_CORVETTE.disturbances
SIGMA_CHANNEL = replace(
    SIGMA_CORVETTE,
    name="SigmaChannel-v0",
    task=Channel(load("corvette", CorvetteParameters)),
    # The channel leads north-east or north-west: waves that run to the south come from 45 degrees
    # off the bow, those that run to the north from 45 degrees off the stern.
    disturbances={name: replace(sea, direction=np.pi) for name, sea in SEAS.items()}
    | {f"{name} quartering": SEAS[name] for name in ("moderate", "rough")},
)


@documented
class SigmaCorvetteEnv(VesselEnv):
    """Hold a turning circle over ground with an estimator in the loop."""

    system = SIGMA_CORVETTE


class SigmaCorvetteVectorEnv(VesselVectorEnv):
    """Vector environment of `SigmaCorvetteEnv`; manual: docs/environments/sigma-corvette.md."""

    system = SIGMA_CORVETTE


@documented
class SigmaChannelEnv(VesselEnv):
    """Keep to a channel in bow or quartering seas, with an estimator in the loop."""

    system = SIGMA_CHANNEL


class SigmaChannelVectorEnv(VesselVectorEnv):
    """Vector environment of `SigmaChannelEnv`; manual: docs/environments/sigma-channel.md."""

    system = SIGMA_CHANNEL
