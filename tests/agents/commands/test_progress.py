"""Progress where the output is no terminal: a file or a pipe gets a line now and then, never a bar."""

import pytest

from agents.commands import console


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still until it is set."""
    now = [100.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    return now


def printed(capsys) -> list[str]:
    return capsys.readouterr().err.splitlines()


def test_many_short_jobs_say_how_far_they_are_at_each_tenth(clock, capsys):
    with console.job_progress("quick", 2) as progress:
        for done in range(1001):
            progress(done, 0, 1000)
    assert [line.partition(",")[0] for line in printed(capsys)] == [
        f"quick: {done}/1000" for done in range(0, 1001, 100)
    ]


def test_long_jobs_report_every_ten_seconds_with_failures(clock, capsys):
    with console.job_progress("full", 2) as progress:
        for done in range(60):
            progress(done, 3, 10_000)
            clock[0] += 2.5
    lines = [line.partition(" left")[0].rpartition(", 6:") for line in printed(capsys)]
    assert [first or last for first, _, last in lines] == [
        f"full: {done + 3}/10000, 3 failed" for done in range(0, 60, 4)
    ]
    assert [bool(first) for first, *_ in lines] == [2.5 * done > 65.0 for done in range(0, 60, 4)]


def test_time_left_follows_from_jobs_after_compilation(clock, capsys):
    with console.job_progress("quick", 2) as progress:
        for done in range(21):
            progress(done, 0, 20)
            clock[0] += 60.0 if done < 2 else 1.0
    first, *lines = printed(capsys)
    assert first == "quick: 0/20, the first jobs take longer, because they compile"
    assert lines[:2] == ["quick: 1/20", "quick: 2/20"]
    assert lines[2] == "quick: 4/20, 0:00:16 left"


def test_run_says_what_it_resumes_and_what_interruption_left(clock, capsys):
    def interrupted() -> None:
        with console.job_progress("quick", 2) as progress:
            progress(120, 0, 300)
            progress(121, 0, 300)
            raise KeyboardInterrupt

    with pytest.raises(SystemExit) as stop:
        console.command(interrupted, [])
    assert stop.value.code == 130
    lines = printed(capsys)
    assert lines[0] == "resuming: 120 of 300 results found"
    kept = "121 of 300 results are kept, and the same command goes on from there"
    assert lines[-1] == f"interrupted: {kept}"
