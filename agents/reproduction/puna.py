"""The PUNA paper: its two Dubins cases, and the ensemble Kalman filter on its model of the vertical plane.

Poses are (x, y, theta) [m, m, rad], theta from +x towards +y; states are (gamma, v, x, h) [rad, m/s, m, m].
"""

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np

from agents.cells import Cell
from agents.reproduction.planar_puna import MISSILE, PlanarPuna, planar_derivative
from agents.reproduction.settings import puna as paper
from estimators import Filter, Gaussian, make, rmse, wrap
from vessel_gym.guidance.dubins import WORDS, Path, approach, candidates, lengths, plan, shortest, word_path
from vessel_gym.guidance.words import chain
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.puna import PunaParameters, trim

PLANE = PlanarPuna()


def cells() -> dict[str, Cell]:
    """Everything to compute, by name."""
    here = __name__
    found = {
        "open": Cell(f"{here}:open_case", {}, "PUNA, path without obstacle"),
        "obstructed": Cell(f"{here}:obstacle_case", {}, "PUNA, path with an obstacle"),
        "aircraft": Cell(f"{here}:aircraft", {}, "PUNA, the model"),
    }
    sampled = {"runs": paper.RUNS, "seed": paper.SEED}
    for level in paper.LEVELS:
        for control in paper.CONTROLS:
            for measured in paper.MEASURED:
                case: dict[str, Any] = {
                    "level": level,
                    "control": control,
                    "measured": measured,
                    "members": list(paper.MEMBERS),
                }
                label = f"PUNA, {level}, {control} angle, {measured}"
                found[cell_name(level, control, measured)] = Cell(f"{here}:estimate", case | sampled, label)
        scales = [*paper.SCALES, partner(level, 0.01)] if level == "sizes" else paper.SCALES
        case = {"level": level, "scales": [list(scale) for scale in scales], "members": 100}
        found[f"{level}, scaled"] = Cell(f"{here}:scaled", case | sampled, f"PUNA, {level}, Q and R scaled")
    timed = {"members": list(paper.MEMBERS), "repetitions": 15, "seed": paper.SEED}
    found["time"] = Cell(f"{here}:computing_time", timed, "PUNA, computing time")
    return found


def cell_name(level: str, control: str, measured: str) -> str:
    """The name of the cell of a noise level, a control and a set of measurements."""
    return f"{level}, {control}, {measured}"


# --- paths ------------------------------------------------------------------------------------------


def pose(point: Sequence[float], heading: float, reading: str) -> np.ndarray:
    """The pose ``(3,)`` of a printed point and heading, the latter under one of the `READINGS`."""
    offset, sign = paper.READINGS[reading]
    return np.array([*point, offset + sign * heading])


def poses(case: paper.OpenCase | paper.ObstacleCase, reading: str) -> tuple[np.ndarray, np.ndarray]:
    """Start and goal of a printed case under a reading of its headings."""
    return pose(case.start, case.headings[0], reading), pose(case.goal, case.headings[1], reading)


def string(start: Sequence[float], goal: Sequence[float], obstacle: Sequence[float], turn: str) -> Path:
    """The taut string from a point to a point round a circular obstacle: straight, arc, straight.

    Args:
        start: x, y [m].
        goal: x, y [m].
        obstacle: x, y, radius [m].
        turn: ``"L"`` or ``"R"``, the way that the arc turns.
    """
    side = {"L": 1.0, "R": -1.0}[turn]
    centre, radius = np.array(obstacle[:2]), obstacle[2]
    before, after = centre - start, np.array(goal) - centre
    headings = [
        np.arctan2(before[1], before[0]) - side * np.arcsin(radius / np.hypot(*before)),
        np.arctan2(after[1], after[0]) + side * np.arcsin(radius / np.hypot(*after)),
    ]
    arc = radius * (side * (headings[1] - headings[0]) % (2.0 * np.pi))
    straights = [np.sqrt(way @ way - radius**2) for way in (before, after)]
    return chain(
        np.array([*start, headings[0]]),
        np.array([0.0, side / radius, 0.0]),
        np.array([straights[0], arc, straights[1]]),
    )


def bank(radius: float) -> float:
    """Bank [rad] of a level turn of a radius [m] at the printed airspeed."""
    return float(np.arctan(paper.SPEED**2 / (PLANE.body.gravity * radius)))


def final_y(start_y: float, heading: float) -> float:
    """The paper's y of the goal [m], which it "obtains": no formula is printed, this one gives both of its values."""
    return start_y + 2.0 * paper.RADIUS * (1.0 - np.sin(heading))


def open_case() -> dict[str, Any]:
    """The case without an obstacle: every word's length and track under every reading, and the paper's minimum."""
    from scipy.optimize import minimize_scalar

    case, radius = paper.OPEN, paper.RADIUS
    by_reading = {reading: poses(case, reading) for reading in paper.READINGS}
    start, goal = by_reading["from the y axis, clockwise"]

    def rsl(y: float) -> float:
        return float(lengths(start, np.array([goal[0], y, goal[2]]), radius)[WORDS.index("RSL")])

    least = minimize_scalar(rsl, bounds=(0.0, 500.0), method="bounded", options={"xatol": 1e-6})
    x, chi = case.start[0], case.headings[0]
    return {
        "lengths": {reading: candidates(*ends, radius) for reading, ends in by_reading.items()},
        "tracks": {
            reading: {word: _track(word_path(*ends, radius, word)) for word in candidates(*ends, radius)}
            for reading, ends in by_reading.items()
        },
        "poses": {reading: np.array(ends) for reading, ends in by_reading.items()},
        "final y": final_y(case.start[1], chi),
        "least RSL": {"y": least.x, "length": least.fun},
        "equation 16": {
            "first line": (x + radius * np.sin(chi) + radius) + (np.pi / 2 - chi) * radius + np.pi / (2.0 * radius),
            "second line": -x - radius * np.sin(chi) - radius + (np.pi - chi) * radius,
        },
        "bank": bank(radius),
    }


def obstacle_case() -> dict[str, Any]:
    """The case with an obstacle: the path whose tangent points the paper prints, the strings, and a path to fly."""
    case, radius = paper.OBSTRUCTED, paper.RADIUS
    obstacle = np.array([case.obstacle])
    start = pose(paper.OPEN.start, case.headings[0], "from the x axis")
    height = final_y(paper.OPEN.start[1], case.headings[0])
    goal = pose((paper.OPEN.goal[0], height), case.headings[1], "from the x axis")
    whole = shortest(start, goal, radius)
    detour = plan(start, goal, radius, obstacle)
    strings = {f"S{turn}S": string(case.start, case.goal, case.obstacle, turn) for turn in "RL"}
    turned = {word: path.segments[[0, -1], 2] - whole.segments[1, 2] for word, path in strings.items()}
    printed = {reading: shortest(*poses(case, reading), radius) for reading in paper.READINGS}
    return {
        "poses": np.array([start, goal]),
        "word": whole.word,
        "length": whole.length,
        "tangent points": whole.segments[1:, :2],
        "clearance": approach(whole, obstacle[:, :2])[0],
        "strings": {word: path.length for word, path in strings.items()},
        "kinks": {word: np.abs(wrap(kinks)) for word, kinks in turned.items()},
        "detour": detour.length,
        "as poses": {
            reading: {"word": path.word, "length": path.length, "clearance": approach(path, obstacle[:, :2])[0]}
            for reading, path in printed.items()
        },
        "bank": bank(case.obstacle[2]),
        "tracks": {"whole": _track(whole), "detour": _track(detour)}
        | {word: _track(path) for word, path in strings.items()},
    }


def _track(path: Path) -> np.ndarray:
    return path.sample(path.length / 200.0)[:, :2]


# --- estimation -------------------------------------------------------------------------------------


def controls(kind: str) -> np.ndarray:
    """Thrust [N] and angle of attack [rad] of every step ``(STEPS, 2)``: level flight's, the angle perhaps swinging."""
    level = trim(paper.SPEED, load("puna", PunaParameters))
    swing = paper.SWING if kind == "varying" else 0.0
    time = PLANE.dt * np.arange(paper.STEPS)
    alpha = level.alpha + swing * np.sin(2.0 * np.pi * time / paper.PERIOD)
    return np.stack([np.full(paper.STEPS, level.thrust), alpha], -1)


def flights(
    u: np.ndarray, process: np.ndarray, reading: np.ndarray, runs: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """True states and readings of all of them, ``(STEPS, runs, 4)`` each, from the first step on.

    The start is drawn as the members of eq. (24) are: from the initial guess with the noise of a step.

    Args:
        u: ``(STEPS, 2)`` controls.
        process: ``(4,)`` variances of what enters in a step.
        reading: ``(4,)`` variances of the readings.
        runs: How many flights.
        seed: Of all of them.
    """
    rng = np.random.default_rng(seed)
    shocks = np.sqrt(process) * rng.standard_normal((1 + len(u), runs, 4))
    state, states = paper.START + shocks[0], np.empty((len(u), runs, 4))
    for k, control in enumerate(u):
        state = states[k] = PLANE.step(state, control) + shocks[k + 1]
    return states, states + np.sqrt(reading) * rng.standard_normal(states.shape)


def ensemble_filter(measured: str, process: np.ndarray, reading: np.ndarray, members: int) -> Filter:
    """The paper's filter on its model, with one of its two sets of measurements; variances as in `flights`."""
    seen = [2] if measured == "x" else [0, 1, 2, 3]
    return make("enkf", PLANE.model(measured, np.diag(process), np.diag(reading[seen])), members=members)


def believed(
    enkf: Filter, u: np.ndarray, process: np.ndarray, readings: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Estimates ``(STEPS, runs, 4)`` of a filter along readings of the same shape; the prior is that of eq. (24)."""
    start = np.broadcast_to(paper.START, readings.shape[1:])
    belief = enkf.init(Gaussian(start, np.diag(process)), rng=rng)
    means = np.empty(readings.shape)
    for k, control in enumerate(u):
        belief = enkf.predict(belief, control, rng=rng)
        belief = enkf.update(belief, enkf.model.measurement(readings[k], control), rng=rng)
        means[k] = belief.mean
    return means


def estimate(level: str, control: str, measured: str, members: list[int], runs: int, seed: int) -> dict[str, Any]:
    """RMS errors of flights with ensembles of several sizes; the flights are the same for all sizes and measurements.

    Returns:
        ``rmse`` ``(sizes, runs, 4)`` over the steps of a flight; ``slowest`` ``(runs,)`` true airspeed of each flight;
        ``truth`` and ``estimate`` ``(STEPS, 4)`` of the first flight, with as many members as the paper had.
    """
    process, reading = _variances(level)
    u = controls(control)
    truth, readings = flights(u, process, reading, runs, seed)
    errors, example = [], np.empty(0)
    for size in members:
        enkf = ensemble_filter(measured, process, reading, size)
        means = believed(enkf, u, process, readings, np.random.default_rng([seed, size]))
        errors.append(rmse(means, truth, angles=(0,), axis=0))
        if size == paper.PRINTED_MEMBERS[control]:
            example = means[:, 0]
    return {
        "rmse": np.array(errors), "slowest": truth[:, :, 1].min(0), "truth": truth[:, 0], "estimate": example,
    }  # fmt: skip


def scaled(level: str, scales: list[list[float]], members: int, runs: int, seed: int) -> dict[str, Any]:
    """RMS errors ``(scales, runs, 4)`` with factors on Q and R, every state measured, the angle of attack constant."""
    u, errors = controls("constant"), []
    for factors in scales:
        process, reading = (factor * v for factor, v in zip(factors, _variances(level), strict=True))
        truth, readings = flights(u, process, reading, runs, seed)
        enkf = ensemble_filter("all", process, reading, members)
        means = believed(enkf, u, process, readings, np.random.default_rng([seed, members]))
        errors.append(rmse(means, truth, angles=(0,), axis=0))
    return {"scales": scales, "rmse": np.array(errors)}


def computing_time(members: list[int], repetitions: int, seed: int) -> dict[str, Any]:
    """Seconds ``(repetitions, sizes)`` that one flight's estimation takes, every state measured; measured, not drawn.

    The sizes take turns, so that what else the machine does falls on all of them.
    """
    process, reading = _variances("flight")
    u = controls("constant")
    _, readings = flights(u, process, reading, 1, seed)
    filters = [ensemble_filter("all", process, reading, size) for size in members]
    seconds = np.empty((repetitions + 1, len(members)))
    for row in seconds:
        for i, enkf in enumerate(filters):
            begin = perf_counter()
            believed(enkf, u, process, readings, np.random.default_rng(seed))
            row[i] = perf_counter() - begin
    return {"seconds": seconds[1:]}  # the first round warms up


def partner(level: str, factor: float) -> tuple[float, float]:
    """Factors on Q and R, the first given, that leave the variance of a random walk after its readings as it is."""
    q, r = paper.LEVELS[level].process, paper.LEVELS[level].reading
    variance = 0.5 * (np.sqrt(q * q + 4.0 * q * r) - q)
    return factor, variance * (variance + factor * q) / (factor * q) / r


def aircraft() -> dict[str, Any]:
    """What the printed equations mean at the printed airspeed."""
    body, level = PLANE.body, trim(paper.SPEED, load("puna", PunaParameters))
    pressure = 0.5 * MISSILE.density[2] * paper.SPEED**2 * MISSILE.area
    state, u = np.array([0.0, paper.SPEED, 0.0, 0.0]), np.array([level.thrust, level.alpha])
    return {
        "alpha": level.alpha,
        "thrust": level.thrust,
        "missile lift coefficient": MISSILE.mass * MISSILE.gravity / pressure,
        "braking": planar_derivative(state, u, body.vector())[1],
    }


def _variances(level: str) -> tuple[np.ndarray, np.ndarray]:
    chosen = paper.LEVELS[level]
    return chosen.process * paper.SIZES, chosen.reading * paper.SIZES
