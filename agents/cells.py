"""Cells of work: pure functions whose results are kept, so that a run may stop anywhere and go on.

A `Cell` names a function and its arguments. `run` computes what is missing and keeps each result in a file of its own::

    out/cells/<key>.json     values, with the description that the key is the hash of
    out/cells/<key>.zip      what the function wrote beside them, e.g. a checkpoint
    out/failed/<key>.json    the traceback of a cell that failed; it is tried again in the next run
    out/journal.jsonl        a line for each computed cell: when, where, how long

A result is written whole or not at all, under a lock of its own: several runs may share a folder, and after a crash
exactly what is missing is computed.
"""

import errno
import hashlib
import json
import os
import platform
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

import vessel_gym
from agents.files import replacing
from agents.source import source_digest

_LIBRARIES = ("numpy", "scipy", "numba")
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


@dataclass(frozen=True, eq=False)
class Cell:
    """A pure function and everything that its result depends on.

    Attributes:
        function: ``"module:name"``. It is called with the arguments and returns values by name: JSON values or arrays
            of numbers.
        arguments: Keyword arguments, JSON values.
        label: What it is, for people. Cells with the same label take about the same time.
        needs: Cells whose artifacts the function reads; it gets their paths as ``needs``.
        artifact: Suffix of a file that the function writes beside its values; it gets the path as ``artifact``.
    """

    function: str
    arguments: dict[str, Any]
    label: str = ""
    needs: tuple["Cell", ...] = ()
    artifact: str = ""

    @cached_property
    def description(self) -> dict[str, Any]:
        """Everything that decides the result, as plain data.

        Raises:
            TypeError: if an argument is not a JSON value.
        """
        versions = {"vessel-gym": vessel_gym.__version__} | {name: metadata.version(name) for name in _LIBRARIES}
        described = {
            "function": self.function,
            "arguments": self.arguments,
            "needs": [cell.key for cell in self.needs],
            "artifact": self.artifact,
            "versions": versions,
            "source": source_digest(self.function.partition(":")[0]),
        }
        return json.loads(json.dumps(described))

    @cached_property
    def key(self) -> str:
        """The name of its result: a hash of its description."""
        return hashlib.sha256(_canonical(self.description)).hexdigest()[:32]

    def compute(self, artifact: Path | None = None, needs: Sequence[Path] = ()) -> dict[str, Any]:
        """Call the function."""
        module, _, name = self.function.partition(":")
        files: dict[str, Any] = {}
        if self.artifact:
            files["artifact"] = artifact
        if self.needs:
            files["needs"] = list(needs)
        return getattr(import_module(module), name)(**self.arguments, **files)


@dataclass
class Outcome:
    """What a run left.

    Attributes:
        values: Of every cell that has a result, by its key.
        failures: Traceback, or the reason for not trying, of every cell that has none, by its key.
        computed: How many cells this run computed.
        notes: What a user should know: files set aside, results of other versions.
    """

    values: dict[str, dict[str, Any]] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    computed: int = 0
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Status:
    """How far a run has come.

    Attributes:
        done: Cells with a result.
        total: Cells in all.
        failed: Cells that failed.
        seconds_left: Estimate; None before any cell of each function has been timed.
        label: Of the cell that ended last.
    """

    done: int
    total: int
    failed: int
    seconds_left: float | None
    label: str = ""


Progress = Callable[[Status], None]


# --- the store --------------------------------------------------------------------------------------


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
            and stored["values_sha256"] == hashlib.sha256(_canonical(stored["values"])).hexdigest()
            and stored["artifact_sha256"] == _artifact_digest(artifact_path(cell, folder) if cell.artifact else None)
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return stored["values"] if whole else None


def journal(folder: Path) -> list[dict[str, Any]]:
    """A line for each cell that was ever computed in a folder: key, label, seconds, cpu_seconds, host, finished."""
    lines = []
    try:
        text = (folder / "journal.jsonl").read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    for line in text.splitlines():
        try:
            lines.append(json.loads(line))
        except ValueError:
            continue  # a line that was cut off tells nothing; the result itself is in its own file
    return lines


def _store(cell: Cell, folder: Path, values: dict[str, Any]) -> None:
    artifact = artifact_path(cell, folder) if cell.artifact else None
    record = {
        "cell": cell.description,
        "values": values,
        "values_sha256": hashlib.sha256(_canonical(values)).hexdigest(),
        "artifact_sha256": _artifact_digest(artifact),
    }
    with replacing(result_path(cell, folder)) as temporary, temporary.open("w", encoding="utf-8") as file:
        json.dump(record, file)
        file.flush()
        os.fsync(file.fileno())


def _note(cell: Cell, folder: Path, seconds: float, cpu_seconds: float) -> None:
    """Add a line to the journal, in one write: lines of several processes do not mix."""
    line = {
        "key": cell.key, "label": cell.label, "function": cell.function, "seconds": round(seconds, 3),
        "cpu_seconds": round(cpu_seconds, 3), "host": platform.node(), "process": os.getpid(),
        "finished": datetime.now().astimezone().isoformat(timespec="seconds"),
    }  # fmt: skip
    handle = os.open(folder / "journal.jsonl", os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(handle, (json.dumps(line) + "\n").encode())
    finally:
        os.close(handle)


def _artifact_digest(path: Path | None) -> str | None:
    return None if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


def _canonical(values: Any) -> bytes:
    return json.dumps(values, sort_keys=True, separators=(",", ":")).encode()


def _plain(values: Any) -> Any:
    """Arrays as lists, NumPy's numbers as Python's, keys as strings, so that what is stored is what is read."""
    if isinstance(values, dict):
        return {str(key): _plain(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [_plain(value) for value in values]
    if isinstance(values, np.ndarray | np.generic):
        return values.tolist()
    return values


# --- one cell ---------------------------------------------------------------------------------------


def work(cell: Cell, folder: Path) -> str:
    """Compute a cell unless its result is there, and store it.

    Returns:
        "stored" if the result was there, "computed", or "failed" (the traceback is in ``failed/``).

    Raises:
        OSError: if the results cannot be written.
    """
    with _lock(folder / ".locks" / f"{cell.key}.lock"):
        if load(cell, folder) is not None:
            return "stored"
        for leftover in (folder / "cells").glob(f".{cell.key}-*"):
            leftover.unlink(missing_ok=True)  # of a run that was killed: we hold the lock, so nobody is writing it
        begin, cpu = time.perf_counter(), time.process_time()
        failed = folder / "failed" / f"{cell.key}.json"
        try:
            with ExitStack() as stack:
                artifact = None
                if cell.artifact:
                    artifact = stack.enter_context(replacing(artifact_path(cell, folder)))
                values = _plain(cell.compute(artifact, [artifact_path(need, folder) for need in cell.needs]))
                _canonical(values)  # what cannot be stored is the cell's fault, and shows here
        except Exception as error:
            if isinstance(error, OSError) and error.errno in _FULL:
                raise
            record = {"cell": cell.description, "label": cell.label, "traceback": traceback.format_exc()}
            with replacing(failed) as temporary:
                temporary.write_text(json.dumps(record, indent=1), encoding="utf-8")
            return "failed"
        _store(cell, folder, values)
        _note(cell, folder, time.perf_counter() - begin, time.process_time() - cpu)
        failed.unlink(missing_ok=True)
        return "computed"


@contextmanager
def _lock(path: Path) -> Iterator[None]:
    path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(path):
        yield


# --- many cells -------------------------------------------------------------------------------------


def run(
    cells: Iterable[Cell],
    folder: Path,
    jobs: int = 1,
    scheduler: str | None = None,
    shard: tuple[int, int] | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Compute the cells that have no result yet.

    Args:
        cells: What is wanted; cells that others need are added.
        folder: Where the results are kept; made if it is not there.
        jobs: Processes on this machine, with one thread each.
        scheduler: Address of a Dask scheduler whose workers compute instead; they must see the folder.
        shard: ``(i, n)``: only the i-th of n parts, counted from 1.
        progress: Called at the start and after every cell.

    Returns:
        Values of all cells that have some, with what failed.

    Raises:
        ValueError: for a number of jobs or a shard that makes no sense.
        OSError: if the results cannot be written, e.g. on a full disk; what was finished is stored.
        ConnectionError: if there is no such scheduler.
        ChildProcessError: if a process that computes was killed; what was finished is stored.
    """
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}")
    folder = Path(folder).resolve()
    wanted = _with_needs(cells)
    mine = wanted if shard is None else _shard(wanted, *shard)
    for name in ("cells", "failed"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    outcome = Outcome(notes=_set_aside(wanted, folder))
    done = {key for key, cell in wanted.items() if load(cell, folder) is not None}
    clock = _Clock(folder, jobs)

    def report(label: str = "") -> None:
        if progress is not None:
            missing = [cell for key, cell in mine.items() if key not in done and key not in outcome.failures]
            total = sum(key in mine for key in done)
            progress(Status(total, len(mine), len(outcome.failures), clock.left(missing), label))

    report()
    with _pool(jobs, scheduler) as pool:
        if scheduler is not None:
            clock.jobs = max(pool.workers, 1)
        while missing := [cell for key, cell in mine.items() if key not in done and key not in outcome.failures]:
            ready = [cell for cell in missing if all(need.key in done for need in cell.needs)]
            for cell in missing:
                lost = [need for need in cell.needs if need.key in outcome.failures or need.key not in (*mine, *done)]
                if lost and cell not in ready:
                    outcome.failures[cell.key] = (
                        f"not tried: it needs {lost[0].label or lost[0].key}, which has no result"
                    )
            for key, what in pool.map(clock.longest_first(ready), folder):
                outcome.computed += what == "computed"
                if what == "failed":
                    record = json.loads((folder / "failed" / f"{key}.json").read_text(encoding="utf-8"))
                    outcome.failures[key] = record["traceback"]
                else:
                    done.add(key)
                clock.read()
                report(mine[key].label)
    for key, cell in wanted.items():
        values = load(cell, folder)
        if values is not None:
            outcome.values[key] = values
    return outcome


def _with_needs(cells: Iterable[Cell]) -> dict[str, Cell]:
    """The cells and all that they need, by key, needs first."""
    found: dict[str, Cell] = {}
    for cell in cells:
        found |= _with_needs(cell.needs)
        found[cell.key] = cell
    return found


def _shard(cells: dict[str, Cell], i: int, n: int) -> dict[str, Cell]:
    """The i-th of n parts. What needs a cell goes with it, so that no part waits for another."""
    if not 1 <= i <= n:
        raise ValueError(f"a shard is i/n with 1 <= i <= n, got {i}/{n}")

    def root(cell: Cell) -> str:
        return root(cell.needs[0]) if cell.needs else cell.key

    roots = sorted({root(cell) for cell in cells.values()})
    return {key: cell for key, cell in cells.items() if roots.index(root(cell)) % n == i - 1}


def _set_aside(wanted: dict[str, Cell], folder: Path) -> list[str]:
    """Move files that are not what their names promise out of the way; say so, and what else lies there."""
    notes = []
    for key, cell in wanted.items():
        path = result_path(cell, folder)
        if path.exists() and load(cell, folder) is None:
            with _lock(folder / ".locks" / f"{key}.lock"):
                if load(cell, folder) is None and path.exists():
                    path.replace(path.with_suffix(".json.corrupt"))
                    notes.append(
                        f"{path.name} was damaged or not ours: it is now {path.name}.corrupt, and computed again"
                    )
    others = [path for path in (folder / "cells").glob("*.json") if path.stem not in wanted]
    if others:
        notes.append(
            f"{len(others)} results in {folder / 'cells'} are of other settings or versions, and were left alone"
        )
    return notes


class _Clock:
    """How long cells take, from the journal: equal labels alike, else the mean of the same function."""

    def __init__(self, folder: Path, jobs: int) -> None:
        self.folder, self.jobs = folder, jobs
        self.read()

    def read(self) -> None:
        """Take in what was added to the journal."""
        times: dict[str, list[float]] = {}
        for line in journal(self.folder):
            for name in {line.get("label") or line["function"], line["function"]}:
                times.setdefault(name, []).append(line["seconds"])
        self._mean = {name: float(np.mean(seconds)) for name, seconds in times.items()}

    def expected(self, cell: Cell) -> float | None:
        """Seconds that a cell will take."""
        return self._mean.get(cell.label, self._mean.get(cell.function))

    def left(self, missing: Sequence[Cell]) -> float | None:
        """Seconds until the missing cells are done; None while one of their functions was never timed."""
        each = [self.expected(cell) for cell in missing]
        known = [seconds for seconds in each if seconds is not None]
        if len(known) < len(each):
            return None
        return max(sum(known) / self.jobs, max(known, default=0.0))

    def longest_first(self, cells: Sequence[Cell]) -> list[Cell]:
        """An order that keeps all processes busy to the end; what was never timed comes first."""
        return sorted(cells, key=lambda cell: -(self.expected(cell) or np.inf))


# --- where cells are computed -----------------------------------------------------------------------


class _Pool:
    """Processes on this machine, or the workers of a Dask scheduler, through joblib."""

    def __init__(self, jobs: int, workers: int) -> None:
        self.jobs, self.workers = jobs, workers

    def map(self, cells: Sequence[Cell], folder: Path) -> Iterator[tuple[str, str]]:
        """Key and outcome of each cell, as they end."""
        from joblib import Parallel, delayed
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        try:
            yield from Parallel(n_jobs=self.jobs, return_as="generator_unordered", pre_dispatch="2*n_jobs")(
                delayed(_keyed)(cell, folder) for cell in cells
            )
        except TerminatedWorkerError:
            raise ChildProcessError(
                "a process that computed was killed, perhaps for want of memory: what was finished is stored; "
                "run again, perhaps with fewer jobs"
            ) from None


def _keyed(cell: Cell, folder: Path) -> tuple[str, str]:
    return cell.key, work(cell, folder)


@contextmanager
def _pool(jobs: int, scheduler: str | None) -> Iterator[_Pool]:
    from joblib import parallel_config

    if scheduler is None:
        with parallel_config(backend="loky", inner_max_num_threads=1) if jobs > 1 else parallel_config():
            yield _Pool(jobs, jobs)
        return
    from dask.distributed import Client

    try:
        client = Client(scheduler, timeout=30)
    except (OSError, ValueError) as error:
        raise ConnectionError(f"no Dask scheduler answers at {scheduler}: {error}") from None
    with client, parallel_config(backend="dask"):
        yield _Pool(-1, sum(client.nthreads().values()))
