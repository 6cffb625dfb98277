"""Which code a result depends on."""

import ast
import hashlib
from functools import cache
from importlib.util import find_spec, resolve_name
from pathlib import Path

import estimators
import vessel_gym

_AROUND = ("agents.cells", "agents.reproduction.comparison")
"""Modules that keep or show results and compute none: a change there leaves the results as they are."""


@cache
def source_digest(module: str) -> str:
    """SHA-256 of the code that a module computes with.

    That is the module itself, what it imports of its own package and what these import in turn, and all of
    `estimators` and `vessel_gym`, because environments are found there by name; not pictures, nor what keeps results.

    Args:
        module: Its dotted name.

    Raises:
        ValueError: if there is no such module.
    """
    digest = hashlib.sha256()
    for package in (estimators, vessel_gym):
        root = Path(package.__file__ or "").parent
        for path in sorted(root.rglob("*.py")):
            name = path.relative_to(root)
            if name.parts[0] != "rendering":
                digest.update(name.as_posix().encode() + b"\0" + path.read_bytes())
    for imported, path in sorted(_closure(module, module.partition(".")[0], {}).items()):
        digest.update(imported.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _closure(module: str, package: str, found: dict[str, Path]) -> dict[str, Path]:
    """The source files of a module and of what it imports of a package, by module name."""
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        raise ValueError(f"there is no module {module}")
    found[module] = Path(spec.origin)
    for name in sorted(_imported(ast.parse(found[module].read_bytes()), spec.parent or "")):
        known = name in found or name in _AROUND
        if name.partition(".")[0] == package and not known and _is_module(name):
            _closure(name, package, found)
    return found


def _imported(tree: ast.AST, parent: str) -> set[str]:
    """Dotted names that a module imports, anywhere in it; names from a module may be modules themselves."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = resolve_name("." * node.level + (node.module or ""), parent)
            names |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return names


def _is_module(name: str) -> bool:
    try:
        spec = find_spec(name)
    except (ImportError, AttributeError):
        return False
    return spec is not None and spec.origin is not None and spec.origin.endswith(".py")
