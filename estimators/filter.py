"""The contract that every filter keeps: ``init``, ``predict``, ``update``."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from estimators.angles import difference
from estimators.belief import Belief
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


class Filter(ABC):
    """A filter is immutable configuration; a `Belief` is what it believes.

    Randomness is an argument (a Generator, or one a row), and filters without randomness ignore it.
    """

    name: ClassVar[str]
    input_delay: ClassVar[int | None] = None
    """Steps by which the unknown input is known late (0 or 1); None: the filter estimates none."""
    random: ClassVar[bool] = False
    """Whether the filter draws random numbers, so that ``rng`` must be given."""

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
        cov = np.array(np.broadcast_to(prior.cov, batch + (n, n)))
        return self._init(Belief(mean, cov, mean, cov, np.ones(batch, bool)), rng)

    def predict(self, belief: Belief, u: np.ndarray | None = None, rng: Streams = None) -> Belief:
        """One step ahead: ``x(k-1|k-1)`` to ``x(k|k-1)``.

        Numerical trouble stays silent here: the next update finds the rows that are lost.

        Args:
            belief: The belief after the last update.
            u: Known input ``(..., m)`` over the step.
            rng: A Generator, or one for each row.
        """
        with np.errstate(all="ignore"):
            return self._predict(belief, _known(u, belief), rng)

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
            updated = self._update(belief, self._reading(belief, y, available, R), rng)
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

    def _reading(self, belief: Belief, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None) -> Reading:
        """Innovation and measurement matrices, with missing channels neutralised."""
        model, u = self.model, belief.u
        expected, C = model.linearise_measurement(belief.mean, u)
        H = None if model.H is None else resolve(model.H, u)
        R = resolve(model.R, u) if R is None else R
        finite = np.isfinite(y)
        mask = finite if available is None else finite & available
        complete = bool(mask.all())
        if not complete:
            weight = mask.astype(float)
            y = np.where(mask, y, expected)
            C = C * weight[..., None]
            H = None if H is None else H * weight[..., None]
            R = R * (weight[..., None] * weight[..., None, :]) + _diagonal(1.0 - weight)
        innovation = difference(y, expected, model.measurement_angles)
        return Reading(innovation, C, H, R, mask, complete)

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
        begun = self._init(Belief(*prior, *prior, ~lost, u=_finite(updated.u)), rng)
        fresh = self._update(begun, self._reading(begun, y, available, R), rng)
        if not _finite_rows(fresh).all():  # not even the prior can take in this reading
            nothing = np.zeros(y.shape, bool)
            prior_alone = self._update(begun, self._reading(begun, y, nothing, R), rng)
            unusable = ~_finite_rows(fresh)
            fresh = fresh.with_rows(unusable, prior_alone[unusable])
        return updated.with_rows(lost, fresh[lost]).replace(healthy=~lost)


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
