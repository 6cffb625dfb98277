"""Surroundings of a vehicle in an episode, and names and units of its state's components.

Images (`vessel_gym.rendering`) and pages (`agents.episodes`) show all tasks in one way. A task
describes the surroundings by `register_surroundings`; otherwise images show the vehicle alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from estimators.checks import finite_array
from vessel_gym.checks import check_numbers, instance, one_of
from vessel_gym.guidance.dive_path import path_point
from vessel_gym.guidance.dubins import COLUMNS, Path
from vessel_gym.registry import Registry
from vessel_gym.simulation.core import Core
from vessel_gym.tasks.channel import Channel
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.tasks.dive import Dive
from vessel_gym.tasks.flight import ALTITUDE, LENGTH, OBSTACLES, SEGMENTS, Flight
from vessel_gym.tasks.turning import TurningTrial

HULLS = ("ship", "torpedo", "aircraft", "dot")
"""Outlines of vehicles for images."""
_SPAN = 2.1
"""Wing span [m] of the Skywalker X8, Gryte (2018), because a point mass has none."""
_WORDS = {
    "x": ("north position", "m"), "y": ("east position", "m"),
    "z": ("depth", "m"), "h": ("altitude", "m"),
    "phi": ("roll", "°"), "theta": ("pitch", "°"), "psi": ("heading", "°"),
    "u": ("surge speed", "m/s"), "v": ("sway speed", "m/s"), "w": ("heave speed", "m/s"),
    "p": ("roll rate", "°/s"), "q": ("pitch rate", "°/s"), "r": ("yaw rate", "°/s"),
    "north": ("speed north", "m/s"), "east": ("speed east", "m/s"), "climb": ("climb rate", "m/s"),
    "unknown yaw increment": ("yaw increment", "mrad"),
}  # fmt: skip


@dataclass(frozen=True)
class Surroundings:
    """Surroundings of the vehicle in one episode, in metres north, east and down.

    Attributes:
        hull: Outline of the vehicle, one of `HULLS`.
        size: Length of the vehicle; span of an aircraft.
        space: Does the vehicle move in three dimensions?
        path: ``(k, 3)`` path to follow.
        fairway: ``(k, 3)`` outline of the permitted water.
        goal: Position of the goal, and the distance that counts as arrival; None: no goal.
        obstacles: ``(m, 3)`` north, east and radius of upright cylinders.
        surface: Depth of the water surface; None: no surface in the image.

    Raises:
        ValueError: for an unknown hull.
    """

    hull: str = "dot"
    size: float = 1.0
    space: bool = False
    path: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    fairway: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    goal: tuple[float, float, float, float] | None = None
    obstacles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    surface: float | None = None

    def __post_init__(self) -> None:
        one_of("hull", self.hull, HULLS)
        check_numbers(self, positive="size", finite="surface?")
        instance("space of Surroundings", self.space, bool)
        for name in ("path", "fairway", "obstacles"):
            finite_array(f"{name} of Surroundings", getattr(self, name), "k", 3)
        if self.goal is not None:
            finite_array("goal of Surroundings", self.goal, 4)

    @property
    def landmarks(self) -> np.ndarray:
        """Points of path and goal ``(n, 3)``, which every map shows."""
        return np.concatenate(
            [self.path, np.zeros((0, 3)) if self.goal is None else [self.goal[:3]]]
        )


MakeSurroundings = Callable[[Any, np.ndarray], Surroundings]
"""Function of a task and its scenario ``(k,)`` that returns the surroundings."""
M = TypeVar("M", bound=MakeSurroundings)

SURROUNDINGS: Registry[MakeSurroundings] = Registry("surroundings", lambda: None)


def register_surroundings(task_type: type) -> Callable[[M], M]:
    """Decorator that registers the function from task and scenario ``(k,)`` to `Surroundings`.

    Subclasses of the task inherit the function.

    Args:
        task_type: Class of the task.

    Raises:
        TypeError: for a task type that is no class.
        ValueError: if another module registered surroundings for the task.
    """

    def register(surroundings: M) -> M:
        SURROUNDINGS.register(task_type, surroundings, surroundings.__module__)
        return surroundings

    return register


def surroundings_of(core: Core, scenario: np.ndarray) -> Surroundings:
    """Surroundings of an episode with a scenario ``(k,)``; by default the vehicle alone."""
    known = SURROUNDINGS.of(core.config.system.task).get("")
    if known is not None:
        return known(core.config.system.task, scenario)
    return Surroundings(space=bool({"z", "h"} & set(core.config.system.vehicle.state_names)))


def pose(states: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Positions and attitudes ``(T, 6)``: north, east, down [m], unwrapped roll, pitch, yaw [rad].

    Components that the state lacks are 0; without a heading, the yaw is the course.

    Args:
        states: ``(T, n)`` states.
        names: Names of the components of a state.
    """

    def of(name: str) -> np.ndarray:
        return states[:, names.index(name)] if name in names else np.zeros(len(states))

    yaw, pitch = of("psi"), of("theta")
    if "psi" not in names and "north" in names:
        yaw = np.arctan2(of("east"), of("north"))
        pitch = np.arctan2(of("climb"), np.hypot(of("east"), of("north")))
    return np.stack([of("x"), of("y"), of("z") - of("h"), of("phi"), pitch, np.unwrap(yaw)], -1)


def in_words(name: str, angles: Sequence[str]) -> tuple[str, str, float]:
    """A state component's name in words, its displayed unit, and the factor from SI to that unit.

    Args:
        name: Name of the component.
        angles: Names of the components that are angles.
    """
    words, unit = _WORDS.get(name, (name, "°" if name in angles else ""))
    return (
        words,
        unit,
        float(np.rad2deg(1.0)) if unit.startswith("°") else 1e3 if unit == "mrad" else 1.0,
    )


@register_surroundings(TurningTrial)
@register_surroundings(CircleTrack)
def _turn(task: TurningTrial | CircleTrack, scenario: np.ndarray) -> Surroundings:
    return Surroundings("ship", task.ship.length, path=_level(task.path(scenario)))


@register_surroundings(Channel)
def _channel(task: Channel, scenario: np.ndarray) -> Surroundings:
    path, edges = _level(task.path(scenario)), _level(task.edges(scenario))
    return Surroundings("ship", task.ship.length, path=path, fairway=edges)


@register_surroundings(Dive)
def _dive(task: Dive, scenario: np.ndarray) -> Surroundings:
    path = path_point(np.linspace(0.0, scenario[1], 121), scenario)[:, :3]
    north, east, down = path[-1]
    goal = (north, east, down, task.GOAL_TOLERANCE)
    return Surroundings(
        "torpedo", task.auv.length, True, path, goal=goal, surface=-task.launch_depth
    )


@register_surroundings(Flight)
def _flight(task: Flight, scenario: np.ndarray) -> Surroundings:
    down = -scenario[ALTITUDE]
    rows = scenario[:LENGTH].reshape(SEGMENTS, COLUMNS)
    path = _level(Path(rows[rows[:, 4] > 0.0]).sample(3.0)[:, :2], down)
    north, east, _ = task.goal(scenario[None])[0]
    obstacles = scenario[-3 * OBSTACLES :].reshape(OBSTACLES, 3)
    goal = (north, east, down, task.GOAL_TOLERANCE)
    return Surroundings(
        "aircraft", _SPAN, True, path, goal=goal, obstacles=obstacles[obstacles[:, 2] > 0.0]
    )


def _level(plane: np.ndarray, down: float = 0.0) -> np.ndarray:
    """Points ``(k, 2)`` of a plane at one depth, ``(k, 3)``."""
    return np.pad(plane, ((0, 0), (0, 1)), constant_values=down)
