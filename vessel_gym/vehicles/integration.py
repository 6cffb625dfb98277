"""Vehicles in time: the method of Runge and Kutta of fourth order, written once for all equations of motion.

A vehicle states its rates for one state, ``rates(s, control, flow, c) -> tuple``: ``s`` is its own state, ``control``
its actuators at that moment, ``flow`` the current or the wind, all of them tuples of numbers, and ``c (k,)`` its
coefficients. Over a step the flow is constant, and actuators move linearly, so that their rate limits are integrated
exactly.

`kernels` makes what a vehicle needs of its rates. The compiler has to know how long the tuples are: blank ones tell it.
"""

from collections.abc import Callable
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from numba.core.errors import TypingError
from numba.extending import overload

from estimators.compiled import gufunc, inlined

Numbers = tuple[float, ...]
Rates = Callable[[Numbers, Numbers, Numbers, np.ndarray], Numbers]
Kernel = Callable[..., np.ndarray]

_LANES = 16  # states that are stepped side by side: a number that the compiler knows, to see that they are independent


class Kernels(NamedTuple):
    """The compiled equations of motion of a vehicle, generalised ufuncs."""

    rates: Kernel
    """State ``(n,)``, actuators, flow and coefficients to the rates of the state."""
    step: Kernel
    """State, actuators before and after, flow, coefficients, seconds and substeps to the state after."""
    steps: Kernel
    """The same for many states ``(N, n)``, each in its own flow, under one control; several times as fast."""


def kernels(name: str, rates: Any, state: int, actuators: int, flow: int) -> Kernels:
    """A vehicle's kernels, called ``{name}_rates``, ``{name}_step`` and ``{name}_steps`` in the module of its rates.

    Args:
        name: The vehicle's.
        rates: Its rates, `estimators.compiled.inlined`.
        state: How many numbers its state has,
        actuators: its actuators,
        flow: and what it moves in.

    Raises:
        ValueError: for a size below 1; when first called, numba.TypingError, if the rates are not as many as the state.
    """
    if min(state, actuators, flow) < 1:
        raise ValueError(f"{name} needs a state, actuators and a flow of one number each at least")
    module = rates.py_func.__module__
    kept = module.startswith("vessel_gym.")  # Numba's cache does not see the rates: the digest of our sources does
    blank = tuple(size * (0.0,) for size in (state, actuators, flow))

    def made(template: Any, what: str, signature: str, layout: str) -> Kernel:
        own = FunctionType(template.__code__, globals() | {"_rates": rates, "_blank": blank})
        own.__module__, own.__doc__ = module, template.__doc__
        own.__name__ = own.__qualname__ = f"{name}_{what}"  # by which the cache and pickles tell them apart
        return gufunc(f"void({signature})", layout, cache=kept)(own)

    x, xs = "float64[:]", "float64[:, :]"
    return Kernels(
        made(_rates_of, "rates", f"{x}, {x}, {x}, {x}, {x}", "(n),(a),(f),(k)->(n)"),
        made(_step, "step", f"{x}, {x}, {x}, {x}, float64, int64, {x}", "(n),(m),(f),(k),(),()->(n)"),
        made(_steps, "steps", f"{xs}, {x}, {xs}, {x}, float64, int64, {xs}", "(N,n),(m),(N,f),(k),(),()->(N,n)"),
    )


def advanced(
    step: Kernel, steps: Kernel, state: np.ndarray, control: np.ndarray, flow: np.ndarray, c: np.ndarray,
    dt: float, substeps: int, out: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """States ``(..., n)`` after a step, by ``steps`` where they share control and coefficients, as an ensemble does.

    Args:
        step: the vehicle's kernel for a state.
        steps: its kernel for many.
        state: ``(..., n)``.
        control: ``(..., m)`` actuators before and after, or ``(..., 1, m)`` the same for all members.
        flow: ``(..., f)``.
        c: ``(..., k)`` coefficients.
        dt: Seconds.
        substeps: Equal parts of the step.
        out: ``(..., n)`` where the states after the step go; None: a new array.
    """
    if state.ndim > 1 and control.shape[-2:-1] == (1,) and c.ndim == 1:
        if flow.shape[:-1] != state.shape[:-1]:
            flow = np.broadcast_to(flow, state.shape[:-1] + flow.shape[-1:])
        return steps(state, control[..., 0, :], flow, c, dt, substeps, out)
    return step(state, control, flow, c, dt, substeps, out)


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
    s, actuators, around = _loaded(_blank[0], state, 0), _loaded(_blank[1], control, 0), _loaded(_blank[2], flow, 0)
    _stored(_moved(_blank[0], 1.0, _rates(s, actuators, around, c)), out, 0)


def _step(
    state: np.ndarray, control: np.ndarray, flow: np.ndarray, c: np.ndarray, dt: float, substeps: int, out: np.ndarray
) -> None:
    """A state ``(n,)`` after a step."""
    s, around, start = _loaded(_blank[0], state, 0), _loaded(_blank[2], flow, 0), _loaded(_blank[1], control, 0)
    change = _moved(_loaded(_blank[1], control, len(start)), -1.0, start)
    for i in range(substeps):
        s = _substep(_rates, s, start, change, around, c, dt, i, substeps)
    _stored(s, out, 0)


def _steps(
    states: np.ndarray, control: np.ndarray, flows: np.ndarray, c: np.ndarray, dt: float, substeps: int, out: np.ndarray
) -> None:
    """Many states ``(N, n)`` after a step: the same numbers as for each, but side by side in vector instructions."""
    start = _loaded(_blank[1], control, 0)
    change = _moved(_loaded(_blank[1], control, len(start)), -1.0, start)
    a, w = np.empty((len(_blank[0]), _LANES)), np.empty((len(_blank[2]), _LANES))
    for first in range(0, len(states), _LANES):
        size = min(_LANES, len(states) - first)
        for j in range(_LANES):
            row = first + min(j, size - 1)
            _stored(_loaded(_blank[0], states[row], 0), a[:, j], 0)
            _stored(_loaded(_blank[2], flows[row], 0), w[:, j], 0)
        for i in range(substeps):
            for j in range(_LANES):
                s, around = _loaded(_blank[0], a[:, j], 0), _loaded(_blank[2], w[:, j], 0)
                _stored(_substep(_rates, s, start, change, around, c, dt, i, substeps), a[:, j], 0)
        for j in range(size):
            _stored(_loaded(_blank[0], a[:, j], 0), out[first + j], 0)
