"""ItsunusaAUV-v0: an underwater vehicle dives in the vertical plane on what a filter believes."""

from typing import Any

from vessel_gym.disturbances import Water
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.system import System
from vessel_gym.tasks.dive import VerticalDive
from vessel_gym.vehicles.itsunusa import Itsunusa, ItsunusaParameters

WATERS = {
    "calm": Water(turbulence=0.002, spin=0.001, current=0.05, velocities=2, rates=1, currents=1),
    "moderate": Water(turbulence=0.005, spin=0.0025, current=0.10, velocities=2, rates=1, currents=1),
    "rough": Water(turbulence=0.010, spin=0.005, current=0.20, velocities=2, rates=1, currents=1),
}

_VEHICLE = Itsunusa(ItsunusaParameters())


def _tuning(name: str, water: Any) -> dict[str, Any]:
    # An ensemble of 100 is a little too sure of itself; 1 + 1/N mends that (docs/dives.md).
    if name in ("enkf", "enkf-sr", "etkf"):
        return {"members": 100, "inflation": 1.01, "localisation": _VEHICLE.localisation}
    return {}


ITSUNUSA_AUV = System(
    name="ItsunusaAUV-v0",
    vehicle=_VEHICLE,
    task=VerticalDive(auv=_VEHICLE.body, goal=(60.0, 0.0, 20.0), goal_spread=(2.0, 0.0, 1.0), ahead=5.0, horizon=600),
    disturbances=WATERS,
    estimator="enkf-sr",
    filter_model="nonlinear",
    tuning=_tuning,
)


class ItsunusaAUVEnv(VesselEnv):
    """Dive in the vertical plane on what an estimator believes."""

    system = ITSUNUSA_AUV


class ItsunusaAUVVectorEnv(VesselVectorEnv):
    """The native batch of `ItsunusaAUVEnv`, which documents spaces, rewards and arguments."""

    system = ITSUNUSA_AUV
