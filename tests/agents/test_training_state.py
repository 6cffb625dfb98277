"""Trainings that are interrupted go on to the same bits, and what lies in their folder meanwhile."""

import csv
import os
import pickle
import signal
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from agents.training import callbacks
from agents.training.algorithms import ALGORITHMS, train
from agents.training.callbacks import BEST, CURVES, LATEST, STATE
from agents.training.state import load_state

STEPS = 10 * 8 * 16
ON_POLICY = {"num_envs": 8, "net_arch": [8], "n_steps": 16}
OFF_POLICY = {"num_envs": 8, "net_arch": [8], "learning_starts": 100, "batch_size": 32, "gradient_steps": 2}
TINY = dict.fromkeys(ALGORITHMS, OFF_POLICY) | {
    "ppo": ON_POLICY | {"batch_size": 64, "n_epochs": 2}, "trpo": ON_POLICY | {"batch_size": 64}, "a2c": ON_POLICY
}  # fmt: skip
LATE = {"sensors": "denied", "estimator": "enkf"}


def learned(path: Path, algorithm: str = "ppo", memory: str = "none", options: Any = None, **more: Any) -> bytes:
    """The bytes of a checkpoint."""
    settings = TINY[algorithm]
    train("SigmaCorvette-v0", path, options, 1, STEPS, None, memory, None, settings, algorithm, **more)
    return path.read_bytes()


def interrupt(monkeypatch: pytest.MonkeyPatch, least: float) -> None:
    """Press Ctrl-C once, in the middle of a rollout, after a share of the steps."""

    def pressed(self: Any) -> bool:
        if not seen and self.num_timesteps >= least * STEPS:
            seen.append(True)
            signal.raise_signal(signal.SIGINT)
        return True

    seen: list[bool] = []
    monkeypatch.setattr(callbacks.Checkpoints, "_on_step", pressed)


KINDS = [("ppo", "none", None), ("sac", "none", None), ("ppo", "lstm", None), ("ppo", "frames", LATE)]
OTHERS = [(name, "none", None) for name in ALGORITHMS if name not in ("ppo", "sac")]
AT_NIGHT = [pytest.param(*each, marks=pytest.mark.nightly) for each in OTHERS]


@pytest.mark.slow
@pytest.mark.parametrize(("algorithm", "memory", "options"), KINDS + AT_NIGHT)
def test_an_interrupted_training_goes_on_to_the_same_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, algorithm: str, memory: str, options: Any
):
    whole = learned(tmp_path / "whole.zip", algorithm, memory, options)  # without a folder: nothing is evaluated
    path, folder = tmp_path / "parted.zip", tmp_path / "parted"
    more = {"folder": folder, "options": options}
    interrupt(monkeypatch, 0.6)
    with pytest.raises(KeyboardInterrupt, match=r"6\d% of the steps are kept in .*state.pkl"):
        learned(path, algorithm, memory, **more)
    assert not path.exists()
    with pytest.raises(ValueError, match="keeps an interrupted training: go on with resume, or remove that file"):
        learned(path, algorithm, memory, **more)
    (folder / ".state-1.pkl").touch()  # as a process that was killed while it wrote leaves one
    assert learned(path, algorithm, memory, resume=True, **more) == whole
    names = {file.name for file in folder.iterdir()}
    events = {name for name in names if "tfevents" in name}
    assert names - events == {CURVES, LATEST, BEST}
    assert bool(events) == (find_spec("tensorboard") is not None)
    with (folder / CURVES).open() as file:
        rows = list(csv.DictReader(file))
    steps = [int(row["time/total_timesteps"]) for row in rows]
    assert steps == sorted(steps)
    assert steps[-1] >= STEPS
    if algorithm in ("ppo", "trpo"):  # a row a rollout, and none twice
        assert sum(bool(row["time/iterations"]) for row in rows) == 10
    assert float(rows[-1]["eval/score"]) > 0.0
    with zipfile.ZipFile(path) as ours, zipfile.ZipFile(folder / LATEST) as latest:
        name = next(name for name in ours.namelist() if name.startswith("weights/"))
        assert ours.read(name) == latest.read(name)


KILLED = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
import test_training_state as tests
from agents.training import callbacks

def killed(self):
    if self.num_timesteps >= {share} * tests.STEPS:
        os.kill(os.getpid(), signal.SIGKILL)
    return True

callbacks.PAUSE = {pause}
callbacks.Checkpoints._on_step = killed
tests.learned(Path({path!r}), {algorithm!r}, folder=Path({folder!r}))
"""


@pytest.mark.slow
@pytest.mark.parametrize(("algorithm", "share", "pause"), [("ppo", 0.6, 0.0), ("sac", 0.6, 0.0), ("ppo", 0.05, 60.0)])
def test_a_killed_training_goes_on_to_the_same_checkpoint(tmp_path: Path, algorithm: str, share: float, pause: float):
    path, folder = tmp_path / "killed.zip", tmp_path / "killed"
    words = {"tests": str(Path(__file__).parent), "path": str(path), "folder": str(folder), "algorithm": algorithm}
    program = KILLED.format(share=share, pause=pause, **words)
    killed = subprocess.run([sys.executable, "-c", program], capture_output=True, env=os.environ | {"PYTHONPATH": "."})
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert list(tmp_path.iterdir()) == [folder]
    assert learned(path, algorithm, folder=folder, resume=True) == learned(tmp_path / "whole.zip", algorithm)


def test_a_state_of_another_training_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path, folder = tmp_path / "agent.zip", tmp_path / "agent"
    with pytest.raises(FileNotFoundError, match="there is no interrupted training to go on with: no file"):
        learned(path, folder=folder, resume=True)
    interrupt(monkeypatch, 0.2)
    with pytest.raises(KeyboardInterrupt):
        learned(path, folder=folder)
    with pytest.raises(ValueError, match=r"is of another training: it differs in env_options$"):
        learned(path, options={"sensors": "clean"}, folder=folder, resume=True)


class Malicious:
    def __reduce__(self) -> Any:
        return os.mkdir, (f"{self.place}",)

    def __init__(self, place: Path) -> None:
        self.place = place


def test_a_state_runs_nothing_and_a_damaged_one_is_refused(tmp_path: Path):
    path, made = tmp_path / STATE, tmp_path / "made"
    parts = {"more": {}, "learner": {}}
    for content in (pickle.dumps(parts | {"environment": Malicious(made)}), pickle.dumps(parts), b"", b"\x80\x04junk"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"state.pkl is no state of a training, or is damaged \("):
            load_state(path)
    assert not made.exists()
