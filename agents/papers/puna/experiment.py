"""The PUNA paper: its two Dubins cases, and the ensemble Kalman filter in the vertical plane.

Poses are (x, y, theta) [m, m, rad], theta from +x towards +y; states are (gamma, v, x, h) [rad,
m/s, m, m].
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from agents.page import text
from agents.papers.figures import figure, panels
from agents.papers.measures import (
    Comparison,
    by_members,
    comparison_table,
    geometric,
    rows,
    with_units,
)
from agents.papers.puna.model import PlanarPuna
from agents.papers.vehicle import Experiment
from estimators import make, rmse, wrap
from vessel_gym.guidance.dubins import WORDS, lengths, shortest
from vessel_gym.guidance.planner import plan
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.puna import PunaParameters, trim

PLANE = PlanarPuna()
QUANTITIES = {"γ": "rad", "v": "m/s", "x": "m", "h": "m"}
MEASURED = {"all": [0, 1, 2, 3], "x": [2]}
"""Sets of measurements: every state, or the position along the track alone."""
CONTROLS = ("constant", "varying")
INTERPRETATIONS = {
    "from the x axis": (0.0, 1.0),
    "from the y axis, clockwise": (np.pi / 2, -1.0),
    "from the y axis, counter-clockwise": (np.pi / 2, 1.0),
}
"""Interpretations of a printed heading chi, theta = offset + sign chi; printed is "to the y axis"
(sec. II d)."""
START = np.array([0.0, 20.0, 0.0, 100.0])
"""Level, at the speed and first altitude of the Dubins cases; no initial state is printed."""


# --- paths ----------------------------------------------------------------------------------------


def poses(case: Mapping[str, Any], interpretation: str) -> tuple[np.ndarray, np.ndarray]:
    """Start and goal ``(3,)`` of a printed case under one of the `INTERPRETATIONS`."""
    offset, sign = INTERPRETATIONS[interpretation]
    start, goal = offset + sign * np.deg2rad(case["headings"])
    return np.array([*case["start"], start]), np.array([*case["goal"], goal])


def string(
    start: Sequence[float], goal: Sequence[float], obstacle: Sequence[float], side: float
) -> tuple[float, np.ndarray]:
    """Length and headings at both ends of the taut string round a circle: straight, arc, straight.

    Args:
        start: x, y [m].
        goal: x, y [m].
        obstacle: x, y, radius [m].
        side: 1 if the arc turns left, -1 if it turns right.
    """
    centre, radius = np.array(obstacle[:2]), obstacle[2]
    ways = np.array([centre - start, np.array(goal) - centre])
    away = np.array([-side, side]) * np.arcsin(radius / np.hypot(*ways.T))
    headings = np.arctan2(ways[:, 1], ways[:, 0]) + away
    arc = radius * (side * (headings[1] - headings[0]) % (2.0 * np.pi))
    return float(arc + np.sqrt((ways**2).sum(1) - radius**2).sum()), headings


def way_round(
    start: Sequence[float], goal: Sequence[float], obstacle: Sequence[float], side: float
) -> list[np.ndarray]:
    """X and y ``(n,)`` of a `string` round a circle."""
    first, last = string(start, goal, obstacle, side)[1]
    turn = np.linspace(first, first + side * (side * (last - first) % (2.0 * np.pi)), 61)
    around = obstacle[2] * side * np.array([np.sin(turn), -np.cos(turn)])
    arc = np.array(obstacle[:2])[:, None] + around
    return [*np.column_stack([start, arc, goal])]


def open_case(paths: Mapping[str, Any]) -> dict[str, Any]:
    """Length of each word by interpretation of the headings, without an obstacle."""
    radius = paths["radius"]
    return {
        name: dict(zip(WORDS, lengths(*poses(paths["open"], name), radius).tolist(), strict=True))
        for name in INTERPRETATIONS
    }


def obstructed_case(paths: Mapping[str, Any]) -> dict[str, Any]:
    """Ways past the obstacle: length, clearance of its centre and kinks at the printed points.

    They are the strings between the printed points, the path of which these are the tangent points,
    a path to fly, and the shortest paths if the points are poses. The goal's y is "obtained": no
    formula is printed, this one gives both of its values.
    """
    case, radius, obstacle = paths["obstructed"], paths["radius"], np.array([paths["obstacle"]])
    heading, (x, y) = np.deg2rad(case["headings"][0]), paths["open"]["start"]
    goal = np.array([paths["open"]["goal"][0], y + 2.0 * radius * (1.0 - np.sin(heading)), 0.0])
    ends = np.array([x, y, heading]), goal
    whole = shortest(*ends, radius)
    found: dict[str, Any] = {}
    for word, side in (("SRS", -1.0), ("SLS", 1.0)):
        length, headings = string(case["start"], case["goal"], paths["obstacle"], side)
        kinks = np.rad2deg(np.abs(wrap(headings - whole.segments[1, 2])))
        found[f"{word}, string round it"] = length, paths["obstacle"][2], kinks.tolist()
    flown = {
        f"{whole.word} from (−500, 100), through the obstacle": whole,
        "our plan from there, round it": plan(*ends, radius, obstacle),
    }
    for name in INTERPRETATIONS:
        path = shortest(*poses(case, name), radius)
        flown[f"{path.word}, printed points as poses, headings {name}"] = path
    for way, path in flown.items():
        found[way] = path.length, path.distance(obstacle[:, :2])[0], []
    return found


# --- estimation -----------------------------------------------------------------------------------


def controls(kind: str, steps: int, swing: float, period: float) -> np.ndarray:
    """Thrust [N] and angle of attack [rad] of level flight ``(steps, 2)``; the angle may swing."""
    level = trim(START[1], load("puna", PunaParameters))
    amplitude = np.deg2rad(swing) if kind == "varying" else 0.0
    alpha = level.alpha + amplitude * np.sin(2.0 * np.pi * PLANE.dt * np.arange(steps) / period)
    return np.stack([np.full(steps, level.thrust), alpha], -1)


def flight(known: np.ndarray, process: np.ndarray, measurement: np.ndarray) -> Experiment:
    """A flight under known controls with variances ``(4,)`` of a step; every state is measured."""
    every, noise, sd = MEASURED["all"], np.sqrt(process), np.sqrt(measurement)
    return Experiment(PLANE.step, START, known, every, every, noise, sd, noise, angles=(0,))


def estimate(
    control: str,
    measured: str,
    process: np.ndarray,
    measurement: np.ndarray,
    members: int,
    runs: int,
    seed: int,
    steps: int,
    swing: float,
    period: float,
) -> np.ndarray:
    """RMS errors of flights; truth and measurements depend neither on what is measured nor on N.

    The start is drawn as the members of eq. (24) are: from the initial guess with the noise of a
    step.

    Args:
        control: One of `CONTROLS`.
        measured: One of the sets `MEASURED`.
        process: ``(4,)`` variances of the process noise of a step.
        measurement: ``(4,)`` variances of the measurements.
        members: N.
        runs: Flights.
        seed: Of truth, measurements and filters.
        steps: Of a flight.
        swing: Amplitude [deg] of a varying angle.
        period: Of a varying angle [s].

    Returns:
        RMSE ``(runs, 4)`` over the steps of a flight.
    """
    known, seen = controls(control, steps, swing, period), MEASURED[measured]
    sd = np.sqrt(measurement)
    flown, noise = flight(known, process, measurement), np.sqrt(process)
    rng = np.random.default_rng(seed)
    start = START + noise * rng.standard_normal((runs, len(START)))
    truth, measurements = replace(flown, start=start).simulate(runs, rng)
    assumed = replace(flown, measured=seen, measurement_sd=sd[seen])
    enkf = make("enkf", assumed.model, members=members, draws="independent")
    means, _ = assumed.estimates(enkf, np.ascontiguousarray(measurements[..., seen]), seed)
    return rmse(means[1:], truth[1:], angles=(0,), axis=0)


# --- tables ---------------------------------------------------------------------------------------


Errors = Callable[[str, str, str, int], np.ndarray]
"""Errors ``(runs, 4)`` by noise level, control, measurements and members."""


def report(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Tables and measures."""
    shared = {key: settings[key] for key in ("runs", "seed", "steps", "swing", "period")}

    @cache
    def errors(level: str, control: str, measured: str, members: int) -> np.ndarray:
        process, measurement = np.outer(settings["levels"][level], settings["D"])
        return estimate(control, measured, process, measurement, members, **shared)

    columns = {
        label: _comparisons(settings["printed"], errors, *of)
        for label, *of in (
            ("noise of a flight", "flight", "all"),
            ("with x alone", "flight", "x"),
            ("noise of the printed sizes", "sizes", "all"),
        )
    }
    own: list[Any] = [("angle", "members", *with_units(QUANTITIES))]
    for control in CONTROLS:
        sizes = {n: errors("flight", control, "all", n) for n in settings["members"]}
        own += by_members(control, sizes)
        every, x = (np.log(errors("flight", control, measured, 300)) for measured in MEASURED)
        gains = (text(geometric(each), 2) for each in (x - every).T)
        own.append((control, "300, x alone / every state", *gains))
    found = open_case(settings["paths"])
    words: list[Any] = [("word", *(f"{interpretation} [m]" for interpretation in found))]
    for word in WORDS:
        cells = (f"{of[word]:.1f}" if of[word] < np.inf else "–" for of in found.values())
        words.append((word, *cells))
    ways: list[Any] = [("way", "length [m]", "passes the centre at [m]", "kinks [deg]")]
    for way, (length, clearance, kinks) in obstructed_case(settings["paths"]).items():
        places = " and ".join(f"{kink:.1f}" for kink in kinks) or "none"
        ways.append((way, f"{length:.3f}", f"{clearance:.2f}", places))
    published = comparison_table(columns)
    return {
        "tables": {"published": published, "own": own, "words": words, "obstacle": ways},
        "figures": _figures(settings),
        "rows": rows(settings["paper"], columns["noise of a flight"]),
    }


def _figures(settings: Mapping[str, Any]) -> list[Any]:
    """Figures 2 and 3, the paths, and both figures 4, a flight with each angle of attack."""
    paths = settings["paths"]
    open_path = shortest(*poses(paths["open"], "from the x axis"), paths["radius"])
    case, obstacle = paths["obstructed"], paths["obstacle"]
    turn, radius = np.linspace(0.0, 2.0 * np.pi, 121), obstacle[2]
    ways = {
        "obstacle": [obstacle[0] + radius * np.cos(turn), obstacle[1] + radius * np.sin(turn)],
        "SRS": way_round(case["start"], case["goal"], obstacle, -1.0),
        "SLS": way_round(case["start"], case["goal"], obstacle, 1.0),
    }
    plane = {"x": "x [m]", "y": "y [m]", "equal": True}
    lines = {open_path.word: [*open_path.sample(5.0).T[:2]]}
    found = [
        figure("2", "The path RSR without an obstacle.", plane | {"lines": lines}),
        figure(
            "3", "The path SRS round an obstacle, and the shorter SLS.", plane | {"lines": ways}
        ),
    ]
    process, measurement = np.outer(settings["levels"]["flight"], settings["D"])
    for control in CONTROLS:
        members = settings["printed"][control]["members"]
        known = controls(control, *(settings[key] for key in ("steps", "swing", "period")))
        flown = flight(known, process, measurement)
        truth, measured = flown.simulate(1, np.random.default_rng(settings["seed"]))
        enkf = make("enkf", flown.model, members=members, draws="independent")
        times, (mean, sd) = PLANE.dt * np.arange(len(truth)), flown.estimates(enkf, measured)
        flights = {"real": truth[:, 0], "EnKF": mean[:, 0]}
        drawn = panels(times, with_units(QUANTITIES), flights, sd[:, 0].T)
        caption = f"Estimates of angle, speed and position, {control} α, {members} members."
        found.append(figure(f"4 {control}", caption, *drawn))
    return found


def _comparisons(
    printed: Mapping[str, Any], errors: Errors, level: str, measured: str
) -> list[Comparison]:
    """The eight printed errors beside ours at a noise level."""
    reason = {"sizes": "Q and R were taken from it"}.get(level, "")
    found = []
    for control in CONTROLS:
        line = printed[control]
        size, meant = line["members"], line.get("meant", {})
        ours = errors(level, control, measured, size).T
        for (name, unit), number, of in zip(QUANTITIES.items(), line["errors"], ours, strict=True):
            found.append(Comparison(
                f"{control} angle, {size} members", name, unit, number, line["where"], of,
                meant=str(meant.get(name, "")), reason=reason,
            ))  # fmt: skip
    return found
