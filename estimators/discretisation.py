"""Discretisation of models of continuous time."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from estimators.checks import AT_LEAST_0, as_array, number, shaped_array
from estimators.linalg import congruence, identity, joined, symmetrise
from estimators.models import LinearModel


def zero_order_hold(A: np.ndarray, B: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Exact discretisation of ``x' = A x + B u`` with ``u`` held over ``dt`` (batches allowed).

    Raises:
        ValueError: if ``dt`` is negative, or A or B is no array.
    """
    A, B, dt = as_array("A", A), as_array("B", B), number("dt", dt, AT_LEAST_0, what="at least 0")
    n, phi = A.shape[-1], _exponential(with_inputs(A, B) * dt)
    return phi[..., :n, :n], phi[..., :n, n:]


def with_inputs(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """``x' = A x + B u`` with u as more states ``(..., n + m, n + m)``, which stay."""
    above = joined([A, B], -1)
    return joined([above, np.zeros((B.shape[-1], above.shape[-1]))], -2)


def van_loan(
    A: np.ndarray, G: np.ndarray, Q: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """Transition matrix and noise covariance of ``x' = A x + G w`` over ``dt``; w has intensity Q.

    Source: Van Loan (1978), Computing integrals involving the matrix exponential.

    Raises:
        ValueError: if ``dt`` is negative, or A, G or Q is no array.
    """
    (A, G, Q), dt = map(as_array, "AGQ", (A, G, Q)), number("dt", dt, AT_LEAST_0, what="at least 0")
    return riccati_step(A, congruence(G, Q), np.zeros_like(A), dt)[:2]


def riccati_step(
    A: np.ndarray, Q: np.ndarray, J: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solution over ``dt`` of ``P' = A P + P A' + Q - P J P``, for every initial P.

    The covariance at the end is that of a Kalman filter which first gains information Y, and then
    predicts with transition F and process noise N::

        P(dt) = F (P^-1 + Y)^-1 F' + N

    They are blocks of the exponential of a Hamiltonian matrix, which also contains exp(-A t). A
    fast decay makes that huge, so the exponential is taken over a part of the step, and the part is
    then doubled by `riccati_composition`.

    Args:
        A: ``(n, n)``.
        Q: ``(n, n)`` intensity of the process noise.
        J: ``(n, n)`` information that measurements give per unit of time, ``C' R^-1 C``.
        dt: Length of the step.

    Returns:
        F, N and Y, each ``(n, n)``.
    """
    n, hamiltonian = len(A), np.vstack([np.hstack([-A, Q]), np.hstack([J, A.T])])
    # Units of the states in which its rows are about as large as its columns (Osborne 1960).
    size, units = np.abs(hamiltonian), np.ones(2 * n)
    for _ in range(3):
        rows, columns = (size @ units / units + 1e-100).reshape(2, n)
        change = np.clip(rows / columns, 1e-24, 1e24) ** 0.25
        units *= np.concatenate([change, 1.0 / change])
    hamiltonian = hamiltonian * units / units[:, None]
    rate = float(np.linalg.norm(hamiltonian, 1))
    doublings = math.ceil(math.log2(max(1.0, 0.5 * rate * dt)))
    part = _exponential(hamiltonian * (dt / 2**doublings))
    F = np.linalg.inv(part[:n, :n])
    step = F, F @ part[:n, n:], part[n:, :n] @ F
    for _ in range(doublings):
        step = riccati_composition(step, step)
    (F, N, Y), units = step, units[:n]
    scale = np.outer(units, units)
    return F * units[:, None] / units, symmetrise(N) * scale, symmetrise(Y) / scale


RiccatiMap = tuple[np.ndarray, np.ndarray, np.ndarray]
"""F, N and Y ``(..., n, n)`` of the map ``P -> F (P^-1 + Y)^-1 F' + N`` of covariances."""


def riccati_composition(one: RiccatiMap, two: RiccatiMap) -> RiccatiMap:
    """The map that applies one map of covariances, and then another.

    Composed with itself, a map covers twice as many steps (the doubling algorithm).

    Source: Anderson & Moore (1979), Optimal Filtering, section 6.7.
    """
    (F, N, Y), (F2, N2, Y2) = one, two
    n = F.shape[-1]
    both = np.linalg.solve(identity(n) + N @ Y2, joined([F, N @ F2.mT], -1))
    after, added = both[..., :n], both[..., n:]
    return F2 @ after, N2 + F2 @ added, Y + F.mT @ Y2 @ after


def _exponential(matrix: np.ndarray) -> np.ndarray:
    """Exponential of matrices ``(..., n, n)`` by scaling, a [13/13] Padé approximant and squaring.

    SciPy has it too, but takes longer to import than this package.
    Source: Higham (2005), The scaling and squaring method for the matrix exponential revisited.
    """
    largest = np.abs(matrix).sum(-2).max(initial=0.0)
    squarings = max(0, math.frexp(largest / 5.37)[1])
    A, unit = matrix / 2.0**squarings, identity(matrix.shape[-1])
    square, even, odd = A @ A, np.zeros_like(A), np.zeros_like(A)
    for k in range(12, -1, -2):
        even = even @ square + math.comb(13, k) / math.perm(26, k) * unit
        odd = odd @ square + math.comb(13, k + 1) / math.perm(26, k + 1) * unit
    odd = A @ odd
    exponential = np.linalg.solve(even - odd, even + odd)
    for _ in range(squarings):
        exponential = exponential @ exponential
    return exponential


def sampled(
    A: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, B: np.ndarray | None = None
) -> LinearModel:
    """The model of ``x' = A x + B u + w``, ``y = C x + v``, measured at irregular times.

    The last component of the known input is the length of the step; `run` appends it when given
    times. The components before it are the control, which is held over the step.

    Args:
        A: ``(n, n)``, of continuous time.
        C: ``(p, n)``.
        Q: ``(n, n)`` intensity of the white noise w, a variance per unit of time.
        R: ``(p, p)`` covariance of a measurement.
        B: ``(n, m)``, or None.

    Raises:
        ValueError: naming the argument whose shape or definiteness is wrong; or in a step, if the
            known input lacks the step's length or the length is negative.
    """
    model = LinearModel(A, C, Q, R, B)
    A, B, Q = matrices(model, "ABQ")
    steps = _Sampled(model.n, with_inputs(A, B), np.pad(Q, (0, B.shape[1])))
    names = [name for name in "ABQ" if getattr(model, name) is not None]
    over_steps: Any = {name: partial(steps.matrix, name) for name in names}
    return replace(model, **over_steps)


def matrices(model: LinearModel, names: str) -> list[np.ndarray]:
    """Matrices of a model by their letters; without known input, B is ``(n, 0)``.

    Raises:
        ValueError: naming a matrix that is a function or has batch axes.
    """
    given = vars(model) | {"B": np.zeros((model.n, 0)) if model.B is None else model.B}
    return [shaped_array(name, given[name], "n", "m") for name in names]


@dataclass(frozen=True, eq=False)
class _Sampled:
    """``x' = A x + B u + w`` with u as m more states, discretised once for each step length."""

    n: int
    A: np.ndarray  # (n + m, n + m)
    Q: np.ndarray

    def matrix(self, name: str, u: np.ndarray | None) -> np.ndarray:
        """A, B or Q ``(..., n, k)`` over steps as long as the last component of u."""
        m = len(self.A) - self.n
        if u is None or u.shape[-1] != m + 1:
            controls = f"its {m} controls and " if m else ""
            raise ValueError(
                f"the known input of a sampled model is {controls}how long each step takes: give"
                " run the times t of the measurements"
            )
        lengths = u[..., -1].ravel().tolist()
        found = np.array([_over_step(self, length)[name] for length in lengths])
        return found.reshape(u.shape[:-1] + found.shape[1:])


@lru_cache(maxsize=1024)
def _over_step(system: _Sampled, length: float) -> dict[str, np.ndarray]:
    """A, B and Q by name over one step; NaN where its length is not finite."""
    n, unit = system.n, np.eye(len(system.A))
    A, Q = (np.nan * unit,) * 2
    if math.isfinite(length):
        A, Q = van_loan(system.A, unit, system.Q, length)
    B = np.concatenate([A[:n, n:], np.zeros((n, 1))], 1)  # the length itself moves no state
    return {"A": A[:n, :n], "B": B, "Q": Q[:n, :n]}
