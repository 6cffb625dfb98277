"""Agents of rl_zoo3: its folders become checkpoints that act as the model did, and it reads the tuned settings."""

import sys
import types
from collections import OrderedDict
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml
from refusals import refused
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from agents import load_agent
from agents.commands import convert as convert_command
from agents.commands.console import command
from agents.policies.checkpoint import description
from agents.training.algorithms import describe, learner
from agents.training.zoo import convert, hyperparams

ENV = "SigmaCorvette-v0"
CONFIG = {"normalize": True, "frame_stack": 2, "learning_rate": "lin_0.002", "clip_range": 0.1}
SETTINGS = {"num_envs": 2, "n_steps": 16, "batch_size": 32, "n_epochs": 1, "net_arch": [8]}


class Schedule:
    """A schedule as rl_zoo3 pickles it, by the name of its class."""

    def __call__(self, remaining: float) -> float:
        return 0.002 * remaining


def saved(folder: Path, monkeypatch: pytest.MonkeyPatch, **changed: Any) -> tuple[Path, PPO, VecNormalize]:
    """A folder as rl_zoo3 leaves it, of a short training, with its model and its statistics."""
    theirs: Any = types.ModuleType("zoo_schedules")
    theirs.Schedule, Schedule.__module__ = Schedule, theirs.__name__
    monkeypatch.setitem(sys.modules, theirs.__name__, theirs)
    inner = folder / "logs" / "ppo" / f"{ENV}_1" / ENV
    inner.mkdir(parents=True)
    statistics = VecNormalize(DummyVecEnv([lambda: gym.make(ENV, estimator="kf", max_episode_steps=20)]))
    model = PPO("MlpPolicy", VecFrameStack(statistics, 2), Schedule(), 16, 8, 1, seed=0, device="cpu").learn(32)
    model.save(inner.parent / ENV)
    statistics.save(str(inner / "vecnormalize.pkl"))
    arguments = {"algo": "ppo", "env": ENV, "env_kwargs": {"estimator": "kf"}, "gym_packages": ["vessel_gym"]}
    for name, table in (("config", CONFIG), ("args", arguments)):
        (inner / f"{name}.yml").write_text(yaml.dump(OrderedDict(table | changed)))
    monkeypatch.delitem(sys.modules, theirs.__name__)  # as where rl_zoo3 is not installed
    return inner.parent, model, statistics


def test_a_folder_becomes_a_checkpoint_that_acts_as_the_model_did(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder, model, statistics = saved(tmp_path, monkeypatch)
    path = tmp_path / "agent.zip"
    assert command(convert_command.main, [str(folder), "--out", str(path), "--trust"]) is None
    agent = load_agent(path, gym.make(ENV))
    agent.reset(1)
    frames = np.random.default_rng(0).uniform(-3.0, 3.0, (4, 1, 11)).astype(np.float32)
    before = np.zeros((1, 11), np.float32)
    for frame in frames:
        now = statistics.normalize_obs(frame)
        expected, _ = model.predict(np.concatenate([before, now], 1), deterministic=True)
        np.testing.assert_array_equal(agent.act(frame), expected)
        before = now
    described = description(path)
    assert described is not None
    assert (described["algorithm"], described["hyperparameters"]) == ("ppo", CONFIG)
    assert (described["env_id"], described["env_options"]) == (ENV, {"estimator": "kf"})


@pytest.mark.parametrize(
    ("changed", "options", "sentence"),
    [
        ({}, {"trust": False}, "holds pickles, .* say trust=True"),
        ({}, {"best": True}, r"best_model\.zip does not exist: rl_zoo3 writes it after an evaluation"),
        ({"algo": "qrdqn"}, {}, "unknown algorithm 'qrdqn'"),
        ({"env_wrapper": "gymnasium.wrappers.ClipAction"}, {}, "cannot store the env_wrapper gymnasium.wrappers.ClipA"),
        ({"frame_stack": None}, {}, "cannot be converted: .*Observation spaces do not match"),
        ({"gym_packages": ["nosuch"]}, {}, "cannot be converted: .*No module named 'nosuch'"),
    ],
)
def test_what_cannot_be_converted_is_answered_with_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, Any], options: dict[str, bool], sentence: str
):
    folder, *_ = saved(tmp_path, monkeypatch, **changed)
    with refused(ValueError, sentence):
        convert(folder, tmp_path / "agent.zip", **({"trust": True} | options))
    assert not (tmp_path / "agent.zip").exists()


def test_a_folder_of_something_else_is_refused(tmp_path: Path):
    with refused(ValueError, "is no folder of a training of rl_zoo3, such as logs/ppo"):
        convert(tmp_path, tmp_path / "agent.zip", trust=True)


@pytest.mark.parametrize("env_id", ["SigmaCorvette-v0", "PunaUAV-v0"])
def test_rl_zoo3_reads_the_tuned_settings(env_id: str):
    read = hyperparams[env_id]
    described = describe(env_id, {}, 0, None, settings=SETTINGS)
    tuned = describe(env_id, {}, 0, None)["hyperparameters"]
    assert read["n_envs"] * read["n_steps"] == tuned["num_envs"] * tuned["n_steps"]
    assert (read["n_timesteps"], read["learning_rate"]) == (tuned["steps"], f"lin_{tuned['learning_rate']}")
    with learner(described) as model:
        given = {name for name in read if name not in ("n_envs", "n_timesteps", "normalize")}
        assert given <= set(vars(model)) | {"policy"}
        assert model.get_env().reward_scale == (100.0 if env_id == "PunaUAV-v0" else 1.0)
