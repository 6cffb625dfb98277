"""Machine code of LLVM IR, compiled once for a processor and kept on disk."""

import ctypes
import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from time import time
from typing import Any

import numpy as np

_KEPT = 90 * 86400.0  # seconds after their last use that objects are kept
OPTIMISED = os.environ.get("VESSEL_GYM_OPTIMISE") != "0"
"""Is code optimised? Otherwise it compiles seven times as fast, but batches are slower."""
_loaded: dict[bytes, int] = {}
_rooms: list[np.ndarray] = []


def load(code: bytes, emit: Callable[[str], str]) -> int:
    """Address of the function of a module.

    Objects are kept under the digest of the code, of this package and of the processor. Each is
    written under a unique name and then renamed, so processes that compile the same code need no
    lock.

    Args:
        code: All that the module depends on, apart from this package's sources. A process loads it
            once.
        emit: Function that returns the LLVM IR of a function with a given name; called if no object
            is kept.
    """
    key = sha256(code).digest()
    if key not in _loaded:
        engine, binding = linker()
        compiler = f"{OPTIMISED:d} {' '.join(_processor())} {_emitter()}"
        name = f"f{sha256(compiler.encode() + key).hexdigest()[:40]}"
        path = f"{folder()}/{name}.o"
        found = _kept(path)
        if found is None:
            found = _object(emit(name))
            _keep(path, found)
        engine.add_object_file(binding.ObjectFileRef.from_data(found))
        _loaded[key] = engine.get_function_address(name)
    return _loaded[key]


@cache
def linker() -> tuple[Any, Any]:
    """LLVM's engine, which keeps the machine code of this process, and its module."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    for symbol in _PYTHON:
        place = ctypes.c_byte.in_dll(ctypes.pythonapi, symbol)
        binding.add_symbol(symbol, ctypes.addressof(place))
    binding.add_symbol("PyArray_Empty", _numpy_functions()[_EMPTY])
    return binding.create_mcjit_compiler(binding.parse_assembly(""), _machine()), binding


_PYTHON = (
    "PyTuple_New", "PyTuple_GetItem", "PyTuple_SetItem", "PyObject_Vectorcall", "Py_IncRef",
    "Py_DecRef",
)  # fmt: skip
_EMPTY = 184
"""Place of ``PyArray_Empty`` in NumPy's table of C functions, on which extensions rely."""


def _object(text: str) -> bytes:
    """The object code of a module."""
    from llvmlite import binding

    _announce()
    machine = _machine()  # not the engine's, as one that has emitted keeps a megabyte
    module = binding.parse_assembly(text)
    if not OPTIMISED:
        return bytes(machine.emit_object(module))
    options = binding.create_pipeline_tuning_options(speed_level=1)
    options.loop_vectorization = options.slp_vectorization = options.loop_unrolling = False
    passes = binding.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    return bytes(machine.emit_object(module))


@cache
def _processor() -> tuple[str, ...]:
    """The compiler of objects, the system, the processor and its features."""
    import llvmlite
    from llvmlite import binding

    host = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    return llvmlite.__version__, binding.get_default_triple(), *host


@cache
def _emitter() -> str:
    """Digest of this package, which emits LLVM IR, and the size of the head of Python's objects."""
    sources = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    return f"{sha256(sources).hexdigest()} {object.__basicsize__}"


_emitter()  # at import: the files may change before the first program is compiled


def _machine() -> Any:
    """The processor as LLVM describes it; an execution engine owns its own and frees it."""
    from llvmlite import binding

    _, triple, name, features = _processor()
    # Not "pic": LLVM's linker takes all offsets from the table of the first object that has one.
    return binding.Target.from_triple(triple).create_target_machine(
        cpu=name, features=features, opt=1 if OPTIMISED else 0, reloc="static", jit=True
    )


@cache
def lanes() -> int:
    """Rows of a batch that code computes side by side: the numbers of a vector."""
    return 8 if "+avx512f" in _processor()[-1] else 4


def _numpy_functions() -> Any:
    """Addresses of NumPy's C functions."""
    pointer = ctypes.PYFUNCTYPE(ctypes.POINTER(ctypes.c_void_p), ctypes.py_object, ctypes.c_char_p)
    table = pointer(("PyCapsule_GetPointer", ctypes.pythonapi))
    return table(np._core._multiarray_umath._ARRAY_API, None)  # type: ignore[attr-defined]


def scratch(size: int) -> int:
    """Address of memory for ``size`` numbers, aligned to cache lines of eight numbers."""
    if not _rooms or len(_rooms[-1]) < size + 8:
        _rooms.append(np.empty(2 * size + 8))  # the former ones stay: calls have their addresses
    return -(-_rooms[-1].__array_interface__["data"][0] // 64) * 64


# --- objects on disk ------------------------------------------------------------------------------


def _keep(path: str, code: bytes) -> None:
    """Write an object, after its digest, atomically for other processes."""
    own = f"{path}.{os.urandom(8).hex()}"
    with suppress(OSError):
        with open(own, "xb", opener=partial(os.open, mode=0o600)) as file:
            file.write(sha256(code).digest() + code)
        os.replace(own, path)


def _kept(path: str) -> bytes | None:
    """An object; None if it is missing or damaged, which would end the process in LLVM."""
    try:
        with open(path, "rb") as file:
            digest, code = file.read(32), file.read()
        os.utime(path)
    except OSError:
        return None
    return code if sha256(code).digest() == digest else None


@cache
def _announce() -> None:
    """Say once on stderr that equations are compiled; stdout belongs to the results."""
    if sys.stderr is not None and not any(Path(folder()).glob("*.o")):
        print(
            f"vessel-gym: compiling equations once, a few seconds; kept in {folder()}",
            file=sys.stderr,
            flush=True,
        )


@cache
def folder() -> str:
    """Folder of objects: in ``VESSEL_GYM_CACHE`` or beside the code, or in the user's cache.

    Objects are executed, so a folder counts only if the user alone can write to it. Without one
    nothing is kept.
    """
    first = os.environ.get("VESSEL_GYM_CACHE") or Path(__file__).parents[1] / "__pycache__"
    for place in (os.path.abspath(first), os.path.expanduser("~/.cache")):
        if os.path.isabs(place) and (found := _own(Path(place))):
            _forget(found)
            return str(found)
    return os.devnull


def _forget(place: Path) -> None:
    """Remove objects that have not been used for long."""
    for path in place.glob("*.o"):
        with suppress(OSError):
            if path.stat().st_mtime < time() - _KEPT:
                path.unlink()


def _own(place: Path) -> Path | None:
    """The folder if only the user can write to it, otherwise None."""
    user = os.getuid() if hasattr(os, "getuid") else None  # Windows: folders are the user's own
    found = place / f"vessel-gym-{user}"
    with suppress(OSError):
        found.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = found.lstat()
        safe = stat.S_ISDIR(status.st_mode) and not status.st_mode & 0o022
        if os.access(found, os.W_OK) and (user is None or (safe and status.st_uid == user)):
            return found
    return None
