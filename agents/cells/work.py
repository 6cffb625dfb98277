"""One cell, computed and stored."""

import errno
import json
import platform
import time
import traceback
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from agents.cells.cell import LIBRARIES, Cell
from agents.cells.store import artifact_path, failure_path, load, lock, note, plain, save, save_failure
from agents.files import replacing

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


class End(NamedTuple):
    """How a cell ended: its values, or why it has none; the seconds it took, if it was computed now."""

    key: str
    values: dict[str, Any] | None
    failure: str = ""
    seconds: float | None = None


class CannotStore(OSError):
    """Nothing can be stored where a cell is computed: the run stops."""


def work(cell: Cell, folder: Path, key: str) -> End:
    """Compute a cell unless its result is there, and store it.

    Raises:
        CannotStore: if the result cannot be written, or if it would not be the one that ``key`` stands for.
    """
    host = platform.node()
    if cell.key != key:
        raise CannotStore(
            f"{host} has other code of this package than the run was started with, or another version of "
            f"{', '.join(LIBRARIES)}: it would compute other results"
        )
    if not (folder / "cells").is_dir():
        raise CannotStore(f"{host} does not see {folder}: all workers need the same folder")
    try:
        with lock(key, folder):
            values = load(cell, folder)
            return _compute(cell, folder) if values is None else End(key, values)
    except OSError as error:
        raise CannotStore(f"cannot store results in {folder}: {error.strerror or error}") from None


def _compute(cell: Cell, folder: Path) -> End:
    begin, cpu = time.perf_counter(), time.process_time()
    try:
        with ExitStack() as stack:
            artifact = stack.enter_context(replacing(artifact_path(cell, folder))) if cell.artifact else None
            values = cell.compute(artifact, [artifact_path(need, folder) for need in cell.needs])
            if not isinstance(values, dict):
                raise TypeError(f"{cell.function} returned {type(values).__name__}, not values by name")
            timing = plain(values.pop("timing", None))
            values = json.loads(json.dumps(plain(values)))  # what cannot be stored is the cell's fault, and shows here
    except (Exception, SystemExit) as error:
        if full := _full_disk(error):
            raise full from None
        text = traceback.format_exc()
        save_failure(cell, folder, text)
        return End(cell.key, None, text)
    save(cell, folder, values)
    seconds = time.perf_counter() - begin
    note(cell, folder, seconds, time.process_time() - cpu, timing)
    failure_path(cell, folder).unlink(missing_ok=True)
    return End(cell.key, values, seconds=seconds)


def _full_disk(error: BaseException | None) -> OSError | None:
    """The full disk behind an error: libraries wrap it in errors of their own."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return error
        error = error.__cause__ or error.__context__
    return None
