"""A task of one's own, of which the package knows nothing: ITSUNUSA keeps a depth. No subclass of any task of ours."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np

from estimators import Belief, Gaussian
from vessel_gym.envs import ItsunusaAUVEnv
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.system import System

CRUISE = ItsunusaAUVEnv.system.vehicle.body.cruise_speed


@dataclass(frozen=True)
class KeepDepth:
    """Stay at a depth 0 to 1 m below the start; a course and a reference are that depth ``(B, 1)``."""

    horizon: int = 60
    perfect: float = 60.0
    ends: ClassVar[tuple[str, ...]] = ("", "lost")
    success: ClassVar[str] = ""
    states: ClassVar[int] = 7
    uniforms: ClassVar[int] = 1
    BOUND: ClassVar[float] = 10.0

    def course(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        return uniforms.copy()

    def prior(self, course: np.ndarray, disturbance: Any) -> Gaussian:
        mean = np.zeros((len(course), 7))
        mean[:, 0] = CRUISE
        return Gaussian(mean, np.diag([0.05, 0.05, 0.02, 0.2, 0.2, 0.05, disturbance.current_sd]) ** 2)

    def reference(self, course: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        return course

    def known_input(self, before: np.ndarray, after: np.ndarray, course: np.ndarray, step: np.ndarray) -> np.ndarray:
        return np.concatenate([before, after], -1)

    def sizes(self) -> dict[str, int]:
        return {"mean": 5, "mean+std": 12, "measurement": 13}

    def observe(self, belief: Belief, reference: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        x = belief.mean
        return np.column_stack([reference[:, 0] - x[:, 4], x[:, 1], x[:, 2], x[:, 5], x[:, 0] - CRUISE])

    def observe_std(self, belief: Belief) -> np.ndarray:
        return np.sqrt(np.diagonal(belief.cov, axis1=-2, axis2=-1))

    def observe_readings(
        self, readings: np.ndarray, available: np.ndarray, course: np.ndarray, step: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        return np.concatenate([readings, available, course], -1)

    def begin(self, truth: np.ndarray, course: np.ndarray) -> np.ndarray:
        return np.empty((len(truth), 0))

    def score(
        self, truth: np.ndarray, reference: np.ndarray, actuators: np.ndarray, action: np.ndarray, tally: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        off = reference[:, 0] - truth[:, 4]
        return 1.0 / (1.0 + off**2), (np.abs(off) > 10.0).astype(int), tally


@dataclass(frozen=True)
class KeepShallowDepth(KeepDepth):
    """A kind of it."""


def system_with(task: Any) -> System:
    return replace(ItsunusaAUVEnv.system, name="KeepDepth-v0", task=task)


class KeepDepthEnv(VesselEnv):
    system = system_with(KeepDepth())


class KeepDepthVectorEnv(VesselVectorEnv):
    system = system_with(KeepDepth())
    max_episode_steps = 60


class DepthPilot:
    """Pitches by the depth error; made with the system, as any pilot."""

    def __init__(self, system: System) -> None:
        self.task = system.task

    def reset(self, num_envs: int) -> None:
        pass

    def act(self, observations: np.ndarray) -> np.ndarray:
        deeper = np.clip(0.3 * observations[:, 0] + observations[:, 3] + observations[:, 2], -1.0, 1.0)
        return np.stack([deeper, np.zeros(len(deeper))], -1).astype(np.float32)


def no_agent(system: System) -> str:
    """What makes no agent."""
    return "pilot"


if "KeepDepth-v0" not in gym.registry:
    gym.register(
        "KeepDepth-v0",
        entry_point=KeepDepthEnv,
        vector_entry_point=KeepDepthVectorEnv,
        max_episode_steps=KeepDepthVectorEnv.max_episode_steps,
    )
