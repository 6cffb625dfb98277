"""Noise of filters tuned on logs by the likelihood of innovations with heavy tails."""

from collections.abc import Collection, Sequence

import numpy as np

from estimators import make, run
from estimators.metrics import nis
from vessel_gym.identification.consistency import withheld_errors
from vessel_gym.identification.filtering import (
    LARGEST,
    NOISE,
    SENSORS,
    WITHHELD,
    Voyage,
    inputs,
    mean_pace,
    model,
    prior,
    start_noise,
)
from vessel_gym.vehicles.measured_ship import MeasuredShip

_TUNED = ("position", "heading", "yaw rate", "yaw", "growth", "manoeuvre")
"""What innovations determine; errors that last do not show from one step to the next."""
_TAIL, _WINDOWS, _SPREAD, _RANGE = 40.0, 40, 1.0, 1.5
"""Degrees of freedom of Student's t, windows at most, and what is assumed of the logarithm of a parameter: its standard
deviation and its largest change. Noise that vanishes would leave no room for errors of linearisation."""

_FEWEST, _NORMAL = 30, 0.9545
"""Measurements of a voyage that its errors without a sensor need, and share of a normal law within two deviations."""


def tune(ship: MeasuredShip, found: Sequence[Voyage], steps: int = 60, rounds: int = 20) -> np.ndarray:
    """Noise ``(K,)`` with the largest likelihood of an ``ekf`` on windows of voyages, each of ``steps``.

    Innovations have Student's t distribution, as those of a filter that finds the level of noise. All changed
    parameters of a gradient are rows of one run. Errors that last do not show in innovations. So standard deviations
    without a sensor are multiplied by a factor, from the errors of an ``ekf`` that does not get it on these voyages.

    Args:
        ship: The model.
        found: Voyages of the same time step, with measurements ``(T, 4)``. Those shorter than a window serve only the
            factors.
        steps: Length of a window, at most that of the longest voyage.
        rounds: Iterations of the optimiser at most.

    Returns:
        ``(K,)`` standard deviations and factors in the order of `NOISE`.

    Raises:
        ValueError: if there is no voyage.
    """
    from scipy.optimize import minimize

    if not found:
        raise ValueError("there is no voyage to tune the noise on")
    steps = min(steps, max(len(each.u) for each in found))
    start = start_noise(ship, mean_pace([each.trial for each in found], ship))
    parts = [each.part(first, first + steps) for each in found for first in range(0, len(each.u) - steps + 1, steps)]
    parts = [parts[i] for i in np.unique(np.linspace(0, len(parts) - 1, _WINDOWS).round().astype(int))]
    y = np.stack([each.y for each in parts], 1)[:, None]
    u = np.stack([each.u for each in parts], 1)[:, None]
    first = np.stack([each.trial.states[0] for each in parts])
    filter, h, k = make("ekf", model(ship, found[0].trial.dt)), 1e-3, len(_TUNED)
    moved = np.array([NOISE.index(name) for name in _TUNED])

    def noise_at(z: np.ndarray) -> np.ndarray:
        noise = np.broadcast_to(start, (*z.shape[:-1], len(start))).copy()
        noise[..., moved] *= np.exp(z)
        return noise

    def value(z: np.ndarray) -> tuple[float, np.ndarray]:
        points = z + np.concatenate([np.zeros((1, k)), h * np.eye(k)])
        noise = noise_at(points)[:, None]
        rows = (k + 1, len(first))
        priors = prior(np.broadcast_to(first, (*rows, first.shape[-1])), np.broadcast_to(noise, (*rows, len(start))))
        measured = np.broadcast_to(y, (steps, *rows, len(SENSORS)))
        series = run(filter, priors, measured, inputs(ship, u, noise))
        square = nis(series.updated.innovation, series.updated.innovation_cov)
        count = np.asarray(series.updated.available).sum(-1)
        tails = 0.5 * (_TAIL + count) * np.log1p(square / _TAIL) - 0.5 * square
        costs = (tails - series.log_likelihoods).sum((0, 2)) + 0.5 * ((points / _SPREAD) ** 2).sum(-1)
        return float(costs[0]), (costs[1:] - costs[0]) / h

    found_at = minimize(
        value, np.zeros(k), jac=True, method="L-BFGS-B", bounds=[(-_RANGE, _RANGE)] * k, options={"maxiter": rounds}
    )
    noise = noise_at(found_at.x)
    outages = [NOISE.index(f"{sensor} outage") for sensor in WITHHELD]
    noise[outages] = [_outage(sensors, ship, found, noise) for sensors in WITHHELD.values()]
    return noise


def _outage(sensors: Collection[str], ship: MeasuredShip, found: Sequence[Voyage], noise: np.ndarray) -> float:
    """Factor of standard deviations without sensors, so that two of them hold as many measurements as a normal law.

    Errors of one voyage depend on each other, and a few voyages tell little of the next: the factor is larger by
    Student's t over the normal law, with a degree of freedom for each voyage beside the first, two at least.
    """
    from scipy.stats import t

    errors = [withheld_errors(sensors, "ekf", ship, each, noise) for each in found]
    ratios = [np.abs(error / deviation) / 2.0 for error, deviation in errors if error.size >= _FEWEST]
    if not ratios:
        return 1.0
    few = t.isf(0.5 * (1.0 - _NORMAL), max(2, len(ratios) - 1)) / 2.0
    factor = few * float(np.quantile(np.concatenate(ratios), _NORMAL))
    return float(np.clip(factor, 1.0, LARGEST)) if np.isfinite(factor) else LARGEST
