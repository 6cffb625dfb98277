"""Draw learning curves: ``vessel-gym plot results/ppo results/sac --out curves.pdf``."""

from pathlib import Path
from typing import Any

from agents.commands.console import asked
from agents.plotting import KINDS, learning_figure, save_figure

OPTIONS = {
    "training": "folder of a training; of one with several runs the mean and the range are drawn",
    "out": "figure to write (.pdf or .svg)",
}


def main(training: tuple[Path, ...], /, out: Path = Path("results/curves.svg")) -> None:
    """Draw the learning curves of trainings: mean returns in evaluations over steps."""
    from vessel_gym.checks import one_of

    with asked():
        one_of("kind of file", out.suffix.lower(), KINDS)
        runs = {path.stem: evaluated_runs(path) for path in training}
    save_figure(learning_figure(runs, "mean return in evaluation"), out)
    print(f"wrote {out}")


def evaluated_runs(training: Path) -> list[tuple[Any, Any]]:
    """Steps and mean returns of the evaluations of each run.

    Raises:
        ValueError: if no run has been evaluated there.
    """
    folder = training if training.is_dir() else training.with_suffix("")
    runs = [evaluations(path) for path in sorted(folder.glob("**/evaluations.npz"))]
    if not runs:
        raise ValueError(f"no evaluations.npz is in {folder}: name what vessel-gym train wrote")
    return runs


def evaluations(file: Path) -> tuple[Any, Any]:
    """Steps and mean returns ``(n,)`` of the evaluations in an ``evaluations.npz``."""
    import numpy as np

    with np.load(file) as kept:
        return kept["timesteps"], kept["results"].mean(axis=1)
