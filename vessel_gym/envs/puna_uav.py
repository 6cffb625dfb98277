"""PunaUAV-v0: a small aircraft flies a Dubins path round obstacles with a filter in the loop."""

from vessel_gym.envs.fixed_wing import fixed_wing_system
from vessel_gym.envs.shared import documented
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

PUNA_UAV = fixed_wing_system("puna", "PunaUAV-v0")


@documented
class PunaUAVEnv(VesselEnv):
    """Fly a path round obstacles to a goal with an estimator in the loop."""

    system = PUNA_UAV


class PunaUAVVectorEnv(VesselVectorEnv):
    """The native batch of `PunaUAVEnv`, which documents spaces, rewards and arguments."""

    system = PUNA_UAV
