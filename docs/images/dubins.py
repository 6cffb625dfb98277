"""Draw the pictures of docs/dubins.md: ``python docs/images/dubins.py``."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from agents.plotting import INK, styled
from vessel_gym.guidance.dubins import CURVATURES, WORDS, chained, path_of, shortest, word_pieces
from vessel_gym.guidance.planner import plan

HERE = Path(__file__).parent
TRUE, BELIEVED, RAW = "#1f4e79", "#c8590b", "#8a8f96"


def draw(axes, path, colour=TRUE):
    """A path with arrows at its poses."""
    x, y, heading = path.sample(path.length / 400).T
    axes.plot(x, y, color=colour)
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


def save(figure, axes, name):
    """Axes of equal scales, beside this file."""
    for ax in np.ravel(axes):
        ax.set_aspect("equal")
        ax.margins(0.1)
        ax.grid()
        ax.set_xlabel("x [R]")
        ax.set_ylabel("y [R]")
        ax.label_outer()
    figure.savefig(HERE / name, dpi=130)


with styled():
    figure = Figure(figsize=(8, 5.6), layout="constrained")
    axes = figure.subplots(2, 3, sharex=True, sharey=True)
    start, goal = np.array([0.0, 0.0, 0.6]), np.array([2.3, 1.3, -2.5])
    pieces = word_pieces(start, goal, 1.0)
    for ax, word, *row in zip(axes.flat, WORDS, CURVATURES, pieces, strict=True):
        path = path_of(chained(start, *row))
        draw(ax, path, BELIEVED if word == shortest(start, goal, 1.0).word else TRUE)
        ax.set_title(f"{word}  {path.length:.2f} R", loc="left")
    save(figure, axes, "dubins-words.png")

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
    save(figure, ax, "dubins-scene.png")
