"""Environments that nobody here wrote, with an estimator in their loop: what a user writes for each, in 12 lines."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from estimators import Gaussian, LinearModel, NonlinearModel
from vessel_gym.wrappers import EstimatedObservation, simulator


def cart_pole(**options: Any) -> gym.Env:
    def swing(x, u):
        p, v, a, w = np.moveaxis(x, -1, 0)
        t = (20.0 * u[..., 0] - 10.0 + 0.05 * w**2 * np.sin(a)) / 1.1
        turn = (9.8 * np.sin(a) - np.cos(a) * t) / (0.5 * (4.0 / 3.0 - 0.1 * np.cos(a) ** 2 / 1.1))
        slide = t - 0.05 * turn * np.cos(a) / 1.1
        return np.stack([p + 0.02 * v, v + 0.02 * slide, a + 0.02 * w, w + 0.02 * turn], -1)

    model = NonlinearModel(
        swing, lambda x, u: x[..., [0, 2]], 1e-9 * np.eye(4), np.diag([4e-4, 1e-4])
    )
    prior = Gaussian(np.zeros(4), np.eye(4) * 0.05**2 / 3)
    return EstimatedObservation(gym.make("CartPole-v1"), model, prior, _state, **options)


def _swing(x, u):
    rate = np.clip(x[..., 1] + (15.0 * np.sin(x[..., 0]) + 3.0 * u[..., 0]) * 0.05, -8.0, 8.0)
    return np.stack([x[..., 0] + 0.05 * rate, rate], -1)


def _angle(x, u):
    return x[..., :1]


def _state(env, seen):
    return env.unwrapped.state


def _seen(x):
    return np.stack([np.cos(x[..., 0]), np.sin(x[..., 0]), x[..., 1]], -1)


def pendulum(**options: Any) -> gym.Env:
    """Of functions that have names: it can be pickled."""
    angle = {"state_angles": (0,), "measurement_angles": (0,)}
    model = NonlinearModel(_swing, _angle, 1e-9 * np.eye(2), [[0.0025]], **angle)
    prior = Gaussian([0.0, 0.0], np.diag([3.3, 0.33]))
    return EstimatedObservation(gym.make("Pendulum-v1"), model, prior, _state, _seen, **options)


def mountain_car(**options: Any) -> gym.Env:
    env = gym.make("MountainCar-v0")
    model = simulator(env, lambda x, u: x[..., :1], Q=1e-11, R=1e-4)
    return EstimatedObservation(
        env, model, Gaussian([-0.5, 0.0], np.diag([0.0034, 0.0])), **options
    )


def acrobot(**options: Any) -> gym.Env:
    env = gym.make("Acrobot-v1")
    model = simulator(
        env, lambda x, u: x[..., :2], Q=1e-9, R=1e-4, state_angles=(0, 1), measurement_angles=(0, 1)
    )
    return EstimatedObservation(
        env, model, None, _state,
        lambda x: [np.cos(x[..., 0]), np.sin(x[..., 0]), np.cos(x[..., 1]), np.sin(x[..., 1]), x[..., 2], x[..., 3]],
        **options,
    )  # fmt: skip


def _known(action: Any) -> np.ndarray:
    """An action as the known input of a fitted model: with a 1 behind."""
    return np.concatenate([action, np.ones((*np.shape(action)[:-1], 1))], -1)


def _fitted(env_id: str, state: Callable[[Any], Any], C: np.ndarray) -> LinearModel:
    """A linear model from random steps, by least squares."""
    env = gym.make(env_id)
    env.action_space.seed(0)
    x, before, after = state(env.reset(seed=0)[0]), [], []
    while len(before) < 2000:
        action = env.action_space.sample()
        seen, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            seen, _ = env.reset()
        else:
            before.append([*x, *_known(action)])
            after.append(state(seen))
        x = state(seen)
    n, AB = len(x), np.linalg.lstsq(before, after)[0].T
    residuals = np.array(after) - np.array(before) @ AB.T
    Q = residuals.T @ residuals / (len(before) - AB.shape[1])
    return LinearModel(AB[:, :n], C, Q, 1e-4 * np.eye(len(C)), B=AB[:, n:])


def lunar_lander(**options: Any) -> gym.Env:
    env = gym.make("LunarLanderContinuous-v3")
    model = _fitted("LunarLanderContinuous-v3", lambda obs: obs[:6], np.eye(6)[[0, 1, 4]])
    return EstimatedObservation(
        env, model, None, lambda env, obs: obs[:6], passes=(6, 7), known_input=_known, **options
    )  # the legs' contacts pass


def _mujoco(
    name: str, observation: Callable, measurement: Callable, passes=(), **options: Any
) -> gym.Env:
    env = gym.make(name)
    model = simulator(env, measurement, Q=1e-8, R=1e-4)
    return EstimatedObservation(
        env, model, None, lambda env, obs: np.concatenate([env.unwrapped.data.qpos, env.unwrapped.data.qvel]),
        observation, passes, **options,
    )  # fmt: skip


def inverted_pendulum(**options: Any) -> gym.Env:
    return _mujoco("InvertedPendulum-v5", None, lambda x, u: x[..., :2], **options)


def hopper(**options: Any) -> gym.Env:
    def seen(x):
        return np.concatenate([x[..., 1:6], np.clip(x[..., 6:], -10.0, 10.0)], -1)

    return _mujoco("Hopper-v5", seen, lambda x, u: x[..., :6], **options)


def reacher(**options: Any) -> gym.Env:
    def seen(x):
        joints = x[..., :2]
        return np.concatenate([np.cos(joints), np.sin(joints), x[..., 2:4], x[..., 4:6]], -1)

    return _mujoco("Reacher-v5", seen, lambda x, u: x[..., :4], passes=(8, 9), **options)


def point_maze(**options: Any) -> gym.Env:
    import gymnasium_robotics

    gym.register_envs(gymnasium_robotics)
    model = _fitted("PointMaze_UMaze-v3", lambda obs: obs["observation"], np.eye(2, 4))
    return EstimatedObservation(
        gym.make("PointMaze_UMaze-v3"), model, None, lambda env, obs: obs["observation"],
        lambda x: {"observation": x, "achieved_goal": x[..., :2]}, ["desired_goal"], _known, **options,
    )  # fmt: skip
