"""Functions that are not ours: may they run traced, so that nobody notices but by the clock?

A function may if it reads nothing that changes unseen (`estimators.engine.dependencies`), if each
row of a batch is computed as a row alone is, instruction by instruction, and if it gives what NumPy
gives, for its own rows and for others around them.
"""

import linecache
import logging
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from estimators import checks
from estimators.engine.arrays import TracedArray, entries
from estimators.engine.compiled import given, output
from estimators.engine.creation import traced_creation
from estimators.engine.dependencies import Dependencies
from estimators.engine.function import FEW, Argument, Function
from estimators.engine.interpret import interpret
from estimators.engine.matching import in_memory, kind_of
from estimators.engine.program import Program
from estimators.engine.tracer import NotTraceable

_log = logging.getLogger(__name__)
_LONGEST = 20_000  # values of a program; LLVM needs a second for as many
_OWN = 64  # rows of the samples that are compared
_DRAWS = 3
_PERTURBATION = (
    2.0**-50
)  # 4 units in the last place of each result: own and NumPy's elementary functions err by 2


class Inspection:
    """A user's function: may it run traced, and its program.

    Attributes:
        traceable: Does the program give what NumPy gives?
        reason: Else one sentence with the line of the function, and what to do about it.
        function: The program for rows of the samples' shapes,
        several: and whether it gives several results.
    """

    def __init__(
        self, reason: str = "", function: Function | None = None, several: bool = False
    ) -> None:
        self.reason, self.traceable = reason, function is not None
        self.function, self.several = function, several
        self.source: Callable[..., Any] = lambda *_: None
        self.dependencies: Dependencies | None = None

    def unchanged(self) -> bool:
        """Is everything that the function reads as it was when it was traced? In about a microsecond."""
        return self.dependencies is not None and self.dependencies.unchanged()

    def inline(self, *tracers: Any) -> Any:
        """The function, traced once more as a part of another program."""
        with traced_creation():
            return self.source(*tracers)

    def __call__(self, *arrays: Any) -> Any:
        """The function's results for arrays (none of them None), computed by its program."""
        if self.function is None:
            raise NotTraceable(self.reason)
        results = self.function.compute([each for each in arrays if each is not None])
        return tuple(results) if self.several else results[0]


def inspect(
    function: Callable[..., Any], *samples: Any, axes: Sequence[int] | None = None
) -> Inspection:
    """Find out whether a function of arrays ``(..., n)`` may run traced. It is called several times.

    Args:
        function: Anybody's.
        samples: Arguments as it gets them. One without a batch's axes beside others that have them
            is for all rows.
        axes: How many last axes of each are a row's; None: 1, or 0 of numbers.
    """
    chosen = [min(1, np.ndim(each)) for each in samples] if axes is None else list(axes)
    try:
        with _quiet():
            return _inspected(function, samples, chosen)
    except NotTraceable as error:
        return Inspection(f"{error}{_place(error)}")
    except checks.Written as error:
        return Inspection(f"{error}{_place(error.__cause__)}")
    except (Exception, SystemExit) as error:
        if isinstance(
            error.__cause__, NotTraceable
        ):  # NumPy says that it was no number, and not why
            return Inspection(f"{error.__cause__}{_place(error)}")
        found = error.__cause__ if isinstance(error, TypeError) and error.__cause__ else error
        text = " ".join(str(found).split())
        return Inspection(f"it raises {type(found).__name__}: {text[:300]}{_place(found)}")


inspections: dict[Any, Inspection] = {}
_KEPT = 1_000
"""Functions whose inspections are kept; of more, the oldest are inspected anew when they are next used."""


def inspection_of(
    key: tuple[Any, ...], function: Callable[..., Any], *samples: Any, axes: Any = None
) -> Inspection:
    """The inspection of a function, kept under a key until something that it reads is another.

    Args:
        key: The function as its user has it, for the log, and what else tells the inspection from
            others.
        function: Of arrays.
        samples: As for `inspect`,
        axes: likewise.
    """
    try:
        found = inspections.get(key)
    except TypeError:  # it can be no key
        return Inspection("nothing tells it from other functions")
    if found is None or (found.traceable and not found.unchanged()):
        if key not in inspections and len(inspections) >= _KEPT:
            del inspections[next(iter(inspections))]
        found = inspections[key] = inspect(function, *samples, axes=axes)
        if not found.traceable:
            _log.info(
                "%s runs in NumPy: %s", getattr(key[0], "__qualname__", "a function"), found.reason
            )
    return found


def _inspected(function: Callable[..., Any], given: Sequence[Any], axes: list[int]) -> Inspection:
    samples = [np.asarray(each) for each in given]
    dependencies = Dependencies(function)
    arguments = [(a[:_OWN] if a.ndim > k else a).copy() for a, k in zip(samples, axes, strict=True)]
    batched = _batched(given, axes)
    own = _called(function, arguments)
    for each in own:
        if each.dtype.kind not in "fiub":
            raise NotTraceable(
                f"it gives {checks.short_repr(each[()])}, and not arrays of real numbers or masks"
            )
    if not dependencies.unchanged():  # what is computed once and kept
        dependencies = Dependencies(function)
    again = _called(function, arguments)
    _check_unchanged(dependencies)
    if [(a.shape, a.dtype, a.tobytes()) for a in own] != [
        (a.shape, a.dtype, a.tobytes()) for a in again
    ]:
        raise NotTraceable(
            "it gives another result for the same arguments: let random numbers be an argument"
        )
    around = _nudged(arguments, axes, batched)
    cases, failure = [(arguments, own)], None
    for rows in (slice(None), slice(0, 1), -1):
        few = [each[rows] if has else each for each, has in zip(around, batched, strict=True)]
        try:
            cases.append((few, _called(function, few)))
        except (
            Exception
        ) as error:  # tracing may say better why; and it need not be a function of a row alone
            failure = failure or (error if rows == slice(None) else None)
    _check_unchanged(dependencies)
    shapes = [
        Argument(a.shape[a.ndim - k :], kind_of(in_memory(a)))
        for a, k in zip(samples, axes, strict=True)
    ]
    traced, several = _trace_rows(function, shapes, batched)
    _check_unchanged(dependencies)
    if failure is not None:
        raise failure
    for compared, expected in cases:
        _compare(traced, compared, batched, expected)
    inspection = Inspection(function=traced, several=several)
    inspection.source, inspection.dependencies = function, dependencies
    return inspection


def _check_unchanged(dependencies: Dependencies) -> None:
    if not dependencies.unchanged():
        raise NotTraceable(
            "it changes something that it reads, and is another function at its next call"
        )


def _batched(samples: Sequence[Any], axes: Sequence[int]) -> list[bool]:
    """Mask of the arguments with an axis for the batch: those with any axis, else all but Python's numbers."""
    own = [np.ndim(sample) > k for sample, k in zip(samples, axes, strict=True)]
    return own if any(own) else [type(sample) not in (int, float, bool) for sample in samples]


def _called(function: Callable[..., Any], arguments: Sequence[np.ndarray]) -> list[np.ndarray]:
    """A function's results in NumPy, for arrays that it can only read."""
    results = checks.call(
        "it", function, *(each.copy() if each.ndim else each[()] for each in arguments)
    )
    return [
        np.array(each) for each in (results if isinstance(results, tuple | list) else [results])
    ]


# --- a row in a batch -----------------------------------------------------------------------------


class _Limited(Program):
    """A program without loops, of a length that can be compiled."""

    loops = False

    def new(self, kind: str, size: int | None = None) -> int:
        if len(self.kinds) > _LONGEST:
            raise NotTraceable(
                "its loops are too long to be unrolled: use NumPy's functions of arrays"
            )
        return super().new(kind, size)

    def repeat(
        self, count: int, body: Callable[..., Sequence[int]], initial: Sequence[int], masks: int = 0
    ) -> tuple[int, ...]:
        """The passes one after the other: a loop of a batch would carry the numbers of all rows at once."""
        values = tuple(initial)
        for _ in range(count):
            values = tuple(body(*values))
        return values


def _trace_rows(
    function: Callable[..., Any], rows: Sequence[Argument], batched: Sequence[bool]
) -> tuple[Function, bool]:
    """The function traced for one row, once it is certain that rows of a batch are computed likewise."""
    program, sizes = _Limited(), {size for row in rows for size in row.shape}
    count = next(
        count for count in range(2, 99) if count not in sizes
    )  # another number than any axis has
    alone = [given(program, i, row) for i, row in enumerate(rows)]
    batch = [
        np.stack([given(program, i, row, at=(at,)).view(np.ndarray) for at in range(count)]).view(TracedArray)
        if has else alone[i]
        for i, (row, has) in enumerate(zip(rows, batched, strict=True))
    ]  # fmt: skip
    with traced_creation():
        one, many = function(*alone), function(*batch)
    several = isinstance(one, tuple | list)
    own, together = (
        list(each) if isinstance(each, tuple | list) else [each] for each in (one, many)
    )
    if len(together) != len(own):
        raise NotTraceable("it gives other results for a batch than for a row")
    outputs = [output(program, each) for each in own]
    _compare_rows(program, own, together, count)
    return Function(program, rows, outputs), several


def _compare_rows(
    program: Program, alone: Sequence[Any], together: Sequence[Any], count: int
) -> None:
    """Refuse a function whose rows in a batch have other instructions than a row alone.

    A row's instructions are repeated with the inputs of the row alone in the place of its own: as
    the program knows equal instructions, they are those of the row alone or new ones.
    """
    expected = [each.value for result in alone for each in entries(result, program)]
    found = []
    for one, many in zip(alone, together, strict=True):
        shape, own = np.shape(np.asarray(one, object)), np.asarray(many, object)
        try:
            found.append(np.broadcast_to(own.view(np.ndarray), (count, *shape)).reshape(count, -1))
        except ValueError:
            raise NotTraceable(
                f"for {count} rows it gives an array of shape {own.shape}, and of shape {shape} for"
                " one: index and sum from behind, as x[..., i] and x.sum(-1)"
            ) from None
    for at in range(count):
        outputs = [each.value for part in found for each in entries(part[at], program)]
        renamed: dict[int, int] = {}
        for each in program.live(outputs):
            own_input = each.opcode == "input" and each.attributes[2:] == (at,)
            program.copy(
                each._replace(attributes=each.attributes[:2]) if own_input else each, renamed
            )
        if [renamed.get(value, value) for value in outputs] != expected:
            raise NotTraceable("its rows in a batch depend on each other, or are computed otherwise than a row alone: "
                               "index and sum from behind, as x[..., i] and x.sum(-1)")  # fmt: skip


# --- values ---------------------------------------------------------------------------------------


def _nudged(
    arguments: Sequence[np.ndarray], axes: Sequence[int], batched: Sequence[bool]
) -> list[np.ndarray]:
    """A batch of rows around the first one of samples, near and far; whole numbers and masks move by little."""
    rng, found = np.random.default_rng(0), []
    sizes = {n for a, k in zip(arguments, axes, strict=True) for n in a.shape[a.ndim - k :]}
    count = next(n for n in range(11, 99) if n not in sizes)
    for array, k, has in zip(arguments, axes, batched, strict=True):
        leading = array.shape[: array.ndim - k]
        if not has or 0 in leading:
            found.append(array)
            continue
        many = np.repeat(array[(0,) * len(leading)][None], count, 0)
        distance = 10.0 ** np.linspace(-6.0, 2.0, count).reshape((count,) + (1,) * k)
        if array.dtype.kind == "f":
            many = (
                many * (1.0 + distance * rng.normal(size=many.shape))
                + distance * rng.normal(size=many.shape)
            ).astype(array.dtype)
        elif array.dtype.kind == "b":
            many = many ^ (rng.random(many.shape) < 0.3)
        else:
            many = many + rng.integers(0, 2, many.shape).astype(array.dtype)
        found.append(many)
    return found


def _compare(
    function: Function, arguments: Sequence[np.ndarray], batched: Sequence[bool], expected: Any
) -> None:
    """Refuse a program that gives other results than NumPy.

    Both round differently: elementary functions and sums in another order. How much that may matter
    is measured, by Monte Carlo arithmetic (Parker, 1997): the program is run with every rounded
    result off by up to 4 units in the last place, and NumPy's may differ by 8 times as much as
    those of such runs do, and by 4 units in the last place.
    """
    arrays = list(map(in_memory, arguments))
    copies = [
        np.stack([each] * FEW) if has else each for each, has in zip(arrays, batched, strict=True)
    ]
    found = [
        each[0] if any(batched) else each for each in function.compute(copies)
    ]  # compiled once, for many rows
    rng = np.random.default_rng(0)
    runs = [interpret(function, arrays, _PERTURBATION, rng) for _ in range(_DRAWS)]
    for i, (own, numpy) in enumerate(zip(found, expected, strict=True)):
        compare(own, numpy, [run[i] for run in runs])


def compare(own: np.ndarray, numpy: np.ndarray, runs: Sequence[np.ndarray]) -> None:
    """Refuse results that are not NumPy's, but for rounding as it shows in such runs."""
    kinds = own.dtype.kind.replace("u", "i"), numpy.dtype.kind.replace("u", "i")
    if kinds[0] != kinds[1]:
        raise NotTraceable(
            f"it gives numbers of type {numpy.dtype} in NumPy, and {own.dtype} when it is traced"
        )
    if numpy.dtype.kind == "f" and numpy.dtype != float:
        raise NotTraceable(f"it computes in {numpy.dtype}: a traced function computes in float64")
    try:
        numpy = np.broadcast_to(numpy, own.shape)
    except ValueError:
        raise NotTraceable(
            f"it gives shape {numpy.shape} in NumPy, and {own.shape} when it is traced"
        ) from None
    spread = np.max([_distance(run, own) for run in runs], axis=0)
    allowed = 8.0 * spread + (
        4.0 * np.spacing(np.abs(own)) if own.dtype.kind == "f" and spread.any() else 0.0
    )
    apart = ~(_distance(numpy, own) <= np.where(np.isnan(allowed), 0.0, allowed))
    if apart.any():
        one, other = numpy[apart].flat[0], own[apart].flat[0]
        raise NotTraceable(f"it gives {one!r} in NumPy where it gives {other!r} when it is traced")


def _distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance of numbers: infinite if one of them is NaN or infinite and the other is not."""
    equal = (a == b) | ((a != a) & (b != b))
    return np.where(equal, 0.0, np.nan_to_num(np.abs(a * 1.0 - b * 1.0), nan=np.inf, posinf=np.inf))


# --- sentences ------------------------------------------------------------------------------------


@contextmanager
def _quiet() -> Iterator[None]:
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _place(error: BaseException | None) -> str:
    """The last line of somebody else's code on the way to an error."""
    found = ""
    step = error.__traceback__ if error else None
    while step is not None:
        code = step.tb_frame.f_code
        module = str(step.tb_frame.f_globals.get("__name__", ""))
        if not module.startswith(("estimators.engine", "numpy.", "scipy.")):
            line = linecache.getline(code.co_filename, step.tb_lineno).strip()[:100]
            found = (
                f" (line {step.tb_lineno} of"
                f" {code.co_filename.rpartition('/')[2]}{': ' if line else ''}{line})"
            )
        step = step.tb_next
    return found
