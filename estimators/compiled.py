"""Compiled kernels: compiled when they are first called, cached on disk, safe when many processes start at once."""

import atexit
import gc
import json
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial, update_wrapper
from hashlib import sha256
from pathlib import Path
from threading import Lock
from time import time
from typing import Any

import numba
import numpy as np
from filelock import FileLock, Timeout
from llvmlite import ir
from numba import guvectorize, njit, types
from numba.core import cgutils, config, event
from numba.extending import intrinsic

_PATIENCE = 2.0  # seconds; whoever only loads kernels holds the lock for less
_PAUSE, _FORGOTTEN = 10.0, 600.0  # seconds between two lines of progress, and after which a number is another command's
_KEPT = 4  # folders of kernels; older ones are those of sources that have changed since

_settings: dict[str, Any] = vars(config)  # Numba's
_options: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}  # one is a tenth of the compilation

_Function = Callable[..., Any]
_compiling = Lock()
"""Held by the thread that compiles."""


def gufunc(signature: str, layout: str, cache: bool = True) -> Callable[[_Function], Any]:
    """Compile a scalar kernel to a NumPy generalised ufunc, `lazy`.

    Args:
        signature: Numba's, e.g. ``"void(float64[:], float64[:])"``.
        layout: NumPy's, e.g. ``"(n)->(n)"``.
        cache: Whether to keep it on disk.
    """
    return lazy(lambda kernel: guvectorize([signature], layout, nopython=True, cache=cache)(kernel).ufunc)


def rowwise(*signatures: str, cache: bool = True) -> Callable[[_Function], Any]:
    """Compile a function of arrays of rows for Numba's signatures, `lazy`: faster than a ufunc, which checks shapes.

    Args:
        signatures: As many as there are kinds of arguments.
        cache: Whether to keep it on disk.
    """
    return lazy(njit(list(signatures), nogil=True, cache=cache, **_options))


def lazy(compiler: Callable[[_Function], _Function]) -> Callable[[_Function], Any]:
    """Compile a function when it is first called, once for all processes; a command that compiles says so once.

    Numba caches a kernel as several files. Processes that compile the same one at the same time mix theirs, and every
    later process that loads such files crashes: so only one compiles, and the others wait and load.

    Args:
        compiler: Compiles a function, all of it at once; what it caches lies in our folder.
    """

    def decorate(function: _Function) -> Any:
        def first(*args: Any, **kwargs: Any) -> Any:
            with _compiling, _alone(), event.install_listener("numba:run_pass", _Announcement()):
                if kernel.func is first:  # no other thread has done it meanwhile
                    kernel.__setstate__((compiler(function), (), {}, kernel.__dict__))
            return kernel(*args, **kwargs)

        kernel: Any = update_wrapper(_Kernel(first), function)
        return kernel

    return decorate


class _Kernel(partial[Any]):
    """What calls a function that can be exchanged, in C: a method of Python's would cost several times as much."""

    def __reduce__(self) -> str:
        return str(vars(self)["__qualname__"])  # pickles find it in its module


class _Announcement(event.Listener):
    """Tells of the first pass of the compiler over a kernel; one that is loaded needs none."""

    def __init__(self) -> None:
        self._told = False

    def on_start(self, event: Any) -> None:
        if not self._told:
            self._told = True
            _tell(_current(_folder()) / "told")

    def on_end(self, event: Any) -> None:
        """Nothing to tell."""


def _tell(path: Path) -> None:
    """Say once a command that it compiles, and every ten seconds how far it is: its processes share what was told."""
    command, now = os.getpgrp() if hasattr(os, "getpgrp") else os.getpid(), time()
    count, begun, told = 0, now, now
    try:
        who, *before = json.loads(path.read_text())
        if who == command and now < before[-1] + _FORGOTTEN:
            count, begun, told = before
    except (OSError, ValueError, TypeError):
        pass  # nothing was told
    if count == 0:
        _say(f"compiling once, about half a minute for each environment; kept in {_folder()}")
    elif now >= told + _PAUSE:
        told = now
        _say(f"compiling, {count} kernels in {now - begun:.0f} s")
    with suppress(OSError):
        path.write_text(json.dumps([command, count + 1, begun, told]))


@contextmanager
def _alone() -> Iterator[None]:
    """No other process compiles meanwhile, Numba's cache is our folder, and no garbage is collected: a tenth faster."""
    lock = FileLock(_folder() / "lock")
    try:
        lock.acquire(timeout=_PATIENCE)
    except Timeout:
        _say("waiting for another process, which compiles")
        lock.acquire()
    chosen, collecting = _settings["CACHE_DIR"], gc.isenabled()
    gc.disable()
    try:
        _settings["CACHE_DIR"] = str(_current(_folder()))
        yield
    finally:
        _settings["CACHE_DIR"] = chosen
        if collecting:
            gc.enable()
        lock.release()


@cache
def _say(text: str) -> None:
    """Once to whoever waits at a terminal; stdout belongs to the results."""
    if sys.stderr is not None:
        print(f"vessel-gym: {text}", file=sys.stderr, flush=True)


@cache
def _current(folder: Path) -> Path:
    """Where the kernels of these sources are, beside those of others, of which only the last are kept.

    Numba itself knows only the file that a kernel stands in, not those of functions that are compiled into it.
    """
    digest = sha256(f"{sys.version} {np.__version__} {numba.__version__}".encode())
    for package in ("estimators", "vessel_gym"):
        for path in sorted(Path(__file__).parents[1].joinpath(package).rglob("*.py")):
            source = path.read_bytes()
            if b"numba" in source or b"estimators.compiled" in source:
                digest.update(source)
    current = folder / digest.hexdigest()[:16]
    current.mkdir(exist_ok=True)
    os.utime(current)
    for old in sorted((each for each in folder.iterdir() if each.is_dir()), key=os.path.getmtime)[:-_KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return current


@cache
def _folder() -> Path:
    """Where kernels are kept: where Numba is told to, beside the code, in the user's home or among temporary files."""
    for place in _places():
        if os.path.isabs(place) and (folder := _own(Path(place))):
            return folder
    folder = Path(tempfile.mkdtemp(prefix="vessel-gym-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _places() -> Iterator[str]:
    if _settings["CACHE_DIR"]:
        yield os.path.abspath(_settings["CACHE_DIR"])
    yield os.path.abspath(os.path.join(os.path.dirname(__file__), "__pycache__"))
    yield os.environ.get("XDG_CACHE_HOME", "")
    yield os.path.expanduser("~/.cache")
    yield tempfile.gettempdir()  # which is an error where nothing can be written, so it comes last


def _own(place: Path) -> Path | None:
    """A folder that the user can write to and nobody else, as what is cached there is executed; None if there is none.

    The same in every process of a user.
    """
    user = os.getuid() if hasattr(os, "getuid") else None  # None: folders are the user's own, as on Windows
    folder = place / f"vessel-gym-{user}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return None
    safe = user is None or (stat.S_ISDIR(found.st_mode) and found.st_uid == user and not found.st_mode & 0o022)
    return folder if safe else None


inlined = njit(forceinline=True, **_options)
"""Compile a function into the kernels that call it, without tests for zero divisors: loops over it can then be
compiled to vector instructions."""
part = njit(**_options)
"""Compile a function once for all that call it, where `inlined` would do so for each of them."""


@inlined
def sincos_near_zero(x: float) -> tuple[float, float]:
    """Sine and cosine of an angle within an eighth of a turn of 0, by the polynomials of fdlibm (Sun, 1993)."""
    z = x * x
    sine = x + x * z * (
        -1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
        + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))))
    )  # fmt: skip
    cosine = 1.0 - 0.5 * z + z * z * (
        4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05
        + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))))
    )  # fmt: skip
    return sine, cosine


@inlined
def sincos(angle: float) -> tuple[float, float]:
    """Sine and cosine, to the last digit for angles up to 1e6 rad.

    Without a branch, so that loops over it can be compiled to vector instructions, which with the library's functions
    they cannot. Whole quarters of a turn are taken off in three parts (Cody & Waite).
    """
    quarters = np.floor(angle * 0.6366197723675814 + 0.5)
    x = angle - quarters * 1.5707963267341256 - quarters * 6.077100506303966e-11 - quarters * 2.0222662487959506e-21
    x = 0.786 if x > 0.786 else (-0.786 if x < -0.786 else x)  # angles without an accurate digit stay bounded
    sine, cosine = sincos_near_zero(x)
    quarter = quarters - 4.0 * np.floor(0.25 * quarters)
    odd = quarter == 1.0 or quarter == 3.0
    s, c = cosine if odd else sine, sine if odd else cosine
    return -s if quarter >= 2.0 else s, -c if quarter == 1.0 or quarter == 2.0 else c


def _products(typing: Any, a: Any, b: Any, count: Any) -> Any:
    """Sum of the first ``count`` products of two vectors, a multiple of eight: eight partial sums, added by halves."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        eight = ir.VectorType(ir.DoubleType(), 8)
        vectors = zip(signature.args[:2], arguments[:2], strict=True)
        data = [context.make_array(kind)(context, builder, value).data for kind, value in vectors]
        sums, end = cgutils.alloca_once_value(builder, ir.Constant(eight, [0.0] * 8)), arguments[2]
        first, step = (ir.Constant(end.type, number) for number in (0, 8))
        with cgutils.for_range_slice(builder, first, end, step, inc=True) as (j, _):
            places = (builder.bitcast(builder.gep(numbers, [j]), eight.as_pointer()) for numbers in data)
            product = builder.fmul(*(builder.load(place, align=8) for place in places))
            builder.store(builder.fadd(builder.load(sums), product), sums)
        parts = [builder.extract_element(builder.load(sums), ir.Constant(ir.IntType(32), i)) for i in range(8)]
        while len(parts) > 1:
            half = len(parts) // 2
            parts = [builder.fadd(*pair) for pair in zip(parts[:half], parts[half:], strict=True)]
        return parts[0]

    return types.float64(a, b, types.intp), code


_summed: Any = intrinsic(_products)


@inlined
def dot(a: np.ndarray, b: np.ndarray) -> float:
    """``a . b`` of contiguous vectors, in an order of their products that is the same on every processor.

    The compiler keeps the order that it is told, and that of one sum would leave no vector instructions.
    """
    whole = len(a) // 8 * 8
    total: float = _summed(a, b, whole)
    for j in range(whole, len(a)):
        total += a[j] * b[j]
    return total
