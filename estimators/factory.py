"""Filters by name."""

import inspect
from collections.abc import Iterable
from difflib import get_close_matches
from importlib import import_module
from typing import Any

from estimators.belief import Belief
from estimators.checks import short_repr
from estimators.filter import Filter, Model

_FILTERS = {
    "kf": "KalmanFilter",
    "ekf": "ExtendedKalmanFilter",
    "steady-kf": "SteadyKalmanFilter",
    "kf-umv-ui": "UMVFilter",
    "kf-umv-ui-wdf": "DelayedUMVFilter",
    "ekf-ui-wdf": "ExtendedUMVFilter",
    "ulise": "ULISE",
    "ukf": "UnscentedKalmanFilter",
    "ukf-umv": "UnscentedUMVFilter",
    "enkf": "EnsembleKalmanFilter",
    "etkf": "EnsembleTransformFilter",
    "pf": "ParticleFilter",
    "huber-kf": "HuberKalmanFilter",
    "robust-kf": "RobustKalmanFilter",
    "enkf-sr": "EnsembleTransformFilter",
}
"""Classes of filters by name; `make` imports only the one that it builds."""
_AS_PRINTED = {"kf-umv-ui": "PrintedUMVFilter", "enkf-sr": "PrintedSquareRootFilter"}
"""Classes of filters with the misprints of their papers, by name."""


def names() -> tuple[str, ...]:
    """Names of the filters that `make` builds."""
    return tuple(_FILTERS)


def make(name: str, model: Model, **options: Any) -> Filter[Belief]:
    """Build a filter by name for a model.

    Args:
        name: One of `names`.
        model: A `LinearModel` or `NonlinearModel`.
        **options: The filter's own options, documented with its class. ``as_printed=True`` builds
            ``kf-umv-ui`` and ``enkf-sr`` as the papers print them, see `estimators.as_printed`.

    Raises:
        ValueError: for an unknown name, or a model that the filter cannot work with; the message
            names the condition that fails, and a remedy.
        TypeError: for an option that the filter does not have.
    """
    if not isinstance(name, str) or name not in _FILTERS:
        raise ValueError(unknown("filter", name, _FILTERS))
    ended = name == "kf-umv-ui" and getattr(model, "delayed_feedthrough", False)
    kind = "EndedUMVFilter" if ended else _FILTERS[name]
    if name in _AS_PRINTED and options.pop("as_printed", False):
        kind = _AS_PRINTED[name]
    cls = getattr(import_module("estimators"), kind)
    check_options(name, cls, options)
    made: Filter = cls(model, **options)
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
    folded = {each.casefold(): each for each in known}
    near = get_close_matches(name.casefold(), folded, n=1) if isinstance(name, str) else []
    hint = f" (did you mean {folded[near[0]]!r}?)" if near else ""
    choices = f": choose from {', '.join(known)}" if known else ""
    return f"{head} {kind} {short_repr(name)}{hint}{choices}"
