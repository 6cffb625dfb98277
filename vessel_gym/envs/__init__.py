"""The environments: single and vector classes on the batched core, and one module for each family.

They may import all other folders of `vessel_gym`; users create them by `gymnasium.make`.
"""

from vessel_gym.envs.auv import (
    AUVEnv,
    AUVVectorEnv,
    ItsunusaAUVEnv,
    ItsunusaAUVVectorEnv,
    SegorogeniAUVEnv,
    SegorogeniAUVVectorEnv,
)
from vessel_gym.envs.fixed_wing import (
    FixedWingEnv,
    FixedWingVectorEnv,
    PunaUAVEnv,
    PunaUAVVectorEnv,
)
from vessel_gym.envs.own import register_environment
from vessel_gym.envs.ship import (
    ShipEnv,
    ShipVectorEnv,
    SigmaChannelEnv,
    SigmaChannelVectorEnv,
    SigmaCorvetteEnv,
    SigmaCorvetteVectorEnv,
)
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
