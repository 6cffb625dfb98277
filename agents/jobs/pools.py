"""Execution of jobs: in this process, in others of this machine, or on a Dask cluster."""

import os
import re
import socket
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

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


@contextmanager
def pool(
    folder: Path, processes: int, scheduler: str | None, modules: Sequence[str] = ()
) -> Iterator[tuple[Compute, int]]:
    """A function that computes jobs of ``modules``, yielding their ends as they come, and its parallelism."""
    if scheduler is not None:
        with _client(scheduler) as client:
            yield partial(_on_cluster, folder, client), sum(client.nthreads().values())
    elif processes > 1:
        yield partial(_in_processes, folder, processes, tuple(modules)), processes
    else:
        yield partial(_here, folder), 1


def _here(folder: Path, jobs: Sequence[Job]) -> Ends:
    yield from (work(job, folder, job.key) for job in jobs)


def _in_processes(folder: Path, processes: int, modules: tuple[str, ...], jobs: Sequence[Job]) -> Ends:
    require("joblib")
    from joblib import Parallel, parallel_config
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    left = {job.key: job for job in jobs}
    with parallel_config(backend="loky", inner_max_num_threads=1, initializer=_begin, initargs=(os.getpid(), modules)):
        processes = min(processes, max(len(jobs), 2))  # with one, joblib would compute here
        parallel = Parallel(processes, return_as="generator_unordered", batch_size=1)
    try:
        with _dispatched(parallel, folder, jobs) as ends:
            for end in ends:
                del left[end.key]
                yield end
    except TerminatedWorkerError:
        pass  # a process was killed, and joblib ended the others with it
    for at_once in (processes, 1):  # the second time alone: it has all the memory there is
        with closing(_apart(folder, at_once, list(left.values()))) as tries:
            for job, result, cause in tries:
                if result is not None:
                    del left[job.key]
                    yield result
                elif at_once == 1:
                    yield _killed(job, folder, f"the process that computed it was killed twice ({cause})")


def _apart(folder: Path, at_once: int, jobs: Sequence[Job]) -> Generator[tuple[Job, End | None, str], None, None]:
    """Each job in a process of its own: its end, or else what ended the process."""
    from concurrent.futures import FIRST_COMPLETED, Future, wait

    from joblib.externals.loky.process_executor import ProcessPoolExecutor, TerminatedWorkerError

    left, running = deque(jobs), dict[Future[End], tuple[Job, ProcessPoolExecutor]]()
    try:
        while left or running:
            while left and len(running) < at_once:
                job = left.popleft()
                process = ProcessPoolExecutor(1, initializer=_begin, initargs=(os.getpid(),), env=_ONE_THREAD)
                running[process.submit(work, job, folder, job.key)] = job, process
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job, process = running.pop(future)
                process.shutdown()
                try:
                    yield job, future.result(), ""
                except TerminatedWorkerError as error:
                    codes = re.search(r"\{(.*)\}", str(error))  # e.g. SIGKILL(-9)
                    yield job, None, codes[1] if codes else "nobody knows how"
    finally:
        for _, process in running.values():
            process.shutdown(kill_workers=True)


def _begin(parent: int, modules: tuple[str, ...] = ()) -> None:
    """End this process soon after its parent, which may be killed before it can stop it, and import what jobs need.

    Loky ends a worker, with a warning, that has grown by 300 MB since its first job. Torch alone is half of that.
    """

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
    from joblib import Parallel

    parallel = Parallel(-1, _dask_backend(client), return_as="generator_unordered", pre_dispatch="all", batch_size=1)
    killed: list[Job] = []
    try:
        with _dispatched(parallel, folder, jobs) as ends:
            for end in ends:
                if isinstance(end, Job):
                    killed.append(end)
                else:
                    yield end
        for job in killed:  # alone: Dask blames all that were on a worker
            with _dispatched(parallel, folder, [job]) as ends:
                for end in ends:
                    text = "every worker that computed it was killed"
                    yield _killed(job, folder, text) if isinstance(end, Job) else end
    except CannotStore:
        raise
    except Exception as error:
        raise ConnectionError(f"the Dask workers cannot go on: {type(error).__name__}: {error}") from error


def _dask_backend(client: Any) -> Any:
    """Joblib's backend for Dask, which would wait for ever for a task that ended without a result.

    This one tells joblib of the error; if all the workers of a job were killed, the job itself comes instead of its
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
                    ((_, (job, _, _), _),) = func.items
                    callback([job])
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
def _dispatched(parallel: Any, folder: Path, jobs: Sequence[Job]) -> Iterator[Iterator[Any]]:
    """The ends of jobs that joblib was given; when left early, the processes that compute are stopped."""
    from joblib import delayed

    ends = parallel(delayed(work)(job, folder, job.key) for job in jobs)
    try:
        yield ends
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that some jobs were not computed, and that one could dispatch fewer
            ends.close()


def check_scheduler(address: str) -> None:
    """Refuse what is no scheduler's address, or one at which nothing listens; Dask itself takes a minute for that.

    Raises:
        ValueError: if it is no address.
        ConnectionError: if nobody listens there.
    """
    found = re.fullmatch(r"(?:(?:tcp|tls)://)?(?:\[([^\s\[\]]+)\]|([^\s:/\[\]]+)):(\d{1,5})", address)
    if not found or not 1 <= int(found[3]) <= 65535:
        raise ValueError(f"a scheduler's address is like tcp://10.0.0.1:8786, got {address!r}")
    end = time.monotonic() + _PATIENCE  # it may be starting at this moment
    while True:
        try:
            socket.create_connection((found[1] or found[2], int(found[3])), timeout=_PATIENCE).close()
            return
        except (OSError, UnicodeError) as error:
            hopeless = isinstance(error, socket.gaierror | UnicodeError)  # a host's name that is none
            if hopeless or time.monotonic() >= end:
                raise ConnectionError(f"no Dask scheduler answers at {address}: {error}") from None
        time.sleep(0.1)


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    require("dask", "distributed", "joblib")
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
            client.run(source_digest, __name__)  # a worker that cannot even import this would fall silent
        except Exception as error:
            raise ConnectionError(f"the Dask workers do not have this package: {error}") from None
        yield client
