"""The benchmark of third-party environments: its trainings, and its table in the documentation."""

from pathlib import Path

import numpy as np
import pytest

from studies.third_party import benchmark, table
from studies.third_party.benchmark import ARMS, TRIALS, Trial
from studies.third_party.table import returns, returns_table


def test_the_table_says_what_share_of_the_gain_over_chance_is_kept():
    truth, chance = np.array([[2.0, 4.0], [4.0, 6.0]]), np.array([-6.0, -6.0])
    last = returns_table({TRIALS["pendulum"]: (chance, truth, truth - 1.0)}).splitlines()[-1]
    _, label, *cells, share, _ = (cell.strip() for cell in last.split("|"))
    assert label == "Pendulum-v1, 100,000 steps"
    assert [cell.split(" ± ")[0] for cell in cells] == ["-6.0", "4.0", "3.0"]
    assert share == "90.0 ± 0.0 %"


def test_what_was_trained_is_not_trained_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    trained: list[tuple[str, str, int]] = []

    def learned(trial: Trial, arm: str, seed: int) -> list[float]:
        trained.append((trial.env_id, arm, seed))
        return [1.0 + seed, 2.0]

    monkeypatch.setattr(table, "learned", learned)
    monkeypatch.setattr(table, "random", lambda trial: [0.0, 0.5])
    one, again = (returns(tmp_path / "results") for _ in range(2))
    assert one == again
    assert len(trained) == len(set(trained)) == table.RUNS * len(ARMS) * len(TRIALS)
    assert "CartPole-v1" in one
    assert "100.0 ± 0.0 %" in one


@pytest.mark.parametrize("name", TRIALS)
def test_random_actions_have_returns_on_seeds_that_repeat(name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(benchmark, "EPISODES", 2)
    first = benchmark.random(TRIALS[name])
    assert first == benchmark.random(TRIALS[name])
    assert len(set(first)) == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pendulum", pytest.param("cart-pole", marks=pytest.mark.nightly)])
def test_a_short_training_repeats_to_the_last_bit(name: str, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(benchmark, "EPISODES", 2)
    trial = TRIALS[name]
    short = Trial(trial.env_id, trial.given, 64, 2, trial.options | {"n_steps": 32, "batch_size": 64})
    assert benchmark.learned(short, "ukf", 0) == benchmark.learned(short, "ukf", 0)
