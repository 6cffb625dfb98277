"""Workspace of a vehicle in one episode: what images and pages show around it."""

from dataclasses import dataclass, field

import numpy as np

from estimators.checks import finite_array
from vessel_gym.checks import check_numbers, one_of

HULLS = ("ship", "torpedo", "aircraft", "dot")
"""Outlines of vehicles for images."""


@dataclass(frozen=True)
class Workspace:
    """Path, goal, obstacles and other bounds of one episode, in metres north, east and down.

    Attributes:
        hull: Outline of the vehicle, one of `HULLS`.
        size: Length of the vehicle; span of an aircraft.
        path: ``(k, 3)`` path to follow.
        fairway: ``(k, 3)`` outline of the permitted water.
        goal: Position of the goal, and the distance that counts as arrival; None: no goal.
        obstacles: ``(m, 3)`` north, east and radius of upright cylinders.
        surface: Depth of the water surface; None: no surface in the image.

    Raises:
        ValueError: for an unknown hull, or numbers that are not finite.
    """

    hull: str = "dot"
    size: float = 1.0
    path: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    fairway: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    goal: tuple[float, float, float, float] | None = None
    obstacles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    surface: float | None = None

    def __post_init__(self) -> None:
        one_of("hull", self.hull, HULLS)
        check_numbers(self, positive="size", finite="surface?")
        for name in ("path", "fairway", "obstacles"):
            finite_array(f"{name} of Workspace", getattr(self, name), "k", 3)
        if self.goal is not None:
            finite_array("goal of Workspace", self.goal, 4)

    @property
    def landmarks(self) -> np.ndarray:
        """Points of path and goal ``(n, 3)``, which every map shows."""
        goal = [] if self.goal is None else [self.goal[:3]]
        return np.concatenate([self.path, np.reshape(goal, (-1, 3))])


def at_depth(points: np.ndarray, down: float = 0.0) -> np.ndarray:
    """Points ``(k, 2)`` north and east as points ``(k, 3)`` at one depth."""
    return np.pad(points, ((0, 0), (0, 1)), constant_values=down)
