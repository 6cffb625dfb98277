"""The adapter to stable-baselines3, checked against single environments."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecEnv, VecVideoRecorder

import vessel_gym  # noqa: F401  (registers the environments)
from agents.training.vec_env import StableBaselinesVecEnv

ENV = "SigmaCorvette-v0"
LIMIT = 100
ROWS = 4


def adapter(rows: int = ROWS, **options: Any) -> StableBaselinesVecEnv:
    return StableBaselinesVecEnv(
        gym.make_vec(ENV, num_envs=rows, max_episode_steps=LIMIT, **options)
    )


def leaning_actions(seed: int, rows: int = ROWS) -> np.ndarray:
    """Random actions that lean hard to one side in half of the rows, whose episodes end early."""
    rng = np.random.default_rng(seed)
    lean = np.where(np.arange(rows) % 2, 1.0, 0.0)[:, None]
    side = rng.choice([-1.0, 1.0], (rows, 1))
    return np.clip(side * lean + rng.normal(0.0, 0.2, (330, rows, 1)), -1.0, 1.0).astype(np.float32)


@pytest.mark.parametrize("mode", AutoresetMode)
def test_every_step_is_that_of_a_batch_that_resets_in_it(mode: AutoresetMode):
    env, batch = (
        adapter(disturbance="rough", autoreset_mode=each)
        for each in (mode, AutoresetMode.SAME_STEP)
    )
    assert isinstance(env, VecEnv)
    assert env.seed(48) == [48, 49, 50, 51]
    np.testing.assert_array_equal(env.reset(), batch.env.reset(seed=48)[0])
    returns, lengths, truncations, kept = np.zeros(ROWS), np.zeros(ROWS, int), [], []
    for actions in leaning_actions(1):
        observations, rewards, dones, infos = env.step(actions)
        expected, reward, terminated, truncated, info = batch.env.step(actions)
        np.testing.assert_array_equal(observations, expected)
        np.testing.assert_allclose(rewards, reward, rtol=0, atol=1e-6)
        np.testing.assert_array_equal(dones, terminated | truncated)
        assert observations.dtype == rewards.dtype == np.float32
        returns += reward
        lengths += 1
        for i, own in enumerate(infos):
            if dones[i]:
                last = own["terminal_observation"]
                kept.append((last, info["final_obs"][i].copy()))
                truncations.append(own["TimeLimit.truncated"])
                assert own["TimeLimit.truncated"] == (truncated[i] and not terminated[i])
                assert own["is_success"] is info["final_info"]["is_success"].item(i)
                assert own["episode"] == {"r": pytest.approx(returns[i]), "l": lengths[i]}
                assert own["score"] == info["final_info"]["score"][i]
            else:
                assert own == {}
        returns[dones], lengths[dones] = 0.0, 0
    assert 4 <= sum(truncations) <= len(truncations) - 4
    for last, expected in kept:  # it does not change when the environment goes on
        np.testing.assert_array_equal(last, expected)


def test_rewards_are_scaled_and_returns_of_episodes_are_not():
    batches = [gym.make_vec("PunaUAV-v0", num_envs=2, max_episode_steps=5) for _ in range(2)]
    envs = [StableBaselinesVecEnv(batches[0]), StableBaselinesVecEnv(batches[1], 100.0)]
    for env in envs:
        env.seed(3)
        env.reset()
    for _ in range(5):
        (_, plain, _, infos), (_, scaled, dones, others) = (
            env.step(np.zeros((2, 3), np.float32)) for env in envs
        )
        assert (plain > 0.0).any()
        np.testing.assert_array_equal(scaled, 100.0 * plain)
    assert dones.all()
    assert [each["episode"]["r"] for each in infos] == [each["episode"]["r"] for each in others]


def test_another_autoreset_mode_is_refused_in_a_sentence():
    env = gym.make_vec("CartPole-v1", num_envs=2, vectorization_mode="sync")
    with pytest.raises(ValueError, match=r"with SAME_STEP autoreset, this one has .*NEXT_STEP"):
        StableBaselinesVecEnv(env)


def test_a_seed_and_options_hold_for_the_next_reset_alone():
    env, plain = adapter(), adapter()
    env.set_options({"radius": 400.0})
    for each in (env, plain):
        each.seed(2)
    observations, others = env.reset(), plain.reset()
    for row in range(ROWS):
        expected, _ = gym.make(ENV).reset(seed=2 + row, options={"radius": 400.0})
        np.testing.assert_allclose(observations[row], expected, rtol=0, atol=1e-6)
    assert (observations != others).any()
    for _ in range(5):
        env.step(np.zeros((ROWS, 1)))
    env.seed(2)
    np.testing.assert_array_equal(env.reset(), others)
    lengths = []
    for _ in range(LIMIT):  # the count of an episode has begun again
        lengths += [info["episode"]["l"] for info in env.step(np.zeros((ROWS, 1)))[3] if info]
    assert max(lengths) == LIMIT
    assert (env.reset() != others).any()
    env.set_options([{"radius": 300.0 + row} for row in range(ROWS)])
    with pytest.raises(ValueError, match=r"share their reset options: give one"):
        env.reset()


def test_gymnasiums_own_batches_with_the_same_autoreset_work_too():
    same = {"autoreset_mode": AutoresetMode.SAME_STEP}
    batch = gym.make_vec("CartPole-v1", 3, "sync", vector_kwargs=same)
    env, ended = StableBaselinesVecEnv(batch), 0
    env.seed(0)
    env.reset()
    for _ in range(60):
        observations, _, dones, infos = env.step(np.ones(3, int))
        # never the fallen pole of the ended episode
        assert (np.abs(observations[:, 2]) < 0.21).all()
        last = [infos[i]["terminal_observation"][2] for i in np.flatnonzero(dones)]
        assert (np.abs(last) > 0.2).all()
        ended += len(last)
    assert ended > 6
    both = np.array([True, True, False]), np.array([True, False, True])
    last = {"final_obs": observations, "final_info": {}}
    env.env.step = lambda actions: (observations, np.ones(3), *both, last)
    cut = [info["TimeLimit.truncated"] for info in env.step(np.ones(3, int))[3]]
    assert cut == [False, False, True]  # only what did not terminate was cut off


def test_adapter_answers_or_refuses_each_request():
    env = adapter()
    assert env.get_attr("max_episode_steps") == [LIMIT] * ROWS
    assert env.get_attr("max_episode_steps", [0, 2]) == [LIMIT] * 2
    with pytest.warns(UserWarning, match="without a render_mode"):
        assert env.get_images() == [None] * ROWS
    assert env.env_is_wrapped(gym.wrappers.TimeLimit) == [False] * ROWS
    with pytest.raises(NotImplementedError, match=r"set env.env.max_episode_steps"):
        env.set_attr("max_episode_steps", 3)
    with pytest.raises(NotImplementedError, match=r"call env.env.reset"):
        env.env_method("reset")
    assert env.has_attr("max_episode_steps")
    assert not env.has_attr("no_such_attribute")


def test_stable_baselines3_evaluates_a_policy_without_a_warning(tmp_path: Path):
    env = adapter(disturbance="calm", render_mode="rgb_array")
    network = {"net_arch": [8]}
    model = PPO("MlpPolicy", env, policy_kwargs=network, seed=0, device="cpu")
    returns, _ = evaluate_policy(model, env, n_eval_episodes=6, return_episode_rewards=True)
    assert len(returns) == 6
    recorder = VecVideoRecorder(env, str(tmp_path), lambda step: step == 0, video_length=2)
    assert recorder.frames_per_sec == env.env.metadata["render_fps"]
    recorder.reset()
    for _ in range(3):
        recorder.step(np.zeros((ROWS, 1)))
    recorder.close()
    assert [path.suffix for path in tmp_path.iterdir()] == [".mp4"]
