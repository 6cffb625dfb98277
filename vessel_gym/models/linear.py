"""Models of filters: nonlinear, linear, or linearised about steady motions."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estimators import LinearModel, NonlinearModel, compiled
from estimators.differences import central_differences, steps
from estimators.varying import Matrix, Schedule, is_compiled, resolve
from vessel_gym import checks
from vessel_gym.models.state_space import StateSpace
from vessel_gym.vehicles.vehicle import Trims


def filter_model(space: StateSpace) -> LinearModel | NonlinearModel:
    """Model of a filter with a state space.

    Raises:
        ValueError: for a sensor that is not linear while the model is, a sensor that shows a flow
            in d while the model is not linear, or a fault that the vehicle's model does not
            include.
    """
    if space.kind not in space.vehicle.linear_kinds:
        return nonlinear_model(space)
    given = space.vehicle.linear(space.kind)
    return linearised_model(space, given) if isinstance(given, Trims) else _linear(space, *given)


def _arguments(space: StateSpace) -> dict[str, Any]:
    """Arguments of every kind of model: angles, noise, and effects of increments in d.

    Raises:
        ValueError: for sensors that show both increments and flows in d.
    """
    noise = {"Q": space.Q, "R": space.R}
    for name, table in space.vehicle.noise.items():
        # The vehicle's schedules hold for its own sensors and states alone.
        if np.shape(noise[name]) == table.table.shape[1:]:
            noise[name] = table
    observable = [i for i, column in zip(space.unknown, space.H.T, strict=True) if column.any()]
    flows = [i for i in observable if i >= space.increments]
    if 0 < len(flows) < len(observable):
        raise ValueError(
            "sensors show increments of the step that has ended and flows as they are now, of"
            f" {', '.join(space.inputs)}: no filter can take both for its unknown input; assume"
            ' them with {"as": "states"}'
        )
    given = {"G": space.G, "H": space.H} if space.inputs else {}
    return noise | given | {
        "state_angles": space.angles, "measurement_angles": space.sensors.angles,
        "delayed_feedthrough": not flows,
    }  # fmt: skip


def nonlinear_model(space: StateSpace) -> NonlinearModel:
    """Nonlinear model, compiled where its parts are.

    Raises:
        ValueError: for a sensor that shows a flow in d.
    """
    disturbance, arguments = space.disturbance, _arguments(space)
    transition, measurement = space.transition, space.measurement
    if all(map(checks.is_compiled, (space.vehicle.drift, disturbance.effect, disturbance.met))):
        transition = compiled(transition)
    measured = (sensor.reads for sensor in space.sensors.each)
    if all(map(checks.is_compiled, (disturbance.effect, *measured))):
        measurement = compiled(measurement)
    if not arguments["delayed_feedthrough"]:
        raise ValueError(
            f"sensors show {', '.join(space.inputs)}, which a nonlinear model cannot have of flows"
            ' in the unknown input: assume them with {"as": "states"}, or leave the sensor out'
        )
    if max(space.unknown, default=0) >= space.increments:
        arguments["G"] = space.input_matrix
    return NonlinearModel(transition, measurement, **arguments)


def linearised_model(space: StateSpace, trims: Trims) -> LinearModel:
    """Nonlinear model, linearised about each steady motion.

    Raises:
        ValueError: for a sensor that is not linear there.
    """
    model, n = nonlinear_model(space), trims.x.shape[-1]
    x = np.zeros((len(trims.x), model.n))
    x[:, :n], u = trims.x, trims.u
    after, A = model.linearise_transition(x, u)
    y, C = model.linearise_measurement(x, u)
    wrong = np.abs(y - np.matvec(C, x)).max(0) > 1e-6 * (1.0 + np.abs(y).max(0))
    _check_linear(space, wrong, "about the vehicle's steady motions")

    def moved(u: np.ndarray, _: np.ndarray | None) -> np.ndarray:
        return model.transition(np.broadcast_to(x[:, None, :], u.shape[:-1] + (model.n,)), u)

    spacing = steps(np.zeros(u.shape), None)
    B = central_differences("transition", moved, u, None, model.n, model.state_angles, spacing)[1]
    B[..., -1] += after - np.matvec(A, x) - np.matvec(B, u)

    def scheduled(table: np.ndarray) -> Schedule:
        return Schedule(np.ascontiguousarray(table), *trims[2:])

    arguments = _arguments(space)
    if space.inputs:
        pushes = np.broadcast_to(model.input_matrix(x, u), (*x.shape, model.q))
        arguments["G"] = scheduled(pushes)
    return LinearModel(scheduled(A), scheduled(C), B=scheduled(B), **arguments)


def _linear(space: StateSpace, A: Matrix, B: Matrix, F: Matrix) -> LinearModel:
    """Linear model from the vehicle's A, B and effect F ``(n, k)`` of flows over a step.

    Raises:
        ValueError: for a sensor that is not linear, or a disturbance with faults of actuators.
    """
    if space.faulty:
        raise ValueError("a linear model does not say what a fault does to it: choose another")
    size, n, k = len(space.incremented), len(space.vehicle_states), len(space.kept)
    effect = np.zeros((space.increments_and_flows, size))  # exogenous input per unit of each state
    effect[:, n : n + k] = space.linear_effect[:, space.kept]
    effect[space.unknown] = 0.0
    constant = space.incremented @ effect[: space.increments]
    constant[n : n + space.slow.size, n : n + space.slow.size] += space.slow.transition

    def transition(u: np.ndarray | None) -> np.ndarray:
        own = resolve(A, u)
        beside = np.zeros((*own.shape[:-1], size - n))
        moved = np.concatenate([own, beside], -1) + resolve(F, u) @ effect[space.flows]
        return _above(moved, size) + constant

    arguments = _arguments(space)
    if space.inputs:
        G, chosen = space.G, space.selected[space.flows]
        arguments["G"] = _scheduled(lambda u: _above(resolve(F, u) @ chosen, size) + G, F)
    known = _scheduled(lambda u: _above(resolve(B, u), size), B)
    return LinearModel(_scheduled(transition, A, F), _measured(space, size), B=known, **arguments)


def _scheduled(form: Callable[..., np.ndarray], *used: Matrix) -> Matrix:
    """A function of the known input; its value if none of the matrices used depends on that."""
    if not any(map(callable, used)):
        return form(None)
    return compiled(form) if all(map(is_compiled, used)) else form


def _above(matrix: np.ndarray, rows: int) -> np.ndarray:
    """The matrix ``(..., n, m)`` with zeros below, in so many rows."""
    *batch, n, columns = matrix.shape
    return np.concatenate([matrix, np.zeros((*batch, rows - n, columns))], -2)


def _measured(space: StateSpace, size: int) -> np.ndarray:
    """C ``(p, size)``.

    Raises:
        ValueError: for a sensor that is not linear.
    """
    nothing = space.measurement(np.zeros(size))
    C, x = (space.measurement(np.eye(size)) - nothing).T, np.linspace(-1.0, 2.0, size)
    error = np.abs(space.measurement(x) - nothing - C @ x)
    wrong = error > 1e-9 * (1.0 + np.abs(C) @ np.abs(x))
    _check_linear(space, wrong, "in what the filter estimates")
    return C


def _check_linear(space: StateSpace, wrong: np.ndarray, where: str) -> None:
    """Refuse a sensor of whose channels some are ``wrong (p,)``.

    Raises:
        ValueError: naming the sensor.
    """
    if wrong.any():
        raise ValueError(
            f"{space.sensors.of_channel(np.argmax(wrong)).name} is not linear {where}: choose a"
            " filter for nonlinear models"
        )
