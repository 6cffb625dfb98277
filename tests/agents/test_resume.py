"""Interrupted trainings go on from their last checkpoint, and what lies in their folder meanwhile."""

import csv
import signal
import time
import zipfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from agents.commands import train as command
from agents.policies.checkpoint import description
from agents.training import callbacks
from agents.training.algorithms import train
from agents.training.callbacks import BEST, CURVES, LATEST, last_checkpoint, replay_path
from agents.training.vec_env import StableBaselinesVecEnv

STEPS = 10 * 8 * 16
TINY = {
    "ppo": {"num_envs": 8, "net_arch": [8], "n_steps": 16, "batch_size": 64, "n_epochs": 2},
    "sac": {
        "num_envs": 8,
        "net_arch": [8],
        "learning_starts": 100,
        "batch_size": 32,
        "gradient_steps": 2,
    },
}


def learned(
    path: Path, algorithm: str = "ppo", memory: str = "none", options: Any = None, **more: Any
) -> Path:
    return train(
        "SigmaCorvette-v0",
        path,
        options,
        1,
        STEPS,
        None,
        memory,
        TINY[algorithm],
        algorithm,
        **more,
    )


def interrupt(monkeypatch: pytest.MonkeyPatch, share: float) -> None:
    """Press Ctrl-C once, in the middle of a rollout, after a share of the steps."""

    def pressed(self: Any) -> bool:
        if not seen and self.num_timesteps >= share * STEPS:
            seen.append(True)
            signal.raise_signal(signal.SIGINT)
        return True

    seen: list[bool] = []
    monkeypatch.setattr(callbacks.Evaluation, "_on_step", pressed)


@pytest.mark.parametrize(
    ("algorithm", "memory"),
    [
        ("ppo", "none"),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (("sac", "none"), ("ppo", "lstm"))
        ),
    ],
)
def test_an_interrupted_training_goes_on_from_its_last_checkpoint_to_the_asked_number_of_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, algorithm: str, memory: str
):
    path, folder = tmp_path / "agent.zip", tmp_path / "agent"
    interrupt(monkeypatch, 0.62)
    with pytest.raises(
        KeyboardInterrupt,
        match=r"^the last checkpoint is .*checkpoint_768_steps.zip; the same command",
    ):
        learned(path, algorithm, memory, folder=folder)
    assert not path.exists()
    assert len(list(folder.glob("checkpoint_*_steps.zip"))) == 2
    with pytest.raises(
        ValueError, match=r"keeps an interrupted training: go on with resume, or remove .*agent$"
    ):
        learned(path, algorithm, memory, folder=folder)
    with pytest.raises(ValueError, match=r"is of another training: it differs in env_options$"):
        learned(path, algorithm, memory, {"sensors": "clean"}, folder=folder, resume=True)
    begun: list[int] = []
    start = callbacks.Evaluation._on_training_start
    monkeypatch.setattr(
        callbacks.Evaluation,
        "_on_training_start",
        lambda self: begun.append(self.num_timesteps) or start(self),
    )
    learned(path, algorithm, memory, folder=folder, resume=True)
    assert begun == [768]
    names = {file.name for file in folder.iterdir()}
    events = {name for name in names if "tfevents" in name}
    assert names - events == {CURVES, LATEST, BEST}
    assert bool(events) == (find_spec("tensorboard") is not None)
    with (folder / CURVES).open() as file:
        rows = list(csv.DictReader(file))
    steps = [int(row["time/total_timesteps"]) for row in rows]
    assert steps == sorted(steps)
    assert steps[0] < 768 or algorithm == "sac"  # which writes no row so early
    assert steps[-1] == description(path)["trained_steps"] >= STEPS
    assert float(rows[-1]["eval/score"]) > 0.0
    with zipfile.ZipFile(path) as ours, zipfile.ZipFile(folder / LATEST) as latest:
        name = next(name for name in ours.namelist() if name.startswith("weights/"))
        assert ours.read(name) == latest.read(name)


def test_evaluations_are_logged_with_the_steps_of_their_policy_and_time_goes_on_after_a_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A second passes with each look at the clock; a policy scores as many points as it has steps."""
    path, folder, clock = tmp_path / "agent.zip", tmp_path / "agent", [0]
    monkeypatch.setattr(time, "time_ns", lambda: clock.append(clock[-1] + 10**9) or clock[-1])
    monkeypatch.setattr(
        callbacks.Evaluation, "_score", lambda self, path: float(description(path)["trained_steps"])
    )
    interrupt(monkeypatch, 0.62)
    with pytest.raises(KeyboardInterrupt):
        learned(path, folder=folder)
    clock.append(clock[-1] + 10**15)
    learned(path, folder=folder, resume=True)
    with (folder / CURVES).open() as file:
        rows = list(csv.DictReader(file))
    scores = {
        int(row["time/total_timesteps"]): float(row["eval/score"])
        for row in rows
        if row["eval/score"]
    }
    assert list(scores) == list(scores.values()) == [128 * tenth for tenth in range(11)]
    elapsed = [int(row["time/time_elapsed"]) for row in rows if row["time/time_elapsed"]]
    assert elapsed == sorted(elapsed)
    assert 100 < elapsed[-1] < 1000
    with pytest.raises(
        ValueError,
        match=r"agent keeps an earlier training: remove it, or train into another place$",
    ):
        learned(path, folder=folder)


def test_settings_that_do_not_go_together_are_refused_in_the_words_of_the_algorithm(tmp_path: Path):
    with pytest.raises(ValueError, match="`batch_size` must be greater than 1"):
        train("SigmaCorvette-v0", tmp_path / "agent.zip", settings=TINY["ppo"] | {"batch_size": 1})


def test_without_a_checkpoint_or_with_a_damaged_one_nothing_is_resumed(tmp_path: Path):
    folder = tmp_path / "agent"
    with pytest.raises(
        FileNotFoundError, match="there is no interrupted training to go on with: no checkpoint in"
    ):
        learned(tmp_path / "agent.zip", folder=folder, resume=True)
    folder.mkdir()
    (folder / "checkpoint_64_steps.zip").write_bytes(b"junk")
    (folder / "checkpoint_128_steps.zip").write_bytes(b"junk")
    assert last_checkpoint(folder) == folder / "checkpoint_128_steps.zip"
    with pytest.raises(ValueError, match=r"checkpoint_128_steps.zip is damaged: remove it"):
        learned(tmp_path / "agent.zip", folder=folder, resume=True)


def test_a_resumed_training_flies_and_draws_what_it_has_not_yet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A damaged best policy does not stop it, and is replaced."""
    first, noise, reset = [], [], StableBaselinesVecEnv.reset

    def recorded(self: Any) -> Any:
        noise.append(torch.rand(1).item())
        first.append(reset(self))
        return first[-1]

    monkeypatch.setattr(StableBaselinesVecEnv, "reset", recorded)
    path, folder = tmp_path / "agent.zip", tmp_path / "agent"
    interrupt(monkeypatch, 0.3)
    with pytest.raises(KeyboardInterrupt):
        learned(path, folder=folder)
    (folder / BEST).write_bytes((folder / BEST).read_bytes()[:1000])
    learned(path, folder=folder, resume=True)
    assert not np.isclose(first[0], first[1]).all(axis=1).any()
    assert noise[0] != noise[1]
    assert description(folder / BEST)["trained_steps"] >= 0
    with pytest.raises(FileNotFoundError, match="no interrupted training"):
        learned(path, folder=folder, resume=True)


def test_an_off_policy_checkpoint_counts_only_with_its_replay_buffer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path, folder = tmp_path / "agent.zip", tmp_path / "agent"
    interrupt(monkeypatch, 0.2)
    with pytest.raises(KeyboardInterrupt):
        learned(path, "sac", folder=folder)
    buffer = replay_path(last_checkpoint(folder))
    buffer.write_bytes(buffer.read_bytes()[:1000])
    for _ in range(2):
        with pytest.raises(
            ValueError, match=r"_steps.zip is damaged: remove it, and --resume goes on from the one"
        ):
            learned(path, "sac", folder=folder, resume=True)
        buffer.unlink(missing_ok=True)


@pytest.mark.parametrize("runs", [1, 2])
def test_a_training_that_broke_off_before_its_first_checkpoint_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runs: int
):
    monkeypatch.setattr(command, "CHOOSING", 1)
    path, folder = tmp_path / "agent.zip", tmp_path / ("agent" if runs == 1 else "agent/run-0")
    folder.mkdir(parents=True)
    (folder / CURVES).write_text("")
    small = tuple(f"{name}={value}" for name, value in TINY["ppo"].items())
    command.main("SigmaCorvette-v0", out=path, steps=STEPS, runs=runs, settings=small, resume=True)
    assert description(path)["trained_steps"] == STEPS
