"""The files of a run: each result is written whole or not at all, under a lock of its own."""

import hashlib
import json
import os
import platform
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from agents.cells.cell import Cell, canonical
from agents.files import replacing

_RESULT = re.compile(r"[0-9a-f]{32}\.")
_TEMPORARY = re.compile(r"\.+([0-9a-f]{32})-\d+")  # more dots: what a function writes has a temporary of its own


def result_path(cell: Cell, folder: Path) -> Path:
    """Where a cell's values are."""
    return folder / "cells" / f"{cell.key}.json"


def artifact_path(cell: Cell, folder: Path) -> Path:
    """Where a cell's artifact is."""
    return folder / "cells" / f"{cell.key}{cell.artifact}"


def load(cell: Cell, folder: Path) -> dict[str, Any] | None:
    """The stored values of a cell; None if there are none, or what is there is not whole or not this cell's."""
    try:
        stored = json.loads(result_path(cell, folder).read_bytes())
        whole = (
            stored["cell"] == cell.description
            and stored["values_sha256"] == hashlib.sha256(canonical(stored["values"])).hexdigest()
            and stored["artifact_sha256"] == _artifact_digest(cell, folder)
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return stored["values"] if whole else None


def journal(folder: Path) -> list[dict[str, Any]]:
    """A line for each cell that was ever computed in a folder: label, times, host; timing, where there is one.

    Lines that are damaged are left out.
    """
    return [line for line in map(_journal_line, _journal_text(folder).splitlines()) if line is not None]


def mend_journal(folder: Path) -> list[str]:
    """Blank out what is no line of the journal, and say so.

    In its place, and never longer: another run may be adding lines.
    """
    text, place, damaged = _journal_text(folder), 0, 0
    path = folder / "journal.jsonl"
    for line in text.splitlines(keepends=True):
        whole = line.rstrip(b"\r\n")
        if whole.strip() and _journal_line(whole) is None:
            damaged += 1
            with path.open("r+b") as file:
                file.seek(place)
                file.write(b" " * len(whole))
        place += len(line)
    if text and not text.endswith(b"\n"):
        with path.open("ab") as file:
            file.write(b"\n")
    lines = f"{damaged} damaged line{'s' if damaged > 1 else ''}"
    return [f"{lines} of {path} held no more than when a cell was computed: now blank"] if damaged else []


def _journal_text(folder: Path) -> bytes:
    try:
        return (folder / "journal.jsonl").read_bytes()
    except FileNotFoundError:
        return b""


_JOURNAL: dict[str, type | tuple[type, ...]] = {
    "key": str, "label": str, "function": str, "seconds": (int, float), "cpu_seconds": (int, float), "host": str,
    "process": int, "finished": str,
}  # fmt: skip
"""What a line of the journal holds."""


def _journal_line(text: bytes) -> dict[str, Any] | None:
    """A line of the journal; None if it is none."""
    try:
        line = json.loads(text)
    except (ValueError, RecursionError):
        return None
    whole = isinstance(line, dict) and all(isinstance(line.get(name), kind) for name, kind in _JOURNAL.items())
    return line if whole and all(0.0 <= line[name] < np.inf for name in ("seconds", "cpu_seconds")) else None


def save(cell: Cell, folder: Path, values: dict[str, Any]) -> None:
    """Store a cell's values; its artifact is there already."""
    record = {
        "cell": cell.description,
        "values": values,
        "values_sha256": hashlib.sha256(canonical(values)).hexdigest(),
        "artifact_sha256": _artifact_digest(cell, folder),
    }
    with replacing(result_path(cell, folder)) as temporary, temporary.open("w", encoding="utf-8") as file:
        json.dump(record, file)
        file.flush()
        os.fsync(file.fileno())


def save_failure(cell: Cell, folder: Path, text: str) -> None:
    """Store why a cell has no result."""
    record = {"cell": cell.description, "label": cell.label, "traceback": text}
    with replacing(failure_path(cell, folder)) as temporary:
        temporary.write_text(json.dumps(record, indent=1), encoding="utf-8")


def failure_path(cell: Cell, folder: Path) -> Path:
    """Where a cell's failure is."""
    return folder / "failed" / f"{cell.key}.json"


def note(cell: Cell, folder: Path, seconds: float, cpu_seconds: float, timing: Any = None) -> None:
    """Add a line to the journal, in one write: lines of several processes do not mix."""
    line = {
        "key": cell.key, "label": cell.label, "function": cell.function, "seconds": round(seconds, 3),
        "cpu_seconds": round(cpu_seconds, 3), "host": platform.node(), "process": os.getpid(),
        "finished": datetime.now().astimezone().isoformat(timespec="seconds"),
    } | ({} if timing is None else {"timing": timing})  # fmt: skip
    handle = os.open(folder / "journal.jsonl", os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(handle, (json.dumps(line) + "\n").encode())
    finally:
        os.close(handle)


def _artifact_digest(cell: Cell, folder: Path) -> str | None:
    return hashlib.sha256(artifact_path(cell, folder).read_bytes()).hexdigest() if cell.artifact else None


def plain(values: Any) -> Any:
    """Arrays as lists, NumPy's numbers as Python's, keys as strings, so that what is stored is what is read."""
    if isinstance(values, dict):
        return {str(key): plain(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [plain(value) for value in values]
    if isinstance(values, np.ndarray | np.generic):
        return values.tolist()
    return values


@contextmanager
def lock(key: str, folder: Path, timeout: float = -1) -> Iterator[None]:
    """Nobody else works on the cell with this key meanwhile; `filelock.Timeout` if that takes too long [s]."""
    path = folder / ".locks" / f"{key}.lock"
    path.parent.mkdir(exist_ok=True)
    with FileLock(path, timeout=timeout):
        yield


def set_aside(cell: Cell, folder: Path) -> list[str]:
    """Move what is in the place of a result, but is none, out of the way; say so."""
    path = result_path(cell, folder)
    if not path.exists():
        return []
    with lock(cell.key, folder):
        if load(cell, folder) is not None or not path.exists():
            return []  # another run was faster
        aside = folder / "set-aside" / f"{datetime.now():%Y%m%dT%H%M%S.%f}"
        aside.mkdir(parents=True)
        for file in {path, artifact_path(cell, folder)}:
            if file.exists():
                file.replace(aside / file.name)
        return [f"the result {path.name} was damaged or not ours: it now is in {aside}, and is computed again"]


def strangers(wanted: Mapping[str, Cell], folder: Path) -> list[str]:
    """What else lies among the results."""
    names = [path.name for path in (folder / "cells").iterdir() if path.stem not in wanted and path.name[0] != "."]
    unknown = sorted(name for name in names if not _RESULT.match(name))
    others = len({name.partition(".")[0] for name in names} - {name.partition(".")[0] for name in unknown})
    notes = []
    if others:
        notes.append(f"{others} results in {folder / 'cells'} are of other settings or versions: left alone")
    if unknown:
        notes.append(f"{folder / 'cells'} holds what is no result: {', '.join(unknown)}: left alone")
    return notes


def sweep(folder: Path) -> None:
    """Remove what killed processes had begun to write, but not what somebody is writing now."""
    begun: dict[str, list[Path]] = {}
    for name in ("cells", "failed"):
        for path in (folder / name).glob(".*"):
            if match := _TEMPORARY.match(path.name):
                begun.setdefault(match[1], []).append(path)
    for key, paths in begun.items():
        try:
            with lock(key, folder, timeout=0):
                for path in paths:
                    path.unlink(missing_ok=True)
        except Timeout:
            continue
