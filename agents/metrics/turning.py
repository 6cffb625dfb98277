"""Metrics of turning circles from a rollout's truth and estimates."""

import numpy as np

from agents.metrics import core_of, register_metrics, rms, rmse, steps
from agents.metrics.costs import tails
from agents.metrics.metric import described
from agents.rollouts import Rollout
from estimators import wrap
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.corvette_equations import COEFFICIENTS, STATE, propulsion, straight_course

_X, _Y, _PSI, _U, _V, _R = (STATE.index(name) for name in ("x", "y", "psi", "u", "v", "r"))

ESTIMATES = {
    "heading_rmse": rmse("psi", scale=1e3),
    "yaw_rate_rmse": rmse("r", scale=1e3),
    "sway_rmse": rmse("v"),
}
"""Errors of the estimates that every filter of a ship gives."""
METRICS = described("turning circle", steps=steps, **ESTIMATES)


def compute(rollout: Rollout) -> dict[str, np.ndarray]:
    """Metrics that have no function of their own, ``(N,)`` by key.

    The unknown input is NaN where none is estimated, and so is the circle of an episode that flew
    less than half of it.
    """
    alive, truth, reference = rollout.alive, rollout.history["truth"], rollout.history["reference"]
    task, error, (raw, came) = (
        core_of(rollout).task,
        wrap(reference[..., 0] - truth[..., _PSI]),
        _raw_input(rollout),
    )
    ahead = np.hypot(truth[1:, :, _U], truth[1:, :, _V]) * np.cos(
        error[1:]
    )  # of the speed through the water
    made_good = np.where(alive[1:], ahead, 0.0).sum(0) * task.dt
    radius_error, out_of_round = circle_errors(rollout)
    return {
        "heading_error": np.rad2deg(rms(error, alive)),
        "yaw_rate_error": np.rad2deg(rms(reference[..., 1] - truth[..., _R], alive)),
        "raw_input_rmse": 1e3 * rms(raw, alive & came),
        **tails("heading_error", error, alive, task.HEADING_TOLERANCE, float(np.rad2deg(1.0))),
        **propulsion_costs(rollout, made_good),
        "radius_error": radius_error,
        "out_of_round": out_of_round,
        "input_rmse": 1e3 * input_error(rollout),
    }


def propulsion_costs(rollout: Rollout, made_good: np.ndarray) -> dict[str, np.ndarray]:
    """Added resistance and fuel of a ship that made good distances ``(N,)`` [m]; NaN for other equations of motion.

    The propellers turn at constant revolutions, and their torque is taken to rise and fall as their
    thrust.
    """
    vehicle, h, alive = core_of(rollout).vehicle, rollout.history, rollout.alive
    if tuple(vehicle.parameter_names) != COEFFICIENTS:
        return dict.fromkeys(("added_resistance", "fuel"), np.full(made_good.shape, np.nan))
    load, added = propulsion(h["truth"][..., : len(STATE)], h["actuators"][..., 0], h["parameters"])
    speed, straight_load = straight_course(h["parameters"][0])
    energy = np.where(alive[1:], load[1:], 0.0).sum(0) * vehicle.dt
    relative = energy / np.where(made_good > 0.0, made_good, np.nan) * speed / straight_load
    return {
        "added_resistance": 100.0 * np.where(alive, added, 0.0).sum(0) / alive.sum(0),
        "fuel": 100.0 * relative,
    }


def _raw_input(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Error of the measurement that shows the yaw increment as it is, and whether it came ``(T + 1, N)``."""
    h, given = rollout.history, core_of(rollout).sensors.gives
    if "yaw increment" not in given:
        return np.zeros(rollout.alive.shape), np.zeros(rollout.alive.shape, bool)
    channel = given.index("yaw increment")
    return h["measurement"][..., channel] - _true_input(rollout), h["available"][..., channel]


def _true_input(rollout: Rollout) -> np.ndarray:
    """The true yaw increment d ``(T + 1, N)``; 0 where no increment acts on the ship."""
    names, new = core_of(rollout).unknown_inputs, rollout.history["unknown_input"]
    return (
        new[..., names.index("yaw increment")]
        if "yaw increment" in names
        else np.zeros(new.shape[:-1])
    )


def circle_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Radius error [%] and out-of-round RMS [m] of the true tracks over ground, ``(N,)`` each.

    A circle is fitted by least squares to the steady part: from the end of the ramp on, up to one
    full turn of the true heading. Less than half a turn is no circle: NaN. The current carries the
    track along, so that even a perfect turn is a little out of round.
    """
    turns = steady_turns(core_of(rollout).task.ship)
    rate = np.abs(rollout.history["reference"][0, :, 3])
    return circle_fit(rollout, 1.0 / np.interp(rate, turns.yaw_rate, 1.0 / turns.radius))


def circle_fit(rollout: Rollout, commanded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`circle_errors` of commanded radii ``(N,)``."""
    task, truth = core_of(rollout).task, rollout.history["truth"]
    begin = int(np.ceil((task.lead + task.ramp) / task.dt))
    radius_error, out_of_round = np.full((2, len(commanded)), np.nan)
    for i, length in enumerate(rollout.length):
        track = truth[begin : length + 1, i]
        turned = np.abs(np.unwrap(track[:, _PSI]) - track[:1, _PSI])
        if not np.any(turned >= np.pi):
            continue
        whole = np.flatnonzero(turned >= 2.0 * np.pi)
        track = track[: whole[0] + 1] if len(whole) else track
        radius, out_of_round[i] = _fitted_circle(track[:, _X], track[:, _Y])
        radius_error[i] = 100.0 * abs(radius / commanded[i] - 1.0)
    return radius_error, out_of_round


def _fitted_circle(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Radius of the circle through points ``(k,)`` by linear least squares, and RMS distance from it [m].

    Source: Kasa (1976), A circle fitting procedure. With noise, it favours small circles on short
    arcs.
    """
    size = max(np.ptp(x), np.ptp(y))
    a, b = (x - x.mean()) / size, (y - y.mean()) / size
    columns = np.stack([2.0 * a, 2.0 * b, np.ones_like(a)], -1)
    centre_a, centre_b, rest = np.linalg.lstsq(columns, a * a + b * b, rcond=1e-10)[0]
    radius = np.sqrt(rest + centre_a**2 + centre_b**2)
    rms = np.sqrt(np.mean((np.hypot(a - centre_a, b - centre_b) - radius) ** 2))
    return float(size * radius), float(size * rms)


def input_error(rollout: Rollout) -> np.ndarray:
    """RMS error ``(N,)`` of the estimated yaw increment [rad]; NaN where none is estimated."""
    core, h = core_of(rollout), rollout.history
    if core.belief.input_mean is None:
        return np.full(len(rollout.seeds), np.nan)
    delay = (
        core.config.estimation.input_delay
    )  # the estimate of step k is of the input of step k - delay
    true = _true_input(rollout)
    return rms(h["input_estimate"][delay:, :, 0] - true[: len(true) - delay], rollout.alive[delay:])


register_metrics(TurningCircle, METRICS, compute)
