"""Environments of other packages with an estimator in their loop, and a linear one."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from estimators import Gaussian, LinearModel, NonlinearModel
from vessel_gym.wrappers import EstimatedObservation


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
    def roll(x, u):
        pushed = x[..., 1] + 0.001 * (u[..., 0] - 1.0) - 0.0025 * np.cos(3.0 * x[..., 0])
        velocity = np.clip(pushed, -0.07, 0.07)
        place = np.clip(x[..., 0] + velocity, -1.2, 0.6)
        return np.stack([place, np.where(place <= -1.2, np.maximum(velocity, 0.0), velocity)], -1)

    model = NonlinearModel(roll, lambda x, u: x[..., :1], 1e-11 * np.eye(2), [[1e-4]])
    return EstimatedObservation(
        gym.make("MountainCar-v0"), model, Gaussian([-0.5, 0.0], np.diag([0.0034, 0.0])), **options
    )


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


def _joints(env: gym.Env, _: Any) -> np.ndarray:
    return np.concatenate([env.unwrapped.data.qpos, env.unwrapped.data.qvel])


def _mujoco(name: str, observation: Any, measured: int, **options: Any) -> gym.Env:
    """Its model is a copy whose state is set and stepped; the first states are measured."""
    copy = gym.make(name).unwrapped
    copy.reset()
    q = copy.model.nq

    def step(x, action):
        copy.set_state(x[:q], x[q:])
        copy.step(action)
        return _joints(copy, None)

    model = NonlinearModel(
        np.vectorize(step, signature="(n),(m)->(n)"), lambda x, u: x[..., :measured],
        1e-8 * np.eye(2 * q), 1e-4 * np.eye(measured),
    )  # fmt: skip
    return EstimatedObservation(gym.make(name), model, None, _joints, observation, **options)


def inverted_pendulum(**options: Any) -> gym.Env:
    return _mujoco("InvertedPendulum-v5", None, 2, **options)


def reacher(**options: Any) -> gym.Env:
    def seen(x):
        joints = x[..., :2]
        return np.concatenate([np.cos(joints), np.sin(joints), x[..., 2:4], x[..., 4:6]], -1)

    return _mujoco("Reacher-v5", seen, 4, passes=(8, 9), **options)


def point_maze(**options: Any) -> gym.Env:
    import gymnasium_robotics

    gym.register_envs(gymnasium_robotics)
    model = _fitted("PointMaze_UMaze-v3", lambda obs: obs["observation"], np.eye(2, 4))
    return EstimatedObservation(
        gym.make("PointMaze_UMaze-v3"), model, None, lambda env, obs: obs["observation"],
        lambda x: {"observation": x, "achieved_goal": x[..., :2]}, passes=["desired_goal"],
        known_input=_known, **options,
    )  # fmt: skip


_NEEDS = dict.fromkeys(("inverted_pendulum", "reacher"), "mujoco") | {
    "lunar_lander": "Box2D",
    "point_maze": "gymnasium_robotics",
}


def built(name: str, **options: Any) -> gym.Env:
    """The environment that the function of this name makes, if its package is installed."""
    if name in _NEEDS:
        pytest.importorskip(_NEEDS[name])
    return globals()[name](**options)


class Linear(gym.Env):
    """``x+ = A x + B u + w``: a linear environment whose noise is the model's."""

    A, B, Q = np.array([[1.0, 0.1], [-0.1, 0.95]]), np.array([[0.0], [0.1]]), np.diag([1e-4, 4e-4])
    observation_space = gym.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gym.spaces.Box(-10.0, 10.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.np_random.normal(size=2) * 0.3
        return self.x.copy(), {}

    def step(self, action):
        noise = np.sqrt(np.diag(self.Q)) * self.np_random.normal(size=2)
        reward = -float(self.x @ self.x + 0.1 * action @ action)
        self.x = self.A @ self.x + self.B @ action + noise
        return self.x.copy(), reward, False, False, {}


LINEAR = LinearModel(Linear.A, [[1.0, 0.0]], Linear.Q, [[0.01]], B=Linear.B)
LINEAR_PRIOR = Gaussian([0.0, 0.0], 0.09 * np.eye(2))


def flown(env: gym.Env, steps: int = 40, seed: int = 5) -> list[dict[str, Any]]:
    """Info and observation of each moment, under random actions."""
    seen, info = env.reset(seed=seed)
    moments = [info | {"observation": seen}]
    env.action_space.seed(0)
    for _ in range(steps):
        seen, _, terminated, truncated, info = env.step(env.action_space.sample())
        moments.append(info | {"observation": seen})
        if terminated or truncated:
            seen, info = env.reset()
            moments.append(info | {"observation": seen})
    return moments
