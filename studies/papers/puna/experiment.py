"""The PUNA paper: its two Dubins cases, and the ensemble Kalman filter on its model of the vertical plane.

Poses are (x, y, theta) [m, m, rad], theta from +x towards +y; states are (gamma, v, x, h) [rad,
m/s, m, m].
"""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from agents.jobs import Job
from estimators import Filter, Gaussian, make, rmse, wrap
from studies.papers.puna.model import SEEN, PlanarPuna
from vessel_gym.guidance.dubins import WORDS, Path, approach, candidates, lengths, plan, shortest
from vessel_gym.guidance.words import chain
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.puna import PunaParameters, trim

PLANE = PlanarPuna()
QUANTITIES = {"γ": "rad", "v": "m/s", "x": "m", "h": "m"}
MEASURED = {"all": "every state", "x": "x alone"}
CONTROLS = ("constant", "varying")
INTERPRETATIONS = {
    "from the x axis": (0.0, 1.0),
    "from the y axis, clockwise": (np.pi / 2, -1.0),
    "from the y axis, counter-clockwise": (np.pi / 2, 1.0),
}
"""Interpretations of a printed heading chi: theta = offset + sign chi. The paper says "to the y axis" (sec. II d)."""
START = np.array([0.0, 20.0, 0.0, 100.0])
"""Level, at the speed and the first altitude of the Dubins cases; no initial state is printed."""


def jobs(settings: Mapping[str, Any]) -> dict[str, Job]:
    """Everything to compute, by name."""
    here, found = __name__, {}
    for name, function in (("open", "open_case"), ("obstructed", "obstacle_case")):
        found[name] = Job(f"{here}:{function}", {"paths": settings["paths"]}, "PUNA, paths")
    flight = {key: settings[key] for key in ("seed", "steps", "swing", "period")}
    D = np.array(settings["D"])

    sizes = {key: settings[key] for key in ("members", "runs")}
    for (level, (q, r)), control, measured in product(
        settings["levels"].items(), CONTROLS, MEASURED
    ):
        noise = {"process": list(q * D), "measurement": list(r * D)}
        arguments = {"control": control, "measured": measured} | sizes | noise | flight
        name = f"{level}, {control}, {measured}"
        found[name] = Job(f"{here}:estimate", arguments, f"PUNA, {control} angle, {measured}")
    return found


# --- paths ----------------------------------------------------------------------------------------


def poses(case: Mapping[str, Any], interpretation: str) -> tuple[np.ndarray, np.ndarray]:
    """Start and goal ``(3,)`` of a printed case, its headings interpreted in one of the `INTERPRETATIONS`."""
    offset, sign = INTERPRETATIONS[interpretation]
    start, goal = (
        np.array([*case[end], offset + sign * np.deg2rad(heading)])
        for end, heading in zip(("start", "goal"), case["headings"], strict=True)
    )
    return start, goal


def string(
    start: Sequence[float], goal: Sequence[float], obstacle: Sequence[float], turn: str
) -> Path:
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
    curvatures = np.array([0.0, side / radius, 0.0])
    return chain(
        np.array([*start, headings[0]]), curvatures, np.array([straights[0], arc, straights[1]])
    )


def bank(speed: float, radius: float) -> float:
    """Bank [deg] of a level turn of a radius [m] at an airspeed [m/s]."""
    return float(np.rad2deg(np.arctan(speed**2 / (PLANE.body.gravity * radius))))


def final_y(start_y: float, heading: float, radius: float) -> float:
    """The paper's y of the goal [m], which it "obtains": no formula is printed, this one gives both of its values."""
    return start_y + 2.0 * radius * (1.0 - np.sin(heading))


def open_case(paths: Mapping[str, Any]) -> dict[str, Any]:
    """The case without an obstacle: each word's length by interpretation, and the paper's minimum."""
    from scipy.optimize import minimize_scalar

    case, radius = paths["open"], paths["radius"]
    by_interpretation = {
        interpretation: poses(case, interpretation) for interpretation in INTERPRETATIONS
    }
    start, goal = by_interpretation["from the y axis, clockwise"]

    def rsl(y: float) -> float:
        return float(lengths(start, np.array([goal[0], y, goal[2]]), radius)[WORDS.index("RSL")])

    least = minimize_scalar(rsl, bounds=(0.0, 500.0), method="bounded", options={"xatol": 1e-6})
    return {
        "lengths": {
            interpretation: candidates(*ends, radius)
            for interpretation, ends in by_interpretation.items()
        },
        "final y": final_y(case["start"][1], np.deg2rad(case["headings"][0]), radius),
        "least RSL": {"y": least.x, "length": least.fun},
    }


def obstacle_case(paths: Mapping[str, Any]) -> dict[str, Any]:
    """The case with an obstacle: the path whose tangent points the paper prints, the strings, and a path to fly."""
    case, radius, obstacle = paths["obstructed"], paths["radius"], np.array([paths["obstacle"]])
    heading = np.deg2rad(case["headings"][0])
    start = np.array([*paths["open"]["start"], heading])
    goal = np.array([paths["open"]["goal"][0], final_y(start[1], heading, radius), 0.0])
    whole, detour = shortest(start, goal, radius), plan(start, goal, radius, obstacle)
    strings = {
        f"S{turn}S": string(case["start"], case["goal"], paths["obstacle"], turn) for turn in "RL"
    }
    kinks = {
        word: path.segments[[0, -1], 2] - whole.segments[1, 2] for word, path in strings.items()
    }
    posed = {
        interpretation: shortest(*poses(case, interpretation), radius)
        for interpretation in INTERPRETATIONS
    }
    return {
        "goal y": goal[1],
        "word": whole.word,
        "length": whole.length,
        "tangent points": whole.segments[1:, :2],
        "clearance": approach(whole, obstacle[:, :2])[0],
        "strings": {word: path.length for word, path in strings.items()},
        "kinks": {word: np.rad2deg(np.abs(wrap(each))) for word, each in kinks.items()},
        "detour": detour.length,
        "as poses": {
            interpretation: {
                "word": path.word,
                "length": path.length,
                "clearance": approach(path, obstacle[:, :2])[0],
            }
            for interpretation, path in posed.items()
        },
        "bank": bank(paths["speed"], paths["obstacle"][2]),
    }


# --- estimation -----------------------------------------------------------------------------------


def controls(kind: str, steps: int, swing: float, period: float) -> np.ndarray:
    """Thrust [N] and angle of attack [rad] of every step ``(steps, 2)``: level flight's, the angle perhaps swinging."""
    level = trim(START[1], load("puna", PunaParameters))
    amplitude = np.deg2rad(swing) if kind == "varying" else 0.0
    alpha = level.alpha + amplitude * np.sin(2.0 * np.pi * PLANE.dt * np.arange(steps) / period)
    return np.stack([np.full(steps, level.thrust), alpha], -1)


def flights(
    u: np.ndarray, process: np.ndarray, measurement: np.ndarray, runs: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """True states and measurements of all of them, ``(steps, runs, 4)`` each, from the first step on.

    The start is drawn as the members of eq. (24) are: from the initial guess with the noise of a
    step.

    Args:
        u: ``(steps, 2)`` controls.
        process: ``(4,)`` variances of the process noise of a step.
        measurement: ``(4,)`` variances of the measurements.
        runs: How many flights.
        seed: Of all of them.
    """
    rng = np.random.default_rng(seed)
    noise = np.sqrt(process) * rng.standard_normal((1 + len(u), runs, 4))
    state, states = START + noise[0], np.empty((len(u), runs, 4))
    for k, control in enumerate(u):
        state = states[k] = PLANE.step(state, control) + noise[k + 1]
    return states, states + np.sqrt(measurement) * rng.standard_normal(states.shape)


def estimates(
    enkf: Filter,
    u: np.ndarray,
    process: np.ndarray,
    measurements: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Estimates ``(steps, runs, 4)`` from measurements of the same shape; the prior is that of eq. (24)."""
    belief = enkf.init(
        Gaussian(np.broadcast_to(START, measurements.shape[1:]), np.diag(process)), rng=rng
    )
    means = np.empty(measurements.shape)
    for k, control in enumerate(u):
        belief = enkf.predict(belief, control, rng=rng)
        belief = enkf.update(belief, enkf.model.measurement(measurements[k], control), rng=rng)
        means[k] = belief.mean
    return means


def estimate(
    control: str, measured: str, members: list[int], process: list[float], measurement: list[float], runs: int,
    seed: int, steps: int, swing: float, period: float,
) -> dict[str, Any]:  # fmt: skip
    """RMS errors of flights with ensembles of several sizes; the flights are the same for all sizes and measurements.

    Returns:
        ``rmse (sizes, runs, 4)`` over the steps of a flight; ``slowest (runs,)`` true airspeed of
        each flight.
    """
    Q, R = np.array(process), np.array(measurement)
    u = controls(control, steps, swing, period)
    truth, measurements = flights(u, Q, R, runs, seed)
    model, errors = PLANE.model(measured, np.diag(Q), np.diag(R[SEEN[measured]])), []
    for size in members:
        enkf = make("enkf", model, members=size, draws="independent")
        means = estimates(enkf, u, Q, measurements, np.random.default_rng([seed, size]))
        errors.append(rmse(means, truth, angles=(0,), axis=0))
    return {"rmse": np.array(errors), "slowest": truth[:, :, 1].min(0)}
