"""Draw learning curves: ``vessel-gym plot results/ppo results/sac --out curves.pdf``."""

from pathlib import Path
from typing import Any

from agents.commands.console import asked
from agents.plotting import KINDS, PALETTE, save_figure, styled

OPTIONS = {
    "training": "folder of a training; of one with several runs the mean and the range are drawn",
    "out": "figure to write (.pdf or .svg)",
}


def main(training: tuple[Path, ...], /, out: Path = Path("results/curves.svg")) -> None:
    """Draw the learning curves of trainings: mean returns in evaluations over steps."""
    from vessel_gym.checks import one_of

    with asked():
        one_of("kind of file", out.suffix.lower(), KINDS)
        curves = {path.stem: learning_curves(path) for path in training}
    save_figure(_figure(curves), out)
    print(f"wrote {out}")


def _figure(curves: dict[str, Any]) -> Any:
    """Mean of each training over its runs, in the band from the least to the greatest."""
    from matplotlib.figure import Figure

    with styled():
        figure = Figure(figsize=(5.0, 3.2), layout="constrained")
        panel = figure.subplots()
        for (name, (steps, returns)), colour in zip(curves.items(), PALETTE, strict=False):
            label = f"{name}, runs: {len(returns)}"
            panel.plot(steps, returns.mean(0), color=colour, label=label)
            band = steps, returns.min(0), returns.max(0)
            panel.fill_between(*band, color=colour, alpha=0.15, linewidth=0)
        panel.set(xlabel="environment steps", ylabel="mean return in evaluation")
        panel.grid()
        panel.legend()
    return figure


def learning_curves(training: Path) -> tuple[Any, Any]:
    """Steps ``(n,)`` of evaluations, and the mean returns ``(runs, n)`` of each run.

    Raises:
        ValueError: if no run has been evaluated there.
    """
    import numpy as np

    folder = training if training.is_dir() else training.with_suffix("")
    runs = [evaluations(path) for path in sorted(folder.glob("**/evaluations.npz"))]
    if not runs:
        raise ValueError(f"no evaluations.npz is in {folder}: name what vessel-gym train wrote")
    steps = min((steps for steps, _ in runs), key=len)
    return steps, np.stack([np.interp(steps, *run) for run in runs])


def evaluations(file: Path) -> tuple[Any, Any]:
    """Steps and mean returns ``(n,)`` of the evaluations in an ``evaluations.npz``."""
    import numpy as np

    with np.load(file) as kept:
        return kept["timesteps"], kept["results"].mean(axis=1)
