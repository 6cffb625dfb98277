"""One job, computed and stored."""

import errno
import json
import platform
import time
import traceback
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from agents.files import replacing
from agents.jobs.job import LIBRARIES, Job
from agents.jobs.store import (
    artifact_path,
    failure_path,
    load,
    lock,
    note,
    plain,
    save,
    save_failure,
)

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


class End(NamedTuple):
    """End of a job: its values, or the failure; its seconds, if it was computed now."""

    key: str
    values: dict[str, Any] | None
    failure: str = ""
    seconds: float | None = None


class CannotStore(OSError):
    """Nothing can be stored where a job is computed: the run stops."""


def work(job: Job, folder: Path, key: str) -> End:
    """Compute a job unless its result is there, and store it.

    Raises:
        CannotStore: if the result cannot be written, or if it would not be the one that ``key``
            stands for.
    """
    host = platform.node()
    if job.key != key:
        raise CannotStore(
            f"{host} has other code of this package than the run was started with, or another"
            f" version of {', '.join(LIBRARIES)}: it would compute other results"
        )
    if not (folder / "jobs").is_dir():
        raise CannotStore(f"{host} does not see {folder}: all workers need the same folder")
    try:
        with lock(key, folder):
            values = load(job, folder)
            return _compute(job, folder) if values is None else End(key, values)
    except OSError as error:
        raise CannotStore(f"cannot store results in {folder}: {error.strerror or error}") from None


def _compute(job: Job, folder: Path) -> End:
    begin, cpu = time.perf_counter(), time.process_time()
    try:
        with ExitStack() as stack:
            artifact = (
                stack.enter_context(replacing(artifact_path(job, folder))) if job.artifact else None
            )
            values = job.compute(artifact, [artifact_path(need, folder) for need in job.needs])
            if not isinstance(values, dict):
                raise TypeError(
                    f"{job.function} returned {type(values).__name__}, not values by name"
                )
            timing = plain(values.pop("timing", None))
            values = json.loads(
                json.dumps(plain(values))
            )  # what cannot be stored is the job's fault, and shows here
    except (Exception, SystemExit) as error:
        if full := _full_disk(error):
            raise full from None
        text = traceback.format_exc()
        save_failure(job, folder, text)
        return End(job.key, None, text)
    save(job, folder, values)
    seconds = time.perf_counter() - begin
    note(job, folder, seconds, time.process_time() - cpu, timing)
    failure_path(job, folder).unlink(missing_ok=True)
    return End(job.key, values, seconds=seconds)


def _full_disk(error: BaseException | None) -> OSError | None:
    """The full disk behind an error: libraries wrap it in errors of their own."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return error
        error = error.__cause__ or error.__context__
    return None
