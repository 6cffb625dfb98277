"""Filters that run on the engine: `_predict` and `_update`, compiled where they are formulas, and their recovery."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from typing import Any, ClassVar, TypeVar, cast

import numpy as np

from estimators.angles import difference
from estimators.belief import Belief, Layout, Record, finite_rows
from estimators.checks import frozen
from estimators.contract import INVALID_INITIAL, Estimator, Model, Rng
from estimators.engine import Compiled
from estimators.engine.matrices import is_traced
from estimators.linalg import congruence, identity, lacks_rank, masked
from estimators.measurement import Measurement
from estimators.models import Gaussian, LinearModel
from estimators.randomness import RandomKeys
from estimators.recovery import (
    attempt,
    condensed,
    doubtful_rows,
    evened,
    proper,
    recovered,
    unsound_rows,
)
from estimators.tracing import BOTH, PREDICTIONS, SUCCESSIVE, Traced, traced
from estimators.varying import Schedule, StateNoise, resolve

__all__ = ["Filter", "Model", "Rng", "inlinable"]

_Method = TypeVar("_Method", bound=Callable[..., Any])


def inlinable(*names: str) -> Callable[[_Method], _Method]:
    """Declare that a method which evaluates the model can be traced together with the model's functions of these names.

    Of a Jacobian that the model does not have, the function's own derivative takes the place.
    """

    def declared(method: _Method) -> _Method:
        vars(method)["inlinable"] = names
        return method

    return declared


class Filter(Estimator[Record], verified=True):
    """A filter is immutable configuration; a `Belief` is its state.

    A filter of your own fills in ``_predict`` and ``_update``, and calls
    ``super().__init__(model)``. One whose beliefs are another record than `Belief` says so
    (``Filter[InputBelief]``, ``record``) and makes them so in ``_init``.
    """

    _questions: ClassVar[dict[str, str]] = {"_moved": "_propagate", "_linearise": "_linearise"}
    """Methods that ask something of the model, and the methods that evaluate it."""
    formulas: ClassVar[bool] = False
    """Whether ``_predict`` and ``_update`` are formulas, which are compiled, see `estimators.engine.matrices`.

    They are then traced once: what they read of the filter itself, or do besides, counts as it was
    then. It is not inherited: a filter of your own is NumPy until it says otherwise. Arrays that
    its record has besides are masks or float64 afterwards.
    """

    idle: bool = False
    """An update without measurements leaves the prediction as it is, to the last bit."""

    def __init__(self, model: Model) -> None:
        super().__init__(model)
        self._identity, self._no_columns = identity(model.n), np.zeros((model.p, 0))
        R = model.R.table if isinstance(model.R, Schedule) else model.R
        self._regular = None if callable(R) else not lacks_rank(R).any()
        self._alike = all(
            getattr(matrix, "ndim", 2) == 2 for matrix in vars(model).values()
        )  # all rows have one model
        self._programs: dict[Any, Any] | None = {} if self.formulas and self._alike else None
        self._first: tuple[np.ndarray, Layout] | None = (
            None  # a row as it begins, but for mean and covariance
        )

    def __init_subclass__(cls, verified: bool = False, **arguments: Any) -> None:
        if not hasattr(cls, "name"):
            cls.name = cls.__name__
        if not verified and "formulas" not in cls.__dict__:
            cls.formulas = False
        super().__init_subclass__(verified, **arguments)

    @classmethod
    def _frozen(cls) -> bool:
        return cls.formulas  # a program holds what it was traced of

    def __getstate__(self) -> dict[str, Any]:
        """All but its programs, which are traced again."""
        return self.__dict__ | {"_programs": None if self._programs is None else {}, "_first": None}

    def __getattr__(self, name: str) -> Any:
        if name in (
            "model",
            "_identity",
            "_no_columns",
            "_regular",
            "_alike",
            "_programs",
            "_first",
        ):
            raise TypeError(
                f"{type(self).__name__} has no model: its __init__ must call"
                " super().__init__(model)"
            )
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")

    # --- what a filter fills in -------------------------------------------------------------------

    def _init(self, belief: Belief, rng: Rng) -> Record:
        return cast(Record, belief)

    @abstractmethod
    def _predict(self, belief: Record, u: np.ndarray | None, rng: Rng) -> Record: ...

    @abstractmethod
    def _update(self, belief: Record, measurement: Measurement, rng: Rng) -> Record: ...

    # --- the contract, of arguments that need no check --------------------------------------------

    def start(self, prior: Gaussian, rng: Rng = None, u: np.ndarray | None = None) -> Record:
        """The belief before any measurement; ``u (..., m)`` is the known input of the first one."""
        if (
            self.verified
            and self._programs is not None
            and not self.random
            and prior.mean.ndim == prior.cov.ndim == 2
        ):
            return self._start_alike(prior, u)
        u = self._protected(u)
        n, batch = self.model.n, np.broadcast(prior.mean[..., 0], prior.cov[..., 0, 0]).shape
        mean, cov = np.empty(batch + prior.mean.shape[-1:]), np.empty(batch + (n, n))
        mean[...], cov[...] = prior.mean, prior.cov
        initial = self._init(Belief(mean, cov, mean, cov, np.zeros(batch, np.int8), u), rng)
        if self.verified:
            return initial
        initial = self._returned("_init", initial, batch)
        if not (finite_rows(initial).all() and proper(initial.cov)):
            raise ValueError(INVALID_INITIAL.format(type(self).__name__))
        return initial

    def _start_alike(self, prior: Gaussian, u: np.ndarray | None) -> Record:
        """The same of rows that share a covariance: nothing else of a filter of formulas depends on the prior."""
        if self._first is None:
            mean, cov = np.zeros((1, self.model.n)), prior.cov[None]
            self._first = self._init(
                Belief(mean, cov, mean, cov, np.zeros(1, np.int8)), None
            ).pack()
        row, layout = self._first
        packed = row.repeat(len(prior.mean), 0)
        packed[layout.fields["mean"][0]], packed[layout.fields["cov"][0]] = (
            prior.mean,
            prior.cov.ravel(),
        )
        initial: Any = self.record.view(packed, layout, None, None, u)
        object.__setattr__(initial, "prior_mean", initial.mean)
        object.__setattr__(initial, "prior_cov", initial.cov)
        return cast(Record, initial)

    def forecast(self, belief: Record, u: np.ndarray | None, rng: Rng) -> Record:
        """The belief one step ahead."""
        u = self._protected(u)
        if self._compiles(rng):
            packed, layout = belief.pack()
            program = cast(Traced, self._program(("_predict",), belief, layout, u))
            return self._executed(program, belief, packed, u, rng=rng)[0]
        with np.errstate(all="ignore"):
            predicted = self._predict(belief, u, rng)
        if self.verified:
            return predicted
        predicted = self._returned("_predict", predicted, belief.mean.shape[:-1])
        if predicted.innovation is None:
            return predicted
        return Belief.replace(predicted, innovation=None, innovation_cov=None, available=None)

    def correct(
        self,
        belief: Record,
        y: np.ndarray,
        available: np.ndarray | None,
        R: np.ndarray | None,
        rng: Rng,
    ) -> Record:
        """The belief after a measurement, recovered where the usual update holds nothing."""
        regular = self._regular
        if R is not None or regular is None:
            R = self._own_R(belief) if R is None and isinstance(self.model.R, StateNoise) else R
            regular = not lacks_rank(masked(*self._noise(y, available, R, belief.u))).any()
        nothing = (
            self.idle and regular and R is None and available is not None and not available.any()
        )
        if nothing and (predicted := self._without_measurement(belief)) is not None:
            return predicted
        if self._compiles(rng):
            packed, layout = belief.pack()
            program = cast(Traced, self._program(("_update",), belief, layout, belief.u, R))
            updated, rows = self._executed(program, belief, packed, belief.u, y, available, R, rng)
        else:
            own = y, available
            if not self.verified:  # it may write into what it is given
                own = y.copy(), None if available is None else available.copy()
            with np.errstate(all="ignore"):
                measurement = self._measurement(belief, *own, R)
                updated = attempt(self, belief, measurement, rng)
                if not self.verified:
                    updated = self._returned("_update", updated, belief.mean.shape[:-1])
                rows = doubtful_rows(updated, measurement.R)
        doubtful = np.count_nonzero(rows) > 0
        if regular and doubtful:
            rows = unsound_rows(self, belief, updated, rows)
        if regular and not (doubtful and rows.any()) and (self.verified or proper(updated.cov)):
            return updated
        with np.errstate(all="ignore"):
            if not (regular and self.verified and self._alike):
                measurement = self._measurement(belief, y, available, R)
                return self._recovered(belief, updated, measurement, y, rng, available, R)
            some, y, rng = belief[rows], y[rows], rng[rows] if isinstance(rng, RandomKeys) else rng
            available, R = (None if a is None else a[rows] for a in (available, R))
            measurement = self._measurement(some, y, available, R)
            return updated.with_rows(
                rows, self._recovered(some, updated[rows], measurement, y, rng, available, R)
            )

    def _without_measurement(self, belief: Record) -> Record | None:
        """The belief after an update without measurements, which leaves a prediction as it is; None: update it."""
        packed, layout = belief.pack()
        if not (
            self._compiles(None)
            and self.verified
            and belief.innovation is None
            and np.isfinite(packed.sum())
        ):
            return None
        program = cast(Traced, self._program(("_update",), belief, layout, belief.u))
        out = np.zeros((*packed.shape[:-1], program.layout.width))
        for name, (columns, _) in layout.fields.items():
            out[program.layout.fields[name][0]] = packed[columns]
        out[program.layout.fields["innovation_cov"][0]] = identity(self.model.p).ravel()
        prior = belief.prior_mean, belief.prior_cov
        return cast(Record, self.record.view(out, program.layout, *prior, belief.u))

    def advance(
        self,
        belief: Record,
        u: np.ndarray | None,
        y: np.ndarray,
        available: np.ndarray | None,
        rng: Rng,
    ) -> Record:
        """The belief one step ahead and after its measurement, in one program where that can be."""
        if self._regular and self._compiles(rng):
            packed, layout = belief.pack()
            program = self._program(BOTH, belief, layout, u)
            if program is not None:
                updated, doubtful = self._executed(
                    program, belief, packed, u, y, available, rng=rng
                )
                if not np.count_nonzero(doubtful) and (self.verified or proper(updated.cov)):
                    return updated
        return super().advance(belief, u, y, available, rng)

    def forecast_steps(
        self, belief: Record, u: np.ndarray | None, y: np.ndarray, available: np.ndarray, wait: np.ndarray,
        kept: Sequence[int],
    ) -> list[np.ndarray] | None:  # fmt: skip
        """`Estimator.forecast_steps`, a program for all successive steps with measurements, or without."""
        if self.random or not (self._compiles(None) and self.verified and self._regular):
            return None
        (packed, layout), (steps, rows) = belief.pack(), y.shape[:2]
        measured: Any = (
            available.reshape(steps, -1).any(1).tolist() if self.idle else [True] * steps
        )
        programs = dict[bool, Traced]()
        for each in set(measured):
            program = self._program(
                SUCCESSIVE if each else PREDICTIONS, belief, layout, None if u is None else u[0]
            )
            if program is None or program.callbacks or program.layout is not layout:
                return None
            programs[each] = program
        predicted, doubtful = list[np.ndarray](), np.zeros((steps, rows), bool)
        state, running = np.ascontiguousarray(packed), wait <= np.arange(steps)[:, None]
        cuts = {k + 1 for k in kept} | {
            k for k in range(1, steps) if measured[k] != measured[k - 1]
        }
        for first, last in pairwise(sorted({0, *cuts})):
            before, now = (state, state) if u is None else (u[first:], u[first + 1 :])
            following = np.empty((rows, layout.width))
            programs[measured[first]].function(
                rows, last - first, state, now, y[first:], available[first:], state, state, state, before,
                running[first:], following, doubtful[first:],
            )  # fmt: skip
            state = following
            if last - 1 in kept:
                predicted.append(state)
        return None if doubtful.any() or not np.isfinite(state.sum()) else predicted

    # --- programs: see estimators.tracing ---------------------------------------------------------

    def _compiles(self, rng: Rng) -> bool:
        """Are prediction and update programs? They draw no numbers from a Generator."""
        return self._programs is not None and not (
            self.random and isinstance(rng, np.random.Generator)
        )

    def _program(
        self,
        methods: tuple[str, ...],
        belief: Belief,
        layout: Layout,
        u: Any,
        R: np.ndarray | None = None,
    ) -> Traced | None:
        """The program of methods, traced where there is none yet or something that it reads has changed.

        None where prediction and update cannot be one: host callbacks of an update need the
        prediction.
        """
        key = methods, layout, None if u is None else u.shape[-1], R is None
        assert self._programs is not None
        program = self._programs.get(key)
        if program is None or not program.current():
            several = len(methods) > 1 and not isinstance(self.model, LinearModel)
            if several and len(self._inlined(belief, u)) < len(self._questions):
                return None
            program = self._programs[key] = traced(self, methods, belief, layout, u, R)
        return program

    def _executed(
        self, program: Traced, belief: Belief, packed: np.ndarray, u: np.ndarray | None, y: np.ndarray | None = None,
        available: np.ndarray | None = None, R: np.ndarray | None = None, rng: Rng = None,
    ) -> tuple[Record, np.ndarray]:  # fmt: skip
        """The result of a program of `_predict`, `_update` or both; and the mask ``(...)`` of its `doubtful_rows`."""
        batch = packed.shape[:-1]
        keys, step = self._words(rng, batch) if self.random else (packed, packed)
        out, doubtful = program.function.compute((
            packed, packed if u is None else u, packed if y is None else y,
            _all(batch, self.model.p) if available is None else available,
            program.results(belief, u, R, batch) if program.callbacks else packed, keys, step,
        ))  # fmt: skip
        recovery = belief.recovery if y is None else None
        updated: Any = self.record.view(
            out, program.layout, belief.prior_mean, belief.prior_cov, u, recovery
        )
        return updated, doubtful

    def _words(self, rng: Rng, batch: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Keys ``(rows, 2)`` and steps ``(rows, 1)`` of a filter that draws random numbers."""
        raise NotImplementedError

    def _by_rows(self, formula: Callable[..., Any], *matrices: np.ndarray) -> Any:
        """A formula of matrices ``(..., n, m)``, compiled where the filter's own are.

        For what is computed between host callbacks; it gives vectors or matrices, one or a tuple of
        them.
        """
        if self._programs is None:
            return formula(*matrices)
        if (own := self._programs.get(formula.__name__)) is None:
            own = self._programs[formula.__name__] = Compiled(formula, (2,) * len(matrices), True)
        return own(*matrices)

    # --- the model --------------------------------------------------------------------------------

    def _asked(self, question: str, belief: Record, u: np.ndarray | None) -> Any:
        """A method's answer about a belief; a host callback where the model's function behind it is not traced."""
        if is_traced(belief.mean) and not isinstance(self.model, LinearModel):
            program = cast(Any, belief.mean).program
            if question not in program.inlined:
                return program.callback(
                    lambda belief, u, R: getattr(self, question)(belief, u), *_ANSWERS[question]
                )
        return getattr(self, question)(belief, u)

    def _inlined(self, belief: Belief, u: np.ndarray | None) -> frozenset[str]:
        """The model's functions that are traced with the methods which linearise them, by these methods' names.

        Others are host callbacks: a method that evaluates the model by itself, a function that
        cannot be traced.
        """
        if isinstance(self.model, LinearModel):
            return frozenset()
        names = {
            question: getattr(getattr(type(self), m), "inlinable", ())
            for question, m in self._questions.items()
        }
        return frozenset(
            q for q, each in names.items() if each and self.model.traceable(belief.mean, u, *each)
        )

    def _moved(self, belief: Record, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Mean ``(..., n)`` and covariance ``(..., n, n)`` one step on, without process noise."""
        return self._propagate(belief.mean, belief.cov, u)

    @inlinable("transition", "transition_jacobian")
    def _propagate(
        self, mean: np.ndarray, cov: np.ndarray, u: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean ``(..., n)`` and covariance ``(..., n, n)`` one step on, without process noise."""
        mean, A = self.model.linearise_transition(mean, u, cov)
        return mean, congruence(A, cov)

    @inlinable("measurement", "measurement_jacobian")
    def _linearise(
        self, belief: Record, u: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Expected measurement ``(..., p)``, C ``(..., p, n)``, and what is to be added to R for what C leaves out."""
        return *self.model.linearise_measurement(belief.mean, u, belief.cov), None

    def _slopes(self, belief: Record, u: np.ndarray | None) -> np.ndarray:
        """A ``(..., n, n)``: how the next state follows the state, of which the belief is."""
        return self.model.linearise_transition(belief.mean, u, belief.cov)[1]

    def _measurement(
        self, belief: Record, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None
    ) -> Measurement:
        """Innovation and measurement matrices, with missing channels masked."""
        model, u = self.model, belief.u
        expected, C, excess = self._asked("_linearise", belief, u)
        H = self._no_columns if model.H is None else resolve(model.H, u)
        R, mask = self._noise(y, available, R, u)
        measurement = Measurement(
            difference(y, expected, model.measurement_angles), C, H, R if excess is None else R + excess, mask,
            not is_traced(mask) and bool(mask.all()),
        )  # fmt: skip
        return measurement if measurement.complete else measurement.only(mask)

    # --- results of methods of one's own, and recovery --------------------------------------------

    def _protected(self, u: np.ndarray | None) -> np.ndarray | None:
        """The known input; a read-only copy for methods of one's own, which may write into it."""
        return u if u is None or self.verified else frozen(u)

    def _returned(self, method: str, belief: Record, batch: tuple[int, ...]) -> Record:
        """The result of a filter's own method, checked to be a belief of the right shape."""
        if not isinstance(belief, self.record):
            kinds = f"a belief of type {self.record.__name__}, got {type(belief).__name__}"
            raise TypeError(f"{type(self).__name__}.{method} must return {kinds}")
        n, mean, cov = (
            self.model.n,
            getattr(belief.mean, "shape", None),
            getattr(belief.cov, "shape", None),
        )
        if mean != batch + (n,) or cov != batch + (n, n):
            raise ValueError(
                f"{type(self).__name__}.{method} must return a mean of shape {batch + (n,)} and a"
                f" cov of shape {batch + (n, n)}, got {mean} and {cov}"
            )
        even = np.array_equal(belief.cov, belief.cov.mT)
        return (belief if even else Belief.replace(belief, cov=evened(belief.cov))).read_only()

    def _recovered(
        self, belief: Record, updated: Record, measurement: Measurement, y: np.ndarray, rng: Rng,
        available: np.ndarray | None, R: np.ndarray | None,
    ) -> Record:  # fmt: skip
        """The update with every lost row replaced by the mildest remedy that holds."""
        return recovered(self, belief, updated, measurement, y, rng, available, R)

    def _condensed(
        self, start: Record, measurement: Measurement, S: np.ndarray, lost: np.ndarray
    ) -> tuple[Measurement, np.ndarray] | None:
        """The measurement in the directions in which S is not singular, and the rows it is for; None: none will do."""
        return condensed(measurement, S, lost, self._observable_input(start, measurement))

    def _observable_input(self, belief: Record, measurement: Measurement) -> np.ndarray | None:
        """Effect of an unknown input, in units of its prior, on the measurement ``(..., p, k)``; None: no input."""
        return None


_ANSWERS = {
    "_moved": (1, 2),
    "_linearise": (1, 2, 2),
    "_moving_G": (2,),
    "_moved_members": (2,),
    "_expected": (2,),
}
"""Axes of what these methods say of a row."""


@cache
def _all(batch: tuple[int, ...], measurements: int) -> np.ndarray:
    """The mask of measurements that have all arrived, made once."""
    return np.ones((*batch, measurements), bool)
