"""Flights of studies: a pure function of its arguments, called by jobs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.metrics import SCORE, consistency, scores
from agents.rollouts import rollout
from agents.seeds import evaluation_seeds
from agents.studies.worlds import environment_options, import_own, registered_id, system_of
from agents.tuning.tuned import load_tuned

NEEDED = "checkpoint"
"""Stands for an agent that another job makes."""


def fly(
    environment: str,
    options: dict[str, Any],
    agent: str,
    first_seed: int,
    episodes: int,
    own: dict[str, str],
    metrics: bool = True,
    needs: Sequence[Path] = (),
) -> dict[str, Any]:
    """Fly the evaluation seeds and score them on the truth.

    Args:
        environment: As in the study.
        options: Of the environment.
        agent: As `agents.load_agent` takes it, or `NEEDED`: what is needed.
        first_seed: See `agents.seeds.evaluation_seeds`.
        episodes: Number of seeds.
        own: Source digests of the user's own modules, by name: part of the job, and imported for
            what they register.
        metrics: Compute all metrics; else the score alone, for which no history is recorded.
        needs: The checkpoint or the file of tuned parameters, if there is one.

    Returns:
        ``episodes``: columns of a table with a row for each seed: ``end``; ``completed``, where the
        episode ended as the task asks; every metric by key, see `agents.metrics.scores`;
        ``nees_in_band``: share of times at which the mean NEES over the episodes lies in its 95 %
        chi-square band, NaN without a covariance.
    """
    import_own(own)
    acting = str(needs[0]) if agent == NEEDED else agent
    if needs and needs[0].suffix == ".toml":
        tuned = load_tuned(acting)
        options = options | {"estimator_options": tuned.arm.estimator_options(tuned.values)}
    flown = rollout(
        acting,
        registered_id(environment),
        evaluation_seeds(episodes, first_seed),
        environment_options(environment, options),
        record=metrics,
    )
    end = np.where(flown.terminated & (flown.end == ""), "terminated", flown.end)
    completed = end == system_of(environment).task.success
    found: dict[str, Any] = {"end": end, "completed": completed, SCORE.key: flown.score}
    if metrics:
        found |= scores(flown) | {"nees_in_band": np.array(consistency(flown), float)}
    return found
