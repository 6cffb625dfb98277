"""Models of continuous time over steps of some length."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import expm

from estimators.checks import frozen
from estimators.linalg import congruence
from estimators.models import LinearModel


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
