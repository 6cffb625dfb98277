"""Gauss-Markov processes: what currents, gusts, waves and the biases of sensors are made of."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import block_diag, solve_continuous_lyapunov

from estimators import van_loan
from estimators.checks import finite_array, frozen, short_repr
from estimators.engine import as_word, lookup
from estimators.model_checks import as_covariance
from estimators.threefry import normals
from vessel_gym.checks import check_numbers

_Function = TypeVar("_Function", bound=Callable[..., Any])


def linear(function: _Function) -> _Function:
    """Declare that what a disturbance does, or a sensor reads, is a matrix times its arguments.

    The matrix is taken from the function, which is then no longer called at every step.
    """
    vars(function)["linear"] = True
    return function


@dataclass(frozen=True, eq=False)
class Process:
    """``z+ = transition z + root n`` over a step, with standard normals n.

    Attributes:
        transition: ``(k, k)``.
        root: ``(k, m)`` a root of the covariance of what enters in a step.
        start_cov: ``(k, k)`` covariance of z at the start.

    Raises:
        ValueError: for arrays that do not fit together.
    """

    transition: np.ndarray
    root: np.ndarray
    start_cov: np.ndarray

    def __post_init__(self) -> None:
        for name in (
            "transition",
            "root",
            "start_cov",
        ):  # laid out alike in every copy: the last bit depends on it
            shape = ("k", "m") if name == "root" else ("...",)
            values = finite_array(f"{name} of a process", getattr(self, name), *shape)
            object.__setattr__(self, name, frozen(np.array(values, order="C")))
        k = len(self.root)
        for name, values in (("transition", self.transition), ("start_cov", self.start_cov)):
            if np.shape(values) != (k, k):
                raise ValueError(
                    f"{name} must have shape {(k, k)}, as many rows as root of shape"
                    f" {np.shape(self.root)}, got {np.shape(values)}"
                )
        if k:
            object.__setattr__(
                self, "start_cov", frozen(as_covariance("start_cov of a process", self.start_cov))
            )

    @property
    def size(self) -> int:
        """k, components of the state."""
        return self.root.shape[0]

    @property
    def normals(self) -> int:
        """m, normal numbers a step."""
        return self.root.shape[1]

    def advance(self, z: np.ndarray) -> np.ndarray:
        """``transition z`` of states ``(..., k)``."""
        return product(self.transition, z, np.zeros_like(z))

    @cached_property
    def start_root(self) -> np.ndarray:
        """A root of ``start_cov``."""
        return root_of(self.start_cov)

    @classmethod
    def stationary(cls, A: np.ndarray, W: np.ndarray, dt: float) -> "Process":
        """``z' = A z + w``, white w of intensity ``W (k, k)``, as it is long after its beginning.

        Args:
            A: ``(k, k)``, stable.
            W: ``(k, k)``.
            dt: Time step [s].

        Raises:
            ValueError: if A is not stable: then the process has no size to begin with.
        """
        A, W = finite_array("A", A, "k", "k"), finite_array("W", W, "k", "k")
        check_numbers("Process.stationary", {"dt": dt}, positive="dt")
        if len(set(A.shape + W.shape)) != 1:
            raise ValueError(
                f"A and W must be square and of one size, got shapes {A.shape} and {W.shape}"
            )
        if not np.linalg.eigvals(A).real.max() < 0.0:
            raise ValueError(
                "A must be stable (eigenvalues with negative real parts): otherwise the process"
                " grows"
            )
        transition, noise = van_loan(A, np.eye(len(A)), W, dt)
        return cls(transition, root_of(noise), solve_continuous_lyapunov(A, -W))

    @classmethod
    def wandering(cls, sd: tuple[float, ...] | np.ndarray, time: float, dt: float) -> "Process":
        """Independent first-order processes of standard deviations ``sd (k,)`` that change in ``time`` [s]."""
        sd = _sizes("sd", sd)
        check_numbers("Process.wandering", {"time": time, "dt": dt}, positive="time dt")
        fresh = np.sqrt(-np.expm1(-2.0 * dt / time))
        return cls(np.exp(-dt / time) * np.eye(len(sd)), np.diag(sd * fresh), np.diag(sd**2))

    @classmethod
    def walk(
        cls, start: tuple[float, ...] | np.ndarray, pace: tuple[float, ...] | np.ndarray, dt: float
    ) -> "Process":
        """Independent random walks: ``start (k,)`` standard deviations at first, ``pace (k,)`` of what a second adds.

        With a pace of zero they are constants that nobody knows.
        """
        start, pace = _sizes("start", start), _sizes("pace", pace)
        check_numbers("Process.walk", {"dt": dt}, positive="dt")
        if start.shape != pace.shape:
            raise ValueError(f"start and pace must be as many, got {len(start)} and {len(pace)}")
        return cls(np.eye(len(start)), np.diag(pace * np.sqrt(dt)), np.diag(start**2))

    @classmethod
    def joined(cls, *processes: "Process") -> "Process":
        """Independent processes as one."""
        for each in processes:
            if not isinstance(each, Process):
                raise TypeError(f"Process.joined joins processes, got {short_repr(each)}")
        if not processes:
            return cls(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)))
        return cls(
            *(
                block_diag(*(getattr(p, name) for p in processes))
                for name in ("transition", "root", "start_cov")
            )
        )


def integrated(process: Process, which: Sequence[int], dt: float) -> Process:
    """A process with the integrals over time of some of its components, which begin at 0, behind them."""
    k, m = process.size, len(which)
    added = np.zeros((m, k))
    added[range(m), which] = dt
    transition = np.block([[process.transition, np.zeros((k, m))], [added, np.eye(m)]])
    root = np.vstack([process.root, np.zeros((m, process.normals))])
    whole = Process(transition, root, block_diag(process.start_cov, np.zeros((m, m))))
    vars(whole)["start_root"] = np.vstack(
        [process.start_root, np.zeros((m, k))]
    )  # the process begins as it does alone
    return whole


def _sizes(name: str, value: object) -> np.ndarray:
    """Standard deviations ``(k,)``."""
    sizes = finite_array(name, value, "k")
    if (sizes < 0.0).any():
        raise ValueError(
            f"{name} must be standard deviations of at least 0, got {short_repr(value)}"
        )
    return sizes


def root_of(cov: np.ndarray) -> np.ndarray:
    """A square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def product(matrix: np.ndarray, x: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """``onto + matrix x`` of vectors ``(..., k)`` and a constant matrix ``(r, k)``.

    Zeros of the matrix are left out. The sum is in the order of its columns: the same to the last
    bit in any batch.
    """
    rows = list(np.moveaxis(onto, -1, 0))
    for i, j in np.argwhere(matrix):
        rows[i] = rows[i] + matrix[i, j] * x[..., j]
    return np.stack(rows, -1) if rows else onto


def interpolated(table: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Linear interpolation of the rows of a table ``(k, ...)`` at the indices ``at (...)``, from 0 to k - 1."""
    i = np.minimum(np.floor(at), len(table) - 2.0)
    low, high = lookup(table, i), lookup(table, i + 1.0)
    return low + (at - i if table.ndim == 1 else (at - i)[..., None]) * (high - low)


def advance(
    keys: np.ndarray, step: np.ndarray, z: np.ndarray, noise: np.ndarray, counts: np.ndarray, root: np.ndarray,
    transition: np.ndarray, gains: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Processes a step later, the noise of the coming step and the exogenous input that follows from both.

    Args:
        keys: ``(..., parts, 2)`` of the random numbers of each part.
        step: ``(...)``, the number of the coming step.
        z: ``(..., k)`` state of the processes.
        noise: ``(..., s + k)`` of the step that is over: white increments, then those of the
            processes.
        counts: Normal numbers of each part.
        root: ``(s + k, m)`` of the covariance of the noise.
        transition: ``(k, k)`` of the processes.
        gains: ``(f, s + k)`` of white increments and processes.

    Returns:
        The new ``z (..., k)``, ``noise (..., s + k)`` and exogenous input ``(..., f)``.
    """
    white, word = len(root) - len(transition), as_word(step)
    drawn = [
        each
        for part, count in enumerate(counts)
        for each in normals(keys[..., part, :], word, count)
    ]
    z = product(transition, z, noise[..., white:])
    noise = (
        product(root, np.stack(drawn, -1), np.zeros_like(noise)) if drawn else np.zeros_like(noise)
    )
    given = np.concatenate([noise[..., :white], z], -1)
    return z, noise, product(gains, given, np.zeros((*z.shape[:-1], len(gains))))
