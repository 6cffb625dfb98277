"""Compiled kernels, cached on disk, safe when many processes start at once."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock
from numba import guvectorize, njit


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
            return guvectorize([signature], layout, nopython=True, cache=True)(kernel).ufunc

    return decorate


inlined = njit(cache=True, forceinline=True, error_model="numpy")
"""Compile a function into the kernels that call it, without tests for zero divisors: loops over it can then be
compiled to vector instructions. Numba's cache knows a kernel's own file only: after a change to a function that
another file's kernels inline, `make clean`."""


@inlined
def sincos(angle: float) -> tuple[float, float]:
    """Sine and cosine, to the last digit for angles up to 1e6 rad.

    Without a branch, so that loops over it can be compiled to vector instructions, which with the library's functions
    they cannot. Whole quarters of a turn are taken off in three parts (Cody & Waite); the polynomials for what is left
    are those of fdlibm (Sun Microsystems, 1993).
    """
    quarters = np.floor(angle * 0.6366197723675814 + 0.5)
    x = angle - quarters * 1.5707963267341256 - quarters * 6.077100506303966e-11 - quarters * 2.0222662487959506e-21
    x = 0.786 if x > 0.786 else (-0.786 if x < -0.786 else x)  # angles without an accurate digit stay bounded
    z = x * x
    sine = x + x * z * (
        -1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
        + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))))
    )  # fmt: skip
    cosine = 1.0 - 0.5 * z + z * z * (
        4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05
        + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))))
    )  # fmt: skip
    quarter = quarters - 4.0 * np.floor(0.25 * quarters)
    odd = quarter == 1.0 or quarter == 3.0
    s, c = cosine if odd else sine, sine if odd else cosine
    return -s if quarter >= 2.0 else s, -c if quarter == 1.0 or quarter == 2.0 else c


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
