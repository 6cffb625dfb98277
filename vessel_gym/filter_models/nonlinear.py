"""Nonlinear models of filters, and their linearisation about steady motions."""

from typing import Any

import numpy as np

from estimators import LinearModel, NonlinearModel
from estimators.differences import central_differences, steps
from estimators.engine import compiled
from estimators.varying import Schedule, StateMatrix
from vessel_gym.checks import is_compiled
from vessel_gym.filter_models.exogenous import change_of
from vessel_gym.filter_models.parts import Parts, seen_alike
from vessel_gym.vehicles.integration import incremented as with_increments
from vessel_gym.vehicles.vehicle import Trims


def nonlinear_model(parts: Parts, options: dict[str, Any]) -> NonlinearModel:
    """The nonlinear model.

    Args:
        parts: Parts of the model.
        options: Further options of the model; G is the effect ``(n, q)`` of d without flows and
            faults.

    Raises:
        ValueError: for an unknown flow whose effect on the measurements depends on the state.
    """
    forces, vehicle, n = parts.forces, parts.vehicle, parts.base
    increments = len(vehicle.increments)
    moves = [parts.own.index(name) for name in vehicle.incremented if name in parts.own]
    has_increments = len(parts.estimated) > 0 and forces.has_increments

    def transition(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        assert u is not None
        if u.size > u.shape[-1] and u.shape[:-1] != x.shape[:-1]:
            x = np.broadcast_to(x, np.broadcast_shapes(x.shape[:-1], u.shape[:-1]) + x.shape[-1:])
        acting, zero = parts.acting(x), np.zeros(x.shape[:-1])
        after = forces.moved(x[..., :n], u, acting)
        after = with_increments(after, acting[..., :increments], moves) if has_increments else after
        ended = [np.stack([acting[..., i] + zero for i in parts.ended], -1)] if parts.ended else []
        return np.concatenate([after, parts.drifted(x, after), *ended], -1)

    measurement = parts.expected
    if forces.drift_compiled:
        transition = compiled(transition)
    if forces.effect_compiled and all(is_compiled(sensor.reads) for sensor in parts.sensors.each):
        measurement = compiled(measurement)
    if "G" in options:
        options["G"] = _input_matrix(parts, options["G"], options["state_angles"])
    return NonlinearModel(transition, measurement, **options)


def _input_matrix(parts: Parts, G: np.ndarray, angles: tuple[int, ...]) -> StateMatrix:
    """G with the effects of flows and faults in d: a function of state and known input, if any.

    The effects are central differences about zero flows and faults.

    Raises:
        ValueError: for an unknown flow whose effect on the measurements depends on the state.
    """
    forces, vehicle, n = parts.forces, parts.vehicle, parts.base
    increments = len(vehicle.increments)
    flowing = [
        (j, i) for j, i in enumerate(forces.inputs) if i in parts.unknown and i >= increments
    ]
    for _, i in flowing:
        if i < forces.outside and not seen_alike(vehicle, parts.sensors, i):
            raise ValueError(
                f"how measurements show {vehicle.ambient_flows[i - increments]} depends on where"
                " the vehicle is, which a nonlinear model cannot have of an unknown input: let it"
                f" be {change_of('a component')!r} instead, or leave the sensor out"
            )

    def pushed(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        own, acting = x[..., None, :n], parts.acting(x)[..., None, :]

        def after(d: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            assert u is not None
            with_d = np.broadcast_to(acting, (*d.shape[:-1], forces.size)).copy()
            with_d[..., [i for _, i in flowing]] = d
            return forces.moved(np.broadcast_to(own, d.shape[:-1] + (n,)), u, with_d)

        none = np.zeros(x.shape[:-1] + (len(flowing),))
        columns = central_differences("drift", after, none, u, n, angles, steps(none, None))[1]
        pushes = np.empty(x.shape[:-1] + G.shape)
        pushes[...] = G
        pushes[..., :n, [j for j, _ in flowing]] = columns
        return pushes

    return pushed if flowing else G


def linearised_model(parts: Parts, options: dict[str, Any], trims: Trims) -> LinearModel:
    """The nonlinear model, linearised about each steady motion; arguments as `nonlinear_model`.

    Raises:
        ValueError: for a sensor that is not linear there.
    """
    model, n = nonlinear_model(parts, options.copy()), trims.x.shape[-1]
    x = np.zeros((len(trims.x), model.n))
    x[:, :n], u = trims.x, trims.u
    after, A = model.linearise_transition(x, u)
    y, C = model.linearise_measurement(x, u)
    wrong = np.abs(y - np.matvec(C, x)).max(0) > 1e-6 * (1.0 + np.abs(y).max(0))
    if wrong.any():
        name = parts.sensors.of_channel(np.argmax(wrong)).name
        raise ValueError(
            f"{name} is not linear about the vehicle's steady motions: choose a filter for"
            " nonlinear models"
        )

    def moved(u: np.ndarray, _: np.ndarray | None) -> np.ndarray:
        return model.transition(np.broadcast_to(x[:, None, :], u.shape[:-1] + (model.n,)), u)

    spacing = steps(np.zeros(u.shape), None)
    B = central_differences("transition", moved, u, None, model.n, model.state_angles, spacing)[1]
    B[..., -1] += after - np.matvec(A, x) - np.matvec(B, u)

    def scheduled(table: np.ndarray) -> Schedule:
        return Schedule(np.ascontiguousarray(table), *trims[2:])

    if "G" in options:
        pushes = np.broadcast_to(model.input_matrix(x, u), (*x.shape, model.q))
        options["G"] = scheduled(pushes)
    return LinearModel(scheduled(A), scheduled(C), B=scheduled(B), **options)
