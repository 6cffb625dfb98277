"""Base class of filters: `init`, `predict`, `update`, and the methods of a filter of one's own.

A filter is two functions of arrays, ``_predict`` and ``_update``. Before each, `Filter.propagate`
or `Filter.expect` evaluates the model. Filters decorated `@compiled` run as compiled programs,
which include the model's functions where these are compiled. All other filters run in NumPy.
"""

import copy
from abc import ABC, abstractmethod
from contextlib import suppress
from functools import lru_cache
from typing import Any, ClassVar, Generic, Self

import numpy as np
from numpy.typing import ArrayLike

from estimators.belief import Belief, Record, unmeasured
from estimators.checks import as_array, as_covariance, as_mask, broadcast, known_input, short_repr
from estimators.engine import invoker
from estimators.linalg import diagonal, lacks_rank, masked, semidefinite, semidefinite_form
from estimators.models import Gaussian, LinearModel, NonlinearModel
from estimators.randomness import RandomKeys
from estimators.stepping import in_numpy, in_program
from estimators.varying import StateNoise

Rng = RandomKeys | np.random.Generator | None
"""`RandomKeys` with a key a row, or a Generator for the whole batch; None for no random numbers."""
Model = LinearModel | NonlinearModel
Changes = dict[str, np.ndarray]
"""Arrays of a belief that a step changes, by name."""
Data = tuple[Any, ...]
"""Known input, measurement, mask, measurement covariance, random numbers; None if absent."""


class Filter(ABC, Generic[Record]):
    """Base of filters: immutable configuration, whose state is a `Belief`.

    A filter of your own defines ``_predict`` and ``_update``. Each returns a dictionary of the
    belief's arrays that change, for any leading axes. The filter runs in NumPy, or compiled if its
    class is decorated `@compiled`. If its beliefs have more fields than `Belief`, it sets
    ``record`` to their class and initialises these fields in ``_begin``.

    Args:
        model: A `LinearModel` or a `NonlinearModel`.

    Raises:
        TypeError: if ``model`` is neither.
    """

    name: str
    """The name by which `make` made the filter, else the class attribute ``name``."""
    record: type[Belief] = Belief
    """Class of the filter's beliefs."""
    input_delay: int | None = None
    """Delay of the unknown input's estimate in steps, 0 or 1; None if the filter estimates none."""
    random: ClassVar[bool] = False
    """True if the filter draws random numbers.

    Its methods then need ``rng``, which ``_predict`` and ``_update`` get as their last argument.
    """
    reversible: ClassVar[bool] = False
    """True if `smooth` can go back through the filter's steps.

    In a subclass that overrides ``_predict``, ``_update`` or ``propagate`` it is False unless set.
    """
    likelihood: ClassVar[str] = "approximate"
    """Kind of `log_likelihood`, which is "exact", "diffuse" or "approximate"."""
    compiled: ClassVar[bool] = False
    """True if the filter runs compiled; its attributes are then constants of the program."""
    tunable: ClassVar[dict[str, Any]] = {}
    """Options that can be tuned beside Q and R, and the range of each."""
    _by_rows = False
    varies_by_row: bool = True
    """True if `by_rows` serves; False if Q and R have entered other constants of the filter."""
    _axes: ClassVar[dict[str, tuple[int, ...]]] = {"predict": (1, 2, 2, 2), "update": (1, 2, 2, 2)}
    """Number of axes of a row of each array from `propagate` or `expect`; the last is G or H."""

    def __init__(self, model: Model) -> None:
        if not isinstance(model, LinearModel | NonlinearModel):
            raise TypeError(
                f"model must be a LinearModel or a NonlinearModel, got {type(model).__name__}"
            )
        self.model = model
        self._programs: dict[str, Any] = {}
        self.model_per_row = any(getattr(part, "ndim", 2) > 2 for part in vars(model).values())
        if self.model_per_row:  # a program has one model for all rows
            self.compiled = False  # type: ignore[misc]
        self._inside = {step: model.is_compiled(step) for step in ("predict", "update")}
        self._exact_channels = not callable(model.R) and lacks_rank(model.value("R")).any()
        # With exact channels an update is checked against its prediction.
        self._inside["step"] = not self._exact_channels and all(self._inside.values())

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        cls.name, cls.compiled = getattr(cls, "name", cls.__name__), False
        own = vars(cls).keys() & {"_predict", "_update", "propagate"}
        cls.reversible = vars(cls).get("reversible", cls.reversible and not own)

    def __setattr__(self, name: str, value: Any) -> None:
        if type(self).compiled and name in self.__dict__ and name != "name":
            raise AttributeError(
                f"{name} of a filter is read-only: build another filter, such as"
                f" make({self.name!r}, model, {name}=...)"
            )
        object.__setattr__(self, name, value)

    def __getstate__(self) -> dict[str, Any]:
        """The attributes without the compiled programs, which are traced again when needed."""
        return self.__dict__ | {"_programs": {}}

    def __repr__(self) -> str:
        return f"{type(self).__name__}(n={self.model.n}, p={self.model.p}, q={self.model.q})"

    # --- what a filter fills in -------------------------------------------------------------------

    @abstractmethod
    def _predict(self, belief: Record, u: Any, *moved: Any, **named: Any) -> Changes:
        """Arrays that a prediction changes, by name.

        Args:
            belief: The belief before the step.
            u: ``(..., m)`` known input, or None.
            *moved: Arrays from `propagate`: mean ``(..., n)``, A ``(..., n, n)`` and Q. Then G if
                the filter estimates an input, and ``rng`` if it draws random numbers.
            **named: None; type checkers then accept methods that name the arrays.
        """

    @abstractmethod
    def _update(
        self, belief: Record, u: Any, e: Any, C: Any, R: Any, available: Any, *more: Any,
        **named: Any,
    ) -> Changes:  # fmt: skip
        """Arrays that a measurement changes, by name.

        ``innovation``, ``innovation_cov`` and ``available`` are filled in if absent.
        Missing measurements have e = 0, zero rows of C and a unit, uncorrelated variance in R, so
        that formulas need no special case.

        Args:
            belief: The prediction.
            u: ``(..., m)`` known input, or None.
            e: ``(..., p)`` innovation.
            C: ``(..., p, n)`` measurement matrix, or Jacobian of h.
            R: ``(..., p, p)`` measurement covariance.
            available: ``(..., p)`` mask.
            *more: H if the filter estimates an input, then ``rng`` if it draws random numbers.
            **named: None, as in `_predict`.
        """

    def _begin(self, mean: np.ndarray, cov: np.ndarray, rng: Rng) -> Changes:
        """Initial arrays of the fields that ``record`` adds to `Belief`."""
        return {}

    def propagate(self, belief: Any, u: np.ndarray | None) -> tuple[Any, ...]:
        """Next mean ``(..., n)``, Jacobian A, and Q."""
        mean, A = self.model.linearise_transition(belief.mean, u, belief.cov)
        return mean, A, self._process_noise(belief, u)

    def expect(self, belief: Any, u: np.ndarray | None, R: Any = None) -> tuple[Any, ...]:
        """Expected measurement, C, and R: the argument, or the model's if it is None."""
        y, C = self.model.linearise_measurement(belief.mean, u, belief.cov)
        return y, C, self._noise(belief, u, R)

    def _noise(self, belief: Record, u: np.ndarray | None, R: Any) -> Any:
        """R ``(..., p, p)``: the one that is given, or the model's."""
        if R is not None:
            return R
        state = (belief.mean,) if isinstance(self.model.R, StateNoise) else ()
        R, p = self.model.value("R", *state, u), self.model.p
        if belief.parameters is None:
            return R
        scale = np.sqrt(belief.parameters[..., 1 : 1 + p])
        return scale[..., :, None] * scale[..., None, :] * R

    def _process_noise(self, belief: Record, u: np.ndarray | None) -> Any:
        """Q ``(..., n, n)``."""
        Q = self.model.value("Q", u)
        return Q if belief.parameters is None else belief.parameters[..., 0, None, None] * Q

    def _option(self, name: str, belief: Record) -> Any:
        """Value of an option in ``tunable``: a number, or ``(..., 1)`` if rows have their own."""
        if belief.parameters is None:
            return getattr(self, name)
        place = 1 + self.model.p + [*self.tunable].index(name)
        return belief.parameters[..., place, None]

    def by_rows(self) -> Self:
        """A copy of the filter whose beliefs hold ``parameters (..., 1 + p + k)`` for each row.

        They are a factor on Q, a factor on R for each measurement, and the values of the k options
        in ``tunable``. `init` takes those of this filter; `Belief.replace` sets others.
        """
        other = copy.copy(self)
        object.__setattr__(other, "_by_rows", True)
        return other

    # --- the contract -----------------------------------------------------------------------------

    def init(self, prior: Gaussian, rng: Rng = None) -> Record:
        """The belief before any measurement: ``x(0|-1)``.

        Args:
            prior: Mean ``(..., n)`` and covariance ``(..., n, n)``; leading axes are the batch.
            rng: For filters that draw members: `RandomKeys` of this step, or a Generator.

        Raises:
            TypeError: if the prior is not a `Gaussian`.
            ValueError: if the prior does not have n states.
        """
        if not isinstance(prior, Gaussian):
            raise TypeError(f"prior must be a Gaussian(mean, cov), got {type(prior).__name__}")
        if (n := prior.mean.shape[-1]) != self.model.n:
            raise ValueError(f"the prior is for {n} states, the model has {self.model.n}")
        batch = np.broadcast_shapes(prior.mean.shape[:-1], prior.cov.shape[:-2])
        mean = np.broadcast_to(prior.mean, (*batch, n)).copy()
        cov = np.broadcast_to(prior.cov, (*batch, n, n)).copy()
        every = {"mean": mean, "cov": cov, "healthy": np.ones(batch, bool)}
        every |= unmeasured(batch, self.model.p)
        every |= self._begin(mean, cov, self._numbers(rng, batch))
        if self._by_rows:
            own = [1.0] * (1 + self.model.p) + [getattr(self, name) for name in self.tunable]
            every["parameters"] = np.broadcast_to(own, (*batch, len(own))).copy()
        belief: Any = self.record.of(every)
        if self.compiled:
            invoker()  # loads LLVM now, and not in the first step
        return belief.read_only()

    def predict(self, belief: Record, u: ArrayLike | None = None, rng: Rng = None) -> Record:
        """One step ahead: ``x(k-1|k-1)`` to ``x(k|k-1)``.

        A row whose result is not finite is computed again, or keeps its values, as in `update`.

        Args:
            belief: The belief after the last update.
            u: Known input ``(..., m)`` over the step.
            rng: For filters that draw: `RandomKeys` of this step, or a Generator.

        Raises:
            TypeError: if ``belief`` is not an instance of ``record``.
            ValueError: if ``u`` has the wrong shape, is given though the model does not use it, or
                is missing though the model has B.
        """
        batch = self._batch(belief)
        u = known_input(u, batch)
        self.model.check_known_input(u)
        return self._run("predict", belief, (u, None, None, None, self._numbers(rng, batch)))

    def update(
        self, belief: Record, y: ArrayLike, rng: Rng = None, available: ArrayLike | None = None,
        R: ArrayLike | None = None, u: ArrayLike | None = None,
    ) -> Record:  # fmt: skip
        """Take in a measurement: ``x(k|k-1)`` to ``x(k|k)``.

        Numerical trouble raises no error. A row whose result is not finite, or whose covariance is
        not positive semidefinite, is computed again with pseudo-inverses and without channels that
        are not finite. If this result is not finite either, the row keeps its values. In both cases
        ``healthy`` is False.

        Args:
            belief: The predicted belief.
            y: Measurements ``(..., p)``; a value that is not finite counts as missing.
            rng: For filters that draw: `RandomKeys` of this step, or a Generator.
            available: Mask ``(..., p)`` of the measurements that arrived; None: all.
            R: Measurement covariance ``(..., p, p)`` for this measurement only; None: the model's.
                A measurement whose variance is not finite counts as missing. Entries of R for
                missing measurements are ignored.
            u: Known input ``(..., m)`` for a model whose measurement depends on it; None: that of
                the last prediction.

        Raises:
            TypeError: if ``belief`` is not an instance of ``record``.
            ValueError: if ``y``, ``available``, ``R`` or ``u`` have the wrong shape, R is not a
                covariance, or the filter estimates an unknown input and has already had a
                measurement of this step.
        """
        batch, p = self._batch(belief), self.model.p
        y = broadcast("y", as_array("y", y), (*batch, p))
        mask = _all(batch, p) if available is None else as_mask("available", available)
        available = broadcast("available", mask, (*batch, p))
        if R is not None:
            R = broadcast("R", as_array("R", R), (*batch, p, p), core=2)
            arrived = np.isfinite(y) & np.isfinite(diagonal(R))
            as_covariance("R", masked(R, arrived & available))
        u = belief.u if u is None else known_input(u, batch)
        if self.input_delay is not None and self._was_updated(belief):
            raise ValueError(
                f"{self.name} takes one update a step: join the measurements, NaN or masked where"
                " none came"
            )
        return self._run("update", belief, (u, y, available, R, self._numbers(rng, batch)))

    def step(
        self, belief: Record, y: np.ndarray, u: np.ndarray | None = None, rng: Rng = None,
        available: np.ndarray | None = None,
    ) -> Record:  # fmt: skip
        """`predict` and then `update`, without checks of the arguments, for fast loops.

        Both run as one program where filter and model are compiled. The arguments are as for
        `predict` and `update`, with a row for each row of the belief.
        """
        if available is None:
            available = _all(belief.mean.shape[:-1], self.model.p)
        if self.joins_steps():
            return self._run("step", belief, (u, y, available, None, rng))
        belief = self._run("predict", belief, (u, None, None, None, rng))
        return self._run("update", belief, (u, y, available, None, rng))

    def joins_steps(self) -> bool:
        """Are a prediction and its update one program? Filter and model are then compiled."""
        return self.compiled and self._inside["step"]

    def log_likelihood(self, predicted: Record, updated: Record) -> np.ndarray:
        """The log density ``(...)`` of a measurement, given those before it; 0 where none came.

        A channel that the preceding channels determine without noise adds nothing, or minus
        infinity if it contradicts them. If a linear combination of uncertain states is known
        exactly, its computed variance is a rounding error and the density has no meaning. Make the
        combination a state instead.

        Args:
            predicted: The belief before the measurement.
            updated: The belief that `update` returned.
        """
        S, mean, u = updated.innovation_cov, predicted.mean, updated.u
        size = np.abs(mean).max(-1, keepdims=True)
        if (np.sqrt(diagonal(S)) <= 1e-8 * size).any():
            # Size of the states in each channel, of which rounding is a share.
            C = self.model.linearise_measurement(mean, u, predicted.cov)[1]
            size = np.abs(mean)
            with suppress(TypeError):  # before the first step there may be no known input
                size = size + np.matvec(np.abs(self._slopes(predicted, u)), size)
            size = np.matvec(np.abs(C), size)
        square, logs, independent = semidefinite_form(updated.innovation, S, size)
        counted = (independent & updated.available).sum(-1)
        return -0.5 * (square + counted * np.log(2.0 * np.pi)) - logs

    # --- one step ---------------------------------------------------------------------------------

    def _run(self, step: str, belief: Record, data: Data) -> Record:
        """The belief after a prediction, an update, or both; lost rows are recovered."""
        u, y, *_, rng = data
        plain = not self.compiled or isinstance(rng, np.random.Generator)
        changed = (in_numpy if plain else in_program)(self, step, belief, data)
        if y is None:
            changed |= unmeasured(belief.healthy.shape, self.model.p)
        changed["u"] = u
        after = belief.replaced(changed)
        if plain:
            after.read_only()
        if b"\0" in after.healthy.tobytes():
            from estimators.recovery import recovered  # late: few rows are ever lost

            after = recovered(self, step, belief, after, data).read_only()
        if step == "update" and b"\0" in belief.healthy.tobytes():
            healthy = np.logical_and(after.healthy, belief.healthy)
            after = after.replaced({"healthy": healthy}).read_only()
        return after

    def _was_updated(self, belief: Any) -> bool:
        """Has this step had an update that estimates the unknown input?"""
        return bool(np.count_nonzero(belief.available))

    def _repaired(self, step: str, belief: Record, data: Data) -> Record:
        """The belief from which lost rows are computed again."""
        return belief.replaced({"cov": semidefinite(belief.cov)})

    def _slopes(self, belief: Record, u: np.ndarray | None) -> np.ndarray:
        """A ``(..., n, n)``: the Jacobian of the next state at the belief."""
        return self.model.linearise_transition(belief.mean, u, belief.cov)[1]

    # --- arguments --------------------------------------------------------------------------------

    def _batch(self, belief: Record) -> tuple[int, ...]:
        """The leading axes of a belief, which is checked to fit this filter and its model."""
        if not isinstance(belief, self.record):
            kinds = f"of type {self.record.__name__}, got {type(belief).__name__}"
            raise TypeError(f"belief must be {kinds}: begin with init(prior)")
        *batch, n = belief.mean.shape
        if n != self.model.n:
            raise ValueError(f"the belief is for {n} states, the model has {self.model.n}")
        return tuple(batch)

    def _numbers(self, rng: Rng, batch: tuple[int, ...]) -> Rng:
        """Random numbers of a step: a key for every row, or a Generator; None if none are drawn."""
        if not self.random:
            return None
        if not isinstance(rng, RandomKeys | np.random.Generator):
            raise TypeError(
                f"{self.name} draws random numbers: pass rng, keys (estimators.RandomKeys) or a"
                f" numpy Generator, got {short_repr(rng)}"
            )
        if isinstance(rng, RandomKeys) and rng.keys.shape[:-1] != batch:
            raise ValueError(f"rng has keys for rows {rng.keys.shape[:-1]}, expected {batch}")
        return rng


@lru_cache(64)
def _all(batch: tuple[int, ...], p: int) -> np.ndarray:
    """The mask of measurements that have all arrived, cached."""
    return ~np.zeros((*batch, p), bool)
