"""The contract that every filter keeps: ``init``, ``predict``, ``update``."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from inspect import signature
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar, cast

import numpy as np

from estimators.angles import difference
from estimators.belief import (
    APART,
    MEMBERS,
    Belief,
    Layout,
    Record,
    laid_out,
)
from estimators.checks import as_array, as_mask, frozen, shown
from estimators.engine import tracer
from estimators.engine.compiled import given
from estimators.engine.foreign import Inspection
from estimators.engine.function import Argument, Function
from estimators.engine.matrices import MatrixTracer, is_traced, matrix, matrix_input
from estimators.engine.program import Program
from estimators.linalg import (
    congruence,
    identity,
    log_density,
    neutralised,
    symmetrise,
)
from estimators.model_checks import as_covariance, usable
from estimators.models import Gaussian, LinearModel, NonlinearModel
from estimators.randomness import Numbers
from estimators.reading import Reading
from estimators.recovery import (
    COVARIANCES,
    condensed,
    doubtful_rows,
    evened,
    finite_rows,
    positive_pivots,
    proper,
    recovered,
    regular_noise,
)
from estimators.varying import StateNoise, noise_at, resolve

Rng = Numbers | np.random.Generator | None
"""Where random numbers come from: keys a row and a step, or a Generator for the whole batch."""
Model = LinearModel | NonlinearModel
_Method = TypeVar("_Method", bound=Callable[..., Any])


def inlinable(*names: str) -> Callable[[_Method], _Method]:
    """Declare that a method which evaluates the model can be traced together with the model's functions of these names.

    Of a Jacobian that the model does not have, the function's own derivative takes the place.
    """

    def declared(method: _Method) -> _Method:
        vars(method)["inlinable"] = names
        return method

    return declared


class Filter(ABC, Generic[Record]):
    """A filter is immutable configuration; a `Belief` is what it believes.

    Randomness is an argument (`Rng`), and filters without randomness ignore it. A filter of
    your own fills in ``_predict`` and ``_update``, and calls ``super().__init__(model)``. One whose beliefs are another
    record than `Belief` says so (``Filter[InputBelief]``, ``record``) and makes them so in ``_init``.
    """

    name: ClassVar[str]
    """What it is called; the class' own name if it does not say."""
    record: type[Belief] = Belief
    """What its beliefs are."""
    input_delay: int | None = None
    """Steps by which the unknown input is known late (0 or 1); None: the filter estimates none."""
    random: ClassVar[bool] = False
    """Whether the filter draws random numbers, so that ``rng`` must be given."""
    manifolds: ClassVar[bool] = False
    """Whether states may be no vectors (`NonlinearModel.difference`)."""
    _ours: ClassVar[bool]
    _settings: ClassVar[frozenset[str]]
    """Arguments of constructors, which are read-only afterwards."""
    _threads: int = 1
    """That rows are shared among (`estimators.threads`), set by who has asked for them: no result depends on it."""
    sequential: bool = True
    """Updates of one step add up to one with all its readings: on a linear model, with noises that are independent."""
    likelihood: ClassVar[str] = "approximate"
    """What `log_likelihood` is: "exact", "diffuse" or "approximate"."""
    _questions: ClassVar[dict[str, str]] = {"_moved": "_propagate", "_linearise": "_linearise"}
    """What is asked of the model, and the method that evaluates it."""
    formulas: ClassVar[bool] = False
    """Whether ``_predict`` and ``_update`` are formulas, which are compiled, see `estimators.engine.matrices`.

    They are then traced once: what they read of the filter itself, or do besides, counts as it was then. It is not
    inherited: a filter of your own is NumPy until it says otherwise. Arrays that its record has besides are masks or
    float64 afterwards.
    """

    def __init__(self, model: Model) -> None:
        if not isinstance(model, LinearModel | NonlinearModel):
            raise TypeError(f"model must be a LinearModel or a NonlinearModel, got {type(model).__name__}")
        if getattr(model, "difference", None) is not None and not self.manifolds:
            raise ValueError(f"{self.name} needs states that are vectors: for a model with a difference use eskf")
        self.model = model
        self._identity, self._no_columns = identity(model.n), np.zeros((model.p, 0))
        self._regular = None if callable(model.R) else regular_noise(model.R)
        self._alike = all(getattr(matrix, "ndim", 2) == 2 for matrix in vars(model).values())  # all rows have one model
        self._programs: dict[Any, _Traced | None] | None = {} if self.formulas and self._alike else None
        self._first: tuple[np.ndarray, Layout] | None = None  # a row as it begins, but for mean and covariance

    def __getstate__(self) -> dict[str, Any]:
        """All but its programs, which are traced again."""
        return self.__dict__ | {"_programs": None if self._programs is None else {}, "_first": None}

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        if not hasattr(cls, "name"):
            cls.name = cls.__name__
        # Ours return covariances by their algebra, as the tests hold; what somebody else's return is looked at.
        if "_ours" not in cls.__dict__:
            cls._ours = cls.__module__.startswith("estimators.")
        if not cls._ours and "formulas" not in cls.__dict__:  # NumPy of any kind, unless it says that it is formulas
            cls.formulas = False
        # What a program was traced of, or what our classes have computed something of; another's own NumPy may count.
        kept = [base for base in cls.__mro__ if cls.formulas or base.__module__.startswith("estimators.")]
        cls._settings = frozenset(
            name for base in kept for name in signature(vars(base).get("__init__", object)).parameters
        )

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__dict__ and name in self._settings:
            raise AttributeError(
                f"{name} of a filter is read-only: build another filter, such as make({self.name!r}, model, {name}=...)"
            )
        object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> Any:
        if name in ("model", "_identity", "_no_columns", "_regular", "_programs", "_first"):
            raise TypeError(f"{type(self).__name__} has no model: its __init__ must call super().__init__(model)")
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")

    def __repr__(self) -> str:
        return f"{type(self).__name__}(n={self.model.n}, p={self.model.p}, q={self.model.q})"

    # --- public contract --------------------------------------------------------------------------

    def init(self, prior: Gaussian, rng: Rng = None) -> Record:
        """The belief before any reading: ``x(0|-1)``.

        Args:
            prior: Mean ``(..., n)`` and covariance ``(..., n, n)``; leading axes are the batch.
            rng: For filters that draw members: `Numbers` of this step, or a Generator.

        Raises:
            TypeError: if the prior is no `Gaussian`.
            ValueError: if the prior is not for n states.
        """
        if not isinstance(prior, Gaussian):
            raise TypeError(f"prior must be a Gaussian(mean, cov), got {type(prior).__name__}")
        self._check_prior(prior)
        begun = self._started(prior, rng, None)
        if not (finite_rows(begun).all() and (self._ours or proper(begun.cov))):
            raise ValueError(
                f"{type(self).__name__}._init must give a finite mean and a covariance for a prior that is so"
            )
        return begun.read_only()

    def _check_prior(self, prior: Gaussian) -> None:
        for size in (prior.mean.shape[-1], prior.cov.shape[-1]):
            if size != self.model.n:
                raise ValueError(f"the prior is for {size} states, the model has {self.model.n}")

    def _started(self, prior: Gaussian, rng: Rng, u: np.ndarray | None) -> Record:
        """What `init` gives, of a prior for this model, told the known input of the first reading."""
        if self._ours and self._programs is not None and not self.random and prior.mean.ndim == prior.cov.ndim == 2:
            return self._started_alike(prior, u)
        n, batch = self.model.n, np.broadcast(prior.mean[..., 0], prior.cov[..., 0, 0]).shape
        mean, cov = np.empty(batch + prior.mean.shape[-1:]), np.empty(batch + (n, n))
        mean[...], cov[...] = prior.mean, prior.cov
        begun = self._init(Belief(mean, cov, mean, cov, np.zeros(batch, np.int8), u), rng)
        return begun if self._ours else self._returned("_init", begun, batch)

    def _started_alike(self, prior: Gaussian, u: np.ndarray | None) -> Record:
        """The same of rows that share a covariance: nothing else of a filter of formulas depends on the prior."""
        if self._first is None:
            mean, cov = np.zeros((1, self.model.n)), prior.cov[None]
            self._first = self._init(Belief(mean, cov, mean, cov, np.zeros(1, np.int8)), None).side_by_side()
        row, layout = self._first
        packed = row.repeat(len(prior.mean), 0)
        packed[layout.cuts["mean"][0]], packed[layout.cuts["cov"][0]] = prior.mean, prior.cov.ravel()
        begun: Any = self.record.looked_at(packed, layout, None, None, u)
        object.__setattr__(begun, "prior_mean", begun.mean)
        object.__setattr__(begun, "prior_cov", begun.cov)
        return cast(Record, begun)

    def predict(self, belief: Record, u: np.ndarray | None = None, rng: Rng = None) -> Record:
        """One step ahead: ``x(k-1|k-1)`` to ``x(k|k-1)``.

        Numerical trouble stays silent here: the next update finds the rows that are lost.

        Args:
            belief: The belief after the last update.
            u: Known input ``(..., m)`` over the step.
            rng: Likewise, as for `init`.

        Raises:
            TypeError: if ``belief`` is none.
            ValueError: if ``u`` has the wrong shape, could only be ignored, or is missing though the model has B.
        """
        batch = self._batch(belief)
        u = self._known(u, batch)
        self._check_known_input(u)
        predicted = self._predicted(belief, u, rng)
        return (predicted if self._ours else self._returned("_predict", predicted, batch)).read_only()

    def update(
        self,
        belief: Record,
        y: np.ndarray,
        rng: Rng = None,
        available: np.ndarray | None = None,
        R: np.ndarray | None = None,
        u: np.ndarray | None = None,
    ) -> Record:
        """Take in a reading: ``x(k|k-1)`` to ``x(k|k)``.

        Sensors that arrive one by one take an update each: those of one step leave what one update with all of its
        readings does, see `sequential`; filters of which that does not hold refuse the second.

        Never raises for numerical trouble, and forgets no more than it must. Where the usual gain gives no finite
        belief, a row takes the first of these that does, and its ``recovery`` says which: the gain with the
        pseudo-inverse, the reading without the offending channels, the prediction alone, the prior and this reading.

        Args:
            belief: The predicted belief.
            y: Readings ``(..., p)``; a value that is not finite counts as missing.
            rng: Likewise, as for `init`.
            available: Mask ``(..., p)`` of the readings that arrived; None: all.
            R: Measurement covariance ``(..., p, p)`` for this reading only; None: the model's. A reading whose
                variance is not finite counts as missing; what R says of missing readings does not matter.
            u: Known input ``(..., m)`` for a model whose measurement depends on it; None: the one
                of the last prediction.

        Raises:
            TypeError: if ``belief`` is none.
            ValueError: if ``y``, ``available``, ``R`` or ``u`` have the wrong shape, or R is no covariance; or if the
                step has had an update with which this one does not add up to one of both.
        """
        batch, p = self._batch(belief), self.model.p
        y = as_array("y", y)
        if y.ndim == len(batch) + 2 and y.shape[-1] == p:
            raise ValueError(
                f"y has shape {y.shape}, expected {(*batch, p)}: readings by age, some of them late, are for "
                "Delayed(filter, horizon)"
            )
        y = _broadcast("y", y, batch + (p,))
        if available is not None:
            available = _broadcast("available", as_mask("available", available), batch + (p,))
        if R is not None:
            R = _broadcast("R", as_array("R", R), batch + (p, p), core=2)
            _, known = usable(R)
            arrived = np.isfinite(y) & known if available is None else np.isfinite(y) & known & available
            as_covariance("R", neutralised(R, arrived))
        if u is not None:
            belief = belief.with_input(self._known(u, batch))
        # Only a prediction of this package is sure to leave no innovation.
        if belief.innovation is not None and type(self)._predict.__module__.startswith("estimators."):
            self._check_sequence(belief, *self._noise(y, available, self._own_R(belief) if R is None else R, belief.u))
        return self._corrected(belief, y, available, R, rng).read_only()

    def _check_sequence(self, belief: Record, R: np.ndarray, arrived: np.ndarray) -> None:
        """Refuse a further update of a step that does not add up to one update with all readings of the step.

        Raises:
            ValueError: saying why, and what to do.
        """
        before: Any = belief.available
        remedy = "pass all readings of a step together, NaN for none, or give them to Delayed(filter, 0)"
        same = before.shape == arrived.shape  # else the readings before were of another model of the same states
        if not self.sequential:
            met, new = before.any(-1), arrived & ~before if same else arrived
            if self.random:  # it would draw the same numbers again, even for readings that come twice
                new = arrived
            if self.input_delay == 1:  # even an update without readings says what the input was
                met, new = True, arrived
            if (met & new.any(-1)).any():
                raise ValueError(f"{self.name} takes one update a step: {remedy}")
        if not same:
            return
        shared = (before & ~arrived)[..., :, None] & (arrived & ~before)[..., None, :] & (R != 0.0)
        if shared.any():
            i, j = np.argwhere(shared)[0, -2:]
            raise ValueError(
                f"the noises of readings {i} and {j} are correlated, but they come in two updates: {remedy}"
            )

    def log_likelihood(self, predicted: Record, updated: Record) -> np.ndarray:
        """The log density ``(...)`` of a reading, given those before it; 0 where none came.

        Args:
            predicted: The belief that the reading met.
            updated: What `update` made of it.

        Raises:
            ValueError: if the filter gives no innovation covariance.
        """
        if (own := getattr(updated, "log_likelihood", None)) is not None:
            return np.asarray(own)
        e, S, available = updated.innovation, updated.innovation_cov, updated.available
        if e is None or S is None or available is None:
            raise ValueError(
                f"{self.name} gives no covariance of its innovations, so that readings have no likelihood: return it "
                "from _update (Belief.updated does), or compare predictions with readings"
            )
        return log_density(e, S, available)

    # --- the same for whoever has checked what comes in -------------------------------------------

    def _advance(
        self, belief: Record, u: np.ndarray | None, y: np.ndarray, available: np.ndarray | None, rng: Rng
    ) -> Record:
        """`predict`, then `update`."""
        if self._compiles(rng) and self._regular and self._in_one_program(_BOTH, belief, u):
            updated, doubtful = self._executed(_BOTH, belief, u, y, available, rng=rng)
            if not doubtful.any() and (self._ours or proper(updated.cov)):
                return updated
        return self._corrected(self._predicted(belief, u, rng), y, available, None, rng)

    def _begin(
        self, prior: Gaussian, u: np.ndarray | None, y: np.ndarray, available: np.ndarray | None, rng: Rng
    ) -> Record:
        """`init`, then `update`, where ``u`` is the known input of the measurement."""
        return self._corrected(self._started(prior, rng, u), y, available, None, rng)

    def _compiles(self, rng: Rng) -> bool:
        """Are prediction and update programs? They draw no numbers from a Generator."""
        return self._programs is not None and not (self.random and isinstance(rng, np.random.Generator))

    def _in_one_program(self, methods: tuple[str, ...], belief: Belief, u: np.ndarray | None) -> bool:
        """Are two methods one program? Host callbacks of an update need the prediction."""
        if isinstance(self.model, LinearModel):
            return True
        assert self._programs is not None
        key = self._key(methods, belief.side_by_side()[1], u, None)
        if (traced := self._programs.get(key)) is not None:
            if all(each.unchanged() for each in traced.inspections):
                return True
            del self._programs[key]
        return len(self._inlined(belief, u)) == len(self._questions)

    @staticmethod
    def _key(methods: tuple[str, ...], layout: Layout, u: np.ndarray | None, R: np.ndarray | None) -> tuple[Any, ...]:
        """Of a program: what it is traced for."""
        return methods, id(layout), None if u is None else u.shape[-1], R is None

    def _predicted(self, belief: Record, u: np.ndarray | None, rng: Rng) -> Record:
        if self._compiles(rng):
            return self._executed(("_predict",), belief, u, rng=rng)[0]
        with np.errstate(all="ignore"):
            return self._predict(belief, u, rng)

    def _corrected(
        self, belief: Record, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None, rng: Rng
    ) -> Record:
        regular = self._regular
        if R is not None or regular is None:
            R = self._own_R(belief) if R is None and isinstance(self.model.R, StateNoise) else R
            regular = regular_noise(neutralised(*self._noise(y, available, R, belief.u)))
        if self._compiles(rng):
            updated, rows = self._executed(("_update",), belief, belief.u, y, available, R, rng)
        else:
            with np.errstate(all="ignore"):
                reading = self._reading(belief, y, available, R)
                updated = self._attempted(belief, reading, rng)
                if not self._ours:
                    updated = self._returned("_update", updated, belief.mean.shape[:-1])
                rows = doubtful_rows(updated, reading.R)
        doubtful = bool(rows.any())
        if regular and doubtful:
            rows = self._unsound(belief, updated, rows)
        if regular and not (doubtful and rows.any()) and (self._ours or proper(updated.cov)):
            return updated
        with np.errstate(all="ignore"):
            if not (regular and self._ours and self._alike):
                reading = self._reading(belief, y, available, R)
                return self._recovered(belief, updated, reading, y, rng, available, R)
            some, y, rng = belief[rows], y[rows], rng[rows] if isinstance(rng, Numbers) else rng
            available, R = (None if a is None else a[rows] for a in (available, R))
            reading = self._reading(some, y, available, R)
            return updated.with_rows(rows, self._recovered(some, updated[rows], reading, y, rng, available, R))

    def _attempted(self, belief: Record, reading: Reading, rng: Rng) -> Record:
        """`_update`; the mean is NaN in rows where that of somebody else stops at a singular matrix."""
        try:
            return self._update(belief, reading, rng)
        except np.linalg.LinAlgError:
            if self._ours:
                raise
        batch, n = belief.mean.shape[:-1], self.model.n
        S = congruence(reading.C, belief.cov) + reading.R if reading.C.shape[-1] == n else None
        failed = Belief.replace(
            belief, mean=np.full(belief.mean.shape, np.nan), innovation=reading.innovation, innovation_cov=S,
            available=reading.available,
        )  # fmt: skip
        if math.prod(batch) > 1:
            for row in np.eye(math.prod(batch), dtype=bool):
                row = row.reshape(batch)
                own = rng[row] if isinstance(rng, Numbers) else rng
                failed = failed.with_rows(row, self._attempted(belief[row], reading.of_rows(row), own))
        return failed

    def _unsound(self, belief: Record, updated: Record, rows: np.ndarray) -> np.ndarray:
        """Those of some rows ``(...)`` in which an update is not finite, or a covariance has a negative eigenvalue."""
        sound = finite_rows(updated)[rows]
        with np.errstate(all="ignore"):
            for cov in (belief.cov, *(getattr(updated, name, None) for name in COVARIANCES)):
                if cov is not None:
                    sound &= self._by_rows(positive_pivots, cov[rows])[..., 0] == cov.shape[-1]
        unsound = np.array(rows)
        unsound[rows] = ~sound
        return unsound

    # --- what a filter fills in -------------------------------------------------------------------

    def _init(self, belief: Belief, rng: Rng) -> Record:
        return cast(Record, belief)

    @abstractmethod
    def _predict(self, belief: Record, u: np.ndarray | None, rng: Rng) -> Record: ...

    @abstractmethod
    def _update(self, belief: Record, reading: Reading, rng: Rng) -> Record: ...

    # --- shared -----------------------------------------------------------------------------------

    def _asked(self, question: str, belief: Record, u: np.ndarray | None) -> Any:
        """A method's answer about a belief; a host callback where the model's function behind it is not traced."""
        if is_traced(belief.mean) and not isinstance(self.model, LinearModel):
            axes, program = _ANSWERS[question], cast(Any, belief.mean).program
            if question in program.inlined:
                return getattr(self, question)(belief, u)
            return program.callback(lambda belief, u, R: getattr(self, question)(belief, u), *axes)
        return getattr(self, question)(belief, u)

    def _inlined(self, belief: Belief, u: np.ndarray | None) -> frozenset[str]:
        """The model's functions that are traced with the methods which linearise them, by these methods' names.

        Others are host callbacks: a method that evaluates the model by itself, a function that cannot be traced.
        """
        found, model = [], self.model
        for question, method in self._questions.items():
            if isinstance(model, LinearModel):
                break
            names = getattr(getattr(type(self), method), "inlinable", ())
            if names and model.traceable(belief.mean, u, *names):
                found.append(question)
        return frozenset(found)

    def _moved(self, belief: Record, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Mean ``(..., n)`` and covariance ``(..., n, n)`` one step on, without process noise."""
        return self._propagate(belief.mean, belief.cov, u)

    def _executed(
        self, methods: tuple[str, ...], belief: Belief, u: np.ndarray | None, y: np.ndarray | None = None,
        available: np.ndarray | None = None, R: np.ndarray | None = None, rng: Rng = None,
    ) -> tuple[Record, np.ndarray]:  # fmt: skip
        """The compiled `_predict`, `_update` or both; and the mask ``(...)`` of the rows that are `_doubtful`."""
        packed, layout = belief.side_by_side()
        traced = self._program(methods, belief, layout, u, R)
        batch, own = packed.shape[:-1], in_rows(packed)
        keys, step = self._words(rng, batch) if self.random else (own, own)
        out, doubtful = np.empty((len(own), traced.layout.width)), np.empty((len(own), 1), bool)
        traced.function(
            len(own), 0, own, own if u is None else in_rows(u), own if y is None else in_rows(y),
            _all(len(own), self.model.p) if available is None else in_rows(available),
            in_rows(traced.results(belief, u, R, batch)) if traced.callbacks else own, keys, step, out, doubtful,
            threads=self._threads,
        )  # fmt: skip
        out = out if len(batch) == 1 else out.reshape(*batch, out.shape[-1])
        updated: Any = self.record.looked_at(out, traced.layout, belief.prior_mean, belief.prior_cov, u)
        if y is None:
            object.__setattr__(updated, "recovery", belief.recovery)
        return updated, doubtful.reshape(batch)

    def _program(
        self, methods: tuple[str, ...], belief: Belief, layout: Layout, u: np.ndarray | None, R: np.ndarray | None
    ) -> "_Traced":
        """The program of methods, traced where there is none yet or something that it reads has changed."""
        key = self._key(methods, layout, u, R)
        assert self._programs is not None
        traced = self._programs.get(key)
        # Of two methods `_in_one_program` has just asked.
        if traced is None or not (len(methods) == 2 or all(each.unchanged() for each in traced.inspections)):
            traced = self._programs[key] = self._traced(methods, belief, layout, u, R)
        return traced

    def _words(self, rng: Rng, batch: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Keys ``(rows, 2)`` and steps ``(rows, 1)`` of a filter that draws random numbers."""
        raise NotImplementedError

    def _repeated(
        self, belief: Record, u: np.ndarray | None, y: np.ndarray, available: np.ndarray
    ) -> tuple[list[Record], Record] | None:
        """Predictions of successive steps, and the last one's update, in one program; None where that cannot be.

        Args:
            belief: After the update before.
            u: ``(steps, rows, m)``,
            y: ``(steps, rows, p)``,
            available: and ``(steps, rows, p)`` of each step.
        """
        packed, layout = belief.side_by_side()
        now = None if u is None else u[0]
        if self._programs is None or not (self._ours and self._regular and self._in_one_program(_BOTH, belief, now)):
            return None
        traced = self._program(_SUCCESSIVE, belief, layout, now, None)
        if traced.layout is not layout or traced.predicted is None or traced.callbacks:
            return None
        steps, rows = y.shape[:2]
        updated, doubtful = np.empty((2, rows, layout.width)), np.empty((steps, rows, 1), bool)
        predicted = np.empty((steps, rows, traced.predicted.width))
        own = in_rows(packed)
        known = own if u is None else u
        traced.function(rows, steps, own, known, y, available, own, own, own, updated, doubtful, predicted)
        if doubtful.any():
            return None
        inputs: Any = (None,) * steps if u is None else u
        beliefs: list[Any] = [
            self.record.looked_at(values, place, belief.prior_mean, belief.prior_cov, given)
            for values, place, given in (
                *((each, traced.predicted, given) for each, given in zip(predicted, inputs, strict=True)),
                (updated[(steps - 1) % 2], layout, inputs[-1]),
            )
        ]
        object.__setattr__(beliefs[0], "recovery", belief.recovery)
        return beliefs[:-1], beliefs[-1]

    def _by_rows(self, formula: Callable[..., Any], *matrices: np.ndarray) -> Any:
        """A formula of matrices ``(..., n, m)``, compiled where the filter's own are.

        For what is computed between host callbacks; it gives vectors or matrices, one or a tuple of them.
        """
        if self._programs is None or is_traced(matrices[0]):
            return formula(*matrices)
        batch, sizes = matrices[0].shape[:-2], tuple(matrix.shape[-2:] for matrix in matrices)
        traced = self._programs.get((formula.__name__, sizes))
        if traced is None:
            traced = self._programs[formula.__name__, sizes] = _formula(formula, sizes)
        rows = [in_rows(matrix.reshape(*batch, math.prod(size))) for matrix, size in zip(matrices, sizes, strict=True)]
        out = np.empty((len(rows[0]), traced.layout.width))
        traced.function(len(out), 0, *rows, out, threads=self._threads)
        results = tuple(out[own].reshape(batch + shape) for own, shape in traced.layout.cuts.values())
        return results if len(results) > 1 else results[0]

    def _traced(
        self, methods: tuple[str, ...], belief: Belief, layout: Layout, u: np.ndarray | None, R: np.ndarray | None
    ) -> "_Traced":
        """The program of some of `_predict` and `_update`, for beliefs and a known input like these."""
        program, callbacks, column = Program(), [], 0
        words = (Argument((2 * self.random,), "u"), Argument((1 * self.random,), "i"))
        rng = Numbers(given(program, 5, words[0]), given(program, 6, words[1])[..., 0]) if self.random else None

        def callback(question: _Question, *axes: int) -> Any:
            nonlocal column
            with np.errstate(all="ignore"):
                values, again = (question(belief, u, R) for _ in range(2))
            pairs = zip(values, again, strict=True) if isinstance(values, tuple) else ((values, again),)
            if not all(one is None or np.array_equal(one, other, equal_nan=True) for one, other in pairs):
                raise ValueError(
                    "the model's functions gave two values for the same arguments: they must depend on these alone, "
                    "without random numbers, clocks or counters of their own"
                )
            results: list[Any] = []
            callbacks.append((question, axes))
            for value, k in zip(values if isinstance(values, tuple) else (values,), axes, strict=True):
                shape = () if value is None else value.shape[value.ndim - k :]
                results.append(None if value is None else matrix_input(program, 4, column, shape))
                column += 0 if value is None else math.prod(shape)
            return tuple(results) if len(axes) > 1 else results[0]

        program.callback, program.inlined, program.inspections = callback, self._inlined(belief, u), set()
        doubtful: Any = None
        try:
            fields: dict[str, Any] = dict.fromkeys(belief.__dataclass_fields__)
            for name, (first, shape) in layout.columns.items():
                value = matrix_input(program, 0, first, shape)
                if name in layout.masks:
                    value = value.as_type(True) if isinstance(value, MatrixTracer) else tracer.cast(value, "b")
                fields[name] = value.mT if name in MEMBERS else value
            known = None if u is None else matrix_input(program, 1, 0, u.shape[-1:])
            now: Any = type(belief)(**(fields | {"u": known}))
            if "_init" in methods:
                now = self._init(now, rng)
            if "_predict" in methods:
                predicted = now = self._sound(self._predict(now, known, rng), now)
            if "_update" in methods:
                p = (self.model.p,)
                y, mask = matrix_input(program, 2, 0, p), matrix_input(program, 3, 0, p, "b")
                told = None if R is None else callback(lambda belief, u, R: R, 2)
                reading = self._reading(now, y, mask, told)
                now = self._sound(self._update(now, reading, rng), now)
                if not self._ours:  # whose covariance may be symmetric but for rounding
                    now = Belief.replace(now, cov=symmetrise(now.cov))
                doubtful = doubtful_rows(now, reading.R)
            packed = [_packed(program, each) for each in ((now, predicted) if methods is _SUCCESSIVE else (now,))]
            mask = [] if doubtful is None else [doubtful.value]
        except Exception as error:
            if self._ours:
                raise
            raise TypeError(
                f"{type(self).__name__} says that it is formulas, but cannot be traced as such ({error}): write it in "
                f"the words of estimators.engine.matrices, or without formulas = True"
            ) from error
        if callbacks and program.inlined != self._inlined(belief, u):  # they have compared Jacobians of the user's
            return self._traced(methods, belief, layout, u, R)
        sizes = (layout.width, 0 if u is None else u.shape[-1], self.model.p, self.model.p, column)
        arguments = [*(Argument((size,), "b" if i == 3 else "f") for i, size in enumerate(sizes)), *words]
        outputs = [(parts, Argument((found.width,))) for found, parts in packed]
        outputs.insert(1, (mask, Argument((1,), "b")))
        function = Function(program, arguments, outputs, successive=methods is _SUCCESSIVE)
        layouts = [found for found, _ in packed]
        return _Traced(function, layouts[0], tuple(callbacks), column, tuple(program.inspections), layouts[-1])

    def _sound(self, traced: Any, before: Any) -> Record:
        """A belief that a formula of one's own gave, if its arrays have the shapes that they must have, a row."""
        n, p = self.model.n, self.model.p
        if self._ours:
            return cast(Record, traced)
        if not isinstance(traced, self.record):
            raise ValueError(f"it must return a {self.record.__name__}, not {type(traced).__name__}")
        fixed = {"mean": (n,), "cov": (n, n), "innovation": (p,), "innovation_cov": (p, p), "available": (p,)}
        for name, value in traced._arrays().items():
            had = getattr(before, name)
            if value is None or name in APART:
                continue
            shape = fixed.get(name, getattr(value if had is None else had, "shape", None))
            if not (is_traced(value) or isinstance(value, np.ndarray | np.generic)) or value.shape != shape:
                found = getattr(value, "shape", shown(value))
                raise ValueError(f"the {name} that it returns must have the shape {shape} a row, not {found}")
        return cast(Record, traced)

    def _reading(self, belief: Record, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None) -> Reading:
        """Innovation and measurement matrices, with missing channels neutralised."""
        model, u = self.model, belief.u
        expected, C, excess = self._asked("_linearise", belief, u)
        H = self._no_columns if model.H is None else resolve(model.H, u)
        R, mask = self._noise(y, available, R, u)
        reading = Reading(
            difference(y, expected, model.measurement_angles), C, H, R if excess is None else R + excess, mask,
            not is_traced(mask) and bool(mask.all()),
        )  # fmt: skip
        return reading if reading.complete else reading.only(mask)

    def _noise(
        self, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None, u: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """R ``(..., p, p)`` and the mask ``(..., p)`` of the readings that tell something."""
        mask = np.isfinite(y) if available is None else np.isfinite(y) & available
        if R is None and not callable(self.model.R):
            return self.model.R, mask
        R, known = usable(resolve(self.model.R, u) if R is None else R)
        return R, mask & known

    def _own_R(self, belief: Record) -> np.ndarray:
        """R ``(..., p, p)`` of readings that bring none of their own."""
        return noise_at(self.model.R, belief.mean, belief.u)

    @inlinable("measurement", "measurement_jacobian")
    def _linearise(self, belief: Record, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """The expected reading ``(..., p)``, C ``(..., p, n)``, and what is to be added to R for what C leaves out."""
        return *self.model.linearise_measurement(belief.mean, u, belief.cov), None

    @inlinable("transition", "transition_jacobian")
    def _propagate(self, mean: np.ndarray, cov: np.ndarray, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Mean ``(..., n)`` and covariance ``(..., n, n)`` one step on, without process noise."""
        mean, A = self.model.linearise_transition(mean, u, cov)
        return mean, congruence(A, cov)

    def _slopes(self, belief: Record, u: np.ndarray | None) -> np.ndarray:
        """A ``(..., n, n)``: how the next state follows the state, of which the belief is."""
        return self.model.linearise_transition(belief.mean, u, belief.cov)[1]

    # --- what came in, and what a filter gave back ------------------------------------------------

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
        return _broadcast("u", u, batch + u.shape[-1:]) if u.ndim else _broadcast("u", u, batch + (1,))

    def _check_known_input(self, u: np.ndarray | None) -> None:
        self.model.check_known_input(u)

    def _returned(self, method: str, belief: Record, batch: tuple[int, ...]) -> Record:
        """What a filter's own method returned, checked to be a belief of the right shape."""
        if not isinstance(belief, self.record):
            kinds = f"a belief of type {self.record.__name__}, got {type(belief).__name__}"
            raise TypeError(f"{type(self).__name__}.{method} must return {kinds}")
        n, mean, cov = self.model.n, getattr(belief.mean, "shape", None), getattr(belief.cov, "shape", None)
        if mean != batch + (n,) or cov != batch + (n, n):
            raise ValueError(
                f"{type(self).__name__}.{method} must return a mean of shape {batch + (n,)} and a cov of shape "
                f"{batch + (n, n)}, got {mean} and {cov}"
            )
        return belief if np.array_equal(belief.cov, belief.cov.mT) else Belief.replace(belief, cov=evened(belief.cov))

    # --- recovery: see estimators.recovery ----------------------------------------------------------

    def _recovered(
        self, belief: Record, updated: Record, reading: Reading, y: np.ndarray, rng: Rng,
        available: np.ndarray | None, R: np.ndarray | None,
    ) -> Record:  # fmt: skip
        """The update with every lost row replaced by the first rung of the ladder that holds."""
        return recovered(self, belief, updated, reading, y, rng, available, R)

    def _condensed(
        self, start: Record, reading: Reading, S: np.ndarray, lost: np.ndarray
    ) -> tuple[Reading, np.ndarray] | None:
        """The reading in the directions in which S is not singular, and the rows it is for; None: none will do."""
        return condensed(reading, S, lost, self._shown_input(start, reading))

    def _shown_input(self, belief: Record, reading: Reading) -> np.ndarray | None:
        """How an unknown input, in units of its prior, shows in the reading ``(..., p, k)``; None: there is none."""
        return None


_BOTH = "_predict", "_update"
_SUCCESSIVE = (*_BOTH, "again")


def check_channels(filter: Filter, channels: int) -> None:
    """Refuse a belief that holds something of another number of readings.

    Raises:
        ValueError: saying of how many.
    """
    if channels != filter.model.p:
        raise ValueError(
            f"the belief is of {channels} readings, the model has {filter.model.p}: {filter.name} needs all sensors in "
            "one model, with NaN for those that have not come"
        )


def in_rows(array: np.ndarray) -> np.ndarray:
    """The array ``(B, k)`` of one ``(..., k)``, as kernels need it."""
    if not (array.flags.c_contiguous and array.flags.aligned):
        array = np.array(array, order="C")
    return array if array.ndim == 2 else array.reshape(math.prod(array.shape[:-1]), array.shape[-1])


@cache
def _all(rows: int, readings: int) -> np.ndarray:
    """The mask of readings that have all arrived, made once."""
    return np.ones((rows, readings), bool)


_Question = Callable[[Any, Any, Any], Any]
_ANSWERS = {"_moved": (1, 2), "_linearise": (1, 2, 2), "_moving_G": (2,), "_moved_members": (2,), "_expected": (2,)}
"""Axes of what these methods say of a row."""


class _Traced(NamedTuple):
    """A program, the layout of its results, and the host callbacks whose results it needs."""

    function: Function
    layout: Layout
    callbacks: tuple[tuple[_Question, tuple[int, ...]], ...]
    columns: int  # of their results
    inspections: tuple[Inspection, ...] = ()  # of functions of others that are part of it
    predicted: Layout | None = None  # of predictions between the results, where it is for successive steps

    def results(self, belief: Belief, u: np.ndarray | None, R: np.ndarray | None, batch: tuple[int, ...]) -> np.ndarray:
        """What the callbacks give for a batch, side by side ``(..., columns)``."""
        out, first = np.empty(batch + (self.columns,)), 0
        with np.errstate(all="ignore"):
            given = [question(belief, u, R) for question, _ in self.callbacks]
        for values, (_, axes) in zip(given, self.callbacks, strict=True):
            for value, k in zip(values if isinstance(values, tuple) else (values,), axes, strict=True):
                if value is not None:
                    own = value.shape[value.ndim - k :]
                    flat = value.reshape(value.shape[: value.ndim - k] + (-1,))
                    out[..., first : first + math.prod(own)] = flat
                    first += math.prod(own)
        return out


def _packed(program: Program, belief: Any) -> tuple[Layout, list[Any]]:
    """The layout of a traced belief's arrays, and these as parts of an output."""
    results = belief.stored()
    masks = frozenset(name for name, value in results.items() if value.dtype == bool)
    found = laid_out(tuple((name, value.shape) for name, value in results.items()), masks)
    return found, [_part(program, value) for value in results.values()]


def _part(program: Program, value: Any) -> Any:
    """A result as a part of an output of floats."""
    value = matrix(program, value)
    return value.view if isinstance(value, MatrixTracer) else tracer.cast(value, "f").value


def _formula(formula: Callable[..., Any], sizes: tuple[tuple[int, int], ...]) -> _Traced:
    """The program of a formula of matrices of these sizes."""
    program = Program()
    results = formula(*(matrix_input(program, argument, 0, size) for argument, size in enumerate(sizes)))
    results = results if isinstance(results, tuple) else (results,)
    found = laid_out(tuple((str(i), result.shape) for i, result in enumerate(results)))
    parts = [_part(program, result) for result in results]
    arguments = [Argument((math.prod(size),)) for size in sizes]
    return _Traced(Function(program, arguments, [(parts, Argument((found.width,)))]), found, (), 0)


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
