"""Segorogeni's dive in three dimensions with ensembles of 50 to 300 members."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import root

from agents.jobs import Job
from estimators import make
from studies.papers.dive import Advance, Experiment, channel_sd, own_step, rms
from vessel_gym.envs.auv import SEGOROGENI_AUV
from vessel_gym.vehicles.segorogeni import STATE, Segorogeni, segorogeni_rates

QUANTITIES = {"x": "m", "y": "m", "z": "m", "angle": "rad"}
REFERENCES = ("planned path", "true position")
_ESTIMATED = [STATE.index(name) for name in ("u", "v", "w", "p", "q", "r")]
_PLACE = [STATE.index(name) for name in ("x", "y", "z", "psi")]
_YAW = STATE.index("psi")
_STILL = np.zeros(2)  # the current
_SHIPPED = Segorogeni()
MEASUREMENT_SD = channel_sd(
    _SHIPPED.sensors, ("u over ground", "v over ground", "w over ground", "r")
)
OWN_STEP = _SHIPPED.dt
PROCESS_SD = SEGOROGENI_AUV.disturbances["moderate"].white.diagonal()
PRIOR_SD = SEGOROGENI_AUV.task.prior(np.zeros((1, 3))).cov.diagonal()[:6] ** 0.5


class Trial(NamedTuple):
    """The dive: the paper's step [s], rudder [deg] and goal [m], and our duration [s] and excess of weight [N]."""

    step: float
    rudder: float
    goal: tuple[float, float, float]
    duration: float
    weight_excess: float

    @property
    def vehicle(self) -> Segorogeni:
        """The vehicle with the printed kinematics."""
        return Segorogeni(
            replace(_SHIPPED.body, printed_kinematics=True, buoyancy_excess=-self.weight_excess)
        )


def read(values: Mapping[str, Any]) -> Trial:
    """The dive of a settings file."""
    return Trial(**dict(values) | {"goal": tuple(values["goal"])})


def jobs(settings: Mapping[str, Any]) -> dict[str, Job]:
    """Everything to compute, by name."""
    here, found = __name__, {}

    def dives(
        name: str, own: bool, members: int, runs: int, seed: int = 0, **factors: float
    ) -> None:
        arguments = {
            "own": own,
            "members": members,
            "runs": runs,
            "seed": seed,
            "trial": settings["trial"],
        } | factors
        found[name] = Job(
            f"{here}:estimate", arguments, f"segorogeni, {members} members, own step {own}"
        )

    for members in settings["members"]:
        for seed in settings["seeds"]:
            dives(
                f"printed step, {members}, {seed}", False, members, settings["runs_of_a_seed"], seed
            )
        dives(f"own step, {members}", True, members, settings["own_runs"])
    dives("own step, 0", True, 0, settings["own_runs"])
    dives(
        "believed",
        True,
        0,
        settings["own_runs"],
        process=settings["open"]["process_noise"]["believed"],
    )
    return found


def estimate(
    own: bool, members: int, runs: int, seed: int, trial: Mapping[str, Any], process: float = 1.0
) -> dict[str, np.ndarray]:
    """Errors of the position in some runs of the dive; truth and measurements depend on the seed alone.

    Args:
        own: Runge-Kutta at the vehicle's step; else forward Euler at the paper's.
        members: N; 0: the extended Kalman filter.
        runs: Dives.
        seed: Of truth, measurements and filter.
        trial: The dive, as in the settings file.
        process: Factor on the process noise.

    Returns:
        ``planned path`` and ``true position``: RMSE ``(runs, 4)`` of x, y, z [m] and yaw [rad]
            against each; ``final
        (runs, 3)`` distances from the planned end [m].
    """
    experiment = dive(read(trial), own, process)
    dives = experiment.run(runs, np.random.default_rng([seed, 0]))
    options: dict[str, Any] = {"members": members, "draws": "independent"} if members else {}
    filter_ = make("enkf" if members else "ekf", experiment.model, **options)
    means = experiment.estimates(
        filter_, dives.measurements, np.random.default_rng([seed, members])
    )
    places, plan = positions(experiment, means), experiment.planned[:, None, _PLACE]
    return {
        "planned path": rms((places - plan)[1:]),
        "true position": rms((places - dives.truth[..., _PLACE])[1:]),
        "final": np.abs(places - plan)[-1, :, :3],
    }


def dive(trial: Trial, own: bool, process: float = 1.0) -> Experiment:
    """The dive from rest under constant controls, and the filter's assumptions; see `estimate`."""
    dt = OWN_STEP if own else trial.step
    share = OWN_STEP / dt  # the noise is stated for steps of the vehicle
    return Experiment(
        advance=own_step(trial.vehicle) if own else _euler_step(trial),
        start=np.zeros(len(STATE)),
        controls=_own_controls(trial, constant_controls(trial)) if own else _euler_controls(trial),
        estimated=_ESTIMATED,
        measured=[_ESTIMATED.index(STATE.index(name)) for name in ("u", "v", "w", "r")],
        process_sd=process * PROCESS_SD / np.sqrt(share),
        measurement_sd=MEASUREMENT_SD * np.sqrt(share),
        prior_sd=PRIOR_SD,
    )


def positions(experiment: Experiment, estimates: np.ndarray) -> np.ndarray:
    """x, y, z [m] and yaw [rad] by the printed kinematics (eqs. 1-4) from estimates ``(T + 1, B, 6)``, alike."""
    controls = experiment.controls[:, None]
    states = experiment.state(estimates[:-1])
    places = np.zeros(estimates.shape[:-1] + (len(_PLACE),))
    yaw = np.cumsum(experiment.advance(states, controls)[..., _YAW], 0)
    states[1:, :, _YAW] = yaw[:-1]
    np.cumsum((experiment.advance(states, controls) - states)[..., _PLACE], 0, out=places[1:])
    return places


@cache
def constant_controls(trial: Trial) -> np.ndarray:
    """Rudder, stern plane [rad] and thrust [N] that end the undisturbed dive at the goal, ``(3,)``.

    Raises:
        RuntimeError: if there are none.
    """
    advance = own_step(trial.vehicle)

    def miss(constant: np.ndarray) -> np.ndarray:
        state = np.zeros(len(STATE))
        for control in _own_controls(trial, constant):
            state = advance(state, control)
        return state[_PLACE[:3]] - trial.goal

    found = root(
        miss, [0.4 * np.deg2rad(trial.rudder), 0.0, _SHIPPED.body.cruise_thrust], tol=1e-10
    )
    if not found.success:
        raise RuntimeError("no constant controls lead to the goal")
    return found.x


def _own_controls(trial: Trial, constant: np.ndarray) -> np.ndarray:
    """Actuators before and after each of the vehicle's steps ``(T, 6)``; in the first the rudder leaves its angle."""
    after = np.tile(constant, (round(trial.duration / OWN_STEP), 1))
    before = after.copy()
    before[0, 0] = np.deg2rad(trial.rudder)
    return np.concatenate([before, after], -1)


def _euler_controls(trial: Trial) -> np.ndarray:
    """The same actuators at the beginning of each of the paper's steps ``(T, 3)``."""
    constant, times = (
        constant_controls(trial),
        trial.step * np.arange(round(trial.duration / trial.step)),
    )
    controls = np.tile(constant, (len(times), 1))
    controls[:, 0] = np.interp(times, [0.0, OWN_STEP], [np.deg2rad(trial.rudder), constant[0]])
    return controls


def _euler_step(trial: Trial) -> Advance:
    coefficients = trial.vehicle.body.vector()

    def advance(states: np.ndarray, control: np.ndarray) -> np.ndarray:
        return states + trial.step * segorogeni_rates(states, control, _STILL, coefficients)

    return advance
