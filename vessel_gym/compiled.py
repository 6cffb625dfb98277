"""Compiled kernels, cached on disk, safe when many processes start at once."""

import atexit
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from numba import guvectorize, njit
from numba.core import config, event

_PATIENCE = 2.0  # seconds; whoever only loads kernels holds the lock for less


def gufunc(signature: str, layout: str) -> Callable[[Callable[..., None]], Any]:
    """Compile a scalar kernel to a NumPy generalised ufunc, once for all processes; who compiles says so once.

    Numba caches a gufunc as two files, kernel and wrapper. Processes that compile the same one
    at the same time mix theirs, and every later process that loads such a pair crashes: so only one
    compiles, and the others wait and load.

    Args:
        signature: Numba's, e.g. ``"void(float64[:], float64[:])"``.
        layout: NumPy's, e.g. ``"(n)->(n)"``.
    """

    def decorate(kernel: Callable[..., None]) -> Any:
        with _alone(), event.install_listener("numba:run_pass", _Announcement()):
            return guvectorize([signature], layout, nopython=True, cache=True)(kernel).ufunc

    return decorate


class _Announcement(event.Listener):
    """Tells of the first pass of a compiler in this process; a kernel that is loaded needs none."""

    def on_start(self, event: Any) -> None:
        _say("compiling its equations, this once: it takes some 20 s")

    def on_end(self, event: Any) -> None:
        """Nothing to tell."""


@contextmanager
def _alone() -> Iterator[None]:
    """No other process compiles meanwhile."""
    lock = FileLock(_FOLDER / "vessel-gym-compiling.lock")
    try:
        lock.acquire(timeout=_PATIENCE)
    except Timeout:
        _say("waiting for another process, which compiles its equations")
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


@cache
def _say(text: str) -> None:
    """Once to whoever waits at a terminal; stdout belongs to the results."""
    if sys.stderr is not None:
        print(f"vessel_gym: {text}", file=sys.stderr, flush=True)


def _cache_folder() -> Path:
    """Where Numba keeps kernels: beside the code, else in the user's home, else in a temporary folder of the user's."""
    try:
        return _numbas_folder()
    except RuntimeError:  # neither can be written
        config.CACHE_DIR = str(_private_folder())  # type: ignore[attr-defined]  # which Numba sets by name
        return _numbas_folder()


def _numbas_folder() -> Path:
    """Where Numba keeps the kernels of this file."""

    def probe() -> None:
        """Never compiled."""

    return Path(str(njit(cache=True)(probe).stats.cache_path))


def _private_folder() -> Path:
    """A temporary folder that nobody else can write to: what is cached there is executed.

    The same in every process of a user; but if somebody else has taken its name, a new one that goes with the process.
    """
    user = os.getuid() if hasattr(os, "getuid") else None  # None: each user has a place for temporaries, as on Windows
    folder = Path(tempfile.gettempdir()) / f"vessel-gym-{user}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if user is None or (stat.S_ISDIR(found.st_mode) and found.st_uid == user and not found.st_mode & 0o022):
            return folder
    except OSError:
        pass
    folder = Path(tempfile.mkdtemp(prefix="vessel-gym-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


_FOLDER = _cache_folder()

inlined = njit(forceinline=True, error_model="numpy")
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
