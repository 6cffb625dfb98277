"""The benchmark: what is compared computes the same, in turns, and goes onto its page."""

import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from studies import speed
from studies.baselines import MEASUREMENTS, filterpys, numpy_kalman, ours
from studies.markdown import ROOT, around
from studies.speed import environment_block, measure


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("name", ["kf", "ekf", "ukf", "bare"])
def test_compared_filters_compute_the_same(name: str, plain: bool):
    rows = 130 if name == "bare" else 1
    one = ours("kf" if name == "bare" else name, rows, plain)
    rival = numpy_kalman(rows) if name == "bare" else filterpys(name)
    for y in np.random.default_rng(1).normal(size=(30, rows, MEASUREMENTS)):
        np.testing.assert_allclose(one(y), rival(y), rtol=1e-9, atol=1e-9)


def test_blocks_take_turns_and_every_other_round_goes_backwards():
    order: list[str] = []
    found = measure({name: lambda name=name: order.append(name) or 1.0 for name in "abc"}, rounds=3)
    assert "".join(order) == "abccbaabccba"
    assert found["a"].shape == (3,)  # the first round warms up
    assert speed.quartiles(np.array([1.0, 20.0, 3.0])) == "3 [2, 11.5]"


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "rows"), [("SigmaCorvette-v0", 0), ("PunaUAV-v0", 3)])
def test_a_block_has_its_steps_and_no_end(env_id: str, rows: int, monkeypatch: pytest.MonkeyPatch):
    made: list[Any] = []
    make = "make_vec" if rows else "make"
    usual = getattr(gym, make)
    monkeypatch.setattr(gym, make, lambda *a, **k: made.append(usual(*a, **k)) or made[-1])
    block = environment_block(env_id, rows)
    assert min(block(), block()) > 0.0
    now = made[0].unwrapped.core.now
    assert set(now.steps) == {speed.STEPS}
    assert not now.episode.any()


@pytest.mark.nightly
def test_the_report_names_all_that_is_timed_and_goes_onto_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    assert all(around(ROOT / "docs/speed.md", speed.MARK))
    monkeypatch.setattr(speed, "BATCH", 2)
    monkeypatch.setattr(speed, "STEPS", 4)
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- measured -->\nold\n<!-- end -->\nafter\n")
    speed.main(("ItsunusaAUV-v0",), rows=(1, 2), rounds=1, page=page)
    printed = capsys.readouterr().out
    text = f"before\n<!-- measured -->\n\n{printed}\n<!-- end -->\nafter\n"
    assert page.read_text() == text
    for label in ("ItsunusaAUV-v0", "batch of 2", "kf of filterpy", "kf in bare NumPy",
                  *speed.labels()):  # fmt: skip
        assert label in printed
    assert re.search(r"\| kf \| \S+ \[\S+, \S+\] \|", printed)
