"""Flights of studies: a pure function of its arguments, called by jobs."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from agents.metrics import SCORE, consistency, nees_of, nis_consistency, scores
from agents.rollouts import Rollout, batch, rollout
from agents.seeds import evaluation_seeds
from agents.studies.worlds import (
    classical_controller,
    environment_options,
    import_own,
    registered_id,
)

TURNS, STEPS, STEPS_ALONE = 6, 20, 50
"""Turns of a timing, and steps of each in a batch and of a vehicle alone."""
LOST = 1e-6
"""A truth is outside of a belief where so little probability is left beyond it."""


def fly(
    environment: str,
    options: dict[str, Any],
    agent: str,
    first_seed: int,
    episodes: int,
    own: dict[str, str],
    timed_beside: str | None = None,
    metrics: bool = True,
    needs: Sequence[Path] = (),
) -> dict[str, Any]:
    """Fly the evaluation seeds and score them on the truth.

    Args:
        environment: As in the study.
        options: Of the environment.
        agent: As `agents.load_agent` takes it, or ``"checkpoint"``: the one that is needed.
        first_seed: See `agents.seeds.evaluation_seeds`.
        episodes: Number of seeds.
        own: Source digests of the user's own modules, by name: part of the job, and imported for
            what they register.
        timed_beside: Measure the CPU time of a step, too, in turns with this estimator.
        metrics: Compute all metrics; else the score alone, for which no history is recorded.
        needs: The checkpoint, if there is one.

    Returns:
        ``figures``: every metric ``(N,)`` by key, see `agents.metrics.scores`; ``nees_in_band`` and
            ``nis_in_band``:
        share of times at which their mean over the episodes lies in its 95 % chi-square band, None
        without a covariance; ``diverged (N,)``: mask of episodes with the truth beyond the filter's
        bounds for half of the time; ``steps``: flown in all; ``timing``, where asked: see
        `step_times`.
    """
    import_own(own)
    flown = rollout(
        str(needs[0]) if agent == "checkpoint" else agent,
        registered_id(environment),
        evaluation_seeds(episodes, first_seed),
        environment_options(environment, options),
        record=metrics,
    )
    return {
        "figures": scores(flown) if metrics else {SCORE.key: flown.score},
        "nees_in_band": consistency(flown) if metrics else None,
        "nis_in_band": nis_consistency(flown) if metrics else None,
        "diverged": _diverged(flown) if metrics else np.zeros(episodes, bool),
        "ends": np.where(flown.terminated & (flown.end == ""), "terminated", flown.end).tolist(),
        "steps": int(flown.length.sum()),
    } | (
        {"timing": step_times(environment, options, agent, episodes, timed_beside)}
        if timed_beside
        else {}
    )


def step_times(
    environment: str, options: dict[str, Any], agent: str, episodes: int, other: str
) -> list[tuple[int, float, float]]:
    """CPU seconds of a step: ``(rows, on an estimator, on the other)`` in a batch, and alone.

    The two fly in turns in one process, so a busy machine slows both; the first turn, which loads
    compiled code, does not count, and of the others the median does. Vehicle, sensors and agent are
    included; history and scores are not. Environment, options, agent and episodes (rows of the
    batch) are as for `fly`; the other estimator has no options.
    """
    beside = {key: value for key, value in options.items() if key != "estimator_options"} | {
        "estimator": other
    }
    found = []
    for rows in (episodes, 1):
        own, others = _in_turns(environment, [options, beside], agent, rows)
        found.append((rows, own, others))
    return found


def _in_turns(environment: str, arms: list[dict[str, Any]], agent: str, rows: int) -> list[float]:
    """Median CPU seconds of a step of one vehicle for each of several options."""
    steps, seconds = STEPS if rows > 1 else STEPS_ALONE, np.zeros((TURNS, len(arms)))
    flown = []
    for options in arms:
        made = environment_options(environment, options)
        env = batch(registered_id(environment), rows, made)
        controller = classical_controller(agent, environment)
        controller.reset(rows)
        seeds: Any = evaluation_seeds(rows)
        flown.append([env, controller, env.reset(seed=seeds)[0]])
    for turn, arm in product(range(TURNS), range(len(arms))):
        env, controller, seen = flown[arm]
        begin = process_time()
        for _ in range(steps):
            seen = env.step(controller.act(seen))[0]
        seconds[turn, arm] = process_time() - begin
        flown[arm][2] = seen
    for env, _, _ in flown:
        env.close()
    return (np.median(seconds[1:], axis=0) / (steps * rows)).tolist()


def _diverged(flown: Rollout) -> np.ndarray:
    """Mask ``(N,)`` of episodes with NEES beyond its 1 - 1e-6 quantile for half of the time."""
    from scipy.stats import chi2

    values = nees_of(flown)
    if values is None:
        return np.zeros(len(flown.seeds), bool)
    limit = chi2.isf(LOST, flown.history["estimate"].shape[-1])
    outside = (~(values <= limit) & flown.alive).sum(0)
    return outside > 0.5 * flown.alive.sum(0)
