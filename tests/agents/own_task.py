"""A task of one's own, of which the package knows nothing: ITSUNUSA keeps a depth. No subclass of any task of ours."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np

from estimators import Gaussian
from vessel_gym.envs import ItsunusaAUVEnv
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.sensors import Sensors
from vessel_gym.system import Estimate, System

CRUISE = ItsunusaAUVEnv.system.vehicle.body.cruise_speed


@dataclass(frozen=True)
class KeepDepth:
    """Stay at a depth 0 to 1 m below the start; a course and a reference are that depth ``(B, 1)``."""

    horizon: int = 60
    perfect: float = 60.0
    end_reasons: ClassVar[tuple[str, ...]] = ("", "lost")
    success: ClassVar[str] = ""
    uniforms: ClassVar[int] = 1
    BOUND: ClassVar[float] = 10.0

    def scenario(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        return uniforms.copy()

    def prior(self, scenario: np.ndarray) -> Gaussian:
        mean = np.zeros((len(scenario), 6))
        mean[:, 0] = CRUISE
        return Gaussian(mean, np.diag([0.05, 0.05, 0.02, 0.2, 0.2, 0.05]) ** 2)

    def reference(self, scenario: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        return scenario

    def commanded(self, scenario: np.ndarray, step: np.ndarray) -> None:
        return None

    def observe(
        self, estimate: Estimate, scenario: np.ndarray, reference: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        x = estimate.state
        return np.column_stack(
            [reference[:, 0] - x[:, 4], x[:, 1], x[:, 2], x[:, 5], x[:, 0] - CRUISE]
        )

    def observe_state(self, estimate: Estimate, scenario: np.ndarray) -> np.ndarray:
        return estimate.state

    def observe_std(self, estimate: Estimate) -> np.ndarray:
        assert estimate.sd is not None
        return estimate.sd

    def observe_measurements(
        self,
        sensors: Sensors,
        measurements: np.ndarray,
        available: np.ndarray,
        scenario: np.ndarray,
        step: np.ndarray,
    ) -> np.ndarray:
        return np.concatenate([measurements / sensors.scale, available], -1)

    def observe_mission(
        self, scenario: np.ndarray, step: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray:
        return scenario

    def over(self, scenario: np.ndarray, reference: np.ndarray) -> np.ndarray:
        return np.zeros(len(reference), bool)

    def initial_score_state(self, state: np.ndarray, scenario: np.ndarray) -> np.ndarray:
        return np.empty((len(state), 0))

    def score(
        self, state: np.ndarray, exogenous: np.ndarray, scenario: np.ndarray, reference: np.ndarray,
        over: np.ndarray, actuators: np.ndarray, action: np.ndarray, score_state: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        off = reference[:, 0] - state[:, 4]
        return 1.0 / (1.0 + off**2), (np.abs(off) > 10.0).astype(int), score_state


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


class DepthController:
    """Pitches by the depth error; made with the system, as any controller."""

    def __init__(self, system: System) -> None:
        self.task = system.task

    def reset(self, num_envs: int) -> None:
        pass

    def act(self, observations: np.ndarray) -> np.ndarray:
        deeper = np.clip(
            0.3 * observations[:, 0] + observations[:, 3] + observations[:, 2], -1.0, 1.0
        )
        return np.stack([deeper, np.zeros(len(deeper))], -1).astype(np.float32)


def no_agent(system: System) -> str:
    """What makes no agent."""
    return "controller"


if "KeepDepth-v0" not in gym.registry:
    gym.register(
        "KeepDepth-v0",
        entry_point=KeepDepthEnv,
        vector_entry_point=KeepDepthVectorEnv,
        max_episode_steps=KeepDepthVectorEnv.max_episode_steps,
    )
