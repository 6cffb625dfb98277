"""What is to be seen of each kind of task beside the vehicle: its path, its goal, what is in its way."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.metrics import core_of
from agents.rollouts import Rollout
from vessel_gym.guidance.dive_path import path_point
from vessel_gym.guidance.path_following import COLUMNS
from vessel_gym.guidance.words import Path as DubinsPath
from vessel_gym.registry import Registry
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.tasks.dive import Dive
from vessel_gym.tasks.flight import OBSTACLES, SEGMENTS, Flight
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.tracks import commanded_path

SPAN = 2.1
"""Wing span [m] of the Skywalker X8, Gryte (2018); the point mass has none."""


@dataclass(frozen=True)
class Scene:
    """The surroundings of one episode, in metres north, east and down.

    Attributes:
        hull: What is drawn at the vehicle's place: ``"ship"``, ``"torpedo"``, ``"aircraft"`` or ``"dot"``.
        size: Its length.
        space: Whether it moves in three dimensions.
        path: ``(k, 3)`` what it is asked to follow.
        goal: Where it is to arrive, and within what distance; None: nowhere.
        obstacles: ``(m, 3)`` north, east and radius of upright cylinders.
        surface: Whether there is water above, and its surface is at this depth; None: there is none.
    """

    hull: str = "dot"
    size: float = 1.0
    space: bool = False
    path: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    goal: tuple[float, ...] | None = None
    obstacles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    surface: float | None = None


SCENES: Registry[Callable[[Rollout], Scene]] = Registry("scene of an episode", lambda: None)


def scene_of(flown: Rollout) -> Scene:
    """The surroundings of the first episode of a rollout; bare where nobody has registered them for its task."""
    return SCENES.of(core_of(flown).task).get("", _bare)(flown)


def _bare(flown: Rollout) -> Scene:
    names = core_of(flown).vehicle.state_names
    return Scene(space="z" in names or "h" in names)


def _turn(flown: Rollout) -> Scene:
    task, reference = core_of(flown).task, flown.history["reference"][0]
    course = task.course_of(reference)[0] if isinstance(task, CircleTrack) else reference[0, [0, 3]]
    return Scene("ship", task.ship.length, path=_level(commanded_path(task, course)))


def _dive(flown: Rollout) -> Scene:
    task = core_of(flown).task
    course = task.course_of(flown.history["reference"][0, 0])
    path = path_point(np.linspace(0.0, course[1], 121), course)[:, :3]
    goal = (*path[-1], task.GOAL_TOLERANCE)
    return Scene("torpedo", task.auv.length, True, path, goal, surface=-task.launch_depth)


def _flight(flown: Rollout) -> Scene:
    task = core_of(flown).task
    course = task.course_of(flown.history["reference"][0, 0])
    down = -float(task.altitude_of(course))
    rows = course[: COLUMNS * SEGMENTS].reshape(SEGMENTS, COLUMNS)
    path = _level(DubinsPath(rows[rows[:, 4] > 0.0]).sample(3.0)[:, :2], down)
    north, east, _ = task.goal(course[None])[0]
    obstacles = course[-3 * OBSTACLES :].reshape(OBSTACLES, 3)
    return Scene(
        "aircraft", SPAN, True, path, (north, east, down, task.GOAL_TOLERANCE), obstacles[obstacles[:, 2] > 0.0]
    )


def _level(plane: np.ndarray, down: float = 0.0) -> np.ndarray:
    """Points ``(k, 2)`` of a plane at one depth, ``(k, 3)``."""
    return np.pad(plane, ((0, 0), (0, 1)), constant_values=down)


def register_surroundings(task_type: type, surroundings: Callable[[Rollout], Any]) -> None:
    """Say what is to be seen around the vehicle in episodes of a kind of task; subclasses inherit it.

    Args:
        task_type: The class of the task.
        surroundings: A function that makes a `Scene` of a rollout's first episode.

    Raises:
        TypeError: for a task type that is no class.
        ValueError: if the task has surroundings from another module.
    """
    SCENES.register(task_type, surroundings, surroundings.__module__)


register_surroundings(TurningCircle, _turn)
register_surroundings(Dive, _dive)
register_surroundings(Flight, _flight)
