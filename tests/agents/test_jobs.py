"""Jobs: what is finished is kept whatever happens, and what is missing or damaged is computed."""

import errno
import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from job_functions import job, long_study, study

from agents import jobs
from agents.jobs import Job, compute, run

HERE = Path(__file__).parent
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parents[1])])}
PATIENCE = 60  # seconds that a process may take for what takes it one


def names(folder: Path) -> set[str]:
    return {path.name for path in (folder / "jobs").glob("[!.]*")}


def results(found: set[str]) -> set[str]:
    """Those that are complete, whatever lies beside them."""
    return {name for name in found if name.endswith(".json")}


def at_once(wanted: list[Job], folder: Path) -> jobs.Outcome:
    """A run in this process whose jobs wait for nothing."""
    with patch("job_functions.sleep"):
        return run(wanted, folder)


def computed(wanted: list[Job], folder: Path) -> set[str]:
    """Names of the files that a run wrote."""
    before = {name: (folder / "jobs" / name).stat().st_ino for name in names(folder)}
    assert not at_once(wanted, folder).failures
    after = {name: (folder / "jobs" / name).stat().st_ino for name in names(folder)}
    return {name for name in after if after[name] != before.get(name)}


@pytest.fixture(scope="module")
def expected(tmp_path_factory) -> dict:
    """Values of a long study that nobody interrupted."""
    return at_once(long_study(), tmp_path_factory.mktemp("uninterrupted")).values


def test_key_depends_on_function_arguments_needs_and_versions(monkeypatch):
    first = job("draw", seed=0)
    assert first.key == Job(first.function, {"seed": 0}, "by another name").key
    others = [
        job("draw", seed=1),
        job("draw", seed=0.0),
        job("echo", seed=0),
        job("draw", (first,), seed=0),
        job("draw", artifact=".zip", seed=0),
    ]
    monkeypatch.setattr(jobs, "versions", lambda: {"vessel-gym": "0.0.0"})
    others.append(job("draw", seed=0))
    assert len({first.key, *(other.key for other in others)}) == 1 + len(others)


def test_values_of_a_job_are_read_as_they_were_computed(tmp_path):
    tuples, drawn = job("echo", a=(1, 2), b={1: 2}), job("draw", seed=3)
    for _ in range(2):  # computed, then read
        values = run([tuples, drawn], tmp_path).values
        assert values[tuples.key] == {
            "arguments": {"a": [1, 2], "b": {"1": 2}},
            "types": ["list", "dict"],
        }
        normal = np.random.default_rng(3).normal(size=50).tolist()
        np.testing.assert_equal(
            values[drawn.key], {"values": normal, "seed": 3, "nothing": float("nan")}
        )


def test_only_missing_jobs_are_computed(tmp_path):
    assert computed(study(), tmp_path) == names(tmp_path)
    new = job("draw", seed=8)
    assert computed([*study(), new], tmp_path) == {f"{new.key}.json"}
    *_, needing = study()
    assert run([needing], tmp_path).values[needing.key]["bytes"] == [
        np.random.default_rng(seed).bytes(5000).hex() for seed in range(3)
    ]


def test_what_others_need_is_computed_first(tmp_path):
    *_, last = wanted = study()
    assert {*[*at_once(wanted, tmp_path).values][:3]} == {need.key for need in last.needs}


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
def test_a_job_that_fails_stops_no_other_and_is_tried_again(tmp_path, processes):
    failing, leaving, lost = job("fail", text="no luck"), job("leave"), job("write", artifact=".no")
    unknown, needing, alone = job("nothing"), job("read", needs=(lost,)), job("process")
    wanted = [failing, leaving, unknown, needing, alone, *study()]
    for _ in range(2):
        seen = list[tuple[int, ...]]()

        def report(*numbers: int, seen=seen) -> None:
            seen.append(numbers)

        outcome = run(wanted, tmp_path, processes, progress=report)
        assert "in fail" in outcome.failures[failing.key]
        assert outcome.failures[failing.key].endswith("ValueError: no luck\n")
        assert outcome.failures[leaving.key].endswith("SystemExit: left\n")
        assert outcome.failures[needing.key] == "read: not tried, it needs write"
        assert len(outcome.failures) == 5
        assert seen[-1] == (13, 5, 18)
        assert {each.key for each in (alone, *study())} <= outcome.values.keys()
    assert processes == 1 or set(outcome.values[alone.key].values()) == {"1"}


@pytest.mark.parametrize("damage", [b"", b"{", b"null", b"other", b"\xff", b"half", b"one"])
@pytest.mark.parametrize("suffix", [".json", ".bin"])
def test_a_damaged_result_is_computed_again(tmp_path, damage, suffix):
    written, other = (job("write", artifact=".bin", seed=seed) for seed in (1, 2))
    values = run([written, other], tmp_path).values
    path, foreign = (tmp_path / "jobs" / f"{each.key}{suffix}" for each in (written, other))
    whole = path.read_bytes()
    changed = whole.replace(b'"seed": 1}', b'"seed": 7}', 2) if suffix == ".json" else b"1" + whole
    damages = {b"other": foreign.read_bytes(), b"half": whole[:400], b"one": changed}
    path.write_bytes(damages.get(damage, damage))
    assert computed([written, other], tmp_path) == {f"{written.key}.json", f"{written.key}.bin"}
    assert run([written, other], tmp_path).values == values


def test_full_disk_stops_run_and_keeps_what_was_finished(tmp_path, monkeypatch):
    writes, write = iter(range(100)), Path.write_text

    def full(*arguments, **named):
        if next(writes) >= 4:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(*arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        with pytest.raises(OSError, match="No space left on device; what was finished is kept"):
            run(study(), tmp_path)
    assert len(results(names(tmp_path))) == 4
    assert len(results(computed(study(), tmp_path))) == 8


def test_worker_with_other_code_or_folder_computes_nothing(tmp_path, monkeypatch):
    drawn = job("draw", seed=0)
    assert drawn.key
    with pytest.raises(OSError, match=f"does not see {tmp_path}/no: all workers need that folder"):
        compute(drawn, tmp_path / "no")
    monkeypatch.setattr(jobs, "versions", lambda: {"vessel-gym": "0.0.0"})
    with pytest.raises(RuntimeError, match="has other code of this package"):
        compute(drawn, tmp_path)


# --- processes that are killed --------------------------------------------------------------------

_RUN = """
import signal
import sys
from pathlib import Path
from agents.jobs import run
from job_functions import long_study
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a shell's background
show = lambda done, failed, total: print(done, flush=True)
run(long_study(), Path(sys.argv[1]), processes=2, progress=show)
"""


def start(folder: Path, done: int) -> subprocess.Popen[str]:
    """A run of the long study on two processes, in a process group of its own, which got so far."""
    process = subprocess.Popen(
        [sys.executable, "-c", _RUN, str(folder)], start_new_session=True, env=ENVIRONMENT,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while int(process.stdout.readline()) < done:
        pass
    return process


def goes_on(folder: Path, expected: dict) -> None:
    """Run the long study to its end, keeping what a run that broke off has left."""
    before = names(folder)
    assert 3 < len(before) < 47
    assert not before & results(computed(long_study(), folder))
    np.testing.assert_equal(at_once(long_study(), folder).values, expected)


@pytest.mark.slow
@pytest.mark.parametrize("times", [2, pytest.param(8, marks=pytest.mark.nightly)])
def test_killed_run_ends_as_if_it_had_not_been(tmp_path, expected, times):
    moments = random.Random(times)
    for attempt in range(times):
        with start(tmp_path, 3 + 40 * attempt // times) as process:
            time.sleep(moments.uniform(0.0, 0.1))
            if attempt % 2:
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()  # its workers live on for a moment
    goes_on(tmp_path, expected)


@pytest.mark.slow
def test_an_interrupt_leaves_results_and_no_process(tmp_path, expected):
    with start(tmp_path, 4) as process:
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        process.communicate(timeout=PATIENCE)  # ends when no worker holds the pipe any more
    assert process.returncode != 0
    goes_on(tmp_path, expected)


@pytest.mark.slow
def test_runs_that_share_a_folder_share_the_work(tmp_path, expected, monkeypatch):
    ours, call = [], Job.call
    monkeypatch.setattr(Job, "call", lambda *each: ours.append(each) or call(*each))
    with start(tmp_path, 3) as process:
        np.testing.assert_equal(run(long_study(), tmp_path).values, expected)
        process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert 0 < len(ours) < 35


@pytest.mark.slow
def test_killed_worker_ends_run_and_next_run_goes_on(tmp_path):
    wanted = [*study(), job("die", unless=str(tmp_path / "mended"))]
    with pytest.raises(OSError, match="killed, perhaps for want of memory; what was finished is"):
        run(wanted, tmp_path, processes=2)
    (tmp_path / "mended").touch()
    before = names(tmp_path)
    assert not before & results(computed(wanted, tmp_path))


# --- a cluster ------------------------------------------------------------------------------------


@pytest.fixture
def cluster():
    """A Dask scheduler's address and its two workers."""
    pytest.importorskip("distributed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    quiet = {"env": ENVIRONMENT, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    module = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    processes = [subprocess.Popen([*module, "--no-dashboard", "--host", address], **quiet)]
    module = [sys.executable, "-m", "distributed.cli.dask_worker", address]
    options = ["--nthreads", "1", "--no-nanny", "--no-dashboard"]
    processes += [subprocess.Popen([*module, *options], **quiet) for _ in range(2)]
    yield address, processes[1:]
    for process in reversed(processes):
        process.kill()
        process.wait(PATIENCE)


@pytest.mark.nightly
def test_cluster_gives_same_values_though_worker_is_killed(tmp_path, expected, cluster):
    address, (victim, _) = cluster

    def kill(done: int, failed: int, total: int) -> None:
        if done == 5:
            victim.kill()

    failing = job("fail", text="far away")
    outcome = run([*long_study(), failing], tmp_path, scheduler=address, progress=kill)
    assert victim.wait(PATIENCE) == -signal.SIGKILL
    assert outcome.failures.keys() == {failing.key}
    assert outcome.failures[failing.key].endswith("ValueError: far away\n")
    np.testing.assert_equal(outcome.values, expected)
    assert not computed(long_study(), tmp_path)


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_one_sentence(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(jobs, "_PATIENCE", 0.1)
    with pytest.raises(OSError, match=r"connect to tcp://127\.0\.0\.1:9 after 0\.1 s; what was"):
        run(study(), tmp_path, scheduler="tcp://127.0.0.1:9")
