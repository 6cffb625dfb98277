"""Ship-v0, SigmaCorvette-v0, SigmaChannel-v0: ships hold a turning circle or keep to a channel."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vessel_gym.caching import cached
from vessel_gym.checks import instance
from vessel_gym.disturbances.seaway import Seaway
from vessel_gym.disturbances.spectrum import WaveSpectrum, WaveSystem
from vessel_gym.models.estimation import tuning
from vessel_gym.system import System
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.ship import Ship, pace

_KNOT = 1852.0 / 3600.0
_LINEAR = ("kf", "kf-umv-ui-wdf", "ulise", "huber-kf", "robust-kf")


def seas(ship: CorvetteParameters, dt: float, direction: float = 0.0) -> dict[str, Seaway]:
    """NATO sea states 2, 4, 5 (Bales et al. 1981) at steps of ``dt`` [s]; currents are assumed.

    Waves and wind run to a ``direction`` [rad from north].
    """

    def sea(height: float, period: float, wind: float, current: float) -> Seaway:
        spectrum = WaveSpectrum.of_systems(WaveSystem(height, period, direction))
        return Seaway(ship, spectrum, wind * _KNOT, current, dt, direction)

    return {
        "calm": sea(height=0.3, period=6.9, wind=8.5, current=0.1),
        "moderate": sea(height=1.88, period=8.8, wind=19.0, current=0.3),
        "rough": sea(height=3.25, period=9.7, wind=24.5, current=0.6),
    }


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
    return _of_ship(ship, name)


@cached
def _of_ship(ship: CorvetteParameters, name: str) -> System:
    """`ship_system` of parameters."""
    task = CircleTrack(ship, pace(ship))
    return System(
        name=name,
        vehicle=Ship(ship, task.dt),
        task=task,
        disturbances=seas(ship, task.dt),
        estimator="kf-umv-ui",
        filter_model="nonlinear",
        filter_models=dict.fromkeys(_LINEAR, "linear"),
        tuning=tuning,
    )


def channel_system(
    vessel: str | Path | CorvetteParameters,
    name: str = "vessel_gym/Channel-v0",
    waypoints: int = 8,
) -> System:
    """Environment in which a ship keeps to a channel.

    The channel leads north-east or north-west: waves that run to the south come from 45 degrees off
    the bow, those that run to the north from 45 degrees off the stern.

    Args:
        vessel: Ship, as for `ship_system`.
        name: Id of the environment.
        waypoints: Largest number of waypoints in a route. Room for 30 makes programs twice as
            slow.

    Raises:
        ValueError: as `ship_system`, or for fewer than 2 waypoints.
        OSError: if the file cannot be read.
    """
    return _in_channel(ship_system(vessel, name), waypoints)


@cached
def _in_channel(turning: Any, waypoints: int) -> System:
    """`channel_system` from the system of the turning circle."""
    from vessel_gym.tasks.channel import Channel  # late, as no other ship needs its path

    ship, quartering = turning.task.ship, turning.disturbances
    return replace(
        turning,
        task=Channel(ship, pace(ship), waypoints=waypoints),
        disturbances=seas(ship, turning.task.dt, np.pi)
        | {f"{sea} quartering": quartering[sea] for sea in ("moderate", "rough")},
    )
