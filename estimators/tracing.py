"""Programs of filters: `_predict` and `_update` traced for beliefs of one layout, and what runs them."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np

from estimators.belief import APART, MEMBERS, Belief, Layout, layout_of
from estimators.checks import short_repr
from estimators.engine import tracer
from estimators.engine.compiled import given
from estimators.engine.dependencies import Dependencies
from estimators.engine.function import Argument, Function
from estimators.engine.matrices import MatrixTracer, is_traced, matrix, matrix_input
from estimators.engine.program import Program
from estimators.linalg import symmetrise
from estimators.randomness import RandomKeys
from estimators.recovery import doubtful_rows

BOTH = "_predict", "_update"
SUCCESSIVE = ("_update", "_predict", "successive")
PREDICTIONS = ("_predict", "successive")
"""Methods of a program; those of successive steps are repeated, from one prediction to the next."""


class Callback(NamedTuple):
    """A host callback: what a program reads is evaluated before it runs."""

    question: Callable[[Any, Any, Any], Any]  # of belief, u and R
    axes: tuple[int, ...]  # of a row of each result

    def results(self, belief: Any, u: Any, R: Any) -> list[Any]:
        """Its results, one or more."""
        with np.errstate(all="ignore"):
            values = self.question(belief, u, R)
        return list(values) if isinstance(values, tuple) else [values]


class Traced(NamedTuple):
    """A program of a filter, and what it needs."""

    function: Function
    layout: Layout  # of its results
    callbacks: tuple[Callback, ...] = ()
    columns: int = 0  # of their results
    dependencies: Dependencies | None = None  # of functions of others that are part of it

    def current(self) -> bool:
        """Is everything that it was traced of as it was?"""
        return self.dependencies is None or self.dependencies.unchanged()

    def results(
        self, belief: Belief, u: np.ndarray | None, R: np.ndarray | None, batch: tuple[int, ...]
    ) -> np.ndarray:
        """Results of the callbacks for a batch, packed ``(..., columns)``."""
        out, first = np.empty(batch + (self.columns,)), 0
        answers = [(each.results(belief, u, R), each.axes) for each in self.callbacks]
        for values, axes in answers:
            for value, k in zip(values, axes, strict=True):
                if value is not None:
                    size = math.prod(value.shape[value.ndim - k :])
                    out[..., first : first + size] = value.reshape(
                        value.shape[: value.ndim - k] + (-1,)
                    )
                    first += size
        return out


class _Callbacks:
    """The callbacks of a program that is being traced for beliefs like one."""

    def __init__(self, program: Program, *example: Any) -> None:
        self.program, self.example, self.columns = program, example, 0
        self.each: list[Callback] = []

    def __call__(self, question: Callable[..., Any], *axes: int) -> Any:
        """Tracers of a question's results, with these axes a row."""
        callback = Callback(question, axes)
        values, again = (callback.results(*self.example) for _ in range(2))
        pairs = zip(values, again, strict=True)
        if not all(
            one is None or np.array_equal(one, other, equal_nan=True) for one, other in pairs
        ):
            raise ValueError(
                "the model's functions gave two values for the same arguments: they must depend on"
                " these alone, without random numbers, clocks or counters of their own"
            )
        self.each.append(callback)
        results: list[Any] = []
        for value, k in zip(values, axes, strict=True):
            shape = () if value is None else value.shape[value.ndim - k :]
            results.append(
                None if value is None else matrix_input(self.program, 4, self.columns, shape)
            )
            self.columns += 0 if value is None else math.prod(shape)
        return tuple(results) if len(axes) > 1 else results[0]


def traced(
    filter: Any,
    methods: tuple[str, ...],
    belief: Any,
    layout: Layout,
    u: np.ndarray | None,
    R: np.ndarray | None,
) -> Traced:
    """The program of a filter's `_predict`, `_update` or both, for beliefs, a known input and R like these.

    Raises:
        TypeError: where methods of one's own cannot be traced.
    """
    program = Program()
    callbacks = _Callbacks(program, belief, u, R)
    program.callback, program.inlined, program.inspections = (
        callbacks,
        filter._inlined(belief, u),
        set(),
    )
    words = Argument((2 * filter.random,), "u"), Argument((1 * filter.random,), "i")
    rng = (
        RandomKeys(given(program, 5, words[0]), given(program, 6, words[1])[..., 0])
        if filter.random
        else None
    )
    known = None if u is None else matrix_input(program, 1, 0, u.shape[-1:])
    p, doubtful, successive = filter.model.p, None, "successive" in methods
    before = (
        known if u is None or not successive else matrix_input(program, 7, 0, u.shape[-1:])
    )  # of the update
    try:
        now: Any = type(belief)(**(_inputs(program, belief, layout) | {"u": before}))
        first = now
        for method in methods:
            if method == "_init":
                now = filter._init(now, rng)
            elif method == "_predict":
                now = _checked(filter, filter._predict(now, known, rng), now)
            elif method == "_update":
                y, mask = matrix_input(program, 2, 0, (p,)), matrix_input(program, 3, 0, (p,), "b")
                own_R = None if R is None else callbacks(lambda belief, u, R: R, 2)
                measurement = filter._measurement(now, y, mask, own_R)
                now = _checked(filter, filter._update(now, measurement, rng), now)
                if not filter.verified:  # whose covariance may be symmetric but for rounding
                    now = Belief.replace(now, cov=symmetrise(now.cov))
                doubtful = cast(Any, doubtful_rows(now, measurement.R))
        results = now.stored()
        found, parts = _packed(program, results)
        if successive and found is layout:  # a row that waits stays as it is
            running = matrix_input(program, 8, 0, (1,), "b")
            masks = running[..., 0], running, running[..., None]  # of numbers, vectors and matrices
            kept = {
                name: np.where(masks[own.ndim], results[name], own)
                for name, own in first.stored().items()
            }
            parts, doubtful = (
                _packed(program, kept)[1],
                None if doubtful is None else doubtful & running[..., 0],
            )
        mask = [] if doubtful is None else [doubtful.value]
    except Exception as error:
        if filter.verified:
            raise
        raise TypeError(
            f"{type(filter).__name__} says that it is formulas, but cannot be traced as such"
            f" ({error}): write it in the words of estimators.engine.matrices, or without formulas"
            " = True"
        ) from error
    if callbacks.each and program.inlined != filter._inlined(
        belief, u
    ):  # they have compared Jacobians of the user's
        return traced(filter, methods, belief, layout, u, R)
    sizes = (layout.width, 0 if u is None else u.shape[-1], p, p, callbacks.columns)
    arguments = [
        *(Argument((size,), "b" if i == 3 else "f") for i, size in enumerate(sizes)),
        *words,
    ]
    arguments += [Argument(sizes[1:2]), Argument((1,), "b")] * successive
    outputs = [(parts, Argument((found.width,))), (mask, Argument((), "b"))]
    function = Function(program, arguments, outputs, successive and found is layout)
    others = [each.source for each in program.inspections]
    dependencies = Dependencies(*others) if others else None
    return Traced(function, found, tuple(callbacks.each), callbacks.columns, dependencies)


def _inputs(program: Program, belief: Any, layout: Layout) -> dict[str, Any]:
    """The fields of a belief as tracers of its packed row."""
    fields: dict[str, Any] = dict.fromkeys(belief.__dataclass_fields__)
    for name, ((_, columns), shape) in layout.fields.items():
        value = matrix_input(program, 0, columns.start, shape)
        if name in layout.masks:
            value = (
                value.as_type(True) if isinstance(value, MatrixTracer) else tracer.cast(value, "b")
            )
        fields[name] = value.mT if name in MEMBERS else value
    return fields


def _checked(filter: Any, result: Any, before: Any) -> Any:
    """The belief that a formula of one's own gave, if its arrays have the shapes that they must have, a row.

    Raises:
        ValueError: saying which has not.
    """
    if filter.verified:
        return result
    n, p = filter.model.n, filter.model.p
    if not isinstance(result, filter.record):
        raise ValueError(f"it must return a {filter.record.__name__}, not {type(result).__name__}")
    fixed = {
        "mean": (n,),
        "cov": (n, n),
        "innovation": (p,),
        "innovation_cov": (p, p),
        "available": (p,),
    }
    for name, value in result._arrays().items():
        had = getattr(before, name)
        if value is None or name in APART:
            continue
        shape = fixed.get(name, getattr(value if had is None else had, "shape", None))
        if (
            not (is_traced(value) or isinstance(value, np.ndarray | np.generic))
            or value.shape != shape
        ):
            found = getattr(value, "shape", short_repr(value))
            raise ValueError(
                f"the {name} that it returns must have the shape {shape} a row, not {found}"
            )
    return result


def _packed(program: Program, results: dict[str, Any]) -> tuple[Layout, list[Any]]:
    """The layout of a traced belief's arrays, and these as parts of an output of floats."""
    parts = [matrix(program, value) for value in results.values()]
    masks = frozenset(name for name, value in results.items() if value.dtype == bool)
    found = layout_of(tuple((name, value.shape) for name, value in results.items()), masks)
    return found, [
        part.view if isinstance(part, MatrixTracer) else tracer.cast(part, "f").value
        for part in parts
    ]
