"""Modules that are installed on request only, and the line that installs each."""

from importlib.util import find_spec

EXTRAS = {
    "train": ("torch", "stable_baselines3", "sb3_contrib"),
    "report": ("matplotlib", "jinja2", "joblib", "pandas", "pyarrow"),
    "render": ("pygame", "imageio", "imageio_ffmpeg", "PIL"),
    "cluster": ("dask", "distributed"),
}
"""Modules by the extra that brings them, as in pyproject.toml; some come with others, too."""


def require(*modules: str) -> None:
    """Ask for modules of an extra before they are imported.

    Raises:
        ModuleNotFoundError: if one is not installed, with the line that installs it.
    """
    for module in modules:
        if not _installed(module):
            raise ModuleNotFoundError(missing(module), name=module)


def missing(module: str | None) -> str | None:
    """Sentence about a module that is not installed; None if no extra brings it."""
    name = (module or "").partition(".")[0]
    for extra, modules in EXTRAS.items():
        if name in modules:
            return f"this needs {name}, which is not installed: pip install 'vessel-gym[{extra}]'"
    return None


def _installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):  # somebody forbids it, or has made one up
        return False
