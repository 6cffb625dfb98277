"""AUV-v0, SegorogeniAUV-v0, ItsunusaAUV-v0: torpedo-shaped vehicles that dive along a curve."""

import math
from pathlib import Path
from typing import Any

from vessel_gym.caching import cached
from vessel_gym.disturbances.disturbance import Disturbance
from vessel_gym.disturbances.spectrum import WaveSpectrum, WaveSystem
from vessel_gym.disturbances.water import SurfaceWater, Water
from vessel_gym.models.estimation import tuning
from vessel_gym.models.state_space import StateSpace
from vessel_gym.system import System
from vessel_gym.tasks.dive import SpatialDive, VerticalDive
from vessel_gym.vehicles.auv import AUVParameters
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.itsunusa import STATE as PLANE
from vessel_gym.vehicles.itsunusa import Itsunusa, ItsunusaParameters
from vessel_gym.vehicles.segorogeni import STATE as SPACE
from vessel_gym.vehicles.segorogeni import Segorogeni


def _waters(spin: float, state: tuple[str, ...], **of_vehicle: Any) -> dict[str, Disturbance]:
    """Waters by name, the last with waves; ``spin`` is the ratio of increments of rates and speeds.

    Turbulence is given by the increments [m/s] of 0.1 s.
    """
    figures = {"calm": (0.002, 0.05), "moderate": (0.005, 0.10), "rough": (0.010, 0.20)}
    waters = {}
    for name, (increment, current) in figures.items():
        turbulence = increment / math.sqrt(0.1)
        waters[name] = Water(turbulence, spin * turbulence, current, **of_vehicle)
    place = tuple(state.index(name) for name in ("x", "y") if name in state)
    spectrum = WaveSpectrum.of_systems(WaveSystem(height=0.88, period=7.5))
    above = SurfaceWater(spectrum, waters["moderate"], place, state.index("z"))
    return waters | {"surface": above}


WATERS = _waters(1.0, SPACE)
PLANE_WATERS = _waters(0.5, PLANE, velocities=("u", "w"), rates=("q",), names=("current",))


def auv_system(
    vessel: str | Path, name: str = "vessel_gym/AUV-v0", as_printed: bool = False
) -> System:
    """Environment in which a torpedo-shaped vehicle dives, in space or in the vertical plane.

    The vehicle file selects space or plane. The dive is that of Segorogeni or, in the plane, that
    of ITSUNUSA, with lengths in proportion to the cruise speed.

    Args:
        vessel: Vehicle file of an underwater vehicle, or the name of a vehicle of the package.
        name: Id of the environment.
        as_printed: True for the misprints of the source papers. In space these are kinematics that
            know yaw alone, eqs. 1-4, in world and filter; in the plane the update of ``enkf-sr``,
            Table 1.

    Raises:
        ValueError: for an error in the file; the message names its line.
        OSError: if the file cannot be read.
    """
    return _of_body(load(vessel, AUVParameters), name, as_printed)


def _printed_tuning(name: str, space: StateSpace) -> dict[str, Any]:
    """Options of filters, with the misprint of ``enkf-sr``."""
    return tuning(name, space) | ({"as_printed": True} if name == "enkf-sr" else {})


@cached
def _of_body(body: Any, name: str, as_printed: bool) -> System:
    """`auv_system` of parameters."""
    if isinstance(body, ItsunusaParameters):
        share = body.cruise_speed / 1.5
        plane = VerticalDive(
            body, (60.0 * share, 0.0, 20.0 * share), (2.0 * share, 0.0, share), 5.0 * share, 600
        )
        linear = dict.fromkeys(("kf", "kf-umv-ui", "kf-umv-ui-wdf", "ulise"), "steady dives")
        return System(
            name, Itsunusa(body), plane, PLANE_WATERS, "enkf-sr", "nonlinear",
            _printed_tuning if as_printed else tuning, linear,
        )  # fmt: skip
    share = body.cruise_speed
    goal, spread = (10.0 * share, 18.0 * share, 6.0 * share), (share, share, 0.5 * share)
    space = SpatialDive(body, goal, spread, 2.5 * share, 500)
    vehicle = Segorogeni(body, as_printed=as_printed)
    return System(name, vehicle, space, WATERS, "enkf", "nonlinear", tuning)
