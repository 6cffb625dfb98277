"""The trainings of `studies.critic`, and the tables and the picture that it writes to docs/critic.md."""

from functools import partial
from pathlib import Path

import numpy as np

from agents.commands.console import progress_bar
from agents.files import compute_once
from agents.plotting import PALETTE, styled
from agents.policies.network import one_thread
from studies.critic.benchmark import END, HALF, World, learned
from studies.tables.markdown import ROOT, put, shown, table

PAGE, PICTURE = ROOT / "docs/critic.md", ROOT / "docs/images/critic.png"

RAW = {"observe": "measurement"}
WORLDS = {
    "estimates": World("estimates", 300_000),
    "rough": World("estimates, rough sea", 300_000, options={"disturbance": "rough"}),
    "raw": World("raw measurements", 1_000_000, options=RAW, arms=("observation", "truth", "leak")),
    "frames": World("raw measurements, frames", 300_000, "frames", RAW),
    "lstm": World("raw measurements, LSTM", 150_000, "lstm", RAW),
}


Found = dict[tuple[World, str], dict[str, np.ndarray]]
"""Measured values ``(runs, POINTS, ...)`` by world and arm."""


def measured(runs: int, out: Path) -> Found:
    """Train in all worlds, as far as results are missing."""
    todo, found = [(world, arm) for world in WORLDS.values() for arm in world.arms], {}
    with progress_bar("trainings", runs * len(todo)) as advance, one_thread():
        for world, arm in todo:
            each = []
            for seed in range(runs):
                name = f"{world.label}-{arm}-{seed}.json".replace(",", "").replace(" ", "-")
                each.append(compute_once(out / name, partial(learned, world, arm, seed)))
                advance()
            found[world, arm] = {key: np.array([run[key] for run in each]) for key in each[0]}
    return found


def write(found: Found) -> None:
    """Write the page."""
    put(PAGE, "table: scores", scores(found))
    put(PAGE, "table: explained", variances(found))
    put(PAGE, "table: leak", leak(found))
    draw(found)


def scores(found: Found) -> str:
    """Mean scores at half time and at the end, with intervals over runs and evaluation seeds."""
    return _compared(found, "score")


def variances(found: Found) -> str:
    """Explained variances likewise, with intervals over runs."""
    return _compared(found, "explained")


def _compared(found: Found, figure: str) -> str:
    rows = []
    for world in WORLDS.values():
        own, true = (found[world, arm][figure] for arm in ("observation", "truth"))
        rows += [
            (f"{world.label}, {world.steps // share:,} steps", shown(own[:, point]), shown(true[:, point]),
             shown(true[:, point] - own[:, point]))
            for share, point in ((2, HALF), (1, END))
        ]  # fmt: skip
    return table(("", "critic sees the observation", "and the truth", "difference"), rows)


def leak(found: Found) -> str:
    """Scores of actors into which the truth leaked, as they were trained and without it."""
    rows = []
    for (world, arm), measured in found.items():
        if arm == "leak":
            kinds = measured["score"], measured["zeroed"], found[world, "truth"]["score"]
            rows += [
                (f"{world.label}, {world.steps // share:,} steps", *(shown(kind[:, point]) for kind in kinds))
                for share, point in ((2, HALF), (1, END))
            ]
    return table(("", "leaks", "leaks, the critic's input zeroed", "does not leak"), rows)


def draw(found: Found) -> None:
    """Scores and explained variances by steps: a line for each run, and a thick one for their mean."""
    from matplotlib.figure import Figure

    looks = {
        "observation": (PALETTE[0], "critic sees the observation"),
        "truth": (PALETTE[1], "and the truth"),
        "leak": (PALETTE[2], "the truth leaks to the actor"),
        "zeroed": (PALETTE[3], "likewise, the critic's input zeroed"),
    }
    with styled():
        figure = Figure(figsize=(11.0, 4.8), layout="constrained")
        axes = figure.subplots(2, len(WORLDS), sharey="row")
        for (top, bottom), world in zip(axes.T, WORLDS.values(), strict=True):
            top.set_title(world.label)
            bottom.set_xlabel("thousand steps")
            for arm in world.arms:
                measured = found[world, arm]
                drawn = [(top, measured["score"].mean(-1), arm), (bottom, measured["explained"], arm)]
                if arm == "leak":
                    drawn.append((top, measured["zeroed"].mean(-1), "zeroed"))
                for axis, runs, look in drawn:
                    steps, (colour, label) = measured["steps"] / 1000.0, looks[look]
                    axis.plot(steps.T, runs.T, color=colour, alpha=0.3, linewidth=0.7)
                    axis.plot(steps.mean(0), runs.mean(0), color=colour, linewidth=2.0, label=label)
        axes[0, 0].set_ylabel("score on held-out seeds")
        axes[1, 0].set_ylabel("explained variance there")
        lines = {
            label: line for axis in axes.flat for line, label in zip(*axis.get_legend_handles_labels(), strict=True)
        }
        figure.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=len(lines))
        figure.savefig(PICTURE, dpi=150)
