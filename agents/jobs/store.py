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

from agents.files import replacing
from agents.jobs.job import Job, canonical

_RESULT = re.compile(r"[0-9a-f]{32}\.")
_TEMPORARY = re.compile(
    r"\.+([0-9a-f]{32})-\d+"
)  # more dots: what a function writes has a temporary of its own


def result_path(job: Job, folder: Path) -> Path:
    """Path of a job's values."""
    return folder / "jobs" / f"{job.key}.json"


def artifact_path(job: Job, folder: Path) -> Path:
    """Path of a job's artifact."""
    return folder / "jobs" / f"{job.key}{job.artifact}"


def load(job: Job, folder: Path) -> dict[str, Any] | None:
    """The stored values of a job; None if there are none, or what is there is not whole or not this job's."""
    try:
        stored = json.loads(result_path(job, folder).read_bytes())
        whole = (
            stored["job"] == job.description
            and stored["values_sha256"] == hashlib.sha256(canonical(stored["values"])).hexdigest()
            and stored["artifact_sha256"] == _artifact_digest(job, folder)
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return stored["values"] if whole else None


def journal(folder: Path) -> list[dict[str, Any]]:
    """A line for each job that was ever computed in a folder: label, times, host; timing, where there is one.

    Damaged lines are left out.
    """
    try:
        text = (folder / "journal.jsonl").read_bytes()
    except FileNotFoundError:
        return []
    return [line for line in map(_journal_line, text.splitlines()) if line is not None]


def end_journal(folder: Path) -> None:
    """End the last line of the journal, which a killed process may have left unfinished."""
    path = folder / "journal.jsonl"
    if path.exists() and not path.read_bytes().endswith(b"\n"):
        with path.open("ab") as file:
            file.write(b"\n")


_JOURNAL: dict[str, type | tuple[type, ...]] = {
    "key": str, "label": str, "function": str, "seconds": (int, float), "cpu_seconds": (int, float), "host": str,
    "process": int, "finished": str,
}  # fmt: skip
"""Types of the values in a line of the journal."""


def _journal_line(text: bytes) -> dict[str, Any] | None:
    """A line of the journal; None if it is none."""
    try:
        line = json.loads(text)
    except (ValueError, RecursionError):
        return None
    whole = isinstance(line, dict) and all(
        isinstance(line.get(name), kind) for name, kind in _JOURNAL.items()
    )
    return (
        line
        if whole and all(0.0 <= line[name] < np.inf for name in ("seconds", "cpu_seconds"))
        else None
    )


def save(job: Job, folder: Path, values: dict[str, Any]) -> None:
    """Store a job's values; its artifact is there already."""
    record = {
        "job": job.description,
        "values": values,
        "values_sha256": hashlib.sha256(canonical(values)).hexdigest(),
        "artifact_sha256": _artifact_digest(job, folder),
    }
    with (
        replacing(result_path(job, folder)) as temporary,
        temporary.open("w", encoding="utf-8") as file,
    ):
        json.dump(record, file)
        file.flush()
        os.fsync(file.fileno())


def save_failure(job: Job, folder: Path, text: str) -> None:
    """Store why a job has no result."""
    record = {"job": job.description, "label": job.label, "traceback": text}
    with replacing(failure_path(job, folder)) as temporary:
        temporary.write_text(json.dumps(record, indent=1), encoding="utf-8")


def failure_path(job: Job, folder: Path) -> Path:
    """Path of a job's failure."""
    return folder / "failed" / f"{job.key}.json"


def note(job: Job, folder: Path, seconds: float, cpu_seconds: float, timing: Any = None) -> None:
    """Add a line to the journal, in one write: lines of several processes do not mix."""
    line = {
        "key": job.key, "label": job.label, "function": job.function, "seconds": round(seconds, 3),
        "cpu_seconds": round(cpu_seconds, 3), "host": platform.node(), "process": os.getpid(),
        "finished": datetime.now().astimezone().isoformat(timespec="seconds"),
    } | ({} if timing is None else {"timing": timing})  # fmt: skip
    handle = os.open(folder / "journal.jsonl", os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(handle, (json.dumps(line) + "\n").encode())
    finally:
        os.close(handle)


def _artifact_digest(job: Job, folder: Path) -> str | None:
    return (
        hashlib.sha256(artifact_path(job, folder).read_bytes()).hexdigest()
        if job.artifact
        else None
    )


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
    """Nobody else works on the job with this key meanwhile; `filelock.Timeout` if that takes too long [s]."""
    path = folder / ".locks" / f"{key}.lock"
    path.parent.mkdir(exist_ok=True)
    with FileLock(path, timeout=timeout):
        yield


def set_aside(job: Job, folder: Path) -> list[str]:
    """Move what is in the place of a result, but is none, out of the way; say so."""
    path = result_path(job, folder)
    if not path.exists():
        return []
    with lock(job.key, folder):
        if load(job, folder) is not None or not path.exists():
            return []  # another run was faster
        aside = folder / "set-aside" / f"{datetime.now():%Y%m%dT%H%M%S.%f}"
        aside.mkdir(parents=True)
        for file in {path, artifact_path(job, folder)}:
            if file.exists():
                file.replace(aside / file.name)
        return [
            f"the result {path.name} was damaged or not ours: it now is in {aside}, and is computed"
            " again"
        ]


def strangers(wanted: Mapping[str, Job], folder: Path) -> list[str]:
    """Notes on other files among the results."""
    names = [
        path.name
        for path in (folder / "jobs").iterdir()
        if path.stem not in wanted and path.name[0] != "."
    ]
    unknown = sorted(name for name in names if not _RESULT.match(name))
    others = len(
        {name.partition(".")[0] for name in names} - {name.partition(".")[0] for name in unknown}
    )
    notes = []
    if others:
        notes.append(
            f"{others} results in {folder / 'jobs'} are of other settings or versions: left alone"
        )
    if unknown:
        notes.append(f"{folder / 'jobs'} holds what is no result: {', '.join(unknown)}: left alone")
    return notes


def sweep(folder: Path) -> None:
    """Remove what killed processes had begun to write, but not what somebody is writing now."""
    partial: dict[str, list[Path]] = {}
    for name in ("jobs", "failed"):
        for path in (folder / name).glob(".*"):
            if match := _TEMPORARY.match(path.name):
                partial.setdefault(match[1], []).append(path)
    for key, paths in partial.items():
        try:
            with lock(key, folder, timeout=0):
                for path in paths:
                    path.unlink(missing_ok=True)
        except Timeout:
            continue
