"""Filters by name."""

import inspect
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

from estimators.checks import short_repr
from estimators.ensemble import EnsembleKalmanFilter, EnsembleTransformFilter
from estimators.filter import Filter, Model
from estimators.iterated import IteratedExtendedKalmanFilter
from estimators.kalman import ExtendedKalmanFilter, KalmanFilter
from estimators.particles import ParticleFilter
from estimators.robust import HuberKalmanFilter, RobustKalmanFilter
from estimators.ulise import ULISE
from estimators.unknown_input import DelayedUMVFilter, EndedUMVFilter, ExtendedUMVFilter, UMVFilter
from estimators.unscented import UnscentedKalmanFilter, UnscentedUMVFilter

_FILTERS: dict[str, type[Filter]] = {
    cls.name: cls
    for cls in (
        KalmanFilter,
        ExtendedKalmanFilter,
        IteratedExtendedKalmanFilter,
        UMVFilter,
        DelayedUMVFilter,
        ExtendedUMVFilter,
        ULISE,
        UnscentedKalmanFilter,
        UnscentedUMVFilter,
        EnsembleKalmanFilter,
        EnsembleTransformFilter,
        ParticleFilter,
        HuberKalmanFilter,
        RobustKalmanFilter,
    )
}
_FILTERS["enkf-sr"] = EnsembleTransformFilter


def names() -> tuple[str, ...]:
    """Names of the filters that `make` builds."""
    return tuple(_FILTERS)


def make(name: str, model: Model, **options: Any) -> Filter:
    """Build a filter by name for a model.

    Args:
        name: One of `names`.
        model: A `LinearModel` or `NonlinearModel`.
        **options: The filter's own options, documented with its class.

    Raises:
        ValueError: for an unknown name, or a model that the filter cannot work with; the message
            names the condition that fails, and a remedy.
        TypeError: for an option that the filter does not have.
    """
    if not isinstance(name, str) or name not in _FILTERS:
        raise ValueError(unknown("filter", name, _FILTERS))
    cls = _FILTERS[name]
    if cls is UMVFilter and getattr(model, "delayed_feedthrough", False):
        cls = EndedUMVFilter
    check_options(name, cls, options)
    made = cls(model, **options)
    made.name = name
    return made


def check_options(name: str, cls: type, options: dict[str, Any]) -> None:
    """Raise a TypeError naming the first option that ``cls`` does not take."""
    known = list(inspect.signature(cls).parameters)[1:]
    for option in options:
        if option not in known:
            takes = f"it takes {', '.join(known)}" if known else "it takes none"
            raise TypeError(f"{name} has no option {option!r}: {takes}")


def unknown(kind: str, name: object, known: Iterable[str], head: str = "unknown") -> str:
    """The error message for an unknown name, with the nearest and all known names."""
    known = list(known)
    near = get_close_matches(name, known, n=1) if isinstance(name, str) else []
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    choices = f": choose from {', '.join(known)}" if known else ""
    return f"{head} {kind} {short_repr(name)}{hint}{choices}"
