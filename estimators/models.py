"""What a filter knows of the world: a prior, a linear model, a nonlinear model.

Notation throughout: ``x+ = A x + B u + G d + w`` and ``y = C x + H d + v`` with ``w ~ N(0, Q)``,
``v ~ N(0, R)`` and ``d`` unknown; n states, m known inputs, q unknown inputs, p measurements.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm

from estimators.linalg import congruence

Matrix = np.ndarray | Callable[[np.ndarray | None], np.ndarray]
StateMatrix = np.ndarray | Callable[[np.ndarray, np.ndarray | None], np.ndarray]


def resolve(matrix: Matrix, u: np.ndarray | None) -> np.ndarray:
    """The matrix itself, or its value at the known input ``u`` when it is a function of it."""
    return matrix(u) if callable(matrix) else matrix


@dataclass(frozen=True)
class Gaussian:
    """A mean ``(..., n)`` and a covariance ``(..., n, n)`` that broadcast against each other.

    Raises:
        ValueError: if the shapes do not fit or the covariance is not positive semidefinite.
    """

    mean: np.ndarray
    cov: np.ndarray

    def __post_init__(self) -> None:
        mean = np.asarray(self.mean, dtype=float)
        cov = as_covariance("cov", self.cov)
        if mean.ndim < 1 or mean.shape[-1] != cov.shape[-1]:
            raise ValueError(f"mean has shape {mean.shape}, but cov {cov.shape} is for a vector of {cov.shape[-1]}")
        if not np.isfinite(mean).all():
            raise ValueError("mean must be finite")
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "cov", cov)


@dataclass(frozen=True, eq=False)
class LinearModel:
    """``x+ = A x + B u + G d + w``, ``y = C x + H d + v``.

    Every matrix is an array, possibly with leading batch axes, or a function of ``u``, which then holds
    the control and whatever else is known (a gain schedule, say). Functions are checked when first called.

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
        for name in "ACBGH":
            _store_array(self, name)
        for name in "QR":
            if not callable(getattr(self, name)):
                object.__setattr__(self, name, as_covariance(name, getattr(self, name)))
        n = _dimension("n", {"A": (self.A, -1), "Q": (self.Q, -1), "C": (self.C, -1), "G": (self.G, -2)})
        p = _dimension("p", {"C": (self.C, -2), "R": (self.R, -1), "H": (self.H, -2)})
        no_input = self.G is None and self.H is None
        q = 0 if no_input else _dimension("q", {"G": (self.G, -1), "H": (self.H, -1)})
        if not no_input and self.G is None:
            object.__setattr__(self, "G", np.zeros((n, q)))
        if not no_input and self.H is None:
            object.__setattr__(self, "H", np.zeros((p, q)))
        _check_shapes({"A": (self.A, n, n), "C": (self.C, p, n), "B": (self.B, n, None), "G": (self.G, n, q),
                       "H": (self.H, p, q), "Q": (self.Q, n, n), "R": (self.R, p, p)})  # fmt: skip
        _store_sizes(self, n, p, q)

    def transition(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """``A x + B u``: the next state without the unknown input and noise; ``x`` is ``(..., n)``."""
        mean = np.matvec(resolve(self.A, u), x)
        if self.B is not None and u is not None:
            mean = mean + np.matvec(resolve(self.B, u), u)
        return mean

    def measurement(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """``C x``: the reading expected without unknown input and noise."""
        return np.matvec(resolve(self.C, u), x)

    def input_matrix(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """G ``(..., n, q)``: how the unknown input moves the next state."""
        return resolve(self.G, u)

    def linearise_transition(self, x: np.ndarray, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """The next state ``(..., n)`` and the Jacobian ``A (..., n, n)``."""
        A = resolve(self.A, u)
        mean = np.matvec(A, x)
        if self.B is not None and u is not None:
            mean = mean + np.matvec(resolve(self.B, u), u)
        return mean, A

    def linearise_measurement(self, x: np.ndarray, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """The expected reading ``(..., p)`` and the Jacobian ``C (..., p, n)``."""
        C = resolve(self.C, u)
        return np.matvec(C, x), C


@dataclass(frozen=True, eq=False)
class NonlinearModel:
    """``x+ = f(x, u) + G d + w``, ``y = h(x, u) + H d + v``.

    Args:
        transition: ``f(x, u) -> (..., n)``; must broadcast over leading axes of ``x`` and ``u``.
        measurement: ``h(x, u) -> (..., p)``; likewise.
        Q: ``(..., n, n)`` process noise covariance.
        R: ``(..., p, p)`` measurement noise covariance.
        G: ``(..., n, q)`` unknown input to the state, ``df/dd``, or a function of ``(x, u)`` that broadcasts; then
            give H, zero if need be, to tell how many unknown inputs there are.
        H: ``(..., p, q)`` unknown input to the measurement, or a function of ``u``.
        state_angles: indices of states that are angles.
        measurement_angles: indices of measurements that are angles.

    Raises:
        ValueError: naming the argument whose shape or definiteness is wrong.
    """

    transition: Callable[[np.ndarray, np.ndarray | None], np.ndarray]
    measurement: Callable[[np.ndarray, np.ndarray | None], np.ndarray]
    Q: np.ndarray
    R: np.ndarray
    G: StateMatrix | None = None
    H: Matrix | None = None
    state_angles: tuple[int, ...] = ()
    measurement_angles: tuple[int, ...] = ()
    n: int = field(init=False)
    p: int = field(init=False)
    q: int = field(init=False)

    def __post_init__(self) -> None:
        for name in ("transition", "measurement"):
            if not callable(getattr(self, name)):
                raise ValueError(f"{name} must be a function of (x, u)")
        for name in "QR":
            object.__setattr__(self, name, as_covariance(name, getattr(self, name)))
        for name in "GH":
            _store_array(self, name)
        n, p = self.Q.shape[-1], self.R.shape[-1]
        no_input = self.G is None and self.H is None
        q = 0 if no_input else _dimension("q", {"G": (self.G, -1), "H": (self.H, -1)})
        if not no_input and self.G is None:
            object.__setattr__(self, "G", np.zeros((n, q)))
        if not no_input and self.H is None:
            object.__setattr__(self, "H", np.zeros((p, q)))
        _check_shapes({"G": (self.G, n, q), "H": (self.H, p, q)})
        _store_sizes(self, n, p, q)

    def input_matrix(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """G ``(..., n, q)``: how the unknown input moves the next state from ``x (..., n)``.

        Raises:
            ValueError: if G is a function whose value has another shape.
        """
        if not callable(self.G):
            return self.G
        G = np.asarray(self.G(x, u))
        if G.shape[-2:] != (self.n, self.q):
            raise ValueError(f"G gave a matrix of shape {G.shape}, expected (..., {self.n}, {self.q})")
        return G

    def linearise_transition(self, x: np.ndarray, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """``f(x, u)`` and its Jacobian by central differences, all columns in one call."""
        return _central_differences("transition", self.transition, x, u, self.n)

    def linearise_measurement(self, x: np.ndarray, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """``h(x, u)`` and its Jacobian by central differences, all columns in one call."""
        return _central_differences("measurement", self.measurement, x, u, self.p)


Function = Callable[[np.ndarray, np.ndarray | None], np.ndarray]


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
    expected = points.shape[:-1] + (size,)
    try:
        values = function(points, None if u is None else u[..., None, :])
    except (ValueError, IndexError) as error:
        raise ValueError(
            f"{name} must broadcast over leading axes, but x of shape {points.shape} ends in: {error}"
        ) from error
    if np.shape(values) != expected:
        raise ValueError(
            f"{name} must broadcast over leading axes: "
            f"x of shape {points.shape} gave {np.shape(values)}, expected {expected}"
        )
    return values


def _central_differences(
    name: str, function: Function, x: np.ndarray, u: np.ndarray | None, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """``f(x)`` and ``df/dx`` by fourth-order differences, whose step can be long enough to keep rounding out.

    The second-order ones would turn a rounding of ``f`` in its last digit into 1e-10 of the Jacobian.
    """
    n = x.shape[-1]
    step = 1e-3 * np.maximum(1.0, np.abs(x))
    eye = np.eye(n)
    offsets = np.concatenate([np.zeros((1, n)), eye, -eye, 2.0 * eye, -2.0 * eye])
    points = x[..., None, :] + offsets * step[..., None, :]
    values = at_points(name, function, points, None if u is None else np.asarray(u), size)
    forward, backward, far_forward, far_backward = np.split(values[..., 1:, :], 4, axis=-2)
    columns = (8.0 * (forward - backward) - (far_forward - far_backward)) / (12.0 * step[..., :, None])
    return values[..., 0, :], columns.mT


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
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n] = -A
    block[:n, n:] = congruence(G, Q)
    block[n:, n:] = A.T
    phi = expm(block * dt)
    transition = phi[n:, n:].T
    noise = transition @ phi[:n, n:]
    return transition, 0.5 * (noise + noise.T)


def forward_euler(A: np.ndarray, B: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """``I + A dt`` and ``B dt``: the discretisation that the source papers use."""
    return np.eye(A.shape[-1]) + A * dt, B * dt


# --- checks -----------------------------------------------------------------------------------------


def as_covariance(name: str, value: object) -> np.ndarray:
    """``value`` as a float array ``(..., k, k)``, checked to be symmetric positive semidefinite.

    Raises:
        ValueError: naming the argument and what is wrong with it.
    """
    cov = np.asarray(value, dtype=float)
    if cov.ndim < 2 or cov.shape[-1] != cov.shape[-2] or cov.shape[-1] == 0:
        raise ValueError(f"{name} must be a square matrix (..., k, k), got shape {cov.shape}")
    if not np.isfinite(cov).all():
        raise ValueError(f"{name} must be finite")
    scale = np.abs(cov).max()
    if np.abs(cov - cov.mT).max() > 1e-9 * scale:
        raise ValueError(f"{name} must be symmetric")
    lowest = float(np.linalg.eigvalsh(cov).min())
    if lowest < -1e-9 * scale:
        raise ValueError(f"{name} must be positive semidefinite, its smallest eigenvalue is {lowest:.3g}")
    return cov


def _store_array(model: object, name: str) -> None:
    value = getattr(model, name)
    if value is None or callable(value):
        return
    array = np.asarray(value, dtype=float)
    if array.ndim < 2:
        raise ValueError(f"{name} must be a matrix, got shape {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite")
    object.__setattr__(model, name, array)


def _store_sizes(model: object, n: int, p: int, q: int) -> None:
    for name, size, indices in (("n", n, "state_angles"), ("p", p, "measurement_angles"), ("q", q, None)):
        object.__setattr__(model, name, size)
        if indices is None:
            continue
        angles = tuple(int(i) for i in getattr(model, indices))
        if any(not 0 <= i < size for i in angles):
            raise ValueError(f"{indices} must be indices below {size}, got {angles}")
        object.__setattr__(model, indices, angles)


def _dimension(symbol: str, sources: dict[str, tuple[object, int]]) -> int:
    for matrix, axis in sources.values():
        if isinstance(matrix, np.ndarray):
            return matrix.shape[axis]
    raise ValueError(f"cannot tell {symbol}: give one of {', '.join(sources)} as an array, not as a function")


def _check_shapes(expected: dict[str, tuple[object, int, int | None]]) -> None:
    for name, (matrix, rows, columns) in expected.items():
        if not isinstance(matrix, np.ndarray):
            continue
        if matrix.shape[-2] != rows or (columns is not None and matrix.shape[-1] != columns):
            wanted = f"(..., {rows}, {'m' if columns is None else columns})"
            raise ValueError(f"{name} has shape {matrix.shape}, expected {wanted}")
