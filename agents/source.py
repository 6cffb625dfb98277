"""Digest of the source code that a result depends on."""

import ast
import hashlib
import sysconfig
from functools import cache
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, resolve_name
from pathlib import Path
from typing import Any

_AROUND = ("agents.jobs",)
"""Modules that keep results and compute none: a change there leaves the results as they are."""
_WHOLE = ("estimators", "vessel_gym")
"""Packages that count as a whole,"""
_SEEN = ("rendering", "surroundings.py")
"""but for what is only looked at."""
_SCENE = "vessel_gym.rendering.scene"
"""Counts for the modules that import it: they keep what a page shows."""


_INSTALLED = tuple(
    {Path(folder).resolve() for folder in sysconfig.get_paths().values() if folder}
    - {Path(sysconfig.get_path(name)).resolve() for name in ("data", "scripts")}
)
"""Folders of Python and of installed packages."""


@cache
def source_digest(module: str) -> str:
    """SHA-256 of the code that a module computes with: what Python makes of it, without comments and docstrings.

    That is the module itself, what it imports of its own package, of ours and of whatever is not
    installed, what these import in turn, and all of `estimators` and `vessel_gym`, because
    environments are found there by name, with the files of their vehicles; not pictures, nor what
    keeps results. What is imported by a name that is put together at run time is not seen.

    Args:
        module: Its dotted name.

    Raises:
        ValueError: if there is no such module.
    """
    digest = hashlib.sha256()
    for package in _WHOLE:
        entry = _source(package)  # it is not imported: filters take a quarter of a second
        assert entry is not None
        root = entry.parent
        for path in sorted((*root.rglob("*.py"), *root.rglob("*.toml"))):
            name = path.relative_to(root)
            if name.parts[0] not in _SEEN:
                digest.update(name.as_posix().encode() + b"\0" + _code(path.read_bytes()))
    for imported, path in sorted(_closure(module, module.partition(".")[0], {}).items()):
        digest.update(imported.encode() + b"\0" + _code(path.read_bytes()))
    return digest.hexdigest()


@cache
def _code(source: bytes) -> bytes:
    """Syntax tree of a source without comments and docstrings; the bytes themselves of what is no source."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return source
    blocks: list[Any] = [
        tree
    ]  # statements alone, as expressions are most of a tree and have no docstring
    for node in blocks:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = node.body[ast.get_docstring(node, clean=False) is not None :]
        for name in ("body", "handlers", "cases", "orelse", "finalbody"):
            blocks += getattr(node, name, ())
    return ast.dump(tree).encode()


def _closure(module: str, package: str, found: dict[str, Path]) -> dict[str, Path]:
    """The source files of a module and of what it imports of what counts, by module name."""
    path = _source(module)
    if path is None:
        raise ValueError(f"there is no module {module}")
    found[module] = path
    package_of = module if path.stem == "__init__" else module.rpartition(".")[0]
    for name in sorted(_imported(path.read_bytes(), package_of)):
        known = name in found or name.startswith(_AROUND)
        counts = name == _SCENE or _counts(name.partition(".")[0], package)
        if not known and counts and _source(name) is not None:
            _closure(name, package, found)
    return found


@cache
def _counts(top: str, package: str) -> bool:
    """True for a top-level package that results may depend on: the same one, ours, or the user's own.

    Installed packages are not looked into: to look for a module in one imports it.
    """
    if top in (*_WHOLE, package, __name__.partition(".")[0]):
        return top not in _WHOLE
    spec = _spec(top)
    places = (
        []
        if spec is None
        else [spec.origin]
        if spec.has_location
        else spec.submodule_search_locations or []
    )
    return any(
        place is not None
        and not any(Path(place).resolve().is_relative_to(each) for each in _INSTALLED)
        for place in places
    )


def _imported(source: bytes, parent: str) -> set[str]:
    """Dotted names that a module imports, anywhere in it; names from a module may be modules themselves."""
    names: set[str] = set()
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return names  # compiled code
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and (parent or not node.level):
            module = resolve_name("." * node.level + (node.module or ""), parent)
            names |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return names | {
        package for name in names if not name.startswith("agents.") for package in _packages(name)
    }


def _packages(module: str) -> list[str]:
    """The packages that a module lies in: they are run before it. Ours do nothing then."""
    parts = module.split(".")
    return [".".join(parts[:n]) for n in range(1, len(parts))]


def _source(module: str) -> Path | None:
    """The file of a module; None if there is no such module, or it has no file."""
    spec = _spec(module)
    return (
        Path(spec.origin).resolve()
        if spec is not None and spec.has_location and spec.origin
        else None
    )


def _spec(module: str) -> ModuleSpec | None:
    """Specification of a module; None if there is none, as below a module that is no package."""
    package = module.rpartition(".")[0]
    if package:
        above = _spec(package)  # to look for a module imports what it lies in
        if above is None or above.submodule_search_locations is None:
            return None
    try:
        return find_spec(module)
    except (ImportError, AttributeError, ValueError):
        return None
