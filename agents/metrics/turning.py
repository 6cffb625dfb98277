"""Metrics of a ship's turns, free and on a track, from a rollout's truth and estimates."""

from collections.abc import Callable

import numpy as np

from agents.metrics import register_metrics, rmse
from agents.metrics.costs import tails
from agents.metrics.metric import (
    PerEpisode,
    described,
    input_errors,
    nees_in,
    once,
    rms,
    rms_of,
)
from agents.rollouts import Rollout
from estimators import wrap
from vessel_gym.tasks.track import Track
from vessel_gym.tasks.turning import TurningTrial
from vessel_gym.vehicles.corvette import propulsion, straight_course
from vessel_gym.vehicles.corvette_equations import COEFFICIENTS, STATE

_INPUT = "yaw increment"
_DEGREES = float(np.rad2deg(1.0))


def _true(rollout: Rollout, name: str) -> np.ndarray:
    """A component of the true state ``(T + 1, N)``; NaN if the vehicle has none of this name."""
    names, truth = rollout.config.system.vehicle.state_names, rollout.history["truth"]
    return truth[..., names.index(name)] if name in names else np.full(truth.shape[:-1], np.nan)


def _heading_error(rollout: Rollout) -> np.ndarray:
    return wrap(rollout.history["reference"][..., 0] - _true(rollout, "psi"))


def _ahead(rollout: Rollout) -> np.ndarray:
    """Distance [m] made good through the water on the commanded heading."""
    speed = np.hypot(_true(rollout, "u"), _true(rollout, "v"))
    ahead = (speed * np.cos(_heading_error(rollout)))[1:]
    return ahead.sum(0, where=rollout.alive[1:]) * rollout.config.system.task.dt


@once
def _on_track(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Progress along the track and distance off it [m], ``(T + 1, N)``."""
    return rollout.config.system.task.on_track(rollout.scenario, rollout.history["truth"])


def _off_track(rollout: Rollout) -> np.ndarray:
    return _on_track(rollout)[1]


def _progress(rollout: Rollout) -> np.ndarray:
    """Distance [m] made good along the track."""
    along = _on_track(rollout)[0]
    return along[rollout.length, np.arange(along.shape[1])] - along[0]


def _propulsion(rollout: Rollout) -> tuple[np.ndarray, np.ndarray] | None:
    """Load of the propellers and added resistance ``(T + 1, N)``; None for other equations.

    The propellers turn at constant revolutions, and their torque is taken to rise and fall as their
    thrust.
    """
    if tuple(rollout.config.system.vehicle.parameter_names) != COEFFICIENTS:
        return None
    h = rollout.history
    return propulsion(h["truth"][..., : len(STATE)], h["actuators"][..., 0], h["parameters"])


def _added_resistance(rollout: Rollout) -> np.ndarray | None:
    if (found := _propulsion(rollout)) is None:
        return None
    return 100.0 * found[1].mean(0, where=rollout.alive)


def _fuel(made_good: Callable[[Rollout], np.ndarray]) -> PerEpisode:
    """Energy of the propellers over a distance made good [m], relative to a straight course."""

    def of(rollout: Rollout) -> np.ndarray | None:
        if (found := _propulsion(rollout)) is None:
            return None
        distance = made_good(rollout)
        speed, load = straight_course(rollout.history["parameters"][0])
        energy = found[0][1:].sum(0, where=rollout.alive[1:]) * rollout.config.system.vehicle.dt
        return 100.0 * (energy / np.where(distance > 0.0, distance, np.nan) * speed / load)

    return of


def _input_rmse(rollout: Rollout) -> np.ndarray | None:
    """RMS error of the estimated yaw increment [mrad]; None where none is estimated."""
    found, inputs = input_errors(rollout), rollout.config.estimation.inputs
    if found is None or _INPUT not in inputs:
        return None
    return 1e3 * rms(found[0][..., inputs.index(_INPUT)], found[1])


ESTIMATES = {
    "heading_rmse": rmse("psi", scale=1e3),
    "yaw_rate_rmse": rmse("r", scale=1e3),
    "sway_rmse": rmse("v"),
    "input_rmse": _input_rmse,
    "added_resistance": _added_resistance,
}
"""Errors of the estimates that every filter of a ship gives, and what both tasks have beside."""
CIRCLE = described(
    "turning circle",
    heading_error=rms_of(_heading_error, _DEGREES),
    **tails("heading_error", _heading_error, lambda task: task.HEADING_TOLERANCE, _DEGREES),
    fuel=_fuel(_ahead),
    **ESTIMATES,
)
TRACK = described(
    "track",
    track_error=rms_of(_off_track),
    roll=rms_of(lambda rollout: _true(rollout, "phi"), _DEGREES),
    **tails("off_track", _off_track, lambda t: getattr(t, "margin", None) or t.DISTANCE_TOLERANCE),
    fuel=_fuel(_progress),
    position_rmse=rmse("x", "y"),
    position_nees=nees_in("x", "y"),
    current_rmse=rmse("current north", "current east"),
    **ESTIMATES,
)
register_metrics(TurningTrial, CIRCLE)
register_metrics(Track, TRACK)
