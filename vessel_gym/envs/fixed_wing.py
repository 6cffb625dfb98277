"""FixedWing-v0 and PunaUAV-v0: a small aircraft flies a Dubins path round obstacles."""

from pathlib import Path

from vessel_gym.caching import cached
from vessel_gym.disturbances import Air
from vessel_gym.models.estimation import tuning
from vessel_gym.system import System
from vessel_gym.tasks.flight import Flight
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.puna import Puna, PunaParameters


def airs(dt: float, airspeed: float) -> dict[str, Air]:
    """Calm, moderate and rough air for steps of ``dt`` [s] and an airspeed [m/s]."""
    return {
        "calm": Air(wind=1.0, gust=0.35, vertical_gust=0.25, dt=dt, airspeed=airspeed),
        "moderate": Air(wind=3.0, gust=1.06, vertical_gust=0.7, dt=dt, airspeed=airspeed),
        "rough": Air(wind=5.0, gust=2.12, vertical_gust=1.4, dt=dt, airspeed=airspeed),
    }


def fixed_wing_system(
    vessel: str | Path, name: str = "vessel_gym/FixedWing-v0", as_printed: bool = False
) -> System:
    """Environment in which a small aircraft flies a Dubins path.

    The task is that of the PUNA, with lengths in proportion to the square of the cruise speed.

    Args:
        vessel: Vehicle file of an aircraft, or the name of an aircraft of the package.
        name: Id of the environment.
        as_printed: True for the misprints of eq. 1 in world and filter, see
            `vessel_gym.vehicles.puna.printed_rates`.

    Raises:
        ValueError: for an error in the file; the message names its line.
        OSError: if the file cannot be read.
    """
    return _of_body(load(vessel, PunaParameters), name, as_printed)


@cached
def _of_body(body: PunaParameters, name: str, as_printed: bool) -> System:
    """`fixed_wing_system` of parameters."""
    share = (body.cruise_speed / 20.0) ** 2  # a turn at the same bank is so much wider
    task = Flight(
        body,
        radius=130.0 * share,
        distance=(600.0 * share, 900.0 * share),
        obstacle_radius=(30.0 * share, 60.0 * share),
        ahead=(20.0 * share, 60.0 * share),
        horizon=round(900 * body.cruise_speed / 20.0),
    )
    vehicle, airs_by_name = Puna(body, as_printed=as_printed), airs(task.dt, body.cruise_speed)
    return System(name, vehicle, task, airs_by_name, "enkf", "nonlinear", tuning)
