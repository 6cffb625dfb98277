"""Trainings of a moment, and the models that they save."""

from pathlib import Path
from typing import Any

import pytest
from short_training import REMEMBERING, TINY


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tuned settings with a small network and short rollouts."""
    from agents.training import algorithms

    tuned = {}
    for memory, own in REMEMBERING.items():
        tuned[memory] = algorithms.hyperparameters("SigmaCorvette-v0", memory) | TINY | own
    monkeypatch.setattr(
        algorithms, "hyperparameters", lambda env_id, memory="none", *_: tuned[memory]
    )


@pytest.fixture
def saved(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The models that are written to checkpoints, as stable-baselines3 trained them."""
    from agents.training import algorithms

    models: list[Any] = []

    def write(path: Path, model: Any, described: dict[str, Any]) -> None:
        models.append(model)
        original(path, model, described)

    original = algorithms.write
    monkeypatch.setattr(algorithms, "write", write)
    return models
