"""Likelihood of printed errors given ours.

The logarithm of a printed error is normal about that of ours. Its variance has three parts: the Monte Carlo spread of a
run, the rounding of the print, and a discrepancy that the repetitions of an experiment share, for what no alternative
has (the record, the vehicle). The numbers of a paper count as independent given the alternatives.
"""

from collections.abc import Sequence

import numpy as np


def half_unit(printed: str) -> float:
    """Half a unit of the last printed digit."""
    return 0.5 * 10.0 ** -len(printed.partition(".")[2])


def log_likelihood(
    printed: Sequence[str], log_mean: np.ndarray, log_sd: np.ndarray, discrepancy: float, averaged: int = 1
) -> np.ndarray:
    """Log likelihood ``(...)`` of the printed repetitions of one experiment.

    Args:
        printed: Repetitions, to the digit.
        log_mean: ``(...)`` mean over runs of the logarithm of our error.
        log_sd: ``(...)`` its standard deviation over runs.
        discrepancy: Standard deviation of the shared part, in units of the logarithm.
        averaged: Runs behind each repetition.
    """
    x, n = np.log([float(text) for text in printed]), len(printed)
    rounding = np.log1p(half_unit(printed[0]) / np.exp(x.mean())) / np.sqrt(3.0)
    within = log_sd**2 / averaged + rounding**2
    shared = discrepancy**2 + within / n
    scatter = ((x - x.mean()) ** 2).sum()
    found = -0.5 * (np.log(2.0 * np.pi * shared) + (x.mean() - log_mean) ** 2 / shared)
    found = found - 0.5 * ((n - 1) * np.log(2.0 * np.pi * within) + np.log(n) + scatter / within)
    return np.where(np.isfinite(found), found, -1e9)


def of_errors(printed: Sequence[Sequence[str]], errors: np.ndarray, discrepancy: float, averaged: int = 1) -> float:
    """Log likelihood of printed quantities, each with its repetitions, given our errors ``(runs, quantities)``."""
    logs = np.log(errors)
    pairs = zip(printed, logs.T, strict=True)
    return float(
        sum(log_likelihood(texts, each.mean(), each.std(ddof=1), discrepancy, averaged) for texts, each in pairs)
    )
