"""PPO on estimates and on the truth, in environments of third parties."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from agents.seeds import evaluation_seeds, training_seed
from estimators import Gaussian, NonlinearModel
from vessel_gym.wrappers import EstimatedObservation

EPISODES = 100
ARMS = "truth", "ukf"


def _falling(start: float) -> Callable[[float], float]:
    """A rate that falls to 0 with the share of the budget that is left."""
    return lambda left: start * left


def balance(x: np.ndarray, u: Any) -> np.ndarray:
    """A step of CartPole-v1."""
    place, speed, angle, rate = np.moveaxis(x, -1, 0)
    sine, cosine = np.sin(angle), np.cos(angle)
    force = (20.0 * u[..., 0] - 10.0 + 0.05 * rate**2 * sine) / 1.1
    turn = (9.8 * sine - cosine * force) / (0.5 * (4.0 / 3.0 - 0.1 * cosine**2 / 1.1))
    push = force - 0.05 * turn * cosine / 1.1
    return np.stack([place + 0.02 * speed, speed + 0.02 * push, angle + 0.02 * rate, rate + 0.02 * turn], -1)


def swing(x: np.ndarray, u: Any) -> np.ndarray:
    """A step of Pendulum-v1."""
    rate = np.clip(x[..., 1] + (15.0 * np.sin(x[..., 0]) + 3.0 * u[..., 0]) * 0.05, -8.0, 8.0)
    return np.stack([x[..., 0] + 0.05 * rate, rate], -1)


@dataclass(frozen=True, eq=False)
class Trial:
    """One environment.

    Attributes:
        env_id: Its name.
        given: What `EstimatedObservation` is given of it.
        steps: Budget of a training.
        envs: As many at once.
        options: PPO's, those of RL Baselines3 Zoo.
    """

    env_id: str
    given: dict[str, Any]
    steps: int
    envs: int
    options: dict[str, Any]

    def made(self, estimator: str) -> gym.Env:
        """The environment, of which positions and angles are read with noise, and rates are not."""
        return EstimatedObservation(gym.make(self.env_id), estimator=estimator, **self.given)


CART_POLE: dict[str, Any] = {
    "model": NonlinearModel(balance, lambda x, u: x[..., [0, 2]], 1e-8 * np.eye(4), np.diag([4e-4, 1e-4])),
    "prior": Gaussian(np.zeros(4), np.eye(4) * 0.05**2 / 3.0),
}
PENDULUM: dict[str, Any] = {
    "model": NonlinearModel(
        swing, lambda x, u: x[..., :1], 1e-8 * np.eye(2), 0.05**2 * np.eye(1), state_angles=(0,),
        measurement_angles=(0,),
    ),
    "prior": Gaussian(np.zeros(2), np.diag([3.3, 0.33])),
    "state": lambda env, obs: env.unwrapped.state,
    "observation": lambda x: [np.cos(x[..., 0]), np.sin(x[..., 0]), x[..., 1]],
}  # fmt: skip
TRIALS = {
    "cart-pole": Trial(
        "CartPole-v1", CART_POLE | {"state": lambda env, obs: env.unwrapped.state}, 50_000, 8,
        {"n_steps": 32, "batch_size": 256, "gae_lambda": 0.8, "gamma": 0.98, "n_epochs": 20, "ent_coef": 0.0,
         "learning_rate": _falling(1e-3), "clip_range": _falling(0.2)},
    ),
    "pendulum": Trial(
        "Pendulum-v1", PENDULUM, 100_000, 4,
        {"n_steps": 1024, "gae_lambda": 0.95, "gamma": 0.9, "n_epochs": 10, "ent_coef": 0.0, "learning_rate": 1e-3,
         "clip_range": 0.2, "use_sde": True, "sde_sample_freq": 4},
    ),
}  # fmt: skip


def learned(trial: Trial, arm: str, seed: int) -> list[float]:
    """Returns of an agent that PPO has trained on an estimator, on the seeds of everybody's evaluation."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    first = training_seed(seed)
    env = make_vec_env(partial(trial.made, arm), n_envs=trial.envs, seed=first)
    model = PPO("MlpPolicy", env, seed=first, device="cpu", **trial.options)
    model.learn(trial.steps)
    return _returns(trial.made(arm), lambda seen: model.predict(seen, deterministic=True)[0])


def random(trial: Trial) -> list[float]:
    """Returns of random actions."""
    env = trial.made("truth")
    env.action_space.seed(0)
    return _returns(env, lambda seen: env.action_space.sample())


def _returns(env: gym.Env, policy: Callable[[np.ndarray], Any]) -> list[float]:
    returns = []
    for seed in evaluation_seeds(EPISODES):
        seen, _ = env.reset(seed=seed)
        total, over = 0.0, False
        while not over:
            seen, reward, terminated, truncated, _ = env.step(policy(seen))
            total, over = total + float(reward), terminated or truncated
        returns.append(total)
    return returns
