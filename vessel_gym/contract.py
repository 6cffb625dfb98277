"""Check of a system of one's own, as Gymnasium's ``check_env`` checks environments.

::

    from vessel_gym import check_system

    check_system(system)  # silent, or one sentence: what is wrong, and what to do
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from estimators import Gaussian
from estimators.checks import frozen, short_repr
from estimators.engine import Compiled, compiled
from estimators.factory import unknown
from vessel_gym.checks import check_names, instance, is_compiled, options
from vessel_gym.disturbances import Disturbance
from vessel_gym.models.state_space import force_names
from vessel_gym.system import Estimate, System, Task, Vehicle

_ROWS = 3
_STEP = np.arange(1, 1 + _ROWS)
_SAME = 1e-9
"""Largest difference between two ways to compute a number, relative to the largest entry."""
_Shape = tuple[int | None, ...]
_ANY: _Shape = (None,)
_NUMBER: _Shape = ()
"""Shapes of a row of a result: any number of columns, and one number."""


def check_system(system: System) -> None:
    """Try each method of a system's parts on three vehicles, and say what is wrong with it.

    The parts are the vehicle, the disturbances, the sensors and the task. A method must give a row
    for each vehicle, the row that it gives a vehicle alone, and finite numbers. It must repeat
    itself and leave its arguments as they are. A method that is compiled, or of a class that is,
    must give what it gives in NumPy.

    Raises:
        ValueError: in one sentence, for the first fault found.
        TypeError: for no system, names or rates of another type, or a prior that is no
            `estimators.Gaussian`.
    """
    instance("system", system, System)
    vehicle, task = system.vehicle, system.task
    what, uniforms = f"scenario of {type(task).__name__}", _uniforms(task.uniforms)
    (scenario,) = _checked(what, lambda u: task.scenario(u, {}), [uniforms], _ANY)
    x, reference = _check_reference(task, scenario, vehicle)
    commanded = task.commanded(scenario, _STEP, reference)
    state, actuators, exogenous = _check_vehicle(vehicle, commanded)
    for disturbance in system.disturbances.values():
        _check_disturbance(disturbance, vehicle, state)
    for sensor in system.nominal_sensors:
        check, channels = partial(_checked, any_axes=True), (len(sensor.channels),)
        (y,) = check(f"reads of {sensor.name}", sensor.reads, [state, exogenous], channels)
        if callable(sensor.sd):
            (sd,) = check(f"sd of {sensor.name}", sensor.sd, [y], channels)
            if (sd < 0.0).any():
                raise ValueError(f"sd of {sensor.name} must give numbers of at least 0")
    _check_task(task, vehicle, (scenario, reference, x), state, actuators, exogenous)


# --- the parts ------------------------------------------------------------------------------------


def _uniforms(columns: int) -> np.ndarray:
    """Random numbers in [0, 1], a row for each vehicle."""
    return np.random.default_rng(0).uniform(size=(_ROWS, columns))


def _check_angles(vehicle: Vehicle) -> None:
    """Refuse angles and rates that are no states of the vehicle."""
    who, states = type(vehicle).__name__, vehicle.state_names
    check_names(f"angles of {who}", vehicle.angles)
    rates = options(f"rates of {who}", vehicle.rates)
    for attribute, names in ("angles", vehicle.angles), ("rates", (*rates, *rates.values())):
        for name in {*names} - {*states}:
            raise ValueError(
                unknown("state", name, states, f"{attribute} of {who} have the unknown")
            )


def _check_vehicle(vehicle: Vehicle, commanded: np.ndarray | None) -> tuple[np.ndarray, ...]:
    """Check a vehicle; states, actuators and exogenous inputs of three vehicles."""
    _check_angles(vehicle)
    tried = partial(_tried, vehicle)
    cruise, u = (np.asarray(each, float) for each in vehicle.cruise)
    size, width = len(vehicle.state_names), len(vehicle.parameter_names)
    x = cruise + 0.01 * _uniforms(len(cruise))
    state, before = tried("start", [x], (size,), _ANY)
    action = _uniforms(len(vehicle.action_names))
    (after,) = tried("actuate", [before, action], before.shape[1:])
    (known,) = tried("known_input", [before, after, commanded], u.shape)
    what, normals = f"parameters of {type(vehicle).__name__}", _uniforms(vehicle.normals)
    (parameters,) = _checked(what, lambda u: vehicle.parameters(0.1, u), [normals], (width,))
    first = len(vehicle.increments)
    exogenous = 0.01 * _uniforms(first + len(vehicle.ambient_flows))
    (state,) = tried("step", [state, before, after, exogenous, parameters], (size,))
    tried("drift", [x, known, exogenous[:, first:]], cruise.shape, any_axes=True)
    return state, after, exogenous


def _check_disturbance(disturbance: Disturbance, vehicle: Vehicle, state: np.ndarray) -> None:
    """Check attributes and methods of a disturbance."""
    for sentence in _contradictions(disturbance, vehicle):
        raise ValueError(sentence)
    tried, shape = partial(_tried, disturbance), (len(disturbance.forces),)
    root = disturbance.process.start_root
    z = _uniforms(root.shape[1]) @ root.T
    tried("effect", [z, state], shape, any_axes=True)
    tried("met", [z, state, state + 0.01], z.shape[1:], any_axes=True)
    if disturbance.uniforms:
        (constants,) = tried("draw", [_uniforms(disturbance.uniforms)], _ANY)
        tried("effect_at", [constants, np.arange(_ROWS) * vehicle.dt, z, state], shape)


def _contradictions(disturbance: Disturbance, vehicle: Vehicle) -> Iterator[str]:
    """Sentences about attributes of a disturbance that contradict each other or the vehicle."""
    who, names, process = type(disturbance).__name__, disturbance.names, disturbance.process
    forces, white = disturbance.forces, disturbance.white_increments
    for attribute, known in (
        ("forces", force_names(vehicle)), ("averaged", forces),
        ("white_increments", [name for name in vehicle.increments if name not in forces]),
        ("inputs", (*forces, *white)),
    ):  # fmt: skip
        given: Any = getattr(disturbance, attribute) or ()
        if not {*given} <= {*known} or len({*given}) < len(given):
            wanted = f"a tuple of different names from {', '.join(known)}"
            yield f"{attribute} of {who} must be {wanted}, got {short_repr(given)}"
    if {*names} & {*vehicle.state_names}:
        yield f"names of {who} must differ from the vehicle's states, got {short_repr(names)}"
    for attribute, size in ("names", process.size), ("scale", process.size), ("white", len(white)):
        given = getattr(disturbance, attribute)
        if given is not None and len(given) != size:
            yield f"{attribute} of {who} must have {size} entries, got {short_repr(given)}"
    owners = [
        next(each for each in type(disturbance).__mro__ if name in vars(each))
        for name in ("effect", "effect_at")
    ]
    if owners[0] is not owners[1] and issubclass(*owners) and owners[1] is not Disturbance:
        yield f"effect of {who} is not used, as it acts by effect_at: override that"
    modulus = np.abs(np.linalg.eigvals(process.transition)).max(initial=0.0)
    if modulus > 1.0 + 1e-6:
        yield f"process of {who} grows by a factor of {modulus:.3g} a step: 1 is the most"


def _check_reference(
    task: Task, scenario: np.ndarray, vehicle: Vehicle
) -> tuple[np.ndarray, np.ndarray]:
    """Check a task's prior and reference; states near the prior's mean, and references there."""
    who = type(task).__name__
    prior = task.prior(frozen(scenario))
    if not isinstance(prior, Gaussian):
        raise TypeError(f"prior of {who} must give a Gaussian, got {short_repr(prior)}")
    n, what = len(vehicle.estimated(vehicle.kinds[0])), f"the mean of prior of {who}"
    (x,) = _checked(what, lambda scenario: task.prior(scenario).mean, [scenario], (n,))
    if (size := np.shape(prior.cov)[-1]) != n:
        raise ValueError(f"prior of {who} must have a covariance of {n} rows, got {size}")
    x = x + 0.01 * _uniforms(n)  # so that rows differ without a drawn scenario, too
    (reference,) = _tried(task, "reference", [scenario, _STEP, x], _ANY)
    return x, reference


def _check_task(
    task: Task, vehicle: Vehicle, mission: tuple[np.ndarray, ...], state: np.ndarray,
    actuators: np.ndarray, exogenous: np.ndarray,
) -> None:  # fmt: skip
    """Check the other methods of a task, for a mission of scenarios, references and states x."""
    tried, who, (scenario, reference, x) = partial(_tried, task), type(task).__name__, mission
    for name, arguments, shape in (
        ("commanded", [scenario, _STEP, reference], _ANY),
        ("exogenous", [scenario, _STEP], exogenous.shape[1:]),
    ):
        if getattr(task, name)(*arguments) is not None:
            tried(name, arguments, shape)
    (score_state,) = tried("initial_score_state", [state, scenario], _ANY)
    (over,) = tried("over", [scenario, reference], _NUMBER)
    scored = [
        state, exogenous, scenario, reference, over, actuators,
        _uniforms(len(vehicle.action_names)), score_state,
    ]  # fmt: skip
    _, end, _ = tried("score", scored, _NUMBER, _NUMBER, score_state.shape[1:])
    if not np.isin(end, np.arange(len(task.end_reasons))).all():
        raise ValueError(
            f"score of {who} must give numbers of end_reasons, whole and below"
            f" {len(task.end_reasons)}, got {short_repr(end.tolist())}"
        )
    tried("observe_mission", [scenario, _STEP, actuators], _ANY)
    estimated = [x, exogenous[:, len(vehicle.increments) :], scenario]
    for name, more in ("observe_state", []), ("observe", [reference, actuators]):
        method = partial(_of_estimate, getattr(task, name))
        compiles = name == "observe" and is_compiled(task)
        _checked(f"{name} of {who}", method, [*estimated, *more], _ANY, compiles=compiles)


def _of_estimate(
    method: Callable[..., np.ndarray], x: np.ndarray, flow: np.ndarray, *seen: np.ndarray
) -> np.ndarray:
    """Result of a task's method of an estimate."""
    return method(Estimate(x, flow), *seen)


# --- a method -------------------------------------------------------------------------------------


def _tried(
    part: object, name: str, arguments: Sequence[Any], *shapes: _Shape, any_axes: bool = False
) -> tuple[np.ndarray, ...]:
    """Results of a part's method, checked."""
    what = f"{name} of {type(part).__name__}"
    return _checked(what, getattr(part, name), arguments, *shapes, any_axes=any_axes)


def _checked(
    what: str, method: Callable[..., Any], arguments: Sequence[Any], *shapes: _Shape,
    any_axes: bool = False, compiles: bool | None = None,
) -> tuple[np.ndarray, ...]:  # fmt: skip
    """Results of a method for three vehicles, checked as `check_system` says.

    Args:
        what: Name of the method, for error messages.
        method: Function of arrays.
        arguments: Arrays with a row for each vehicle, or None.
        shapes: Shape of a row of each result.
        any_axes: Must the method take any leading axes, as filters try vehicles at several points?
        compiles: Is the method compiled? None: if it, or its class, is decorated so.
    """
    plain = method.function if isinstance(method, Compiled) else method
    found = _results(what, plain, arguments, shapes)
    _compare(
        found, _results(what, plain, arguments, shapes), 0.0,
        f"{what} gave two values for the same arguments: it must depend on these alone, without"
        " random numbers, clocks or counters of its own",
    )  # fmt: skip
    kept = tuple(each.copy() for each in found)
    for rows in [slice(None, None, -1), *(slice(row, row + 1) for row in range(_ROWS))]:
        some = [each if each is None else each[rows] for each in arguments]
        _compare(
            [each[rows] for each in kept], _results(what, plain, some, shapes), _SAME,
            f"{what} gives a vehicle alone other numbers than in a batch: rows must share nothing,"
            " so compute along the last axis, as by np.sum(x, -1)",
        )  # fmt: skip
    _compare(
        found, kept, 0.0,
        f"{what} writes into an array that it has given before: it must give a new one each time",
    )  # fmt: skip
    if any_axes:
        title = f"{what} must take any leading axes, so index from behind, by x[..., i]: it"
        pairs = [each if each is None else np.stack([each, each]) for each in arguments]
        twice = [np.stack([each, each]) for each in found]
        given = _results(title, plain, pairs, shapes)
        _compare(given, twice, _SAME, f"{title} gives other numbers for two axes")
    if is_compiled(method) if compiles is None else compiles:
        axes = [0 if each is None else each.ndim - 1 for each in arguments]
        traced = method if isinstance(method, Compiled) else compiled(method, axes=axes)
        _compare(
            found, _results(f"{what}, compiled,", traced, arguments, shapes), _SAME,
            f"{what} gives other numbers compiled than in NumPy: it is traced once, so it must"
            " depend on its arguments and constants alone; or leave out @compiled",
        )  # fmt: skip
    return found


def _results(
    what: str, method: Callable[..., Any], arguments: Sequence[Any], shapes: Sequence[_Shape]
) -> tuple[np.ndarray, ...]:
    """Results of a method of read-only arguments, an array of finite numbers of each shape.

    Raises:
        ValueError: if the method fails, or a result is another one.
    """
    given: list[Any] = [None if each is None else frozen(np.array(each)) for each in arguments]
    leading = given[0].shape[:-1]
    many = " x ".join(map(str, leading))
    try:
        with np.errstate(all="ignore"):
            returned = method(*given)
    except Exception as error:
        advice = "write it for any number of rows, with np.where for if and & for and"
        if "read-only" in str(error):
            advice = "its arguments may only be read, so compute a new array"
        if what.endswith("compiled,"):
            advice = "use what docs/engine.md lists, or leave out @compiled"
        reason = f"{type(error).__name__}: {short_repr(str(error))}"
        raise ValueError(f"{what} fails for {many} vehicles ({reason}): {advice}") from error
    results = returned if isinstance(returned, tuple) else (returned,)
    if len(results) != len(shapes):
        raise ValueError(f"{what} must give {len(shapes)} arrays, got {short_repr(returned)}")
    for array, shape in zip(results, shapes, strict=True):
        if not (isinstance(array, np.ndarray) and array.dtype.kind in "fiub"):
            raise ValueError(f"{what} must give arrays of real numbers, got {short_repr(array)}")
        row = array.shape[-1:] if shape == _ANY else shape
        if array.shape != (*leading, *row):
            wanted = "a row of numbers" if shape == _ANY else f"numbers of shape {shape}"
            raise ValueError(
                f"{what} must give {wanted} for each vehicle: for {many} it gave shape"
                f" {array.shape}"
            )
        if not np.isfinite(array).all():
            raise ValueError(
                f"{what} gave {short_repr(array.tolist())} in ordinary motion: it must give finite"
                " numbers"
            )
    return tuple(results)


def _compare(
    one: Sequence[np.ndarray], other: Sequence[np.ndarray], tolerance: float, sentence: str
) -> None:
    """Refuse results that differ by more than ``tolerance`` of the largest entry.

    Raises:
        ValueError: with the sentence.
    """
    for a, b in zip(one, other, strict=True):
        scale = np.abs(b).max(initial=1.0)
        if not (np.abs(1.0 * a - b) <= tolerance * scale).all():
            raise ValueError(sentence)
