"""Trainings of a moment, and the models that they save."""

from pathlib import Path
from typing import Any

import pytest
from short_training import REMEMBERING, TINY


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tuned settings with a small network and short rollouts."""
    import agents.training.ppo as ppo

    tuned = {
        memory: ppo.hyperparameters("SigmaCorvette-v0", memory) | TINY | own for memory, own in REMEMBERING.items()
    }
    monkeypatch.setattr(ppo, "hyperparameters", lambda env_id, memory="none", *_: tuned[memory])


@pytest.fixture
def saved(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The models that are written to checkpoints, as stable-baselines3 trained them."""
    import agents.training.ppo as ppo

    models: list[Any] = []

    def write(path: Path, model: Any, described: dict[str, Any]) -> None:
        models.append(model)
        original(path, model, described)

    original = ppo.write
    monkeypatch.setattr(ppo, "write", write)
    return models
