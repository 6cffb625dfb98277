"""What a filter knows of the world: a prior, a linear model, a nonlinear model.

Notation throughout: ``x+ = A x + B u + G d + w`` and ``y = C x + H d + v`` with ``w ~ N(0, Q)``,
``v ~ N(0, R)`` and ``d`` unknown; n states, m known inputs, q unknown inputs, p measurements.
"""

import logging
import math
import operator
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache, partial
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import expm

from estimators.angles import difference, short_way
from estimators.checks import Written, as_array, call, finite_array, frozen, number, read_only, shown, whole
from estimators.engine.compiled import Compiled, compiled
from estimators.engine.derivative import linearise
from estimators.engine.foreign import Inspection, inspect
from estimators.engine.matrices import columnwise, is_traced, lookup_matrix, matrix
from estimators.linalg import congruence, joined, neutralised

_log = logging.getLogger(__name__)

Matrix = np.ndarray | Callable[[np.ndarray | None], np.ndarray]
StateMatrix = np.ndarray | Callable[[np.ndarray, np.ndarray | None], np.ndarray]


def resolve(matrix: Matrix, u: np.ndarray | None) -> np.ndarray:
    """The matrix itself, or its value at the known input ``u`` when it is a function of it."""
    if not callable(matrix):
        return matrix
    if is_traced(u):
        program: Any = u.program  # type: ignore[union-attr]
        return (
            matrix.traced(u)
            if isinstance(matrix, Schedule)
            else program.callback(lambda belief, u, R: resolve(matrix, u), 2)
        )
    return matrix(u) if isinstance(matrix, Schedule) else call(getattr(matrix, "name", "a matrix"), matrix, u)


class Frozen:
    """A record whose arrays are read-only; those of its copies and pickles, too."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update({name: frozen(v) if isinstance(v, np.ndarray) else v for name, v in state.items()})


@dataclass(frozen=True, eq=False)
class Schedule(Frozen):
    """A matrix that follows one component of the known input: the entry of a table that is nearest.

    Args:
        table: ``(k, n, m)``.
        component: Which component of ``u``.
        scale: Entries to a unit of it.
        middle: The entry at 0, and half of one more.
    """

    table: np.ndarray
    component: int
    scale: float
    middle: float

    def __post_init__(self) -> None:
        table = finite_array("table", self.table, "k", "n", "m")
        if not len(table):
            raise ValueError("table must have at least one entry, got none")
        object.__setattr__(self, "table", frozen(table))
        object.__setattr__(self, "component", whole("component", self.component, 0))
        for name in ("scale", "middle"):
            object.__setattr__(self, name, number(name, getattr(self, name), what="a finite number"))

    def __call__(self, u: np.ndarray | None) -> np.ndarray:
        """The matrices ``(..., n, m)`` at ``u (..., k)``."""
        if u is None:
            raise ValueError(f"this model needs a known input u: its matrices follow component {self.component} of it")
        index = self._index(u)
        within = np.fmin(np.fmax(index, 0.0), len(self.table) - 1.0)  # the first entry where u is not a number
        return self.table.take(within.astype(np.intp), axis=0)

    def follows(self, other: "Schedule") -> bool:
        """Whether both tables have the same entry at every known input."""
        mine, theirs = ((len(s.table), s.component, s.scale, s.middle) for s in (self, other))
        return mine == theirs

    def traced(self, u: Any) -> Any:
        """The same where a formula is traced."""
        return lookup_matrix(self.table, self._index(u))

    def _index(self, u: Any) -> Any:
        """Places in the table ``(...)`` of known inputs ``(..., k)``."""
        if self.component >= u.shape[-1]:
            raise ValueError(f"matrices follow component {self.component} of the known input, but u has {u.shape[-1]}")
        return u[..., self.component] * self.scale + self.middle


@dataclass(frozen=True, eq=False)
class StateNoise:
    """A measurement noise covariance that follows the state: filters take it at the predicted mean.

    Args:
        function: ``R(x, u) -> (..., p, p)``.
        nominal: ``(p, p)``, where no state is at hand.
    """

    function: Callable[[np.ndarray, np.ndarray | None], np.ndarray]
    nominal: np.ndarray

    def __call__(self, u: np.ndarray | None) -> np.ndarray:
        """The nominal one, whatever the known input."""
        return self.nominal

    def changed(self, change: Callable[[np.ndarray], np.ndarray]) -> "StateNoise":
        """A function of this one, such as its double."""
        return StateNoise(lambda x, u: change(self.function(x, u)), change(self.nominal))


def noise_at(R: Matrix, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    """The measurement noise covariance ``(..., p, p)`` of a model at states ``(..., n)``."""
    if not isinstance(R, StateNoise):
        return resolve(R, u)
    with np.errstate(all="ignore"):
        return R.function(x, u)


@dataclass(frozen=True, eq=False)
class Gaussian(Frozen):
    """A mean ``(..., n)`` and a covariance ``(..., n, n)`` that broadcast against each other.

    Two are equal if their arrays are.

    Raises:
        ValueError: if the shapes do not fit or the covariance is not positive semidefinite.
    """

    mean: np.ndarray
    cov: np.ndarray
    _vector: ClassVar[bool] = True

    def __post_init__(self) -> None:
        mean = as_array("mean", self.mean)
        cov = as_covariance("cov", self.cov)
        if mean.ndim < 1 or (self._vector and mean.shape[-1] != cov.shape[-1]):
            raise ValueError(f"mean has shape {mean.shape}, but cov {cov.shape} is for a vector of {cov.shape[-1]}")
        if not np.isfinite(mean).all():
            raise ValueError("mean must be finite")
        try:
            np.broadcast_shapes(mean.shape[:-1], cov.shape[:-2])
        except ValueError:
            raise ValueError(f"mean has shape {mean.shape} and cov {cov.shape}: their rows do not fit") from None
        object.__setattr__(self, "mean", frozen(mean))
        object.__setattr__(self, "cov", frozen(cov))

    def about(self, mean: np.ndarray) -> "Gaussian":
        """The same covariance about other means ``(..., n)``, which are not looked at."""
        moved = object.__new__(type(self))
        object.__setattr__(moved, "mean", mean)
        object.__setattr__(moved, "cov", self.cov)
        return moved

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Gaussian):
            return NotImplemented
        return np.array_equal(self.mean, other.mean) and np.array_equal(self.cov, other.cov)


@dataclass(frozen=True, eq=False)
class ManifoldGaussian(Gaussian):
    """A state ``(..., nx)`` that is no vector, and the covariance ``(..., n, n)`` of its error, which is one.

    What the error of a state is, a model says (`NonlinearModel.difference`); it may have fewer numbers than the state.
    """

    _vector = False


@dataclass(frozen=True, eq=False)
class LinearModel(Frozen):
    """``x+ = A x + B u + G d + w``, ``y = C x + H d + v``.

    Every matrix is an array, possibly with leading batch axes, or a function of ``u``, which then holds
    the control and whatever else is known (a gain schedule, say). Functions are checked when first called. They must be
    pure: the same ``u`` gives the same matrix, so time enters as a component of ``u``, not as a clock that is read.

    A model is immutable, and its arrays are read-only copies: build another with
    ``dataclasses.replace(model, A=...)``, and a filter of it.

    Args:
        A: ``(..., n, n)`` transition.
        C: ``(..., p, n)`` measurement.
        Q: ``(..., n, n)`` process noise covariance, positive semidefinite.
        R: ``(..., p, p)`` measurement noise covariance, positive semidefinite.
        B: ``(..., n, m)`` known input, or None when ``u`` does not enter the state.
        G: ``(..., n, q)`` unknown input to the state.
        H: ``(..., p, q)`` unknown input to the measurement (direct feedthrough).
        state_angles: indices of states that are angles.
        measurement_angles: indices of measurements that are angles; their innovation is wrapped.

    Raises:
        ValueError: naming the argument whose shape or definiteness is wrong.
    """

    A: Matrix
    C: Matrix
    Q: Matrix
    R: Matrix
    B: Matrix | None = None
    G: Matrix | None = None
    H: Matrix | None = None
    state_angles: tuple[int, ...] = ()
    measurement_angles: tuple[int, ...] = ()
    n: int = field(init=False)
    p: int = field(init=False)
    q: int = field(init=False)

    def __post_init__(self) -> None:
        for name in "AC":
            if getattr(self, name) is None:
                raise ValueError(f"{name} must be a matrix or a function of u, got None")
        _store_arrays(self, "ACBGH")
        n = _dimension("n", {"A": (self.A, -1), "Q": (self.Q, -1), "C": (self.C, -1), "G": (self.G, -2)})
        p = _dimension("p", {"C": (self.C, -2), "R": (self.R, -1), "H": (self.H, -2)})
        q = _unknown_inputs(self, n, p)
        _check_shapes({"A": (self.A, n, n), "C": (self.C, p, n), "B": (self.B, n, None), "G": (self.G, n, q),
                       "H": (self.H, p, q), "Q": (self.Q, n, n), "R": (self.R, p, p)})  # fmt: skip
        for name, shape in {"A": (n, n), "B": (n,), "C": (p, n), "G": (n, q), "H": (p, q)}.items():
            _check_when_called(self, name, shape)
        _check_noise_when_called(self, n, p)
        _store_sizes(self, n, p, q)

    def check_known_input(self, u: np.ndarray | None) -> None:
        """Refuse a known input that could only be ignored, or that B expects and does not get.

        Raises:
            ValueError: saying which.
        """
        expected = self.B.shape[-1] if isinstance(self.B, np.ndarray) else None
        if u is None:
            if self.B is not None and expected != 0:
                raise ValueError("the model has B: give the known input u")
            return
        if expected is not None and u.shape[-1] != expected:
            raise ValueError(f"u has {u.shape[-1]} components, B is for {expected}")
        if self.B is None and not any(callable(getattr(self, name)) for name in "ACGHQR"):
            raise ValueError("u was given, but the model has no B and no matrix that depends on u")

    def transition(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """``A x + B u``: the next state without the unknown input and noise; ``x`` is ``(..., n)``."""
        return self.linearise_transition(x, u)[0]

    def measurement(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """``C x``: the reading expected without unknown input and noise."""
        return np.matvec(resolve(self.C, u), x)

    def input_matrix(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """G ``(..., n, q)``: how the unknown input moves the next state."""
        assert self.G is not None, "the model has no unknown input"
        return resolve(self.G, u)

    def linearise_transition(
        self, x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The next state ``(..., n)`` and the Jacobian ``A (..., n, n)``, whatever the belief's covariance."""
        A = resolve(self.A, u)
        mean = np.matvec(A, x)
        if self.B is not None and u is not None:
            mean = mean + np.matvec(resolve(self.B, u), u)
        return mean, A

    def linearise_measurement(
        self, x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The expected reading ``(..., p)`` and the Jacobian ``C (..., p, n)``, whatever the belief's covariance."""
        C = resolve(self.C, u)
        return np.matvec(C, x), C


@dataclass(frozen=True, eq=False)
class NonlinearModel(Frozen):
    """``x+ = f(x, u) + G d + w``, ``y = h(x, u) + H d + v``.

    Args:
        transition: ``f(x, u) -> (..., n)``; must broadcast over leading axes of ``x`` and ``u``.
        measurement: ``h(x, u) -> (..., p)``; likewise.
        Q: ``(..., n, n)`` process noise covariance, or a function of ``u``.
        R: ``(..., p, p)`` measurement noise covariance, or a function of ``u``.
        G: ``(..., n, q)`` unknown input to the state, ``df/dd``, or a function of ``(x, u)`` that broadcasts; then
            give H, zero if need be, to tell how many unknown inputs there are.
        H: ``(..., p, q)`` unknown input to the measurement, or a function of ``u``.
        state_angles: indices of states that are angles; the transition may wrap them.
        measurement_angles: indices of measurements that are angles; likewise.
        transition_jacobian: ``df/dx (x, u) -> (..., n, n)``; None: exact where f can be traced, else by differences.
        measurement_jacobian: ``dh/dx (x, u) -> (..., p, n)``; None: likewise.
        states: n, where Q and G are functions, and Q has no value at ``u = None`` that would tell.
        measurements: p, where R and H are functions, likewise.
        difference: ``e(a, b) -> (..., n)``, the error of ``b (..., nx)`` where ``a (..., nx)`` is true, for states that
            are no vectors, as attitudes are; it broadcasts, and ``sum`` is its inverse. n is then the size of the
            error, Q its noise, and Jacobians are by errors. None: states are vectors, but for their angles.
        sum: ``x(b, e) -> (..., nx)``, the state that is the error ``e (..., n)`` away from b; likewise.

    A Jacobian of your own is compared with differences when it is first used. Functions must be pure, as those of a
    `LinearModel`, and may only read their arguments; the model is immutable likewise.

    Raises:
        ValueError: naming the argument whose shape or definiteness is wrong.
    """

    transition: Callable[[np.ndarray, np.ndarray | None], np.ndarray]
    measurement: Callable[[np.ndarray, np.ndarray | None], np.ndarray]
    Q: Matrix
    R: Matrix
    G: StateMatrix | None = None
    H: Matrix | None = None
    state_angles: tuple[int, ...] = ()
    measurement_angles: tuple[int, ...] = ()
    transition_jacobian: Callable[[np.ndarray, np.ndarray | None], np.ndarray] | None = None
    measurement_jacobian: Callable[[np.ndarray, np.ndarray | None], np.ndarray] | None = None
    states: int | None = None
    measurements: int | None = None
    difference: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    sum: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    n: int = field(init=False)
    p: int = field(init=False)
    q: int = field(init=False)
    _compared: set[str] = field(init=False, repr=False, default_factory=set)

    def __post_init__(self) -> None:
        for name in ("transition", "measurement", "transition_jacobian", "measurement_jacobian"):
            function = getattr(self, name)
            if not callable(function) and not (function is None and name.endswith("jacobian")):
                raise ValueError(f"{name} must be a function of (x, u), got {shown(function)}")
        if (self.difference is None) != (self.sum is None):
            raise ValueError("difference and sum belong together: give both, or neither")
        if self.difference is not None and self.state_angles:
            raise ValueError("difference and sum say what errors of angles are: leave state_angles out")
        _store_arrays(self, "GH")
        n = _told("states", self.states, {"Q": (self.Q, -1), "G": (self.G, -2)})
        p = _told("measurements", self.measurements, {"R": (self.R, -1), "H": (self.H, -2)})
        q = _unknown_inputs(self, n, p)
        _check_shapes({"G": (self.G, n, q), "H": (self.H, p, q), "Q": (self.Q, n, n), "R": (self.R, p, p)})
        _check_when_called(self, "H", (p, q))
        _check_noise_when_called(self, n, p)
        _store_sizes(self, n, p, q)

    def check_known_input(self, u: np.ndarray | None) -> None:
        """Nothing to refuse: what the functions make of ``u`` is theirs."""

    def traceable(self, name: str, x: np.ndarray, u: np.ndarray | None) -> Compiled | Inspection | None:
        """Its transition or measurement, if it can be traced into a filter's program with its derivative; else None.

        Args:
            name: The function's.
            x: ``(..., n)`` where it is tried,
            u: and ``(..., m)``.
        """
        if self.difference is not None or getattr(self, f"{name}_jacobian") is not None:
            return None
        return inspected(getattr(self, name), x, u)

    def source(self, name: str, x: np.ndarray, u: np.ndarray | None) -> "Function":
        """Its transition or measurement as it is traced; `traceable` has been asked."""
        function = getattr(self, name)
        if isinstance(function, Compiled):
            return function
        inlined: Any = _inspections[function][_sizes(x, u)].inline
        return inlined

    def input_matrix(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """G ``(..., n, q)``: how the unknown input moves the next state from ``x (..., n)``.

        Raises:
            ValueError: if G is a function whose value has another shape.
        """
        assert self.G is not None, "the model has no unknown input"
        if not callable(self.G):
            return self.G
        if is_traced(x):  # the mean of the belief that a program is executed on
            program: Any = x.program  # type: ignore[attr-defined]
            traced: np.ndarray = program.callback(lambda belief, u, R: self.input_matrix(belief.mean, u), 2)
            return traced
        G = np.asarray(call("G", self.G, x, u))
        if G.shape[-2:] != (self.n, self.q):
            raise ValueError(f"G gave a matrix of shape {G.shape}, expected (..., {self.n}, {self.q})")
        return G

    def linearise_transition(
        self, x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """``f(x, u)`` and its Jacobian ``(..., n, n)``; the steps of differences follow x's covariance."""
        return self._linearise("transition", self.n, self.state_angles, x, u, cov)

    def linearise_measurement(
        self, x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """``h(x, u)`` and its Jacobian ``(..., p, n)``; otherwise as `linearise_transition`."""
        return self._linearise("measurement", self.p, self.measurement_angles, x, u, cov)

    def _linearise(
        self, name: str, size: int, angles: tuple[int, ...], x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        function, own = getattr(self, name), getattr(self, f"{name}_jacobian")
        if is_traced(x):
            program: Any = x.program  # type: ignore[attr-defined]
            return tuple(matrix(program, each) for each in linearise(self.source(name, x, u), x, u))
        x = read_only(x)
        if self.difference is not None:
            return self._linearise_errors(name, size, angles, x, u, cov)
        if own is None:
            traced = self.traceable(name, x, u)
            if traced is not None:
                return derivative(traced)(x, u)
            return central_differences(name, function, x, u, size, angles, steps(x, cov, self.state_angles))
        jacobian = self._own(name, function, size, angles, x, x, u, cov)
        return at_points(name, function, x[..., None, :], u, size)[..., 0, :], jacobian

    def _own(
        self, name: str, function: "Function", size: int, angles: tuple[int, ...], x: np.ndarray, at: np.ndarray,
        u: np.ndarray | None, cov: np.ndarray | None,
    ) -> np.ndarray:  # fmt: skip
        """The user's Jacobian at the state ``x``, compared when first used with differences of a function at ``at``."""
        jacobian = as_array(f"{name}_jacobian", call(f"{name}_jacobian", getattr(self, f"{name}_jacobian"), x, u))
        expected = x.shape[:-1] + (size, self.n)
        if jacobian.shape != expected:
            if jacobian.shape[-2:] != expected[-2:]:
                raise ValueError(f"{name}_jacobian gave a matrix of shape {jacobian.shape}, expected {expected}")
            jacobian = np.broadcast_to(jacobian, expected)
        if name not in self._compared:
            _compare(name, function, jacobian, at, u, angles, steps(at, cov, self.state_angles))
            if np.isfinite(jacobian).all():  # else it is compared again where it is
                self._compared.add(name)
        return jacobian

    def _linearise_errors(
        self, name: str, size: int, angles: tuple[int, ...], x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """A function of the model at a state, and the Jacobian of its error, or of a reading, by the state's error."""
        function, moved, none = getattr(self, name), name == "transition", np.zeros(x.shape[:-1] + (self.n,))
        value = np.asarray(call(name, function, x, u))

        def of_errors(e: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            assert self.sum is not None
            assert self.difference is not None
            after = np.asarray(call(name, function, self.sum(x[..., None, :], e), u))
            return self.difference(after, value[..., None, :]) if moved else after

        if getattr(self, f"{name}_jacobian") is not None:
            return value, self._own(name, of_errors, size, angles, x, none, u, cov)
        return value, central_differences(name, of_errors, none, u, size, angles, steps(none, cov))[1]


Function = Callable[[np.ndarray, np.ndarray | None], np.ndarray]
_inspections: dict[Any, dict[Any, Inspection]] = {}
_KEPT = 500
"""Functions whose inspections are kept; of more, the oldest are inspected anew when they are next used."""


def inspected(function: Function, x: np.ndarray, u: np.ndarray | None) -> Compiled | Inspection | None:
    """What runs compiled in the place of a model's function; None for one that only NumPy can compute.

    What is `estimators.engine.compiled` declares itself pure. Any other function is inspected when it is first used,
    and again when something that it reads has changed; why it is not traceable stands in the log.
    """
    if isinstance(function, Compiled):
        return function
    try:
        if function not in _inspections and len(_inspections) >= _KEPT:
            del _inspections[next(iter(_inspections))]
        known = _inspections.setdefault(function, {})
    except TypeError:  # it can be no key
        return None
    key = _sizes(x, u)
    if key not in known or (known[key].traceable and not known[key].unchanged()):
        if u is None:
            known[key] = inspect(lambda x, u=None: function(x, u), x)
        else:
            known[key] = inspect(function, x, u)
        if not known[key].traceable:
            _log.info("%s runs in NumPy: %s", getattr(function, "__name__", "a function"), known[key].reason)
    return known[key] if known[key].traceable else None


def _sizes(x: np.ndarray, u: np.ndarray | None) -> tuple[int, int | None]:
    return x.shape[-1], None if u is None else u.shape[-1]


def derivative(function: Compiled | Inspection) -> Compiled:
    """A function's value ``(..., k)`` and exact Jacobian ``(..., k, n)`` at points ``(..., n)``, compiled."""
    known: Compiled | None = vars(function).get("derivative")
    if known is None:
        source = function.function if isinstance(function, Compiled) else function.inline
        known = vars(function)["derivative"] = compiled(partial(linearise, source))
    return known


def at_columns(name: str, function: Function, points: np.ndarray, u: np.ndarray | None, size: int) -> np.ndarray:
    """The same of points that are columns ``(..., n, N)``: values ``(..., size, N)``, contiguous."""
    traced = inspected(function, points[..., 0], u)
    if traced is None:
        return np.ascontiguousarray(at_points(name, function, points.mT, u, size).mT)
    known: Compiled | None = vars(traced).get("columnwise")
    if known is None:
        source = traced.function if isinstance(traced, Compiled) else traced.inline
        known = vars(traced)["columnwise"] = compiled(partial(columnwise, source), axes=(2, 1), matrices=True)
    return known(points, u)


def at_points(name: str, function: Function, points: np.ndarray, u: np.ndarray | None, size: int) -> np.ndarray:
    """A model's function at several points of every row.

    Args:
        name: The function's name in the model, for the error.
        function: ``f(x, u)``.
        points: ``(..., k, n)``.
        u: ``(..., m)``, shared by the points of a row.
        size: Components of a value.

    Returns:
        The values ``(..., k, size)``.

    Raises:
        ValueError: if the function does not broadcast over leading axes.
    """
    traced = inspected(function, points, None if u is None else u[..., None, :])
    return _at_points(name, function, points, u, size, traced)[0]


def _at_points(
    name: str, function: Function, points: np.ndarray, u: np.ndarray | None, size: int,
    traced: Compiled | Inspection | None = None,
) -> tuple[np.ndarray, float]:  # fmt: skip
    """The values of `at_points`, and the relative rounding of the type in which the function returned them."""
    expected = points.shape[:-1] + (size,)
    u = None if u is None else u[..., None, :]
    try:
        if traced is not None:
            returned = traced(points) if u is None and isinstance(traced, Inspection) else traced(points, u)
        else:
            returned = call(name, function, points, u)
    except Written:
        raise
    except (ValueError, IndexError) as error:
        raise ValueError(
            f"{name} must broadcast over leading axes, but x of shape {points.shape} ends in: {error}"
        ) from error
    values = as_array(f"what {name} returns", returned)
    if values.shape != expected:
        raise ValueError(
            f"{name} must broadcast over leading axes: "
            f"x of shape {points.shape} gave {values.shape}, expected {expected}"
        )
    kind = values.dtype if values is returned else np.asarray(returned).dtype
    return values, float(np.finfo(kind).eps) if kind in (np.float16, np.float32) else _EPS


def central_differences(
    name: str,
    function: Function,
    x: np.ndarray,
    u: np.ndarray | None,
    size: int,
    angles: tuple[int, ...],
    step: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """``f(x)`` and ``df/dx`` by fourth-order differences of ``step (..., n)``, all columns in one call.

    The second-order ones would turn a rounding of ``f`` in its last digit into 1e-10 of the Jacobian. Components in
    ``angles`` are differenced the short way round, so that it does not matter where ``f`` wraps them.

    Raises:
        ValueError: if ``f`` does not broadcast, or returns fewer digits than float64 has.
    """
    n = x.shape[-1]
    points = _offsets(n) * step[..., None, :]
    points += x[..., None, :]
    values, eps = _at_points(name, function, points, u, size)
    if eps > _EPS:
        raise ValueError(
            f"{name} returns numbers of few digits (float32?), whose differences are mostly rounding: compute it in "
            f"float64, give its Jacobian, or use ukf"
        )
    pairs = values[..., 1:, :].reshape(values.shape[:-2] + (2, 2, n, size))  # near and far, to either side
    change = pairs[..., 0, :, :] - pairs[..., 1, :, :]
    for i in angles:
        change[..., i] = short_way(change[..., i])
    columns, far = change[..., 0, :, :], change[..., 1, :, :]
    columns *= 8.0
    columns -= far
    columns /= 12.0 * step[..., None]
    return values[..., 0, :], columns.mT


@cache
def _offsets(n: int) -> np.ndarray:
    """Where to evaluate, in steps ``(4 n + 1, n)``: at the point, one step to either side, two steps."""
    eye = np.eye(n)
    return np.concatenate([np.zeros((1, n)), eye, -eye, 2.0 * eye, -2.0 * eye])


def steps(x: np.ndarray, cov: np.ndarray | None, angles: tuple[int, ...] = ()) -> np.ndarray:
    """How far to step in each component for a difference ``(..., n)``.

    A share r of the belief's standard deviation, the same for all components: the error of a fourth-order difference,
    ``r^4`` of what bends over a deviation and ``eps F / r`` of rounding, is smallest near ``r = (eps F)^(1/5)``, with F
    the largest state in units of its deviation, since what is computed from states is rounded like them. The step is a
    power of two, so that ``x`` plus the step is exact, and has at least half the digits of ``x``. Where the belief has
    no spread there is no scale to follow; the step is then 2^-10. An angle's is 2^-8 rad at most, however little is
    known of it: a step of several turns could not be told from one of none.

    Args:
        x: ``(..., n)``.
        cov: ``(..., n, n)`` covariance of ``x``; None: no spread.
        angles: Indices of the components that are angles.
    """
    size = np.abs(x)
    if cov is None:
        wanted = np.full(x.shape, 2.0**-10)
    else:
        sd = np.sqrt(np.asarray(cov).diagonal(0, -2, -1))
        spread = sd > 0.0
        everywhere = spread.all()
        deviations = size / sd if everywhere else np.where(spread, size, 0.0) / np.where(spread, sd, 1.0)
        share = np.power(_EPS * np.maximum.reduce(deviations, -1, keepdims=True), 0.2)
        wanted = sd * np.minimum(np.maximum(share, 2.0**-10), 2.0**-3)
        if not everywhere:
            wanted = np.where(spread, wanted, 2.0**-10)
    if angles:
        wanted = np.minimum(wanted, _longest(x.shape[-1], angles))
    return np.ldexp(1.0, np.frexp(np.maximum(wanted, 2.0**-26 * size))[1] - 1)


_EPS = float(np.finfo(float).eps)


@cache
def _longest(n: int, angles: tuple[int, ...]) -> np.ndarray:
    """The longest step in each component ``(n,)``."""
    return np.where(np.isin(np.arange(n), angles), 2.0**-8, np.inf)


def _compare(
    name: str,
    function: Function,
    jacobian: np.ndarray,
    x: np.ndarray,
    u: np.ndarray | None,
    angles: tuple[int, ...],
    step: np.ndarray,
) -> None:
    """Compare a user's Jacobian with differences to either side, between which it must lie where f bends or has a kink.

    A belief may reach much further than f is straight. An entry that differs over ``step (..., n)`` is therefore
    compared over shorter ones, too, and is right if it agrees with one.

    Raises:
        ValueError: naming the entry that differs most, both values, and what to look for.
    """
    offsets = np.concatenate([np.zeros((1, x.shape[-1])), np.eye(x.shape[-1]), -np.eye(x.shape[-1])])
    excess, scale = np.full(jacobian.shape, np.inf), np.zeros(jacobian.shape[:-1] + (1,))
    for shorter in (1.0, 2.0**-10, 2.0**-20):
        change = np.maximum(shorter * step, 2.0**-27 * np.abs(x))[..., None, :]
        values, eps = _at_points(name, function, x[..., None, :] + offsets * change, u, jacobian.shape[-2])
        slopes = difference(values[..., 1:, :], values[..., :1, :], angles).mT / np.concatenate([change, -change], -1)
        forward, backward = np.split(slopes, 2, axis=-1)  # (..., size, n) each
        low, high = np.minimum(forward, backward), np.maximum(forward, backward)
        scale = np.fmax(scale, np.maximum(np.abs(low), np.abs(high)).max(-1, keepdims=True))
        rounding = max(1e-8, 4.0 * eps) * np.abs(values[..., 0, :, None]) / step[..., None, :]
        beyond = np.maximum(low - jacobian, jacobian - high) - 1e-3 * scale - rounding
        excess = np.minimum(excess, np.where(np.isfinite(beyond) & np.isfinite(low + high), beyond, 0.0))
        if (excess <= 0.0).all():
            return
    worst = np.unravel_index(np.argmax(excess / np.where(scale > 0.0, scale, 1.0)), excess.shape)
    i, j = (int(k) for k in worst[-2:])
    raise ValueError(
        f"{name}_jacobian differs from {name}: entry ({i}, {j}) is {jacobian[worst]:.6g}, "
        f"by differences {0.5 * (forward + backward)[worst]:.6g}"
    )


# --- an unknown input as a state --------------------------------------------------------------------


def retimed(model: "LinearModel") -> "LinearModel":
    """The linear model without feedthrough as one with: the input of the step before is taken for that of now.

    With ``x' = x - G d(k-1)`` and ``d' = d(k-1)``: ``x'+ = A x' + A G d' + B u``, ``y = C x' + C G d'``. So a filter
    that needs rank(H) = q takes a model of rank(C G) = q; it estimates x', and calls the input of the step before that
    of now. Exact where G does not change.

    Args:
        model: With unknown inputs and H = 0.

    Raises:
        ValueError: if the model has no unknown input, or one that feeds through.
    """
    G: Any = model.G
    if model.q == 0 or callable(model.H) or np.any(model.H):
        raise ValueError("retimed needs an unknown input without feedthrough: give the model G, and H = 0")
    return LinearModel(
        model.A, model.C, model.Q, model.R, B=model.B,
        G=_assembled(lambda A, G: A @ G, model.A, G), H=_assembled(lambda C, G: C @ G, model.C, G),
        state_angles=model.state_angles, measurement_angles=model.measurement_angles,
    )  # fmt: skip


def stacked(model: "LinearModel | NonlinearModel") -> "LinearModel | NonlinearModel":
    """The model without feedthrough: its unknown input is n + 1 to n + q of the states, and d(k) drives it from k - 1.

    ``(x, d)+ = [A, G; 0, 0] (x, d) + [0; I] d(k+1)`` and ``y = [C, H] (x, d)``. So filters that need H = 0 take a model
    with feedthrough: what they call the input of the step before is the d that acts now. Begin with the input's prior
    beside that of the state.

    Args:
        model: With unknown inputs, and H of rank q if an unbiased filter is to tell them. A Jacobian of your own is
            taken over unless G is a function of the state.

    Raises:
        ValueError: if the model has no unknown input.
    """
    n, p, q = model.n, model.p, model.q
    G: Any = model.G
    H: Any = model.H
    if q == 0:
        raise ValueError("stacked needs an unknown input: give the model G, H or both")
    options: dict[str, Any] = {
        "Q": _assembled(lambda Q: _above(joined([Q, np.zeros((n, q))], -1), q), model.Q), "R": model.R,
        "G": np.eye(n + q, q, -n), "H": np.zeros((p, q)),
        "state_angles": model.state_angles, "measurement_angles": model.measurement_angles,
    }  # fmt: skip
    if isinstance(model, LinearModel):
        return LinearModel(
            _assembled(lambda A, G: _above(joined([A, G], -1), q), model.A, G),
            _assembled(lambda C, H: joined([C, H], -1), model.C, H),
            B=None if model.B is None else _assembled(lambda B: _above(B, q), model.B), **options,
        )  # fmt: skip

    def transition(z: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        x, d = z[..., :n], z[..., n:]
        moved = model.transition(x, u) + np.matvec(model.input_matrix(x, u), d)
        return np.concatenate([moved, np.zeros(moved.shape[:-1] + (q,))], -1)

    def feedthrough(u: np.ndarray | None) -> np.ndarray:
        return resolve(H, u)

    fed = feedthrough if callable(H) else lambda u: H  # which can be traced

    def measurement(z: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        return model.measurement(z[..., :n], u) + np.matvec(fed(u), z[..., n:])

    moves, shows = None if callable(G) else model.transition_jacobian, model.measurement_jacobian
    return NonlinearModel(
        transition, measurement, states=n + q, measurements=p, **options,
        transition_jacobian=moves and (lambda z, u: _above(joined([moves(z[..., :n], u), G], -1), q)),
        measurement_jacobian=shows and (lambda z, u: joined([shows(z[..., :n], u), resolve(H, u)], -1)),
    )  # fmt: skip


def _above(matrix: np.ndarray, q: int) -> np.ndarray:
    """A matrix ``(..., n, m)`` with q rows of zeros below."""
    return joined([matrix, np.zeros((q, matrix.shape[-1]))], -2)


def _assembled(assemble: Callable[..., np.ndarray], *parts: Matrix) -> Matrix:
    """A matrix made of others; a function of u where one of them is, a `Schedule` where they follow the same."""
    functions = [part for part in parts if callable(part)]
    if not functions:
        return assemble(*parts)
    first = functions[0]
    if isinstance(first, Schedule) and all(isinstance(part, Schedule) and part.follows(first) for part in functions):
        return replace(first, table=assemble(*(part.table if isinstance(part, Schedule) else part for part in parts)))
    return lambda u: assemble(*(resolve(part, u) for part in parts))


# --- discretisation ---------------------------------------------------------------------------------


def zero_order_hold(A: np.ndarray, B: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Exact discretisation of ``x' = A x + B u`` with ``u`` held over ``dt`` (batches allowed)."""
    n, m = A.shape[-1], B.shape[-1]
    block = np.zeros(np.broadcast_shapes(A.shape[:-2], B.shape[:-2]) + (n + m, n + m))
    block[..., :n, :n] = A
    block[..., :n, n:] = B
    phi = expm(block * dt)
    return phi[..., :n, :n], phi[..., :n, n:]


def van_loan(A: np.ndarray, G: np.ndarray, Q: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and process noise of ``x' = A x + G w``, white ``w`` of intensity ``Q``, over ``dt``.

    Source: Van Loan (1978), Computing integrals involving the matrix exponential.
    """
    n = A.shape[-1]
    # exp(-A t) is in it, which a fast decay makes huge: over a part of the step, of which two make one twice as long
    halves = max(0, math.ceil(np.log2(np.linalg.norm(A, 1) * dt / 4.0))) if dt > 0.0 and np.any(A) else 0
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n] = -A
    block[:n, n:] = congruence(G, Q)
    block[n:, n:] = A.T
    phi = expm(block * (dt / 2**halves))
    transition = phi[n:, n:].T
    noise = transition @ phi[:n, n:]
    for _ in range(halves):
        noise = congruence(transition, noise) + noise
        transition = transition @ transition
    return transition, 0.5 * (noise + noise.T)


def sampled(
    A: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, B: np.ndarray | None = None,
    state_angles: tuple[int, ...] = (), measurement_angles: tuple[int, ...] = (),
) -> LinearModel:  # fmt: skip
    """The model of ``x' = A x + B u + w``, ``y = C x + v``, read at times that need not be regular.

    How long a step takes is the last component of the known input, where `run` puts it when it is told times; the
    control before it is held over the step.

    Args:
        A: ``(n, n)``, of continuous time.
        C: ``(p, n)``.
        Q: ``(n, n)`` intensity of the white noise w: variance a unit of time.
        R: ``(p, p)`` covariance of a reading.
        B: ``(n, m)``, or None.
        state_angles: As of `LinearModel`.
        measurement_angles: Likewise.

    Raises:
        ValueError: naming the argument whose shape or definiteness is wrong, or later if a step has no length.
    """
    model = LinearModel(A, C, Q, R, B=B, state_angles=state_angles, measurement_angles=measurement_angles)
    rates: Any = model  # which has checked them
    for name in "ACQR" if B is None else "ABCQR":
        if callable(getattr(rates, name)) or getattr(rates, name).ndim > 2:
            raise ValueError(f"{name} of a sampled model must be one matrix, for all rows and times")
    drive = np.zeros((model.n, 0)) if B is None else rates.B
    steps = _Discretisation(rates.A, drive, rates.Q)
    held = {part: _Held(steps, part) for part in "ABQ"}
    return replace(model, A=held["A"], B=held["B"] if drive.size else None, Q=held["Q"])


@dataclass(frozen=True, eq=False)
class _Discretisation:
    """``x' = A x + B u + w``, to be discretised once for each length of a step."""

    A: np.ndarray
    B: np.ndarray
    Q: np.ndarray

    def untimed(self) -> ValueError:
        """The error of a known input that does not tell how long a step takes."""
        m = self.B.shape[1]
        return ValueError(
            f"the known input of a sampled model is {f'its {m} controls and ' if m else ''}how long each step takes, "
            "not below 0: give run the times t of the readings"
        )


@lru_cache(maxsize=1024)
def _over_step(steps: _Discretisation, length: float) -> dict[str, np.ndarray]:
    """A, B and Q by name, over one step; of one whose length is not finite nothing is known."""
    n, m = steps.B.shape
    if length < 0.0:
        raise steps.untimed()
    if math.isfinite(length):
        A, Q = van_loan(steps.A, np.eye(n), steps.Q, length)
        B = zero_order_hold(steps.A, steps.B, length)[1] if m else np.zeros((n, 0))
    else:
        A, B, Q = (np.full((n, columns), np.nan) for columns in (n, m, n))
    return {"A": frozen(A), "B": frozen(np.concatenate([B, np.zeros((n, 1))], 1)), "Q": frozen(Q)}


@dataclass(frozen=True, eq=False)
class _Held:
    """One of the matrices of a `sampled` model, a function of the known input."""

    steps: _Discretisation
    part: str

    def __call__(self, u: np.ndarray | None) -> np.ndarray:
        if u is None or u.shape[-1] != self.steps.B.shape[1] + 1:
            raise self.steps.untimed()
        lengths = u[..., -1]
        if lengths.size == 1:
            one = _over_step(self.steps, lengths.item())[self.part]
            return one.reshape(lengths.shape + one.shape)
        different, rows = np.unique(lengths, return_inverse=True)
        return np.stack([_over_step(self.steps, k)[self.part] for k in different.tolist()])[rows.reshape(lengths.shape)]


def forward_euler(A: np.ndarray, B: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """``I + A dt`` and ``B dt``: the discretisation that the source papers use."""
    return np.eye(A.shape[-1]) + A * dt, B * dt


# --- checks -----------------------------------------------------------------------------------------


def as_covariance(name: str, value: object) -> np.ndarray:
    """``value`` as a float array ``(..., k, k)``, checked to be symmetric positive semidefinite.

    Raises:
        ValueError: naming the argument and what is wrong with it.
    """
    cov = as_array(name, value)
    if cov.ndim < 2 or cov.shape[-1] != cov.shape[-2] or cov.shape[-1] == 0:
        raise ValueError(f"{name} must be a square matrix (..., k, k), got shape {cov.shape}")
    if not np.isfinite(cov).all():
        raise ValueError(f"{name} must be finite")
    if symmetric := np.array_equal(cov, cov.mT):
        with suppress(np.linalg.LinAlgError):  # positive definite
            np.linalg.cholesky(cov)
            return cov
    variances = cov.diagonal(0, -2, -1)
    scale = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    unit = cov / scale[..., None] / scale[..., None, :]  # correlations: rounding is a share of standard deviations
    if (np.abs(unit - unit.mT) > 1e-9).any():
        raise ValueError(f"{name} must be symmetric")
    lowest = np.linalg.eigvalsh(unit)[..., 0].min()
    impossible = (variances < 0.0).any() or ((variances == 0.0)[..., None] & (cov != 0.0)).any()
    if impossible or lowest < -1e-9:
        own = np.linalg.eigvalsh(cov)[..., 0].min()
        scaled = "" if own < 0.0 else "in units of its standard deviations "
        found = f"its smallest eigenvalue {scaled}is {own if own < 0.0 else lowest:.3g}"
        zero = ", and what goes with a variance of 0 must be 0" if impossible and min(own, lowest) >= 0.0 else ""
        raise ValueError(f"{name} must be positive semidefinite, {found}{zero}")
    return cov if symmetric else 0.5 * cov + 0.5 * cov.mT


def usable(R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R ``(..., p, p)`` without the readings whose variance is not finite, and the mask ``(..., p)`` of the others.

    Receivers report an unknown variance as NaN or infinity: such a reading tells nothing.
    """
    finite = np.isfinite(R.diagonal(0, -2, -1))
    if is_traced(R):
        return neutralised(R, finite), finite
    return (R, finite) if finite.all() else (neutralised(R, finite), finite)


def _store_arrays(model: "LinearModel | NonlinearModel", matrices: str) -> None:
    """Check the matrices of these letters, and Q and R, and keep as arrays those that are no functions."""
    for name in (*matrices, "Q", "R"):
        value = getattr(model, name)
        if callable(value) or (value is None and name in matrices):
            continue
        array = as_array(name, value) if name in matrices else as_covariance(name, value)
        if array.ndim < 2:
            raise ValueError(f"{name} must be a matrix, got shape {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite")
        object.__setattr__(model, name, frozen(array))


def _unknown_inputs(model: "LinearModel | NonlinearModel", n: int, p: int) -> int:
    """How many there are; where one of G and H is given, the other is 0 unless it is, too."""
    if model.G is None and model.H is None:
        return 0
    q = _dimension("q", {"G": (model.G, -1), "H": (model.H, -1)})
    for name, rows in (("G", n), ("H", p)):
        if getattr(model, name) is None:
            object.__setattr__(model, name, frozen(np.zeros((rows, q))))
    return q


def _store_sizes(model: object, n: int, p: int, q: int) -> None:
    for name, size, indices in (("n", n, "state_angles"), ("p", p, "measurement_angles"), ("q", q, None)):
        object.__setattr__(model, name, size)
        if indices is None:
            continue
        given = getattr(model, indices)
        try:
            angles = tuple(operator.index(i) for i in given)
        except TypeError:
            angles = (-1,)
        if any(not 0 <= i < size for i in angles):
            raise ValueError(f"{indices} must be indices below {size}, got {shown(given)}")
        object.__setattr__(model, indices, angles)


def _told(name: str, number: int | None, sources: dict[str, tuple[object, int]]) -> int:
    """A size that the user tells, or the first of the matrices that does: an array, or a function without ``u``."""
    if number is not None:
        return whole(name, number, 1)
    told = _size(sources)
    if told is not None:
        return told
    symbol, (function, axis) = next(iter(sources.items()))
    if callable(function):
        with suppress(Exception):  # a function of u may do anything without one
            return as_array(symbol, function(None)).shape[axis]
    raise ValueError(f"cannot tell {name}: give {name}=, or one of {', '.join(sources)} as an array")


def _size(sources: dict[str, tuple[object, int]]) -> int | None:
    """The length of the first array's axis; None: there is no array among them, and no table of arrays."""
    tables = ((m.table if isinstance(m, Schedule) else m, axis) for m, axis in sources.values())
    return next((table.shape[axis] for table, axis in tables if isinstance(table, np.ndarray)), None)


def _dimension(symbol: str, sources: dict[str, tuple[object, int]]) -> int:
    told = _size(sources)
    if told is not None:
        return told
    raise ValueError(f"cannot tell {symbol}: give one of {', '.join(sources)} as an array, not as a function")


@dataclass(frozen=True)
class _Checked:
    """A model's function of ``u`` until its first value has the right shape, and is a covariance if need be."""

    model: object = field(repr=False)
    name: str
    function: Callable[[np.ndarray | None], np.ndarray]
    shape: tuple[int, ...]
    covariance: bool
    seen: bool = False

    def __call__(self, u: np.ndarray | None) -> np.ndarray:
        value = self.function(u)
        if self.seen:  # a program that was traced still asks here
            return value
        array = as_array(self.name, value)
        if array.ndim < 2 or array.shape[-2:][: len(self.shape)] != self.shape:
            columns = self.shape[1] if len(self.shape) > 1 else "m"
            raise ValueError(
                f"{self.name} gave a matrix of shape {array.shape}, expected (..., {self.shape[0]}, {columns})"
            )
        if self.covariance:
            as_covariance(self.name, array if self.name == "Q" else usable(array)[0])
        object.__setattr__(self.model, self.name, self.function)
        object.__setattr__(self, "seen", True)
        return value


def _check_when_called(model: object, name: str, shape: tuple[int, ...], covariance: bool = False) -> None:
    function = getattr(model, name)
    if isinstance(function, Schedule):
        _check_shapes({name: (function.table, shape[0], shape[1] if len(shape) > 1 else None)})
    elif isinstance(function, StateNoise):
        _check_shapes({name: (function.nominal, *shape)})  # type: ignore[dict-item]
    elif callable(function):
        function = function.function if isinstance(function, _Checked) else function
        object.__setattr__(model, name, _Checked(model, name, function, shape, covariance))


def _check_noise_when_called(model: object, n: int, p: int) -> None:
    _check_when_called(model, "Q", (n, n), covariance=True)
    _check_when_called(model, "R", (p, p), covariance=True)


def _check_shapes(expected: dict[str, tuple[object, int, int | None]]) -> None:
    for name, (one, rows, columns) in expected.items():
        if not isinstance(one, np.ndarray):
            continue
        if one.shape[-2] != rows or (columns is not None and one.shape[-1] != columns):
            wanted = f"(..., {rows}, {'m' if columns is None else columns})"
            raise ValueError(f"{name} has shape {one.shape}, expected {wanted}")
