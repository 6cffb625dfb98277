"""ITSUNUSA's dive to 20 m with ensembles of 200 to 400 members, after the EnKF-SR paper."""

from functools import cache
from typing import Any

import numpy as np

from agents.cells import Cell
from agents.pilots.dive import DiveAutopilot
from agents.reproduction.ensembles import Experiment, rms, seconds_a_step, thinned
from agents.reproduction.settings import itsunusa as paper
from estimators import Filter, make
from vessel_gym.envs.itsunusa_auv import ITSUNUSA_AUV
from vessel_gym.system import Estimate
from vessel_gym.vehicles.itsunusa import STATE

_ESTIMATED = [STATE.index(name) for name in ("u", "w", "q", "theta")]
_MEASURED = [STATE.index(name) for name in ("u", "w", "q")]
_DEPTH = STATE.index("z")
_STILL = np.zeros(1)  # the current
_COEFFICIENTS = paper.VEHICLE.body.vector()


def cells() -> dict[str, Cell]:
    """Everything to compute, by name."""
    found = {}
    for variant in paper.VARIANTS:
        for members in paper.MEMBERS:
            found[cell_name(variant, members)] = _cell(variant, members)
    most = max(paper.MEMBERS)
    found["extended"] = _cell("ekf", most)
    found["doubled"] = _cell("symmetric", most, noise=paper.DOUBLED)
    found["pitch measured"] = _cell("symmetric", most, inclinometer=True)
    for variant in paper.VARIANTS:
        timed = {"variant": variant, "steps": 20, "repeats": 50, "seed": paper.SEED}
        found[f"time, {variant}"] = Cell(f"{__name__}:computing_time", timed, "itsunusa, computing time")
    return found


def _cell(variant: str, members: int, **options: Any) -> Cell:
    arguments = {"variant": variant, "members": members, "runs": paper.RUNS, "seed": paper.SEED} | options
    return Cell(f"{__name__}:estimate", arguments, f"itsunusa, {variant}, {members} members")


def cell_name(variant: str, members: int) -> str:
    """The name of the cell of a variant of the filter with so many members."""
    return f"{variant}, {members} members"


# --- the experiment ---------------------------------------------------------------------------------


def estimate(
    variant: str, members: int, runs: int, seed: int, noise: float = 1.0, inclinometer: bool = False
) -> dict[str, np.ndarray]:
    """Errors in some runs of the dive; truth and readings of the motions depend on the seed alone.

    Args:
        variant: Of `enkf-sr`; or "ekf" for the filter that has no members.
        members: N.
        runs: Dives.
        seed: Of truth, readings and filter.
        noise: Factor on all standard deviations.
        inclinometer: Whether pitch is measured, too.

    Returns:
        ``rmse (runs, 4)`` of surge, heave [m/s], pitch rate [rad/s] and depth [m], and of the first run ``time [s]``,
        ``truth`` and ``estimate (k, 4)``.
    """
    experiment = dive(noise, inclinometer)
    flights = experiment.fly(runs, np.random.default_rng([seed, 0]))
    believed = experiment.estimates(
        _filter(experiment, variant, members), flights.readings, np.random.default_rng([seed, members])
    )
    truth = flights.truth[..., [*_MEASURED, _DEPTH]]
    found = np.concatenate([believed[..., :3], depths(experiment, believed)[..., None]], -1)
    return {
        "rmse": rms((found - truth)[1:]),
        "time": thinned(paper.DT * np.arange(len(truth))),
        "truth": thinned(truth[:, 0]),
        "estimate": thinned(found[:, 0]),
    }


def _filter(experiment: Experiment, variant: str, members: int) -> Filter:
    if variant == "ekf":
        return make("ekf", experiment.model)
    return make("enkf-sr", experiment.model, members=members, variant=variant)


def dive(noise: float = 1.0, inclinometer: bool = False) -> Experiment:
    """The dive from rest under the recorded controls, and what the filter is told of it.

    Args:
        noise: Factor on all standard deviations.
        inclinometer: Whether pitch is measured, too.
    """
    reading_sd = np.append(paper.READING_SD, paper.INCLINOMETER_SD) if inclinometer else paper.READING_SD
    return Experiment(
        advance=_step,
        start=np.zeros(len(STATE)),
        controls=recorded_controls(),
        estimated=_ESTIMATED,
        measured=list(range(len(reading_sd))),
        kick_sd=noise * paper.KICK_SD,
        reading_sd=noise * reading_sd,
        prior_sd=noise * paper.PRIOR_SD,
    )


def depths(experiment: Experiment, estimates: np.ndarray) -> np.ndarray:
    """Depth [m] ``(T + 1, B)`` by the vehicle's kinematics from estimates ``(T + 1, B, 4)``."""
    sunk = experiment.advance(experiment.state(estimates[:-1]), experiment.controls[:, None])[..., _DEPTH]
    depth = np.zeros(estimates.shape[:-1])
    np.cumsum(sunk, 0, out=depth[1:])
    return depth


@cache
def recorded_controls() -> np.ndarray:
    """Actuators before and after each step ``(T, 4)`` of the autopilot's dive in still water, from rest."""
    vehicle, task = paper.VEHICLE, ITSUNUSA_AUV.task
    autopilot = DiveAutopilot(ITSUNUSA_AUV)
    course = task.course(np.zeros((1, task.uniforms)), {"goal": paper.GOAL})
    truth, actuators = np.zeros((1, len(STATE))), np.zeros((1, len(vehicle.action_names)))
    controls: list[np.ndarray] = []
    for step in range(task.horizon):
        estimate = Estimate(truth, _STILL[None])
        reference = task.reference(course, np.array([step]), truth)
        if reference[0, 0] >= course[0, 1]:
            break
        before, actuators = (
            actuators,
            vehicle.actuate(actuators, autopilot.act(task.observe(estimate, reference, actuators))),
        )
        controls.append(np.concatenate([before, actuators], -1)[0])
        truth = _step(truth, controls[-1])
    return np.stack(controls)


def _step(states: np.ndarray, control: np.ndarray) -> np.ndarray:
    before, after = np.split(control, 2, -1)
    return paper.VEHICLE.moved(states, before, after, _STILL, _COEFFICIENTS)


def computing_time(variant: str, steps: int, repeats: int, seed: int) -> dict[str, np.ndarray]:
    """Measured time of one dive by the number of members: ``seconds (repeats, sizes)``."""
    experiment = dive()

    def sized(members: int) -> Filter:
        return _filter(experiment, variant, members)

    seconds = seconds_a_step(experiment, sized, paper.MEMBERS, steps, repeats, seed)
    return {"seconds": seconds * len(experiment.controls)}
