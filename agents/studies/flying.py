"""What flights compute: a pure function of its arguments, called by cells."""

from pathlib import Path
from typing import Any

import numpy as np

from agents.agent import Agent
from agents.metrics import consistency, nees_of, nis_consistency
from agents.rollouts import Rollout, rollout
from agents.scores import scores
from agents.seeds import evaluation_seeds
from agents.studies.worlds import classical_pilot, environment_id, environment_options, import_own

LOST = 1e-6
"""A truth is outside of a belief where so little probability is left beyond it."""


def fly(
    environment: str,
    options: dict[str, Any],
    agent: str,
    first_seed: int,
    episodes: int,
    own: dict[str, str],
    needs: list[Path] | None = None,
) -> dict[str, Any]:
    """Fly the evaluation seeds and score them on the truth.

    Args:
        environment: As in the study.
        options: Of the environment.
        agent: As `agents.pilots.make_pilot` takes it, or ``"checkpoint"``: the one that is needed.
        first_seed: See `agents.seeds.evaluation_seeds`.
        episodes: Number of seeds.
        own: Source digests of the user's own modules, by name: part of the cell, and imported for what they register.
        needs: The checkpoint, if there is one.

    Returns:
        ``figures``: every metric ``(N,)`` by key, see `agents.scores`; ``nees_in_band`` and ``nis_in_band``: share of
        times at which their mean over the episodes lies in its 95 % chi-square band, None without a covariance;
        ``diverged (N,)``: whether the truth was outside of what the filter held for possible for half of the episode;
        ``steps``: flown in all.
    """
    import_own(own)
    flown = rollout(
        _pilot(agent, environment, needs),
        environment_id(environment),
        evaluation_seeds(episodes, first_seed),
        environment_options(environment, options),
    )
    return {
        "figures": scores(flown),
        "nees_in_band": consistency(flown),
        "nis_in_band": nis_consistency(flown),
        "diverged": _diverged(flown),
        "ends": list(flown.end),
        "steps": int(flown.length.sum()),
    }


def _pilot(agent: str, environment: str, needs: list[Path] | None) -> Agent | str:
    if agent == "checkpoint":
        assert needs
        return str(needs[0])
    return classical_pilot(agent, environment)


def _diverged(flown: Rollout) -> np.ndarray:
    """Whether a filter lost the truth in each episode ``(N,)``: NEES beyond its 1 - 1e-6 quantile half of the time."""
    from scipy.stats import chi2

    values = nees_of(flown)
    if values is None:
        return np.zeros(len(flown.seeds), bool)
    limit = chi2.isf(LOST, flown.history["estimate"].shape[-1])
    outside = (~(values <= limit) & flown.alive).sum(0)
    return outside > 0.5 * flown.alive.sum(0)
