"""Execution of jobs: in this process, in others of this machine, or on a Dask cluster."""

import os
import re
import signal
import socket
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Executor, as_completed
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from queue import Empty
from typing import Any, Self

from agents.jobs.job import Job
from agents.jobs.store import save_failure
from agents.jobs.work import CannotStore, End, work
from agents.source import source_digest
from vessel_gym.extras import require

_PATIENCE = 30  # seconds for a Dask scheduler or its first worker to answer
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)

Ends = Generator[End, None, None]
Compute = Callable[[Sequence[Job]], Ends]
"""Computes jobs and yields their ends in order of completion."""


class Workers:
    """Processes of this machine, of one thread each, which start with the first jobs and serve several runs.

    Args:
        processes: Their number.
        modules: What each imports at its start.
    """

    def __init__(self, processes: int, modules: Sequence[str] = ()) -> None:
        self.processes, self._modules = processes, tuple(modules)
        self._open = ExitStack()
        self._pool: tuple[Executor, type[Exception]] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> tuple[Executor, type[Exception]]:
        """Executor of the processes, and the error of a job when one of them is killed."""
        if self._pool is None:
            self._pool = self._open.enter_context(_pool(self.processes, self._modules))
        return self._pool

    def stop(self) -> None:
        """End the processes, with what they compute."""
        self._pool = None
        self._open.close()


@contextmanager
def pool(
    folder: Path, processes: int | Workers, scheduler: str | None, modules: Sequence[str] = ()
) -> Iterator[tuple[Compute, int]]:
    """A function that computes jobs of ``modules``, yielding their ends as they come, and its parallelism."""
    if scheduler is not None:
        with _client(scheduler) as client:
            yield partial(_on_cluster, folder, client), sum(client.nthreads().values())
    elif isinstance(processes, Workers):
        yield partial(_in_processes, folder, processes), processes.processes
    elif processes > 1:
        with Workers(processes, modules) as own:
            yield partial(_in_processes, folder, own), processes
    else:
        yield partial(_here, folder), 1


def _here(folder: Path, jobs: Sequence[Job]) -> Ends:
    yield from (work(job, folder, job.key) for job in jobs)


Tries = Generator[tuple[Job, End | Exception], None, None]
"""Jobs in order of completion, each with its end, or with the error of a process that was killed."""


def _tried(executor: Executor, killed: type[Exception], folder: Path, jobs: Iterable[Job]) -> Tries:
    """Each job on an executor, which raises ``killed`` for a job whose process was killed."""
    futures = {executor.submit(work, job, folder, job.key): job for job in jobs}
    for future in as_completed(futures):
        error = future.exception()
        if error is not None and not isinstance(error, killed):
            raise error
        yield futures.pop(future), error or future.result()


def _in_processes(folder: Path, workers: Workers, jobs: Sequence[Job]) -> Ends:
    """Jobs in a pool. A killed process ends the pool: those that it may have computed are tried again, one by one."""
    left = dict.fromkeys(jobs)
    while left:
        complete = False
        try:
            for job, end in _tried(*workers.start(), folder, left):
                if isinstance(end, End):
                    del left[job]
                    yield end
            complete = not left
        finally:
            if not complete:
                workers.stop()
        for job in list(left)[
            : 2 * workers.processes
        ]:  # jobs begin in their order: the killed one is among the first
            del left[job]
            yield _alone(job, folder)


def _alone(job: Job, folder: Path) -> End:
    """A job in a process of its own, which has all the memory there is, and then once more."""
    for _ in range(2):
        with _pool(1) as (executor, killed):
            ((_, end),) = _tried(executor, killed, folder, [job])
        if isinstance(end, End):
            return end
    codes = re.search(r"\{(.*)\}", str(end))  # e.g. SIGKILL(-9)
    cause = codes[1] if codes else "nobody knows how"
    return _killed(job, folder, f"the process that computed it was killed twice ({cause})")


@contextmanager
def _pool(
    processes: int, modules: tuple[str, ...] = ()
) -> Iterator[tuple[Executor, type[Exception]]]:
    """Processes of one thread each, stopped at the end, and the error of a job when one of them is killed."""
    require("joblib")
    from joblib.externals.loky.process_executor import ProcessPoolExecutor, TerminatedWorkerError

    executor = ProcessPoolExecutor(
        processes, initializer=_begin, initargs=(os.getpid(), modules), env=_ONE_THREAD
    )
    try:
        yield executor, TerminatedWorkerError
    finally:
        with suppress(
            Empty
        ):  # loky forgets jobs that have not begun, and then fails to find those in this queue
            while True:
                executor._work_ids.get_nowait()
        executor.shutdown(kill_workers=True)


_GROWTH = 2_000_000_000  # bytes


def _begin(parent: int, modules: tuple[str, ...] = ()) -> None:
    """End this process soon after its parent, which may be killed before it can stop it, and import what jobs need.

    Loky ends a worker, with a warning, that has grown by 300 MB since its first job. Torch is half
    of that, and the compiled programs of a study's filters, which stay, are more: only a worker
    that grows by `_GROWTH` is replaced.
    """
    from joblib.externals.loky import process_executor

    process_executor._MAX_MEMORY_LEAK_SIZE = _GROWTH
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # Ctrl-C reaches the parent, too, which stops its workers

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    for module in modules:
        with suppress(Exception):  # the job that needs it says why it fails
            import_module(module)


def _killed(job: Job, folder: Path, text: str) -> End:
    failure = f"{text}, perhaps for want of memory"
    save_failure(job, folder, failure)
    return End(job.key, None, failure)


def _on_cluster(folder: Path, client: Any, jobs: Sequence[Job]) -> Ends:
    """Jobs on Dask's workers. Dask blames all jobs that were on a killed worker: they are tried again, one by one."""
    from distributed import KilledWorker

    executor, left = client.get_executor(pure=False), list[Job]()
    try:
        for job, end in _tried(executor, KilledWorker, folder, jobs):
            if isinstance(end, End):
                yield end
            else:
                left.append(job)
        for job in left:
            ((_, end),) = _tried(executor, KilledWorker, folder, [job])
            yield (
                end
                if isinstance(end, End)
                else _killed(job, folder, "every worker that computed it was killed")
            )
    except CannotStore:
        raise
    except Exception as error:
        raise ConnectionError(
            f"the Dask workers cannot go on: {type(error).__name__}: {error}"
        ) from error
    finally:
        executor.shutdown(wait=False)


def check_scheduler(address: str) -> None:
    """Refuse what is no scheduler's address, or one at which nothing listens; Dask itself takes a minute for that.

    Raises:
        ValueError: if it is no address.
        ConnectionError: if nobody listens there.
    """
    found = re.fullmatch(
        r"(?:(?:tcp|tls)://)?(?:\[([^\s\[\]]+)\]|([^\s:/\[\]]+)):(\d{1,5})", address
    )
    if not found or not 1 <= int(found[3]) <= 65535:
        raise ValueError(f"a scheduler's address is like tcp://10.0.0.1:8786, got {address!r}")
    end = time.monotonic() + _PATIENCE  # it may be starting at this moment
    while True:
        try:
            socket.create_connection(
                (found[1] or found[2], int(found[3])), timeout=_PATIENCE
            ).close()
            return
        except (OSError, UnicodeError) as error:
            hopeless = isinstance(
                error, socket.gaierror | UnicodeError
            )  # a host's name that is none
            if hopeless or time.monotonic() >= end:
                raise ConnectionError(f"no Dask scheduler answers at {address}: {error}") from None
        time.sleep(0.1)


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    require("dask", "distributed")
    from dask.distributed import Client

    check_scheduler(scheduler)
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
            client.run(
                source_digest, __name__
            )  # a worker that cannot even import this would fall silent
        except Exception as error:
            raise ConnectionError(f"the Dask workers do not have this package: {error}") from None
        yield client
