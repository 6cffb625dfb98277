"""What a flight was like: figures of each episode, computed from a rollout's truth and estimates."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from agents.rollouts import Rollout
from estimators import chi_square_band, nees, wrap
from estimators.angles import difference
from vessel_gym.sea_trials import fit_circle
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette import TRUTH, steady_turns

WITHOUT_COVARIANCE = ("truth", "measurement")
"""Estimators that claim no uncertainty of their own: their NEES means nothing."""

_X, _Y, _PSI, _R = (TRUTH.index(name) for name in ("x", "y", "psi", "r"))


@dataclass(frozen=True)
class Metric:
    """A figure of an episode.

    Attributes:
        key: its name in `scores` and in files.
        label: its name in tables.
        unit: empty where it has none.
        better: ``"higher"``, ``"lower"``, ``"near 1"``, or ``""`` where it is not a matter of better.
        decimals: digits worth printing.
        meaning: one sentence.
    """

    key: str
    label: str
    unit: str
    better: str
    decimals: int
    meaning: str


METRICS = (
    Metric("score", "Score", "", "higher", 3, "Mean reward over a full episode, computed from the truth; 0 to 1."),
    Metric("return", "Return", "", "higher", 1, "Sum of rewards: the score times the steps of a full episode."),
    Metric("steps", "Steps", "", "higher", 0, "Steps flown until the turn was complete or lost."),
    Metric("heading_error", "Heading error", "°", "lower", 2, "RMS of commanded minus true heading."),
    Metric("yaw_rate_error", "Yaw-rate error", "°/s", "lower", 3, "RMS of commanded minus true yaw rate."),
    Metric(
        "radius_error", "Radius error", "%", "lower", 2,
        "Distance between the radius of the circle fitted to the true track over ground and the commanded radius.",
    ),
    Metric("out_of_round", "Out of round", "m", "lower", 1, "RMS distance of that track from its fitted circle."),
    Metric("rudder_rate", "Rudder rate", "°/s", "lower", 2, "RMS rate of the rudder: what the steering gear endures."),
    Metric("heading_rmse", "Heading", "mrad", "lower", 2, "RMS error of the estimated heading."),
    Metric("yaw_rate_rmse", "Yaw rate", "mrad/s", "lower", 2, "RMS error of the estimated yaw rate."),
    Metric("sway_rmse", "Sway", "m/s", "lower", 3, "RMS error of the estimated sway velocity."),
    Metric("input_rmse", "Input d", "mrad", "lower", 3, "RMS error of the estimated unknown input."),
    Metric(
        "raw_input_rmse", "Raw channel", "mrad", "lower", 3,
        "RMS error of the second reading taken for the unknown input as it is.",
    ),
    Metric(
        "nees", "NEES/n", "", "near 1", 2,
        "Mean squared estimation error in units of the claimed covariance, per state; above 1: too sure of itself.",
    ),
    Metric("unhealthy", "Restarts", "steps", "lower", 1, "Steps at which the estimator had to begin again."),
)  # fmt: skip


def metric(key: str) -> Metric:
    """The metric with this key."""
    return next(m for m in METRICS if m.key == key)


def scores(rollout: Rollout) -> dict[str, np.ndarray]:
    """Every metric of every episode, ``(N,)`` by key.

    Only times that an episode lived through count. A figure that an episode or an estimator does
    not have is NaN: NEES without a covariance, the unknown input where none is estimated, the
    circle of an episode that flew less than half of it.

    Raises:
        ValueError: if the rollout kept no history, or its task is not a turning circle.
    """
    if not rollout.history:
        raise ValueError("scores need the history of a rollout: fly it with record=True")
    core = _core(rollout)
    if not isinstance(core.task, TurningCircle):
        raise ValueError(f"scores are defined for turning circles, not {type(core.task).__name__}")
    h, alive, dt = rollout.history, rollout.alive, core.vehicle.dt
    truth, reference, estimate = h["truth"], h["reference"], h["estimate"]
    state = core.vehicle.filter_state(truth, estimate.shape[-1])
    sway, yaw_rate, heading = np.moveaxis(difference(estimate, state, core.filter.model.state_angles), -1, 0)[:3]
    radius_error, out_of_round = circle_errors(rollout)
    raw = h["measurement"][..., 1] - h["unknown_input"][..., 0]
    deg, milli = np.rad2deg, 1e3
    return {
        "score": rollout.score.astype(float),
        "return": rollout.returns.astype(float),
        "steps": rollout.length.astype(float),
        "heading_error": deg(_rms(wrap(reference[..., 0] - truth[..., _PSI]), alive)),
        "yaw_rate_error": deg(_rms(reference[..., 1] - truth[..., _R], alive)),
        "radius_error": radius_error,
        "out_of_round": out_of_round,
        "rudder_rate": deg(_rms(np.diff(h["actuators"][..., 0], axis=0) / dt, alive[1:])),
        "heading_rmse": milli * _rms(heading, alive),
        "yaw_rate_rmse": milli * _rms(yaw_rate, alive),
        "sway_rmse": _rms(sway, alive),
        "input_rmse": milli * _input_rmse(rollout),
        "raw_input_rmse": milli * _rms(raw, alive & h["available"][..., 1]),
        "nees": _mean_nees(rollout),
        "unhealthy": np.sum(alive & ~h["healthy"], axis=0).astype(float),
    }


def circle_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Radius error [%] and out-of-round RMS [m] of the true tracks over ground, ``(N,)`` each.

    A circle is fitted by least squares to the steady part: from the end of the ramp on, up to one
    full turn of the true heading. Less than half a turn is no circle: NaN. The current carries the
    track along, so that even a perfect turn is a little out of round.
    """
    core = _core(rollout)
    task, truth = core.task, rollout.history["truth"]
    turns = steady_turns(task.ship)
    rate = np.abs(rollout.history["reference"][0, :, 3])
    commanded = 1.0 / np.interp(rate, turns.yaw_rate, 1.0 / turns.radius)
    begin = int(np.ceil((task.lead + task.ramp) / task.dt))
    radius_error, out_of_round = np.full((2, len(rate)), np.nan)
    for i, length in enumerate(rollout.length):
        track = truth[begin : length + 1, i]
        turned = np.abs(np.unwrap(track[:, _PSI]) - track[:1, _PSI])
        if not np.any(turned >= np.pi):
            continue
        whole = np.flatnonzero(turned >= 2.0 * np.pi)
        track = track[: whole[0] + 1] if len(whole) else track
        circle = fit_circle(track[:, _X], track[:, _Y])
        radius_error[i] = 100.0 * abs(circle.radius / commanded[i] - 1.0)
        out_of_round[i] = circle.rms
    return radius_error, out_of_round


def consistency(rollout: Rollout) -> float | None:
    """Share of times at which the mean NEES over the runs lies in its 95 % chi-square band.

    About 0.95 for an estimator that is as good as it says; None for one that says nothing.
    """
    values = _nees(rollout)
    if values is None:
        return None
    alive, n = rollout.alive, rollout.history["estimate"].shape[-1]
    runs = alive.sum(1)
    flown = runs > 0
    mean = np.where(alive, values, 0.0).sum(1)[flown] / runs[flown]
    band = np.array([_band(int(count), n) for count in runs[flown]])
    return float(np.mean((mean >= band[:, 0]) & (mean <= band[:, 1])))


@cache
def _band(runs: int, degrees: int) -> tuple[float, float]:
    return chi_square_band(runs, degrees)


def _core(rollout: Rollout) -> Any:
    return rollout.env.unwrapped.core


def _rms(error: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square over time of errors ``(T, N)`` where the mask holds; NaN where it never does."""
    count = mask.sum(0)
    mean = np.where(mask, error, 0.0) ** 2
    return np.sqrt(np.where(count > 0, mean.sum(0) / np.maximum(count, 1), np.nan))


def _input_rmse(rollout: Rollout) -> np.ndarray:
    core, h = _core(rollout), rollout.history
    if core.belief.input_mean is None:
        return np.full(len(rollout.seeds), np.nan)
    delay = core.filter.input_delay or 0  # the estimate of step k is of the input of step k - delay
    known = len(h["unknown_input"]) - delay
    return _rms(h["input_estimate"][delay:, :, 0] - h["unknown_input"][:known, :, 0], rollout.alive[delay:])


def _nees(rollout: Rollout) -> np.ndarray | None:
    """NEES ``(T + 1, N)``, or None for an estimator without a covariance of its own."""
    core, h = _core(rollout), rollout.history
    if core.estimator in WITHOUT_COVARIANCE:
        return None
    state = core.vehicle.filter_state(h["truth"], h["estimate"].shape[-1])
    return nees(h["estimate"], h["covariance"], state, core.filter.model.state_angles)


def _mean_nees(rollout: Rollout) -> np.ndarray:
    values, alive = _nees(rollout), rollout.alive
    if values is None:
        return np.full(len(rollout.seeds), np.nan)
    n = rollout.history["estimate"].shape[-1]
    return np.where(alive, values, 0.0).sum(0) / alive.sum(0) / n
