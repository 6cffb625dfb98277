"""ItsunusaAUV-v0: an underwater vehicle dives in the vertical plane on what a filter believes."""

from vessel_gym.envs.auv import auv_system
from vessel_gym.envs.shared import documented
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

ITSUNUSA_AUV = auv_system("itsunusa", "ItsunusaAUV-v0")


@documented
class ItsunusaAUVEnv(VesselEnv):
    """Dive in the vertical plane on what an estimator believes."""

    system = ITSUNUSA_AUV


class ItsunusaAUVVectorEnv(VesselVectorEnv):
    """The native batch of `ItsunusaAUVEnv`, which documents spaces, rewards and arguments."""

    system = ITSUNUSA_AUV
