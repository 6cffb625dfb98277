"""Vehicles in time: the method of Runge and Kutta of fourth order, written once for all equations of motion.

A vehicle states its rates for one state, ``rates(s, control, flow, c) -> tuple``: ``s`` is its own state, ``control``
its actuators at that moment, ``flow`` the current or the wind, all of them tuples of numbers, and ``c (k,)`` its
coefficients. Over a step the flow is constant, and actuators move linearly, so that their rate limits are integrated
exactly.

`kernels` makes what a vehicle needs of its rates. The compiler has to know how long the tuples are: blank ones tell it.
"""

from collections.abc import Callable
from functools import wraps
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from numba.core.errors import TypingError
from numba.extending import overload

from estimators.compiled import gufunc, inlined, part, rowwise

Numbers = tuple[float, ...]
Rates = Callable[[Numbers, Numbers, Numbers, np.ndarray], Numbers]
Kernel = Callable[..., np.ndarray]

_LANES = 16  # rows side by side, at most: a number that the compiler knows, to see that they are independent


class Kernels(NamedTuple):
    """The compiled equations of motion of a vehicle."""

    rates: Kernel
    """State ``(n,)``, actuators, flow and coefficients to the rates of the state: a generalised ufunc."""
    step: Kernel
    """State, actuators before and after, flow, coefficients, seconds and substeps to the state after (`_for_all`)."""
    forced: Callable[..., None]
    """Likewise for rows of each, kicked at the end: state, actuators before, after, forcing ``(B, kicks + f)``,
    coefficients, seconds, substeps, which component each kick is added to ``(kicks,)``, and where the states after go.
    """
    sloped: Callable[..., None]
    """Likewise for rows that nothing kicks: states, actuators before, after, flow, coefficients, seconds, substeps,
    which numbers of state and flow ``(k,)`` to differ in, by how much ``(B, k)``, and where the states after go and
    their derivatives to these ``(B, n, k)``."""


def kernels(name: str, rates: Any, state: int, actuators: int, flow: int, coefficients: int) -> Kernels:
    """A vehicle's kernels, called ``{name}_rates``, ``_step``, ``_forced`` and ``_sloped`` in the module of its rates.

    Args:
        name: The vehicle's.
        rates: Its rates, `estimators.compiled.inlined`.
        state: How many numbers its state has,
        actuators: its actuators,
        flow: what it moves in,
        coefficients: and its equations.

    Raises:
        ValueError: for a size below 1; when first called, numba.TypingError, if the rates are not as many as the state.
    """
    if min(state, actuators, flow, coefficients) < 1:
        raise ValueError(f"{name} needs a state, actuators, a flow and coefficients of one number each at least")
    module = rates.py_func.__module__
    kept = module.startswith("vessel_gym.")  # Numba's cache does not see the rates: the digest of our sources does
    blank = tuple(size * (0.0,) for size in (state, actuators, flow, coefficients))

    def made(template: Any, what: str, compiler: Callable[[Any], Any], **known: Any) -> Any:
        own = FunctionType(template.__code__, globals() | {"_rates": rates, "_blank": blank} | known)
        own.__module__, own.__doc__ = module, template.__doc__
        own.__name__ = own.__qualname__ = f"{name}_{what}"  # by which the cache and pickles tell them apart
        return compiler(own)

    x, xs = "float64[:]", "float64[:, :]"
    rated, stepped = f"void({x}, {x}, {x}, {x}, {x})", f"void({xs}, {xs}, {xs}, {xs}, float64, int64, {xs})"
    forced = f"void({xs}, {xs}, {xs}, {xs}, {xs}, float64, int64, int64[::1], {xs})"
    sloped = f"void({xs}, {xs}, {xs}, {xs}, {xs}, float64, int64, int64[::1], {xs}, {xs}, float64[:, :, :])"
    moved = made(_moved_rows, "moved", part)
    return Kernels(
        made(_rates_of, "rates", gufunc(rated, "(n),(a),(f),(k)->(n)", cache=kept)),
        _for_all(
            made(_step, "step", gufunc(stepped, "(b,n),(p,m),(q,f),(r,k),(),()->(b,n)", cache=kept), _moved_rows=moved)
        ),
        made(_forced, "forced", rowwise(forced, cache=kept), _moved_rows=moved),
        made(_sloped, "sloped", rowwise(sloped, cache=kept), _moved_rows=moved),
    )


def _for_all(kernel: Kernel) -> Kernel:
    """The kernel of rows for one state or many, whose controls, flows and coefficients are their own or shared."""

    @wraps(kernel, ("__module__", "__name__", "__qualname__"))  # by which pickles find it
    def step(
        state: np.ndarray, control: np.ndarray, flow: np.ndarray, c: np.ndarray, dt: float, substeps: int,
        out: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """States ``(..., n)`` after a step: the same numbers for each alone as among others.

        Args:
            state: ``(..., n)``.
            control: ``(..., m)`` actuators before and after; these, flow and coefficients broadcast to the states.
            flow: ``(..., f)``.
            c: ``(..., k)`` coefficients.
            dt: Seconds.
            substeps: Equal parts of the step.
            out: ``(..., n)`` where the states after the step go; None: a new array.

        Raises:
            ValueError: for numbers of rows or columns that do not fit.
        """
        if state.ndim == 1:
            return step(state[None], control, flow, c, dt, substeps, None if out is None else out[None])[..., 0, :]
        if control.ndim == 1 or flow.ndim == 1 or c.ndim == 1:
            control, flow, c = (x if x.ndim > 1 else x[None] for x in (control, flow, c))
        return kernel(state, control, flow, c, dt, substeps, out)

    return step


# --- tuples, half by half: loops over their numbers would stay loops in the compiled code, and slow -----


def _loaded(blank: Numbers, numbers: np.ndarray, first: int) -> Numbers:
    """As many ``numbers`` as ``blank`` has, from the ``first`` on."""
    raise NotImplementedError("this is compiled")


def _stored(s: Numbers, out: np.ndarray, first: int) -> None:
    """Writes ``s`` to ``out``, from the ``first`` on."""
    raise NotImplementedError("this is compiled")


def _moved(s: Numbers, h: float, rate: Numbers) -> Numbers:
    """``s + h rate``."""
    raise NotImplementedError("this is compiled")


_compiled: dict[str, Any] = {"strict": False, "jit_options": {"forceinline": True, "error_model": "numpy"}}


@overload(_loaded, **_compiled)
def _halves_loaded(blank: Any, numbers: Any, first: Any) -> Callable[..., Numbers]:
    half = len(blank) // 2
    if half == 0:
        return lambda blank, numbers, first: (numbers[first],)
    return lambda blank, numbers, first: (
        _loaded(blank[:half], numbers, first) + _loaded(blank[half:], numbers, first + half)
    )


@overload(_stored, **_compiled)
def _halves_stored(s: Any, out: Any, first: Any) -> Callable[..., None]:
    half = len(s) // 2

    def one(s: Numbers, out: np.ndarray, first: int) -> None:
        out[first] = s[0]

    def halves(s: Numbers, out: np.ndarray, first: int) -> None:
        _stored(s[:half], out, first)
        _stored(s[half:], out, first + half)

    return one if half == 0 else halves


@overload(_moved, **_compiled)
def _halves_moved(s: Any, h: Any, rate: Any) -> Callable[..., Numbers]:
    if len(s) != len(rate):
        raise TypingError(f"there are {len(rate)} rates of a state of {len(s)} numbers")
    half = len(s) // 2
    if half == 0:
        return lambda s, h, rate: (s[0] + h * rate[0],)
    return lambda s, h, rate: _moved(s[:half], h, rate[:half]) + _moved(s[half:], h, rate[half:])


# --- kernels ----------------------------------------------------------------------------------------


@inlined
def _substep(
    rates: Rates, s: Numbers, start: Numbers, change: Numbers, flow: Numbers, c: np.ndarray, dt: float, i: int, n: int
) -> Numbers:
    """The ``i``-th of ``n`` equal parts of a step, over which actuators ``change`` from those at its ``start``."""
    h = dt / n
    control, middle = _moved(start, i / n, change), _moved(start, (i + 0.5) / n, change)
    k1 = rates(s, control, flow, c)
    k2 = rates(_moved(s, 0.5 * h, k1), middle, flow, c)
    k3 = rates(_moved(s, 0.5 * h, k2), middle, flow, c)
    k4 = rates(_moved(s, h, k3), _moved(start, (i + 1) / n, change), flow, c)
    return _moved(_moved(_moved(_moved(s, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)


_rates: Any = None  # in what follows those of a vehicle,
_blank: Any = None  # and as many zeros as its state, its actuators and what it moves in have numbers


def _rates_of(state: np.ndarray, control: np.ndarray, flow: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
    """The rates of a state ``(n,)``."""
    n, m, f, k = _blank
    if (len(state), len(control), len(flow), len(c)) != (len(n), len(m), len(f), len(k)):
        raise ValueError("state, control, flow and coefficients must be as long as the equations say")
    s, actuators, around = _loaded(_blank[0], state, 0), _loaded(_blank[1], control, 0), _loaded(_blank[2], flow, 0)
    _stored(_moved(_blank[0], 1.0, _rates(s, actuators, around, c)), out, 0)


def _step(
    states: np.ndarray, control: np.ndarray, flow: np.ndarray, c: np.ndarray, dt: float, substeps: int, out: np.ndarray
) -> None:
    """States ``(b, n)`` after a step; of the others there is a row each, or one."""
    m, unkicked = control.shape[1] // 2, np.empty(0, np.int64)
    _moved_rows(states, control[:, :m], control[:, m:], flow, c, dt, substeps, unkicked, out)


def _forced(
    states: np.ndarray, before: np.ndarray, after: np.ndarray, forcing: np.ndarray, c: np.ndarray, dt: float,
    substeps: int, kicked: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """States ``(b, n)`` after a step at whose end they are kicked."""
    _moved_rows(states, before, after, forcing, c, dt, substeps, kicked, out)


def _sloped(
    states: np.ndarray, before: np.ndarray, after: np.ndarray, flow: np.ndarray, c: np.ndarray, dt: float,
    substeps: int, columns: np.ndarray, by: np.ndarray, out: np.ndarray, slopes: np.ndarray,
) -> None:  # fmt: skip
    """States ``(b, n)`` after a step, and their derivatives by fourth-order differences ``(b, n, k)``."""
    n, k, unkicked = states.shape[1], len(columns), np.empty(0, np.int64)
    points, around = np.empty((4 * k + 1, n)), np.empty((4 * k + 1, flow.shape[1]))
    ends = np.empty((4 * k + 1, n))
    for row in range(len(states)):
        points[:], around[:] = states[row], flow[min(row, len(flow) - 1)]
        for j in range(k):
            for side in range(4):
                change = (1.0, -1.0, 2.0, -2.0)[side] * by[row, j]
                if columns[j] < n:
                    points[1 + 4 * j + side, columns[j]] += change
                else:
                    around[1 + 4 * j + side, columns[j] - n] += change
        now, then = min(row, len(before) - 1), min(row, len(after) - 1)
        _moved_rows(points, before[now : now + 1], after[then : then + 1], around, c[:1], dt, substeps, unkicked, ends)
        for i in range(n):
            out[row, i] = ends[0, i]
            for j in range(k):
                near, far = ends[1 + 4 * j, i] - ends[2 + 4 * j, i], ends[3 + 4 * j, i] - ends[4 + 4 * j, i]
                slopes[row, i, j] = (8.0 * near - far) / (12.0 * by[row, j])


def _moved_rows(
    states: np.ndarray, before: np.ndarray, after: np.ndarray, forcing: np.ndarray, c: np.ndarray, dt: float,
    substeps: int, kicked: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """States ``(b, n)`` after a step, side by side in vector instructions; of the others there is a row each, or one.

    How many there are in a block is no constant: a loop over a few the compiler unrolls, and leaves scalar.
    """
    s, actuators, around, coefficients = _blank
    n, m, f = len(s), len(actuators), len(around)
    a = np.empty((n + 2 * m + f + len(coefficients), _LANES))
    told = states.shape[1], before.shape[1], after.shape[1], forcing.shape[1] - len(kicked), c.shape[1]
    if told != (n, m, m, f, len(coefficients)):
        raise ValueError("state, control, flow and coefficients must be as long as the equations say")
    for rows in (len(before), len(after), len(forcing), len(c)):
        if rows != 1 and rows != len(states):
            raise ValueError("there must be a row of control, flow and coefficients for each state, or one for all")
    for first in range(0, len(states), _LANES):
        left = min(len(states) - first, _LANES)
        size = (left + 3) // 4 * 4  # whole vectors: nothing is compiled for what is left over
        _gather(states, first, size, a)
        _gather(before, first, size, a[n:])
        _gather(after, first, size, a[n + m :])
        _gather(forcing[:, len(kicked) :], first, size, a[n + 2 * m :])
        _gather(c, first, size, a[n + 2 * m + f :])
        for i in range(substeps):
            for j in range(size):
                start, end = _loaded(actuators, a[:, j], n), _loaded(actuators, a[:, j], n + m)
                s, around = _loaded(s, a[:, j], 0), _loaded(around, a[:, j], n + 2 * m)
                change = _moved(end, -1.0, start)
                _stored(_substep(_rates, s, start, change, around, a[n + 2 * m + f :, j], dt, i, substeps), a[:, j], 0)
        for j in range(left):
            _stored(_loaded(s, a[:, j], 0), out[first + j], 0)
            for i in range(len(kicked)):
                out[first + j, kicked[i]] += forcing[first + j, i]


@inlined
def _gather(rows: np.ndarray, first: int, size: int, lanes: np.ndarray) -> None:
    """Sets ``lanes[k, j]`` to ``rows[first + j, k]``; beyond the last row there are more of it, as there are of one."""
    if first == 0 or len(rows) > 1:
        for j in range(size):
            row = min(first + j, len(rows) - 1)
            for k in range(rows.shape[1]):
                lanes[k, j] = rows[row, k]
