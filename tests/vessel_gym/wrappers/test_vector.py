"""An estimator in the loop of many environments at once: rows are as single environments."""

from functools import partial
from typing import Any

import anybody
import gymnasium as gym
import numpy as np
import pytest
from anybody import LINEAR, LINEAR_PRIOR, Linear, cart_pole, pendulum
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from refusals import refused
from scipy.linalg import solve_discrete_are
from scipy.stats import chi2

from estimators.metrics import nees
from vessel_gym.wrappers import EstimatedObservation
from vessel_gym.wrappers.vector import EstimatedObservation as EstimatedObservations


def _many(rows: int, estimator: str, mode: AutoresetMode, **options: Any) -> EstimatedObservations:
    made, single = partial(gym.make, "CartPole-v1", max_episode_steps=30), cart_pole().watch
    envs = SyncVectorEnv([made] * rows, autoreset_mode=mode)
    states = lambda env, seen: [each.unwrapped.state for each in env.envs]  # noqa: E731
    return EstimatedObservations(
        envs, single.model, single.prior, states, estimator=estimator, **options
    )


def _single(estimator: str) -> EstimatedObservation:
    env, single = gym.make("CartPole-v1", max_episode_steps=30), cart_pole().watch
    state = lambda env, seen: env.unwrapped.state  # noqa: E731
    given = {"estimator": estimator, "sensors": "degraded"}
    return EstimatedObservation(env, single.model, single.prior, state, **given)


@pytest.mark.parametrize("estimator", ["ekf", "enkf", "pf", "truth"])
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_rows_of_a_vector_are_as_single_ones(estimator: str, mode: AutoresetMode):
    many, over = _many(3, estimator, mode, sensors="degraded"), np.zeros(3, bool)
    ones = [_single(estimator) for _ in range(3)]
    seen, _ = many.reset(seed=7)
    for i, one in enumerate(ones):
        np.testing.assert_array_equal(one.reset(seed=7 + i)[0], seen[i])
    rng = np.random.default_rng(0)
    for _ in range(60):
        actions = rng.integers(0, 2, 3)
        if mode is AutoresetMode.DISABLED and over.any():
            seen, info = many.reset(options={"reset_mask": over})
            for i in np.flatnonzero(over):
                np.testing.assert_array_equal(ones[i].reset()[0], seen[i])
            over[:] = False
        seen, _, terminated, truncated, info = many.step(actions)
        for i, one in enumerate(ones):
            alone, *_, single_info = one.reset() if over[i] else one.step(actions[i])
            np.testing.assert_array_equal(alone, seen[i])
            np.testing.assert_array_equal(single_info["measurement"], info["measurement"][i])
        over = terminated | truncated
    assert many.watch.now.episode.min() >= 1


def test_a_native_batch_is_wrapped_as_others_are():
    env = gym.make_vec("CartPole-v1", num_envs=64, vectorization_mode="vector_entry_point")
    single = cart_pole().watch
    wrapped = EstimatedObservations(
        env,
        single.filter.model,
        single.prior,
        lambda env, obs: env.unwrapped.state.T,
        estimator="ukf",
    )
    wrapped.reset(seed=0)
    for _ in range(50):
        *_, info = wrapped.step(wrapped.action_space.sample())
    assert np.abs(info["truth"] - info["estimate"]).max() < 0.5
    assert wrapped.watch.now.episode.max() > 0


def test_functions_of_a_batch_must_keep_its_rows():
    single = pendulum().watch
    envs = SyncVectorEnv([partial(gym.make, "Pendulum-v1")] * 4)
    given = {"model": single.model, "prior": single.prior, "state": _pendulum_states}
    env = EstimatedObservations(envs, **given, observation=lambda x: [np.cos(x[:, 0]), *x.T])
    with refused(
        ValueError, r"observation must give a row of 3 numbers for each of 4, got shape \(3, 4\)"
    ):
        env.reset(seed=0)
    turned = {"observation": anybody._seen, "known_input": np.transpose}
    env = EstimatedObservations(envs, **given, **turned)
    env.reset(seed=0)
    with refused(ValueError, "known_input must give a row of 1 numbers for each of 4"):
        env.step(np.zeros((4, 1), np.float32))


def test_seed_concerns_reset_rows_alone():
    many = _many(2, "ekf", AutoresetMode.DISABLED)
    ones = [_many(1, "ekf", AutoresetMode.DISABLED) for _ in range(2)]
    for seeds, mask in (
        ([7, 9], [True, True]),
        ([50, 51], [True, False]),
        ([60, 61], [False, True]),
        (None, None),
    ):
        reset = np.ones(2, bool) if mask is None else np.array(mask)
        _, info = many.reset(seed=seeds, options={"reset_mask": reset})
        for i in np.flatnonzero(reset):
            _, alone = ones[i].reset(seed=None if seeds is None else [seeds[i]])
            np.testing.assert_array_equal(alone["truth"][0], info["truth"][i])
            np.testing.assert_array_equal(alone["measurement"][0], info["measurement"][i])


def test_batches_that_hide_how_episodes_end_are_refused():
    with pytest.raises(
        ValueError, match="resets in the same step hides the state in which an episode ended"
    ):
        _many(2, "ekf", AutoresetMode.SAME_STEP)


def _pendulum_states(env, seen):
    return np.array([each.unwrapped.state for each in env.unwrapped.envs])


def test_step_before_reset_gets_one_sentence():
    env = _linear(2, "ekf")
    env.env.reset(seed=0)
    with pytest.raises(gym.error.ResetNeeded, match=r"call reset\(\) before step\(\)"):
        env.step(np.zeros((2, 1)))


# --- statistics -----------------------------------------------------------------------------------


def _linear(rows: int, estimator: str, **options: Any) -> EstimatedObservations:
    """As many linear environments: rows are as single ones."""
    return EstimatedObservations(
        SyncVectorEnv([Linear] * rows), LINEAR, LINEAR_PRIOR, estimator=estimator, **options
    )


@pytest.mark.parametrize("estimator", ["kf", "ekf", "ukf", "etkf"])
def test_filter_is_consistent_under_noise_of_its_model(estimator: str):
    """One late time of 300 independent episodes: false alarm 1e-4."""
    options = {"members": 200} if estimator == "etkf" else {}
    env = _linear(300, estimator, estimator_options=options)
    env.reset(seed=0)
    for _ in range(15):
        *_, info = env.step(np.zeros((300, 1)))
    low, high = chi2.interval(1.0 - 1e-4, 300 * 2)
    assert low < nees(info["estimate"], info["covariance"], info["truth"]).sum() < high


def test_a_linear_regulator_on_estimates_costs_what_riccati_says():
    """The mean cost of a step, 20 seeds, within 3 standard errors of LQG's."""
    A, B, Q, C, R = Linear.A, Linear.B, Linear.Q, LINEAR.C, LINEAR.R
    effort = 0.1 * np.eye(1)
    S = solve_discrete_are(A, B, np.eye(2), effort)
    K = np.linalg.solve(B.T @ S @ B + effort, B.T @ S @ A)
    P = solve_discrete_are(A.T, C.T, Q, R)
    after = P - P @ C.T @ np.linalg.solve(C @ P @ C.T + R, C @ P)
    expected = np.trace(S @ Q) + np.trace(after @ K.T @ (B.T @ S @ B + effort) @ K)
    env, costs = _linear(20, "kf"), np.zeros(20)
    seen, _ = env.reset(seed=0)
    for k in range(1500):
        seen, reward, *_ = env.step(-seen @ K.T)
        costs -= reward / 1400 if k >= 100 else 0.0
    error = np.std(costs, ddof=1) / np.sqrt(20)
    assert abs(np.mean(costs) - expected) < 3.0 * error
