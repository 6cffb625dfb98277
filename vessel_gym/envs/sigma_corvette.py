"""SigmaCorvette-v0: a SIGMA-class corvette holds a turning circle with a filter in the loop."""

from vessel_gym.envs.shared import documented
from vessel_gym.envs.ship import ship_system
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

SIGMA_CORVETTE = ship_system("corvette", "SigmaCorvette-v0")
SEAS = SIGMA_CORVETTE.disturbances


@documented
class SigmaCorvetteEnv(VesselEnv):
    """Hold a turning circle, as a place on the map, with an estimator in the loop."""

    system = SIGMA_CORVETTE


class SigmaCorvetteVectorEnv(VesselVectorEnv):
    """The native batch of `SigmaCorvetteEnv`, which documents spaces, rewards and arguments."""

    system = SIGMA_CORVETTE
