"""SegorogeniAUV-v0: an underwater vehicle dives along a curve in three dimensions with a filter in the loop."""

from vessel_gym.envs.auv import auv_system
from vessel_gym.envs.shared import documented
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

SEGOROGENI_AUV = auv_system("segorogeni", "SegorogeniAUV-v0")


@documented
class SegorogeniAUVEnv(VesselEnv):
    """Dive along a curve in three dimensions with an estimator in the loop."""

    system = SEGOROGENI_AUV


class SegorogeniAUVVectorEnv(VesselVectorEnv):
    """The native batch of `SegorogeniAUVEnv`, which documents spaces, rewards and arguments."""

    system = SEGOROGENI_AUV
