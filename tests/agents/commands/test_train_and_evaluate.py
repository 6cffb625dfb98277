"""The train and evaluate commands."""

from pathlib import Path
from typing import Any

import pytest

import agents.training.algorithms
from agents import rollout
from agents.commands import evaluate, train
from agents.commands.console import command
from agents.policies.checkpoint import description, packaged
from agents.refusal import Refusal
from agents.seeds import tuning_seeds


@pytest.mark.slow
@pytest.mark.parametrize("memory", ["none", "frames"])
def test_a_trained_agent_can_be_evaluated_on_several_estimators(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], memory: str
):
    checkpoint = tmp_path / "ppo.zip"
    train.main("SigmaCorvette-v0", out=checkpoint, memory=memory, steps=128)
    with pytest.raises(
        Refusal, match=r"ppo.zip is there already: remove it and its folder, or give another --out$"
    ):
        train.main("SigmaCorvette-v0", out=checkpoint.with_suffix(""))
    assert f"checkpoint: {checkpoint}" in capsys.readouterr().out
    assert description(checkpoint)["memory"] == memory
    evaluate.main("SigmaCorvette-v0", agent=str(checkpoint), estimator=("truth", "kf"), episodes=2)
    printed = capsys.readouterr().out
    for label in ("Score", "Off track", "truth", "kf"):
        assert label in printed


@pytest.mark.slow
def test_of_several_trainings_the_best_on_tuning_seeds_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Three trainings, of which only the second, the package's own agent, has learned anything."""
    flown = []

    def learn(env_id: str, path: Path, options: dict[str, Any], seed: int, **settings: Any) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(packaged(env_id).read_bytes() if seed == 8 else poor)
        return path

    def fly(agent: Path, env_id: str, seeds: list[int], *rest: Any, **more: Any) -> Any:
        flown.append(seeds)
        return rollout(agent, env_id, seeds[:4], *rest, **more)

    poor = agents.training.algorithms.train(
        "SigmaCorvette-v0", tmp_path / "poor.zip", {"estimator": "truth"}, steps=128
    ).read_bytes()
    monkeypatch.setattr(agents.training.algorithms, "train", learn)
    monkeypatch.setattr(agents, "rollout", fly)
    train.main("SigmaCorvette-v0", out=tmp_path / "best.zip", estimator="truth", seed=7, runs=3)
    assert (tmp_path / "best.zip").read_bytes() == packaged("SigmaCorvette-v0").read_bytes()
    assert flown == [tuning_seeds(train.CHOOSING)] * 3
    printed = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in printed] == ["run 7", "run 8", "run 9", "checkpoint"]


def test_an_interrupted_command_ends_quietly():
    def interrupted() -> None:
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as stop:
        command(interrupted, [])
    assert stop.value.code == 130


def test_learning_that_starts_too_late_is_told_with_a_start_that_fits(
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("stable_baselines3")
    given = {"steps": 50, "memory": "none", "settings": {}, "algorithm": "sac"}
    train._checked("SigmaCorvette-v0", {}, 0, given)
    assert "--set learning_starts=5\n" in capsys.readouterr().err
