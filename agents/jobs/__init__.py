"""Jobs of work: pure functions whose results are kept, so that a run may stop anywhere and go on.

A `Job` names a function and its arguments. `run` computes what is missing and keeps each result in
a file of its own::

    out/jobs/<key>.json     values, with the description that the key is the hash of
    out/jobs/<key>.zip      what the function wrote beside them, e.g. a checkpoint
    out/failed/<key>.json    the traceback of a job that failed; it is tried again in the next run
    out/set-aside/           what lay in the place of a result and was damaged or not ours
    out/journal.jsonl        a line for each computed job: when, where, how long

A result is written whole or not at all, under a lock of its own: several runs may share a folder,
and after a crash exactly what is missing is computed. Results hold no times, so those of two runs
are equal byte for byte.

They may import files and sources of `agents`, nothing that flies; studies and maintainers' commands
import them.
"""

from agents.jobs.job import Job
from agents.jobs.pools import Workers, check_scheduler
from agents.jobs.runner import Outcome, Status, run
from agents.jobs.schedule import seconds_left
from agents.jobs.store import artifact_path, journal, load, result_path

__all__ = [
    "Job",
    "Outcome",
    "Status",
    "Workers",
    "artifact_path",
    "check_scheduler",
    "journal",
    "load",
    "result_path",
    "run",
    "seconds_left",
]
