"""PPO training: repeatable, on its own seeds, with checkpoints that are whole and say what they are for."""

import zipfile
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO

import agents.ppo
from agents import load_agent, rollout
from agents.ppo import PPOAgent, hyperparameters, train
from agents.seeds import evaluation_seeds, training_seed, tuning_seeds
from vessel_gym.core import Core

ENV = "SigmaCorvette-v0"
TINY = {"num_envs": 8, "n_steps": 16, "batch_size": 64, "n_epochs": 2, "net_arch": [8]}
STEPS = 3 * 8 * 16


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tuned settings with a small network and short rollouts."""
    tuned = hyperparameters(ENV)
    monkeypatch.setattr(agents.ppo, "hyperparameters", lambda env_id: {**tuned, **TINY})


def weights(path: Path) -> dict[str, np.ndarray]:
    return {key: value.numpy().copy() for key, value in PPO.load(path, device="cpu").policy.state_dict().items()}


def test_the_same_seed_trains_the_same_policy_and_another_seed_another(tmp_path: Path):
    one, other, third = (
        weights(train(ENV, tmp_path / f"{name}.zip", seed=seed, steps=STEPS))
        for name, seed in (("one", 3), ("other", 3), ("third", 4))
    )
    for key, value in one.items():
        np.testing.assert_array_equal(value, other[key], err_msg=key)
    assert any((one[key] != third[key]).any() for key in one)


@pytest.mark.parametrize("seed", [0, 3])
def test_training_flies_its_own_seeds_and_no_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int):
    flown: list[tuple[int, ...]] = []
    original = Core.step

    def step(core: Core, *args: Any, **kwargs: Any) -> Any:
        flown.append(tuple(core.seeds))
        return original(core, *args, **kwargs)

    monkeypatch.setattr(Core, "step", step)
    train(ENV, tmp_path / "agent.zip", seed=seed, steps=STEPS)
    assert len(flown) == STEPS // TINY["num_envs"]
    first = training_seed(seed)
    assert set(flown) == {tuple(range(first, first + TINY["num_envs"]))}
    used = set(flown[0])
    assert not used & set(evaluation_seeds(1_000_000))
    assert not used & set(tuning_seeds(1_000_000))


def test_a_checkpoint_flies_as_the_policy_that_was_saved(tmp_path: Path):
    path = train(ENV, tmp_path / "agent.zip", {"observe": "mean+std"}, steps=STEPS)
    env = gym.make(ENV, observe="mean+std")
    agent = load_agent(path, env)
    observations = np.random.default_rng(0).uniform(-3.0, 3.0, (5, 11)).astype(np.float32)
    actions = agent.act(observations)
    expected, _ = PPO.load(path, device="cpu").predict(observations, deterministic=True)
    np.testing.assert_array_equal(actions, expected)
    assert actions.shape == (5, 1)
    assert env.action_space.contains(actions[0])
    np.testing.assert_array_equal(agent.act(observations), actions)  # without exploration noise
    one, other = (rollout(str(path), ENV, [1, 2], {"observe": "mean+std"}) for _ in range(2))
    np.testing.assert_array_equal(one.score, other.score)


def test_a_checkpoint_leaves_nothing_else_behind(tmp_path: Path):
    path = train(ENV, tmp_path / "new" / "folder" / "agent.zip", steps=STEPS)
    assert path == tmp_path / "new" / "folder" / "agent.zip"
    assert [entry.name for entry in path.parent.iterdir()] == ["agent.zip"]
    assert zipfile.is_zipfile(path)


def test_a_suffix_is_added_and_the_name_is_kept(tmp_path: Path):
    """Names with a point in them, as in a sweep, stay apart."""
    paths = [train(ENV, tmp_path / name, steps=STEPS) for name in ("rate-0.1", "rate-0.2")]
    assert [path.name for path in paths] == ["rate-0.1.zip", "rate-0.2.zip"]


def test_a_training_that_breaks_off_leaves_the_old_checkpoint_as_it_was(tmp_path: Path):
    path = train(ENV, tmp_path / "agent.zip", steps=STEPS)
    before = path.read_bytes()

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(ENV, path, steps=STEPS, progress=interrupt)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["agent.zip"]


def test_a_place_that_cannot_be_written_is_found_out_before_the_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(Core, "step", lambda *_: pytest.fail("it had begun to train"))
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "folder.zip").mkdir()
    for place in (tmp_path / "file" / "agent.zip", tmp_path / "folder.zip"):
        with pytest.raises(OSError, match=str(place.name) + "|file"):
            train(ENV, place, steps=STEPS)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "folder.zip"]


def test_progress_is_told_after_each_rollout(tmp_path: Path):
    told: list[tuple[int, int, float]] = []
    train(ENV, tmp_path / "agent.zip", steps=STEPS, progress=lambda *args: told.append(args))
    assert [(done, whole) for done, whole, _ in told] == [(128, STEPS), (256, STEPS), (384, STEPS)]


def test_a_budget_below_one_batch_is_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="steps must be at least the 8 environments of a batch, got 7"):
        train(ENV, tmp_path / "agent.zip", steps=7)
    assert list(tmp_path.iterdir()) == []


def test_an_environment_without_settings_is_answered_with_those_that_have(tmp_path: Path):
    with pytest.raises(ValueError, match=r"no PPO settings for 'CartPole-v1' .*: choose from SigmaCorvette-v0"):
        hyperparameters("CartPole-v1")


def test_a_checkpoint_of_another_observation_is_refused_in_a_sentence(tmp_path: Path):
    path = train(ENV, tmp_path / "agent.zip", {"observe": "mean+std"}, steps=STEPS)
    with pytest.raises(ValueError, match=r"agent\.zip was trained on .*"):
        PPOAgent(path, gym.make(ENV).unwrapped)


def test_a_checkpoint_of_another_observation_of_the_same_length_is_refused_too(tmp_path: Path):
    """``mean`` and ``measurement`` have seven numbers each, which mean different things."""
    path = train(ENV, tmp_path / "agent.zip", {"observe": "mean"}, steps=STEPS)
    PPOAgent(path, gym.make(ENV, observe="mean", estimator="kf").unwrapped)  # other estimates are what studies fly
    with pytest.raises(ValueError, match=r"agent\.zip was trained on .*mean.*measurement"):
        PPOAgent(path, gym.make(ENV, observe="measurement").unwrapped)


def test_a_file_that_is_no_checkpoint_is_refused_in_a_sentence(tmp_path: Path):
    text, empty, other = tmp_path / "notes.txt", tmp_path / "empty.zip", tmp_path / "other.zip"
    text.write_text("no checkpoint")
    empty.write_bytes(b"")
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("readme", "something else")
    for path in (text, empty, other):
        with pytest.raises(ValueError, match=f"{path.name} is not a PPO checkpoint") as caught:
            load_agent(path, gym.make(ENV))
        assert "\n" not in str(caught.value)


def test_half_a_checkpoint_is_refused_in_a_sentence(tmp_path: Path):
    path = train(ENV, tmp_path / "agent.zip", steps=STEPS)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(ValueError, match=r"agent\.zip is not a PPO checkpoint"):
        load_agent(path, gym.make(ENV))
