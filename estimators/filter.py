"""The contract that every filter keeps: ``init``, ``predict``, ``update``."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from estimators.angles import difference
from estimators.belief import Belief
from estimators.linalg import congruence
from estimators.models import Gaussian, LinearModel, NonlinearModel, resolve

Streams = np.random.Generator | Sequence[np.random.Generator] | None
Model = LinearModel | NonlinearModel


class Reading(NamedTuple):
    """A measurement prepared for an update: missing channels carry no information.

    A missing channel has innovation 0, a zero row in ``C`` and ``H`` and a unit, uncorrelated
    variance in ``R``, so that the formulas need no special case.
    """

    innovation: np.ndarray  # (..., p)
    C: np.ndarray  # (..., p, n)
    H: np.ndarray | None  # (..., p, q)
    R: np.ndarray  # (..., p, p)
    available: np.ndarray  # (..., p)
    complete: bool
    whole: np.ndarray | None = None  # (..., p, n) C with the rows of missing readings, too
    anomalies: np.ndarray | None = None  # (..., N, p) spread of what the members expect (ensemble filters)
    whole_R: np.ndarray | None = None  # (..., p, p) R with that of missing readings, too (ensemble filters)


class Filter(ABC):
    """A filter is immutable configuration; a `Belief` is what it believes.

    Randomness is an argument (a Generator, or one a row), and filters without randomness ignore it.
    """

    name: ClassVar[str]
    input_delay: ClassVar[int | None] = None
    """Steps by which the unknown input is known late (0 or 1); None: the filter estimates none."""
    random: ClassVar[bool] = False
    """Whether the filter draws random numbers, so that ``rng`` must be given."""
    shares: ClassVar[bool] = False
    """Whether covariances that all rows have in common are computed once; the formulas then only broadcast."""

    def __init__(self, model: Model) -> None:
        if not isinstance(model, LinearModel | NonlinearModel):
            raise TypeError(f"model must be a LinearModel or a NonlinearModel, got {type(model).__name__}")
        self.model = model
        self._identity = np.eye(model.n)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(n={self.model.n}, p={self.model.p}, q={self.model.q})"

    # --- public contract --------------------------------------------------------------------------

    def init(self, prior: Gaussian, rng: Streams = None) -> Belief:
        """The belief before any reading: ``x(0|-1)``.

        Args:
            prior: Mean ``(..., n)`` and covariance ``(..., n, n)``; leading axes are the batch.
            rng: A Generator, or one for each row, for filters that draw members.

        Raises:
            ValueError: if the prior is not for n states.
        """
        n = self.model.n
        if prior.mean.shape[-1] != n:
            raise ValueError(f"the prior is for {prior.mean.shape[-1]} states, the model has {n}")
        batch = np.broadcast_shapes(prior.mean.shape[:-1], prior.cov.shape[:-2])
        mean = np.array(np.broadcast_to(prior.mean, batch + (n,)))
        cov = np.broadcast_to(prior.cov, batch + (n, n))
        cov = cov if self.shares else np.array(cov)
        begun = Belief(mean, cov, mean, cov, np.ones(batch, bool))
        return self._sharing(begun, lambda belief: self._init(belief, rng))

    def predict(self, belief: Belief, u: np.ndarray | None = None, rng: Streams = None) -> Belief:
        """One step ahead: ``x(k-1|k-1)`` to ``x(k|k-1)``.

        Numerical trouble stays silent here: the next update finds the rows that are lost.

        Args:
            belief: The belief after the last update.
            u: Known input ``(..., m)`` over the step.
            rng: A Generator, or one for each row.
        """
        u = _known(u, belief)
        with np.errstate(all="ignore"):
            return self._sharing(belief, lambda belief: self._predict(belief, u, rng))

    def update(
        self,
        belief: Belief,
        y: np.ndarray,
        rng: Streams = None,
        available: np.ndarray | None = None,
        R: np.ndarray | None = None,
        u: np.ndarray | None = None,
    ) -> Belief:
        """Take in a reading: ``x(k|k-1)`` to ``x(k|k)``.

        Never raises for numerical trouble: a row that is lost (not finite) starts again from its
        prior and this reading, and says so in ``healthy``.

        Args:
            belief: The predicted belief.
            y: Readings ``(..., p)``; a value that is not finite counts as missing.
            rng: A Generator, or one for each row.
            available: Mask ``(..., p)`` of the readings that arrived; None: all.
            R: Measurement covariance ``(..., p, p)`` for this reading only; None: the model's.
            u: Known input ``(..., m)`` for a model whose measurement depends on it; None: the one
                of the last prediction.

        Raises:
            ValueError: if ``y``, ``available`` or ``R`` have the wrong shape.
        """
        batch, p = belief.mean.shape[:-1], self.model.p
        y = _broadcast("y", np.asarray(y, dtype=float), batch + (p,))
        if available is not None:
            available = _broadcast("available", np.asarray(available, dtype=bool), batch + (p,))
        if R is not None:
            R = _broadcast("R", np.asarray(R, dtype=float), batch + (p, p), core=2)
        if u is not None:
            belief = belief.replace(u=_known(u, belief))
        with np.errstate(all="ignore"):
            reading = self._reading(belief, y, available, R)
            updated = self._sharing(belief, lambda belief: self._update(belief, reading, rng))
            if math.isfinite(np.add.reduce(updated.mean, None) + np.add.reduce(updated.cov, None)):
                return updated
            return self._recovered(updated, y, rng, available, R)

    # --- what a filter fills in -------------------------------------------------------------------

    def _init(self, belief: Belief, rng: Streams) -> Belief:
        return belief

    @abstractmethod
    def _predict(self, belief: Belief, u: np.ndarray | None, rng: Streams) -> Belief: ...

    @abstractmethod
    def _update(self, belief: Belief, reading: Reading, rng: Streams) -> Belief: ...

    # --- shared -----------------------------------------------------------------------------------

    def _sharing(self, belief: Belief, formulas: Callable[[Belief], Belief]) -> Belief:
        """The formulas on the belief, with covariances that all rows have in common computed once."""
        if not self.shares or len(belief.mean) == 1:
            return formulas(belief)
        return _spread(formulas(_shared(belief)), belief.mean.shape[:-1])

    def _reading(self, belief: Belief, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None) -> Reading:
        """Innovation and measurement matrices, with missing channels neutralised."""
        model, u = self.model, belief.u
        expected, C, excess = self._linearise(belief)
        whole = C
        H = None if model.H is None else resolve(model.H, u)
        R = resolve(model.R, u) if R is None else R
        R = R if excess is None else R + excess
        finite = np.isfinite(y)
        mask = finite if available is None else finite & available
        complete = bool(mask.all())
        if not complete:
            weight = mask.astype(float)
            y = np.where(mask, y, expected)
            C = C * weight[..., None]
            H = None if H is None else H * weight[..., None]
            R = neutralised(R, weight)
        innovation = difference(y, expected, model.measurement_angles)
        return Reading(innovation, C, H, R, mask, complete, whole)

    def _linearise(self, belief: Belief) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """The expected reading ``(..., p)``, C ``(..., p, n)``, and what is to be added to R for what C leaves out."""
        return *self.model.linearise_measurement(belief.mean, belief.u), None

    def _propagate(self, mean: np.ndarray, cov: np.ndarray, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Mean ``(..., n)`` and covariance ``(..., n, n)`` one step on, without process noise."""
        mean, A = self.model.linearise_transition(mean, u)
        return mean, congruence(A, cov)

    def _recovered(
        self,
        updated: Belief,
        y: np.ndarray,
        rng: Streams,
        available: np.ndarray | None,
        R: np.ndarray | None,
    ) -> Belief:
        """The same belief with every lost row begun again from its prior and this reading."""
        lost = ~_finite_rows(updated)
        if not lost.any():  # the sum overflowed, the entries did not
            return updated
        prior = updated.prior_mean, updated.prior_cov
        rng = _streams_of(lost, rng)
        begun = self._init(Belief(*prior, *prior, ~lost, u=_finite(updated.u)), rng)
        fresh = self._update(begun, self._reading(begun, y, available, R), rng)
        unusable = ~_finite_rows(fresh)
        if unusable.any():  # not even the prior can take in this reading
            nothing = np.zeros(y.shape, bool)
            prior_alone = self._update(begun, self._reading(begun, y, nothing, R), _streams_of(unusable, rng))
            fresh = fresh.with_rows(unusable, prior_alone[unusable])
        return updated.with_rows(lost, fresh[lost]).replace(healthy=~lost)


_COVARIANCES = (
    "cov", "innovation_cov", "input_cov", "state_input_cov", "input_observed", "input_matrix",
    "feedthrough_cov", "state_feedthrough_cov", "feedthrough_observed",
)  # fmt: skip


def _shared(belief: Belief) -> Belief:
    """The belief with covariances ``(1, ..., n, n)`` where all rows have the same: a linear filter's usual case.

    That they are the same shows in their strides: `_spread` gave them none along the batch.
    """
    changes = {}
    for name in _COVARIANCES:
        array = getattr(belief, name)
        if array is None:
            continue
        if any(array.strides[:-2]):
            return belief
        changes[name] = array[(slice(0, 1),) * (array.ndim - 2)]
    return belief.replace(**changes)


def _spread(belief: Belief, batch: tuple[int, ...]) -> Belief:
    """The belief with a covariance for every row, as views of the one where they share it."""
    changes = {}
    for name in _COVARIANCES:
        array = getattr(belief, name)
        if array is not None and array.shape[:-2] != batch:
            changes[name] = np.broadcast_to(array, batch + array.shape[-2:])
    return belief.replace(**changes) if changes else belief


def neutralised(R: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """R ``(..., p, p)`` with a unit, uncorrelated variance where ``weight (..., p)`` is 0 instead of 1."""
    return R * (weight[..., None] * weight[..., None, :]) + _diagonal(1.0 - weight)


def _streams_of(rows: np.ndarray, rng: Streams) -> Streams:
    """The streams of a mask's rows; the others get one to waste, so that theirs do not advance."""
    if rng is None or isinstance(rng, np.random.Generator):
        return rng
    wasted = np.random.default_rng(0)
    return [stream if row else wasted for stream, row in zip(rng, rows.ravel(), strict=True)]


def _finite_rows(belief: Belief) -> np.ndarray:
    return np.isfinite(belief.mean).all(-1) & np.isfinite(belief.cov).all((-2, -1))


def _known(u: np.ndarray | None, belief: Belief) -> np.ndarray | None:
    """The known input with a row for each belief, so that rows can be taken out and replaced."""
    if u is None:
        return None
    u, batch = np.asarray(u, dtype=float), belief.mean.shape[:-1]
    return u if u.shape[:-1] == batch else np.broadcast_to(u, batch + u.shape[-1:])


def _finite(u: np.ndarray | None) -> np.ndarray | None:
    return None if u is None else np.nan_to_num(u)


def _broadcast(name: str, value: np.ndarray, shape: tuple[int, ...], core: int = 1) -> np.ndarray:
    """``value`` with the leading axes of ``shape``; its last ``core`` axes must fit exactly."""
    if value.shape == shape:
        return value
    try:
        if value.shape[-core:] == shape[-core:]:
            return np.broadcast_to(value, shape)
    except ValueError:
        pass
    raise ValueError(f"{name} has shape {value.shape}, expected {shape}")


def _diagonal(values: np.ndarray) -> np.ndarray:
    return values[..., None] * np.eye(values.shape[-1])
