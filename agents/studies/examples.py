"""Example episodes of a study: what was flown and what was believed, at a seed that nobody chose."""

from typing import Any

import numpy as np

from agents.cells import Cell
from agents.metrics import WITHOUT_COVARIANCE, core_of
from agents.rollouts import Rollout, rollout
from agents.studies.plan import Plan
from agents.studies.study import FLOOR, ORACLE
from agents.studies.worlds import classical_pilot, environment_id, environment_options, import_own, system_of
from estimators import wrap
from estimators.angles import difference
from vessel_gym.guidance.dive_path import path_point
from vessel_gym.guidance.path_following import COLUMNS
from vessel_gym.guidance.words import Path as DubinsPath
from vessel_gym.tasks.circle_track import TRACK, CircleTrack
from vessel_gym.tasks.dive import Dive, VerticalDive
from vessel_gym.tasks.flight import OBSTACLES, SEGMENTS, Flight
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.tracks import believed_path, commanded_path, path
from vessel_gym.vehicles.corvette_equations import STATE as SHIP

POINTS = 400
"""Points of a line at most."""


def examples(plan: Plan) -> dict[tuple[str, str], Cell]:
    """The cells of the examples, by environment and estimator.

    The classical agent flies the first evaluation seed in the first condition on the environment's default estimator,
    on the first and the last of the study's others, and on dead reckoning.
    """
    chosen: dict[tuple[str, str], Cell] = {}
    classical = next(agent.name for agent in plan.study.agents if not agent.learned)
    condition = plan.study.conditions[0].name
    for environment in (e.id for e in plan.study.environments):
        flights = {
            f.flown_on: f.cell.arguments
            for f in plan.flights
            if (f.environment, f.condition, f.agent) == (environment, condition, classical)
        }
        default = system_of(environment).estimator
        order = [e.name for e in plan.study.estimators if e.name in flights]
        others = [name for name in order if name not in (default, ORACLE, FLOOR)]
        for name in dict.fromkeys([default, *others[:1], *others[-1:], FLOOR]):
            if name in flights:
                given = {key: flights[name][key] for key in ("environment", "options", "agent", "own")}
                chosen[environment, name] = Cell(
                    "agents.studies.examples:example",
                    given | {"seed": plan.study.seeds[0]},
                    f"example on {name} in {environment}",
                )
    return chosen


def example(environment: str, options: dict[str, Any], agent: str, seed: int, own: dict[str, str]) -> dict[str, Any]:
    """Fly one episode and keep what a figure of it needs.

    Args:
        environment: As in the study.
        options: Of the environment.
        agent: As `agents.pilots.make_pilot` takes it.
        seed: Of the episode.
        own: Source digests of the user's own modules, by name: part of the cell, and imported for what they register.

    Returns:
        ``tracks``: ``commanded``, ``true`` and ``believed``, ``(k, 2)`` each in the plane of ``axes`` (labels across
        and up; ``down``: whether the second one grows downwards), empty for a task that is not known here;
        ``obstacles (m, 3)``: centre and radius in that plane [m];
        ``time (k,)`` [s], ``error (k,)``: estimate minus truth of ``what`` in ``unit``; ``two_sigma (k,)``: twice the
        standard deviation that the estimator claims for it, None if it claims none; ``score``; and ``end``: why the
        episode ended, empty for its time limit. Lines are thinned to `POINTS`.
    """
    import_own(own)
    pilot, options = classical_pilot(agent, environment), environment_options(environment, options)
    flown = rollout(pilot, environment_id(environment), [seed], options)
    task = core_of(flown).task
    views = (CircleTrack, _track), (TurningCircle, _turn), (Dive, _dive), (Flight, _flight)
    view = next((view for kind, view in views if isinstance(task, kind)), _unknown)
    return view(flown) | {"score": float(flown.score[0]), "end": str(flown.end[0])}


def _turn(flown: Rollout) -> dict[str, Any]:
    """North over east, through the water; the heading."""
    task, h = core_of(flown).task, _episode(flown)
    heading, surge, sway = (h["truth"][:, SHIP.index(name)] for name in ("psi", "u", "v"))
    tracks = {
        "commanded": commanded_path(task, h["reference"][0, [0, 3]]),
        "true": path(heading, surge, sway, task.dt),
        "believed": believed_path(h["estimate"], task.ship, task.dt),
    }
    return {
        "tracks": {name: _thin(track[:, ::-1]) for name, track in tracks.items()},
        "axes": ["east [m]", "north [m]"],
        "down": False,
        "obstacles": [],
        "what": "heading",
        "unit": "mrad",
    } | _error(flown, 1e3 * wrap(h["estimate"][:, 2] - heading), 1e3 * np.sqrt(h["covariance"][:, 2, 2]))


def _track(flown: Rollout) -> dict[str, Any]:
    """From above, and the position to starboard of the track."""
    task, h = core_of(flown).task, _episode(flown)
    line = commanded_path(task, task.course_of(h["reference"][:1])[0])
    return {"axes": ["east [m]", "north [m]"], "down": False, "obstacles": []} | _plane(
        flown, ("y", "x"), _thin(line[:, ::-1]), -h["reference"][:, TRACK], "position across the track"
    )


def _dive(flown: Rollout) -> dict[str, Any]:
    """From above, and the position across the path; or, in the vertical plane, from the side, and that along x."""
    core, h = core_of(flown), _episode(flown)
    course = h["reference"][0, 8:]
    commanded = path_point(np.linspace(0.0, course[1], POINTS), course)
    if isinstance(core.task, VerticalDive):
        shown: dict[str, Any] = {"axes": ["ahead [m]", "depth below the start [m]"], "down": True}
        plane, line, angle, what = ("x", "z"), commanded[:, [0, 2]], np.zeros(len(h["truth"])), "position along x"
    else:
        shown = {"axes": ["east [m]", "north [m]"], "down": False}
        plane, line, what = ("y", "x"), commanded[:, [1, 0]], "position across the path"
        angle = -h["reference"][:, 3]  # starboard of the path, in the plane of east and north
    return shown | {"obstacles": []} | _plane(flown, plane, line, angle, what)


def _flight(flown: Rollout) -> dict[str, Any]:
    """From above, and the position across the path."""
    h = _episode(flown)
    course = core_of(flown).task.course_of(h["reference"][0])
    rows = course[: COLUMNS * SEGMENTS].reshape(SEGMENTS, COLUMNS)
    whole = DubinsPath(rows[rows[:, 4] > 0.0])
    line = whole.pose(np.linspace(0.0, whole.length, POINTS))[:, 1::-1]
    obstacles = course[-3 * OBSTACLES :].reshape(OBSTACLES, 3)[:, [1, 0, 2]]
    return {
        "axes": ["east [m]", "north [m]"],
        "down": False,
        "obstacles": obstacles[obstacles[:, 2] > 0.0],
    } | _plane(flown, ("y", "x"), line, -h["reference"][:, 3], "position across the path")


def _plane(
    flown: Rollout, names: tuple[str, str], commanded: np.ndarray, angle: np.ndarray, what: str
) -> dict[str, Any]:
    """Tracks in the plane of two components of the state, and the error along a direction in it.

    Args:
        flown: One episode.
        names: Of the two components.
        commanded: ``(k, 2)`` path in the plane.
        angle: ``(T,)`` of the direction, from the first component towards the second.
        what: The direction in words.
    """
    h, core = _episode(flown), core_of(flown)
    both = [core.truth_names.index(name) for name in names]
    believed = [core.composition.names.index(name) for name in names]
    direction = np.stack([np.cos(angle), np.sin(angle)], -1)
    error = np.vecdot(direction, h["estimate"][:, believed] - h["truth"][:, both])
    variance = np.einsum("ti,tij,tj->t", direction, h["covariance"][:, believed][:, :, believed], direction)
    return {
        "tracks": {
            "commanded": commanded,
            "true": _thin(h["truth"][:, both]),
            "believed": _thin(h["estimate"][:, believed]),
        },
        "what": what,
        "unit": "m",
    } | _error(flown, error, np.sqrt(np.maximum(variance, 0.0)))


def _unknown(flown: Rollout) -> dict[str, Any]:
    """No tracks; the first component that the filter estimates."""
    core, h = core_of(flown), _episode(flown)
    model = core.filter.model
    state = core.estimated(h["truth"])
    error = difference(h["estimate"], state, model.state_angles)[:, 0]
    shown = {"tracks": {}, "axes": [], "down": False, "obstacles": [], "what": "first state component", "unit": "SI"}
    return shown | _error(flown, error, np.sqrt(np.maximum(h["covariance"][:, 0, 0], 0.0)))


def _error(flown: Rollout, error: np.ndarray, sd: np.ndarray) -> dict[str, Any]:
    """The time, an error ``(T,)`` and twice its claimed standard deviation ``(T,)``."""
    core = core_of(flown)
    claims = core.estimator not in WITHOUT_COVARIANCE
    return {
        "time": _thin(np.arange(len(error)) * core.vehicle.dt),
        "error": _thin(error),
        "two_sigma": _thin(2.0 * sd) if claims else None,
    }


def _episode(flown: Rollout) -> dict[str, np.ndarray]:
    """The history of the only episode ``(T, ...)``, from its start to its end."""
    return {key: values[: flown.length[0] + 1, 0] for key, values in flown.history.items()}


def _thin(line: np.ndarray) -> np.ndarray:
    """At most `POINTS` rows, evenly spread, the first and the last among them."""
    return line[np.unique(np.linspace(0, len(line) - 1, POINTS).round().astype(int))]
