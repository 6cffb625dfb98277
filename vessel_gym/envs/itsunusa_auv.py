"""ItsunusaAUV-v0: an underwater vehicle dives in the vertical plane with a filter in the loop."""

from vessel_gym.envs.auv import auv_system
from vessel_gym.envs.shared import documented
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

ITSUNUSA_AUV = auv_system("itsunusa", "ItsunusaAUV-v0")


@documented
class ItsunusaAUVEnv(VesselEnv):
    """Dive in the vertical plane with an estimator in the loop."""

    system = ITSUNUSA_AUV


class ItsunusaAUVVectorEnv(VesselVectorEnv):
    """The native batch of `ItsunusaAUVEnv`, which documents spaces, rewards and arguments."""

    system = ITSUNUSA_AUV
