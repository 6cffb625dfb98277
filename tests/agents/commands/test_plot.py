"""`vessel-gym plot` draws the mean and the range of a training's runs."""

from pathlib import Path

import numpy as np
import pytest

from agents.commands.console import command
from agents.commands.plot import evaluated_runs, main
from agents.plotting import aligned

STEPS = np.array([100, 200, 300, 400])


def trained(folder: Path, evaluations: int, seed: int) -> np.ndarray:
    """Returns ``(evaluations, episodes)`` of a run, in a folder as stable-baselines3 writes it."""
    folder.mkdir(parents=True)
    results = np.random.default_rng(seed).normal(size=(evaluations, 5))
    np.savez(folder / "evaluations.npz", timesteps=STEPS[:evaluations], results=results)
    return results


def test_curves_reach_as_far_as_the_shortest_run(tmp_path: Path):
    results = [trained(tmp_path / "ppo" / f"run-{i}", n, i) for i, n in enumerate((4, 3))]
    steps, returns = aligned(evaluated_runs(tmp_path / "ppo.npz"))
    np.testing.assert_array_equal(steps, STEPS[:3])
    np.testing.assert_allclose(returns, [each[:3].mean(1) for each in results])


def test_runs_that_are_evaluated_elsewhere_are_interpolated(tmp_path: Path):
    trained(tmp_path / "run-0", 2, 0)
    (tmp_path / "run-1").mkdir()
    results = [[0.0, 0.0], [3.0, 5.0]]
    np.savez(tmp_path / "run-1" / "evaluations.npz", timesteps=[0, 200], results=results)
    np.testing.assert_allclose(aligned(evaluated_runs(tmp_path))[1][1], [2.0, 4.0])


@pytest.mark.parametrize(("suffix", "begin"), [(".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_the_figure_has_a_curve_for_each_training(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str, begin: bytes
):
    for name in ("ppo", "sac"):
        trained(tmp_path / name, 4, 0)
    out = tmp_path / "new" / f"curves{suffix}"
    command(main, [str(tmp_path / "ppo"), str(tmp_path / "sac"), "--out", str(out)])
    assert out.read_bytes().startswith(begin)
    assert capsys.readouterr().out == f"wrote {out}\n"
