"""Linear models of filters: vehicle, with disturbance and sensors' biases as further states."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estimators import LinearModel, compiled
from estimators.varying import Matrix, is_compiled, resolve
from vessel_gym.filter_models.exogenous import input_channels
from vessel_gym.filter_models.parts import Parts, moving


def linear_model(parts: Parts, kind: str, options: dict[str, Any]) -> LinearModel:
    """The linear model.

    Args:
        parts: Parts of the model.
        kind: One of the vehicle's linear models.
        options: Further options of the model; G is the effect ``(n, q)`` of d without flows.

    Raises:
        ValueError: for a sensor that is not linear, or a flow or fault that the vehicle's model
            does not include.
    """
    forces, vehicle, drift = parts.forces, parts.vehicle, parts.drift
    n, k, incremented = parts.base, len(parts.estimated), parts.incremented
    size, increments = incremented.shape
    effect = np.zeros((forces.size, size))  # E: exogenous input per unit of the filter's state
    effect[:, n : n + k] = forces.linear[:, parts.estimated]
    effect[parts.unknown] = 0.0
    A, B, *flows = vehicle.linear(kind)
    flowed = flows[0] if flows else np.zeros((n, len(vehicle.ambient_flows)))
    moved = [i for i in np.flatnonzero(moving(forces, n)) if i in parts.unknown or effect[i].any()]
    for i in moved:
        if not flows or i >= forces.outside:
            what = input_channels(vehicle)[i]
            raise ValueError(
                f"the {kind} model does not say what {what} does to it: choose a nonlinear one"
            )
    chosen = np.zeros((len(vehicle.ambient_flows), len(forces.inputs)))  # flows that are d
    for j, channel in enumerate(forces.inputs):
        if channel in parts.unknown and channel in moved:
            chosen[channel - increments, j] = 1.0
    carry, rows = effect[increments : forces.outside], size - n
    constant = incremented @ effect[:increments]
    constant[n : n + drift.size, n : n + drift.size] += drift.transition

    def transition(u: np.ndarray | None) -> np.ndarray:
        own = resolve(A, u)
        moved = np.concatenate([own, np.zeros((*own.shape[:-1], rows))], -1)
        if carry.any():
            moved = moved + resolve(flowed, u) @ carry
        return _above(moved, rows) + constant

    if chosen.any():
        G = options["G"]
        options["G"] = _scheduled(lambda u: _above(resolve(flowed, u) @ chosen, rows) + G, flowed)
    C = _measured(parts, effect)
    if not rows:
        return LinearModel(A, C, B=B, **options)
    known = _scheduled(lambda u: _above(resolve(B, u), rows), B)
    return LinearModel(_scheduled(transition, A, flowed), C, B=known, **options)


def _scheduled(form: Callable[..., np.ndarray], *used: Matrix) -> Matrix:
    """A function of the known input; its value if none of the matrices used depends on that."""
    if not any(map(callable, used)):
        return form(None)
    return compiled(form) if all(map(is_compiled, used)) else form


def _above(matrix: np.ndarray, rows: int) -> np.ndarray:
    """The matrix ``(..., n, m)``, with rows of zeros appended below."""
    zeros = np.zeros((*matrix.shape[:-2], rows, matrix.shape[-1]))
    return np.concatenate([matrix, zeros], -2)


def _measured(parts: Parts, effect: np.ndarray) -> np.ndarray:
    """C, given the exogenous input ``effect (f, n)`` per unit of each state."""
    sensors, first, size = parts.sensors, parts.base + len(parts.estimated), effect.shape[-1]
    last = first + sensors.bias.size
    seen = effect[: parts.forces.outside].T.copy()
    seen[:, : len(parts.vehicle.increments)] = 0.0
    seen[np.arange(last, size), parts.ended] = (
        1.0  # sensors show increments of the step that has ended
    )
    nothing = sensors.exact(
        parts.state(np.zeros(size)), np.zeros(seen.shape[-1]), np.zeros(sensors.bias.size)
    )

    def read(x: np.ndarray) -> np.ndarray:
        return sensors.exact(parts.state(x), x @ seen, x[..., first:last]) - nothing

    C, x = read(np.eye(size)).T, np.linspace(-1.0, 2.0, size)
    wrong = np.flatnonzero(np.abs(read(x) - C @ x) > 1e-9 * (1.0 + np.abs(C) @ np.abs(x)))
    if len(wrong):
        raise ValueError(
            f"{sensors.of_channel(wrong[0]).name} is not linear in what the filter estimates:"
            " choose a filter for nonlinear models"
        )
    return C
