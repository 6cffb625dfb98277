"""Trainings of studies: a pure function of its arguments, called by jobs."""

from pathlib import Path
from typing import Any

from agents.policies.checkpoint import description
from agents.studies.worlds import environment_id, environment_options
from agents.training.algorithms import train
from vessel_gym.extras import require

require("torch", "stable_baselines3", "sb3_contrib")

import stable_baselines3  # noqa: E402, F401
import torch  # noqa: E402, F401  (workers load both before their memory is first measured)


def train_agent(
    environment: str,
    options: dict[str, Any],
    memory: str,
    changed: dict[str, Any],
    steps: int | None,
    seed: int,
    settings: dict[str, Any],
    own: dict[str, str],
    artifact: Path,
) -> dict[str, Any]:
    """Train by `agents.training.algorithms.train`; the checkpoint is the artifact.

    Hyperparameters that are ``changed`` are not the tuned ones. The ``settings`` that `train` looks
    up by itself and the source digests of what is the user's ``own`` are here to be part of the
    job.
    """
    chosen = environment_options(environment, options)
    train(environment_id(environment), artifact, chosen, seed, steps, None, memory, changed)
    return {"steps": description(artifact)["trained_steps"]}
