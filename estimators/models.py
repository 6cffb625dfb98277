"""Priors, linear models and nonlinear models of filters.

Notation throughout: ``x+ = A x + B u + G d + w`` and ``y = C x + H d + v`` with ``w ~ N(0, Q)``,
``v ~ N(0, R)`` and ``d`` unknown; n states, m known inputs, q unknown inputs, p measurements. With
``delayed_feedthrough``, ``y(k) = C x(k) + H d(k-1) + v(k)``: measurements contain the input of the
step that has ended.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from estimators.checks import as_covariance, finite_array, frozen, short_repr
from estimators.differences import central_differences, steps
from estimators.engine import Compiled, columnwise, compiled, is_traced, linearise, matrix
from estimators.varying import (
    Frozen,
    Function,
    Matrix,
    StateMatrix,
    StateNoise,
    check_matrices,
    is_compiled,
    resolve,
    sized,
)


@dataclass(frozen=True, eq=False)
class Gaussian(Frozen):
    """A mean ``(..., n)`` and a covariance ``(..., n, n)`` that broadcast against each other.

    Raises:
        ValueError: if the shapes do not fit or the covariance is not positive semidefinite.
    """

    mean: np.ndarray
    cov: np.ndarray

    def __init__(self, mean: ArrayLike, cov: ArrayLike) -> None:
        cov = as_covariance("cov", cov)
        mean = finite_array("mean", mean, "...", cov.shape[-1])
        try:
            np.broadcast_shapes(mean.shape[:-1], cov.shape[:-2])
        except ValueError:
            raise ValueError(
                f"mean has shape {mean.shape} and cov {cov.shape}: their rows do not fit"
            ) from None
        vars(self).update(mean=frozen(mean), cov=frozen(cov))

    def about(self, mean: np.ndarray) -> "Gaussian":
        """A Gaussian of this covariance about other means ``(..., n)``, which are not checked."""
        moved = object.__new__(type(self))
        vars(moved).update(mean=mean, cov=self.cov)
        return moved


class _Model(Frozen):
    """Base of models of n states, p measurements and q unknown inputs."""

    n: int
    p: int
    q: int
    shapes: ClassVar[dict[str, str]]
    """Letters of rows and columns of each matrix, in the order in which sizes are sought."""
    sizes: dict[str, tuple[int, ...]]
    """Rows and columns of each matrix; number of values of the transition and the measurement.

    Empty for B, which has a column for each known input.
    """
    parts: ClassVar[dict[str, tuple[str, ...]]]
    """Names of the matrices and functions that a "predict" and an "update" use."""

    def is_compiled(self, step: str) -> bool:
        """Are all functions of a "predict" or an "update" compiled? Arrays count as compiled."""
        return all(is_compiled(getattr(self, name)) for name in self.parts[step])

    def evaluated(self, name: str, x: np.ndarray, u: np.ndarray | None) -> Any:
        """The transition or the measurement, which is refused if it is of another size."""
        return sized(name, getattr(self, name)(x, u), *self.sizes[name])

    def value(self, name: str, *arguments: Any) -> Any:
        """A matrix, or the value of its function, which is refused if it is of another size.

        The arguments are ``u``, or ``(x, u)`` for a function of the state; a `StateNoise` takes
        both.
        """
        part = getattr(self, name)
        if not callable(part):
            return part
        if len(arguments) > 1 and isinstance(part, StateNoise):
            part = part.function
        size = self.sizes[name] or (self.n, *np.shape(arguments[-1])[-1:])
        return sized(name, resolve(part, *arguments), *size)


@dataclass(frozen=True, eq=False)
class LinearModel(_Model):
    """``x+ = A x + B u + G d + w``, ``y = C x + H d + v``.

    Every matrix is an array, possibly with leading batch axes, or a function of ``u``. Such a ``u``
    holds the control and what else the matrices depend on, such as the time. Functions must be
    pure: the same ``u`` gives the same matrix, so time enters as a component of ``u``, not as a
    clock that is read.

    A model is immutable, and its arrays are read-only copies. To change a matrix, build another
    model with ``dataclasses.replace(model, A=...)``, and a new filter.

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
        delayed_feedthrough: H feeds through d(k-1), the unknown input of the step that has ended,
            instead of d(k). An example is a gyro that averages over its sampling interval.

    Raises:
        ValueError: naming the argument whose shape or definiteness is wrong.
    """

    shapes = {"A": "nn", "Q": "nn", "C": "pn", "R": "pp", "G": "nq", "H": "pq", "B": "nm"}
    parts = {"predict": ("A", "B", "Q", "G"), "update": ("C", "R", "H")}
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

    def __post_init__(self) -> None:
        check_matrices(self)

    def check_known_input(self, u: np.ndarray | None) -> None:
        """Refuse a ``u`` of the wrong size, one that nothing uses, and a missing one that B needs.

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
        """``A x + B u (..., n)``: the next state without the unknown input and noise."""
        return self.linearise_transition(x, u)[0]

    def measurement(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """``C x``: the measurement expected without unknown input and noise."""
        return np.matvec(self.value("C", u), x)

    def input_matrix(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """G ``(..., n, q)``: how the unknown input moves the next state."""
        return self.value("G", u)

    def linearise_transition(
        self, x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Next state ``(..., n)`` and Jacobian A ``(..., n, n)``; the covariance is not used."""
        A = self.value("A", u)
        mean = np.matvec(A, x)
        if self.B is not None and u is not None:
            mean = mean + np.matvec(self.value("B", u), u)
        return mean, A

    def linearise_measurement(
        self, x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Expected measurement ``(..., p)`` and Jacobian C; the covariance is not used."""
        C = self.value("C", u)
        return np.matvec(C, x), C


@dataclass(frozen=True, eq=False)
class NonlinearModel(_Model):
    """``x+ = f(x, u) + G d + w``, ``y = h(x, u) + H d + v``.

    Args:
        transition: ``f(x, u) -> (..., n)``; must broadcast over leading axes of ``x`` and ``u``.
        measurement: ``h(x, u) -> (..., p)``; must broadcast like ``f``.
        Q: ``(..., n, n)`` process noise covariance, or a function of ``u``.
        R: ``(..., p, p)`` measurement noise covariance, a function of ``u``, or a `StateNoise` of
            ``(x, u)``.
        G: ``(..., n, q)`` unknown input to the state, ``df/dd``, or a function of ``(x, u)`` that
            broadcasts. A function needs H as well, zero if need be, which gives the number of
            unknown inputs.
        H: ``(..., p, q)`` unknown input to the measurement, or a function of ``u``.
        state_angles: indices of states that are angles; the transition may wrap them.
        measurement_angles: indices of measurements that are angles; h may wrap them.
        transition_jacobian: ``df/dx (x, u) -> (..., n, n)``; None: exact if ``f`` is compiled,
            otherwise by central differences.
        measurement_jacobian: ``dh/dx (x, u) -> (..., p, n)``; None: found in the same way.
        states: The number n, needed if Q and G are functions.
        measurements: The number p, needed if R and H are functions.
        delayed_feedthrough: H feeds d(k-1) through instead of d(k), see `LinearModel`.

    Functions run in NumPy unless they are decorated `@compiled`. They must be pure, as those of a
    `LinearModel`; `check_filter` tries a filter on a model of your own. The model is immutable.

    Raises:
        ValueError: naming the argument whose shape or definiteness is wrong.
    """

    shapes = {"Q": "nn", "R": "pp", "G": "nq", "H": "pq"}
    parts = {
        "predict": ("transition", "transition_jacobian", "Q", "G"),
        "update": ("measurement", "measurement_jacobian", "R", "H"),
    }
    transition: Function
    measurement: Function
    Q: Matrix
    R: Matrix
    G: StateMatrix | None = None
    H: Matrix | None = None
    state_angles: tuple[int, ...] = ()
    measurement_angles: tuple[int, ...] = ()
    transition_jacobian: Function | None = None
    measurement_jacobian: Function | None = None
    states: int | None = None
    measurements: int | None = None
    delayed_feedthrough: bool = False

    def __post_init__(self) -> None:
        sizes = {"n": ("states", self.states), "p": ("measurements", self.measurements)}
        check_matrices(self, **sizes)
        for name in "transition", "measurement":
            if not callable(function := getattr(self, name)):
                raise ValueError(f"{name} must be a function of (x, u), got {short_repr(function)}")

    def check_known_input(self, u: np.ndarray | None) -> None:
        """Accept every known input: the model's functions decide how they use ``u``."""

    def input_matrix(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """G ``(..., n, q)``: how the unknown input moves the next state from ``x (..., n)``."""
        return self.value("G", x, u)

    def _linearise(
        self, name: str, x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        function, slopes = getattr(self, name), getattr(self, f"{name}_jacobian")
        if is_traced(x):
            value, jacobian = matrix(linearise(function, x, u, slopes=slopes))
        elif slopes is None and is_compiled(function):
            value, jacobian = _in_form(linearise, function)(x, u)
        elif slopes is None:
            angles = self.state_angles if name == "transition" else self.measurement_angles
            step = steps(x, cov, self.state_angles)
            return central_differences(name, function, x, u, self.sizes[name][0], angles, step)
        else:
            value, jacobian = np.asarray(function(x, u), float), np.asarray(slopes(x, u), float)
        value = sized(name, value, *self.sizes[name])
        jacobian = sized(f"{name}_jacobian", jacobian, *self.sizes[name], self.n)
        if slopes is not None and not is_traced(x):  # it may be the same for all rows
            jacobian = np.broadcast_to(jacobian, (*value.shape, self.n))
        return value, jacobian

    def linearise_transition(
        self, x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """``f(x, u)`` and its Jacobian ``(..., n, n)``; ``cov`` sets the steps of differences."""
        return self._linearise("transition", x, u, cov)

    def linearise_measurement(
        self, x: np.ndarray, u: np.ndarray | None, cov: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """``h(x, u)`` and its Jacobian ``(..., p, n)``; ``cov`` sets the steps of differences."""
        return self._linearise("measurement", x, u, cov)


def at_columns(
    model: LinearModel | NonlinearModel, name: str, points: np.ndarray, u: np.ndarray | None
) -> np.ndarray:
    """A model's transition or measurement at columns ``(..., n, N)``: values ``(..., k, N)``."""
    if isinstance(model, LinearModel):
        values = model.value("A" if name == "transition" else "C", u) @ points
        if name == "measurement" or model.B is None or u is None:
            return values
        return values + np.matvec(model.value("B", u), u)[..., None]
    function = getattr(model, name)
    if is_traced(points):
        return sized(name, columnwise(function, points, u).mT, *model.sizes[name]).mT
    if is_compiled(function):
        values = _in_form(columnwise, function)(points, u)
        return sized(name, values.mT, *model.sizes[name]).mT
    return np.ascontiguousarray(at_points(model, name, points.mT, u).mT)


def at_points(
    model: LinearModel | NonlinearModel, name: str, points: np.ndarray, u: np.ndarray | None
) -> np.ndarray:
    """A model's transition or measurement at several points of every row.

    Args:
        model: The model.
        name: "transition" or "measurement".
        points: ``(..., k, n)``.
        u: ``(..., m)``, shared by the points of a row.

    Returns:
        The values ``(..., k, size)``.
    """
    known = None if u is None else u[..., None, :]
    return np.asarray(model.evaluated(name, points, known), float)


@lru_cache(1000)
def _in_form(form: Callable[..., Any], function: Compiled) -> Compiled:
    """A function as `linearise` of ``(..., n)``, or `columnwise` of columns ``(..., n, N)``."""
    options: dict[str, Any] = {"axes": (2, 1), "matrices": True} if form is columnwise else {}
    return compiled(partial(form, function), **options)
