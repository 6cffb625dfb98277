"""Flights of studies: a pure function of its arguments, called by jobs."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from agents.controllers import make_controller
from agents.metrics import SCORE, consistency, nees_of, nis_consistency, scores
from agents.rollouts import Rollout, batch, rollout
from agents.seeds import evaluation_seeds
from agents.studies.worlds import environment_options, import_own, registered_id, system_of

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
        ``episodes``: columns of a table with a row for each seed: ``end``; ``completed``, where the
        episode ended as the task asks; every metric by key, see `agents.metrics.scores`;
        ``nees_in_band`` and ``nis_in_band``: share of times at which their mean over the episodes
        lies in its 95 % chi-square band; ``diverged``: 1 where the truth was beyond the filter's
        bounds for half of the time; the last three are NaN without a covariance. ``timing``, where
        asked: see `step_times`.
    """
    import_own(own)
    flown = rollout(
        str(needs[0]) if agent == "checkpoint" else agent,
        registered_id(environment),
        evaluation_seeds(episodes, first_seed),
        environment_options(environment, options),
        record=metrics,
    )
    end = np.where(flown.terminated & (flown.end == ""), "terminated", flown.end)
    completed = end == system_of(environment).task.success
    found: dict[str, Any] = {"end": end, "completed": completed, SCORE.key: flown.score}
    if metrics:
        bands = np.array([consistency(flown), nis_consistency(flown)], float)
        found |= scores(flown) | {"nees_in_band": bands[0], "nis_in_band": bands[1]}
        found |= {"diverged": _diverged(flown)}
    if not timed_beside:
        return {"episodes": found}
    timing = step_times(environment, options, agent, episodes, timed_beside)
    return {"episodes": found, "timing": timing}


def step_times(
    environment: str, options: dict[str, Any], agent: str, episodes: int, other: str
) -> list[tuple[int, float, float]]:
    """CPU seconds of a step: ``(rows, on an estimator, on the other)`` in a batch, and alone.

    The two fly in turns in one process, so a busy machine slows both; the first turn, which loads
    compiled code, does not count, and of the others the median does. Vehicle, sensors and agent are
    included; history and scores are not. Environment, options, agent and episodes (rows of the
    batch) are as for `fly`; the other estimator has no options.
    """
    beside, found = options | {"estimator": other, "estimator_options": None}, []
    for rows, steps in ((episodes, STEPS), (1, STEPS_ALONE)):
        arms = [_blocks(environment, made, agent, rows, steps) for made in (options, beside)]
        seconds = [[next(arm) for arm in arms] for _ in range(TURNS)]
        own, others = np.median(seconds[1:], axis=0)
        found.append((rows, float(own), float(others)))
    return found


def _blocks(
    environment: str, options: dict[str, Any], agent: str, rows: int, steps: int
) -> Iterator[float]:
    """CPU seconds of a step of one vehicle, measured in one block of steps after another."""
    controller = make_controller(agent, system_of(environment))
    controller.reset(rows)
    made, seeds = environment_options(environment, options), evaluation_seeds(rows)
    with closing(batch(registered_id(environment), rows, made)) as env:
        seen = env.reset(seed=seeds)[0]  # type: ignore[arg-type]
        while True:
            begin = process_time()
            for _ in range(steps):
                seen = env.step(controller.act(seen))[0]
            yield (process_time() - begin) / (steps * rows)


def _diverged(flown: Rollout) -> np.ndarray:
    """Episodes ``(N,)`` with NEES beyond its 1 - 1e-6 quantile for half of the time are 1."""
    from scipy.stats import chi2

    values = nees_of(flown)
    if values is None:
        return np.full(len(flown.seeds), np.nan)
    limit = chi2.isf(LOST, flown.history["estimate"].shape[-1])
    outside = (~(values <= limit) & flown.alive).sum(0)
    return (outside > 0.5 * flown.alive.sum(0)).astype(float)
