"""Compiled kernels, cached on disk, safe when many processes start at once."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from filelock import FileLock
from numba import guvectorize


def gufunc(signature: str, layout: str) -> Callable[[Callable[..., None]], Any]:
    """Compile a scalar kernel to a NumPy generalised ufunc, once for all processes.

    Numba caches a gufunc as two files, kernel and wrapper. Processes that compile the same one
    at the same time mix theirs, and every later process that loads such a pair crashes: so only one
    compiles, and the others wait and load.

    Args:
        signature: Numba's, e.g. ``"void(float64[:], float64[:])"``.
        layout: NumPy's, e.g. ``"(n)->(n)"``.
    """

    def decorate(kernel: Callable[..., None]) -> Any:
        with FileLock(_lock_file()):
            return guvectorize([signature], layout, nopython=True, cache=True)(kernel)

    return decorate


def _lock_file() -> Path:
    """Beside the cache where that can be written: machines that share the one share the other."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen) if chosen else Path(__file__).parent / "__pycache__"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir())
    if not os.access(folder, os.W_OK):
        folder = Path(tempfile.gettempdir())
    return folder / "vessel-gym-compiling.lock"
