"""The environments: two thin faces on the batched core, and one module of data an environment.

They may import all other folders of `vessel_gym`; users import them by `gymnasium.make`.
"""

from vessel_gym.envs.auv import AUVEnv, AUVVectorEnv
from vessel_gym.envs.fixed_wing import FixedWingEnv, FixedWingVectorEnv
from vessel_gym.envs.itsunusa_auv import ItsunusaAUVEnv, ItsunusaAUVVectorEnv
from vessel_gym.envs.own import register_environment
from vessel_gym.envs.puna_uav import PunaUAVEnv, PunaUAVVectorEnv
from vessel_gym.envs.segorogeni_auv import SegorogeniAUVEnv, SegorogeniAUVVectorEnv
from vessel_gym.envs.ship import ShipEnv, ShipVectorEnv
from vessel_gym.envs.sigma_channel import SigmaChannelEnv, SigmaChannelVectorEnv
from vessel_gym.envs.sigma_corvette import SigmaCorvetteEnv, SigmaCorvetteVectorEnv
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.thesis_corvette import ThesisCorvetteEnv, ThesisCorvetteVectorEnv
from vessel_gym.envs.vector import VesselVectorEnv

__all__ = [
    "AUVEnv",
    "AUVVectorEnv",
    "FixedWingEnv",
    "FixedWingVectorEnv",
    "ItsunusaAUVEnv",
    "ItsunusaAUVVectorEnv",
    "PunaUAVEnv",
    "PunaUAVVectorEnv",
    "SegorogeniAUVEnv",
    "SegorogeniAUVVectorEnv",
    "ShipEnv",
    "ShipVectorEnv",
    "SigmaChannelEnv",
    "SigmaChannelVectorEnv",
    "SigmaCorvetteEnv",
    "SigmaCorvetteVectorEnv",
    "ThesisCorvetteEnv",
    "ThesisCorvetteVectorEnv",
    "VesselEnv",
    "VesselVectorEnv",
    "register_environment",
]
