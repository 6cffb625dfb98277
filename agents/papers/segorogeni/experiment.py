"""Segorogeni's dive in three dimensions with ensembles of 50 to 300 members."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, reduce
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import root

from agents.papers.figures import figure
from agents.papers.measures import (
    Comparison,
    against_table,
    by_members,
    comparison_table,
    means,
    rows,
    with_units,
)
from agents.papers.vehicle import Advance, Experiment, channel_sd, own_step
from estimators import make, rmse
from vessel_gym.envs import SegorogeniAUVEnv
from vessel_gym.vehicles.segorogeni import STATE, Segorogeni, printed_rates

QUANTITIES = {"x": "m", "y": "m", "z": "m", "angle": "rad"}
REFERENCES = ("planned path", "true position")
_ESTIMATED = [STATE.index(name) for name in ("u", "v", "w", "p", "q", "r")]
_MEASURED = [0, 1, 2, 5]  # u, v, w and r
_PLACE = [STATE.index(name) for name in ("x", "y", "z", "psi")]
_YAW = STATE.index("psi")
_SHIPPED = Segorogeni()
MEASUREMENT_SD = channel_sd(
    _SHIPPED.sensors, ("u over ground", "v over ground", "w over ground", "r")
)
OWN_STEP = _SHIPPED.dt
PROCESS_SD = SegorogeniAUVEnv.system.disturbances["moderate"].white.diagonal()
PRIOR_SD = np.array(SegorogeniAUVEnv.system.task.prior_sd)[:6]


class Trial(NamedTuple):
    """The dive: printed step [s], rudder [deg], goal [m]; our duration [s], weight excess [N]."""

    step: float
    rudder: float
    goal: tuple[float, float, float]
    duration: float
    weight_excess: float

    @property
    def vehicle(self) -> Segorogeni:
        """The vehicle with the printed kinematics."""
        heavy = replace(_SHIPPED.body, buoyancy_excess=-self.weight_excess)
        return Segorogeni(heavy, as_printed=True)


def read(values: dict[str, Any]) -> Trial:
    """The dive of a settings file."""
    return Trial(**values | {"goal": tuple(values["goal"])})


def rms_errors(
    experiment: Experiment, members: Sequence[int], runs: int, seeds: Sequence[int] = (0,)
) -> dict[int, dict[str, np.ndarray]]:
    """Errors of the position in some dives by members; 0: of the extended Kalman filter.

    Args:
        experiment: The dive.
        members: N.
        runs: Dives of each seed.
        seeds: Of truth and measurements.

    Returns:
        ``planned path`` and ``true position``: RMSE ``(B, 4)`` of x, y, z [m] and yaw [rad] against
        each in all dives; ``final (B, 3)`` distances from the planned end [m].
    """
    dives = (experiment.simulate(runs, np.random.default_rng([seed, 0])) for seed in seeds)
    truth, measurements = (np.concatenate(each, 1) for each in zip(*dives, strict=True))
    plan, found = experiment.planned[:, None, _PLACE], {}
    for n in members:
        filter_ = experiment.ensemble(n) if n else make("ekf", experiment.model)
        places = positions(experiment, experiment.estimates(filter_, measurements)[0])
        references = zip(REFERENCES, (plan, truth[..., _PLACE]), strict=True)
        found[n] = {name: rmse(places[1:], of[1:], axis=0) for name, of in references}
        found[n]["final"] = np.abs(places - plan)[-1, :, :3]
    return found


def dive(trial: Trial, own: bool, process: float = 1.0) -> Experiment:
    """The dive from rest under constant controls, and the filter's assumptions.

    Args:
        trial: The dive.
        own: Runge-Kutta at the vehicle's step; else forward Euler at the paper's.
        process: Factor on the process noise.
    """
    dt = OWN_STEP if own else trial.step
    share = OWN_STEP / dt  # the noise is stated for steps of the vehicle
    return Experiment(
        advance=own_step(trial.vehicle) if own else _euler_step(trial),
        start=np.zeros(len(STATE)),
        controls=_own_controls(trial, constant_controls(trial)) if own else _euler_controls(trial),
        estimated=_ESTIMATED,
        measured=_MEASURED,
        process_sd=process * PROCESS_SD / np.sqrt(share),
        measurement_sd=MEASUREMENT_SD * np.sqrt(share),
        prior_sd=PRIOR_SD,
    )


def positions(experiment: Experiment, estimates: np.ndarray) -> np.ndarray:
    """x, y, z [m] and yaw [rad] by eqs. 1-4 ``(T + 1, B, 4)`` from estimates ``(T + 1, B, 6)``."""
    states = experiment.state(estimates[:-1])
    states[..., _YAW] = experiment.path(states, [_YAW])[:-1, :, 0]
    return experiment.path(states, _PLACE)


@cache
def constant_controls(trial: Trial) -> np.ndarray:
    """Rudder, stern plane [rad] and thrust [N] that end the undisturbed dive at the goal, ``(3,)``.

    Raises:
        RuntimeError: if there are none.
    """
    advance = own_step(trial.vehicle)

    def miss(constant: np.ndarray) -> np.ndarray:
        end = reduce(advance, _own_controls(trial, constant), np.zeros(len(STATE)))
        return end[_PLACE[:3]] - trial.goal

    first = [0.4 * np.deg2rad(trial.rudder), 0.0, _SHIPPED.body.cruise_thrust]
    found = root(miss, first, tol=1e-10)
    if not found.success:
        raise RuntimeError("no constant controls lead to the goal")
    return found.x


def _own_controls(trial: Trial, constant: np.ndarray) -> np.ndarray:
    """Actuators before and after each step ``(T, 6)``; in the first the rudder leaves its angle."""
    after = np.tile(constant, (round(trial.duration / OWN_STEP), 1))
    before = after.copy()
    before[0, 0] = np.deg2rad(trial.rudder)
    return np.concatenate([before, after], -1)


def _euler_controls(trial: Trial) -> np.ndarray:
    """Actuators at the beginning of each of the paper's steps ``(T, 3)``."""
    constant = constant_controls(trial)
    times = trial.step * np.arange(round(trial.duration / trial.step))
    controls = np.tile(constant, (len(times), 1))
    controls[:, 0] = np.interp(times, [0.0, OWN_STEP], [np.deg2rad(trial.rudder), constant[0]])
    return controls


def _euler_step(trial: Trial) -> Advance:
    coefficients, still = trial.vehicle.body.vector(), np.zeros(2)

    def advance(states: np.ndarray, control: np.ndarray) -> np.ndarray:
        return states + trial.step * printed_rates(states, control, still, coefficients)

    return advance


# --- tables ---------------------------------------------------------------------------------------


def report(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Tables and measures."""
    members, runs = settings["members"], settings["own_runs"]
    trial, few = read(settings["trial"]), settings["runs_of_a_seed"]
    euler = rms_errors(dive(trial, False), members, few, settings["seeds"])
    own = rms_errors(dive(trial, True), (*members, 0), runs)
    noise = settings["open"]["process_noise"]["believed"]
    believed = rms_errors(dive(trial, True, noise), (0,), runs)[0]
    units = with_units(QUANTITIES)
    tables: dict[str, Any] = {
        "own": [("reference", "members", *units)], "believed": [("reference", *units)],
    }  # fmt: skip
    columns = {}
    for of in REFERENCES:
        against = {n: found[of] for n, found in euler.items()}
        printed, averaged = settings["printed"], settings["averaged"]
        found = against_table("Table III", printed, QUANTITIES, against, averaged)
        ends = "xyz", settings["end"], euler[members[-1]]["final"].T
        for name, text, ours in zip(*ends, strict=True):
            found.append(Comparison("end of the dive", name, "m", text, "sec. III D", ours))
        columns[f"against the {of}"] = found
        tables["own"] += by_members(of, {n: own[n][of] for n in members})
        tables["own"].append((of, "none: ekf", *means(own[0][of])))
        tables["own"].append((of, "300 less 200", *means(own[300][of] - own[200][of])))
        tables["believed"].append((of, *means(believed[of], 3)))
    tables["published"] = comparison_table(columns)
    return {
        "tables": tables,
        "figures": [_dive_figure(trial, members[-1])],
        "rows": rows(settings["paper"], columns[f"against the {REFERENCES[0]}"]),
    }


def _dive_figure(trial: Trial, members: int) -> dict[str, Any]:
    """Figure 2: path and estimate of a dive in three dimensions, one of the table's."""
    experiment = dive(trial, own=False)
    truth, measurements = experiment.simulate(1, np.random.default_rng([0, 0]))
    enkf = experiment.ensemble(members)
    places = positions(experiment, experiment.estimates(enkf, measurements)[0])[:, 0]
    every = round(OWN_STEP / trial.step)
    ways = {"path": experiment.planned[:, _PLACE], "real": truth[:, 0, _PLACE], "EnKF": places}
    lines = {name: [*way[::every, :3].T] for name, way in ways.items()}
    panel = {"x": "X [m]", "y": "Y [m]", "z": "Z [m]", "lines": lines}
    return figure("2", f"Estimated position in a dive, {members} members.", panel)
