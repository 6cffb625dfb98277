"""A registered environment of others behind an estimator, and an agent for it."""

from typing import Any

import gymnasium as gym
import numpy as np

from estimators import Gaussian, NonlinearModel
from vessel_gym.wrappers import EstimatedObservation


def swing(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Angle and rate of the pendulum after a step."""
    rate = np.clip(x[..., 1] + (15.0 * np.sin(x[..., 0]) + 3.0 * u[..., 0]) * 0.05, -8.0, 8.0)
    return np.stack([x[..., 0] + 0.05 * rate, rate], -1)


def make(estimator: Any = "ukf", render_mode: str | None = None, **options: Any) -> gym.Env:
    """The pendulum, of which the angle is measured."""
    angle = {"state_angles": (0,), "measurement_angles": (0,)}
    model = NonlinearModel(swing, lambda x, u: x[..., :1], 1e-6 * np.eye(2), [[0.0025]], **angle)
    return EstimatedObservation(
        gym.make("Pendulum-v1", render_mode=render_mode), model, Gaussian([0.0, 0.0], np.diag([3.3, 0.33])),
        lambda env, obs: env.unwrapped.state, lambda x: [np.cos(x[..., 0]), np.sin(x[..., 0]), x[..., 1]],
        estimator=estimator, **options,
    )  # fmt: skip


class Brake:
    """Torque against the rate."""

    def __init__(self, system: Any) -> None:
        assert (system.name, system.vehicle.dt, system.task.horizon) == ("Swinging-v0", 0.05, 40)

    def reset(self, num_envs: int) -> None:
        """Nothing to forget."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Torque ``(B, 1)``."""
        return np.clip(-observations[:, 2:], -2.0, 2.0).astype(np.float32)


gym.register("Swinging-v0", entry_point=make, max_episode_steps=40)
