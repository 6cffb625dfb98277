"""Conditions under which measurements of a linear system determine its unknown inputs."""

from typing import NamedTuple

import numpy as np

from estimators.discretisation import matrices
from estimators.kalman import input_covariance
from estimators.linalg import congruence, identity
from estimators.models import LinearModel
from estimators.steady import steady_state


class InputConditions(NamedTuple):
    """Observability of the unknown inputs of a linear system.

    Attributes:
        rank: Number of directions of d that measurements show, at once or one step later. An
            unbiased filter needs all q.
        sd: ``(q,)`` standard deviation with which the measurements show each input, in units of the
            prior's standard deviation. An input with a value above about 3 does not count as shown.
            Infinite if the input has a part in a direction of d that does not show.
        zeros: Invariant zeros that d adds to the system. Each stands for an input that no
            measurement ever shows. With a zero on or outside the unit circle the errors of an
            unbiased filter grow without bound. A single NaN stands for all complex numbers: each is
            a zero.
    """

    rank: int
    sd: np.ndarray
    zeros: np.ndarray


def input_conditions(
    A: np.ndarray,
    C: np.ndarray,
    G: np.ndarray,
    H: np.ndarray,
    Q: np.ndarray,
    R: np.ndarray,
    prior: np.ndarray | float,
) -> InputConditions:
    """Observability of the unknown inputs of ``x+ = A x + G d + w``, ``y = C x + H d + v``.

    Measurements show a direction of d at once through H, or one step later through C G. In the
    second case only that part of a measurement counts which is free of H d. This covers
    the rank conditions of all filters with unknown input.

    The standard deviations ``sd`` of the estimates of d assume that the state's covariance is the
    steady one of a Kalman filter to which d is known. If there is no steady one, they assume that
    the state is known. An unbiased filter knows the state less well. Invariant zeros above 1000 in
    modulus count as infinite and are not in ``zeros``.

    Args:
        A: ``(n, n)``; no argument has batch axes.
        C: ``(p, n)``.
        G: ``(n, q)``.
        H: ``(p, q)``.
        Q: ``(n, n)``.
        R: ``(p, p)``, positive definite.
        prior: ``(q, q)`` covariance of d, or a number for that number times identity.

    Raises:
        ValueError: naming the argument that has a wrong shape or is not a covariance.
        LinAlgError: if ``R`` or ``prior`` is singular.
    """
    model = LinearModel(A, C, Q, R, G=G, H=H)
    q = model.q
    A, C, G, H, _, R = matrices(model, "ACGHQR")
    cov = input_covariance("prior", prior, q)
    root, noise = np.linalg.cholesky(cov), np.linalg.cholesky(R)
    G, H = G @ root, H @ root
    now, delayed = observable_ranks(C, G, H)
    try:
        S = congruence(C, steady_state(model).before[0]) + R
    except ValueError:
        S = R
    one_step, observable = _one_step(driven_measurements(C, G), H, np.linalg.inv(S))
    unseen = congruence(root, np.eye(q) - observable)
    share, hidden = (
        np.diagonal(each) / np.diagonal(cov) for each in (congruence(root, one_step), unseen)
    )
    sd = np.where(hidden > 1e-9, np.inf, np.sqrt(share))
    zeros = _added_zeros(A, np.linalg.solve(noise, C), G, np.linalg.solve(noise, H))
    return InputConditions(int(now + delayed), sd, zeros)


def driven_measurements(C: np.ndarray, G: np.ndarray) -> np.ndarray:
    """``C G (..., p, q)``, 0 where it is nothing but rounding."""
    CG = C @ G
    return np.where(np.abs(CG) > 1e-12 * (np.abs(C) @ np.abs(G)), CG, 0.0)


def observable_ranks(C: np.ndarray, G: np.ndarray, H: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of inputs that ``H (..., p, q)`` shows at once, and ``C G`` one step later."""
    seen, CG = np.linalg.pinv(H, rcond=1e-9), driven_measurements(C, G)
    clean = (identity(H.shape[-2]) - H @ seen) @ CG @ (identity(H.shape[-1]) - seen @ H)
    delayed = np.linalg.matrix_rank(clean, tol=1e-9 * np.linalg.norm(CG, 2, (-2, -1)))
    return np.linalg.matrix_rank(H, rtol=1e-9), delayed


def _one_step(
    CG: np.ndarray, H: np.ndarray, precision: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance ``(q, q)`` of d, from what shows each direction first, and a projector."""

    def best(F: np.ndarray, weight: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
        values, directions = np.linalg.eigh(congruence(F.T, weight))
        chosen = values > 1e-14 * size
        observable = directions[:, chosen]
        return (observable / values[chosen]) @ observable.T, observable @ observable.T

    now, seen = best(H, precision, np.trace(congruence(H.T, precision)))
    rest, left = CG @ (np.eye(len(seen)) - seen), precision - congruence(precision @ H, now)
    delayed, others = best(rest, left, np.trace(congruence(CG.T, precision)))
    return now + delayed, seen + others


def _added_zeros(A: np.ndarray, C: np.ndarray, G: np.ndarray, H: np.ndarray) -> np.ndarray:
    """Numbers z at which ``[A - z I, G; C, H]`` loses more column rank than ``[A - z I; C]`` does.

    Candidates are the zeros of q random sums of the measurements, which include those of the
    system. They are found as eigenvalues by a shift and an inverse.
    """
    n, q = G.shape
    system, states = np.block([[A, G], [C, H]]), np.eye(n + len(C), n + q)
    states[n:] = 0.0

    def adds(z: complex) -> bool:
        pencil = system - z * states
        size = np.linalg.norm(pencil, axis=0)
        pencil /= np.where(size > 0.0, size, 1.0)
        rank, undriven = (
            np.linalg.matrix_rank(part, rtol=1e-9) for part in (pencil, pencil[:, :n])
        )
        return bool(rank - undriven < q)

    rng = np.random.default_rng(0)
    shift = complex(*rng.normal(size=2))
    if adds(shift):
        return np.array([complex(np.nan)])
    square = np.vstack([system[:n], rng.normal(size=(q, len(C))) @ system[n:]])
    shifted = square - shift * states[: n + q]
    with np.errstate(divide="ignore", invalid="ignore"):  # 0: a zero at infinity
        candidates = shift + 1.0 / np.linalg.eigvals(np.linalg.solve(shifted, states[: n + q]))
    return np.array([z for z in candidates if np.abs(z) < _INFINITE and adds(z)], complex)


_INFINITE = 1e3
"""Zeros of a larger modulus are infinite zeros with rounding errors."""
