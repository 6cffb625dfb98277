"""All states and inputs of a linear system at once, by least squares."""

from typing import NamedTuple

import numpy as np

from tests.estimators.cases import System


class Posterior(NamedTuple):
    """What all measurements of one run say.

    Attributes:
        x: ``(T, n)`` states.
        d: ``(T, q)`` unknown inputs.
        cov: Covariance of all states and then all inputs, each time after time.
        log_likelihood: Of the measurements, integrated over what nothing is supposed of.
    """

    x: np.ndarray
    d: np.ndarray
    cov: np.ndarray
    log_likelihood: float


def least_squares(
    system: System, y: np.ndarray, u: np.ndarray, told: dict[int, np.ndarray] | None = None
) -> Posterior:
    """States and inputs of one run, given measurements ``y (T, p)``; NaN is missing.

    Args:
        system: A linear one, with or without an unknown input.
        y: ``(T, p)``.
        u: ``(T, m)``.
        told: By time, directions ``(k, q)`` of which the input is known to be 0 but for a variance
            of 1 each. Nothing is supposed of it in others. What acts on no measurement must be
            told.
    """
    model, T = system.model, len(y)
    n, q = model.n, model.q
    rows, noise, targets = [], [], []

    def add(row: dict[int, np.ndarray], target: np.ndarray, cov: np.ndarray) -> None:
        whole = np.zeros((len(target), T * (n + q)))
        for first, block in row.items():
            whole[:, first : first + block.shape[1]] = block
        root = np.linalg.cholesky(cov)
        rows.append(np.linalg.solve(root, whole))
        targets.append(np.linalg.solve(root, target))
        noise.append(2.0 * np.log(np.diag(root)).sum() + len(target) * np.log(2.0 * np.pi))

    add({0: np.eye(n)}, system.mean, system.cov)
    for k in range(T):
        if k:
            drive = {n * (k - 1): -model.A, n * k: np.eye(n)}
            if q:
                drive[T * n + q * (k - 1)] = -model.G
            add(drive, model.B @ u[k - 1], model.Q)
        seen = np.isfinite(y[k])
        if seen.any():
            row = {n * k: model.C[seen]} | ({T * n + q * k: model.H[seen]} if q else {})
            add(row, y[k, seen], model.R[np.ix_(seen, seen)])
        if told and k in told:
            add({T * n + q * k: told[k]}, np.zeros(len(told[k])), np.eye(len(told[k])))
    M, b = np.concatenate(rows), np.concatenate(targets)
    triangle = np.linalg.qr(M, mode="r")
    solution, *_ = np.linalg.lstsq(M, b, rcond=None)
    inverse = np.linalg.inv(triangle)
    free = T * (n + q)
    log_likelihood = -0.5 * (
        np.square(b - M @ solution).sum() + sum(noise) - free * np.log(2.0 * np.pi)
    ) - np.log(np.abs(np.diag(triangle))).sum()  # fmt: skip
    return Posterior(
        solution[: T * n].reshape(T, n),
        solution[T * n :].reshape(T, q),
        inverse @ inverse.T,
        log_likelihood,
    )


def marginals(cov: np.ndarray, size: int) -> np.ndarray:
    """The blocks ``(T, size, size)`` on the diagonal."""
    T = len(cov) // size
    return np.einsum("titj->tij", cov.reshape(T, size, T, size))
