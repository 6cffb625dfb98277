"""Draw the pictures of docs/dubins.md: ``python docs/images/dubins.py``."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from agents.plotting import BELIEVED, INK, RAW, TRUE, styled
from vessel_gym.guidance.dubins import WORDS, plan, shortest, word_path

HERE = Path(__file__).parent


def draw(axes, path, colour=TRUE, **style):
    """A path with arrows at its poses."""
    x, y, heading = path.sample(path.length / 400).T
    axes.plot(x, y, color=colour, **style)
    ends = [0, -1]
    axes.quiver(
        x[ends],
        y[ends],
        np.cos(heading[ends]),
        np.sin(heading[ends]),
        color=INK,
        zorder=3,
        width=0.006,
    )


def obstruct(axes, obstacles, margin):
    """Obstacles, and dashed the distance to keep from them."""
    for x, y, radius in obstacles:
        axes.add_patch(Circle((x, y), radius, color="#e3e5e8"))
        axes.add_patch(
            Circle((x, y), radius + margin, fill=False, color=RAW, linestyle="--", linewidth=0.6)
        )


def save(figure, axes, name, unit="m"):
    """Axes of equal scales, beside this file."""
    for ax in np.ravel(axes):
        ax.set_aspect("equal")
        ax.margins(0.1)
        ax.grid()
        ax.set_xlabel(f"x [{unit}]")
        ax.set_ylabel(f"y [{unit}]")
        ax.label_outer()
    figure.savefig(HERE / name, dpi=130)


with styled():
    figure = Figure(figsize=(8, 5.6), layout="constrained")
    axes = figure.subplots(2, 3, sharex=True, sharey=True)
    start, goal = [0.0, 0.0, 0.6], [2.3, 1.3, -2.5]
    for ax, word in zip(axes.flat, WORDS, strict=True):
        path = word_path(start, goal, 1.0, word)
        draw(ax, path, BELIEVED if word == shortest(start, goal, 1.0).word else TRUE)
        ax.set_title(f"{word}  {path.length:.2f} R", loc="left")
    save(figure, axes, "dubins-words.png", "R")

    figure = Figure(figsize=(8, 5.2), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    for ax, axis, headings in zip(
        axes, "xy", [(np.pi / 6, 0.0), (np.pi / 3, np.pi / 2)], strict=True
    ):
        path = shortest([-500.0, 100.0, headings[0]], [0.0, 200.0, headings[1]], 100.0)
        draw(ax, path)
        ax.set_ylim(60.0, 240.0)
        ax.set_title(f"headings from the {axis} axis: {path.word}, {path.length:.1f} m", loc="left")
    save(figure, axes, "dubins-case-a.png")

    figure = Figure(figsize=(8, 3.6), layout="constrained")
    ax = figure.subplots()
    obstacle, poses = [(-250.0, 150.0, 30.0)], ([-500.0, 100.0, np.pi / 3], [0.0, 126.795, 0.0])
    direct, detour = shortest(*poses, 100.0), plan(*poses, 100.0, obstacle, margin=10.0)
    obstruct(ax, obstacle, 10.0)
    draw(
        ax, direct, BELIEVED, linestyle=":", label=f"shortest: {direct.word}, {direct.length:.1f} m"
    )
    draw(ax, detour, label=f"plan: {detour.length:.1f} m")
    ax.plot(
        *direct.segments[1:, :2].T, "o", color=BELIEVED, markersize=5, label="the published points"
    )
    ax.set_ylim(60.0, 220.0)
    figure.legend(loc="outside lower center", ncols=3)
    save(figure, ax, "dubins-case-b.png")

    figure = Figure(figsize=(8, 6), layout="constrained")
    ax = figure.subplots()
    rng = np.random.default_rng(19)
    obstacles = rng.uniform([3.0, -7.0, 0.3], [17.0, 7.0, 1.6], (20, 3))
    path = plan([0.0, 0.0, 1.5], [20.0, 0.0, 1.5], 1.0, obstacles, margin=0.2)
    obstruct(ax, obstacles, 0.2)
    draw(ax, path)
    ax.set_title(
        f"{path.length:.1f} R, unobstructed {shortest([0.0, 0.0, 1.5], [20.0, 0.0, 1.5], 1.0).length:.1f} R"
    )
    save(figure, ax, "dubins-scene.png", "R")
