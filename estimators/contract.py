"""The contract that every filter keeps: `init`, `predict` and `update`, their arguments and errors."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from inspect import signature
from typing import Any, ClassVar, Generic, cast

import numpy as np

from estimators.belief import Belief, Record, finite_rows
from estimators.checks import as_array, as_mask, frozen
from estimators.linalg import log_density, masked
from estimators.model_checks import as_covariance, usable
from estimators.models import Gaussian, LinearModel, NonlinearModel
from estimators.randomness import RandomKeys
from estimators.varying import noise_at, resolve

Rng = RandomKeys | np.random.Generator | None
"""Random numbers: keys a row and a step, or a Generator for the whole batch."""
Model = LinearModel | NonlinearModel


class Estimator(ABC, Generic[Record]):
    """A filter is immutable configuration; a `Belief` is its state.

    Randomness is an argument (`Rng`), and filters without randomness ignore it. `start`, `forecast`
    and `correct` are `init`, `predict` and `update` of arguments that need no check; `begin` is the
    first with the last, `advance` the second with it.
    """

    name: str
    """That by which it was made; by default the class' own name."""
    record: type[Belief] = Belief
    """Class of its beliefs."""
    input_delay: int | None = None
    """Steps by which the unknown input is known late (0 or 1); None: the filter estimates none."""
    random: ClassVar[bool] = False
    """It draws random numbers, so that ``rng`` must be given."""
    sequential: bool = True
    """Updates of one step add up to one with all its measurements: on a linear model, with independent noises."""
    mixes: bool = True
    """An update may take linear combinations of the measurements, where these repeat each other."""
    likelihood: ClassVar[str] = "approximate"
    """Kind of `log_likelihood`: "exact", "diffuse" or "approximate"."""
    verified: ClassVar[bool] = False
    """The results of this very class need no check, for tests hold that they are right; a class argument."""
    _settings: ClassVar[frozenset[str]]
    """Arguments of constructors, which are read-only afterwards."""

    def __init__(self, model: Model) -> None:
        if not isinstance(model, LinearModel | NonlinearModel):
            raise TypeError(
                f"model must be a LinearModel or a NonlinearModel, got {type(model).__name__}"
            )
        self.model = model

    def __init_subclass__(cls, verified: bool = False, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        cls.verified = verified
        # Results of verified classes follow from their settings; in NumPy of one's own a setting
        # may be changed.
        cls._settings = frozenset(
            name
            for base in cls.__mro__
            if cls._frozen() or vars(base).get("verified")
            for name in signature(vars(base).get("__init__", object)).parameters
        )

    @classmethod
    def _frozen(cls) -> bool:
        """Are the settings of all its classes read-only?"""
        return False

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__dict__ and name in self._settings:
            raise AttributeError(
                f"{name} of a filter is read-only: build another filter, such as"
                f" make({self.name!r}, model, {name}=...)"
            )
        object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(n={self.model.n}, p={self.model.p}, q={self.model.q})"

    # --- checked ----------------------------------------------------------------------------------

    def init(self, prior: Gaussian, rng: Rng = None) -> Record:
        """The belief before any measurement: ``x(0|-1)``.

        Args:
            prior: Mean ``(..., n)`` and covariance ``(..., n, n)``; leading axes are the batch.
            rng: For filters that draw members: `RandomKeys` of this step, or a Generator.

        Raises:
            TypeError: if the prior is no `Gaussian`.
            ValueError: if the prior is not for n states.
        """
        if not isinstance(prior, Gaussian):
            raise TypeError(f"prior must be a Gaussian(mean, cov), got {type(prior).__name__}")
        for size in (prior.mean.shape[-1], prior.cov.shape[-1]):
            if size != self.model.n:
                raise ValueError(f"the prior is for {size} states, the model has {self.model.n}")
        initial = self.start(prior, rng)
        if not finite_rows(initial).all():
            raise ValueError(INVALID_INITIAL.format(type(self).__name__))
        return initial.read_only()

    def predict(self, belief: Record, u: np.ndarray | None = None, rng: Rng = None) -> Record:
        """One step ahead: ``x(k-1|k-1)`` to ``x(k|k-1)``.

        Numerical trouble stays silent here: the next update finds the rows that are lost.

        Args:
            belief: The belief after the last update.
            u: Known input ``(..., m)`` over the step.
            rng: Likewise, as for `init`.

        Raises:
            TypeError: if ``belief`` is none.
            ValueError: if ``u`` has the wrong shape, could only be ignored, or is missing though
                the model has B.
        """
        u = self._known(u, self._batch(belief))
        self._check_known_input(u)
        return self.forecast(belief, u, rng).read_only()

    def update(
        self,
        belief: Record,
        y: np.ndarray,
        rng: Rng = None,
        available: np.ndarray | None = None,
        R: np.ndarray | None = None,
        u: np.ndarray | None = None,
    ) -> Record:
        """Take in a measurement: ``x(k|k-1)`` to ``x(k|k)``.

        Sensors that arrive one by one take an update each: those of one step leave what one update
        with all of its measurements does, see `sequential`; filters of which that does not hold
        refuse the second.

        Never raises for numerical trouble, and forgets no more than it must. Where the usual gain
        gives no finite belief, a row takes the first of these that does, and its ``recovery`` says
        which: the gain with the pseudo-inverse, the measurement without the offending channels, the
        prediction alone, the prior and this measurement.

        Args:
            belief: The predicted belief.
            y: Measurements ``(..., p)``; a value that is not finite counts as missing.
            rng: Likewise, as for `init`.
            available: Mask ``(..., p)`` of the measurements that arrived; None: all.
            R: Measurement covariance ``(..., p, p)`` for this measurement only; None: the model's.
                A measurement whose variance is not finite counts as missing; what R says of missing
                measurements does not matter.
            u: Known input ``(..., m)`` for a model whose measurement depends on it; None: the one
                of the last prediction.

        Raises:
            TypeError: if ``belief`` is none.
            ValueError: if ``y``, ``available``, ``R`` or ``u`` have the wrong shape, or R is no
                covariance; or if the step has had an update with which this one does not add up to
                one of both.
        """
        batch, p = self._batch(belief), self.model.p
        y = as_array("y", y)
        if y.ndim == len(batch) + 2 and y.shape[-1] == p:
            raise ValueError(
                f"y has shape {y.shape}, expected {(*batch, p)}: measurements by age, some of them"
                " late, are for Delayed(filter, horizon)"
            )
        y = _broadcast("y", y, batch + (p,))
        if available is not None:
            available = _broadcast("available", as_mask("available", available), batch + (p,))
        if R is not None:
            R = _broadcast("R", as_array("R", R), batch + (p, p), core=2)
            as_covariance("R", masked(*self._noise(y, available, R, None)))
        if u is not None:
            belief = belief.with_input(self._known(u, batch))
        if belief.innovation is not None:
            self._check_sequence(
                belief,
                *self._noise(y, available, self._own_R(belief) if R is None else R, belief.u),
            )
        return self.correct(belief, y, available, R, rng).read_only()

    def log_likelihood(self, predicted: Record, updated: Record) -> np.ndarray:
        """The log density ``(...)`` of a measurement, given those before it; 0 where none came.

        Channels that follow from those before them without noise add nothing, or minus infinity if
        they contradict. A mixture of states that is known exactly, while they are not, is known to
        rounding only: make it a state.

        Args:
            predicted: The belief that the measurement met.
            updated: What `update` made of it.

        Raises:
            ValueError: if the filter gives no innovation covariance.
        """
        if (own := getattr(updated, "log_likelihood", None)) is not None:
            return np.asarray(own)
        e, S, available = updated.innovation, updated.innovation_cov, updated.available
        if e is None or S is None or available is None:
            raise ValueError(
                f"{self.name} gives no covariance of its innovations, so that measurements have no"
                " likelihood: return it from _update (Belief.updated does), or compare predictions"
                " with measurements"
            )
        size = np.abs(predicted.mean).max(-1, keepdims=True)
        if (
            S.diagonal(0, -2, -1) <= np.square(1e-8 * size)
        ).any():  # which states' rounding is in which channel?
            size, at = (
                np.abs(predicted.mean) + np.abs(predicted.prior_mean),
                (predicted.mean, updated.u, predicted.cov),
            )
            if (
                predicted.mean != predicted.prior_mean
            ).any():  # at first no state has moved, perhaps for want of u
                size = size + np.matvec(np.abs(self.model.linearise_transition(*at)[1]), size)
            size = np.matvec(np.abs(self.model.linearise_measurement(*at)[1]), size)
        return log_density(e, S, available, size)

    # --- the same of arguments that need no check -------------------------------------------------

    @abstractmethod
    def start(self, prior: Gaussian, rng: Rng = None, u: np.ndarray | None = None) -> Record:
        """The belief before any measurement; ``u (..., m)`` is the known input of the first one."""

    @abstractmethod
    def forecast(self, belief: Record, u: np.ndarray | None, rng: Rng) -> Record:
        """The belief one step ahead."""

    @abstractmethod
    def correct(
        self,
        belief: Record,
        y: np.ndarray,
        available: np.ndarray | None,
        R: np.ndarray | None,
        rng: Rng,
    ) -> Record:
        """The belief after a measurement."""

    def begin(
        self,
        prior: Gaussian,
        u: np.ndarray | None,
        y: np.ndarray,
        available: np.ndarray | None,
        rng: Rng,
    ) -> Record:
        """The belief after the first measurement, of which ``u (..., m)`` is the known input."""
        return self.correct(self.start(prior, rng, u), y, available, None, rng)

    def advance(
        self,
        belief: Record,
        u: np.ndarray | None,
        y: np.ndarray,
        available: np.ndarray | None,
        rng: Rng,
    ) -> Record:
        """The belief one step ahead and after its measurement."""
        return self.correct(self.forecast(belief, u, rng), y, available, None, rng)

    def forecast_steps(
        self, belief: Record, u: np.ndarray | None, y: np.ndarray, available: np.ndarray, wait: np.ndarray,
        kept: Sequence[int],
    ) -> list[np.ndarray] | None:  # fmt: skip
        """Predictions of successive steps, packed ``(rows, width)`` as the first; None: take one after the other.

        Args:
            belief: The prediction that the first measurement meets.
            u: Known inputs ``(steps + 1, rows, m)``: that of the first measurement, then those of
                the predictions.
            y: ``(steps, rows, p)`` measurements.
            available: ``(steps, rows, p)``.
            wait: ``(rows,)`` steps after which a row begins: ``belief`` is its prediction there.
            kept: Steps whose predictions are returned; the last one is among them.
        """
        return None

    # --- checks, which a filter may narrow --------------------------------------------------------

    def _check_known_input(self, u: np.ndarray | None) -> None:
        self.model.check_known_input(u)

    def _batch(self, belief: Record) -> tuple[int, ...]:
        """The leading axes of a belief, checked to be one for this model."""
        if not isinstance(belief, self.record):
            kinds = f"of type {self.record.__name__}, got {type(belief).__name__}"
            raise TypeError(f"belief must be {kinds}: begin with init(prior)")
        *batch, n = belief.mean.shape
        if n != self.model.n:
            raise ValueError(f"the belief is for {n} states, the model has {self.model.n}")
        return tuple(batch)

    def _known(self, u: np.ndarray | None, batch: tuple[int, ...]) -> np.ndarray | None:
        """The known input with a row for each belief, so that rows can be taken out and replaced."""
        if u is None:
            return None
        u = frozen(as_array("u", u))  # the belief keeps it
        return _broadcast("u", u, batch + (u.shape[-1:] or (1,)))

    def _check_sequence(self, belief: Record, R: np.ndarray, arrived: np.ndarray) -> None:
        """Refuse a further update of a step that does not add up to one update with all measurements of the step.

        Raises:
            ValueError: saying why, and what to do.
        """
        before = cast(np.ndarray, belief.available)
        remedy = (
            "pass all measurements of a step together, NaN for none, or give them to"
            " Delayed(filter, 0)"
        )
        same = (
            before.shape == arrived.shape
        )  # else the measurements before were of another model of the same states
        if not self.sequential:
            # A drawing filter would draw the same numbers again, even for measurements that come
            # twice; with a delayed input even an update without measurements says what the input
            # was.
            new = (
                arrived & ~before if same and not self.random and self.input_delay != 1 else arrived
            )
            if ((before.any(-1) | (self.input_delay == 1)) & new.any(-1)).any():
                raise ValueError(f"{self.name} takes one update a step: {remedy}")
        if not same:
            return
        shared = (before & ~arrived)[..., :, None] & (arrived & ~before)[..., None, :] & (R != 0.0)
        if shared.any():
            i, j = np.argwhere(shared)[0, -2:]
            raise ValueError(
                f"the noises of measurements {i} and {j} are correlated, but they come in two"
                f" updates: {remedy}"
            )

    # --- measurement noise ------------------------------------------------------------------------

    def _noise(
        self,
        y: np.ndarray,
        available: np.ndarray | None,
        R: np.ndarray | None,
        u: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """R ``(..., p, p)`` and the mask ``(..., p)`` of the measurements that tell something."""
        mask = np.isfinite(y) if available is None else np.isfinite(y) & available
        if R is None and not callable(self.model.R):
            return self.model.R, mask
        R, known = usable(resolve(self.model.R, u) if R is None else R)
        return R, mask & known

    def _own_R(self, belief: Record) -> np.ndarray:
        """R ``(..., p, p)`` of measurements that bring none of their own."""
        return noise_at(self.model.R, belief.mean, belief.u)


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


INVALID_INITIAL = "{}._init must give a finite mean and a covariance for a prior that is so"
