"""The environments: two thin faces on the batched core, and one module of data an environment."""

from vessel_gym.envs.sigma_corvette import SigmaCorvetteEnv, SigmaCorvetteVectorEnv
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

__all__ = ["SigmaCorvetteEnv", "SigmaCorvetteVectorEnv", "VesselEnv", "VesselVectorEnv"]
