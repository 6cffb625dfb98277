"""Trainings of studies: a pure function of its arguments, called by jobs."""

from pathlib import Path
from typing import Any

from agents.policies.checkpoint import description
from agents.studies.worlds import environment_id, environment_options
from agents.training.algorithms import train

POINTS = 200
"""Points of a learning curve at most."""


def train_agent(
    environment: str,
    options: dict[str, Any],
    own: dict[str, str],
    memory: str,
    steps: int,
    seed: int,
    hyperparameters: dict[str, Any],
    artifact: Path,
    **described: Any,
) -> dict[str, Any]:
    """Train by `agents.training.algorithms.train`; the checkpoint is the artifact.

    Source digests of what is the user's ``own``, and the rest of what
    `agents.training.algorithms.describe` has ``described``, are here to be part of the job.

    Returns:
        ``steps`` of the training, and its learning ``curve``: pairs of steps and of the mean return
        of the last training episodes.
    """
    chosen, curve = environment_options(environment, options), []

    def note(done: int, total: int, mean_return: float) -> None:
        if mean_return == mean_return:
            curve.append((done, mean_return))

    settings = memory, hyperparameters
    train(environment_id(environment), artifact, chosen, seed, steps, note, *settings)
    every = -(-len(curve) // POINTS)
    return {"steps": description(artifact)["trained_steps"], "curve": curve[:: every or 1]}
