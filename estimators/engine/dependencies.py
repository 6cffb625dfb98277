"""Objects that a Python function reads besides its arguments, and a check whether any has changed since.

A traced function is a constant: it must run anew in NumPy, or be traced anew, once a global, a
closure's variable, an attribute or the contents of an array that it reads are others.
"""

import builtins
import dis
import functools
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copyreg import _HEAPTYPE  # type: ignore[attr-defined]
from dataclasses import is_dataclass
from enum import Enum, EnumMeta
from operator import getitem, length_hint
from types import (
    BuiltinFunctionType,
    CodeType,
    FunctionType,
    MethodType,
    ModuleType,
    SimpleNamespace,
)
from typing import Any

import numpy as np

from estimators.engine.compiled import Compiled, _Methods
from estimators.engine.snapshot import Snapshot
from estimators.engine.tracer import NotTraceable

_LARGEST = 1 << 18  # bytes of arrays of a function that are compared at every call
_SMALL = 4096  # of those arrays that are read-only
_MOST = 3_000  # objects of one
_PURE = frozenset(("numpy", "scipy", "math", "cmath", "operator", "_operator", "functools", "_functools", "itertools",
                   "collections", "dataclasses", "enum", "typing", "types", "abc", "numbers", "copy", "contextlib",
                   "builtins", "fractions", "decimal", "bisect", "re", "difflib"))  # fmt: skip
"""Packages whose functions depend on their arguments alone, but for `numpy.random`."""
_FIXED = frozenset(("estimators", "vessel_gym"))
"""Packages whose code stays, and whose objects keep their attributes: a user's among these are compared."""
_IMPURE = frozenset(("print", "open", "input", "eval", "exec", "compile", "globals", "locals", "id", "breakpoint",
                     "setattr", "delattr", "__import__"))  # fmt: skip
_ALL = frozenset(
    ("__dict__", "vars", "dir", "getattr", "attrgetter", "__getattribute__", "__getattr__")
)
"""Names by which a function may read any attribute."""
_UNUSED = frozenset(("__repr__", "__str__", "__format__", "__reduce__", "__reduce_ex__", "__getstate__",
                     "__setstate__", "__del__", "__delattr__", "__copy__", "__deepcopy__", "__doc__", "__sizeof__",
                     "__dir__", "__init_subclass__", "__class_getitem__", "__subclasshook__"))  # fmt: skip
_SIMPLE = frozenset(
    (float, type(None), bool, int, str, bytes, complex, type(Ellipsis), slice, range)
)
_CONTAINERS = tuple, list, dict, SimpleNamespace
_PARTS: dict[Any, tuple[str, ...]] = {
    MethodType: ("__func__", "__self__"), functools.partial: ("func", "args", "keywords"), property: ("fget",),
    staticmethod: ("__func__",), classmethod: ("__func__",), functools.cached_property: ("func",),
    functools._lru_cache_wrapper: ("__wrapped__",), Compiled: ("function", "_axes", "_matrices"),
}  # fmt: skip
"""Objects that read nothing but these attributes of theirs, which are always the same."""
_SLOTS = (
    "member_descriptor",
    "getset_descriptor",
    "_tuplegetter",
)  # what an object has itself, by its class
_BUILDING = frozenset(("__init__", "__new__", "__post_init__", "__setattr__", "__delattr__"))


class Dependencies:
    """Globals, closures, attributes, defaults and contents of arrays that functions read, as they are now.

    Raises:
        NotTraceable: if a function changes something, or reads what cannot be compared.
    """

    def __init__(self, *functions: Callable[..., Any]) -> None:
        self._functions = functions
        self._keep(_walked(functions))

    def _keep(self, walk: "_Walk") -> None:
        """Keep all that was met."""
        self._leaves, self._snapshot = walk.leaves, Snapshot(walk.watched.values(), walk.arrays)

    def unchanged(self) -> bool:
        """Is everything that they read as it was?"""
        return self._snapshot.holds() or self._equal()

    def _equal(self) -> bool:
        """Are other objects in their places equal to them?"""
        try:
            walk = _walked(self._functions)
        except (NotTraceable, RecursionError):
            return False
        if walk.leaves != self._leaves:
            return False
        self._keep(walk)
        return True


def _walked(functions: Sequence[Callable[..., Any]]) -> "_Walk":
    """All that functions read; attributes count by their names, which are known when all their code has been seen."""
    names: frozenset[str] = frozenset()
    while True:
        walk = _Walk(names, len(functions))
        for function in functions:
            walk.value(function, getattr(function, "__name__", "it"))
        if walk.mentioned <= names:
            return walk
        names |= walk.mentioned


class _Walk:
    """One walk through the objects that so many functions can reach."""

    def __init__(self, names: frozenset[str], functions: int = 1) -> None:
        self.names, self.mentioned, self._most, self._largest = (
            names,
            set[str](),
            _MOST * functions,
            _LARGEST * functions,
        )
        self.watched: dict[Any, tuple[Callable[[Any, Any], Any], Any, Any, Any]] = {}
        self.arrays: list[tuple[np.ndarray, bytes]] = []
        self.leaves: list[Any] = []  # everything by value, in order
        self._met: dict[tuple[int, bool], tuple[int, Any]] = {}
        self._classes = set[tuple[type, frozenset[str]]]()
        self._bytes = 0
        self._fixed = False  # is what is met a part of code that stays as it is?

    def value(self, value: Any, what: str) -> None:
        """An object that is read, under a name for the sentence of a refusal."""
        kind = type(value)
        if kind in _SIMPLE or isinstance(value, np.generic | np.dtype):
            self.leaves.append((kind, repr(value)))
        elif (key := (id(value), self._fixed)) in self._met:
            self.leaves.append(self._met[key][0])
        else:
            self._met[key] = len(self._met), value
            if len(self._met) > self._most:
                raise NotTraceable(
                    f"it reads too many objects to compare them at every call, {what} among them"
                )
            self.leaves.append(kind)
            self._object(value, kind, what)

    def _object(self, value: Any, kind: type, what: str) -> None:
        parts = next((names for base, names in _PARTS.items() if isinstance(value, base)), None)
        if parts is not None:
            for name in parts:
                self.value(getattr(value, name), what)
        elif isinstance(value, np.ndarray):
            self._array(value, what)
        elif isinstance(value, FunctionType):
            self._function(value)
        elif isinstance(value, ModuleType):
            self._module(value, what)
        elif isinstance(value, BuiltinFunctionType):
            self._builtin(value, what)
        elif isinstance(value, type):
            self._class(value, _UNUSED)
        elif isinstance(value, CodeType | frozenset | np.ufunc | Enum | type(np.sum) | _Methods):
            self.leaves.append(value)
        else:
            self._instance(value, kind, what)

    def _watch(
        self, read: Callable[[Any, Any], Any], holder: Any, key: Any, value: Any, stays: bool
    ) -> None:
        """Compare what is read from an object at every call, unless it stays as it is."""
        if not (self._fixed or stays):
            self.watched[read, id(holder), key] = read, holder, key, value

    def _item(self, holder: Any, key: Any, what: str, stays: bool = False) -> None:
        self._watch(getitem, holder, key, holder[key], stays)
        self.leaves.append(key)
        self.value(holder[key], what)

    def _attribute(self, holder: Any, name: str, what: str, stays: bool = False) -> None:
        try:
            found = getattr(holder, name)
        except (AttributeError, ValueError):  # a slot or a cell without contents
            self.leaves.append("empty")
            return
        self._watch(getattr, holder, name, found, stays)
        self.value(found, what)

    def _mapping(self, mapping: Any, what: str, every: bool, stays: bool = False) -> None:
        self._watch(length_hint, mapping, 0, len(mapping), stays)
        for name in list(mapping) if every else sorted(self.names & mapping.keys()):
            self._item(
                mapping,
                name,
                f"{what}.{name}" if isinstance(name, str) else f"{what}[{name!r}]",
                stays,
            )

    def _array(self, array: np.ndarray, what: str) -> None:
        if array.dtype.hasobject or type(array) is not np.ndarray:
            raise NotTraceable(
                f"it reads {what}, an array of a kind of its own, whose changes cannot be seen"
            )
        if not (array.flags.writeable or array.base is not None or array.nbytes <= _SMALL):
            self.leaves.append(("read-only", id(array)))
            return
        self._bytes += array.nbytes
        if self._bytes > self._largest:
            raise NotTraceable(f"it reads {what}, which is too large to compare it at every call: an array that never "
                               "changes is read-only by .flags.writeable = False")  # fmt: skip
        contents = array.tobytes()
        if not self._fixed:
            self.arrays.append((array, contents))
        self.leaves.append((array.shape, array.dtype.str, contents))

    def _function(self, function: FunctionType) -> None:
        if _root(function.__module__) in _PURE or str(function.__module__).startswith(
            "estimators.engine"
        ):
            self.leaves.append(function)
            return
        code, namespace = function.__code__, function.__globals__
        for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            if name == "__class__":  # of super(), which builds nothing
                self._class(cell.cell_contents, _UNUSED | _BUILDING)
            else:
                self._attribute(cell, "cell_contents", name, _root(function.__module__) in _FIXED)
        names, variables = _read(code)
        with self._code_of(function.__module__):
            self.mentioned |= names - _ALL if self._fixed else names
            for name in ("__code__", "__defaults__", "__kwdefaults__"):
                if getattr(function, name) is not None:
                    self._attribute(function, name, f"the defaults of {function.__name__}")
            for name, line in variables:
                if name in namespace:
                    self._item(namespace, name, name)
                elif name in _IMPURE:
                    raise NotTraceable(
                        f"it calls {name}(), which has to happen at every call {line}"
                    )
                else:
                    self._watch(length_hint, namespace, 0, len(namespace), False)
                    self.leaves.append(getattr(builtins, name, "missing"))
            self._mapping(function.__dict__, function.__name__, every=bool(_ALL & self.names))

    @contextmanager
    def _code_of(self, module: str | None, fixed: bool = False) -> Iterator[None]:
        """Mark a scope as part of the code of a module."""
        before, self._fixed = self._fixed, fixed or _root(module) in _FIXED
        yield
        self._fixed = before

    def _module(self, module: ModuleType, what: str) -> None:
        root = _root(module.__name__)
        if root == "numpy" and (
            module.__name__.startswith("numpy.random") or "random" in self.names
        ):
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

    def _class(self, kind: type, unused: frozenset[str]) -> None:
        self.leaves.append(kind)
        if (kind, unused) in self._classes:
            return
        self._classes.add((kind, unused))
        for each in kind.__mro__:
            if _root(each.__module__) in sys.stdlib_module_names or _root(each.__module__) in _PURE:
                continue
            own = vars(each)
            special = (
                name
                for name in own
                if name.startswith("__") and isinstance(own[name], FunctionType)
            )
            with self._code_of(each.__module__, isinstance(each, EnumMeta)):
                self._watch(length_hint, own, 0, len(own), False)
                for name in sorted((self.names & own.keys()).union(special) - unused):
                    comparison = name in ("__eq__", "__hash__") and is_dataclass(
                        each
                    )  # of all fields, read or not
                    if (
                        type(own[name]).__name__ not in _SLOTS
                        and name != "__dict__"
                        and not comparison
                    ):
                        self._item(own, name, f"{each.__name__}.{name}")

    def _instance(self, value: Any, kind: type, what: str) -> None:
        if isinstance(value, tuple):
            for i, each in enumerate(value):
                self.value(each, f"{what}[{i}]")
        elif isinstance(value, list):
            self._watch(length_hint, value, 0, len(value), False)
            for i in range(len(value)):
                self._item(value, i, f"{what}[{i}]")
        elif isinstance(value, dict):
            self._mapping(value, what, every=True)
        elif not _visible(kind):
            raise NotTraceable(
                f"it reads {what}, a {kind.__module__}.{kind.__qualname__}, whose changes cannot be"
                " seen"
            )
        if kind in (tuple, list, dict):
            return
        self._class(kind, _UNUSED | _BUILDING)
        if (own := getattr(value, "__dict__", None)) is not None:
            every = (
                _root(kind.__module__) in _PURE
                or bool(_ALL & self.names)
                or hasattr(kind, "__getattr__")
            )
            stays = getattr(
                vars(kind).get("__dataclass_params__"), "frozen", _root(kind.__module__) in _FIXED
            )
            self._watch(getattr, value, "__dict__", own, stays)
            self._mapping(
                own, what, every, stays
            )  # attributes that code names, or all where that is not known
        for each in kind.__mro__:
            for name in sorted(
                k for k, v in vars(each).items() if type(v).__name__ == "member_descriptor"
            ):
                self._attribute(value, name, f"{what}.{name}")


@functools.lru_cache(1024)
def _read(
    code: CodeType, outside: frozenset[str] | None = None
) -> tuple[set[str], list[tuple[str, str]]]:
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
                f"it changes the variable {name}, which outlives the call: return it as a result"
                f" {place}"
            )
        elif each.opname in ("STORE_ATTR", "DELETE_ATTR") and code.co_name not in _BUILDING:
            raise NotTraceable(
                f"it changes the attribute .{name}: return it as a result instead {place}"
            )
        elif (
            each.opname == "IMPORT_NAME"
            and _root(name) not in _PURE
            and not name.startswith("estimators")
        ):
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
    return kind.__module__ not in ("random", "threading") and all(
        base in _CONTAINERS
        or (base.__flags__ & _HEAPTYPE and getattr(base.__new__, "__self__", None) is not base)
        for base in kind.__mro__[:-1]
    )
