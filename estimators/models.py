"""Priors, linear models and nonlinear models of filters.

Notation throughout: ``x+ = A x + B u + G d + w`` and ``y = C x + H d + v`` with ``w ~ N(0, Q)``,
``v ~ N(0, R)`` and ``d`` unknown; n states, m known inputs, q unknown inputs, p measurements. With
``delayed_feedthrough``, ``y(k) = C x(k) + H d(k-1) + v(k)``: measurements contain the input of the
step that has ended.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, cast

import numpy as np

from estimators.checks import as_array, call, check_takes, frozen, read_only, short_repr
from estimators.differences import central_differences, check_jacobian, steps, values_at
from estimators.engine.compiled import Compiled, compiled
from estimators.engine.derivative import linearise
from estimators.engine.foreign import Inspection, inspection_of, inspections
from estimators.engine.matrices import columnwise, is_traced, matrix
from estimators.model_checks import as_covariance, check_matrices
from estimators.varying import Frozen, Function, Matrix, Schedule, StateMatrix, resolve


@dataclass(frozen=True, eq=False)
class Gaussian(Frozen):
    """A mean ``(..., n)`` and a covariance ``(..., n, n)`` that broadcast against each other.

    Two are equal if their arrays are.

    Raises:
        ValueError: if the shapes do not fit or the covariance is not positive semidefinite.
    """

    mean: np.ndarray
    cov: np.ndarray

    def __post_init__(self) -> None:
        mean = as_array("mean", self.mean)
        cov = as_covariance("cov", self.cov)
        if mean.ndim < 1 or mean.shape[-1] != cov.shape[-1]:
            raise ValueError(
                f"mean has shape {mean.shape}, but cov {cov.shape} is for a vector of"
                f" {cov.shape[-1]}"
            )
        if not np.isfinite(mean).all():
            raise ValueError("mean must be finite")
        try:
            np.broadcast_shapes(mean.shape[:-1], cov.shape[:-2])
        except ValueError:
            raise ValueError(
                f"mean has shape {mean.shape} and cov {cov.shape}: their rows do not fit"
            ) from None
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
class LinearModel(Frozen):
    """``x+ = A x + B u + G d + w``, ``y = C x + H d + v``.

    Every matrix is an array, possibly with leading batch axes, or a function of ``u``, which then
    holds the control and whatever else is known (a gain schedule, say). Functions are checked when
    first called. They must be pure: the same ``u`` gives the same matrix, so time enters as a
    component of ``u``, not as a clock that is read.

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
        delayed_feedthrough: H feeds d(k-1) through, the unknown input of the step that has ended,
            instead of d(k). A gyro that averages over its sampling interval reads so what has
            turned it since the last measurement.

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
    delayed_feedthrough: bool = False
    n: int = field(init=False)
    p: int = field(init=False)
    q: int = field(init=False)

    def __post_init__(self) -> None:
        for name in "AC":
            if getattr(self, name) is None:
                raise ValueError(f"{name} must be a matrix or a function of u, got None")
        check_matrices(
            self, {"A": "nn", "Q": "nn", "C": "pn", "R": "pp", "G": "nq", "H": "pq", "B": "nm"}
        )

    def is_compiled(self, *names: str) -> bool:
        """Are the parts of these names arrays, or compiled functions?"""
        return all(
            not callable(part := getattr(self, name)) or isinstance(part, Compiled | Schedule)
            for name in names
        )

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
        """``C x``: the measurement expected without unknown input and noise."""
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
        """Expected measurement ``(..., p)`` and Jacobian ``C (..., p, n)``, whatever the belief's covariance."""
        C = resolve(self.C, u)
        return np.matvec(C, x), C


@dataclass(frozen=True, eq=False)
class NonlinearModel(Frozen):
    """``x+ = f(x, u) + G d + w``, ``y = h(x, u) + H d + v``.

    Args:
        transition: ``f(x, u) -> (..., n)``; must broadcast over leading axes of ``x`` and ``u``.
        measurement: ``h(x, u) -> (..., p)``; likewise.
        Q: ``(..., n, n)`` process noise covariance, or a function of ``u``.
        R: ``(..., p, p)`` measurement noise covariance, a function of ``u``, or a `StateNoise` of
            ``(x, u)``.
        G: ``(..., n, q)`` unknown input to the state, ``df/dd``, or a function of ``(x, u)`` that
            broadcasts; then give H, zero if need be, to tell how many unknown inputs there are.
        H: ``(..., p, q)`` unknown input to the measurement, or a function of ``u``.
        state_angles: indices of states that are angles; the transition may wrap them.
        measurement_angles: indices of measurements that are angles; likewise.
        transition_jacobian: ``df/dx (x, u) -> (..., n, n)``; None: exact where f can be traced,
            else by differences.
        measurement_jacobian: ``dh/dx (x, u) -> (..., p, n)``; None: likewise.
        states: n, where Q and G are functions, and Q has no value at ``u = None`` that would tell.
        measurements: p, where R and H are functions, likewise.
        delayed_feedthrough: H feeds d(k-1) through instead of d(k), see `LinearModel`.

    A Jacobian of your own is compared with differences when it is first used. Functions must be
    pure, as those of a `LinearModel`, and may only read their arguments; the model is immutable
    likewise.

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
    delayed_feedthrough: bool = False
    n: int = field(init=False)
    p: int = field(init=False)
    q: int = field(init=False)
    _compared: dict[str, bool] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("transition", "measurement", "transition_jacobian", "measurement_jacobian"):
            function = getattr(self, name)
            if not callable(function) and not (function is None and name.endswith("jacobian")):
                raise ValueError(f"{name} must be a function of (x, u), got {short_repr(function)}")
            if function is not None:
                check_takes(name, function, "x", "u")
        shapes = {"Q": "nn", "R": "pp", "G": "nq", "H": "pq"}
        check_matrices(
            self,
            shapes,
            of_state="G",
            n=("states", self.states),
            p=("measurements", self.measurements),
        )

    def is_compiled(self, *names: str) -> bool:
        """Are the parts of these names arrays, or compiled functions?"""
        return all(
            not callable(part := getattr(self, name)) or isinstance(part, Compiled | Schedule)
            for name in names
        )

    def check_known_input(self, u: np.ndarray | None) -> None:
        """Nothing to refuse: what the functions make of ``u`` is theirs."""

    def traceable(self, x: np.ndarray, u: np.ndarray | None, *names: str) -> bool:
        """Can all functions of these names, as far as there are any, be traced into a filter's program?

        Args:
            x: ``(..., n)`` where they are tried,
            u: and ``(..., m)``.
            names: Transition or measurement and, where the filter needs it, its Jacobian, which has
                to be compared.
        """
        functions = [
            (name, function) for name in names if (function := getattr(self, name)) is not None
        ]
        return all(
            (name in ("transition", "measurement") or name in self._compared)
            and inspected(function, x, u) is not None
            for name, function in functions
        )

    def source(self, name: str, x: np.ndarray, u: np.ndarray | None) -> "Function":
        """A function as it is traced; `traceable` has been asked."""
        function = getattr(self, name)
        if isinstance(function, Compiled):
            return function
        inspection = inspections[_key(function, x, u)]
        cast(Any, x).program.inspections.add(inspection)
        return inspection.inline

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
            return program.callback(lambda belief, u, R: self.input_matrix(belief.mean, u), 2)
        G = np.asarray(call("G", self.G, x, u))
        if G.shape[-2:] != (self.n, self.q):
            raise ValueError(
                f"G gave a matrix of shape {G.shape}, expected (..., {self.n}, {self.q})"
            )
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
        self,
        name: str,
        size: int,
        angles: tuple[int, ...],
        x: np.ndarray,
        u: np.ndarray | None,
        cov: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        function, own = getattr(self, name), getattr(self, f"{name}_jacobian")
        if is_traced(x):
            program, source = cast(Any, x).program, self.source(name, x, u)
            own = own and self.source(f"{name}_jacobian", x, u)
            return tuple(matrix(program, each) for each in linearise(source, x, u, slopes=own))
        x = read_only(x)
        if own is None:
            if (traced := inspected(function, x, u)) is not None:
                return _compiled(linearise, traced)(x, u)
            return central_differences(
                name, function, x, u, size, angles, steps(x, cov, self.state_angles)
            )
        jacobian = self._own_jacobian(f"{name}_jacobian", size, x, u)
        if f"{name}_jacobian" not in self._compared:
            check_jacobian(name, function, jacobian, x, u, angles, steps(x, cov, self.state_angles))
            if np.isfinite(jacobian).all():  # else it is compared again where it is
                self._compared[f"{name}_jacobian"] = True
        return at_points(name, function, x[..., None, :], u, size)[..., 0, :], jacobian

    def _own_jacobian(
        self, name: str, size: int, x: np.ndarray, u: np.ndarray | None
    ) -> np.ndarray:
        """The user's Jacobian ``(..., size, n)`` of this name.

        Raises:
            ValueError: if it has another shape.
        """
        jacobian, expected = (
            as_array(name, call(name, getattr(self, name), x, u)),
            x.shape[:-1] + (size, self.n),
        )
        if jacobian.shape[-2:] != expected[-2:]:
            raise ValueError(f"{name} gave a matrix of shape {jacobian.shape}, expected {expected}")
        return np.broadcast_to(jacobian, expected)


_KEPT = 500
"""Functions whose derivatives are kept."""


def inspected(
    function: Function, x: np.ndarray, u: np.ndarray | None
) -> Compiled | Inspection | None:
    """The compiled form of a model's function; None for one that only NumPy can compute.

    What is `estimators.engine.compiled` declares itself pure. Any other function is inspected when
    it is first used, and again when something that it reads has changed; why it is not traceable
    stands in the log.
    """
    if isinstance(function, Compiled):
        return function
    if x.dtype == object:  # it is traced as a part of another
        return None
    own, samples = (lambda x, u=None: function(x, u), (x,)) if u is None else (function, (x, u))
    inspection = inspection_of(_key(function, x, u), own, *samples)
    return inspection if inspection.traceable and not inspection.several else None


def _key(
    function: Function, x: np.ndarray, u: np.ndarray | None
) -> tuple[Function, int, int | None]:
    return function, x.shape[-1], None if u is None else u.shape[-1]


@lru_cache(2 * _KEPT)
def _compiled(form: Callable[..., Any], function: Compiled | Inspection) -> Compiled:
    """A function of points in another form: `linearise` of ``(..., n)``, or `columnwise` of columns ``(..., n, N)``."""
    options: dict[str, Any] = {"axes": (2, 1), "matrices": True} if form is columnwise else {}
    return compiled(partial(form, getattr(function, "inline", function)), **options)


def at_columns(
    model: NonlinearModel, name: str, points: np.ndarray, u: np.ndarray | None, size: int
) -> np.ndarray:
    """A model's function at points that are columns ``(..., n, N)``: values ``(..., size, N)``, contiguous."""
    if is_traced(points):
        return columnwise(model.source(name, points[..., 0], u), points, u)  # type: ignore[return-value]
    function = getattr(model, name)
    traced = inspected(function, points[..., 0], u)
    if traced is None:
        return np.ascontiguousarray(at_points(name, function, points.mT, u, size).mT)
    return _compiled(columnwise, traced)(points, u)


def at_points(
    name: str, function: Function, points: np.ndarray, u: np.ndarray | None, size: int
) -> np.ndarray:
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
    return values_at(name, traced or function, points, u, size)[0]
