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
from estimators import rmse, wrap
from vessel_gym.guidance.dubins import WORDS, Path, lengths, shortest
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


def taut_string(
    start: Sequence[float], goal: Sequence[float], obstacle: Sequence[float], side: float
) -> Path:
    """The taut string round a circle: straight, arc, straight.

    Args:
        start: x, y [m].
        goal: x, y [m].
        obstacle: x, y, radius [m].
        side: 1 if the arc turns left, -1 if it turns right.
    """
    centre, radius = np.array(obstacle[:2]), obstacle[2]
    ways = np.array([centre - start, np.array(goal) - centre])
    away = np.array([-side, side]) * np.arcsin(radius / np.hypot(*ways.T))
    first, last = headings = np.arctan2(ways[:, 1], ways[:, 0]) + away
    touched = centre + radius * side * np.stack([np.sin(headings), -np.cos(headings)], -1)
    before, after = np.sqrt((ways**2).sum(1) - radius**2)
    arc = radius * (side * (last - first) % (2.0 * np.pi))
    return Path(np.column_stack([
        [start, *touched], [first, first, last], [0.0, side / radius, 0.0], [before, arc, after]
    ]))  # fmt: skip


def strings(paths: Mapping[str, Any]) -> dict[str, Path]:
    """Taut strings past both sides of the obstacle, by their words."""
    case, sides = paths["obstructed"], {"SRS": -1.0, "SLS": 1.0}
    return {
        word: taut_string(case["start"], case["goal"], paths["obstacle"], side)
        for word, side in sides.items()
    }


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
    taut = {f"{word}, string round it": path for word, path in strings(paths).items()}
    flown = taut | {
        f"{whole.word} from (−500, 100), through the obstacle": whole,
        "our plan from there, round it": plan(*ends, radius, obstacle),
    }
    for name in INTERPRETATIONS:
        path = shortest(*poses(case, name), radius)
        flown[f"{path.word}, printed points as poses, headings {name}"] = path
    found = {}
    for way, path in flown.items():
        kinks = np.rad2deg(np.abs(wrap(path.segments[1:, 2] - whole.segments[1, 2])))
        printed = kinks.tolist() if way in taut else []
        found[way] = path.length, path.distance(obstacle[:, :2])[0], printed
    return found


# --- estimation -----------------------------------------------------------------------------------


def controls(settings: Mapping[str, Any], kind: str) -> np.ndarray:
    """Thrust [N] and angle of attack [rad] of level flight ``(steps, 2)``; the angle may swing."""
    level, steps = trim(START[1], load("puna", PunaParameters)), settings["steps"]
    amplitude = np.deg2rad(settings["swing"]) if kind == "varying" else 0.0
    phase = 2.0 * np.pi * PLANE.dt * np.arange(steps) / settings["period"]
    return np.stack([np.full(steps, level.thrust), level.alpha + amplitude * np.sin(phase)], -1)


def flight(settings: Mapping[str, Any], level: str, control: str) -> Experiment:
    """A flight with a level of noise under one of the `CONTROLS`; every state is measured."""
    process, measurement = np.sqrt(np.outer(settings["levels"][level], settings["D"]))
    known, every = controls(settings, control), MEASURED["all"]
    return Experiment(PLANE.step, START, known, every, every, process, measurement, process, (0,))


def rms_errors(
    flown: Experiment, seen: list[int], members: int, runs: int, seed: int
) -> np.ndarray:
    """RMS errors of flights; truth and measurements depend neither on what is measured nor on N.

    The start is drawn as the members of eq. (24) are: from the initial guess with the noise of a
    step.

    Args:
        flown: The flight.
        seen: Indices of the states that the filter measures.
        members: N.
        runs: Flights.
        seed: Of truth, measurements and filters.

    Returns:
        RMSE ``(runs, 4)`` over the steps of a flight.
    """
    rng = np.random.default_rng(seed)
    start = START + flown.process_sd * rng.standard_normal((runs, len(START)))
    truth, measurements = replace(flown, start=start).simulate(runs, rng)
    assumed = replace(flown, measured=seen, measurement_sd=flown.measurement_sd[seen])
    measurements = np.ascontiguousarray(measurements[..., seen])
    means, _ = assumed.estimates(assumed.ensemble(members), measurements, seed)
    return rmse(means[1:], truth[1:], angles=(0,), axis=0)


# --- tables ---------------------------------------------------------------------------------------


Errors = Callable[[str, str, str, int], np.ndarray]
"""Errors ``(runs, 4)`` by noise level, control, measurements and members."""


def report(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Tables and measures."""
    sizes = settings["runs"], settings["seed"]

    @cache
    def found(level: str, control: str, measured: str, members: int) -> np.ndarray:
        return rms_errors(flight(settings, level, control), MEASURED[measured], members, *sizes)

    columns = {
        label: _comparisons(settings["printed"], found, *of)
        for label, *of in (
            ("noise of a flight", "flight", "all"),
            ("with x alone", "flight", "x"),
            ("noise of the printed sizes", "sizes", "all"),
        )
    }
    own: list[Any] = [("angle", "members", *with_units(QUANTITIES))]
    for control in CONTROLS:
        own += by_members(
            control, {n: found("flight", control, "all", n) for n in settings["members"]}
        )
        every, x = (np.log(found("flight", control, measured, 300)) for measured in MEASURED)
        gains = (text(geometric(each), 2) for each in (x - every).T)
        own.append((control, "300, x alone / every state", *gains))
    opened = open_case(settings["paths"])
    words: list[Any] = [("word", *(f"{interpretation} [m]" for interpretation in opened))]
    for word in WORDS:
        cells = (f"{of[word]:.1f}" if of[word] < np.inf else "–" for of in opened.values())
        words.append((word, *cells))
    ways: list[Any] = [("way", "length [m]", "passes the centre at [m]", "kinks [deg]")]
    for way, (length, clearance, kinks) in obstructed_case(settings["paths"]).items():
        places = " and ".join(f"{kink:.1f}" for kink in kinks) or "none"
        ways.append((way, f"{length:.3f}", f"{clearance:.2f}", places))
    published = comparison_table(columns)
    return {
        "tables": {"published": published, "own": own, "words": words, "obstacle": ways},
        "figures": [*_paths(settings["paths"]), *_flights(settings)],
        "rows": rows(settings["paper"], columns["noise of a flight"]),
    }


def _paths(paths: Mapping[str, Any]) -> list[Any]:
    """Figures 2 and 3."""
    open_path = shortest(*poses(paths["open"], "from the x axis"), paths["radius"])
    (x, y, radius), turn = paths["obstacle"], np.linspace(0.0, 2.0 * np.pi, 121)
    lines = {"obstacle": [x + radius * np.cos(turn), y + radius * np.sin(turn)]}
    ways = strings(paths) | {open_path.word: open_path}
    lines |= {word: [*path.sample(5.0).T[:2]] for word, path in ways.items()}
    alone = {open_path.word: lines.pop(open_path.word)}
    plane = {"x": "x [m]", "y": "y [m]", "equal": True}
    return [
        figure("2", "The path RSR without an obstacle.", plane | {"lines": alone}),
        figure(
            "3", "The path SRS round an obstacle, and the shorter SLS.", plane | {"lines": lines}
        ),
    ]


def _flights(settings: Mapping[str, Any]) -> list[Any]:
    """Both figures 4, a flight with each angle of attack."""
    found = []
    for control in CONTROLS:
        flown = flight(settings, "flight", control)
        members = settings["printed"][control]["members"]
        truth, measured = flown.simulate(1, np.random.default_rng(settings["seed"]))
        times = PLANE.dt * np.arange(len(truth))
        mean, sd = flown.estimates(flown.ensemble(members), measured)
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
