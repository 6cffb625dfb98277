"""Gauss-Markov processes of currents, gusts, waves and sensors' biases."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from estimators.checks import as_covariance, finite_array, frozen, short_repr
from estimators.discretisation import van_loan
from estimators.engine import lookup
from vessel_gym.checks import check_numbers


@dataclass(frozen=True, eq=False)
class Process:
    """Gauss-Markov process ``z+ = transition z + root n`` over a step, with standard normal n.

    Attributes:
        transition: ``(k, k)``.
        root: ``(k, m)`` root of the process noise's covariance.
        start_cov: ``(k, k)`` covariance of z at the start.

    Raises:
        ValueError: for arrays of inconsistent shapes.
    """

    transition: np.ndarray
    root: np.ndarray
    start_cov: np.ndarray

    def __post_init__(self) -> None:
        root = finite_array("root of a process", self.root, "k", "m")
        k = len(root)
        transition = finite_array("transition of a process", self.transition, k, k)
        start_cov = finite_array("start_cov of a process", self.start_cov, k, k)
        if k:
            start_cov = as_covariance("start_cov of a process", start_cov)
        given = {"transition": transition, "root": root, "start_cov": start_cov}
        for name, values in given.items():  # in one memory order, as the last bit depends on it
            object.__setattr__(self, name, frozen(np.array(values, order="C")))

    @property
    def size(self) -> int:
        """Number k of components of the state."""
        return self.root.shape[0]

    @property
    def normals(self) -> int:
        """Number m of normal random numbers in a step."""
        return self.root.shape[1]

    def advance(self, z: np.ndarray) -> np.ndarray:
        """``transition z`` of states ``(..., k)``."""
        return product(self.transition, z, np.zeros_like(z))

    @cached_property
    def start_root(self) -> np.ndarray:
        """Root of ``start_cov``."""
        return root_of(self.start_cov)

    @classmethod
    def stationary(cls, A: np.ndarray, W: np.ndarray, dt: float) -> "Process":
        """Stationary process ``z' = A z + w``, with white noise w of intensity ``W (k, k)``.

        Args:
            A: ``(k, k)``, stable.
            W: ``(k, k)``.
            dt: Time step [s].

        Raises:
            ValueError: if A is not stable, so that no stationary covariance exists.
        """
        k = len(finite_array("A", A, "k", "k"))
        A, W = finite_array("A", A, k, k), finite_array("W", W, k, k)
        check_numbers("Process.stationary", {"dt": dt}, positive="dt")
        if not np.linalg.eigvals(A).real.max() < 0.0:
            raise ValueError(
                "A must be stable (eigenvalues with negative real parts): otherwise the process"
                " grows"
            )
        from scipy.linalg import solve_continuous_lyapunov  # late, as SciPy loads slowly

        transition, noise = van_loan(A, np.eye(len(A)), W, dt)
        return cls(transition, root_of(noise), solve_continuous_lyapunov(A, -W))

    @classmethod
    def wandering(cls, sd: tuple[float, ...] | np.ndarray, time: float, dt: float) -> "Process":
        """Independent first-order processes of standard deviations ``sd (k,)``.

        The correlation time is ``time`` [s].
        """
        sd = _sizes("sd", sd)
        check_numbers("Process.wandering", {"time": time, "dt": dt}, positive="time dt")
        fresh = np.sqrt(-np.expm1(-2.0 * dt / time))
        return cls(np.exp(-dt / time) * np.eye(len(sd)), np.diag(sd * fresh), np.diag(sd**2))

    @classmethod
    def walk(
        cls, start: tuple[float, ...] | np.ndarray, pace: tuple[float, ...] | np.ndarray, dt: float
    ) -> "Process":
        """Independent random walks.

        ``start (k,)`` is the standard deviation at the start, ``pace (k,)`` that of the increment
        in 1 s. A pace of zero gives unknown constants.
        """
        start, pace = _sizes("start", start), _sizes("pace", pace)
        check_numbers("Process.walk", {"dt": dt}, positive="dt")
        if start.shape != pace.shape:
            raise ValueError(f"start and pace must be as many, got {len(start)} and {len(pace)}")
        return cls(np.eye(len(start)), np.diag(pace * np.sqrt(dt)), np.diag(start**2))

    @classmethod
    def joined(cls, *processes: "Process") -> "Process":
        """Independent processes as one."""
        parts = [(each.transition, each.root, each.start_cov) for each in processes]
        empty = (np.zeros((0, 0)),) * 3
        return cls(*(block_diagonal(*blocks) for blocks in zip(empty, *parts, strict=True)))


def integrated(process: Process, which: Sequence[int], dt: float) -> Process:
    """Process followed by the time integrals of some of its components, which begin at 0."""
    k, m = process.size, len(which)
    transition = np.eye(k + m)
    transition[:k, :k] = process.transition
    transition[range(k, k + m), which] = dt
    root = np.pad(process.root, ((0, m), (0, 0)))
    whole = Process(transition, root, np.pad(process.start_cov, (0, m)))
    # the process begins as without the integrals
    vars(whole)["start_root"] = np.pad(process.start_root, ((0, m), (0, 0)))
    return whole


def _sizes(name: str, value: object) -> np.ndarray:
    """Standard deviations ``(k,)``, checked."""
    sizes = finite_array(name, value, "k")
    if (sizes < 0.0).any():
        raise ValueError(
            f"{name} must be standard deviations of at least 0, got {short_repr(value)}"
        )
    return sizes


def root_of(cov: np.ndarray) -> np.ndarray:
    """Square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def block_diagonal(*blocks: np.ndarray) -> np.ndarray:
    """Matrix with blocks ``(rows, columns)`` on its diagonal, and zeros elsewhere."""
    whole = np.zeros(np.sum([(0, 0), *map(np.shape, blocks)], 0))
    row = column = 0
    for each in blocks:
        k, m = each.shape
        whole[row : row + k, column : column + m] = each
        row, column = row + k, column + m
    return whole


def product(matrix: np.ndarray, x: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """``onto + matrix x`` for vectors ``(..., k)`` and a constant matrix ``(r, k)``.

    Zeros of the matrix are left out. The sum follows the order of columns, so that its bits are
    equal in any batch.
    """
    rows = list(np.moveaxis(onto, -1, 0))
    for i, j in np.argwhere(matrix):
        rows[i] = rows[i] + matrix[i, j] * x[..., j]
    return np.stack(rows, -1) if rows else onto


def interpolated(table: np.ndarray, *at: np.ndarray) -> np.ndarray:
    """Multilinear interpolation in a table at indices ``(...)`` along each of its first axes.

    Args:
        table: Numbers ``(k1, ..., kn)``, or rows ``(k1, ..., kn, m)``.
        at: Indices along the n axes.
    """
    row = table.shape[len(at) :]
    entries, axes = table.reshape(-1, *row), [*zip(at, table.shape, strict=False)]

    def value(first: Any, axis: int) -> np.ndarray:
        """Value at an index along the axes before ``axis``, interpolated along the others."""
        if axis == len(axes):
            return lookup(entries, first)
        x, size = axes[axis]
        low = np.minimum(np.floor(x), max(size - 2.0, 0.0))
        near, far = (value(first * size + (low + i), axis + 1) for i in (0.0, 1.0))
        share = (x - low)[..., None] if row else x - low
        return near + share * (far - near)

    return value(0.0, 0)
