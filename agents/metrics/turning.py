"""Metrics of turning circles from a rollout's truth and estimates."""

import numpy as np

from agents.metrics import core_of, register_metrics, rms, rmse, steps
from agents.metrics.costs import tails
from agents.metrics.metric import described, input_errors
from agents.rollouts import Rollout
from estimators import wrap
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette_equations import COEFFICIENTS, STATE, propulsion, straight_course

_PSI, _U, _V, _R = (STATE.index(name) for name in ("psi", "u", "v", "r"))
_INPUT = "yaw increment"

ESTIMATES = {
    "heading_rmse": rmse("psi", scale=1e3),
    "yaw_rate_rmse": rmse("r", scale=1e3),
    "sway_rmse": rmse("v"),
}
"""Errors of the estimates that every filter of a ship gives."""
METRICS = described("turning circle", steps=steps, **ESTIMATES)


def compute(rollout: Rollout) -> dict[str, np.ndarray]:
    """Metrics that have no function of their own, ``(N,)`` by key.

    The unknown input is NaN where none is estimated.
    """
    alive, h, task = rollout.alive, rollout.history, core_of(rollout).task
    truth, reference = h["truth"], h["reference"]
    error = wrap(reference[..., 0] - truth[..., _PSI])
    # of the speed through the water
    ahead = np.hypot(truth[1:, :, _U], truth[1:, :, _V]) * np.cos(error[1:])
    made_good = np.where(alive[1:], ahead, 0.0).sum(0) * task.dt
    return {
        "heading_error": np.rad2deg(rms(error, alive)),
        "yaw_rate_error": np.rad2deg(rms(reference[..., 1] - truth[..., _R], alive)),
        **tails("heading_error", error, alive, task.HEADING_TOLERANCE, float(np.rad2deg(1.0))),
        **propulsion_costs(rollout, made_good),
        "input_rmse": 1e3 * input_error(rollout),
    }


def propulsion_costs(rollout: Rollout, made_good: np.ndarray) -> dict[str, np.ndarray]:
    """Added resistance and fuel of a ship that made good distances ``(N,)`` [m].

    NaN for other equations of motion. The propellers turn at constant revolutions, and their torque
    is taken to rise and fall as their thrust.
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


def input_error(rollout: Rollout) -> np.ndarray:
    """RMS error ``(N,)`` of the estimated yaw increment [rad]; NaN where none is estimated."""
    found, inputs = input_errors(rollout), core_of(rollout).unknown_inputs
    if found is None or _INPUT not in inputs:
        return np.full(len(rollout.seeds), np.nan)
    return rms(found[0][..., inputs.index(_INPUT)], found[1])


register_metrics(TurningCircle, METRICS, compute)
