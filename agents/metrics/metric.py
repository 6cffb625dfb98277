"""Metrics of an episode: their description, root mean squares and consistency."""

import csv
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from agents.rollouts import Rollout
from agents.wrapped import Wrapped
from estimators import chi_square_band, nees
from estimators.angles import difference
from vessel_gym.estimation import WITHOUT_COVARIANCE

_band = cache(chi_square_band)

PerEpisode = Callable[[Rollout], np.ndarray]
"""One number of every episode of a rollout, ``(N,)``; NaN where there is none."""


@dataclass(frozen=True)
class Metric:
    """A metric of an episode.

    Attributes:
        key: Its name in `scores` and in files.
        label: Its name in tables.
        unit: Empty where it has none.
        better: ``"higher"``, ``"lower"``, ``"near 1"``, or ``""`` where it is not a matter of
            better.
        decimals: Digits to print.
        meaning: One sentence.
        yes_or_no: True if each episode has 0 or 100 % of it.
        of: Computes it: a function of a `Rollout` that returns one value an episode, ``(N,)``, NaN
            where there is none. None: the function registered with its task does, along with
            others.
        cost: True for what the vehicle's owner pays, which stands beside the score.
    """

    key: str
    label: str
    unit: str
    better: str
    decimals: int
    meaning: str
    yes_or_no: bool = False
    of: PerEpisode | None = field(default=None, compare=False, repr=False)
    cost: bool = False


@cache
def _catalogue() -> list[dict[str, str]]:
    """Rows of ``metrics.csv``."""
    with files("agents.metrics").joinpath("metrics.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def described(task: str, **of: PerEpisode) -> tuple[Metric, ...]:
    """Metrics of a kind of task in the order of ``metrics.csv``, with their functions by key."""
    return tuple(
        Metric(
            **{name: row[name] for name in ("key", "label", "unit", "better", "meaning")},
            decimals=int(row["decimals"]),
            yes_or_no=row["kind"] == "yes or no",
            of=of.get(row["key"]),
            cost=row["kind"] == "cost",
        )
        for row in _catalogue()
        if task in row["tasks"].split(", ")
    )


def rmse(*names: str, scale: float = 1.0) -> PerEpisode:
    """RMS error of those components of the estimated state that have these names, together.

    NaN where the estimator has none of them.

    Args:
        names: As the vehicle names its state.
        scale: Metric's units in one of SI.
    """

    def of(rollout: Rollout) -> np.ndarray:
        chosen = components(rollout, *names)
        if not chosen:
            return np.full(len(rollout.seeds), np.nan)
        core, h = core_of(rollout), rollout.history
        angles = core.filter.model.state_angles
        error = difference(h["estimate"], core.estimated(h["truth"]), angles)[..., chosen]
        return rms(np.sqrt((error**2).sum(-1)), rollout.alive) * scale

    return of


def nees_in(*names: str) -> PerEpisode:
    """Mean NEES of the components with these names."""
    return lambda rollout: mean_nees(rollout, components(rollout, *names))


def ended(end: str) -> PerEpisode:
    """Share of episodes that ended in these words [%]: 0 or 100 for each."""
    return lambda rollout: 100.0 * (rollout.end == end)


def steps(rollout: Rollout) -> np.ndarray:
    """Steps flown."""
    return rollout.length.astype(float)


def input_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray] | None:
    """Errors of the estimated unknown input ``(T', N, q)``, and when an episode lived ``(T', N)``.

    The estimate of a step is of the input of some steps before: there are as many times fewer. None
    where none is estimated.
    """
    core, h, alive = core_of(rollout), rollout.history, rollout.alive
    if core.belief.input_mean is None:
        return None
    delay = core.config.estimation.input_delay
    true = h["unknown_input"][: len(alive) - delay]
    return h["input_estimate"][delay:] - true, alive[delay:]


def _input_rmse(rollout: Rollout) -> np.ndarray:
    composition, found = core_of(rollout).composition, input_errors(rollout)
    if found is None or not composition.inputs:
        return np.full(len(rollout.seeds), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = found[0] / np.sqrt(np.diag(composition.forces.input_cov))
    return rms(np.sqrt((error**2).mean(-1)), found[1])


def mean_nees(rollout: Rollout, components: tuple[int, ...] | None = None) -> np.ndarray:
    """Mean NEES per component of each episode ``(N,)``; NaN without a covariance."""
    values, alive = nees_of(rollout, components), rollout.alive
    if values is None:
        return np.full(len(rollout.seeds), np.nan)
    return np.where(alive, values, 0.0).sum(0) / alive.sum(0) / len(_known(rollout, components))


def _unhealthy(rollout: Rollout) -> np.ndarray:
    return (rollout.alive & ~rollout.history["healthy"]).sum(0).astype(float)


SCORE, RETURN, STEPS, INPUT, NEES, UNHEALTHY = described(
    "every",
    score=lambda rollout: rollout.score.astype(float),
    steps=steps,
    input_rmse=_input_rmse,
    nees=mean_nees,
    unhealthy=_unhealthy,
    **{"return": lambda rollout: rollout.returns.astype(float)},
)


def components(rollout: Rollout, *names: str) -> tuple[int, ...]:
    """Indices of the components of the estimated state with these names."""
    return tuple(i for i, name in enumerate(core_of(rollout).composition.names) if name in names)


def at_end(rollout: Rollout) -> np.ndarray:
    """The true states ``(N, n)`` in which episodes ended."""
    return rollout.history["truth"][rollout.length, np.arange(len(rollout.length))]


def core_of(rollout: Rollout) -> Any:
    """The core of the environment that was flown, or the `Wrapped` that stands for it."""
    return core_in(rollout.env, rollout.env_id)


def core_in(env: Any, env_id: str) -> Any:
    """The core of a batch, or the `Wrapped` that stands for it."""
    env = env.unwrapped
    return env.core if hasattr(env, "core") else Wrapped(env_id, env.envs[0])


def rms(error: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square over time of errors ``(T, N)`` where the mask holds, if it ever does."""
    count = mask.sum(0)
    mean = np.where(mask, error, 0.0) ** 2
    return np.sqrt(np.where(count > 0, mean.sum(0) / np.maximum(count, 1), np.nan))


def nees_of(rollout: Rollout, components: tuple[int, ...] | None = None) -> np.ndarray | None:
    """NEES ``(T + 1, N)``, or None for an estimator without a covariance of its own.

    Args:
        rollout: with its history.
        components: of the filter's state; None: those that the truth has, too.
    """
    core, h = core_of(rollout), rollout.history
    if core.estimator in ("", *WITHOUT_COVARIANCE):
        return None
    chosen = list(_known(rollout, components))
    state = core.estimated(h["truth"])
    angles = tuple(chosen.index(i) for i in core.filter.model.state_angles if i in chosen)
    cov = h["covariance"][..., np.array(chosen)[:, None], chosen]
    return nees(h["estimate"][..., chosen], cov, state[..., chosen], angles)


def _known(rollout: Rollout, components: tuple[int, ...] | None) -> tuple[int, ...]:
    """The components given; None: those of the filter's state that the truth has, too."""
    if components is not None:
        return components
    absent = np.isnan(core_of(rollout).estimated(rollout.history["truth"])).all((0, 1))
    return tuple(np.flatnonzero(~absent).tolist())


def consistency(rollout: Rollout, components: tuple[int, ...] | None = None) -> float | None:
    """Share of times at which the mean NEES over the runs lies in its 95 % chi-square band.

    About 0.95 for an estimator that is as good as it says; None for one that says nothing.

    Args:
        rollout: with its history.
        components: of the filter's state; None: those that the truth has, too.
    """
    values, alive = nees_of(rollout, components), rollout.alive
    if values is None:
        return None
    runs, size = alive.sum(1), len(_known(rollout, components))
    flown = runs > 0
    mean = np.where(alive, values, 0.0).sum(1)[flown] / runs[flown]
    return _share_within(mean, [_band(int(count), size) for count in runs[flown]])


def nis_consistency(rollout: Rollout) -> float | None:
    """Share of times at which the NIS of all runs lies in its 95 % chi-square band.

    The degrees of freedom are the delivered measurements. None without innovations, and for delayed
    sensors: not every measurement has an innovation when it is delivered.
    """
    values = rollout.history.get("nis")
    if values is None or core_of(rollout).sensors.horizon:
        return None
    seen = np.isfinite(values)
    degrees = np.where(seen, rollout.history["available"].sum(-1), 0).sum(1)
    compared = degrees > 0
    if not compared.any():
        return None
    total = np.where(seen, values, 0.0).sum(1)[compared]
    return _share_within(total, [_band(1, int(count)) for count in degrees[compared]])


def _share_within(values: np.ndarray, bands: list[tuple[float, float]]) -> float:
    """Share of values ``(n,)`` within the bands."""
    low, high = np.transpose(bands)
    return float(np.mean((values >= low) & (values <= high)))
