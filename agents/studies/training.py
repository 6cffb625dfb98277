"""Trainings of studies: a pure function of its arguments, called by jobs."""

from pathlib import Path
from typing import Any

from agents.policies.checkpoint import description
from agents.studies.worlds import environment_id, environment_options
from agents.training.algorithms import train


def train_agent(
    environment: str,
    options: dict[str, Any],
    memory: str,
    steps: int | None,
    seed: int,
    hyperparameters: dict[str, Any],
    versions: dict[str, str],
    own: dict[str, str],
    artifact: Path,
) -> dict[str, Any]:
    """Train by `agents.training.algorithms.train`; the checkpoint is the artifact.

    The ``versions`` of libraries that learn and the source digests of what is the user's ``own``
    are here to be part of the job.
    """
    chosen = environment_options(environment, options)
    settings = memory, hyperparameters
    train(environment_id(environment), artifact, chosen, seed, steps, None, *settings)
    return {"steps": description(artifact)["trained_steps"]}
