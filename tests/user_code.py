"""Code as the pages show it, for type checkers: `make lint` runs mypy, `make nightly` pyright."""

from pathlib import Path
from typing import assert_type

import gymnasium as gym
import numpy as np

from agents import Episode, Rollout, episode, load_agent, rollout
from agents.seeds import evaluation_seeds
from agents.statistics import Interval, mean_interval, paired_difference
from estimators import (
    Belief,
    Filter,
    Gaussian,
    LinearModel,
    NonlinearModel,
    check_filter,
    make,
    nees,
    rmse,
    run,
)
from vessel_gym import check_system, model_of
from vessel_gym.envs import SegorogeniAUVEnv, register_environment
from vessel_gym.wrappers import EstimatedObservation


class FixedGain(Filter):
    """A filter with the names of its arrays in its methods."""

    def __init__(self, model, gain=0.1):
        super().__init__(model)
        self.gain = gain

    def _predict(self, belief, u, mean, A, Q):
        return {"mean": mean, "cov": A @ belief.cov @ A.mT + Q}

    def _update(self, belief, u, e, C, R, available):
        return {"mean": belief.mean + self.gain * np.matvec(C.mT, e)}


def estimates() -> np.ndarray:
    """Lists wherever a filter takes arrays, and arrays wherever it returns them."""
    A, C, R = [[1.0, 0.1], [0.0, 1.0]], [[1.0, 0.0]], [[0.25]]
    filter = make("kf", LinearModel(A, C, np.diag([1e-4, 1e-2]), R, state_angles=(0,)))
    belief = filter.init(Gaussian([0.0, 0.0], np.eye(2)))
    belief = filter.update(filter.predict(belief), [0.3], available=[True], R=[[0.1]])
    assert_type(belief, Belief)
    assert_type(belief.mean, np.ndarray)
    assert_type(belief.with_rows(belief.healthy, belief).cov, np.ndarray)
    series = run(filter, Gaussian([0.0, 0.0], np.eye(2)), [[0.1], [0.2]], t=[0.0, 0.1])
    assert_type(series.updated.mean, np.ndarray)
    assert_type(nees([[0.0]], [[[1.0]]], [[0.1]]), np.ndarray)
    return rmse(series.updated.mean, [[0.0, 0.0], [0.0, 0.0]])


def own_filter() -> None:
    """A filter and a model of one's own."""
    swing = NonlinearModel(
        lambda x, u: np.stack([x[..., 0] + 0.1 * x[..., 1], x[..., 1]], -1),
        lambda x, u: x[..., :1],
        Q=1e-4 * np.eye(2),
        R=[[0.01]],
    )
    check_filter(FixedGain, swing, gain=0.2)
    check_filter(FixedGain, *model_of("SigmaCorvette-v0"))
    prior = Gaussian([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]])
    state = lambda env, seen: env.unwrapped.state  # noqa: E731
    env = EstimatedObservation(gym.make("Pendulum-v1"), swing, prior, state=state, estimator="ekf")
    env.reset(seed=0)


def voyage() -> Episode:
    """Scores, differences and pictures."""
    seeds = evaluation_seeds(3)
    runs = [
        rollout("autopilot", "PunaUAV-v0", seeds, {"estimator": each}) for each in ("ekf", "kf")
    ]
    assert_type(runs[0], Rollout)
    assert_type(runs[0].history["truth"], np.ndarray)
    assert_type(mean_interval([0.1, 0.2, 0.3]), Interval)
    assert_type(paired_difference(runs[0].score, runs[1].score), Interval)
    shown = episode("SigmaCorvette-v0", ["ekf", FixedGain], seed=seeds[0])
    shown.save("voyage.pdf")
    shown.save(Path("voyage.html"))
    return shown


def environment() -> str:
    """An environment of one's own, steered by the package's agent."""
    system = SegorogeniAUVEnv.system
    check_system(system)
    load_agent("autopilot", gym.make(register_environment(system), max_episode_steps=100))
    return system.name
