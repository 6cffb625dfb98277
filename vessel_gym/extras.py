"""Optional modules, and the command that installs each."""

from importlib.util import find_spec

EXTRAS = {
    "train": ("torch", "stable_baselines3", "sb3_contrib"),
    "report": ("matplotlib", "jinja2", "joblib", "markdown_it", "pandas", "pyarrow"),
    "render": ("pygame", "imageio", "imageio_ffmpeg", "PIL"),
    "cluster": ("dask", "distributed"),
}
"""Modules by the extra that brings them, as in pyproject.toml; extras may share modules."""


def require(*modules: str) -> None:
    """Check that optional modules are installed, before their import.

    Raises:
        ModuleNotFoundError: for a module that is not installed, with the command that installs it.
    """
    for module in modules:
        if not _installed(module):
            raise ModuleNotFoundError(missing(module), name=module)


def missing(module: str | None) -> str | None:
    """Sentence about a module that is not installed; None if it belongs to no extra."""
    name = (module or "").partition(".")[0]
    for extra, modules in EXTRAS.items():
        if name in modules:
            return f"this needs {name}, which is not installed: pip install 'vessel-gym[{extra}]'"
    return None


def _installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):  # an import hook forbids the module, or it has no spec
        return False
