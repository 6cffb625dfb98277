"""Digest of the source code that a result depends on."""

import hashlib
import sysconfig
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import find_spec
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any

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
    files = set(_sources(module).values())
    for package in _WHOLE:
        spec = find_spec(package)
        assert spec is not None
        for root in map(Path, spec.submodule_search_locations or ()):
            files |= {*root.rglob("*.py"), *root.rglob("*.toml")}
    contents = sorted(hashlib.sha256(path.read_bytes()).digest() for path in files)
    return hashlib.sha256(b"".join(contents)).hexdigest()


def _sources(module: str) -> dict[str, Path]:
    """Source files of a module and of what it imports, by the name of each module.

    Raises:
        ValueError: if there is no such module.
    """
    finder = _Finder(module.partition(".")[0])
    try:
        finder.import_hook(module)
    except ImportError:
        raise ValueError(f"there is no module {module}") from None
    found: dict[str, Any] = finder.modules
    return {name: Path(each.__file__) for name, each in found.items() if each.__file__}


class _Finder(ModuleFinder):
    """Finds modules of one package, and others that are neither installed nor in `_WHOLE`."""

    def __init__(self, package: str) -> None:
        super().__init__(excludes={*_WHOLE} - {package})
        self.package = package

    def find_module(self, name: str, path: Any, parent: Any = None) -> Any:
        spec = PathFinder.find_spec(name, path)
        if spec and not spec.loader:  # ModuleFinder cannot find packages without __init__.py
            return None, spec.submodule_search_locations, None
        return super().find_module(name, path, parent)

    def load_module(self, fqname: str, fp: Any, pathname: Any, file_info: Any) -> Any:
        if not file_info:
            found: Any = self.add_module(fqname)
            found.__path__ = [*pathname]
            return found
        if fqname.partition(".")[0] != self.package and _is_installed(pathname):
            raise ImportError(fqname)
        return super().load_module(fqname, fp, pathname, file_info)


def _is_installed(path: str | None) -> bool:
    """Is a module, at a path if it has one, Python's own or in a folder of packages?"""
    if path is None or {"site-packages", "dist-packages"} & {*Path(path).parts}:
        return True
    return Path(path).is_relative_to(sysconfig.get_path("stdlib"))
