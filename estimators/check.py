"""Checks of a filter of one's own, on systems whose answer is known.

::

    from estimators import check_filter

    check_filter(MyFilter, gain=0.5)  # silent, or one sentence: what is wrong, and what to do

Environments run its quick part, `check_steps`, on every filter of a user's own before its first
step.
"""

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from estimators.belief import Belief
from estimators.checks import frozen, known_input, short_repr
from estimators.filter import Filter, Model
from estimators.linalg import diagonal, semidefinite
from estimators.models import Gaussian, LinearModel, NonlinearModel
from estimators.randomness import RandomKeys
from estimators.series import Series, run

_SAME = 1e-7
"""Largest difference between two ways to compute a number, relative to the largest entry.

The systems here are well conditioned, and Jacobians by differences are accurate to this."""


System = tuple[Model, Gaussian, np.ndarray | None]
"""A model, a prior of ``(n,)`` and a known input ``(m,)`` on which filters are tried."""


def check_filter(
    build: Callable[..., Filter],
    model: Model | None = None,
    prior: Gaussian | None = None,
    u: np.ndarray | None = None,
    **options: Any,
) -> None:
    """Try a filter on known systems, and say what is wrong with it.

    The filter is tried on each known system that it accepts: linear with a known input, with an
    unknown input in the measurements or in the state only, nonlinear with and without unknown
    input. The checks on each system, in this order:

    - ``build`` returns a filter;
    - one row and several rows agree, with whole, partial and missing measurements, and compiled
      formulas agree with NumPy (`check_steps`);
    - a repeated run gives the same numbers;
    - an update without measurements does not reduce the covariance;
    - rows of a batch can begin again.

    Whether errors are as large as the covariance says is tested by `estimators.consistency`.

    Args:
        build: A subclass of `Filter`, or a function of a model (and options) that returns one.
        model: A model of your own to try it on, for a filter that takes no other.
        prior: Mean ``(n,)`` and covariance ``(n, n)`` of its start; None: zero, with unit
            covariance.
        u: Known input ``(m,)`` of the model, if it has one.
        **options: Arguments of ``build`` after the model.

    Raises:
        ValueError: in one sentence, for the first fault found.
        TypeError: if ``build`` is not a class or function, or does not return a filter.
    """
    if not callable(build):
        raise TypeError(
            "check_filter takes a Filter class, or a function of a model that returns one, got"
            f" {short_repr(build)}"
        )
    name = getattr(build, "__name__", type(build).__name__)
    systems, tried = _systems(), "it was tried on: give it one with model="
    if model is not None:
        start = prior or Gaussian(np.zeros(model.n), np.eye(model.n))
        systems, tried = ((model, start, known_input(u, ())),), "given"
    refusals, checked = [], False
    for model, prior, u in systems:
        try:
            filter = build(model, **options)
        except Exception as error:  # whatever a constructor does with a model that it is not for
            refusals.append(f"{type(error).__name__}: {error}")
            continue
        if not isinstance(filter, Filter):
            raise TypeError(f"{name} must return a Filter, got {short_repr(filter)}")
        _check_more(filter, prior, u, check_steps(filter, prior, u))
        checked = True
    if not checked:
        raise ValueError(
            f"{name} takes none of the models {tried} ({'; '.join(dict.fromkeys(refusals))})"
        )


def check_steps(filter: Filter, prior: Gaussian, u: np.ndarray | None) -> Series:
    """Check a filter in a few steps of one row and of several rows, in milliseconds.

    Args:
        filter: The filter to check.
        prior: Mean ``(n,)`` and covariance ``(n, n)`` of a start that its model may have.
        u: Known input ``(m,)``, or None.

    Returns:
        The steps of several rows.

    Raises:
        ValueError: in one sentence, for the first fault found.
    """
    cls = type(filter).__name__
    if "_programs" not in vars(filter):
        raise ValueError(f"{cls}.__init__ must call super().__init__(model) before all else")
    alone = [_steps(filter, prior, u, row) for row in range(_ROWS)]
    series = _steps(filter, prior, u)
    for method, name, ordinary in ("predict", "predicted", _STEPS), ("update", "updated", _WHOLE):
        beliefs = getattr(series, name)
        _check_belief(f"{cls}._{method}", beliefs, beliefs[:ordinary].healthy)
        for row, one in enumerate(alone):
            _compare(
                f"{cls}.{method} gives a row of a batch another {{}} than the same row alone: rows"
                " must share nothing, so reduce over the last axes only",
                beliefs[:, row],
                getattr(one, name),
            )
    if filter.compiled:
        plain = copy.copy(filter)
        plain.compiled = False  # type: ignore[misc]
        _compare(
            f"{cls} gives another {{}} compiled than in NumPy: a formula is traced once, so it must"
            " depend on nothing but what it is handed; or leave out @compiled",
            _steps(plain, prior, u).updated,
            series.updated,
        )
    return series


_ROWS, _STEPS, _WHOLE = 3, 5, 3
"""Rows, measurements, and the first of these that arrive whole; then all but one channel, none."""


def _steps(filter: Filter, prior: Gaussian, u: np.ndarray | None, row: int | None = None) -> Series:
    """Some steps of one row, or of three with None; any error is raised as a sentence."""
    rows = np.arange(_ROWS) if row is None else np.array(row)
    mean = prior.mean + (rows[..., None] - 1.0) * 0.5 * np.sqrt(diagonal(prior.cov))
    known = None if u is None else np.broadcast_to(u, (*mean.shape[:-1], len(u)))
    expected = _expected(filter.model, mean, known)
    R = filter._noise(Belief.of({"mean": mean, "cov": prior.cov}), known, None)
    sd = np.sqrt(diagonal(R))
    away = np.where(sd > 0.0, np.minimum(0.1, 0.5 * sd), 0.1)  # as particles can explain it
    y = expected + away * np.arange(1.0, _STEPS + 1.0).reshape(-1, *(1,) * expected.ndim)
    y[_WHOLE, ..., 0], y[_WHOLE + 1 :] = np.nan, np.nan
    try:
        keys = RandomKeys.seeded(range(_ROWS))[rows]
        held = None if known is None else [known] * _STEPS
        return run(filter, Gaussian(mean, prior.cov), frozen(y), held, rng=keys)
    except Exception as error:
        many = f"{_ROWS} rows" if row is None else "one row"
        why = (
            f"{type(filter).__name__} raised {type(error).__name__} in steps of {many}"
            f" ({' '.join(str(error).split())})"
        )
        if "read-only" in str(error):
            why += ": what a filter is given it may only read, so put a new array into the belief"
        elif row is None:
            why += (
                ": of one row it works, so write it for any leading axes, with np.matvec and .mT,"
                " axes from behind"
            )
        raise ValueError(why) from error


def _expected(model: Model, mean: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    """Measurement ``(..., p)`` that a model expects, tried with one leading axis more, too.

    Raises:
        ValueError: if it fails, or has another shape.
    """
    known = None if u is None else np.stack([u, u])
    for x, given in (np.stack([mean, mean]), known), (mean, u):
        wanted = (*x.shape[:-1], model.p)
        try:
            expected = np.asarray(model.measurement(x, given))
            fault = "" if expected.shape == wanted else f"gave shape {expected.shape}"
        except Exception as error:
            fault = f"raised {type(error).__name__} ({' '.join(str(error).split())})"
        if fault:
            raise ValueError(
                f"the model's measurement of states of shape {x.shape} {fault}, expected {wanted}:"
                " take any leading axes, indexing from behind, as by x[..., :1]"
            )
    return expected


def _check_more(filter: Filter, prior: Gaussian, u: np.ndarray | None, series: Series) -> None:
    """The slower checks of a filter that has passed `check_steps`."""
    cls = type(filter).__name__
    _compare(
        f"{cls} gives another {{}} when the same is done again: what changes belongs in the belief,"
        " and random numbers come from rng alone",
        _steps(filter, prior, u).updated,
        series.updated,
        0.0,
    )
    spread, left = (
        np.trace(b.cov[-1], axis1=-2, axis2=-1) for b in (series.predicted, series.updated)
    )
    if (left < spread * (1.0 - _SAME)).any():
        raise ValueError(
            f"{cls}.update without any measurement makes cov smaller: use the C and R that it is"
            " given, where what is missing is neutral, and not the model's"
        )
    rows, rng, old = np.array([False, True, False]), RandomKeys.seeded(range(_ROWS)), series.last
    fresh = filter.init(Gaussian(np.tile(prior.mean, (_ROWS, 1)), prior.cov), rng=rng)
    mixed, went_on, began = (
        filter.predict(belief, old.u, rng=rng.at(9))
        for belief in (old.with_rows(rows, fresh[rows]), old, fresh)
    )
    _compare(
        f"{cls} gives another {{}} where some rows begin again (belief.with_rows): what a row needs"
        " must be in the belief, and a row alone must say what it does",
        mixed,
        went_on.with_rows(rows, began[rows]),
    )


# --- beliefs --------------------------------------------------------------------------------------


def _check_belief(method: str, beliefs: Belief, healthy: np.ndarray) -> None:
    """Refuse beliefs that lack a row, are not healthy, or have an invalid covariance."""
    for name, array in beliefs.arrays().items():
        if array is not None and array.shape[1:2] != (_ROWS,):
            raise ValueError(
                f"{method} gave a {name} that is no array with a row for each of the batch"
            )
    if not healthy.all():
        raise ValueError(
            f"{method} could not be used: of ordinary numbers it must give a finite mean, and a"
            " covariance that is symmetric and positive semidefinite"
        )
    for name in ("cov", "input_cov"):
        cov = getattr(beliefs, name)
        if cov is not None and not np.abs(cov - semidefinite(cov)).max() <= _SAME * cov.max():
            raise ValueError(
                f"{method} gave a {name} that is not symmetric and positive semidefinite"
            )


def _compare(sentence: str, mine: Belief, theirs: Belief, tolerance: float = _SAME) -> None:
    """Raise an error with ``sentence`` for the first array that differs, relative to its size."""
    for name, a in mine.arrays().items():
        if a is not None:
            b = getattr(theirs, name)
            least = 0.0 if name in ("cov", "innovation_cov", "input_cov") else 1.0
            scale = np.abs(b).max(initial=least)
            if not (np.abs(1.0 * a - b) <= tolerance * scale).all():
                raise ValueError(sentence.format(name))


# --- known systems --------------------------------------------------------------------------------


def _systems() -> tuple[System, ...]:
    """A vehicle on a line, and a driven pendulum; with unknown inputs, too."""
    u, dt, I2 = np.array([0.3]), 0.05, np.eye(2)
    A, R = np.array([[1.0, 0.5], [0.0, 0.9]]), np.diag([0.25, 0.15]) + 0.05
    B, G, H = np.array([[[0.0, 0.5]], [[0.1, 0.5]], [[0.0, 1.0]]]).mT
    vehicle = LinearModel(A, I2, np.diag([0.01, 0.05]), R, B)
    start = Gaussian(A[0], np.diag([1.0, 0.5]))

    def swing(x: np.ndarray, u: Any) -> np.ndarray:
        rate = x[..., 1] + dt * (u[..., 0] - 9.81 * np.sin(x[..., 0]))
        return np.stack([x[..., 0] + dt * rate, rate], -1)

    pendulum = NonlinearModel(
        swing, lambda x, u: x, np.diag([1e-4, 1e-3]), np.diag([1e-3, 1e-2]),
        state_angles=(0,), measurement_angles=(0,),
    )  # fmt: skip
    hanging = Gaussian(np.array([0.3, 0.0]), 0.01 * I2)
    return (
        (replace(vehicle, C=I2[:1], R=I2[:1, :1]), start, u),  # fewer measurements than states
        (replace(vehicle, G=G, H=H), start, u),
        (replace(vehicle, G=G), start, u),
        (pendulum, hanging, u),
        (replace(pendulum, G=dt * H), hanging, u),
    )
