"""Models of continuous time over steps of some length."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy.linalg import expm

from estimators.checks import AT_LEAST_0, as_array, number
from estimators.linalg import congruence
from estimators.models import LinearModel


def zero_order_hold(A: np.ndarray, B: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Exact discretisation of ``x' = A x + B u`` with ``u`` held over ``dt`` (batches allowed).

    Raises:
        ValueError: if ``dt`` is negative, or A or B is no array.
    """
    (A, B), dt = map(as_array, "AB", (A, B)), number("dt", dt, AT_LEAST_0, what="at least 0")
    n, m = A.shape[-1], B.shape[-1]
    block = np.zeros(np.broadcast_shapes(A.shape[:-2], B.shape[:-2]) + (n + m, n + m))
    block[..., :n, :n] = A
    block[..., :n, n:] = B
    phi = expm(block * dt)
    return phi[..., :n, :n], phi[..., :n, n:]


def van_loan(
    A: np.ndarray, G: np.ndarray, Q: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """Transition and process noise of ``x' = A x + G w``, white ``w`` of intensity ``Q``, over ``dt``.

    Source: Van Loan (1978), Computing integrals involving the matrix exponential.

    Raises:
        ValueError: if ``dt`` is negative, or A, G or Q is no array.
    """
    (A, G, Q), dt = map(as_array, "AGQ", (A, G, Q)), number("dt", dt, AT_LEAST_0, what="at least 0")
    n = A.shape[-1]
    # exp(-A t) is in it, which a fast decay makes huge: over a part of the step, of which two make
    # one twice as long
    halves = max(0, math.ceil(np.log2(np.linalg.norm(A, 1) * dt / 4.0))) if dt and np.any(A) else 0
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

    How long a step takes is the last component of the known input, where `run` puts it when it is
    told times; the control before it is held over the step.

    Args:
        A: ``(n, n)``, of continuous time.
        C: ``(p, n)``.
        Q: ``(n, n)`` intensity of the white noise w: variance a unit of time.
        R: ``(p, p)`` covariance of a measurement.
        B: ``(n, m)``, or None.
        state_angles: As of `LinearModel`.
        measurement_angles: Likewise.

    Raises:
        ValueError: naming the argument whose shape or definiteness is wrong, or later if a step has
            no length.
    """
    model = LinearModel(
        A, C, Q, R, B=B, state_angles=state_angles, measurement_angles=measurement_angles
    )
    rates: Any = model  # which has checked them
    for name in "ACQR" if B is None else "ABCQR":
        if callable(getattr(rates, name)) or getattr(rates, name).ndim > 2:
            raise ValueError(
                f"{name} of a sampled model must be one matrix, for all rows and times"
            )
    system = _Sampled(rates.A, np.zeros((model.n, 0)) if B is None else rates.B, rates.Q)
    matrices: dict[str, Any] = {
        name: partial(system.matrix, name) for name in ("ABQ" if system.B.size else "AQ")
    }
    return replace(model, **({"B": None} | matrices))


@dataclass(frozen=True, eq=False)
class _Sampled:
    """``x' = A x + B u + w``, discretised once for each length of a step."""

    A: np.ndarray
    B: np.ndarray
    Q: np.ndarray

    def untimed(self) -> ValueError:
        """The error of a known input without a length of the step."""
        controls = f"its {m} controls and " if (m := self.B.shape[1]) else ""
        return ValueError(
            f"the known input of a sampled model is {controls}how long each step takes, not below"
            " 0: give run the times t of the measurements"
        )

    def matrix(self, name: str, u: np.ndarray | None) -> np.ndarray:
        """A, B or Q ``(..., n, k)`` over steps whose lengths are the last component of ``u (..., m + 1)``."""
        m = self.B.shape[1]
        if u is None or u.shape[-1] != m + 1:
            raise self.untimed()
        if u.size == m + 1:  # np.unique takes long
            matrix = _over_step(self, u.item(-1))[name]
            return matrix.reshape(u.shape[:-1] + matrix.shape)
        lengths, rows = np.unique(u[..., -1], return_inverse=True)
        return np.stack([_over_step(self, length)[name] for length in lengths.tolist()])[
            rows.reshape(u.shape[:-1])
        ]


@lru_cache(maxsize=1024)
def _over_step(system: _Sampled, length: float) -> dict[str, np.ndarray]:
    """A, B and Q by name over one step; NaN where its length is not finite."""
    n, m = system.B.shape
    if length < 0.0:
        raise system.untimed()
    if math.isfinite(length):
        A, Q = van_loan(system.A, np.eye(n), system.Q, length)
        B = zero_order_hold(system.A, system.B, length)[1] if m else np.zeros((n, 0))
    else:
        A, B, Q = (np.full((n, columns), np.nan) for columns in (n, m, n))
    return {"A": A, "B": np.concatenate([B, np.zeros((n, 1))], 1), "Q": Q}


def forward_euler(A: np.ndarray, B: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """``I + A dt`` and ``B dt``: the discretisation that the source papers use."""
    return np.eye(A.shape[-1]) + A * dt, B * dt
