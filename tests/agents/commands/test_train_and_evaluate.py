"""The train and evaluate commands."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from brief import BRIEF

import agents
import agents.training.algorithms
from agents import rollout
from agents.commands import evaluate, train
from agents.policies.checkpoint import description, packaged
from agents.refusal import Refusal
from agents.seeds import evaluation_seeds, tuning_seeds
from agents.statistics import paired_difference

ENV = "SigmaCorvette-v0"


@pytest.mark.slow
def test_a_trained_agent_can_be_evaluated_on_several_estimators(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    policy, tables = tmp_path / "ppo.npz", tmp_path / "mine.toml"
    tables.write_text(f'["{ENV}"]\nn_steps = 2\nbatch_size = 64\ngamma = 0.9\n')
    given: Any = {"hyperparameters": tables, "set_": {"gamma": 0.8}, "steps": 256}
    train.main(ENV, out=tmp_path / "ppo.zip", memory="frames", **given)
    printed = capsys.readouterr()
    model = tmp_path / "ppo.zip"
    assert f"wrote {policy}, and for stable-baselines3 {model}\n" in printed.out
    best = re.search(r"the best of 2 evaluations, .* after (?:128|256) steps: (.*)", printed.out)[1]
    assert Path(best).exists()
    assert "run 0" not in printed.err
    described = description(policy)
    assert (described["memory"], described["trained_steps"]) == ("frames", 256)
    assert described["hyperparameters"].items() >= {"n_steps": 2, "gamma": 0.8}.items()
    with pytest.raises(Refusal, match=r"ppo.npz exists: give --force to replace it"):
        train.main(ENV, out=tmp_path / "ppo")
    with pytest.raises(Refusal, match=r"mine.toml has neither a table \['PunaUAV-v0'\] nor"):
        train.main("PunaUAV-v0", hyperparameters=tables)
    evaluate.main(
        ENV, agent=str(tmp_path / "ppo.zip"), estimator=("truth", "kf-linear"), episodes=2
    )
    printed = capsys.readouterr().out
    for label in ("Score", "Off track", "truth", "kf-linear"):
        assert label in printed


def test_of_several_trainings_the_best_on_tuning_seeds_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Two trainings, of which only the second, the package's own agent, has learned anything."""
    flown = []

    def learn(env_id: str, path: Path, seed: int, **settings: Any) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(packaged(ENV if seed == 8 else "PunaUAV-v0").read_bytes())
        path.with_suffix(".zip").write_text(f"model {seed}")

    def fly(agent: Path, env_id: str, seeds: list[int], *rest: Any, **more: Any) -> Any:
        flown.append(seeds)
        return rollout("ppo" if "8" in agent.stem else "random", env_id, seeds[:2], *rest, **more)

    monkeypatch.setattr(agents.training.algorithms, "train", learn)
    monkeypatch.setattr(agents, "rollout", fly)
    train.main(ENV, out=tmp_path / "best", estimator="truth", seed=7, runs=2)
    assert (tmp_path / "best.npz").read_bytes() == packaged(ENV).read_bytes()
    assert (tmp_path / "best.zip").read_text() == "model 8"
    assert flown == [tuning_seeds(train.CHOOSING)] * 2
    printed = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in printed[:-1]] == ["run 7", "run 8"]
    zipped = tmp_path / "best.zip"
    assert printed[-1] == f"wrote {tmp_path / 'best.npz'}, and for stable-baselines3 {zipped}"


@pytest.mark.parametrize("lost", [0.0, 1.0])
def test_scores_above_those_on_the_truth_are_warned_of(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], lost: float
):
    def fly(agent: str, env_id: str, seeds: list[int], options: Any, **more: Any) -> Any:
        flown = rollout(agent, env_id, seeds, options, **more)
        return replace(flown, score=flown.score - lost * (options["estimator"] == "truth"))

    monkeypatch.setattr(agents, "rollout", fly)
    evaluate.main(BRIEF, estimator=("kf", "truth"), episodes=3)
    warning = "autopilot beats the truth beyond chance: check the task's score, and what its reward"
    assert (warning in capsys.readouterr().out) == bool(lost)


@pytest.mark.parametrize("episodes", [1, 4])
def test_a_file_has_means_and_paired_differences(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], episodes: int
):
    out, names = tmp_path / "new" / "table.csv", ("ekf", "truth", "default")
    evaluate.main(BRIEF, estimator=names, compare_to="truth", episodes=episodes, out=out)
    assert "minus that with truth, paired by seed: ekf" in capsys.readouterr().out
    found = pd.read_csv(out).set_index(["estimator", "metric"])
    assert (found.reference == "truth").all()
    own = {
        name: rollout("autopilot", BRIEF, evaluation_seeds(episodes), {"estimator": name}).score
        for name in ("ekf", "truth", "kf-umv-ui")
    }
    for name, scores in own.items():
        row = found.loc[name, "score"]
        assert row["mean"] == pytest.approx(scores.mean())
        assert row.difference == pytest.approx((scores - own["truth"]).mean(), abs=1e-12)
        if episodes == 1:
            assert row[["low", "high", "difference_low"]].isna().all()
        else:
            each = paired_difference(scores, own["truth"], comparisons=2)
            ends = row.difference_low, row.difference_high
            assert ends == pytest.approx((each.low, each.high))


def test_the_table_names_its_world_and_what_errors_are_of(capsys: pytest.CaptureFixture[str]):
    evaluate.main(ENV, estimator=("kf",), episodes=1, disturbance="calm")
    printed = " ".join(capsys.readouterr().out.split())
    assert "episodes: 1, disturbance=calm" in printed
    assert "Position error, RMS [m] " in printed
