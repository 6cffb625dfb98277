"""Checks of a filter of one's own, on systems whose answer is known.

::

    from estimators import check_filter

    check_filter(MyFilter, gain=0.5)  # silent, or one sentence that says what is wrong and what to do

Environments ask the quick part of it, `check_steps`, of every filter of a user's own before it
flies.
"""

import copy
import inspect
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from estimators.belief import Belief
from estimators.checks import frozen, short_repr
from estimators.consistency import simulate
from estimators.filter import Filter, Model
from estimators.metrics import chi_square_band, nees
from estimators.models import Gaussian, LinearModel, NonlinearModel
from estimators.randomness import RandomKeys
from estimators.series import run

_RUNS, _STEPS, _CONFIDENCE = 400, 20, 0.9999
_SAME = 1e-7
"""How far two ways to compute the same may be apart, relative to the largest entry: systems here are well conditioned,
and Jacobians by differences no worse than this."""


class System(NamedTuple):
    """A system on which filters are tried: a model, a prior of ``(n,)`` and a known input ``(m,)``."""

    model: Model
    prior: Gaussian
    u: np.ndarray | None


def check_filter(
    build: Callable[..., Filter],
    model: Model | None = None,
    prior: Gaussian | None = None,
    u: np.ndarray | None = None,
    **options: Any,
) -> None:
    """Try a filter on known systems, and say what is wrong with it.

    Each of the systems that the filter takes is tried: linear with a known input, with an unknown
    input in the measurements or in the state only, nonlinear with and without unknown input. On
    each, in this order: what building it gives; steps of one row and of several, whole, in part and
    without a measurement, and formulas compiled and in NumPy (`check_steps`); the same twice; what
    is handed in; gaps; rows that begin again.

    Errors of the first system are then compared with the covariance (NEES, in 400 simulated runs).
    A filter that is not as good as it says gets a warning and is not failed: robust and ensemble
    filters, and those made for nonlinear models, know their errors nearly, and a fixed gain has no
    use for a covariance.

    Args:
        build: A subclass of `Filter`, or a function of a model (and options) that returns one.
        model: A model of your own to try it on, for a filter that takes no other.
        prior: Mean ``(n,)`` and covariance ``(n, n)`` of its start; None: zero, with unit
            covariance.
        u: Its known input ``(m,)``, if it has one.
        **options: What ``build`` takes after the model.

    Raises:
        ValueError: one sentence, of the first that is wrong.
        TypeError: if ``build`` cannot be called with a model, or gives no filter; or the prior is
            none.
    """
    if isinstance(build, Filter) or not callable(build):
        raise TypeError(
            "check_filter takes a Filter class, or a function of a model that returns one, got"
            f" {build!r}"
        )
    name, signature = getattr(build, "__name__", type(build).__name__), inspect.signature(build)
    try:
        signature.bind(model, **options)
    except TypeError as error:
        call = f"{name}({', '.join(['model', *options])})"
        raise TypeError(
            f"{name} cannot be built as {call}: {error}: take the model first, then options"
        ) from None
    if model is None:
        systems = _systems()
    else:
        own = Gaussian(np.zeros(model.n), np.eye(model.n)) if prior is None else prior
        systems = (System(model, own, None if u is None else np.asarray(u, float)),)
    refusals, checked = [], False
    for system in systems:
        try:
            filter = build(system.model, **options)
        except Exception as error:  # whatever a constructor does with a model that it is not for
            refusals.append(f"{type(error).__name__}: {error}")
            continue
        if not isinstance(filter, Filter):
            raise TypeError(f"{name} must return a Filter, got {short_repr(filter)}")
        check_steps(filter, *system[1:])
        _check_more(filter, system)
        if not checked:
            _warn_of_errors(filter, system)
        checked = True
    if not checked:
        whose = "it was tried on: give it one with model=" if model is None else "given"
        raise ValueError(
            f"{name} takes none of the models {whose} ({'; '.join(dict.fromkeys(refusals))})"
        )


def check_steps(filter: Filter, prior: Gaussian, u: np.ndarray | None) -> None:
    """The quick part: a few steps of one row and of several, in milliseconds.

    Args:
        filter: What was built.
        prior: Mean ``(n,)`` and covariance ``(n, n)`` of a start that its model may have.
        u: Known input ``(m,)``, or None.

    Raises:
        ValueError: one sentence, of the first that is wrong.
    """
    cls = type(filter).__name__
    if "_programs" not in vars(filter):
        raise ValueError(f"{cls}.__init__ must call super().__init__(model) before all else")
    if not (isinstance(filter.name, str) and filter.name):
        raise ValueError(
            f'{cls}.name must be what the filter is called, such as "my-filter", got'
            f" {short_repr(filter.name)}"
        )
    alone = [_steps(filter, prior, u, row) for row in range(_ROWS)]
    beliefs = _steps(filter, prior, u)
    for k, belief in enumerate(beliefs):
        method, whole = ("predict", "update")[k % 2], k in _WHOLE
        for name, array in _arrays(belief).items():
            if np.shape(array)[:1] != (_ROWS,):
                raise ValueError(
                    f"{cls}._{method} gave a {name} that is no array with a row for each of the"
                    " batch"
                )
            if not np.isfinite(array).all():
                raise ValueError(
                    f"{cls}._{method} gave a {name} that is not finite, of ordinary numbers"
                )
        if (method == "predict" or whole) and not belief.healthy.all():
            raise ValueError(
                f"{cls}._{method} could not be used: of ordinary numbers it must give a finite"
                " mean, and a covariance that is symmetric and positive semidefinite"
            )
        for name, cov in (("cov", belief.cov), ("input_cov", belief.input_cov)):
            if cov is not None and not _is_covariance(cov):
                raise ValueError(
                    f"{cls}._{method} gave a {name} that is not symmetric and positive semidefinite"
                )
        for row in range(_ROWS):
            if odd := _differ([belief[row]], [alone[row][k]]):
                raise ValueError(
                    f"{cls}.{method} gives a row of a batch another {odd} than the same row alone:"
                    " rows must share nothing, so reduce over the last axes only"
                )
    if filter.compiled:
        _check_compiled(filter, prior, u, beliefs)


def _check_compiled(
    filter: Filter, prior: Gaussian, u: np.ndarray | None, beliefs: list[Belief]
) -> None:
    """Formulas give compiled what NumPy gives, as a prediction and an update and as both at once."""
    plain = copy.copy(filter)
    plain.compiled = False  # type: ignore[misc]
    both = _steps(filter, prior, u, at_once=True)
    if odd := _differ(_steps(plain, prior, u), beliefs) or _differ(both, beliefs[1::2]):
        raise ValueError(
            f"{type(filter).__name__} gives another {odd} compiled than in NumPy: a formula is"
            " traced once, so it must depend on nothing but what it is handed; or leave out"
            " @compiled"
        )


_ROWS = 3
_MASKS = (True, True, False, None)
"""Measurements that arrive after each prediction: all, all, all but the first, none."""
_WHOLE = (1, 3)


def _steps(
    filter: Filter, prior: Gaussian, u: np.ndarray | None, row: int | None = None, masked: bool = False,
    at_once: bool = False,
) -> list[Belief]:  # fmt: skip
    """Beliefs after every prediction and every update, of one row, or of three with None.

    Missing measurements are NaN or, ``masked``, any number that a mask excludes. ``at_once`` each
    prediction and its update are one call, as in environments: the belief after every update.
    """
    model, cls = filter.model, type(filter).__name__
    rows = np.arange(_ROWS) if row is None else np.array(row)
    away = 0.5 * np.sqrt(np.diagonal(prior.cov, axis1=-2, axis2=-1))
    mean = prior.mean + (rows[..., None] - 1.0) * away
    known = _for_rows(u, mean.shape[:-1])
    expected, batch = (
        model.measurement(mean, known),
        "one row" if row is not None else f"{_ROWS} rows",
    )
    rng, beliefs = RandomKeys.seeded(range(_ROWS))[rows], []
    with _named(f"{cls}.init of {batch}", row is None):
        belief = filter.init(Gaussian(mean, prior.cov), rng=rng)
    for k, mask in enumerate(_MASKS):
        arrived = np.full(expected.shape, bool(mask))
        if mask is False:
            arrived[..., 1:] = True
        now, y = rng.at(k + 1), expected + 0.1 * (k + 1.0)
        missing = np.where(arrived, y, np.nan)
        if at_once:
            belief = filter.step(belief, missing, known, rng=now)
            beliefs.append(belief)
            continue
        with _named(f"{cls}.predict of {batch}", row is None):
            belief = filter.predict(belief, known, rng=now)
        beliefs.append(belief)
        arrays = {"y": y, "available": arrived} if masked else {"y": missing}
        with _named(f"{cls}.update of {batch}", row is None):
            belief = filter.update(
                belief, rng=now, **{name: frozen(array) for name, array in arrays.items()}
            )
        beliefs.append(belief)
    return beliefs


def _for_rows(u: np.ndarray | None, batch: tuple[int, ...]) -> np.ndarray | None:
    """A known input ``(m,)`` for each row, read-only."""
    return None if u is None else frozen(np.broadcast_to(u, batch + u.shape))


@contextmanager
def _named(call: str, batch: bool) -> Iterator[None]:
    """Raise any error as a sentence that names the call."""
    try:
        yield
    except Exception as error:
        why = f"{call} raised {type(error).__name__} ({' '.join(str(error).split())})"
        if "read-only" in str(error):
            why += ": what a filter is given it may only read, so put a new array into the belief"
        elif batch:
            why += (
                ": of one row it works, so write it for any leading axes, with np.matvec and .mT,"
                " axes from behind"
            )
        raise ValueError(why) from error


def _check_more(filter: Filter, system: System) -> None:
    """The slower checks of a filter that has passed `check_steps`."""
    cls, (_, prior, u) = type(filter).__name__, system
    beliefs = _steps(filter, prior, u)

    if odd := _differ(_steps(filter, prior, u), beliefs, 0.0):
        raise ValueError(
            f"{cls} gives another {odd} when the same is done again: what changes belongs in the"
            " belief, and random numbers come from rng alone"
        )
    if odd := _differ(_steps(filter, prior, u, masked=True), beliefs, 0.0):
        raise ValueError(
            f"{cls} gives another {odd} for a measurement that is masked than for NaN: both are"
            " missing"
        )
    before, after = beliefs[-2], beliefs[-1]
    spread, left = (np.trace(belief.cov, axis1=-2, axis2=-1) for belief in (before, after))
    if (left < spread * (1.0 - _SAME)).any():
        raise ValueError(
            f"{cls}.update without any measurement makes cov smaller: use the C and R that it is"
            " given, where what is missing is neutral, and not the model's"
        )
    _check_restart(filter, system, beliefs)
    if filter.random:
        with _named(f"{cls} with a NumPy Generator as rng", False):
            rng = np.random.default_rng(0)
            filter.predict(filter.init(prior, rng=rng), u, rng=rng)


def _check_restart(filter: Filter, system: System, beliefs: list[Belief]) -> None:
    """Refuse a filter for which a row that begins again, beside others that go on, is not as a new one."""
    cls, (model, prior, u) = type(filter).__name__, system
    again, rng = np.array([False, True, False]), RandomKeys.seeded(range(_ROWS))
    known, start = (
        _for_rows(u, (_ROWS,)),
        Gaussian(np.broadcast_to(prior.mean, (_ROWS, model.n)), prior.cov),
    )
    with _named(f"{cls}: a belief with rows that begin again (belief.with_rows)", False):
        fresh = filter.init(start, rng=rng)
        mixed = beliefs[3].with_rows(again, fresh[again])
        stepped = [
            filter.predict(belief, known, rng=rng.at(9)) for belief in (mixed, beliefs[3], fresh)
        ]
    for row in range(_ROWS):
        if odd := _differ([stepped[0][row]], [stepped[2 if again[row] else 1][row]]):
            raise ValueError(
                f"{cls} gives another {odd} where some rows begin again (belief.with_rows): what a"
                " row needs must be in the belief, and a row alone must say what it does"
            )


def _warn_of_errors(filter: Filter, system: System) -> None:
    """Warn where errors in simulated runs are larger or smaller than the covariance."""
    model, prior, u = system
    rng = np.random.default_rng(0)
    unknown = (
        rng.normal(size=(_STEPS, _RUNS, model.q))
        if filter.input_delay is not None and model.q
        else None
    )
    data = simulate(model, prior, rng, _RUNS, _STEPS, u, unknown)
    series = run(filter, prior, data.y, data.u, rng=RandomKeys.seeded(range(_RUNS)))
    found = float(nees(series.mean[-1], series.cov[-1], data.x[-1], model.state_angles).mean())
    low, high = chi_square_band(_RUNS, model.n, _CONFIDENCE)
    if not low <= found <= high:
        than, hint = (
            ("larger", "it claims too much") if found > high else ("smaller", "it is too careful")
        )
        warnings.warn(
            f"{type(filter).__name__}: its errors are {than} than its covariance says ({hint}): the"
            f" mean NEES of {model.n} states over {_RUNS} runs is {found:.2f}, expected {low:.2f}"
            f" to {high:.2f}; see estimators.consistency",
            stacklevel=3,
        )


# --- comparing beliefs ----------------------------------------------------------------------------


def _arrays(belief: Belief) -> dict[str, np.ndarray]:
    """The arrays of a belief by name, without those that it does not have."""
    found = {name: getattr(belief, name) for name in belief.__dataclass_fields__}
    return {name: array for name, array in found.items() if array is not None}


def _differ(some: list[Belief], others: list[Belief], tolerance: float = _SAME) -> str:
    """The first array in which beliefs are not the same, or nothing; variances may be small beside 1."""
    for mine, theirs in zip(map(_arrays, some), map(_arrays, others), strict=True):
        for name in mine.keys() & theirs.keys():
            a, b = np.asarray(mine[name], float), np.asarray(theirs[name], float)
            scale = float(
                np.abs(b).max(
                    initial=0.0 if name in ("cov", "innovation_cov", "input_cov") else 1.0
                )
            )
            if a.shape != b.shape or not (np.abs(a - b) <= tolerance * scale).all():
                return name
    return ""


def _is_covariance(cov: np.ndarray) -> bool:
    size = np.abs(cov).max((-2, -1), initial=0.0)
    even = np.abs(cov - cov.mT).max((-2, -1), initial=0.0) <= _SAME * size
    return bool(
        (
            even & (np.linalg.eigvalsh(0.5 * (cov + cov.mT)).min(-1, initial=0.0) >= -_SAME * size)
        ).all()
    )


# --- known systems --------------------------------------------------------------------------------


def _systems() -> tuple[System, ...]:
    """Linear ones of a vehicle whose speed sensor drifts, and a driven pendulum; of each with unknown inputs, too."""
    A, Q = (
        np.array([[1.0, 0.5, 0.0], [0.0, 0.9, 0.0], [0.0, 0.0, 0.95]]),
        np.diag([0.01, 0.05, 0.02]),
    )
    B, G, H = (
        np.array([[0.0], [0.5], [0.0]]),
        np.array([[0.1], [0.5], [0.0]]),
        np.array([[0.0], [0.0], [1.0]]),
    )
    C, R = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]]), np.array([[0.3, 0.05], [0.05, 0.2]])
    more, both = np.vstack([C, [0.0, 1.0, 0.0]]), np.diag([0.3, 0.2, 0.1])
    prior, push, dt = (
        Gaussian(np.array([1.0, 0.5, 0.0]), np.diag([1.0, 0.5, 0.1])),
        np.array([0.3]),
        0.05,
    )

    def swing(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        rate = x[..., 1] + dt * (u[..., 0] - 9.81 * np.sin(x[..., 0]))
        return np.stack([x[..., 0] + dt * rate, rate], -1)

    pendulum: dict[str, Any] = {
        "transition": swing, "measurement": lambda x, u: x, "Q": np.diag([1e-4, 1e-3]), "R": np.diag([1e-3, 1e-2]),
        "state_angles": (0,), "measurement_angles": (0,),
    }  # fmt: skip
    hanging = Gaussian(np.array([0.3, 0.0]), np.diag([0.01, 0.01]))
    return (
        System(LinearModel(A, C, Q, R, B), prior, push),
        System(LinearModel(A, more, Q, both, B, G, H), prior, push),
        System(LinearModel(A, more, Q, both, B, G), prior, push),
        System(NonlinearModel(**pendulum), hanging, push),
        System(NonlinearModel(**pendulum, G=np.array([[0.0], [dt]])), hanging, push),
    )
