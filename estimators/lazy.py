"""Public names of a package, each imported from its module at first use."""

import ast
from collections.abc import Callable
from importlib import import_module
from pkgutil import get_data
from typing import Any


def public_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package, from the imports in its stub.

    The stub ``__init__.pyi`` is what type checkers read; so each name is written once. The idiom is
    that of SPEC 1 of Scientific Python.
    """
    modules = {
        name.name: str(node.module)
        for node in ast.parse(get_data(package, "__init__.pyi") or b"").body
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }

    def attribute(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(modules[name]), name)

    return attribute, lambda: [*modules], [*modules]
