"""Metrics of an episode: their description, root mean squares and consistency."""

import csv
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, wraps
from importlib.resources import files
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from agents.rollouts import Rollout
from estimators import nees
from estimators.angles import difference
from estimators.checks import frozen
from vessel_gym.models.estimation import WITHOUT_COVARIANCE

PerEpisode = Callable[[Rollout], np.ndarray | None]
"""One number of every episode of a rollout, ``(N,)``; NaN, or None for all, where there is none."""

_TOGETHER = 20_000
"""Covariances that are factorised at once: all those of many episodes would take ten gigabytes."""


@dataclass(frozen=True)
class Metric:
    """A metric of an episode.

    Attributes:
        key: Name of the metric in `scores` and in files.
        label: Name of the metric in tables.
        unit: Unit of the metric; empty for none.
        better: ``"higher"``, ``"lower"`` or ``"near 1"``; ``""`` where no value is better.
        decimals: Digits to print.
        meaning: Definition of the metric in one sentence.
        yes_or_no: True if the value of an episode is either 0 or 100 %.
        of: Function of a `Rollout` that returns one value for each episode, ``(N,)``, NaN where
            there is none; or None if no episode has a value.
        cost: True for a cost to the vehicle's owner, which tables show beside the score.
    """

    key: str
    label: str
    unit: str
    better: str
    decimals: int
    meaning: str
    yes_or_no: bool = False
    of: PerEpisode = field(kw_only=True)
    cost: bool = False

    @property
    def title(self) -> str:
        """Label and unit of the metric, as the head of a column."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


@cache
def _catalogue() -> list[list[str]]:
    """Rows of ``metrics.csv``."""
    with files("agents.metrics").joinpath("metrics.csv").open(encoding="utf-8") as file:
        return list(csv.reader(file))


def described(task: str, **of: PerEpisode) -> tuple[Metric, ...]:
    """Metrics of a kind of task in the order of ``metrics.csv``, with their functions by key."""
    return tuple(
        Metric(
            *(key, label, unit, better, int(decimals), meaning),
            yes_or_no=kind == "yes or no",
            of=of[key],
            cost=kind == "cost",
        )
        for tasks, key, label, unit, better, decimals, kind, meaning in _catalogue()
        if task in tasks.split(", ")
    )


def once(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of a rollout and names that is evaluated once, since several metrics need it.

    Its callers share the arrays that it returns, so they must not write into them.
    """
    results = WeakKeyDictionary[Rollout, dict[tuple[str, ...], Any]]()

    @wraps(function)
    def of(rollout: Rollout, *names: str) -> Any:
        found = results.setdefault(rollout, {})
        if names not in found:
            found[names] = function(rollout, *names)
        return found[names]

    return of


def rms_of(error: Callable[[Rollout], np.ndarray], scale: float = 1.0) -> PerEpisode:
    """RMS over each episode of an error ``(T + 1, N)``.

    Args:
        error: Function of a rollout.
        scale: Factor from the error's unit to the metric's unit.
    """
    return lambda rollout: scale * rms(error(rollout), rollout.alive)


def rmse(*names: str, scale: float = 1.0) -> PerEpisode:
    """Metric function for the RMS, over an episode, of the norm of the error in some components.

    Its value is None where the estimator has none of these components.

    Args:
        names: Names of components of the estimated state.
        scale: Factor from SI units to the metric's unit.
    """

    def of(rollout: Rollout) -> np.ndarray | None:
        if not (chosen := components(rollout, *names)):
            return None
        return rms(np.sqrt((_errors(rollout)[..., chosen] ** 2).sum(-1)), rollout.alive) * scale

    return of


@once
def _errors(rollout: Rollout) -> np.ndarray:
    """Errors ``(T + 1, N, n)`` of the estimates."""
    config, history = rollout.config, rollout.history
    truth = config.true_state.in_filter_order(history["truth"])
    return difference(history["estimate"], truth, config.estimation.filter.model.state_angles)


def nees_in(*names: str) -> PerEpisode:
    """Mean NEES of the components with these names."""
    return lambda rollout: mean_nees(rollout, *names)


def ended(end: str) -> PerEpisode:
    """Metric function for the share of episodes with this end reason [%]: 0 or 100 for each."""
    return lambda rollout: 100.0 * (rollout.end == end)


def input_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray] | None:
    """Errors of the estimated unknown input ``(T', N, q)``, and when an episode lived ``(T', N)``.

    The estimate of a step is of the input of some steps before: there are as many times fewer. None
    where none is estimated.
    """
    estimation, h, alive = rollout.config.estimation, rollout.history, rollout.alive
    if rollout.core.now.belief.input_mean is None:
        return None
    delay = estimation.input_delay
    true = h["unknown_input"][: len(alive) - delay]
    return h["input_estimate"][delay:] - true, alive[delay:]


def _input_rmse(rollout: Rollout) -> np.ndarray | None:
    space, found = rollout.config.estimation.space, input_errors(rollout)
    if found is None or not space.inputs:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        error = found[0] / np.sqrt(np.diag(space.input_cov))
    return rms(np.sqrt((error**2).mean(-1)), found[1])


def mean_nees(rollout: Rollout, *names: str) -> np.ndarray | None:
    """Mean NEES per component, as `nees_of`, of each episode ``(N,)``."""
    values, alive = nees_of(rollout, *names), rollout.alive
    if values is None:
        return None
    return values.mean(0, where=alive) / len(_known(rollout, names))


SCORE, RETURN, STEPS, INPUT, NEES, UNHEALTHY = described(
    "every",
    score=lambda rollout: rollout.score,
    steps=lambda rollout: rollout.length,
    input_rmse=_input_rmse,
    nees=mean_nees,
    unhealthy=lambda rollout: (rollout.alive & ~rollout.history["healthy"]).sum(0),
    **{"return": lambda rollout: rollout.returns},
)


def components(rollout: Rollout, *names: str) -> tuple[int, ...]:
    """Indices of the components of the estimated state with these names."""
    return tuple(i for i, name in enumerate(rollout.config.estimation.space.names) if name in names)


def rms(error: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square over time of errors ``(T, N)`` where the mask holds."""
    return np.sqrt((error**2).mean(0, where=mask))


@once
def nees_of(rollout: Rollout, *names: str) -> np.ndarray | None:
    """NEES ``(T + 1, N)``, read-only, or None for an estimator without a covariance of its own.

    Args:
        rollout: Rollout with a history.
        names: Components of the filter's state; without names, all that the true state also has.
    """
    config, h = rollout.config, rollout.history
    if config.estimation.filter.name in ("", *WITHOUT_COVARIANCE):
        return None
    chosen = list(_known(rollout, names))
    state = config.true_state.in_filter_order(h["truth"])
    turning = config.estimation.filter.model.state_angles
    angles = tuple(chosen.index(i) for i in turning if i in chosen)

    def at(times: slice) -> np.ndarray:
        cov = h["covariance"][times][..., np.array(chosen)[:, None], chosen]
        return nees(h["estimate"][times][..., chosen], cov, state[times][..., chosen], angles)

    together = -(-_TOGETHER // len(rollout.seeds))
    blocks = [slice(k, k + together) for k in range(0, len(state), together)]
    return frozen(np.concatenate([*map(at, blocks)]))


def _known(rollout: Rollout, names: tuple[str, ...]) -> tuple[int, ...]:
    """Components of these names; without names, those that the true state also has."""
    if names:
        return components(rollout, *names)
    truth = rollout.config.true_state.in_filter_order(rollout.history["truth"])
    absent = np.isnan(truth).all((0, 1))
    return tuple(np.flatnonzero(~absent).tolist())


def consistency(rollout: Rollout, *names: str) -> float | None:
    """Share of times at which the mean NEES over the episodes lies in its 95 % chi-square band.

    About 0.95 for an estimator with a correct covariance; None for one without a covariance of its
    own.

    Args:
        rollout: Rollout with a history.
        names: Components of the filter's state; without names, all that the true state also has.
    """
    from scipy.special import chdtr

    values, size = nees_of(rollout, *names), len(_known(rollout, names))
    if values is None or not size:
        return None
    total, freedom = values.sum(1, where=rollout.alive), size * rollout.alive.sum(1)
    return float(np.mean(np.abs(chdtr(freedom, total) - 0.5) <= 0.475))
