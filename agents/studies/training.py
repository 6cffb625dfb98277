"""Trainings of studies: a pure function of its arguments, called by jobs."""

from pathlib import Path
from typing import Any

from agents.policies.checkpoint import description
from agents.studies.worlds import environment_id, environment_options
from agents.training.algorithms import train


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
    """
    chosen = environment_options(environment, options)
    settings = memory, hyperparameters
    train(environment_id(environment), artifact, chosen, seed, steps, None, *settings)
    return {"steps": description(artifact)["trained_steps"]}
