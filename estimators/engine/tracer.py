"""Tracers: what stands for a scalar while a function is traced, and records the operations on it."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NoReturn

import numpy as np

from estimators.engine.program import Program

KINDS = {
    "f": np.dtype(float),
    "i": np.dtype(np.int64),
    "u": np.dtype(np.uint64),
    "b": np.dtype(bool),
}
_REMEDY = "give both outcomes to np.where, or leave the function as it is: it then runs in NumPy"


class NotTraceable(TypeError):
    """A function does what cannot be traced; it can run in NumPy."""


_Operators: Any = object  # which are set below, and unknown to a checker of types


class Tracer(_Operators):
    """A scalar of each row: a number, a word or a mask."""

    __slots__ = ("program", "value")
    as_array: ClassVar[Callable[["Tracer"], Any]]
    """Array of it alone, whose functions are its own, too; `estimators.engine.arrays` registers which."""
    __array_priority__ = 1000.0
    ndim = 0
    shape = ()
    size = 1

    def __init__(self, program: Program, value: int) -> None:
        self.program, self.value = program, value

    @property
    def kind(self) -> str:
        """The letter of its type."""
        return self.program.kinds[self.value]

    @property
    def dtype(self) -> np.dtype:
        """Its type in NumPy."""
        return KINDS[self.kind]

    def __bool__(self) -> bool:
        raise NotTraceable(
            f"a traced function cannot branch on values, which differ from row to row: {_REMEDY}"
        )

    def _no_number(self, *_: Any) -> NoReturn:
        raise NotTraceable("a traced function cannot turn values into Python's numbers or fresh arrays of floats: "
                           "use NumPy's functions and np.stack")  # fmt: skip

    __float__ = __int__ = __index__ = __complex__ = __iter__ = __len__ = __hash__ = _no_number

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        if dtype not in (None, object, np.dtype(object)):
            self._no_number()
        array = np.empty((), object)
        array[()] = self
        return array

    def __repr__(self) -> str:
        return f"Tracer({self.value}, {self.kind!r})"

    def __copy__(self) -> "Tracer":
        return self

    def __deepcopy__(self, memo: Any) -> "Tracer":
        return self

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, **others: Any) -> Any:
        return self.as_array().__array_ufunc__(ufunc, method, *operands, **others)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return self.as_array().__array_function__(function, types, args, kwargs)

    def __getitem__(self, key: Any) -> Any:
        return self.as_array()[key]

    def __getattr__(self, name: str) -> Any:
        if name in _METHODS:  # NumPy calls them of the entries of plain object arrays
            return lambda: operation(name, self)
        if name.startswith("__") or not hasattr(np.ndarray, name):
            raise AttributeError(f"a traced number has no .{name}")
        return getattr(self.as_array(), name)

    def conjugate(self) -> "Tracer":
        """Itself: numbers are real."""
        return self


def constant(program: Program, value: Any) -> Tracer:
    """The tracer of a constant scalar."""
    if type(value) is Tracer:
        return value
    if isinstance(value, float):  # np.float64, too
        return Tracer(program, program.constant(value, "f"))
    if isinstance(value, np.ndarray) and value.dtype == object and value.ndim == 0:
        value = value[()]
    kind = np.asarray(value).dtype.kind
    if kind == "f" and np.asarray(value).dtype != float:
        value = float(value)
    if kind not in KINDS:
        raise NotTraceable(f"a traced function computes with real numbers and masks, not {value!r}")
    return Tracer(program, program.constant(value, kind))


def known(tracer: Tracer) -> Any:
    """The value of a constant, None of what differs from row to row."""
    return tracer.program.constants.get(tracer.value)


def cast(x: Tracer, kind: str) -> Any:
    """A number as another kind: masks are 1 and 0, floats are truncated."""
    if x.kind == kind:
        return x
    if (value := known(x)) is not None:
        return constant(x.program, KINDS[kind].type(value))
    if kind == "b":
        return operation("not equal", x, constant(x.program, KINDS[x.kind].type(0)))
    return Tracer(x.program, x.program.add("cast", (x.value,), kind))


def _arithmetic(x: Tracer, y: Tracer) -> tuple[Tracer, Tracer]:
    """Operands as the kind that NumPy computes with."""
    kinds = {x.kind, y.kind}
    if kinds == {"b"}:
        raise NotTraceable(
            "a traced function does not compute with two masks: use & and |, or 1.0 * mask"
        )
    if "f" in kinds or (kinds == {"u", "i"} and known(x) is None and known(y) is None):
        kind = "f"
    else:
        kind = "u" if "u" in kinds else "i"
    return cast(x, kind), cast(y, kind)


_METHODS = frozenset(("sqrt", "sin", "cos", "tan", "exp", "expm1", "log", "log1p", "arctan", "arcsin", "arccos", "tanh",
                      "floor", "ceil", "trunc", "rint"))  # fmt: skip
_COMPARISONS = {"less": "greater", "less equal": "greater equal"}


def numpy_function(opcode: str) -> Any:
    """NumPy's function of an opcode."""
    return getattr(np, _NUMPY.get(opcode) or opcode.replace(" ", "_"))


_NUMPY = {"and": "bitwise_and", "or": "bitwise_or", "xor": "bitwise_xor", "not": "invert",
          "whole remainder": "remainder"}  # fmt: skip
_EXACT: dict[str, Callable[..., Any]] = {
    opcode: numpy_function(opcode)
    for opcode in (
        "add", "subtract", "multiply", "divide", "negative", "sqrt", "absolute", "floor", "ceil", "trunc", "rint",
        "maximum", "minimum", "copysign", "fmod", "greater", "greater equal", "equal", "not equal", "isfinite",
        "isnan", "and", "or", "xor", "not", "left shift", "right shift", "whole remainder",
    )
}  # fmt: skip
"""Opcodes that the processor carries out exactly as NumPy does."""


_FLOATS = frozenset(("add", "subtract", "multiply", "divide"))
_BITWISE = frozenset(("and", "or", "xor", "not"))
_GIVE_MASKS = frozenset(("greater", "greater equal", "equal", "not equal", "isfinite", "isnan"))
_PROMOTING = frozenset((
    "add", "subtract", "multiply", "maximum", "minimum", "greater", "greater equal", "equal", "not equal",
    "whole remainder", "and", "or", "xor",
))  # fmt: skip
"""Opcodes whose operands become of one kind."""


def operation(opcode: str, *operands: Any) -> Any:
    """The result of an opcode of scalars, computed at once where all are constants."""
    if opcode in _FLOATS:  # most instructions by far
        program = operands[type(operands[0]) is not Tracer].program
        x, y = operands = constant(program, operands[0]), constant(program, operands[1])
        a, b = program.constants.get(x.value), program.constants.get(y.value)
        if program.kinds[x.value] == program.kinds[y.value] == "f" and (a is None or b is None):
            simple = None if a is b else _simplified(opcode, operands, (a, b))
            return (
                Tracer(program, program.add(opcode, (x.value, y.value), "f"))
                if simple is None
                else simple
            )
    program = next(each.program for each in operands if isinstance(each, Tracer))
    traced = [constant(program, each) for each in operands]
    if opcode in ("remainder", "floor divide"):
        return _remainder(*traced) if opcode == "remainder" else _floor_divide(*traced)
    if opcode in _COMPARISONS:
        opcode, traced = _COMPARISONS[opcode], traced[::-1]
    kinds = {x.kind for x in traced}
    if opcode in _BITWISE and "f" in kinds:
        raise NotTraceable("&, | and ~ are of masks or whole numbers")
    if opcode in _PROMOTING:
        if kinds != {"b"} or opcode not in ("equal", "not equal", "multiply", *_BITWISE):
            traced = list(_arithmetic(*traced))
    elif opcode in ("left shift", "right shift"):
        places = known(traced[1])
        if traced[0].kind not in "iu" or places is None or not 0 <= places < 64:
            raise NotTraceable(
                "<< and >> in a traced function shift whole numbers by a constant from 0 to 63"
            )
        traced[1] = cast(traced[1], traced[0].kind)
    elif opcode != "not" and not (opcode in ("absolute", "negative") and kinds <= {"i", "u"}):
        traced = [cast(x, "f") for x in traced]
    kind = traced[0].kind
    if opcode == "multiply" and kind == "b":
        opcode = "and"
    if opcode in _GIVE_MASKS:
        kind = "b"
    values = [known(x) for x in traced]
    if opcode in _EXACT and all(value is not None for value in values):
        with np.errstate(all="ignore"):
            return constant(
                program,
                _EXACT[opcode](
                    *(KINDS[x.kind].type(v) for x, v in zip(traced, values, strict=True))
                ),
            )
    if (simple := _simplified(opcode, traced, values)) is not None:
        return simple
    return Tracer(program, program.add(opcode, tuple(x.value for x in traced), kind))


_MASK_IDENTITIES = {"and": True, "or": False, "xor": False}


def _simplified(opcode: str, operands: Sequence[Tracer], values: Sequence[Any]) -> Tracer | None:
    """Simplify an operation with an identity element, to the bit: 0.0 is none of addition."""
    if opcode == "multiply" and 1 in values:
        return operands[values.index(1) - 1]
    if opcode == "divide" and values[1] == 1:
        return operands[0]
    if opcode == "add":
        for value, other in zip(values, operands[::-1], strict=True):
            if value == 0 and (other.kind in "iu" or np.signbit(value)):
                return other
    if opcode in _MASK_IDENTITIES and operands[0].kind == "b":
        for value, other in zip(values, operands[::-1], strict=True):
            if value is not None and bool(value) is _MASK_IDENTITIES[opcode]:
                return other
    if (
        opcode == "subtract"
        and values[1] == 0
        and (operands[0].kind in "iu" or not np.signbit(values[1]))
    ):
        return operands[0]
    return None


def where(mask: Any, chosen: Any, other: Any) -> Any:
    """One of two scalars."""
    program = next(each.program for each in (mask, chosen, other) if isinstance(each, Tracer))
    mask = cast(constant(program, mask), "b")
    if known(mask) is not None:
        return chosen if known(mask) else other
    one, two = constant(program, chosen), constant(program, other)
    if {one.kind, two.kind} != {"b"}:
        one, two = _arithmetic(one, two)
    if one.value == two.value:
        return one
    return Tracer(program, program.add("where", (mask.value, one.value, two.value), one.kind))


def _remainder(x: Any, y: Any) -> Any:
    """``x - y floor(x / y)`` with the sign of y, exactly, as `numpy.remainder`."""
    if x.kind != "f" and y.kind != "f":
        return operation("whole remainder", x, y)
    rest = operation("fmod", x, y)
    moved = where((rest < 0.0) ^ (y < 0.0), rest + y, rest)
    return where(rest == 0.0, operation("copysign", 0.0, y), moved)


def _floor_divide(x: Any, y: Any) -> Any:
    """``floor(x / y)`` of floats from their remainder, as `numpy.floor_divide`: a quotient is not rounded up."""
    x, y = cast(x, "f"), cast(y, "f")
    rest = operation("fmod", x, y)
    quotient = (x - rest) / y
    quotient = where((rest != 0.0) & ((rest < 0.0) ^ (y < 0.0)), quotient - 1.0, quotient)
    floor = operation("floor", quotient)
    floor = where(quotient - floor > 0.5, floor + 1.0, floor)
    whole = where(quotient == 0.0, operation("copysign", 0.0, x / y), floor)
    return where(y == 0.0, x / y, whole)


def power(x: Any, exponent: Any) -> Any:
    """A power of a constant exponent: a whole number, or a half of one."""
    value = known(exponent) if isinstance(exponent, Tracer) else exponent
    twice = None if value is None or isinstance(value, np.ndarray) else 2.0 * float(value)
    if not isinstance(x, Tracer) or twice is None or twice != int(twice) or abs(twice) > 64:
        raise NotTraceable(
            "a traced function has powers of constant exponents alone, whole numbers and halves"
        )
    if x.kind == "b":
        raise NotTraceable("a traced function has powers of numbers: of a mask they are 1.0 * mask")
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


def _operator(opcode: str, swapped: bool = False) -> Callable[[Tracer, Any], Any]:
    def apply(self: Tracer, other: Any) -> Any:
        if isinstance(other, np.ndarray) or not (isinstance(other, Tracer) or np.isscalar(other)):
            return NotImplemented
        return operation(opcode, other, self) if swapped else operation(opcode, self, other)

    return apply


for _name, _opcode in {
    "add": "add", "sub": "subtract", "mul": "multiply", "truediv": "divide", "and": "and", "or": "or", "xor": "xor",
    "lshift": "left shift", "rshift": "right shift", "mod": "remainder", "floordiv": "floor divide", "gt": "greater",
    "ge": "greater equal", "lt": "less", "le": "less equal", "eq": "equal", "ne": "not equal",
}.items():  # fmt: skip
    setattr(Tracer, f"__{_name}__", _operator(_opcode))
    setattr(Tracer, f"__r{_name}__", _operator(_opcode, True))
for _name, _opcode in (("neg", "negative"), ("abs", "absolute"), ("invert", "not")):
    setattr(Tracer, f"__{_name}__", lambda self, opcode=_opcode: operation(opcode, self))
for _name, _method in (("pos", lambda self: self), ("pow", power)):
    setattr(Tracer, f"__{_name}__", _method)
