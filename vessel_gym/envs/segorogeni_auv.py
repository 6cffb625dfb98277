"""SegorogeniAUV-v0: an underwater vehicle dives along a curve in three dimensions on what a filter believes."""

from typing import Any

from vessel_gym.disturbances import Water
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.system import System
from vessel_gym.tasks.dive import SpatialDive
from vessel_gym.vehicles.segorogeni import Segorogeni, SegorogeniParameters

WATERS = {
    "calm": Water(turbulence=0.002, spin=0.002, current=0.05),
    "moderate": Water(turbulence=0.005, spin=0.005, current=0.10),
    "rough": Water(turbulence=0.010, spin=0.010, current=0.20),
}

_VEHICLE = Segorogeni(SegorogeniParameters())


def _tuning(name: str, water: Any) -> dict[str, Any]:
    # An ensemble of 100 is a little too sure of itself; 1 + 1/N mends that (docs/dives.md).
    if name in ("enkf", "enkf-sr", "etkf"):
        return {"members": 100, "inflation": 1.01, "localisation": _VEHICLE.localisation}
    return {}


SEGOROGENI_AUV = System(
    name="SegorogeniAUV-v0",
    vehicle=_VEHICLE,
    task=SpatialDive(auv=_VEHICLE.body, goal=(10.0, 18.0, 6.0), goal_spread=(1.0, 1.0, 0.5), ahead=2.5, horizon=500),
    disturbances=WATERS,
    estimator="enkf",
    filter_model="nonlinear",
    tuning=_tuning,
)


class SegorogeniAUVEnv(VesselEnv):
    """Dive along a curve in three dimensions on what an estimator believes."""

    system = SEGOROGENI_AUV


class SegorogeniAUVVectorEnv(VesselVectorEnv):
    """The native batch of `SegorogeniAUVEnv`, which documents spaces, rewards and arguments."""

    system = SEGOROGENI_AUV
