import errno
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from agents.jobs import (
    Job,
    Status,
    Workers,
    artifact_path,
    journal,
    load,
    pools,
    result_path,
    run,
    schedule,
    seconds_left,
)
from agents.jobs import job as job_module
from agents.jobs.schedule import Clock
from agents.jobs.work import work

HERE = Path(__file__).parent
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parents[1])])}
PATIENCE = 60  # seconds that a process may take for what takes it one


def job(name: str, needs: tuple[Job, ...] = (), artifact: str = "", **arguments) -> Job:
    return Job(f"job_functions:{name}", arguments, name, needs, artifact)


def study(seconds: float = 0.0, draws: int = 8) -> list[Job]:
    """Twelve jobs, or more, in two waves, three of them with artifacts."""
    written = tuple(job("write", artifact=".bin", seed=seed, seconds=seconds) for seed in range(3))
    return [
        *(job("draw", seed=seed, seconds=seconds) for seed in range(draws)),
        job("read", needs=written),
    ]


def long_study() -> list[Job]:
    """44 jobs that take a second and a half in all."""
    return study(0.03, draws=40)


def stored(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "jobs").iterdir()}


def leftovers(folder: Path) -> list[str]:
    return [path.name for name in ("jobs", "failed") for path in (folder / name).glob(".*")]


@pytest.fixture(scope="module")
def expected(tmp_path_factory) -> dict[str, bytes]:
    """The files of a study that nobody interrupted, on this machine: another one's flights round otherwise."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    run(long_study(), folder)
    return stored(folder)


# --- a job ----------------------------------------------------------------------------------------


def test_a_key_depends_on_the_function_the_arguments_the_needs_and_the_package_version(monkeypatch):
    first = job("draw", seed=0)
    assert first.key == job("draw", seed=0).key
    assert first.key == Job(first.function, first.arguments, "by another name").key
    others = [
        job("draw", seed=1),
        job("draw", seed=0.0),
        job("echo", seed=0),
        job("draw", (first,), seed=0),
    ]
    others.append(job("draw", artifact=".zip", seed=0))
    monkeypatch.setattr(job_module, "_versions", lambda: {"vessel-gym": "0.0.0"})
    others.append(job("draw", seed=0))
    assert len({first.key, *(other.key for other in others)}) == 1 + len(others)


def test_a_function_gets_what_the_key_is_made_of(tmp_path):
    tuples, lists = job("echo", a=(1, 2), b={1: 2}), job("echo", a=[1, 2], b={"1": 2})
    assert tuples.key == lists.key
    assert run([tuples], tmp_path).values[tuples.key] == {
        "arguments": {"a": [1, 2], "b": {"1": 2}}, "types": ["list", "dict"],
    }  # fmt: skip


def test_arguments_are_json_values():
    with pytest.raises(TypeError, match="not JSON serializable"):
        _ = job("echo", a=object()).key


def test_results_are_read_as_they_were_returned(tmp_path):
    drawn = job("draw", seed=3)
    values = run([drawn], tmp_path).values[drawn.key]
    np.testing.assert_array_equal(values["values"], np.random.default_rng(3).normal(size=50))
    np.testing.assert_equal(load(drawn, tmp_path), values)
    np.testing.assert_equal(run([drawn], tmp_path).values[drawn.key], values)


# --- a run ----------------------------------------------------------------------------------------


def test_what_is_stored_is_not_computed_again(tmp_path):
    first = run(study(), tmp_path)
    again = run(study(), tmp_path)
    assert (first.computed, again.computed) == (12, 0)
    np.testing.assert_equal(again.values, first.values)
    assert run([*study(), job("draw", seed=8)], tmp_path).computed == 1


def test_a_job_reads_the_artifacts_that_it_needs(tmp_path):
    *_, needing = study()
    values = run([needing], tmp_path).values[needing.key]
    assert values["bytes"] == [
        artifact_path(need, tmp_path).read_bytes().hex() for need in needing.needs
    ]


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
def test_a_job_that_fails_stops_no_other_and_is_tried_again(tmp_path, processes):
    failing, lost, leaving = (
        job("fail", text="no luck"),
        job("fail", artifact=".bin", text=""),
        job("leave"),
    )
    needing = job("read", needs=(lost,))
    for _ in range(2):
        outcome = run([failing, leaving, job("nothing"), needing, *study()], tmp_path, processes)
        assert outcome.failures[failing.key].endswith("ValueError: no luck\n")
        assert "in fail" in outcome.failures[failing.key]
        assert outcome.failures[leaving.key].endswith("SystemExit: left\n")
        assert outcome.failures[needing.key] == "not tried: it needs fail, which has no result"
        assert len(outcome.failures) == 5
        assert {one.key for one in study()} <= outcome.values.keys()
        record = json.loads((tmp_path / "failed" / f"{failing.key}.json").read_text())
        assert record["traceback"] == outcome.failures[failing.key]
        assert not leftovers(tmp_path)


@pytest.mark.slow
def test_processes_give_the_same_files_as_one_and_have_one_thread_and_all_modules_each(
    tmp_path, expected
):
    """Joblib ends a process, with a warning, that grows by 300 MB after its first job: torch must be there before."""
    threads, modules = job("threads"), job("loaded", modules=["colorsys"])
    failing = Job("colorsys:no_function", {}, needs=(modules,))
    outcome = run([*long_study(), threads, failing], tmp_path, processes=2)
    assert outcome.values[modules.key] == {"colorsys": True}
    assert "no_function" in outcome.failures[failing.key]
    assert {"torch", "stable_baselines3"} <= vars(import_module("agents.studies.training")).keys()
    assert outcome.values[threads.key] == dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
    )
    assert dict(stored(tmp_path).items() - expected.items()) == {
        path.name: path.read_bytes()
        for path in (result_path(each, tmp_path) for each in (threads, modules))
    }
    assert expected.items() <= stored(tmp_path).items()


def test_shards_share_the_work_and_none_waits_for_another(tmp_path):
    outcomes = [run(study(), tmp_path / "apart" / str(i), shard=(i, 3)) for i in (1, 2, 3)]
    assert sum(outcome.computed for outcome in outcomes) == 12
    assert set().union(*(outcome.values for outcome in outcomes)) == set(
        run(study(), tmp_path / "whole").values
    )
    for i in (1, 2, 3):
        run(study(), tmp_path / "shared", shard=(i, 3))
    assert len(journal(tmp_path / "shared")) == 12
    assert stored(tmp_path / "shared") == stored(tmp_path / "whole")


@pytest.mark.parametrize("shard", [(0, 3), (4, 3), (1, 0)])
def test_a_shard_is_one_of_its_parts(tmp_path, shard):
    with pytest.raises(ValueError, match="a shard is i/n"):
        run(study(), tmp_path, shard=shard)


def test_jobs_are_counted_from_one(tmp_path):
    with pytest.raises(ValueError, match="processes must be at least 1"):
        run(study(), tmp_path, processes=0)


# --- progress -------------------------------------------------------------------------------------


def test_progress_counts_to_the_end(tmp_path):
    seen: list[Status] = []
    failing = job("fail", text="", artifact=".bin")
    run([*study(), job("read", needs=(failing,))], tmp_path, progress=seen.append)
    assert [status.done + status.failed for status in seen] == list(range(15))
    assert {status.total for status in seen} == {14}
    assert seen[0].seconds_left is None
    assert (seen[-1].failed, seen[-1].seconds_left) == (2, 0.0)


@pytest.mark.slow
def test_the_time_left_is_known_from_the_start_of_a_second_run(tmp_path):
    seen: list[Status] = []
    run([job("draw", seed=0, seconds=0.1)], tmp_path)
    run([job("draw", seed=seed, seconds=0.1) for seed in range(5)], tmp_path, progress=seen.append)
    assert (
        0.4 <= seen[0].seconds_left < 1.0
    )  # four jobs of a tenth of a second and what storing takes
    lefts = [status.seconds_left for status in seen]
    assert lefts == sorted(lefts, reverse=True)
    assert lefts[-1] == 0.0


@pytest.mark.parametrize(
    ("waves", "workers", "seconds"),
    [
        ([], 2, 0.0),
        ([[3.0, 1.0, 2.0]], 1, 6.0),
        ([[3.0, 1.0, 2.0]], 2, 3.0),
        ([[1.0, 1.0, 1.0]], 2, 2.0),  # the third waits until one of the others has ended
        ([[5.0], [1.0, 1.0]], 4, 6.0),  # what needs the first waits for it
        ([[5.0, None]], 2, None),
    ],
)
def test_the_time_left_is_that_of_workers_who_take_the_longest_job_first(waves, workers, seconds):
    assert seconds_left(waves, workers) == seconds


# --- damage ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "damage", [b"", b"{", b'{"job": {}}', "another job's", "values changed", "half", b"\xff\xfe"]
)
def test_a_damaged_or_foreign_result_is_set_aside_said_and_computed_again(tmp_path, damage):
    drawn = job("draw", seed=0)
    run([drawn, job("draw", seed=1)], tmp_path)
    path, whole = result_path(drawn, tmp_path), result_path(drawn, tmp_path).read_bytes()
    if damage == "another job's":
        damage = result_path(job("draw", seed=1), tmp_path).read_bytes()
    elif damage == "values changed":
        damage = whole.replace(b'"seed": 0}', b'"seed": 1}', 1).replace(
            b'"seed": 0,', b'"seed": 1,'
        )
        assert damage != whole
    elif damage == "half":
        damage = whole[: len(whole) // 2]
    path.write_bytes(damage)
    outcome = run([drawn, job("draw", seed=1)], tmp_path)
    assert outcome.computed == 1
    assert path.read_bytes() == whole
    (note,) = outcome.notes
    assert note.startswith(f"the result {path.name} was damaged or not ours: it now is in ")
    assert [aside.read_bytes() for aside in (tmp_path / "set-aside").glob("*/*")] == [damage]


WHOLE = b"a line"
"""Stands for one that a run wrote."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage",
    [
        b"{",
        b"null",
        b"[1, 2]",
        b"{}",
        b"\xff\xfe\x00",
        b"[" * 100_000,
        WHOLE[:-40] + b"NaN",
        WHOLE * 2,
        b'{"key": 3}',
    ],
    ids=["cut", "null", "a list", "empty", "no text", "deep", "half", "two in one", "no words"],
)
@pytest.mark.parametrize("place", ["first", "last", "unended"])
def test_a_bad_line_in_the_journal_stops_no_run_and_spoils_no_other_line(tmp_path, damage, place):
    run([job("draw", seed=0)], tmp_path)
    path = tmp_path / "journal.jsonl"
    [line] = path.read_bytes().splitlines()
    damage = damage.replace(WHOLE, line).replace(WHOLE[:-40], line[:-40])
    path.write_bytes(damage + b"\n" + line + b"\n" if place == "first" else line + b"\n" + damage)
    if place == "last":
        path.write_bytes(path.read_bytes() + b"\n")
    assert len(journal(tmp_path)) == 1
    outcome = run([job("draw", seed=0), job("draw", seed=1)], tmp_path)
    assert (outcome.computed, outcome.failures) == (1, {})
    assert outcome.notes == []
    assert [each["key"] for each in journal(tmp_path)] == [
        job("draw", seed=seed).key for seed in (0, 1)
    ]


def test_a_job_reads_no_folder_and_asks_not_for_all_that_are_left(tmp_path, monkeypatch):
    """What grew with the number of jobs: of ten times as many, each costs the same."""
    calls = {"scans": 0, "asked": 0}
    glob, expected = Path.glob, Clock.expected

    def counted(name, function):
        def call(*arguments, **keywords):
            calls[name] += 1
            return function(*arguments, **keywords)

        return call

    monkeypatch.setattr(Path, "glob", counted("scans", glob))
    monkeypatch.setattr(Clock, "expected", counted("asked", expected))
    monkeypatch.setattr(schedule.time, "monotonic", iter(np.arange(1e6) * 1e-6).__next__)
    seen = []
    run([job("echo", number=number) for number in range(300)], tmp_path, progress=seen.append)
    assert len(seen) == 301
    assert calls["scans"] <= 4
    assert calls["asked"] < 300 * 20


@pytest.mark.parametrize("damage", [None, b"", b"other bytes"])
def test_a_damaged_artifact_is_computed_again(tmp_path, damage):
    written = job("write", artifact=".bin", seed=0)
    run([written], tmp_path)
    before, path = stored(tmp_path), artifact_path(written, tmp_path)
    path.unlink()
    if damage is not None:
        path.write_bytes(damage)
    outcome = run([written], tmp_path)
    assert (outcome.computed, len(outcome.notes)) == (1, 1)
    assert stored(tmp_path) == before


def test_unknown_files_and_results_of_other_versions_are_left_alone_and_said(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(job_module, "_versions", lambda: {"vessel-gym": "0.0.0"})
        run(study(), tmp_path)
    (tmp_path / "jobs" / "notes.txt").write_text("mine")
    before = stored(tmp_path)
    outcome = run(study(), tmp_path)
    assert outcome.computed == 12
    assert before.items() <= stored(tmp_path).items()
    assert outcome.notes == [
        f"12 results in {tmp_path / 'jobs'} are of other settings or versions: left alone",
        f"{tmp_path / 'jobs'} holds what is no result: notes.txt: left alone",
    ]


def test_a_full_disk_stops_the_run_in_one_sentence_and_what_was_finished_is_kept(
    tmp_path, monkeypatch
):
    syncs, sync = iter(range(100)), os.fsync

    def full(handle: int) -> None:
        if next(syncs) >= 4:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(handle)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(
            OSError, match="No space left on device; 4 of 12 are stored, and the same run goes on"
        ):
            run(study(), tmp_path)
    assert len(list((tmp_path / "jobs").glob("*.json"))) == 4
    assert not leftovers(tmp_path)
    assert run(study(), tmp_path).computed == 8


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
def test_a_full_disk_inside_a_function_is_no_fault_of_the_job(tmp_path, processes):
    with pytest.raises(
        OSError, match=r"^cannot store results in .*: No space left on device; \d+ of 13 are stored"
    ):
        run([*study(), job("fill")], tmp_path, processes)
    assert not list((tmp_path / "failed").iterdir())
    assert not leftovers(tmp_path)


@pytest.mark.parametrize("place", ["file", "file/below"])
def test_a_folder_that_cannot_be_is_one_sentence(tmp_path, place):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"^cannot store results in \S+: [A-Z][a-z ]+$"):
        run(study(), tmp_path / place)


def test_a_worker_with_other_code_or_another_folder_computes_nothing(tmp_path):
    (tmp_path / "jobs").mkdir()
    with pytest.raises(OSError, match="has other code of this package"):
        work(job("draw", seed=0), tmp_path, "the key there")
    with pytest.raises(
        OSError, match=f"does not see {tmp_path / 'elsewhere'}: all workers need the same folder"
    ):
        work(job("draw", seed=0), tmp_path / "elsewhere", job("draw", seed=0).key)
    assert not stored(tmp_path)


# --- processes that are killed --------------------------------------------------------------------

_RUN = """
import signal
import sys
from pathlib import Path
from agents.jobs import run
from test_jobs import long_study
signal.signal(signal.SIGINT, signal.default_int_handler)  # what a shell starts in the background ignores it
run(long_study(), Path(sys.argv[1]), processes=2, progress=lambda status: print(status.done, flush=True))
"""


def start(folder: Path, stderr: int = subprocess.DEVNULL) -> subprocess.Popen[str]:
    """A run of the study on two processes, in a process group of its own, which prints how much is done."""
    return subprocess.Popen(
        [sys.executable, "-c", _RUN, str(folder)],
        stdout=subprocess.PIPE, stderr=stderr, env=ENVIRONMENT, start_new_session=True, text=True,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("times", [2, pytest.param(8, marks=pytest.mark.nightly)])
def test_killed_at_random_moments_a_run_ends_as_if_it_had_not_been(tmp_path, expected, times):
    moments = random.Random(times)
    for attempt in range(times):
        with start(tmp_path) as process:
            for _ in range(moments.randint(1, 3)):
                process.stdout.readline()
            time.sleep(moments.uniform(0.0, 0.1))
            if attempt % 2:
                os.killpg(process.pid, signal.SIGKILL)
            else:
                # its workers live on for a moment: the next run finds their jobs locked
                process.kill()
        assert all(
            name.startswith(".") or expected[name] == data
            for name, data in stored(tmp_path).items()
        )
    before = sum(
        name.endswith(".json") for name in stored(tmp_path) if name[0] != "."
    )  # others are not complete
    outcome = run(long_study(), tmp_path)
    assert stored(tmp_path) == expected
    assert not leftovers(tmp_path)
    assert 0 < before < 44
    assert 0 < outcome.computed <= 44 - before
    keys = [line["key"] for line in journal(tmp_path)]
    assert len(keys) == len(set(keys))


@pytest.mark.slow
def test_an_interrupt_leaves_results_and_no_process(tmp_path, expected):
    with start(tmp_path, subprocess.PIPE) as process:
        for _ in range(4):
            process.stdout.readline()
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        _, errors = process.communicate(
            timeout=PATIENCE
        )  # ends when no worker holds the other end of the pipe any more
    assert process.returncode != 0
    assert "ExecutorManagerThread" not in errors
    assert not leftovers(tmp_path)
    before = len(list((tmp_path / "jobs").glob("*.json")))
    assert 3 <= before < 44
    assert run(long_study(), tmp_path).computed == 44 - before
    assert stored(tmp_path) == expected


@pytest.mark.slow
def test_a_job_that_kills_its_process_stops_no_other_and_gets_a_second_chance(tmp_path):
    killer, once = job("die"), job("die", beside=str(tmp_path / "once"))
    outcome = run([killer, once, job("draw", seed=0)], tmp_path, processes=2)
    cause = (
        "the process that computed it was killed twice (SIGKILL(-9)), perhaps for want of memory"
    )
    assert outcome.failures == {killer.key: cause}
    assert outcome.values[once.key] == {"alive": True}
    assert outcome.computed == 2
    assert (
        json.loads((tmp_path / "failed" / f"{killer.key}.json").read_text())["traceback"] == cause
    )


@pytest.mark.slow
def test_several_runs_share_processes_even_after_one_was_killed_and_end_them_at_last(tmp_path):
    def numbers(first: int) -> set[int]:
        outcome = run(
            [job("process", number=first + i) for i in range(4)], tmp_path, workers=workers
        )
        return {values["process"] for values in outcome.values.values()}

    with Workers(2) as workers:
        first = numbers(0)
        assert numbers(4) <= first
        once = job("die", beside=str(tmp_path / "once"))
        assert run([once], tmp_path, workers=workers).values[once.key] == {"alive": True}
        others = numbers(8)
        assert not others & first
    assert os.getpid() not in first | others
    for number in first | others:
        with pytest.raises(ProcessLookupError):
            os.kill(number, 0)


# --- a cluster ------------------------------------------------------------------------------------


@pytest.fixture
def cluster():
    """A Dask scheduler's address and two workers."""
    pytest.importorskip("distributed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    quiet = {"env": ENVIRONMENT, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    module = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    options = ["--no-dashboard", "--host", address]
    processes = [subprocess.Popen([*module, *options], **quiet)]
    module = [sys.executable, "-m", "distributed.cli.dask_worker", address]
    options = ["--nthreads", "1", "--no-nanny", "--no-dashboard"]
    processes += [subprocess.Popen([*module, *options], **quiet) for _ in range(2)]
    yield address, processes[1:]
    for process in reversed(processes):
        process.kill()
        process.wait(PATIENCE)


@pytest.mark.slow
def test_two_workers_of_a_cluster_give_the_same_files_though_one_is_killed(
    tmp_path, expected, cluster
):
    address, (victim, _) = cluster

    def kill(status: Status) -> None:
        if status.done == 3:
            victim.kill()

    outcome = run(long_study(), tmp_path, scheduler=address, progress=kill)
    assert victim.wait(PATIENCE) == -signal.SIGKILL
    assert len(outcome.values) == 44
    assert (
        40 <= outcome.computed <= 44
    )  # the few that the victim had stored, and not reported, are not computed again
    assert stored(tmp_path) == expected
    keys = [line["key"] for line in journal(tmp_path)]
    assert len(keys) == len(set(keys))
    outcome = run([job("draw", seed=99), job("fail", text="far away")], tmp_path, scheduler=address)
    assert outcome.computed == 1
    assert [text.splitlines()[-1] for text in outcome.failures.values()] == ["ValueError: far away"]
    assert os.getpid() not in {line["process"] for line in journal(tmp_path)}


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_one_sentence(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(pools, "_PATIENCE", 1)
    with pytest.raises(ConnectionError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        run(study(), tmp_path, scheduler="tcp://127.0.0.1:9")


def test_what_killed_processes_had_begun_to_write_is_gone_after_the_next_run(tmp_path):
    one, other = (Job("job_functions:write", {"seed": seed}, artifact=".bin") for seed in (1, 2))
    (tmp_path / "jobs").mkdir()
    for key in (one.key, other.key, "0" * 32):
        for name in (
            f".{key}-1.json",
            f".{key}-1.bin",
            f"..{key}-1-1.bin",
        ):  # the last is a temporary's temporary
            (tmp_path / "jobs" / name).write_bytes(b"the beg")
    run([one], tmp_path)
    assert not leftovers(tmp_path)
    assert load(one, tmp_path) is not None


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:A worker stopped")  # as an error it would end loky's own thread
def test_a_worker_that_keeps_what_it_compiled_is_not_replaced():
    pytest.importorskip("psutil")  # without it loky does not look
    grown = import_module("job_functions").grown
    with pools._pool(1) as (executor, _):
        found = [executor.submit(grown, megabytes) for megabytes in (0, 400, 0, 0)]
        assert len({each.result() for each in found}) == 1
