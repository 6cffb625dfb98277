"""Numbers of other libraries that take NumPy's functions, so that an equation is written once.

NumPy hands its operations to objects that have ``__array_ufunc__`` and ``__array_function__``. A
function of arrays of such objects then computes with the operations of their library.
"""

import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

PYTHON: dict[str, Callable[..., Any]] = {
    "add": operator.add, "subtract": operator.sub, "multiply": operator.mul,
    "divide": operator.truediv, "negative": operator.neg, "greater": operator.gt,
    "less": operator.lt, "greater_equal": operator.ge, "less_equal": operator.le,
}  # fmt: skip
"""Operations by their names in NumPy, for libraries that overload Python's operators."""


def operations(module: Any, **other: Any) -> dict[str, Callable[..., Any]]:
    """Operations of a module, which has NumPy's names but for the others."""
    named = {
        name: getattr(module, name)
        for name in ("sqrt", "sin", "cos", "absolute", "maximum", "where")
        if name not in other
    }
    return PYTHON | named | other


def vector(values: Any) -> np.ndarray:
    """Array of objects ``(n,)``, of which NumPy converts none."""
    array = np.empty(len(values), object)
    for index, value in enumerate(values):
        array[index] = value
    return array


class Dispatched(NDArrayOperatorsMixin):
    """A number whose operations NumPy leaves to `apply`."""

    def apply(self, name: str, *operands: Any) -> Any:
        """Result of the operation that NumPy calls by this name."""
        raise NotImplementedError

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, **options: Any) -> Any:
        if any(isinstance(each, np.ndarray) for each in operands):  # element by element
            return ufunc(*(vector([x]) if isinstance(x, Dispatched) else x for x in operands))
        return self._applied(ufunc.__name__, operands)

    def __array_function__(self, function: Any, types: Any, operands: Any, options: Any) -> Any:
        if function is np.stack:
            return vector(operands[0])
        return self._applied(function.__name__, operands)

    def _applied(self, name: str, operands: Any) -> Any:
        outer = next((each for each in operands if isinstance(each, Dual)), self)
        return outer.apply(name, *operands)


class Scalar(Dispatched):
    """A number of a library, which has the given operations. Zeros are folded."""

    def __init__(self, value: Any, operations: Mapping[str, Callable[..., Any]]) -> None:
        self.value, self.operations = value, operations

    def apply(self, name: str, *operands: Any) -> Any:
        """Result of an operation of the library."""
        zero = [isinstance(each, float) and each == 0.0 for each in operands]
        if (name == "multiply" and any(zero)) or (name == "divide" and zero[0]):
            return 0.0
        if name in ("add", "subtract") and zero[1]:
            return operands[0]
        if name == "add" and zero[0]:
            return operands[1]
        values = (x.value if isinstance(x, Scalar) else float(x) for x in operands)
        return Scalar(self.operations[name](*values), self.operations)


class Dual(Dispatched):
    """A number with its derivatives by index, for libraries without exact Jacobians."""

    FACTORS: Mapping[str, Callable[..., tuple[Any, ...]]] = {
        "add": lambda a, b: (1.0, 1.0),
        "subtract": lambda a, b: (1.0, -1.0),
        "multiply": lambda a, b: (b, a),
        "divide": lambda a, b: (1.0 / b, -(a / b) / b),
        "negative": lambda a: (-1.0,),
        "absolute": lambda a: (np.where(a < 0.0, -1.0, 1.0),),
        "sqrt": lambda a: (0.5 / np.sqrt(a),),
        "sin": lambda a: (np.cos(a),),
        "cos": lambda a: (-np.sin(a),),
        "maximum": lambda a, b: (np.where(a > b, 1.0, 0.0), np.where(a > b, 0.0, 1.0)),
        "where": lambda mask, a, b: (0.0, np.where(mask, 1.0, 0.0), np.where(mask, 0.0, 1.0)),
    }
    """Derivative of each operation by each operand."""

    def __init__(self, value: Any, slopes: Mapping[int, Any]) -> None:
        self.value, self.slopes = value, slopes

    def apply(self, name: str, *operands: Any) -> Any:
        """Result with its derivatives; a comparison has none."""
        values = [x.value if isinstance(x, Dual) else x for x in operands]
        value = getattr(np, name)(*values)
        if name not in self.FACTORS:
            return value
        slopes: dict[int, Any] = {}
        for operand, factor in zip(operands, self.FACTORS[name](*values), strict=True):
            for index, slope in getattr(operand, "slopes", {}).items():
                slopes[index] = slopes.get(index, 0.0) + factor * slope
        return Dual(value, slopes)


def forward(function: Callable[..., np.ndarray], x: np.ndarray, *others: Any) -> Any:
    """Value ``(m,)`` of a function of a state ``(n,)``, and its Jacobian, by forward mode."""
    found = function(vector([Dual(value, {i: 1.0}) for i, value in enumerate(x)]), *others)
    jacobian = [[each.slopes.get(index, 0.0) for index in range(len(x))] for each in found]
    return vector([each.value for each in found]), np.array(jacobian, object)


class Lines(dict[str, Callable[..., str]]):
    """Operations that write Python: each appends a line, and returns the name of its result."""

    def __init__(self, arguments: str) -> None:
        self.lines = [f"def written({arguments}):"]

    def __missing__(self, name: str) -> Callable[..., str]:
        def write(*operands: Any) -> str:
            self.lines.append(f"    t{len(self.lines)} = {name}({', '.join(map(str, operands))})")
            return f"t{len(self.lines) - 1}"

        return write

    def function(self, last: str, names: dict[str, Any]) -> Callable[..., Any]:
        """The function that is written, with a last line and the functions that it calls."""
        exec("\n".join([*self.lines, f"    {last}"]), names)
        return names["written"]
