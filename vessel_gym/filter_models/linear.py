"""Linear models: the vehicle's, with what acts on it and the sensors' biases as further states."""

from typing import Any

import numpy as np

from estimators import LinearModel
from estimators.varying import Matrix, resolve
from vessel_gym.filter_models.exogenous import input_channels
from vessel_gym.filter_models.parts import Parts, moving


def linear_model(
    parts: Parts,
    kind: str,
    incremented: np.ndarray,
    G: np.ndarray,
    H: np.ndarray,
    options: dict[str, Any],
) -> LinearModel:
    """The linear model.

    Args:
        parts: What it is composed of.
        kind: Of the vehicle's linear models.
        incremented: ``(n, increments)`` what increments do to the state.
        G: ``(n, q)`` what d does to the state, but for its flows,
        H: and ``(p, q)`` to the measurements.
        options: Of the model.

    Raises:
        ValueError: for a sensor that is not linear, or a flow or fault of which the vehicle's model
            says nothing.
    """
    forces, vehicle, drift = parts.forces, parts.vehicle, parts.drift
    n, k, increments, given = (
        parts.base,
        len(parts.estimated),
        len(vehicle.increments),
        vehicle.linear(kind),
    )
    size = n + drift.size + len(parts.ended)
    effect = np.zeros(
        (forces.size, size)
    )  # E: what the filter's state gives of the exogenous input
    effect[:, n : n + k] = forces.linear[:, parts.estimated]
    effect[parts.unknown] = 0.0
    A, B, flowed = given if len(given) == 3 else (*given, np.zeros((n, len(vehicle.ambient_flows))))
    moved = [i for i in np.flatnonzero(moving(forces, n)) if i in parts.unknown or effect[i].any()]
    for i in moved:
        if len(given) == 2 or i >= forces.outside:
            what = input_channels(vehicle)[i]
            raise ValueError(
                f"the {kind} model does not say what {what} does to it: choose a nonlinear one"
            )
    flowing = [
        (j, i - increments)
        for j, i in enumerate(forces.inputs)
        if i in parts.unknown and i in moved
    ]
    carry, constant = effect[increments : forces.outside], np.zeros((size, size))
    constant[:] = incremented @ effect[:increments]
    constant[n : n + drift.size, n : n + drift.size] += drift.transition

    def transition(u: np.ndarray | None) -> np.ndarray:
        matrix = _extended(constant, resolve(A, u))
        if carry.any():
            matrix[..., :n, :] += resolve(flowed, u) @ carry
        return matrix

    def known(u: np.ndarray | None) -> np.ndarray:
        own = resolve(B, u)
        return _extended(np.zeros((size, own.shape[-1])), own)

    def pushed(u: np.ndarray | None) -> np.ndarray:
        own = resolve(flowed, u)
        matrix = _extended(G, own[..., :0])
        for j, i in flowing:
            matrix[..., :n, j] = own[..., i]
        return matrix

    push: Matrix = G if not flowing else pushed if callable(flowed) else pushed(None)
    if H.size:
        options |= {"G": push, "H": H}
    C = _measured(parts, effect)
    return (
        LinearModel(A, C, B=B, **options)
        if size == n
        else LinearModel(transition, C, B=known, **options)
    )


def _extended(constant: np.ndarray, own: np.ndarray) -> np.ndarray:
    """A ``constant`` matrix ``(r, s)`` with that of the vehicle ``(..., n, k)`` added to its first block."""
    matrix = np.zeros(own.shape[:-2] + constant.shape)
    matrix[...] = constant
    matrix[..., : own.shape[-2], : own.shape[-1]] += own
    return matrix


def _measured(parts: Parts, effect: np.ndarray) -> np.ndarray:
    """C, with the exogenous input ``effect (f, n)`` of a unit of each state."""
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
