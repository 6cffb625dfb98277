"""Gauss-Markov processes: what currents, gusts, waves and the biases of sensors are made of."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import block_diag, solve_continuous_lyapunov

from estimators import van_loan
from estimators.checks import finite_array, frozen, shown
from estimators.compiled import rowwise
from estimators.models import as_covariance
from estimators.threefry import normals_of_rows
from vessel_gym.checks import check_numbers

_Function = TypeVar("_Function", bound=Callable[..., Any])


def linear(function: _Function) -> _Function:
    """Declare that what a disturbance does, or a sensor reads, is a matrix times its arguments.

    The matrix is taken from the function, which is then no longer called at every step.
    """
    vars(function)["linear"] = True
    return function


def row_by_row(function: _Function) -> _Function:
    """Declare that what a disturbance does to one vehicle has the same bits among others: threads may share them."""
    vars(function)["row_by_row"] = True
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
        for name in ("transition", "root", "start_cov"):  # laid out alike in every copy: the last bit depends on it
            shape = ("k", "m") if name == "root" else ("...",)
            values = finite_array(f"{name} of a process", getattr(self, name), *shape)
            object.__setattr__(self, name, frozen(np.array(values, order="C")))
        k = len(self.root)
        for name, values in (("transition", self.transition), ("start_cov", self.start_cov)):
            if np.shape(values) != (k, k):
                raise ValueError(
                    f"{name} must have shape {(k, k)}, as many rows as root of shape {np.shape(self.root)}, got "
                    f"{np.shape(values)}"
                )
        if k:
            object.__setattr__(self, "start_cov", frozen(as_covariance("start_cov of a process", self.start_cov)))

    @property
    def size(self) -> int:
        """k, components of the state."""
        return self.root.shape[0]

    @property
    def normals(self) -> int:
        """m, normal numbers a step."""
        return self.root.shape[1]

    def advance(self, z: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """``transition z`` of states ``(..., k)``, entry by entry: the same to the last bit in any batch."""
        moved = np.multiply(z, self._decay, out)
        for i, j, entry in self._couplings:
            moved[..., i] += entry * z[..., j]
        return moved

    @cached_property
    def start_root(self) -> np.ndarray:
        """A root of ``start_cov``."""
        return root_of(self.start_cov)

    @cached_property
    def _decay(self) -> np.ndarray:
        """The diagonal of the transition."""
        return np.diag(self.transition).copy()

    @cached_property
    def _couplings(self) -> list[tuple[int, int, float]]:
        """Its other entries but for zeros, of which a few processes side by side have most."""
        couples = self.transition - np.diag(self._decay)
        return [(int(i), int(j), float(couples[i, j])) for i, j in np.argwhere(couples)]

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
            raise ValueError(f"A and W must be square and of one size, got shapes {A.shape} and {W.shape}")
        if not np.linalg.eigvals(A).real.max() < 0.0:
            raise ValueError("A must be stable (eigenvalues with negative real parts): otherwise the process grows")
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
    def walk(cls, start: tuple[float, ...] | np.ndarray, pace: tuple[float, ...] | np.ndarray, dt: float) -> "Process":
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
                raise TypeError(f"Process.joined joins processes, got {shown(each)}")
        if not processes:
            return cls(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)))
        return cls(
            *(block_diag(*(getattr(p, name) for p in processes)) for name in ("transition", "root", "start_cov"))
        )


def _sizes(name: str, value: object) -> np.ndarray:
    """Standard deviations ``(k,)``."""
    sizes = finite_array(name, value, "k")
    if (sizes < 0.0).any():
        raise ValueError(f"{name} must be standard deviations of at least 0, got {shown(value)}")
    return sizes


def root_of(cov: np.ndarray) -> np.ndarray:
    """A square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0.0))


@rowwise("void(u8[:,:,::1],i8[::1],i8[::1],f8[:,::1],f8[:,::1],f8[:,::1],f8[:,::1],f8[:,::1],f8[:,::1])")
def stir(
    keys: np.ndarray, steps: np.ndarray, counts: np.ndarray, root: np.ndarray, transition: np.ndarray,
    gains: np.ndarray, z: np.ndarray, noise: np.ndarray, forcing: np.ndarray,
) -> None:  # fmt: skip
    """Move processes by a step, draw what is new over the next one, and what acts then: steps and the last three.

    Products are sums entry by entry: the same to the last bit in any batch.

    Args:
        keys: ``(B, parts, 2)`` of the random numbers of each part.
        steps: ``(B,)`` how many lie behind.
        counts: ``(parts,)`` how many each takes.
        root: ``(s + k, m)`` what they make: white kicks, then what is new in the processes.
        transition: ``(k, k)`` of these.
        gains: ``(f, s + k)`` what white kicks and processes give.
        z: ``(B, k)`` the processes.
        noise: ``(B, s + k)`` what ``root`` has made.
        forcing: ``(B, f)`` what ``gains`` do.
    """
    B, size, drawn = len(steps), len(transition), 0
    shaken = len(root) - size
    for row in range(B):
        steps[row] += 1
    normals, words = np.empty((root.shape[1] + 1, B)), np.empty((2, B), np.uint64)
    for part in range(len(counts)):
        normals_of_rows(keys, part, steps, counts[part], words, normals, drawn)
        drawn += counts[part]
    for i in range(size):
        for j in range(size):
            if transition[i, j] != 0.0:
                for row in range(B):
                    noise[row, shaken + i] += transition[i, j] * z[row, j]
    for row in range(B):
        for i in range(size):
            z[row, i] = noise[row, shaken + i]
        for i in range(len(root)):
            noise[row, i] = 0.0
        for i in range(len(gains)):
            forcing[row, i] = 0.0
    for i in range(len(root)):
        for j in range(root.shape[1]):
            if root[i, j] != 0.0:
                for row in range(B):
                    noise[row, i] += root[i, j] * normals[j, row]
    for i in range(len(gains)):
        for j in range(gains.shape[1]):
            if gains[i, j] != 0.0:
                for row in range(B):
                    forcing[row, i] += gains[i, j] * (noise[row, j] if j < shaken else z[row, j - shaken])
