"""Tunings of studies: a pure function of its arguments, called by jobs."""

from pathlib import Path
from typing import Any

from agents.studies.worlds import import_own
from agents.tuning.arm import Arm
from agents.tuning.tune import tune


def tune_arm(
    environment: str,
    agent: str,
    options: dict[str, Any],
    conditions: list[dict[str, Any]],
    by: str,
    evaluations: int,
    episodes: int,
    seed: int,
    own: dict[str, str],
    artifact: Path,
) -> dict[str, Any]:
    """Tune an estimator and a controller, and write the file of their parameters.

    Args:
        environment: As in the study.
        agent: A controller of its task.
        options: Options of the environment that all conditions share, among them the estimator.
        conditions: Options of each condition; the mean score over all of them is tuned.
        by: What is maximised.
        evaluations: See `agents.tuning.tune.tune`.
        episodes: See `agents.tuning.tune.tune`.
        seed: Number of the tuning.
        own: Source digests of the user's own modules, by name: part of the job, and imported for
            what they register.
        artifact: File of the parameters.

    Returns:
        What the tuning found, and the tuned values by name as ``values``.
    """
    import_own(own)
    arm = Arm(environment, agent, options, tuple(conditions), by=by)
    tuned = tune(arm, evaluations, episodes, seed)
    tuned.write(artifact)
    return tuned.found | {"values": tuned.values}
