"""Interrupted trainings go on from their last checkpoint."""

import csv
import signal
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from agents import load_agent
from agents.commands import train as command
from agents.policies.checkpoint import description
from agents.training import callbacks
from agents.training.algorithms import train
from agents.training.callbacks import checkpoints
from agents.training.vec_env import StableBaselinesVecEnv

ENV = "SigmaCorvette-v0"
STEPS = 10 * 8 * 16
SMALL = {"n_envs": 8, "policy_kwargs": {"net_arch": [8]}, "batch_size": 32}
TINY = {
    "ppo": SMALL | {"n_steps": 16, "n_epochs": 2},
    "sac": SMALL | {"learning_starts": 100, "gradient_steps": 2},
}


def learned(path: Path, algorithm: str = "ppo", memory: str = "none", **more: Any) -> Path:
    given = {"settings": TINY[algorithm], "algorithm": algorithm, "memory": memory}
    return train(ENV, path, seed=1, steps=STEPS, folder=path.with_suffix(""), **given | more)


def interrupt(monkeypatch: pytest.MonkeyPatch, share: float) -> None:
    """Press Ctrl-C once, in the middle of a rollout, after a share of the steps."""
    # A run in the background has been told to ignore the signal, and its children with it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    original, pressed = callbacks.Evaluation._on_step, []

    def step(self: Any) -> bool:
        if not pressed and self.num_timesteps >= share * STEPS:
            pressed.append(True)
            signal.raise_signal(signal.SIGINT)
        return original(self)

    monkeypatch.setattr(callbacks.Evaluation, "_on_step", step)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("algorithm", "memory"),
    [
        ("ppo", "none"),
        pytest.param("sac", "none", marks=pytest.mark.nightly),
        pytest.param("ppo", "lstm", marks=pytest.mark.nightly),
    ],
)
def test_interrupted_training_goes_on_from_last_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, algorithm: str, memory: str
):
    """In other episodes, with other noise, keeping the best policy and the curves."""
    path, folder, first, noise = tmp_path / "agent.npz", tmp_path / "agent", [], []
    reset = StableBaselinesVecEnv.reset

    def recorded(self: Any) -> Any:
        seen = reset(self)
        if len(seen) == 8:  # of the learner
            noise.append(torch.rand(1).item())
            first.append(seen)
        return seen

    monkeypatch.setattr(StableBaselinesVecEnv, "reset", recorded)
    monkeypatch.setattr(callbacks, "EPISODES", 1)
    interrupt(monkeypatch, 0.62)
    with pytest.raises(KeyboardInterrupt):
        learned(path, algorithm, memory)
    assert not path.exists()
    assert checkpoints(folder) == [704, 768]
    with pytest.raises(ValueError, match=r"agent keeps a training: go on with --resume if it was"):
        learned(path, algorithm, memory)
    with pytest.raises(ValueError, match=r"is of another training: it differs in env_options$"):
        learned(path, algorithm, memory, env_options={"sensors": "clean"}, resume=True)
    damaged = "replay_buffer_768_steps.pkl" if algorithm == "sac" else "768_steps.zip"
    damaged = folder / f"rl_model_{damaged}"
    damaged.write_bytes(damaged.read_bytes()[:1000])
    learned(path, algorithm, memory, resume=True)
    assert not np.isclose(first[0], first[1]).all(axis=1).any()
    assert noise[0] != noise[1]
    trained = description(path)["trained_steps"]
    assert STEPS <= trained < STEPS + 128
    assert checkpoints(folder) == []
    names = {file.name for file in folder.iterdir() if "tfevents" not in file.name}
    assert names == {"config.json", "evaluations.npz", "best_model.zip", "best_model.npz"} | {
        "progress.csv", "progress_704.csv"
    }  # fmt: skip
    with np.load(folder / "evaluations.npz") as file:
        assert file["timesteps"].tolist()[:6] == [128 * tenth for tenth in range(1, 7)]
        assert file["timesteps"][-1] > 1000
        assert file["results"].shape == file["successes"].shape
        assert file["results"].shape[1] == callbacks.EPISODES
        best = file["timesteps"][file["results"].mean(axis=1).argmax()]
    assert description(folder / "best_model.npz")["trained_steps"] == best
    with (folder / "progress_704.csv").open() as csv_file:
        steps = [int(row["time/total_timesteps"]) for row in csv.DictReader(csv_file)]
    assert steps == sorted(steps)
    assert 704 < steps[0] < steps[-1] <= trained
    load_agent(tmp_path / "agent.zip", gym.make(ENV))  # by the policy beside the model
    before = path.read_bytes()
    learned(path, algorithm, memory, force=True)
    assert not (folder / "progress_704.csv").exists()
    assert path.read_bytes() != before


def test_without_a_training_nothing_is_resumed(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match="there is no interrupted training to go on with"):
        learned(tmp_path / "agent", resume=True)


@pytest.mark.slow
@pytest.mark.parametrize("runs", [1, 2])
def test_training_without_checkpoint_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runs: int
):
    monkeypatch.setattr(command, "CHOOSING", 1)
    monkeypatch.setattr(callbacks, "EPISODES", 1)
    monkeypatch.setattr(callbacks, "EVALUATIONS", 1)
    monkeypatch.setattr(callbacks, "CHECKPOINTS", 1)
    interrupt(monkeypatch, 0.0)
    small = {name: value for name, value in TINY["ppo"].items() if "kw" not in name}
    given = {"out": tmp_path / "agent", "steps": 128, "runs": runs, "set_": small}
    with pytest.raises(KeyboardInterrupt):
        command.main(ENV, **given)
    command.main(ENV, **given, resume=True)
    assert description(tmp_path / "agent.npz")["trained_steps"] == 128
