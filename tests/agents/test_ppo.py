"""PPO training: repeatable, on its own seeds, with checkpoints that are whole and say what they are for."""

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from short_training import STEPS, TINY
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecFrameStack

from agents import load_agent, rollout
from agents.policies.checkpoint import description
from agents.policies.lstm import LstmPolicy
from agents.seeds import evaluation_seeds, training_seed, tuning_seeds
from agents.training.algorithms import MEMORIES, batch, describe, hyperparameters, train
from agents.training.vec_env import StableBaselinesVecEnv
from estimators import ExtendedKalmanFilter
from vessel_gym.core import Core
from vessel_gym.sensor_faults import SensorFault

pytestmark = pytest.mark.usefixtures("tiny")
ENV = "SigmaCorvette-v0"
RAW = {"observe": "measurement", "estimator": "measurement"}


def weights(path: Path) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(path) as archive:
        return {
            name: np.load(archive.open(name))
            for name in archive.namelist()
            if name.startswith("weights/")
        }


@pytest.mark.slow
@pytest.mark.parametrize("memory", MEMORIES)
def test_the_same_seed_trains_the_same_policy_and_another_seed_another(tmp_path: Path, memory: str):
    one, other, third = (
        weights(train(ENV, tmp_path / f"{name}.zip", RAW, seed, STEPS, memory=memory))
        for name, seed in (("one", 3), ("other", 3), ("third", 4))
    )
    for key, value in one.items():  # on one machine: training carries rounding of another far
        np.testing.assert_array_equal(value, other[key], err_msg=key)
    assert len(one) > 5
    assert any((one[key] != third[key]).any() for key in one)
    assert (tmp_path / "one.zip").read_bytes() == (
        tmp_path / "other.zip"
    ).read_bytes()  # no times, no addresses


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "memory"), [(0, "none"), (3, "none"), (0, "frames"), (0, "lstm")])
def test_training_flies_its_own_seeds_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, memory: str
):
    flown: list[tuple[int, ...]] = []
    original = Core.step

    def step(core: Core, *args: Any, **kwargs: Any) -> Any:
        flown.append(tuple(core.seeds))
        return original(core, *args, **kwargs)

    monkeypatch.setattr(Core, "step", step)
    train(ENV, tmp_path / "agent.zip", seed=seed, steps=STEPS, memory=memory)
    assert len(flown) == STEPS // TINY["num_envs"]
    first = training_seed(seed)
    assert set(flown) == {tuple(range(first, first + TINY["num_envs"]))}
    used = set(flown[0])
    assert not used & set(evaluation_seeds(1_000_000))
    assert not used & set(tuning_seeds(1_000_000))


@pytest.mark.parametrize(
    ("memory", "options"), [("none", {"observe": "mean+std"}), ("lstm", RAW), ("frames", RAW)]
)
def test_a_checkpoint_flies_as_the_actor_that_was_saved(
    tmp_path: Path, saved: list[Any], memory: str, options: dict[str, Any]
):
    path = train(ENV, tmp_path / "agent.zip", options, steps=STEPS, memory=memory)
    model, frames, rows = saved[0], 3 if memory == "frames" else 1, 5
    env = gym.make(ENV, **options)
    size = env.observation_space.shape[0]
    agent = load_agent(path, env)
    agent.reset(rows)
    past = np.zeros((frames, rows, size), np.float32)
    rng, state, starts = np.random.default_rng(0), None, np.ones(rows, bool)
    for _ in range(4):
        new = rng.uniform(-3.0, 3.0, past[0].shape).astype(np.float32)
        past = np.concatenate([past[1:], new[None]])
        expected, state = model.predict(
            np.concatenate(list(past), -1), state, starts, deterministic=True
        )
        actions = agent.act(new)
        np.testing.assert_array_equal(actions, expected)
        assert env.action_space.contains(actions[0])
        starts[:] = False
    if memory == "none":
        np.testing.assert_array_equal(agent.act(new), actions)  # without exploration noise
    one, other = (rollout(str(path), ENV, [1, 2], options, record=False) for _ in range(2))
    np.testing.assert_array_equal(one.score, other.score)
    assert description(path)["policy"]["observations"] == frames * size


@pytest.mark.parametrize("env_id", [ENV, "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0"])
def test_training_on_raw_measurements_runs_no_filter_and_sees_the_same(env_id: str):
    """Observations, rewards and ends are those with the environment's own filter, to the last bit."""
    options = {"observe": "measurement", "sensors": "degraded", "max_episode_steps": 15}
    ours = batch(describe(env_id, options, 0, None), 3)
    env = gym.make_vec(env_id, num_envs=3, **options)
    theirs = StableBaselinesVecEnv(env)
    assert ours.env.unwrapped.core.estimator == "measurement" != env.unwrapped.core.estimator
    for each in (ours, theirs):
        each.seed(tuning_seeds(1)[0])
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    rng, size = np.random.default_rng(0), ours.action_space.shape
    for _ in range(40):
        actions = rng.uniform(-1.0, 1.0, (3, *size)).astype(np.float32)
        for one, other in zip(ours.step(actions)[:3], theirs.step(actions)[:3], strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_filter_that_ends_missions_is_kept():
    for options in ({"termination": "belief"}, {"observe": "mean"}):
        described = describe(ENV, {"observe": "measurement"} | options, 0, None)
        assert batch(described, 1).env.unwrapped.core.estimator == "kf-umv-ui"


def test_frames_at_flight_are_those_of_the_training_at_starts_and_ends_of_episodes(
    tmp_path: Path, saved: list[PPO]
):
    """Rows end at different times; each of their episodes is flown again from its raw observations alone."""
    path = train(ENV, tmp_path / "agent.zip", RAW, steps=STEPS, memory="frames")
    trained = saved[0]
    agent = load_agent(path, gym.make(ENV, **RAW))
    rows, limit = 4, 100
    hard_over = np.where(np.arange(rows) % 2, 1.0, 0.0)[
        :, None
    ]  # which loses the turn before its time

    def batch() -> StableBaselinesVecEnv:
        return StableBaselinesVecEnv(
            gym.make_vec(ENV, num_envs=rows, max_episode_steps=limit, disturbance="rough", **RAW)
        )

    raw, stacked = batch(), VecFrameStack(batch(), 3)
    for env in (raw, stacked):
        env.seed(tuning_seeds(1)[0])
    news, frames = raw.reset(), stacked.reset()
    lived: list[list[np.ndarray]] = [[] for _ in range(rows)]
    seen: list[list[np.ndarray]] = [[] for _ in range(rows)]
    ends = []
    for step in range(2 * limit + 10):
        for i in range(rows):
            lived[i].append(news[i].copy())
            seen[i].append(frames[i].copy())
        news, _, dones, infos = raw.step(hard_over)
        frames, _, _, stacked_infos = stacked.step(hard_over)
        for i in np.flatnonzero(dones):
            ends.append(step)
            lived[i].append(infos[i]["terminal_observation"])
            seen[i].append(stacked_infos[i]["terminal_observation"])
            agent.reset(1)
            flown = [agent.act(observation[None])[0] for observation in lived[i]]
            expected, _ = trained.predict(np.stack(seen[i]), deterministic=True)
            np.testing.assert_allclose(flown, expected, rtol=0, atol=1e-6)
            newest = trained.predict(np.roll(seen[i], news.shape[-1], axis=-1), deterministic=True)[
                0
            ]
            assert (np.abs(newest - expected) > 1e-3).any()  # the order of the frames matters to it
            lived[i], seen[i] = [], []
    assert len(ends) >= 2 * rows
    assert len(set(ends)) > 3


@pytest.mark.slow
@pytest.mark.parametrize("memory", ["frames", "lstm"])
def test_each_row_remembers_its_own_past_until_the_reset(tmp_path: Path, memory: str):
    path = train(ENV, tmp_path / "agent.zip", RAW, steps=STEPS, memory=memory)
    agent = load_agent(path, gym.make(ENV, **RAW))
    past = np.random.default_rng(0).uniform(-2.0, 2.0, (6, 3, 10)).astype(np.float32)
    past[-1] = past[-1, 0]  # all see the same in the end

    def flown(observations: np.ndarray) -> np.ndarray:
        agent.reset(observations.shape[1])
        return np.stack([agent.act(seen) for seen in observations])

    together = flown(past)
    assert together.shape == (6, 3, 1)
    assert np.ptp(together[-1]) > 1e-5
    for i in range(3):
        np.testing.assert_allclose(
            flown(past[:, i : i + 1])[:, 0], together[:, i], rtol=0, atol=1e-7
        )
    np.testing.assert_array_equal(flown(past), together)


def test_the_recurrent_policy_is_that_of_sb3_contrib_in_all_that_a_training_asks_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Episodes of five steps begin inside rollouts of sixteen, so sequences of unequal length are asked for."""
    ours, theirs = LstmPolicy._process_sequence, RecurrentActorCriticPolicy._process_sequence
    beginnings = []

    def both(features: Any, states: Any, starts: Any, lstm: Any) -> Any:
        output, last = ours(features, states, starts, lstm)
        expected, expected_last = theirs(features, states, starts, lstm)
        for one, other in zip((output, *last), (expected, *expected_last), strict=True):
            torch.testing.assert_close(one, other, rtol=0, atol=1e-6)
        beginnings.append((starts.numel() > states[0].shape[1], bool(starts.any())))
        return output, last

    monkeypatch.setattr(LstmPolicy, "_process_sequence", staticmethod(both))
    train(ENV, tmp_path / "agent.zip", {**RAW, "max_episode_steps": 5}, steps=STEPS, memory="lstm")
    assert (True, True) in beginnings


def test_descriptions_differ_by_memory_and_stand_in_the_checkpoint(tmp_path: Path):
    described = [describe(ENV, RAW, 0, STEPS, memory) for memory in MEMORIES]
    assert [one["memory"] for one in described] == list(MEMORIES)
    assert describe(ENV, RAW, 0, STEPS) == described[0]
    path = train(ENV, tmp_path / "agent.zip", RAW, steps=STEPS)
    assert description(path).items() >= described[0].items()
    assert description(path)["trained_steps"] == STEPS


def test_options_may_be_objects_and_the_checkpoint_holds_them_as_plain_data(tmp_path: Path):
    core = gym.make(ENV).unwrapped.core
    late = [replace(sensor, latency=2 * core.vehicle.dt) for sensor in core.sensors.each]
    options = {
        "estimator": ExtendedKalmanFilter, "sensors": late,
        "sensor_faults": [SensorFault(late[0].name, "bias", np.float64(0.1), begin=(1.0, 2.0))],
    }  # fmt: skip
    stored = description(train(ENV, tmp_path / "agent.zip", options, steps=STEPS))["env_options"]
    assert stored["estimator"] == "estimators.kalman:ExtendedKalmanFilter"
    assert [sensor["latency"] for sensor in stored["sensors"]] == [
        sensor.latency for sensor in late
    ]
    assert stored["sensor_faults"][0]["begin"] == [1.0, 2.0]
    with pytest.raises(TypeError, match=r"a checkpoint cannot say what .* in env_options is"):
        train(ENV, tmp_path / "agent.zip", {"estimator": object()}, steps=STEPS)


def test_training_leaves_the_user_s_threads_and_random_numbers_of_flights_alone(tmp_path: Path):
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        path = train(ENV, tmp_path / "agent.zip", steps=STEPS)
        agent = load_agent(path, gym.make(ENV))
        state = torch.random.get_rng_state()
        load_agent(path, gym.make(ENV))
        agent.act(np.zeros((1, 11), np.float32))
        assert torch.get_num_threads() == 2
        assert torch.equal(torch.random.get_rng_state(), state)
    finally:
        torch.set_num_threads(threads)


def test_an_unknown_memory_is_answered_with_those_that_there_are():
    with pytest.raises(
        ValueError, match="unknown memory 'elephant': choose from none, frames, lstm"
    ):
        hyperparameters(ENV, "elephant")
    assert "frames" not in hyperparameters(ENV)


@pytest.mark.parametrize(
    ("algorithm", "name", "value", "wanted"),
    [
        ("ppo", "target_kl", 0.02, None), ("ppo", "clip_range_vf", 0.2, None), ("ppo", "gamma", 1, None),
        ("sac", "ent_coef", "auto_0.1", None), ("sac", "ent_coef", 0.1, None), ("sac", "target_entropy", -2.0, None),
        ("sac", "learning_starts", 0, None), ("sac", "gradient_steps", -1, None), ("sac", "action_noise", 0.1, None),
        ("ppo", "gamma", 1.5, "between 0 and 1"), ("ppo", "gae_lambda", 7, "between 0 and 1"),
        ("ppo", "clip_range", 0, "a number above 0"), ("ppo", "clip_range_vf", -0.2, "a number above 0"),
        ("trpo", "target_kl", "low", "a number above 0"), ("sac", "tau", 2.0, "between 0 and 1"),
        ("sac", "ent_coef", -0.1, "'auto' or a number"), ("sac", "target_entropy", "much", "'auto' or a number"),
        ("sac", "target_entropy", "auto_3", "'auto' or a number"),
        ("tqc", "top_quantiles_to_drop_per_net", -1, "a whole number of at least 0"),
    ],
)  # fmt: skip
def test_a_setting_is_what_the_algorithm_takes(
    algorithm: str, name: str, value: Any, wanted: str | None
):
    if wanted is None:
        assert hyperparameters(ENV, "none", {name: value}, algorithm)[name] == value
    else:
        with pytest.raises(
            ValueError, match=rf"^the setting {name} must be {wanted}, got {value!r}$"
        ):
            hyperparameters(ENV, "none", {name: value}, algorithm)


def test_a_checkpoint_has_a_suffix_and_its_own_name_and_leaves_nothing_else_behind(tmp_path: Path):
    """Names with a point in them, as in a sweep, stay apart."""
    folder = tmp_path / "new" / "folder"
    paths = [train(ENV, folder / name, steps=STEPS) for name in ("rate-0.1", "rate-0.2.zip")]
    assert paths == [folder / "rate-0.1.zip", folder / "rate-0.2.zip"]
    assert set(folder.iterdir()) == set(paths)
    assert all(map(zipfile.is_zipfile, paths))


def test_a_training_that_breaks_off_leaves_the_old_checkpoint_as_it_was(tmp_path: Path):
    path = train(ENV, tmp_path / "agent.zip", steps=STEPS)
    before = path.read_bytes()

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(ENV, path, steps=STEPS, progress=interrupt)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["agent.zip"]


def test_progress_is_reported_after_each_rollout_up_to_the_end_of_the_last_one(tmp_path: Path):
    reported: list[tuple[int, int, float]] = []
    train(
        ENV, tmp_path / "agent.zip", steps=STEPS - 9, progress=lambda *args: reported.append(args)
    )
    assert [(done, whole) for done, whole, _ in reported] == [
        (0, 384),
        (128, 384),
        (256, 384),
        (384, 384),
    ]


def test_a_budget_below_one_batch_is_refused(tmp_path: Path):
    with pytest.raises(
        ValueError, match="steps must be at least the 8 environments of a batch, got 7"
    ):
        train(ENV, tmp_path / "agent.zip", steps=7)
    assert list(tmp_path.iterdir()) == []


def test_an_environment_without_settings_is_answered_with_those_that_have(tmp_path: Path):
    with pytest.raises(
        ValueError, match=r"no PPO settings for 'CartPole-v1' .*: choose from SigmaCorvette-v0"
    ):
        hyperparameters("CartPole-v1")
