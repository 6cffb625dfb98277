"""Jobs: pure functions whose results are files, so that a run may stop anywhere and go on.

A `Job` names a function and its arguments. `run` computes what is missing; the result of each job
is a file, ``jobs/<key>.json``, whose name is a hash of all that the result depends on. What the
function writes beside its values, e.g. a policy, is ``jobs/<key>`` with its own suffix. A result is
written whole or not at all, so several runs may share a folder, and after a crash exactly what is
missing is computed. Results are JSON: nothing in them is executed.
"""

import hashlib
import json
import os
import platform
import random
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import vessel_gym
from agents.files import write_text
from agents.source import source_digest
from vessel_gym.extras import require

_PATIENCE = 30  # seconds for a Dask scheduler or its first worker to answer


@cache
def versions() -> dict[str, str]:
    """Versions of the libraries that every result depends on."""
    libraries = {name: metadata.version(name) for name in ("numpy", "scipy", "llvmlite")}
    return {"vessel-gym": vessel_gym.__version__} | libraries


@dataclass(frozen=True, eq=False)
class Job:
    """A pure function and everything that its result depends on.

    Attributes:
        function: ``"module:name"``. It is called with the arguments and returns values by name:
            JSON values or arrays of numbers.
        arguments: Keyword arguments, JSON values. The function gets what JSON makes of them: lists
            for tuples.
        label: Description for people.
        needs: Jobs whose artifacts the function reads; it gets their paths as ``needs``. They need
            no others.
        artifact: Suffix of a file that the function writes beside its values; it gets the path as
            ``artifact``.
    """

    function: str
    arguments: dict[str, Any]
    label: str = ""
    needs: tuple["Job", ...] = ()
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
            "needs": [job.key for job in self.needs],
            "artifact": self.artifact,
            "versions": versions(),
            "source": source_digest(self.function.partition(":")[0]),
        }
        return json.loads(json.dumps(described))

    @cached_property
    def key(self) -> str:
        """Name of the result: a hash of the description."""
        text = json.dumps(self.description, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def call(self, folder: Path) -> Any:
        """Values of the function."""
        module, _, name = self.function.partition(":")
        files: dict[str, Any] = {}
        if self.artifact:
            files["artifact"] = folder / (self.key + self.artifact)
        if self.needs:
            files["needs"] = [folder / (job.key + job.artifact) for job in self.needs]
        return getattr(import_module(module), name)(**self.description["arguments"], **files)


@dataclass
class Outcome:
    """Values and CPU seconds of jobs by key, and why others failed: label, traceback or reason."""

    values: dict[str, dict[str, Any]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)

    def add(self, key: str, record: dict[str, Any]) -> None:
        """Take in the end of a job: what `load` gives, or else its ``failure``."""
        if "failure" in record:
            self.failures[key] = record["failure"]
        else:
            self.values[key], self.seconds[key] = record["values"], record["cpu_seconds"]


def run(
    jobs: Iterable[Job],
    folder: Path,
    processes: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int, int, int], None] = lambda done, failed, total: None,
) -> Outcome:
    """Compute the jobs that have no result yet.

    A job that fails does not stop the others, and is tried again in the next run. Several runs may
    share a folder: each goes through the jobs in an order of its own, and takes what the others
    have finished.

    Args:
        jobs: What is wanted; jobs that others need are added.
        folder: Where the results are kept, in ``jobs``; made if it is not there.
        processes: Processes on this machine, with one thread each; 1: this process.
        scheduler: Address of a Dask scheduler whose workers compute instead; they must see the
            folder.
        progress: Called at the start and after every job with (jobs done, failed, in all). Those
            that others need come first. Otherwise jobs are computed in random order, so the first
            of them take as long as others.

    Returns:
        Values of all jobs that have some, with what failed.

    Raises:
        OSError: if the run cannot go on, as on a full disk or when a process is killed; what was
            finished is kept.
        ModuleNotFoundError: without joblib, or with a scheduler without Dask.
    """
    require("dask" if scheduler else "joblib")
    folder = Path(folder).resolve() / "jobs"
    folder.mkdir(parents=True, exist_ok=True)
    wanted = {job.key: job for last in jobs for job in (*last.needs, last)}
    needed = {need.key for job in wanted.values() for need in job.needs}
    outcome = Outcome()
    for key, job in wanted.items():
        if record := load(job, folder):
            outcome.add(key, record)
    left = [job for key, job in wanted.items() if key not in outcome.values]
    for first in (True, False):
        ready = []
        for job in (job for job in left if (not job.needs) == first):
            if lost := [need.label for need in job.needs if need.key in outcome.failures]:
                outcome.failures[job.key] = f"{job.label}: not tried, it needs {lost[0]}"
            else:
                ready.append(job)
        progress(len(outcome.values), len(outcome.failures), len(wanted))
        random.shuffle(ready)
        ready.sort(key=lambda job: job.key not in needed)
        for end in _compute_all(ready, folder, processes, scheduler):
            outcome.add(*end)
            progress(len(outcome.values), len(outcome.failures), len(wanted))
    return outcome


End = tuple[str, dict[str, Any]]
"""Key of a job, and its record, or the reason why there is none as ``failure``."""


def _compute_all(
    jobs: list[Job], folder: Path, processes: int, scheduler: str | None
) -> Iterator[End]:
    """Ends of jobs in order of completion.

    Raises:
        OSError: if no more can be computed or stored.
    """
    try:
        if scheduler and jobs:
            yield from _on_cluster(jobs, folder, scheduler)
        elif jobs:
            yield from _on_this_machine(jobs, folder, processes)
    except Exception as error:
        killed = "a process that computes was killed, perhaps for want of memory"
        why = killed if isinstance(error, BrokenExecutor) else error
        kept = "what was finished is kept, and the same run goes on from there"
        raise OSError(f"{why}; {kept}") from error


def _on_this_machine(jobs: list[Job], folder: Path, processes: int) -> Iterator[End]:
    from joblib import Parallel, delayed, parallel_config

    begin = {"initializer": _begin, "initargs": (os.getpid(),)}
    with parallel_config("loky", n_jobs=processes, inner_max_num_threads=1, **begin):
        parallel = Parallel(return_as="generator_unordered")
    yield from parallel(delayed(compute)(job, folder) for job in jobs)


def _begin(parent: int) -> None:
    """End this process soon after its parent, which may be killed before it can stop it.

    Ctrl-C reaches the parent, too, which stops its workers. Joblib replaces a worker that has grown
    by 300 MB since its first job. Torch is half of that, and the compiled programs of a study's
    filters, which stay, are more.
    """
    from joblib.externals.loky import process_executor

    process_executor._MAX_MEMORY_LEAK_SIZE = 2_000_000_000
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _on_cluster(jobs: list[Job], folder: Path, scheduler: str) -> Iterator[End]:
    """Ends of jobs on Dask's workers.

    Joblib's own backend for Dask waits forever for a job that killed every worker it was tried on.
    """
    from dask.distributed import Client, KilledWorker, as_completed

    with Client(scheduler, timeout=_PATIENCE) as client:
        client.wait_for_workers(1, timeout=_PATIENCE)
        futures = client.map(compute, jobs, folder=folder, pure=False)
        submitted = dict(zip(futures, jobs, strict=True))
        for future in as_completed(submitted):
            try:
                yield future.result()
            except KilledWorker as error:
                job = submitted[future]
                yield job.key, {"failure": f"{job.label}: {error}"}


def compute(job: Job, folder: Path) -> End:
    """Compute a job unless its result is there, and store it.

    Raises:
        RuntimeError: where the code is not that of the run.
        OSError: if the result cannot be stored.
    """
    if replace(job).key != job.key:
        raise RuntimeError(
            f"{platform.node()} has other code of this package than the run was started with, or"
            " other versions of libraries: it would compute other results"
        )
    if not folder.is_dir():
        raise OSError(f"{platform.node()} does not see {folder}: all workers need that folder")
    if record := load(job, folder):
        return job.key, record
    begin = time.process_time()
    try:
        values = json.loads(json.dumps(job.call(folder), default=lambda array: array.tolist()))
        digest = _digest(job, folder, values)
    except (Exception, SystemExit):
        return job.key, {"failure": f"{job.label}: {traceback.format_exc()}"}
    seconds = time.process_time() - begin
    record = {"job": job.description, "values": values, "cpu_seconds": seconds, "sha256": digest}
    write_text(folder / f"{job.key}.json", json.dumps(record))
    return job.key, record


def load(job: Job, folder: Path) -> dict[str, Any] | None:
    """Record of a job: values, CPU seconds; None if there is none, or it is damaged."""
    try:
        record = json.loads((folder / f"{job.key}.json").read_bytes())
        whole = record["sha256"] == _digest(job, folder, record["values"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return record if whole else None


def _digest(job: Job, folder: Path, values: Any) -> str:
    """SHA-256 of a result: of its key, its values, and the file beside them."""
    data = json.dumps([job.key, values]).encode()
    artifact = (folder / (job.key + job.artifact)).read_bytes() if job.artifact else b""
    return hashlib.sha256(data + artifact).hexdigest()
