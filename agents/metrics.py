"""What figures of an episode are made of: their description, root mean squares and consistency."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from agents.rollouts import Rollout
from estimators import chi_square_band, nees

WITHOUT_COVARIANCE = ("truth", "measurement")
"""Estimators that claim no uncertainty of their own: their NEES means nothing."""


@dataclass(frozen=True)
class Metric:
    """A figure of an episode.

    Attributes:
        key: its name in `scores` and in files.
        label: its name in tables.
        unit: empty where it has none.
        better: ``"higher"``, ``"lower"``, ``"near 1"``, or ``""`` where it is not a matter of better.
        decimals: digits worth printing.
        meaning: one sentence.
        yes_or_no: whether each episode has 0 or 100 % of it.
    """

    key: str
    label: str
    unit: str
    better: str
    decimals: int
    meaning: str
    yes_or_no: bool = False


SCORE = Metric(
    "score", "Score", "", "higher", 3, "Sum of rewards over that of a perfect episode, computed from the truth; 0 to 1."
)
RETURN = Metric("return", "Return", "", "higher", 1, "Sum of rewards.")
NEES = Metric(
    "nees", "NEES/n", "", "near 1", 2,
    "Mean squared estimation error in units of the claimed covariance, per state; above 1: too sure of itself.",
)  # fmt: skip
UNHEALTHY = Metric(
    "unhealthy", "Failed updates", "steps", "lower", 1, "Steps at which the estimator's usual update failed."
)


def common(rollout: Rollout) -> dict[str, np.ndarray]:
    """The metrics that every task has, ``(N,)`` by key."""
    return {
        "score": rollout.score.astype(float),
        "return": rollout.returns.astype(float),
        "steps": rollout.length.astype(float),
        "nees": mean_nees(rollout),
        "unhealthy": np.sum(rollout.alive & ~rollout.history["healthy"], axis=0).astype(float),
    }


def core_of(rollout: Rollout) -> Any:
    """The core of the environment that was flown."""
    return rollout.env.unwrapped.core


def rms(error: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square over time of errors ``(T, N)`` where the mask holds; NaN where it never does."""
    count = mask.sum(0)
    mean = np.where(mask, error, 0.0) ** 2
    return np.sqrt(np.where(count > 0, mean.sum(0) / np.maximum(count, 1), np.nan))


def nees_of(rollout: Rollout, components: tuple[int, ...] | None = None) -> np.ndarray | None:
    """NEES ``(T + 1, N)``, or None for an estimator without a covariance of its own.

    Args:
        rollout: with its history.
        components: of the filter's state; None: all.
    """
    core, h = core_of(rollout), rollout.history
    if core.estimator in WITHOUT_COVARIANCE:
        return None
    n = h["estimate"].shape[-1]
    chosen = list(range(n) if components is None else components)
    state = core.estimated(h["truth"])
    angles = tuple(chosen.index(i) for i in core.filter.model.state_angles if i in chosen)
    cov = h["covariance"][..., chosen, :][..., chosen]
    return nees(h["estimate"][..., chosen], cov, state[..., chosen], angles)


def mean_nees(rollout: Rollout, components: tuple[int, ...] | None = None) -> np.ndarray:
    """Mean NEES per component of each episode ``(N,)``; NaN without a covariance."""
    values, alive = nees_of(rollout, components), rollout.alive
    if values is None:
        return np.full(len(rollout.seeds), np.nan)
    n = rollout.history["estimate"].shape[-1] if components is None else len(components)
    return np.where(alive, values, 0.0).sum(0) / alive.sum(0) / n


def consistency(rollout: Rollout, components: tuple[int, ...] | None = None) -> float | None:
    """Share of times at which the mean NEES over the runs lies in its 95 % chi-square band.

    About 0.95 for an estimator that is as good as it says; None for one that says nothing.

    Args:
        rollout: with its history.
        components: of the filter's state; None: all.
    """
    values = nees_of(rollout, components)
    if values is None:
        return None
    alive = rollout.alive
    n = rollout.history["estimate"].shape[-1] if components is None else len(components)
    runs = alive.sum(1)
    flown = runs > 0
    mean = np.where(alive, values, 0.0).sum(1)[flown] / runs[flown]
    band = np.array([_band(int(count), n) for count in runs[flown]])
    return float(np.mean((mean >= band[:, 0]) & (mean <= band[:, 1])))


def nis_consistency(rollout: Rollout) -> float | None:
    """Share of times at which the mean NIS over the runs lies in its 95 % chi-square band; None without innovations.

    The degrees of freedom are the readings that arrived.
    """
    values = rollout.history["nis"]
    seen = np.isfinite(values)
    degrees = np.where(seen, rollout.history["available"].sum(-1), 0).sum(1)
    told = degrees > 0
    if not told.any():
        return None
    total = np.where(seen, values, 0.0).sum(1)[told]
    band = np.array([_band(1, int(count)) for count in degrees[told]])
    return float(np.mean((total >= band[:, 0]) & (total <= band[:, 1])))


@cache
def _band(runs: int, degrees: int) -> tuple[float, float]:
    return chi_square_band(runs, degrees)
