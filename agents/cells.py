"""Cells of work: pure functions whose results are kept, so that a run may stop anywhere and go on.

A `Cell` names a function and its arguments. `run` computes what is missing and keeps each result in a file of its own::

    out/cells/<key>.json     values, with the description that the key is the hash of
    out/cells/<key>.zip      what the function wrote beside them, e.g. a checkpoint
    out/failed/<key>.json    the traceback of a cell that failed; it is tried again in the next run
    out/set-aside/           what lay in the place of a result and was damaged or not ours
    out/journal.jsonl        a line for each computed cell: when, where, how long

A result is written whole or not at all, under a lock of its own: several runs may share a folder, and after a crash
exactly what is missing is computed. Results hold no times, so those of two runs are equal byte for byte.
"""

import errno
import hashlib
import heapq
import json
import os
import platform
import re
import threading
import time
import traceback
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, fields
from datetime import datetime
from functools import cache, cached_property, partial
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from filelock import FileLock, Timeout

import vessel_gym
from agents.files import replacing
from agents.source import source_digest

_LIBRARIES = ("numpy", "scipy", "numba")
_PATIENCE = 30  # seconds for a Dask scheduler or its first worker to answer
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
_RESULT = re.compile(r"[0-9a-f]{32}\.")
_TEMPORARY = re.compile(r"\.+([0-9a-f]{32})-\d+")  # more dots: what a function writes has a temporary of its own
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


@dataclass(frozen=True, eq=False)
class Cell:
    """A pure function and everything that its result depends on.

    Attributes:
        function: ``"module:name"``. It is called with the arguments and returns values by name: JSON values or arrays
            of numbers.
        arguments: Keyword arguments, JSON values. The function gets what JSON makes of them: lists for tuples.
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
        described = {
            "function": self.function,
            "arguments": self.arguments,
            "needs": [cell.key for cell in self.needs],
            "artifact": self.artifact,
            "versions": _versions(),
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
        return getattr(import_module(module), name)(**self.description["arguments"], **files)

    def __getstate__(self) -> dict[str, Any]:
        """What another process is sent: not the key, which it makes of the code that it has itself."""
        return {attribute.name: getattr(self, attribute.name) for attribute in fields(self)}


@cache
def _versions() -> dict[str, str]:
    return {"vessel-gym": vessel_gym.__version__} | {name: metadata.version(name) for name in _LIBRARIES}


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
            and stored["artifact_sha256"] == _artifact_digest(cell, folder)
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
    record = {
        "cell": cell.description,
        "values": values,
        "values_sha256": hashlib.sha256(_canonical(values)).hexdigest(),
        "artifact_sha256": _artifact_digest(cell, folder),
    }
    with replacing(result_path(cell, folder)) as temporary, temporary.open("w", encoding="utf-8") as file:
        json.dump(record, file)
        file.flush()
        os.fsync(file.fileno())


def _store_failure(cell: Cell, folder: Path, text: str) -> None:
    record = {"cell": cell.description, "label": cell.label, "traceback": text}
    with replacing(_failure_path(cell, folder)) as temporary:
        temporary.write_text(json.dumps(record, indent=1), encoding="utf-8")


def _failure_path(cell: Cell, folder: Path) -> Path:
    return folder / "failed" / f"{cell.key}.json"


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


def _artifact_digest(cell: Cell, folder: Path) -> str | None:
    return hashlib.sha256(artifact_path(cell, folder).read_bytes()).hexdigest() if cell.artifact else None


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


@contextmanager
def _lock(key: str, folder: Path, timeout: float = -1) -> Iterator[None]:
    path = folder / ".locks" / f"{key}.lock"
    path.parent.mkdir(exist_ok=True)
    with FileLock(path, timeout=timeout):
        yield


def _set_aside(cell: Cell, folder: Path) -> list[str]:
    """Move what is in the place of a result, but is none, out of the way; say so."""
    path = result_path(cell, folder)
    if not path.exists():
        return []
    with _lock(cell.key, folder):
        if load(cell, folder) is not None or not path.exists():
            return []  # another run was faster
        aside = folder / "set-aside" / f"{datetime.now():%Y%m%dT%H%M%S.%f}"
        aside.mkdir(parents=True)
        for file in {path, artifact_path(cell, folder)}:
            if file.exists():
                file.replace(aside / file.name)
        return [f"the result {path.name} was damaged or not ours: it now is in {aside}, and is computed again"]


def _strangers(wanted: Mapping[str, Cell], folder: Path) -> list[str]:
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


def _sweep(folder: Path) -> None:
    """Remove what killed processes had begun to write, but not what somebody is writing now."""
    files = [path for name in ("cells", "failed") for path in (folder / name).glob(".*")]
    for key in {match[1] for path in files if (match := _TEMPORARY.match(path.name))}:
        try:
            with _lock(key, folder, timeout=0):
                _remove_begun(key, folder)
        except Timeout:
            continue


def _remove_begun(key: str, folder: Path) -> None:
    for name in ("cells", "failed"):
        for path in (folder / name).glob(f".*{key}-*"):
            path.unlink(missing_ok=True)


# --- one cell ---------------------------------------------------------------------------------------


class _End(NamedTuple):
    """How a cell ended: its values, or why it has none; the seconds it took, if it was computed now."""

    key: str
    values: dict[str, Any] | None
    failure: str = ""
    seconds: float | None = None


class _CannotStore(OSError):
    """Nothing can be stored where a cell is computed: the run stops."""


def _work(cell: Cell, folder: Path, key: str) -> _End:
    """Compute a cell unless its result is there, and store it.

    Raises:
        _CannotStore: if the result cannot be written, or if it would not be the one that ``key`` stands for.
    """
    host = platform.node()
    if cell.key != key:
        raise _CannotStore(
            f"{host} has other code of this package than the run was started with, or another version of "
            f"{', '.join(_LIBRARIES)}: it would compute other results"
        )
    if not (folder / "cells").is_dir():
        raise _CannotStore(f"{host} does not see {folder}: all workers need the same folder")
    try:
        with _lock(key, folder):
            _remove_begun(key, folder)  # we hold the lock, so whoever began it is dead
            values = load(cell, folder)
            return _compute(cell, folder) if values is None else _End(key, values)
    except OSError as error:
        raise _CannotStore(f"cannot store results in {folder}: {error.strerror or error}") from None


def _compute(cell: Cell, folder: Path) -> _End:
    begin, cpu = time.perf_counter(), time.process_time()
    try:
        with ExitStack() as stack:
            artifact = stack.enter_context(replacing(artifact_path(cell, folder))) if cell.artifact else None
            values = cell.compute(artifact, [artifact_path(need, folder) for need in cell.needs])
            if not isinstance(values, dict):
                raise TypeError(f"{cell.function} returned {type(values).__name__}, not values by name")
            values = json.loads(json.dumps(_plain(values)))  # what cannot be stored is the cell's fault, and shows here
    except (Exception, SystemExit) as error:
        if full := _full_disk(error):
            raise full from None
        text = traceback.format_exc()
        _store_failure(cell, folder, text)
        return _End(cell.key, None, text)
    _store(cell, folder, values)
    seconds = time.perf_counter() - begin
    _note(cell, folder, seconds, time.process_time() - cpu)
    _failure_path(cell, folder).unlink(missing_ok=True)
    return _End(cell.key, values, seconds=seconds)


def _full_disk(error: BaseException | None) -> OSError | None:
    """The full disk behind an error: libraries wrap it in errors of their own."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return error
        error = error.__cause__ or error.__context__
    return None


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

    A cell that fails does not stop the others; nor does one whose process is killed, which is tried once more, alone.

    Args:
        cells: What is wanted; cells that others need are added.
        folder: Where the results are kept; made if it is not there.
        jobs: Processes on this machine, with one thread each; 1: this process.
        scheduler: Address of a Dask scheduler whose workers compute instead; they must see the folder.
        shard: ``(i, n)``: only the i-th of n parts, counted from 1.
        progress: Called at the start and after every cell.

    Returns:
        Values of all cells that have some, with what failed.

    Raises:
        ValueError: for a number of jobs or a shard that makes no sense.
        OSError: if the results cannot be written, e.g. on a full disk; what was finished is stored.
        ConnectionError: if there is no such scheduler, or its workers cannot compute.
    """
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}")
    folder = Path(folder).resolve()
    wanted = _with_needs(cells)
    mine = wanted if shard is None else _shard(wanted, *shard)
    try:
        for name in ("cells", "failed"):
            (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"cannot store results in {folder}: {error.strerror}") from None
    outcome = Outcome()
    for key, cell in wanted.items():
        values = load(cell, folder)
        if values is None:
            outcome.notes += _set_aside(cell, folder)
        else:
            outcome.values[key] = values
    outcome.notes += _strangers(wanted, folder)
    missing = {key: cell for key, cell in mine.items() if key not in outcome.values}
    clock = _Clock(journal(folder))
    workers = jobs

    def report(label: str = "") -> None:
        if progress is not None:
            done = sum(key in outcome.values for key in mine)
            ended = outcome.values.keys() | outcome.failures.keys()
            left = {key: cell for key, cell in missing.items() if key not in ended}
            waves = [[clock.expected(cell) for cell in wave] for wave in _waves(left)]
            progress(Status(done, len(mine), len(outcome.failures), seconds_left(waves, workers), label))

    report()
    if not missing:
        return outcome
    try:
        with _pool(folder, jobs, scheduler) as (compute, workers):
            for wave in _waves(missing):
                ready = []
                for cell in wave:
                    lost = [need for need in cell.needs if need.key not in outcome.values]
                    if lost:
                        name = lost[0].label or lost[0].key
                        outcome.failures[cell.key] = f"not tried: it needs {name}, which has no result"
                        report(cell.label)
                    else:
                        ready.append(cell)
                with closing(compute(clock.longest_first(ready))) as ends:
                    for key, values, failure, seconds in ends:
                        if values is None:
                            outcome.failures[key] = failure
                        else:
                            outcome.values[key] = values
                        if seconds is not None:
                            outcome.computed += 1
                            clock.add(mine[key].label, mine[key].function, seconds)
                        report(mine[key].label)
    except _CannotStore as error:
        done = sum(key in outcome.values for key in mine)
        raise OSError(f"{error}; {done} of {len(mine)} are stored, and the same run goes on from there") from None
    finally:
        _sweep(folder)
    return outcome


def _with_needs(cells: Iterable[Cell]) -> dict[str, Cell]:
    """The cells and all that they need, by key, needs first."""
    found: dict[str, Cell] = {}
    for cell in cells:
        found |= _with_needs(cell.needs)
        found[cell.key] = cell
    return found


def _shard(cells: Mapping[str, Cell], i: int, n: int) -> dict[str, Cell]:
    """The i-th of n parts, each with all that it needs; what needs the same cell first goes together."""
    if not 1 <= i <= n:
        raise ValueError(f"a shard is i/n with 1 <= i <= n, got {i}/{n}")

    def root(cell: Cell) -> str:
        return root(cell.needs[0]) if cell.needs else cell.key

    needed = {need.key for cell in cells.values() for need in cell.needs}
    last = [cell for key, cell in cells.items() if key not in needed]
    part = {key: number % n for number, key in enumerate(sorted({root(cell) for cell in last}))}
    return _with_needs(cell for cell in last if part[root(cell)] == i - 1)


def _waves(cells: Mapping[str, Cell]) -> list[list[Cell]]:
    """What can be computed at once, then what needs that, and so on."""
    left, waves = dict(cells), []
    while left:
        ready = {key: cell for key, cell in left.items() if not any(need.key in left for need in cell.needs)}
        left = {key: cell for key, cell in left.items() if key not in ready}
        waves.append(list(ready.values()))
    return waves


class _Clock:
    """How long cells take: equal labels alike, else the mean of the same function."""

    def __init__(self, lines: Iterable[Mapping[str, Any]]) -> None:
        self._times: dict[str, tuple[int, float]] = {}
        for line in lines:
            self.add(line["label"], line["function"], line["seconds"])

    def add(self, label: str, function: str, seconds: float) -> None:
        """Take in one cell's time."""
        for name in {label, function}:
            count, total = self._times.get(name, (0, 0.0))
            self._times[name] = count + 1, total + seconds

    def expected(self, cell: Cell) -> float | None:
        """Seconds that a cell will take; None if its function was never timed."""
        count, total = self._times.get(cell.label or cell.function) or self._times.get(cell.function) or (0, 0.0)
        return total / count if count else None

    def longest_first(self, cells: Sequence[Cell]) -> list[Cell]:
        """An order that keeps all processes busy to the end; what was never timed comes first."""

        def expected(cell: Cell) -> float:
            seconds = self.expected(cell)
            return np.inf if seconds is None else seconds

        return sorted(cells, key=expected, reverse=True)


def seconds_left(waves: Sequence[Sequence[float | None]], workers: int) -> float | None:
    """How long workers take for waves of cells, each wave longest first, if cells take as long as expected.

    Args:
        waves: Seconds of each cell; a wave begins when the one before has ended.
        workers: How many cells are computed at once.

    Returns:
        Seconds; None if a cell's time is not known.
    """
    total = 0.0
    for wave in waves:
        known = [seconds for seconds in wave if seconds is not None]
        if len(known) < len(wave):
            return None
        busy = [0.0] * workers
        for seconds in sorted(known, reverse=True):
            heapq.heapreplace(busy, busy[0] + seconds)
        total += max(busy)
    return total


# --- where cells are computed -----------------------------------------------------------------------

_Ends = Generator[_End, None, None]


@contextmanager
def _pool(folder: Path, jobs: int, scheduler: str | None) -> Iterator[tuple[Callable[[Sequence[Cell]], _Ends], int]]:
    """What computes cells and yields their ends as they come, and how many at once."""
    if scheduler is not None:
        with _client(scheduler) as client:
            yield partial(_on_cluster, folder, client), sum(client.nthreads().values())
    elif jobs > 1:
        yield partial(_in_processes, folder, jobs), jobs
    else:
        yield partial(_here, folder), 1


def _here(folder: Path, cells: Sequence[Cell]) -> _Ends:
    yield from (_work(cell, folder, cell.key) for cell in cells)


def _in_processes(folder: Path, jobs: int, cells: Sequence[Cell]) -> _Ends:
    from joblib import Parallel, parallel_config
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    left = {cell.key: cell for cell in cells}
    with parallel_config(
        backend="loky", inner_max_num_threads=1, initializer=_leave_with_parent, initargs=(os.getpid(),)
    ):
        parallel = Parallel(jobs, return_as="generator_unordered", batch_size=1)
    try:
        with _dispatched(parallel, folder, cells) as ends:
            for end in ends:
                del left[end.key]
                yield end
    except TerminatedWorkerError:
        pass  # a process was killed, and joblib ended the others with it
    for at_once in (jobs, 1):  # the second time alone: it has all the memory there is
        with closing(_apart(folder, at_once, list(left.values()))) as tries:
            for cell, result, cause in tries:
                if result is not None:
                    del left[cell.key]
                    yield result
                elif at_once == 1:
                    yield _killed(cell, folder, f"the process that computed it was killed twice ({cause})")


def _apart(folder: Path, at_once: int, cells: Sequence[Cell]) -> Generator[tuple[Cell, _End | None, str], None, None]:
    """Each cell in a process of its own: its end, or else what ended the process."""
    from concurrent.futures import FIRST_COMPLETED, Future, wait

    from joblib.externals.loky.process_executor import ProcessPoolExecutor, TerminatedWorkerError

    left, running = deque(cells), dict[Future[_End], tuple[Cell, ProcessPoolExecutor]]()
    try:
        while left or running:
            while left and len(running) < at_once:
                cell = left.popleft()
                process = ProcessPoolExecutor(
                    1, initializer=_leave_with_parent, initargs=(os.getpid(),), env=_ONE_THREAD
                )
                running[process.submit(_work, cell, folder, cell.key)] = cell, process
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                cell, process = running.pop(future)
                process.shutdown()
                try:
                    yield cell, future.result(), ""
                except TerminatedWorkerError as error:
                    codes = re.search(r"\{(.*)\}", str(error))  # e.g. SIGKILL(-9)
                    yield cell, None, codes[1] if codes else "nobody knows how"
    finally:
        for _, process in running.values():
            process.shutdown(kill_workers=True)


def _leave_with_parent(parent: int) -> None:
    """End this process soon after its parent, which may be killed before it can stop what it started."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _killed(cell: Cell, folder: Path, text: str) -> _End:
    failure = f"{text}, perhaps for want of memory"
    _store_failure(cell, folder, failure)
    return _End(cell.key, None, failure)


def _on_cluster(folder: Path, client: Any, cells: Sequence[Cell]) -> _Ends:
    from joblib import Parallel

    parallel = Parallel(-1, _dask_backend(client), return_as="generator_unordered", pre_dispatch="all", batch_size=1)
    killed: list[Cell] = []
    try:
        with _dispatched(parallel, folder, cells) as ends:
            for end in ends:
                if isinstance(end, Cell):
                    killed.append(end)
                else:
                    yield end
        for cell in killed:  # alone: Dask blames all that were on a worker
            with _dispatched(parallel, folder, [cell]) as ends:
                for end in ends:
                    text = "every worker that computed it was killed"
                    yield _killed(cell, folder, text) if isinstance(end, Cell) else end
    except _CannotStore:
        raise
    except Exception as error:
        raise ConnectionError(f"the Dask workers cannot go on: {type(error).__name__}: {error}") from error


def _dask_backend(client: Any) -> Any:
    """Joblib's backend for Dask, which would wait for ever for a task that ended without a result.

    This one tells joblib of the error; if all the workers of a cell were killed, the cell itself comes instead of its
    end.
    """
    from distributed import KilledWorker
    from joblib._dask import DaskDistributedBackend

    class Backend(DaskDistributedBackend):
        def effective_n_jobs(self, n_jobs: int) -> int:
            return 2  # how many compute is up to Dask; with one, joblib would compute here

        def submit(self, func: Any, callback: Any = None) -> Any:
            def tell(future: Any) -> None:
                error = future.exception()
                if isinstance(error, KilledWorker):
                    ((_, (cell, _, _), _),) = func.items
                    callback([cell])
                elif error is not None:
                    callback(error)

            future = super().submit(func, callback)
            future.add_done_callback(tell)
            return future

        def retrieve_result_callback(self, out: Any) -> Any:
            if isinstance(out, BaseException):
                raise out
            return super().retrieve_result_callback(out)

    return Backend(client=client)


@contextmanager
def _dispatched(parallel: Any, folder: Path, cells: Sequence[Cell]) -> Iterator[Iterator[Any]]:
    """The ends of cells that joblib was given; when left early, the processes that compute are stopped."""
    from joblib import delayed

    ends = parallel(delayed(_work)(cell, folder, cell.key) for cell in cells)
    try:
        yield ends
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that some cells were not computed, and that one could dispatch fewer
            ends.close()


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    from dask.distributed import Client

    try:
        client = Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConnectionError(f"no Dask scheduler answers at {scheduler}: {error}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError:
            raise ConnectionError(f"the Dask scheduler at {scheduler} has no workers") from None
        try:
            client.run(source_digest, __name__)  # a worker that cannot even import this would fall silent
        except Exception as error:
            raise ConnectionError(f"the Dask workers do not have this package: {error}") from None
        yield client
