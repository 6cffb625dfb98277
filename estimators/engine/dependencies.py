"""What a Python function reads besides its arguments, and whether any of it has changed since.

A traced function is a constant: it must run anew in NumPy, or be traced anew, once a global, a closure's variable, an
attribute or the contents of an array that it reads are others.
"""

import builtins
import dis
import functools
import struct
import sys
from collections.abc import Callable
from copyreg import _HEAPTYPE, _new_type  # type: ignore[attr-defined]
from dataclasses import is_dataclass
from enum import Enum
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, MethodType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from estimators.engine.tracer import NotTraceable

_LARGEST = 1 << 18  # bytes of arrays that are compared at every call
_SMALL = 4096  # of those that are read-only
_MOST = 3_000  # objects
_PURE = frozenset(("numpy", "scipy", "math", "cmath", "operator", "_operator", "functools", "_functools", "itertools",
                   "collections", "dataclasses", "enum", "typing", "types", "abc", "numbers", "copy", "contextlib",
                   "builtins", "fractions", "decimal", "bisect"))  # fmt: skip
"""Packages whose functions depend on their arguments alone, but for `numpy.random`."""
_IMPURE = frozenset(("print", "open", "input", "eval", "exec", "compile", "globals", "locals", "id", "breakpoint",
                     "setattr", "delattr", "__import__"))  # fmt: skip
_ALL = frozenset(("__dict__", "vars", "dir", "getattr", "attrgetter", "__getattribute__", "__getattr__"))
"""Names by which a function may read any attribute."""
_UNUSED = frozenset(("__repr__", "__str__", "__format__", "__reduce__", "__reduce_ex__", "__getstate__",
                     "__setstate__", "__del__", "__delattr__", "__copy__", "__deepcopy__", "__doc__", "__sizeof__",
                     "__dir__", "__init_subclass__", "__class_getitem__", "__subclasshook__"))  # fmt: skip
_SLOTS = ("member_descriptor", "getset_descriptor", "_tuplegetter")  # what an object has itself, by its class
_BUILDING = frozenset(("__init__", "__new__", "__post_init__", "__setattr__", "__delattr__"))


class Dependencies:
    """Globals, closures, attributes, defaults and contents of arrays that a function reads, as they are now.

    Raises:
        NotTraceable: if the function changes something, or reads what cannot be compared.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._walk = _walked(function)

    def unchanged(self) -> bool:
        """Is everything that it reads as it was?"""
        walk = self._walk
        try:
            for holder, key, value in walk.items:
                if holder[key] is not value:
                    return self._equal()
            for holder, name, value in walk.attributes:
                if getattr(holder, name) is not value:
                    return self._equal()
            for holder, length in walk.lengths:
                if len(holder) != length:
                    return self._equal()
            for array, contents in walk.arrays:
                if array.tobytes() != contents:
                    return False
        except (KeyError, IndexError, AttributeError, ValueError):
            return self._equal()
        return True

    def _equal(self) -> bool:
        """Are other objects in their places equal to them?"""
        try:
            walk = _walked(self._function)
        except (NotTraceable, RecursionError):
            return False
        if walk.leaves != self._walk.leaves:
            return False
        self._walk = walk
        return True


def _walked(function: Callable[..., Any]) -> "_Walk":
    """All that a function reads; attributes count by their names, which are known when all its code has been seen."""
    names: frozenset[str] = frozenset()
    while True:
        walk = _Walk(names)
        walk.value(function, getattr(function, "__name__", "it"))
        if walk.mentioned <= names:
            return walk
        names |= walk.mentioned


class _Walk:
    """One walk through the objects that a function can reach."""

    def __init__(self, names: frozenset[str]) -> None:
        self.names, self.mentioned = names, set[str]()
        self.items: list[tuple[Any, Any, Any]] = []
        self.attributes: list[tuple[Any, str, Any]] = []
        self.lengths: list[tuple[Any, int]] = []
        self.arrays: list[tuple[np.ndarray, bytes]] = []
        self.leaves: list[Any] = []  # everything by value, in order
        self._met: dict[int, Any] = {}
        self._classes = set[tuple[type, frozenset[str]]]()
        self._bytes = 0

    def value(self, value: Any, what: str) -> None:
        """An object that is read, under a name for the sentence of a refusal."""
        kind = type(value)
        if kind is float:
            self.leaves.append(struct.pack("d", value))
        elif value is None or kind in (bool, int, str, bytes, complex, type(Ellipsis), slice, range, np.dtype):
            self.leaves.append((kind, value))
        elif isinstance(value, np.generic):
            self.leaves.append((value.dtype.str, value.tobytes()))
        elif id(value) in self._met:
            self.leaves.append(("met", list(self._met).index(id(value))))
        else:
            self._met[id(value)] = value
            if len(self._met) > _MOST:
                raise NotTraceable(f"it reads too many objects to compare them at every call, {what} among them")
            self._object(value, what)

    def _object(self, value: Any, what: str) -> None:
        self.leaves.append(type(value))
        if isinstance(value, np.ndarray):
            self._array(value, what)
        elif isinstance(value, FunctionType):
            self._function(value)
        elif isinstance(value, MethodType):
            self.value(value.__func__, what)
            self.value(value.__self__, what)
        elif isinstance(value, functools.partial):
            for part in (value.func, value.args, value.keywords):
                self.value(part, what)
        elif isinstance(value, property | staticmethod | classmethod | functools.cached_property):
            self._descriptor(value, what)
        elif isinstance(value, ModuleType):
            self._module(value, what)
        elif isinstance(value, BuiltinFunctionType):
            self._builtin(value, what)
        elif isinstance(value, type):
            self._class(value, _UNUSED)
        elif isinstance(value, np.ufunc | type(np.sum)) or type(value).__module__ == "estimators.engine.compiled":
            self.leaves.append(value)
            if (inner := getattr(value, "function", None)) is not None:
                self.value(inner, what)
        else:
            self._instance(value, what)

    def _array(self, array: np.ndarray, what: str) -> None:
        if array.dtype.hasobject or type(array) is not np.ndarray:
            raise NotTraceable(f"it reads {what}, an array of a kind of its own, whose changes cannot be seen")
        if array.flags.writeable or array.base is not None or array.nbytes <= _SMALL:
            self._bytes += array.nbytes
            if self._bytes > _LARGEST:
                raise NotTraceable(f"it reads {what}, which is too large to compare it at every call: an array that "
                                   "never changes is read-only by .flags.writeable = False")  # fmt: skip
            contents = array.tobytes()
            self.arrays.append((array, contents))
            self.leaves.append((array.shape, array.dtype.str, contents))
        else:
            self.leaves.append(("read-only", id(array)))

    def _function(self, function: FunctionType) -> None:
        if _root(function.__module__) in _PURE or str(function.__module__).startswith("estimators.engine"):
            self.leaves.append(function)
            return
        self.attributes.append((function, "__code__", function.__code__))
        self.leaves.append(function.__code__)
        for name in ("__defaults__", "__kwdefaults__"):
            if (defaults := getattr(function, name)) is not None:
                self.attributes.append((function, name, defaults))
                self.value(defaults, f"the defaults of {function.__name__}")
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            self._cell(name, cell)
        self._code(function.__code__, function.__globals__)
        self._mapping(function.__dict__, function.__name__, every=bool(_ALL & self.names))

    def _cell(self, name: str, cell: CellType) -> None:
        try:
            contents = cell.cell_contents
        except ValueError:
            self.leaves.append("empty")
            return
        self.attributes.append((cell, "cell_contents", contents))
        if name == "__class__":  # of super(), which builds nothing
            self._class(contents, _UNUSED | _BUILDING)
        else:
            self.value(contents, name)

    def _code(self, code: CodeType, namespace: dict[str, Any]) -> None:
        names, variables = _read(code)
        self.mentioned |= names
        for name, line in variables:
            self._global(name, namespace, line)

    def _global(self, name: str, namespace: dict[str, Any], line: str) -> None:
        if name in namespace:
            self._item(namespace, name, name)
        elif name in _IMPURE:
            raise NotTraceable(f"it calls {name}(), which has to happen at every call {line}")
        else:
            self._length(namespace)
            self.leaves.append(getattr(builtins, name, "missing"))

    def _item(self, holder: Any, key: Any, what: str) -> None:
        found = holder[key]
        self.items.append((holder, key, found))
        self.leaves.append(key)
        self.value(found, what)

    def _length(self, holder: Any) -> None:
        if not any(each is holder for each, _ in self.lengths):
            self.lengths.append((holder, len(holder)))

    def _module(self, module: ModuleType, what: str) -> None:
        root = _root(module.__name__)
        if root == "numpy" and (module.__name__.startswith("numpy.random") or "random" in self.names):
            raise NotTraceable("it draws random numbers from np.random: let them be an argument")
        if root in _PURE or module.__name__.startswith("estimators.engine"):
            self.leaves.append(module)
        elif root in sys.stdlib_module_names:
            raise NotTraceable(f"it uses the module {root}, whose results differ from call to call")
        else:
            self._mapping(vars(module), what, every=False)

    def _builtin(self, function: Any, what: str) -> None:
        owner = function.__self__
        if owner is not None and not isinstance(owner, ModuleType | type):
            self.value(owner, what)
        elif _root(function.__module__ or "builtins") not in _PURE or function.__name__ in _IMPURE:
            raise NotTraceable(f"it calls {what}, of which it is not known what it depends on")
        self.leaves.append(function.__name__)

    def _descriptor(self, value: Any, what: str) -> None:
        inner = getattr(value, "fget", None) or getattr(value, "__func__", None) or getattr(value, "func", None)
        self.value(inner, what)

    def _class(self, kind: type, unused: frozenset[str]) -> None:
        self.leaves.append(kind)
        if (kind, unused) in self._classes:
            return
        self._classes.add((kind, unused))
        for each in kind.__mro__:
            if _root(each.__module__) in sys.stdlib_module_names or _root(each.__module__) in _PURE:
                continue
            own = vars(each)
            self._length(own)
            special = (name for name in own if name.startswith("__") and isinstance(own[name], FunctionType))
            for name in sorted((self.names & own.keys()).union(special) - unused):
                comparison = name in ("__eq__", "__hash__") and is_dataclass(each)  # of all fields, read or not
                if type(own[name]).__name__ not in _SLOTS and name != "__dict__" and not comparison:
                    self._item(own, name, f"{each.__name__}.{name}")

    def _mapping(self, mapping: Any, what: str, every: bool) -> None:
        self._length(mapping)
        for name in list(mapping) if every else sorted(self.names & mapping.keys()):
            self._item(mapping, name, f"{what}.{name}" if isinstance(name, str) else f"{what}[{name!r}]")

    def _instance(self, value: Any, what: str) -> None:
        kind = type(value)
        if isinstance(value, tuple):
            for i, each in enumerate(value):
                self.value(each, f"{what}[{i}]")
        elif isinstance(value, list):
            self._length(value)
            for i in range(len(value)):
                self._item(value, i, f"{what}[{i}]")
        elif isinstance(value, dict):
            self._mapping(value, what, every=True)
        elif kind is frozenset:
            self.leaves.append(value)
        elif isinstance(value, Enum):
            self.value(value.value, what)
        elif not _visible(kind):
            raise NotTraceable(
                f"it reads {what}, a {kind.__module__}.{kind.__qualname__}, whose changes cannot be seen"
            )
        if kind not in (tuple, list, dict, frozenset):
            self._class(kind, _UNUSED | _BUILDING)
            self._state(value, kind, what)

    def _state(self, value: Any, kind: type, what: str) -> None:
        """Attributes of an object: those that code names, or all where that is not known."""
        if (own := getattr(value, "__dict__", None)) is not None:
            self.attributes.append((value, "__dict__", own))
            own_code = _root(kind.__module__) not in _PURE
            self._mapping(own, what, every=not own_code or bool(_ALL & self.names) or hasattr(kind, "__getattr__"))
        for each in kind.__mro__:
            for name in sorted(k for k, v in vars(each).items() if type(v).__name__ == "member_descriptor"):
                if hasattr(value, name):
                    self.attributes.append((value, name, getattr(value, name)))
                    self.value(getattr(value, name), f"{what}.{name}")
                else:
                    self.leaves.append("empty")


@functools.lru_cache(1024)
def _read(code: CodeType, outside: frozenset[str] | None = None) -> tuple[set[str], list[tuple[str, str]]]:
    """Names and strings in a function's code; and its global variables, each with a place for a sentence.

    Raises:
        NotTraceable: if it changes what outlives a call.
    """
    outside = frozenset(code.co_freevars) if outside is None else outside
    names = {*code.co_names, *(each for each in code.co_consts if isinstance(each, str))}
    variables: list[tuple[str, str]] = []
    line = code.co_firstlineno
    for each in dis.get_instructions(code):
        name, line = each.argval, (each.positions.lineno if each.positions else None) or line
        place = f"(line {line} of {code.co_filename.rpartition('/')[2]})"
        if each.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            variables.append((name, place))
        elif each.opname in ("STORE_GLOBAL", "DELETE_GLOBAL") or (
            each.opname in ("STORE_DEREF", "DELETE_DEREF") and name in outside
        ):
            raise NotTraceable(
                f"it changes the variable {name}, which outlives the call: return it as a result {place}"
            )
        elif each.opname in ("STORE_ATTR", "DELETE_ATTR") and code.co_name not in _BUILDING:
            raise NotTraceable(f"it changes the attribute .{name}: return it as a result instead {place}")
        elif each.opname == "IMPORT_NAME" and _root(name) not in _PURE and not name.startswith("estimators"):
            raise NotTraceable(f"it imports {name} while it runs: import it before {place}")
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            more, others = _read(inner, outside)
            names, variables = names | more, variables + others
    return names, list(dict(variables).items())


def _root(module: str | None) -> str:
    """The package of a module."""
    return str(module).partition(".")[0]


def _visible(kind: type) -> bool:
    """Is all that an object of a class knows in its attributes?"""
    if not (kind.__flags__ & _HEAPTYPE or kind is SimpleNamespace) or kind.__module__ in ("random", "threading"):
        return False
    for base in kind.__mro__[:-1]:
        if base in (tuple, list, dict, SimpleNamespace):
            continue
        new = base.__new__
        if not base.__flags__ & _HEAPTYPE or (isinstance(new, _new_type) and getattr(new, "__self__", None) is base):
            return False
    return True
