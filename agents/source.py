"""Digest of the source code that a result depends on."""

import ast
import hashlib
import sysconfig
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec, resolve_name
from itertools import accumulate
from pathlib import Path

_WHOLE = ("estimators", "vessel_gym")
"""Packages that count as a whole, because environments and filters are found there by name."""


@cache
def source_digest(module: str) -> str:
    """SHA-256 of the source files that a module computes with.

    These are the module itself, what it imports of its own package and of whatever is not
    installed, what these import in turn, and all of `estimators` and `vessel_gym` with the files of
    their vehicles. What is installed is known by its version. An import by a name that is put
    together at run time is not seen.

    Args:
        module: Its dotted name.

    Raises:
        ValueError: if there is no such module.
    """
    if _spec(module) is None:
        raise ValueError(f"there is no module {module}")
    files = set(_closure(module, module.partition(".")[0], {}).values())
    for package in _WHOLE:
        spec = _spec(package)
        assert spec is not None
        for root in map(Path, spec.submodule_search_locations or ()):
            files |= {*root.rglob("*.py"), *root.rglob("*.toml")}
    contents = sorted(hashlib.sha256(path.read_bytes()).digest() for path in files)
    return hashlib.sha256(b"".join(contents)).hexdigest()


def _closure(module: str, package: str, found: dict[str, Path]) -> dict[str, Path]:
    """Add the source files of a module and of what it imports to those found, by module name."""
    spec, top = _spec(module), module.partition(".")[0]
    if module in found or top in _WHOLE or spec is None or not spec.has_location:
        return found
    path = Path(spec.origin or "")
    if top != package and _is_installed(path):
        return found
    found[module] = path
    with suppress(SyntaxError, ValueError):  # of compiled code
        tree = ast.parse(path.read_bytes())
        parent = module if spec.submodule_search_locations else module.rpartition(".")[0]
        for name in _imported(tree, parent):
            _closure(name, package, found)
    return found


def _imported(tree: ast.Module, parent: str) -> Iterator[str]:
    """Dotted names that a module imports, anywhere in it; names from a module may be modules."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from accumulate(alias.name.split("."), "{}.{}".format)
        elif isinstance(node, ast.ImportFrom):
            module = resolve_name("." * node.level + (node.module or ""), parent)
            yield from (module, *(f"{module}.{alias.name}" for alias in node.names))


def _is_installed(path: Path) -> bool:
    return bool({"site-packages", "dist-packages"} & set(path.parts)) or path.is_relative_to(
        sysconfig.get_path("stdlib")
    )


def _spec(module: str) -> ModuleSpec | None:
    """Specification of a module, for which nothing is imported; None if there is no such module."""
    package = module.rpartition(".")[0]
    if not package:
        return find_spec(module)
    above = _spec(package)
    places = above and above.submodule_search_locations
    return PathFinder.find_spec(module, places) if places else None
