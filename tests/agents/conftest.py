"""Trainings of a moment."""

from typing import Any

import pytest
from short_training import REMEMBERING, TINY


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tuned settings with a small network, short rollouts and two evaluations of an episode."""
    from agents.training import algorithms, callbacks

    monkeypatch.setattr(callbacks, "EPISODES", 1)
    monkeypatch.setattr(callbacks, "EVALUATIONS", 2)

    tuned = {}
    for memory, own in REMEMBERING.items():
        tuned[memory] = algorithms.hyperparameters("SigmaCorvette-v0", memory) | TINY | own
    monkeypatch.setattr(
        algorithms, "hyperparameters", lambda env_id, memory="none", *_: tuned[memory]
    )


@pytest.fixture
def models(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The models that are written to policies, as stable-baselines3 trained them."""
    from agents.training import algorithms

    written: list[Any] = []
    original = algorithms.write
    monkeypatch.setattr(
        algorithms,
        "write",
        lambda path, model, *a: written.append(model) or original(path, model, *a),
    )
    return written
