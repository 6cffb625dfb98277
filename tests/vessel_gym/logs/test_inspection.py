"""Faults that are put into simulated logs are found, and clean logs have none."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.vessel_gym.identification.voyages import STEP, coefficients, trial
from vessel_gym.logs import Channel, Log
from vessel_gym.logs.inspection import inspect, noise, rate
from vessel_gym.logs.lag import lag
from vessel_gym.logs.scale import scale

LOGS = 20


def clean(seed: int) -> Log:
    """A log of three minutes with white noise, the velocities over ground in it."""
    rng = np.random.default_rng([3, seed])
    voyage = trial(rng, coefficients(rng), 180.0, noise=0.0)
    count = len(voyage)
    t = STEP * np.arange(count)
    sd = {"x": 0.01, "y": 0.01, "heading": 2e-3, "surge": 3e-3, "sway": 3e-3, "yaw rate": 3e-4}
    motion = {
        name: voyage.states[:count, i] + size * rng.normal(size=count) for i, (name, size) in enumerate(sd.items())
    }
    values = motion | {"rudder": voyage.control[:, 0], "revolutions": voyage.control[:, 1]}
    lines = np.arange(2, count + 2)
    return Log("log.csv", {name: Channel(name, t, column, lines) for name, column in values.items()})


def altered(log: Log, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Log:
    """The log with other values of a channel."""
    channel = log[name]
    other = Channel(name, channel.times, change(channel.values.copy()), channel.lines)
    return Log(log.name, log.channels | {name: other}, log.remarks)


def at(values: np.ndarray, first: int, last: int, new: float | np.ndarray) -> np.ndarray:
    """Values with a span of new ones."""
    values[first:last] = new
    return values


FAULTS: dict[str, tuple[str, Callable[[Log], Log], int]] = {
    "missing": ("heading", lambda log: altered(log, "heading", lambda v: at(v, 400, 420, np.nan)), 402),
    "held": ("x", lambda log: altered(log, "x", lambda v: at(v, 301, 315, v[300])), 303),
    "jump": ("y", lambda log: altered(log, "y", lambda v: at(v, 500, 900, v[500:900] + 0.5)), 502),
    "unit": ("rudder", lambda log: altered(log, "rudder", np.rad2deg), 0),
    "quantised": ("yaw rate", lambda log: altered(log, "yaw rate", lambda v: 0.005 * np.round(v / 0.005)), 2),
}


@pytest.mark.parametrize("kind", FAULTS)
def test_faults_are_found_at_their_lines(kind: str) -> None:
    """In at least 19 of 20 logs."""
    channel, put, line = FAULTS[kind]
    found = [[each for each in inspect(put(clean(seed))) if each.kind == kind] for seed in range(LOGS)]
    hits = [any(each.channel == channel and (not line or abs(each.line - line) <= 1) for each in one) for one in found]
    assert sum(hits) >= LOGS - 1


def test_clean_logs_have_no_faults() -> None:
    """False alarms: a lag in at most 5 of 60 channels, since its interval misses 0 on this side with probability .025.

    A scale error in at most 3 of 20 logs: its interval excludes 0 with probability .05, and more than 3 do so with
    probability .016. A jump in at most 2 of 120 channels of motion: a propeller that reverses bends the yaw rate at
    once.
    """
    found = [each for seed in range(LOGS) for each in inspect(clean(seed))]
    assert [each for each in found if each.kind not in ("lag", "jump", "scale")] == []
    assert sum(each.kind == "scale" for each in found) <= 3
    assert sum(each.kind == "lag" for each in found) <= 5
    assert sum(each.kind == "jump" for each in found) <= 2


def test_times_that_run_back_stand_still_or_leave_a_gap_are_found() -> None:
    log = clean(0)
    t = log["x"].times.copy()
    t[100], t[200], t[300:] = t[95], t[199], t[300:] + 4.0
    log = Log("log.csv", {name: Channel(name, t, each.values, each.lines) for name, each in log.channels.items()})
    sentences = {each.line: each.sentence for each in inspect(log) if each.kind in ("time", "gap")}
    assert "runs back" in sentences[102]
    assert "stands still" in sentences[202]
    assert sentences[302].startswith("4.2 s without a row, usually 0.2 s")


def test_noise_and_rate_are_recovered() -> None:
    log = clean(1)
    np.testing.assert_allclose(noise(log["heading"]), 2e-3, rtol=0.1)
    np.testing.assert_allclose(noise(log["yaw rate"]), 3e-4, rtol=0.1)
    np.testing.assert_allclose(rate(log["x"]), 5.0, rtol=1e-6)


def test_the_interval_of_a_lag_holds_it() -> None:
    """In all but 4 of some 20 logs; more misses have a probability of .003 at 95 %. Too still a log has no lag."""
    inside = []
    for seed in range(LOGS):
        log = clean(seed)
        times = log["surge"].times
        late = altered(log, "surge", lambda v, times=times: np.interp(times - 0.6, times, v))
        if found := lag(late, "surge"):
            inside.append(abs(found[0] - 0.6) <= found[1])
    assert len(inside) >= 18
    assert inside.count(False) <= 4


def test_the_interval_of_a_gyro_s_scale_holds_it_whatever_its_offset() -> None:
    """In at least 16 of 20 logs; fewer than 16 has a probability of .003 at 95 %."""
    inside, said = [], []
    for seed in range(LOGS):
        log = altered(clean(seed), "yaw rate", lambda v: v / 1.05 + 2e-3)
        found = scale(log)
        assert found is not None
        inside.append(abs(found[0] - 0.05) <= found[1])
        said += [each.sentence for each in inspect(log) if each.kind == "scale" and each.channel == "yaw rate"]
    assert sum(inside) >= 16
    assert len(said) >= LOGS - 1
    assert all("faster" in each for each in said)


def test_a_gap_does_not_change_the_scale() -> None:
    log = clean(3)
    kept = np.delete(np.arange(len(log["heading"].times)), np.s_[300:420])
    cut = {
        name: Channel(name, each.times[kept], each.values[kept], each.lines[kept])
        for name, each in log.channels.items()
    }
    found, whole = scale(Log("log.csv", cut)), scale(log)
    assert found is not None
    assert whole is not None
    assert abs(found[0] - whole[0]) < whole[1]


def test_a_still_or_short_log_has_no_scale() -> None:
    log = clean(0)
    assert scale(altered(log, "yaw rate", np.zeros_like)) is None
    short = {
        name: Channel(name, each.times[:120], each.values[:120], each.lines[:120])
        for name, each in log.channels.items()
    }
    assert scale(Log("log.csv", short)) is None


def test_a_jump_has_the_line_it_leads_to_and_a_gap_is_none() -> None:
    log = clean(2)
    for change in (lambda v: at(v, 400, 401, v[400] + 3.0), lambda v: at(v, 400, 900, v[400:900] + 3.0)):
        found = [each for each in inspect(altered(log, "x", change)) if each.kind == "jump" and each.channel == "x"]
        assert found[0].line == 402
        assert abs(float(found[0].sentence.split()[2]) - 3.0) < 0.1
    kept = np.delete(np.arange(len(log["x"].times)), np.s_[400:500])
    cut = {
        name: Channel(name, each.times[kept], each.values[kept], each.lines[kept])
        for name, each in log.channels.items()
    }
    assert all(abs(each.line - 502) > 5 for each in inspect(Log("log.csv", cut)) if each.kind == "jump")


def test_a_long_hold_is_found_behind_many_short_ones() -> None:
    """A receiver at half the rate repeats each value once."""
    log = altered(clean(0), "x", lambda v: np.repeat(v[::2], 2)[: len(v)])
    log = altered(log, "x", lambda v: at(v, 800, 813, v[800]))
    (found,) = [each for each in inspect(log) if each.kind == "held"]
    assert (found.channel, found.sentence) == ("x", "held for 13 rows")
    assert abs(found.line - 802) <= 2


def test_the_command_names_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from agents.commands import console
    from agents.commands import inspect as command

    rows = "\n".join(f"{0.1 * k},{k}" for k in range(30))
    (tmp_path / "log.csv").write_text(f"t,x\n{rows}\n3.0,oops\n", encoding="utf-8")
    console.command(command.main, [str(tmp_path / "log.csv")])
    assert "line 32: 'x' is 'oops', which is no number" in capsys.readouterr().out
