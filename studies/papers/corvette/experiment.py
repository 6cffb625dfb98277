"""Hermawan's five simulations: KF-UMV-UI follows a turning circle with an unknown input in the measurements."""

from collections.abc import Mapping
from itertools import product
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.jobs import Job
from vessel_gym.envs.thesis_corvette import THESIS_CORVETTE
from vessel_gym.tasks.turning_trial import SAMPLES, SWITCH
from vessel_gym.vehicles.corvette_thesis import NOISE, SIMULATIONS, A, B, Simulation

MODELS = ("as-printed", "corrected")
QUANTITIES = ("heading", "unknown input")
TRIAL: Any = THESIS_CORVETTE.task
PRIOR, RECORD = TRIAL.prior_variance, TRIAL.record[:SAMPLES, 2]
"""Variance of each state that the filter starts from; heading of our ship in the trial ``(195,)`` [rad]."""
RUDDER = np.deg2rad(35.0)
"""Constant rudder angle u [rad] of the thesis, Section 4.3.1."""
C, G, H = (
    np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]),
    np.array([[0.0], [0.0], [1.0]]),
    np.ones((2, 1)),
)
"""Matrices of the measurement and of d, eqs. 4.4 and 4.5."""


def jobs(settings: Mapping[str, Any]) -> dict[str, Job]:
    """A job for each simulation and filter model, and for a d that drives the heading."""
    here, found = __name__, {}
    trial = {key: settings[key] for key in ("seed", "runs")}
    for simulation, model in product(SIMULATIONS, MODELS):
        arguments = {"simulation": simulation, "model": model, **trial}
        found[f"{simulation}, {model}"] = Job(
            f"{here}:simulate", arguments, f"corvette, model {model}"
        )
    for simulation in ("I", "V"):
        found[f"driven, {simulation}"] = Job(
            f"{here}:driven", {"simulation": simulation, **trial}, "corvette, driven"
        )
    return found


# --- the experiment -------------------------------------------------------------------------------


def simulate(simulation: str, model: str, runs: int, seed: int) -> dict[str, Any]:
    """One of the five simulations with one filter model, as it was set up before the search: ``ThesisCorvette-v0``.

    Returns:
        ``rmse (2, runs)`` of updated heading and unknown input.
    """
    env = gym.make_vec(
        "ThesisCorvette-v0",
        runs,
        vectorization_mode="vector_entry_point",
        estimator_options={"model": model},
    )
    action = np.full((runs, 1), TRIAL.helm / TRIAL.ship.rudder_limit)
    infos = [env.reset(seed=seed, options={"simulation": simulation})[1]]
    infos += [env.step(action)[-1] for _ in range(SAMPLES - 1)]
    pairs = (("estimate", 2, "truth", 2), ("input_estimate", 0, "unknown_input", 0))
    errors = np.empty((2, runs, SAMPLES))
    for (k, info), (i, (estimated, a, true, b)) in product(enumerate(infos), enumerate(pairs)):
        errors[i, :, k] = info[estimated][:, a] - info[true][:, b]
    return {"rmse": rms(errors)}


def driven(simulation: str, runs: int, seed: int) -> dict[str, Any]:
    """``rmse (2, runs)`` of updated heading and d with eq. 4.3, where d drives the true heading, too (eq. 4.4)."""
    s = SIMULATIONS[simulation]
    d = np.where(np.arange(SAMPLES) < SWITCH, s.size, -s.size)
    heading = np.tile(RECORD + np.concatenate([[0.0], np.cumsum(d)[:-1]]), (runs, 1))
    noise = NOISE * np.random.default_rng(seed).standard_normal((runs, SAMPLES, 2))
    filter = recursion(s, "cited", "update", PRIOR)
    errors = respond(
        filter, "update", heading, measurements(heading, d, noise), np.zeros(3), RUDDER
    )[:2]
    return {"rmse": rms(errors - np.stack([0.0 * d, d])[:, None])}


def measurements(heading: np.ndarray, d: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Measurements ``(psi + d, d) + noise`` of eq. 4.5, ``(..., 2)`` [rad]."""
    return np.stack(np.broadcast_arrays(heading + d, d), -1) + noise


def rms(errors: np.ndarray) -> np.ndarray:
    """Root mean square over time, the last axis."""
    return np.sqrt(np.mean(errors**2, -1))


# --- one combination of choices -------------------------------------------------------------------


class Recursion(NamedTuple):
    """A filter as its gains: ``d = M e``, ``x = x- + L e``, ``x-+ = A x + B u + G d``."""

    L: list[np.ndarray]
    M: list[np.ndarray]


def recursion(simulation: Simulation, kind: str, first: str, prior: float) -> Recursion:
    """Gains of the filter of Gillijns and De Moor ("cited"), or of Table 2.5 to the letter ("as printed")."""
    q, r = simulation.Q * np.eye(3), simulation.R * np.eye(2)
    R_inverse, P, eye = np.eye(2) / simulation.R, prior * np.eye(3), np.eye(3)
    if first == "predict":
        P = A @ P @ A.T + q
    found = Recursion([], [])
    for _ in range(SAMPLES):
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + r)
        S = np.linalg.inv(H.T @ R_inverse @ (np.eye(2) - C @ K) @ H)
        M = S @ H.T @ R_inverse @ (np.eye(2) - C @ K)
        found.L.append(K @ (np.eye(2) - H @ M))
        found.M.append(M)
        updated = (eye + K @ H @ S @ H.T @ R_inverse @ C) @ (eye - K @ C) @ P
        cross = A @ (-K @ H @ S) @ G.T if kind == "cited" else A @ C.T @ R_inverse @ H @ G.T
        P = A @ updated @ A.T + cross + cross.T + G @ S @ G.T + q
        P = 0.5 * (P + P.T)
    return found


def respond(
    filter: Recursion,
    first: str,
    heading: np.ndarray,
    y: np.ndarray,
    start: np.ndarray,
    u: float = 0.0,
) -> np.ndarray:
    """Updated heading less ``heading (b, T)``, d, and predicted heading less heading, ``(3, b, T)``, for y and start.

    The last two arguments are the first estimate ``(b, 3)`` and the rudder angle.
    """
    x = np.broadcast_to(start, (len(y), 3))
    found = np.empty((3, *y.shape[:2]))
    if first == "predict":
        x = x @ A.T + B[:, 0] * u
    for k, (L, M) in enumerate(zip(filter.L, filter.M, strict=True)):
        innovation = y[:, k] - x @ C.T
        found[2, :, k] = x[:, 2] - heading[:, k]
        d = innovation @ M.T
        x = x + innovation @ L.T
        found[:2, :, k] = x[:, 2] - heading[:, k], d[:, 0]
        x = x @ A.T + B[:, 0] * u + d @ G.T
    return found


def record(choice: str, resolution: float) -> np.ndarray:
    """Heading ``(1, T)`` [rad], rounded to a resolution [deg]."""
    heading = RECORD if choice == "ship" else np.linspace(0.0, 2.0 * np.pi, SAMPLES)
    unit = np.deg2rad(resolution)
    return (unit * np.round(heading / unit) if unit else heading)[None]


def level(noise: str, R: float) -> tuple[str, float]:
    """Distribution and scale [rad] of the noise, from words such as "normal sqrt(R)"."""
    kind, _, text = noise.partition(" ")
    if kind == "none":
        return "normal", 0.0
    return kind, {"R": R, "sqrt(R)": np.sqrt(R)}.get(text) or float(text)


def explain(choices: Mapping[str, Any], runs: int, seed: int) -> dict[str, np.ndarray]:
    """RMSE ``(2, runs)`` of heading and d in each simulation under one combination of choices."""
    rng = np.random.default_rng(seed)
    drawn = {
        "normal": rng.standard_normal((runs, SAMPLES, 2)),
        "uniform": rng.random((runs, SAMPLES, 2)),
    }
    sd = (
        np.sqrt(choices["prior"])
        if choices["start_sd"] == "root of the prior"
        else float(choices["start_sd"])
    )
    start = sd * rng.standard_normal((runs, 3))
    heading = record(choices["record"], choices["resolution"])
    scored = 0 if choices["scored"] == "updated" else 2
    skipped = int(choices["scored"].endswith("from the second on"))
    found = {}
    for name, s in SIMULATIONS.items():
        height = s.size if name == "V" else choices["size"]
        d = height * np.where(np.arange(SAMPLES) < choices["switch"], 1.0, choices["after_switch"])
        kind, scale = level(choices["noise"], s.R)
        noise = scale * (drawn[kind][..., [0, 0]] if choices["same_noise"] else drawn[kind])
        filter = recursion(s, choices["recursion"], choices["first"], choices["prior"])
        errors = respond(
            filter, choices["first"], heading, measurements(heading, d, noise), start, RUDDER
        )
        found[name] = np.stack([rms(errors[scored][:, skipped:]), rms(errors[1] - d)])
    return found
