"""Segorogeni's dive in three dimensions with ensembles of 50 to 300 members, after the EnKF paper."""

from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import root

from agents.cells import Cell
from agents.reproduction.ensembles import Experiment, rms, seconds_a_step, thinned
from agents.reproduction.settings import segorogeni as paper
from estimators import Filter, make
from vessel_gym.vehicles.segorogeni import STATE, segorogeni_rates

_ESTIMATED = [STATE.index(name) for name in ("u", "v", "w", "p", "q", "r")]
_MEASURED = [STATE.index(name) for name in ("u", "v", "w", "r")]
_PLACE = [STATE.index(name) for name in ("x", "y", "z", "psi")]
_YAW = STATE.index("psi")
_STILL = np.zeros(2)  # the current
_COEFFICIENTS = paper.VEHICLE.body.vector()


def cells() -> dict[str, Cell]:
    """Everything to compute, by name."""
    found = {}
    for members in paper.MEMBERS:
        for seed in paper.SEEDS:
            found[printed_name(members, seed)] = _cell("printed", members, paper.RUNS, seed)
        found[own_name(members)] = _cell("own", members, paper.OWN_RUNS, 0)
    most = max(paper.MEMBERS)
    for seed in paper.SEEDS:
        found[extended_name(seed)] = _cell("printed", 0, paper.EXTENDED_RUNS, seed, estimator="ekf")
    found["extended"] = _cell("own", 0, paper.OWN_RUNS, 0, estimator="ekf")
    found["doubled"] = _cell("own", most, paper.OWN_RUNS, 0, noise=paper.DOUBLED)
    timed = {"steps": 100, "repeats": 50, "seed": 0}
    found["time"] = Cell(f"{__name__}:computing_time", timed, "segorogeni, computing time")
    return found


def _cell(scheme: str, members: int, runs: int, seed: int, **options: Any) -> Cell:
    arguments = {"scheme": scheme, "members": members, "runs": runs, "seed": seed} | options
    return Cell(f"{__name__}:estimate", arguments, f"segorogeni, {scheme} step, {members} members")


def printed_name(members: int, seed: int) -> str:
    """The name of a cell at the paper's step."""
    return f"printed step, {members} members, seed {seed}"


def own_name(members: int) -> str:
    """The name of a cell at our own step."""
    return f"own step, {members} members"


def extended_name(seed: int) -> str:
    """The name of a cell at the paper's step with the filter that has no members."""
    return f"printed step, ekf, seed {seed}"


# --- the experiment ---------------------------------------------------------------------------------


def estimate(
    scheme: str, members: int, runs: int, seed: int, estimator: str = "enkf", noise: float = 1.0
) -> dict[str, np.ndarray]:
    """Errors of the position in some runs of the dive; truth and readings depend on the seed alone.

    Args:
        scheme: "printed" (forward Euler at the paper's step) or "own" (Runge-Kutta at the vehicle's).
        members: N; what a filter without members does not need.
        runs: Dives.
        seed: Of truth, readings and filter.
        estimator: "enkf", or "ekf" for the filter that has no members.
        noise: Factor on all standard deviations.

    Returns:
        ``rmse (runs, 4)`` of x, y, z [m] and yaw [rad], ``final (runs, 3)`` distances at the end [m], and of the first
        run ``time [s]``, ``truth`` and ``estimate (k, 4)``.
    """
    experiment = dive(scheme, noise)
    flights = experiment.fly(runs, np.random.default_rng([seed, 0]))
    filter_ = make(estimator, experiment.model, **({"members": members} if estimator == "enkf" else {}))
    believed = experiment.estimates(filter_, flights.readings, np.random.default_rng([seed, members]))
    places = positions(experiment, believed)
    truth = flights.truth[..., _PLACE]
    errors = places - truth
    example = np.stack([truth[:, 0], places[:, 0]])
    return {
        "rmse": rms(errors[1:]),
        "final": np.abs(errors[-1, :, :3]),
        "time": thinned(np.linspace(0.0, paper.DURATION, len(truth))),
        "truth": thinned(example[0]),
        "estimate": thinned(example[1]),
    }


def dive(scheme: str, noise: float = 1.0) -> Experiment:
    """The dive from rest under the held controls, and what the filter is told of it.

    Args:
        scheme: "printed" or "own".
        noise: Factor on all standard deviations.
    """
    own = scheme == "own"
    dt = paper.OWN_DT if own else paper.DT
    share = paper.OWN_DT / dt  # steps to one of ours, for which the noise is stated
    return Experiment(
        advance=_own_step if own else _euler_step,
        start=np.zeros(len(STATE)),
        controls=_own_controls(held_controls()) if own else _euler_controls(held_controls()),
        estimated=_ESTIMATED,
        measured=[_ESTIMATED.index(i) for i in _MEASURED],
        kick_sd=noise * paper.KICK_SD / np.sqrt(share),
        reading_sd=noise * paper.READING_SD * np.sqrt(share),
        prior_sd=noise * paper.PRIOR_SD,
    )


def positions(experiment: Experiment, estimates: np.ndarray) -> np.ndarray:
    """x, y, z [m] and yaw [rad] by the printed kinematics (eqs. 1-4) from estimates ``(T + 1, B, 6)``, alike."""
    controls = experiment.controls[:, None]
    states = experiment.state(estimates[:-1])
    places = np.zeros(estimates.shape[:-1] + (len(_PLACE),))
    yaw = np.cumsum(experiment.advance(states, controls)[..., _YAW], 0)
    states[1:, :, _YAW] = yaw[:-1]
    moved = (experiment.advance(states, controls) - states)[..., _PLACE]
    np.cumsum(moved, 0, out=places[1:])
    return places


@cache
def held_controls() -> np.ndarray:
    """Rudder, stern plane [rad] and thrust [N] that end the undisturbed dive at the goal, ``(3,)``.

    Raises:
        RuntimeError: if there are none.
    """

    def miss(held: np.ndarray) -> np.ndarray:
        state = np.zeros(len(STATE))
        for control in _own_controls(held):
            state = _own_step(state, control)
        return state[_PLACE[:3]] - paper.GOAL

    found = root(miss, [0.4 * paper.RUDDER, 0.0, paper.VEHICLE.body.cruise_thrust], tol=1e-10)
    if not found.success:
        raise RuntimeError("no held controls lead to the goal")
    return found.x


def _own_controls(held: np.ndarray) -> np.ndarray:
    """Actuators before and after each of our steps ``(T, 6)``."""
    after = np.tile(held, (round(paper.DURATION / paper.OWN_DT), 1))
    before = after.copy()
    before[0, 0] = paper.RUDDER
    return np.concatenate([before, after], -1)


def _euler_controls(held: np.ndarray) -> np.ndarray:
    """The same actuators at the beginning of each of the paper's steps ``(T, 3)``."""
    times = paper.DT * np.arange(round(paper.DURATION / paper.DT))
    controls = np.tile(held, (len(times), 1))
    controls[:, 0] = np.interp(times, [0.0, paper.OWN_DT], [paper.RUDDER, held[0]])
    return controls


def _own_step(states: np.ndarray, control: np.ndarray) -> np.ndarray:
    before, after = np.split(control, 2, -1)
    return paper.VEHICLE.moved(states, before, after, _STILL, _COEFFICIENTS)


def _euler_step(states: np.ndarray, control: np.ndarray) -> np.ndarray:
    return states + paper.DT * segorogeni_rates(states, control, _STILL, _COEFFICIENTS)


def computing_time(steps: int, repeats: int, seed: int) -> dict[str, np.ndarray]:
    """Measured time of one dive at the paper's step by the number of members: ``seconds (repeats, sizes)``."""
    experiment = dive("printed")

    def sized(members: int) -> Filter:
        return make("enkf", experiment.model, members=members)

    seconds = seconds_a_step(experiment, sized, paper.MEMBERS, steps, repeats, seed)
    return {"seconds": seconds * len(experiment.controls)}
