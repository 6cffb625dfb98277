"""The benchmark: what is compared computes the same, in turns, and goes onto its page."""

import re
from pathlib import Path

import numpy as np
import pytest

from estimators import names
from studies import speed
from studies.speed import Flight, filterpys, measure, numpy_kalman, ours, shown
from studies.tables import around
from vessel_gym.core import Core


@pytest.mark.parametrize("name", ["kf", "ekf", "ukf"])
def test_the_filters_of_filterpy_compute_the_same(name: str):
    one, rival = ours(name, 1), filterpys(name)
    for y in np.random.default_rng(1).normal(size=(30, 1, speed.MEASUREMENTS)):
        np.testing.assert_allclose(one(y), rival(y), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rows", [1, 130])
def test_a_kalman_filter_in_bare_numpy_computes_the_same(rows: int):
    one, other = ours("kf", rows), numpy_kalman(rows)
    for y in np.random.default_rng(1).normal(size=(30, rows, speed.MEASUREMENTS)):
        np.testing.assert_allclose(one(y), other(y), rtol=1e-9, atol=1e-9)


def test_blocks_take_turns_and_every_other_round_goes_backwards():
    order: list[str] = []
    blocks = [lambda name=name: order.append(name) or 1.0 for name in "abc"]
    times = measure(blocks, rounds=3)
    assert "".join(order) == "abccbaabccba"
    assert times.shape == (3, 3)  # the first round warms up
    assert shown(np.array([1.0, 20.0, 3.0])) == "3 [2, 11.5]"


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "rows"), [("ThesisCorvette-v0", 0), ("PunaUAV-v0", 3)])
def test_a_block_has_the_steps_that_are_counted_and_no_end(env_id: str, rows: int):
    flight = Flight(env_id, rows, estimator="ekf")
    assert flight() > 0.0
    core = flight.env.unwrapped.core
    assert set(core.steps) == {speed.STEPS}
    assert not core.episodes.any()
    assert flight.units == max(rows, 1) * speed.STEPS


def test_the_parts_of_a_step_are_all_of_it_and_the_clock_leaves_nothing_behind():
    before = Core.observe, Core._moved, Core._scored
    flight = Flight("ThesisCorvette-v0", 2)
    for _ in range(2):
        assert flight.parted() > 0.0
    for shares in flight.shares:
        assert sum(shares.values()) == pytest.approx(1.0)
        assert min(shares.values()) > 0.0
    assert (Core.observe, Core._moved, Core._scored) == before


@pytest.mark.slow
def test_the_report_names_all_that_is_timed_and_goes_onto_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(speed, "BATCH", 2)
    monkeypatch.setattr(speed, "STEPS", 4)
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- measured -->\nold\n<!-- end -->\nafter\n")
    speed.main(("ItsunusaAUV-v0",), rows=(1, 2), rounds=1, page=page)
    printed = capsys.readouterr().out
    text = f"before\n<!-- measured -->\n\n{printed}\n<!-- end -->\nafter\n"
    assert page.read_text() == text
    for label in ("ItsunusaAUV-v0", "batch of 2", "kf of filterpy", "kf in bare NumPy",
                  *names(), *Flight.PARTS):  # fmt: skip
        assert label in printed
    assert re.search(r"\| kf \| \S+ \[\S+, \S+\] \|", printed)


def test_its_page_can_be_written_again():
    page = Path(speed.__file__).parents[1] / "docs" / "speed.md"
    assert all(around(page, speed.MARK))
