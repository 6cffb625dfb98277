"""Tracers, which stand for scalars while a function is traced and record the operations on them."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, ClassVar, NoReturn

import numpy as np

from estimators.engine.program import KINDS, NotTraceable, Program

_Operators: Any = object  # which are set below, and unknown to a checker of types


class Tracer(_Operators):
    """A scalar of each row: a number, a word or a mask."""

    __slots__ = ("kind", "program", "value")
    array: ClassVar[Any]
    """Class of arrays of tracers, whose methods a tracer has; set by `estimators.engine.arrays`."""
    __array_priority__ = 1000.0
    ndim = 0
    shape = ()
    size = 1

    def __init__(self, program: Program, value: int) -> None:
        self.program, self.value, self.kind = program, value, program.kinds[value]

    @property
    def dtype(self) -> np.dtype:
        """Its type in NumPy."""
        return KINDS[self.kind]

    def __bool__(self) -> bool:
        raise NotTraceable(
            "a traced function cannot branch on values, which differ from row to row: use np.where"
        )

    def _no_number(self, *_: Any) -> NoReturn:
        raise NotTraceable(
            "a traced function cannot turn values into Python's numbers or fresh arrays of floats:"
            " use NumPy's functions and np.stack"
        )

    __float__ = __int__ = __index__ = __complex__ = __iter__ = __len__ = __hash__ = _no_number

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        if np.dtype(dtype or object) != object:
            self._no_number()
        array = np.empty((), object)
        array[()] = self
        return array

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, **others: Any) -> Any:
        if any(isinstance(each, self.array) for each in operands):
            return NotImplemented
        return self.array.of(self).__array_ufunc__(ufunc, method, *operands, **others)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if any(issubclass(each, self.array) for each in types):
            return NotImplemented
        return self.array.of(self).__array_function__(function, types, args, kwargs)

    def __getitem__(self, key: Any) -> Any:
        return self.array.of(self)[key]

    def __getattr__(self, name: str) -> Any:
        if name in OPCODES:  # NumPy calls them of the entries of plain object arrays
            return lambda: operation(name, self)
        if name.startswith("__") or not hasattr(np.ndarray, name):
            raise AttributeError(f"a traced number has no .{name}")
        return getattr(self.array.of(self), name)

    def conjugate(self) -> "Tracer":
        """The number itself, as all numbers are real."""
        return self

    __pos__ = conjugate

    def __neg__(self) -> Any:
        return operation("negative", self)

    def __abs__(self) -> Any:
        return operation("absolute", self)

    def __invert__(self) -> Any:
        return operation("invert", self)

    def __pow__(self, exponent: Any) -> Any:
        return power(self, exponent)


def constant(program: Program, value: Any) -> Tracer:
    """The tracer of a constant scalar."""
    if isinstance(value, Tracer):
        return value
    if isinstance(value, np.ndarray):
        return constant(program, value[()])
    kind = "f" if isinstance(value, float) else np.asarray(value).dtype.kind
    if kind not in KINDS:
        raise NotTraceable(f"a traced function computes with real numbers and masks, not {value!r}")
    return Tracer(program, program.constant(KINDS[kind].type(value), kind))


def known(tracer: Tracer) -> Any:
    """The value of a constant; None for a number that differs from row to row."""
    return tracer.program.constants.get(tracer.value)


def cast(x: Any, kind: str) -> Any:
    """A number as another kind: masks are 1 and 0, floats are truncated."""
    if not isinstance(x, Tracer):
        return np.asarray(x).astype(KINDS[kind])[()]
    if x.kind == kind:
        return x
    if (value := known(x)) is not None:
        return constant(x.program, KINDS[kind].type(value))
    if kind == "b":
        return operation("not_equal", x, KINDS[x.kind].type(0))
    if x.kind == "b":
        return where(x, KINDS[kind].type(1), KINDS[kind].type(0))
    if x.kind == "f":
        x = within(x, -9.2e18, 9.2e18)
    return Tracer(x.program, x.program.add("cast", (x.value,), kind))


def within(x: Any, low: Any, high: Any) -> Any:
    """A number within bounds; NaN becomes the lower one."""
    x = where(x > low, x, low)
    return where(x < high, x, high)


def _arithmetic(x: Tracer, y: Tracer) -> tuple[Tracer, Tracer]:
    """Operands as the kind that NumPy computes with."""
    kinds = {x.kind, y.kind}
    if kinds == {"b"}:
        raise NotTraceable("of two masks there are & and |, or 1.0 * mask for numbers")
    if "f" in kinds or (kinds == {"u", "i"} and known(x) is None and known(y) is None):
        kind = "f"
    else:
        kind = "u" if "u" in kinds else "i"
    return cast(x, kind), cast(y, kind)


ELEMENTARY = frozenset((
    "sin", "cos", "exp", "log", "log1p", "arctan", "arcsin", "tanh", "arctan2", "hypot",
))  # fmt: skip
"""Opcodes that `estimators.engine.elementary` computes; the others are exactly NumPy's."""
_BITWISE = frozenset(("bitwise_and", "bitwise_or", "bitwise_xor"))
GIVE_MASKS = frozenset(("greater", "greater_equal", "equal", "not_equal"))
_SHIFTS = frozenset(("left_shift", "right_shift"))
OF_WORDS = _BITWISE | _SHIFTS
"""Opcodes of whole numbers and masks."""
_PROMOTING = frozenset(("add", "subtract", "multiply", *GIVE_MASKS, *_BITWISE))
"""Opcodes whose operands are converted to one kind."""


def program_of(operands: Iterable[Any]) -> Any:
    """The program of the first operand that is traced; None if there is none."""
    for each in operands:
        if (program := getattr(each, "program", None)) is not None:
            return program
    return None


def _converted(opcode: str, operands: list[Tracer], kinds: set[str]) -> list[Any]:
    """Operands, converted to the kinds that an opcode takes."""
    if opcode in _BITWISE and "f" in kinds:
        raise NotTraceable("&, | and ^ are of masks or whole numbers")
    if opcode in _SHIFTS:
        if operands[0].kind not in "iu" or known(operands[1]) not in range(64):
            raise NotTraceable("<< and >> shift whole numbers by a constant from 0 to 63")
        return [operands[0], cast(operands[1], operands[0].kind)]
    if opcode not in _PROMOTING:
        return [*map(partial(cast, kind="f"), operands)]
    masks = kinds == {"b"} and opcode in ("equal", "not_equal", *_BITWISE)
    return operands if masks else [*_arithmetic(*operands)]


def operation(opcode: str, *operands: Any) -> Any:
    """The result of an opcode of scalars, computed at once by NumPy where none is traced."""
    if (program := program_of(operands)) is None:
        with np.errstate(all="ignore"):
            return getattr(np, opcode)(*operands)
    traced: list[Any] = [constant(program, each) for each in operands]
    if opcode in _COMPOSED:
        return _COMPOSED[opcode](*traced)
    kinds = {x.kind for x in traced}
    if opcode == "multiply" and kinds == {"b"}:
        opcode = "bitwise_and"
    if opcode in OF_WORDS or kinds != {"f"}:
        traced = _converted(opcode, traced, kinds)
    kind = "b" if opcode in GIVE_MASKS else traced[0].kind
    values = (*[x.value for x in traced],)
    if opcode not in ELEMENTARY and program.constants.keys() >= {*values}:
        return constant(program, operation(opcode, *map(known, traced)))
    return Tracer(program, program.add(opcode, values, kind))


def where(mask: Any, chosen: Any, other: Any) -> Any:
    """One of two scalars."""
    if (program := program_of((mask, chosen, other))) is None:
        return np.where(mask, chosen, other)[()]
    mask = cast(constant(program, mask), "b")
    if known(mask) is not None:
        return chosen if known(mask) else other
    one, two = constant(program, chosen), constant(program, other)
    if {one.kind, two.kind} != {"b"}:
        one, two = _arithmetic(one, two)
    if one.value == two.value:
        return one
    return Tracer(program, program.add("where", (mask.value, one.value, two.value), one.kind))


def _extreme(x: Tracer, y: Tracer, beyond: Tracer) -> Any:
    """The first operand, or the other one where it is ``beyond`` the first, equal to it or NaN."""
    number = known(y)
    if y.kind == "f" and (number is None or number != number):
        beyond = beyond | operation("isnan", y)
    return where(beyond, y, x)


def _remainder(x: Tracer, y: Tracer) -> Any:
    """``x - y floor(x / y)`` of floats with the sign of y, exactly, as `numpy.remainder`."""
    rest = operation("fmod", x, y)
    moved = where((rest < 0.0) ^ (y < 0.0), rest + y, rest)
    return where(rest == 0.0, operation("copysign", 0.0, y), moved)


_COMPOSED: dict[str, Callable[..., Any]] = {
    "less": lambda x, y: operation("greater", y, x),
    "less_equal": lambda x, y: operation("greater_equal", y, x),
    "maximum": lambda x, y: _extreme(x, y, y >= x),
    "minimum": lambda x, y: _extreme(x, y, x >= y),
    "isnan": lambda x: x != x,
    "isfinite": lambda x: cast(x, "f") - cast(x, "f") == 0.0,
    "tan": lambda x: operation("sin", x) / operation("cos", x),
    "invert": lambda x: x ^ (True if x.kind == "b" else -1),
    "remainder": _remainder,
}
"""Operations that are several instructions."""
OPCODES = frozenset((
    "divide", "negative", "sqrt", "absolute", "floor", "ceil", "trunc", "rint", "copysign", "fmod",
    *_PROMOTING, *_SHIFTS, *_COMPOSED, *ELEMENTARY,
))  # fmt: skip
"""Operations of scalars, by the names of NumPy's functions."""


def power(x: Any, exponent: Any) -> Any:
    """A power of a constant exponent: a whole number, or a half of one."""
    if not isinstance(x, Tracer) and not isinstance(exponent, Tracer):
        return np.power(x, exponent)
    twice = np.nan if isinstance(exponent, Tracer) else 2.0 * float(exponent)
    if not isinstance(x, Tracer) or twice != np.rint(twice) or abs(twice) > 64:
        raise NotTraceable("powers have constant exponents, whole numbers and halves")
    whole, result = int(abs(twice)) // 2, None
    if int(twice) % 2:
        result = operation("sqrt", x)
    square = x
    while whole:
        if whole % 2:
            result = square if result is None else operation("multiply", result, square)
        whole //= 2
        square = operation("multiply", square, square) if whole else square
    if result is None:
        return 1.0
    return result if twice > 0 else operation("divide", 1.0, result)


_SCALARS = Tracer, float, int, np.generic


def _operator(opcode: str, swapped: bool = False) -> Callable[[Tracer, Any], Any]:
    def apply(self: Tracer, other: Any) -> Any:
        if not isinstance(other, _SCALARS):
            return NotImplemented
        return operation(opcode, other, self) if swapped else operation(opcode, self, other)

    return apply


OPERATORS = {
    "add": "add", "sub": "subtract", "mul": "multiply", "truediv": "divide", "and": "bitwise_and",
    "or": "bitwise_or", "xor": "bitwise_xor", "lshift": "left_shift", "rshift": "right_shift",
    "mod": "remainder", "gt": "greater", "ge": "greater_equal", "lt": "less", "le": "less_equal",
    "eq": "equal", "ne": "not_equal",
}  # fmt: skip
"""Python's operators of two numbers, and NumPy's functions."""
for _name, _opcode in OPERATORS.items():
    setattr(Tracer, f"__{_name}__", _operator(_opcode))
    setattr(Tracer, f"__r{_name}__", _operator(_opcode, True))
