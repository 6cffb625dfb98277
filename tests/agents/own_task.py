"""A task of one's own, of which the package knows nothing: ITSUNUSA keeps a depth."""

from dataclasses import replace
from typing import Any

import numpy as np

from vessel_gym.envs import ItsunusaAUVEnv, register_environment
from vessel_gym.system import System
from vessel_gym.tasks.task import Task


class KeepDepth(Task):
    """Stay at a depth 0 to 1 m below the start, which is scenario and reference."""

    vehicle = ItsunusaAUVEnv.system.vehicle
    horizon, uniforms, end_reasons = 60, 1, ("", "lost")
    prior_sd = 0.05, 0.05, 0.02, 0.2, 0.2, 0.05

    def score(
        self, state: np.ndarray, exogenous: np.ndarray, scenario: np.ndarray, reference: np.ndarray,
        over: np.ndarray, actuators: np.ndarray, action: np.ndarray, score_state: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        off = reference[:, 0] - state[:, 4]
        return 1.0 / (1.0 + off**2), (np.abs(off) > 10.0).astype(int), score_state


class KeepShallowDepth(KeepDepth):
    """A kind of it."""


def system_with(task: Any) -> System:
    return replace(ItsunusaAUVEnv.system, name="KeepDepth-v0", task=task)


class DepthController:
    """Pitches by the depth error; made with the system, as any controller."""

    def __init__(self, system: System) -> None:
        self.task = system.task

    def reset(self, num_envs: int) -> None:
        pass

    def act(self, observations: np.ndarray) -> np.ndarray:
        _, _, q, _, z, theta, _, depth, *_ = observations.T
        deeper = np.clip(0.3 * (depth - z) + theta + q, -1.0, 1.0)
        return np.stack([deeper, np.zeros(len(deeper))], -1).astype(np.float32)


def no_agent(system: System) -> str:
    """What makes no agent."""
    return "controller"


SYSTEM = system_with(KeepDepth())
register_environment(SYSTEM)
