"""Hermawan's five simulations: KF-UMV-UI follows a turning circle with an unknown input in the measurements."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.jobs import Job
from studies.papers.likelihood import log_likelihood
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
C, G, H = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.array([[0.0], [0.0], [1.0]]), np.ones((2, 1))
"""Matrices of the measurement and of d, eqs. 4.4 and 4.5."""


def jobs(settings: Mapping[str, Any]) -> dict[str, Job]:
    """A job for each simulation and filter model, and the search by recursion and discrepancy."""
    here, found = __name__, {}
    trial = {key: settings[key] for key in ("seed", "runs")}
    for simulation, model in product(SIMULATIONS, MODELS):
        arguments = {"simulation": simulation, "model": model, **trial}
        found[f"{simulation}, {model}"] = Job(f"{here}:simulate", arguments, f"corvette, model {model}")
    for simulation in ("I", "V"):
        found[f"driven, {simulation}"] = Job(f"{here}:driven", {"simulation": simulation, **trial}, "corvette, driven")
    tried = {name: choice["tried"] for name, choice in settings["open"].items()}
    search = {key: settings[key] for key in ("seed", "printed")}
    for recursion, discrepancy in product(tried["recursion"], settings["discrepancies"]):
        arguments = search | {"tried": tried | {"recursion": [recursion]}, "discrepancy": discrepancy}
        arguments["runs"] = settings["samples_of_search"]
        found[f"search, {recursion}, {discrepancy}"] = Job(f"{here}:search", arguments, "corvette, search")
    return found


# --- the experiment ---------------------------------------------------------------------------------


def simulate(simulation: str, model: str, runs: int, seed: int) -> dict[str, Any]:
    """One of the five simulations with one filter model, as it was set up before the search: ``ThesisCorvette-v0``.

    Returns:
        ``rmse (2, runs)`` of updated heading and unknown input; ``example``: errors of the first run ``(2, T)``.
    """
    env = gym.make_vec(
        "ThesisCorvette-v0", runs, vectorization_mode="vector_entry_point", estimator_options={"model": model}
    )
    action = np.full((runs, 1), TRIAL.helm / TRIAL.ship.rudder_limit)
    infos = [env.reset(seed=seed, options={"simulation": simulation})[1]]
    infos += [env.step(action)[-1] for _ in range(SAMPLES - 1)]
    pairs = (("estimate", 2, "truth", 2), ("input_estimate", 0, "unknown_input", 0))
    errors, truths = np.empty((2, runs, SAMPLES)), np.empty((2, SAMPLES))
    for (k, info), (i, (estimated, a, true, b)) in product(enumerate(infos), enumerate(pairs)):
        errors[i, :, k], truths[i, k] = info[estimated][:, a] - info[true][:, b], info[true][0, b]
    example = dict(zip(QUANTITIES, truths, strict=True)) | {"errors": errors[:, 0]}
    return {"rmse": rms(errors), "example": example}


def driven(simulation: str, runs: int, seed: int) -> dict[str, Any]:
    """``rmse (2, runs)`` of updated heading and d with eq. 4.3, where d drives the true heading, too (eq. 4.4)."""
    s = SIMULATIONS[simulation]
    d = np.where(np.arange(SAMPLES) < SWITCH, s.size, -s.size)
    heading = np.tile(RECORD + np.concatenate([[0.0], np.cumsum(d)[:-1]]), (runs, 1))
    noise = NOISE * np.random.default_rng(seed).standard_normal((runs, SAMPLES, 2))
    filter = recursion(s, "cited", "update", PRIOR)
    errors = respond(filter, "update", heading, measurements(heading, d, noise), np.zeros(3), RUDDER)[:2]
    return {"rmse": rms(errors - np.stack([0.0 * d, d])[:, None])}


def measurements(heading: np.ndarray, d: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Measurements ``(psi + d, d) + noise`` of eq. 4.5, ``(..., 2)`` [rad]."""
    return np.stack(np.broadcast_arrays(heading + d, d), -1) + noise


def rms(errors: np.ndarray) -> np.ndarray:
    """Root mean square over time, the last axis."""
    return np.sqrt(np.mean(errors**2, -1))


# --- the search -------------------------------------------------------------------------------------
# The filter is linear and its gains do not depend on the measurements: its errors are sums of responses to the record,
# to d, to the noise and to the error of the first estimate. So each response is computed once for all combinations.


class Recursion(NamedTuple):
    """A filter as its gains: ``d = M e``, ``x = x- + L e``, ``x-+ = A x + B u + E d``."""

    L: list[np.ndarray]
    M: list[np.ndarray]
    E: np.ndarray
    u: float


def recursion(simulation: Simulation, kind: str, first: str, prior: float) -> Recursion:
    """Gains of the filter of Gillijns and De Moor ("cited"), or of Table 2.5 to the letter ("as printed").

    Table 2.5 calls the matrix of d both E and B: "as printed, the rudder's B" takes it for that of the rudder, which is
    what its prediction then leaves out.
    """
    q, r = simulation.Q * np.eye(3), simulation.R * np.eye(2)
    R_inverse, P, eye = np.eye(2) / simulation.R, prior * np.eye(3), np.eye(3)
    rudder = kind.endswith("the rudder's B")
    E = B if rudder else G
    if first == "predict":
        P = A @ P @ A.T + q
    found = Recursion([], [], E, 0.0 if rudder else RUDDER)
    for _ in range(SAMPLES):
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + r)
        S = np.linalg.inv(H.T @ R_inverse @ (np.eye(2) - C @ K) @ H)
        M = S @ H.T @ R_inverse @ (np.eye(2) - C @ K)
        found.L.append(K @ (np.eye(2) - H @ M))
        found.M.append(M)
        updated = (eye + K @ H @ S @ H.T @ R_inverse @ C) @ (eye - K @ C) @ P
        cross = A @ (-K @ H @ S) @ E.T if kind == "cited" else A @ C.T @ R_inverse @ H @ E.T
        P = A @ updated @ A.T + cross + cross.T + E @ S @ E.T + q
        P = 0.5 * (P + P.T)
    return found


def respond(
    filter: Recursion, first: str, heading: np.ndarray, y: np.ndarray, start: np.ndarray, u: float = 0.0
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
        x = x @ A.T + B[:, 0] * u + d @ filter.E.T
    return found


class Parts(NamedTuple):
    """Responses of a filter ``(3, ..., T)``: to records, to steps d of unit height, to noise by kind, to the start."""

    record: np.ndarray
    step: np.ndarray
    noise: dict[tuple[str, bool], np.ndarray]
    start: np.ndarray


def parts(filter: Recursion, first: str, records: np.ndarray, steps: np.ndarray, runs: int, seed: int) -> Parts:
    """The responses of a filter to records and steps ``(..., T)`` and to that many draws of noise and start."""
    rng = np.random.default_rng(seed)
    still, none = np.zeros((1, SAMPLES)), np.zeros(3)
    drawn = {"normal": rng.standard_normal((runs, SAMPLES, 2)), "uniform": rng.random((runs, SAMPLES, 2))}
    noise = {}
    for (kind, each), same in product(drawn.items(), (False, True)):
        v = each[..., [0, 0]] if same else each
        noise[kind, same] = respond(filter, first, np.broadcast_to(still, v.shape[:2]), v, none)
    start = rng.standard_normal((runs, 3))
    flat, d = records.reshape(-1, SAMPLES), steps.reshape(-1, SAMPLES)
    zeros = np.zeros((runs, SAMPLES))
    record = respond(filter, first, flat, measurements(flat, 0.0 * flat, np.zeros(2)), none, filter.u)
    step = respond(filter, first, 0.0 * d, measurements(0.0 * d, d, np.zeros(2)), none)
    step[1] -= d
    return Parts(
        record.reshape(3, *records.shape), step.reshape(3, *steps.shape), noise,
        respond(filter, first, zeros, np.zeros((runs, SAMPLES, 2)), start),
    )  # fmt: skip


def records(tried: Mapping[str, Sequence[Any]]) -> np.ndarray:
    """Headings ``(records, resolutions, T)`` [rad]."""
    headings = {"ship": RECORD, "uniform turn": np.linspace(0.0, 2.0 * np.pi, SAMPLES)}
    units = np.deg2rad(tried["resolution"])
    return np.array([
        [headings[name] if unit == 0.0 else unit * np.round(headings[name] / unit) for unit in units]
        for name in tried["record"]
    ])  # fmt: skip


def steps(tried: Mapping[str, Sequence[Any]]) -> np.ndarray:
    """Unknown inputs ``(switches, values after them, T)`` of height 1."""
    k = np.arange(SAMPLES)
    return np.array(
        [[np.where(k < switch, 1.0, after) for after in tried["after_switch"]] for switch in tried["switch"]]
    )


def level(noise: str, R: float) -> tuple[str, float]:
    """Distribution and scale [rad] of the noise, from words such as "normal sqrt(R)"."""
    kind, _, text = noise.partition(" ")
    if kind == "none":
        return "normal", 0.0
    return kind, {"R": R, "sqrt(R)": np.sqrt(R)}.get(text) or float(text)


def start_sd(words: str, prior: float) -> float:
    """Standard deviation of the error of the first estimate."""
    return np.sqrt(prior) if words == "root of the prior" else float(words)


def log_errors(
    tried: Mapping[str, Sequence[Any]], simulation: str, found: Parts, prior: float
) -> Iterator[tuple[int, int, np.ndarray]]:
    """Logarithms of RMSE by what is scored (-1: d, else the index of "scored"), axes as the rest of the choices.

    Yields:
        Both indices, and the array ``(starts, records, resolutions, switches, afters, sizes, noises, same, runs)``.
    """
    s = SIMULATIONS[simulation]
    sizes = [s.size] if simulation == "V" else tried["size"]
    scores = [(-1, 1, 0)]
    for i, scored in enumerate(tried["scored"]):
        scores.append((i, 0 if scored == "updated" else 2, int(scored.endswith("from the second on"))))
    for index, what, skipped in scores:
        heights = np.array(sizes)[:, None]
        fixed = (found.record[what][:, :, None, None, None] + heights * found.step[what][:, :, None])[..., skipped:]
        shape, flat = fixed.shape[:-1], fixed.reshape(-1, fixed.shape[-1])
        columns = []
        for start, noise, same in product(tried["start_sd"], tried["noise"], tried["same_noise"]):
            kind, scale = level(noise, s.R)
            random = scale * found.noise[kind, same][what] + start_sd(start, prior) * found.start[what]
            random = random[:, skipped:]
            squares = (flat**2).sum(-1)[:, None] + 2.0 * flat @ random.T + (random**2).sum(-1)
            columns.append(0.5 * np.log(np.maximum(squares, 1e-30) / flat.shape[-1]))
        errors = np.stack(columns, -2).reshape(
            *shape, *(len(tried[n]) for n in ("start_sd", "noise", "same_noise")), -1
        )
        yield index, what, np.moveaxis(errors, 5, 0)


def search(
    tried: Mapping[str, Sequence[Any]], printed: Mapping[str, Mapping[str, Any]], discrepancy: float, runs: int,
    seed: int,
) -> dict[str, Any]:  # fmt: skip
    """``log_likelihood`` of Tables 4.4 to 4.8 under every combination of what is tried, an axis a choice."""
    shape = [len(alternatives) for alternatives in tried.values()]
    total = np.zeros(shape)
    grid, inputs = records(tried), steps(tried)
    for i, j, k in np.ndindex(*shape[1:4]):
        kind, first, prior = tried["recursion"][i], tried["first"][j], tried["prior"][k]
        made: dict[tuple[float, float], Parts] = {}
        for name, s in SIMULATIONS.items():
            with np.errstate(all="ignore"):  # the printed recursion may diverge: its likelihood is then nothing
                if (s.Q, s.R) not in made:
                    made[s.Q, s.R] = parts(recursion(s, kind, first, prior), first, grid, inputs, runs, seed)
                for scored, what, errors in log_errors(tried, name, made[s.Q, s.R], prior):
                    texts = printed[name]["unknown_input" if what == 1 else "heading"]
                    found = log_likelihood(texts, errors.mean(-1), errors.std(-1, ddof=1), discrepancy)
                    total[slice(None) if scored < 0 else scored, i, j, k] += found
    return {"log_likelihood": np.round(total, 3)}


def explain(combination: Mapping[str, Any], runs: int, seed: int) -> dict[str, np.ndarray]:
    """RMSE ``(2, runs)`` of heading and d in each simulation under one combination."""
    tried = {name: [alternative] for name, alternative in combination.items()}
    found = {}
    for name, s in SIMULATIONS.items():
        filter = recursion(s, combination["recursion"], combination["first"], combination["prior"])
        made = parts(filter, combination["first"], records(tried), steps(tried), runs, seed)
        by_score = {
            scored: np.exp(errors.ravel()) for scored, _, errors in log_errors(tried, name, made, combination["prior"])
        }
        found[name] = np.stack([by_score[0], by_score[-1]])
    return found
