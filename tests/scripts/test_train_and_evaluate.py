"""The train and evaluate commands, and how every command refuses."""

import subprocess
import sys
from pathlib import Path

import pytest

from agents.checkpoint import description
from scripts import evaluate, train
from scripts.console import command


@pytest.mark.slow
@pytest.mark.parametrize(("memory", "critic"), [("none", None), ("frames", None), ("none", "truth")])
def test_a_trained_agent_can_be_evaluated_on_several_estimators(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], memory: str, critic: str | None
):
    checkpoint = tmp_path / "ppo.zip"
    train.main("SigmaCorvette-v0", out=checkpoint, memory=memory, critic=critic, steps=128)
    assert f"checkpoint: {checkpoint}" in capsys.readouterr().out
    assert description(checkpoint)["memory"] == memory
    evaluate.main("SigmaCorvette-v0", agent=str(checkpoint), estimator=("truth", "kf"), episodes=2)
    printed = capsys.readouterr().out
    for label in ("Score", "Off track", "truth", "kf"):
        assert label in printed


@pytest.mark.parametrize(
    ("module", "arguments", "sentence"),
    [
        ("evaluate", ["--estimator", "kf-umv-iu", "--episodes", "2"], "did you mean 'kf-umv-ui'?"),
        ("evaluate", ["--disturbance", "stormy", "--episodes", "2"], "choose from calm, moderate, rough"),
        ("evaluate", ["--agent", "nobody", "--episodes", "2"], "unknown agent 'nobody'"),
        ("evaluate", ["SigmaFrigate-v0", "--episodes", "2"], "SigmaFrigate"),
        ("train", ["--out", "/dev/null/ppo.zip"], "cannot write /dev/null/ppo.zip"),
        ("train", ["--steps", "5"], "steps must be at least"),
        ("train", ["--critic", "oracle"], "critic must be 'truth', or None"),
    ],
)
def test_a_command_refuses_in_one_sentence(
    module: str, arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(SystemExit) as stop:
        command({"evaluate": evaluate, "train": train}[module].main, arguments)
    assert stop.value.code == 2
    told = capsys.readouterr().err
    assert len(told.splitlines()) == 1
    assert sentence in told


@pytest.mark.slow
def test_a_module_is_run_as_a_command():
    run = subprocess.run([sys.executable, "-m", "scripts.evaluate", "--estimator"], capture_output=True, text=True)
    assert run.returncode == 2
    assert run.stderr == "error: --estimator needs the name of at least one estimator\n"


def test_an_interrupted_command_ends_quietly():
    def interrupted() -> None:
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as stop:
        command(interrupted, [])
    assert stop.value.code == 130
