"""Running jobs: what is missing is computed, in whatever order and place is best."""

from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agents.jobs.job import Job
from agents.jobs.pools import Compute, Workers, pool
from agents.jobs.schedule import Clock, Forecast, part, waves, with_needs
from agents.jobs.store import end_journal, journal, load, set_aside, strangers, sweep
from agents.jobs.work import CannotStore


@dataclass
class Outcome:
    """Outcome of a run: values of jobs by key, failures (traceback, or the reason for not trying) of the others.

    ``computed`` counts the jobs of this run; ``notes`` are for the user: files set aside, results
    of other versions.
    """

    values: dict[str, dict[str, Any]] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    computed: int = 0
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Status:
    """Progress of a run, in jobs, with the label of the one that ended last.

    ``seconds_left`` is an estimate: None before any job of each function has been timed.
    """

    done: int
    total: int
    failed: int
    seconds_left: float | None
    label: str = ""


Progress = Callable[[Status], None]


def run(
    jobs: Iterable[Job],
    folder: Path,
    processes: int = 1,
    scheduler: str | None = None,
    shard: tuple[int, int] | None = None,
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> Outcome:
    """Compute the jobs that have no result yet.

    A job that fails does not stop the others; nor does one whose process is killed, which is tried
    once more, alone.

    Args:
        jobs: What is wanted; jobs that others need are added.
        folder: Where the results are kept; made if it is not there.
        processes: Processes on this machine, with one thread each; 1: this process.
        scheduler: Address of a Dask scheduler whose workers compute instead; they must see the
            folder.
        shard: ``(i, n)``: only the i-th of n parts, counted from 1.
        progress: Called at the start and after every job.
        workers: Processes that serve several runs, in place of those of this run alone.

    Returns:
        Values of all jobs that have some, with what failed.

    Raises:
        ValueError: for a number of processes or a shard that makes no sense.
        OSError: if the results cannot be written, e.g. on a full disk; what was finished is stored.
        ConnectionError: if there is no such scheduler, or its workers cannot compute.
    """
    if processes < 1:
        raise ValueError(f"processes must be at least 1, got {processes}")
    folder, wanted = Path(folder).resolve(), with_needs(jobs)
    mine = wanted if shard is None else part(wanted, *shard)
    outcome = _stored(wanted, folder)
    missing = {key: job for key, job in mine.items() if key not in outcome.values}
    others = len(outcome.values) - (len(mine) - len(missing))  # of other parts of a job array
    clock, left = (
        Clock(journal(folder)),
        [{job.key: job for job in wave} for wave in waves(missing)],
    )
    forecast, parallel = Forecast(clock, left), processes

    def report(label: str = "") -> None:
        if progress is not None:
            done = len(outcome.values) - others
            progress(
                Status(
                    done, len(mine), len(outcome.failures), forecast.seconds_left(parallel), label
                )
            )

    report()
    if not missing:
        return outcome
    try:
        with pool(folder, workers or processes, scheduler, _modules(missing)) as (
            compute,
            parallel,
        ):
            for wave in left:
                with closing(_compute(wave, compute, clock, outcome)) as labels:
                    for label in labels:
                        report(label)
    except CannotStore as error:
        stored = f"{len(outcome.values) - others} of {len(mine)} are stored"
        raise OSError(f"{error}; {stored}, and the same run goes on from there") from None
    finally:
        sweep(folder)
    return outcome


def _modules(jobs: dict[str, Job]) -> list[str]:
    """Modules whose functions are called."""
    return sorted({job.function.partition(":")[0] for job in jobs.values()})


def _stored(wanted: dict[str, Job], folder: Path) -> Outcome:
    """The results that a folder holds already; what is damaged there is set aside."""
    try:
        for name in ("jobs", "failed"):
            (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"cannot store results in {folder}: {error.strerror}") from None
    sweep(folder)
    end_journal(folder)
    outcome = Outcome()
    for key, job in wanted.items():
        values = load(job, folder)
        if values is None:
            outcome.notes += set_aside(job, folder)
        else:
            outcome.values[key] = values
    outcome.notes += strangers(wanted, folder)
    return outcome


def _compute(
    wave: dict[str, Job], compute: Compute, clock: Clock, outcome: Outcome
) -> Generator[str, None, None]:
    """Compute a wave, from which jobs are removed as they end; yields the label of each."""
    for job in list(wave.values()):
        lost = [need for need in job.needs if need.key not in outcome.values]
        if lost:
            del wave[job.key]
            outcome.failures[job.key] = (
                f"not tried: it needs {lost[0].label or lost[0].key}, which has no result"
            )
            yield job.label
    with closing(compute(clock.longest_first(list(wave.values())))) as ends:
        for key, values, failure, seconds in ends:
            job = wave.pop(key)
            if values is None:
                outcome.failures[key] = failure
            else:
                outcome.values[key] = values
            if seconds is not None:
                outcome.computed += 1
                clock.add(job.label, job.function, seconds)
            yield job.label
