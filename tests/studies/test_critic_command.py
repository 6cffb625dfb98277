"""What measures the worth of the truth to the critic, on trainings of a moment."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from agents.commands.console import command
from agents.training.algorithms import describe, learner
from studies.critic import __main__ as critic
from studies.critic import benchmark, page
from studies.critic.benchmark import explained, flown, leaking, learned
from studies.critic.page import WORLDS

STEPS = 16_384
SHORT: Any = {"steps": STEPS, "options": {"max_episode_steps": 100}}


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "EPISODES", 6)
    monkeypatch.setattr(benchmark, "POINTS", 2)
    for module in (benchmark, page):
        monkeypatch.setattr(module, "END", 1)
    monkeypatch.setattr(page, "HALF", 0)


@pytest.mark.nightly
def test_an_actor_flies_the_same_with_the_critic_s_input_kept_from_it_and_a_leaking_one_does_not():
    world = replace(WORLDS["estimates"], **SHORT)
    described = describe(world.env_id, world.options, 0, STEPS, world.memory, "truth")
    with learner(described) as model:
        model.learn(STEPS)
        told, kept = flown(model, described), flown(model, described, zeroed=True)
    np.testing.assert_array_equal(told, kept)
    measured = learned(world, "truth", 0)  # which flies checkpoints; and to measure changes nothing
    assert measured["steps"] == [8192, STEPS]
    np.testing.assert_allclose(measured["score"][-1], told, rtol=0, atol=1e-6)
    with leaking(), learner(described) as model:
        model.learn(STEPS)
        assert (np.array(flown(model, described)) != flown(model, described, zeroed=True)).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["estimates", "lstm"])
def test_a_critic_that_says_the_same_of_everything_explains_nothing_and_one_that_learned_something(name: str):
    world = replace(WORLDS[name], **SHORT)
    assert 0.01 < learned(world, "truth", 0)["explained"][-1] < 1.0
    described = describe(world.env_id, world.options, 0, STEPS, world.memory, "truth")
    with learner(described) as model:
        torch.nn.init.zeros_(model.policy.value_net.weight)
        torch.nn.init.constant_(model.policy.value_net.bias, 3.0)
        assert explained(model, described) == pytest.approx(0.0, abs=1e-9)


def test_too_few_runs_are_refused_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        command(critic.main, ["--runs", "1", "--out", str(tmp_path)])
    told = capsys.readouterr().err
    assert "--runs must be at least 2" in told
    assert len(told.splitlines()) == 1
    assert not list(tmp_path.iterdir())
