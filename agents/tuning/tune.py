"""Tune an arm: search on tuning seeds, set the scale of Q and R, compare on fresh seeds."""

import time
from collections.abc import Callable
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np

import vessel_gym
from agents.metrics import scores
from agents.seeds import tuning_seeds
from agents.source import source_digest
from agents.statistics import mean_interval
from agents.studies.worlds import digests
from agents.tuning.arm import LIKELIHOOD, SCORE, Arm, Values, is_noise
from agents.tuning.search import Journal, search
from agents.tuning.trials import Trials
from agents.tuning.tuned import Tuned
from estimators.checks import integer
from vessel_gym.models.estimation import WITHOUT_COVARIANCE

FRESH = 500_000
"""Number of the first tuning seed on which tuned and delivered parameters are compared."""
MATTERS = 0.002
"""Largest change of the score that counts as none."""
_SCALINGS = 2
NEAR = 0.01
"""Share of a range from its end at which a parameter counts as being at its bound."""


def tune(
    arm: Arm,
    evaluations: int = 100,
    episodes: int = 40,
    seed: int = 0,
    fresh: int = 100,
    journal: Path | None = None,
    processes: int = 1,
    progress: Callable[[int, float], None] = lambda done, best: None,
) -> Tuned:
    """Tune estimator and controller together for the highest mean score, in closed loop.

    All candidates meet the same ``episodes`` tuning seeds in each condition. Then Q and R are
    multiplied by one factor such that the NEES of the position is 1 per component in the median
    episode, if that hardly changes the score. Tuned and delivered parameters are compared on other
    seeds.

    Args:
        arm: What is tuned, and for which conditions.
        evaluations: Largest number of candidates.
        episodes: Seeds of a candidate in each condition.
        seed: Number of the tuning. Each has its own tuning seeds and its own start of the search;
            number 0 starts at the delivered values.
        fresh: Seeds of the comparison, two or more.
        journal: File to which each evaluation is appended, and from which an interrupted tuning
            goes on; None: none.
        processes: Processes that share the episodes of a candidate.
        progress: As for `agents.tuning.search.search`.

    Raises:
        ValueError: for an arm without parameters, a damaged journal or one of another tuning, or
            seeds that are not there.
    """
    evaluations, began = integer("evaluations", evaluations, 1), _cpu_seconds()
    trials = Trials(arm, seeds_of_tuning(episodes, seed), processes)
    others = tuning_seeds(integer("fresh", fresh, 2), first=FRESH)
    made_by = {
        "version": vessel_gym.__version__, "source": source_digest("agents.tuning.tune"),
        "first_seed": trials.seeds[0], "episodes": episodes, "evaluations": evaluations,
        "seed": seed,
        "own": digests(arm.env_id, arm.agent, arm.options, *arm.conditions),
    }  # fmt: skip
    described = [made_by, arm.env_id, arm.agent, str(arm.options), str(arm.conditions), arm.by]
    kept = Journal(journal, [*described, sorted(arm.parameters)])
    values = search(
        lambda values: float(trials.scores([values]).mean()), arm.parameters, evaluations, seed,
        kept, progress,
    )  # fmt: skip
    searched, (values, nees) = values, _scaled(trials, values)
    best = np.fmax.accumulate([score for _, score in kept.points]).tolist()
    if arm.by == LIKELIHOOD:
        trials = Trials(replace(arm, by=SCORE), trials.seeds, processes)
    before, after = trials.scores([{}, values]).mean(1).tolist()
    found = {
        "before": before, "after": after, "best_so_far": best, "position_nees": nees,
        "at_bound": _at_bound(arm, searched),
    }  # fmt: skip
    found |= _compared(Trials(trials.arm, others), searched, values)
    return Tuned(arm, values, made_by, found | {"cpu_seconds": _cpu_seconds() - began})


def _cpu_seconds() -> float:
    """CPU seconds of this process, and of others for its trials."""
    return time.process_time() + Trials.elsewhere


def seeds_of_tuning(episodes: int, seed: int) -> list[int]:
    """Tuning seeds of a tuning, by its number.

    Raises:
        ValueError: if they would be among those on which parameters are compared.
    """
    first = integer("episodes", episodes, 1) * integer("seed", seed, 0)
    if first + episodes > FRESH:
        raise ValueError(
            f"there are {FRESH} seeds to tune on: tuning {seed} of {episodes} episodes needs"
            f" {first + episodes}, so take fewer episodes or a smaller seed"
        )
    return tuning_seeds(episodes, first)


def _scaled(trials: Trials, values: Values) -> tuple[Values, float]:
    """Values with a common factor on Q and R, and the NEES of the position per component.

    The gain of a Kalman filter depends on the ratio of Q and R alone, and so does the score. The
    factor brings the NEES to 1 unless that changes the score by `MATTERS` or more.
    """
    arm = trials.arm
    if arm.estimator in WITHOUT_COVARIANCE:
        return values, np.nan
    nees, names = _nees(trials, values), [n for n in arm.every if is_noise(n)]
    if arm.picked or arm.by == LIKELIHOOD or not names or not np.isfinite(nees):
        return values, nees
    scaled, scaled_nees = values, nees
    for _ in range(_SCALINGS):  # the share of the prior and of biases does not scale
        scaled = scaled | {name: scaled_nees * (arm.delivered | scaled)[name] for name in names}
        scaled_nees = _nees(trials, scaled)
    before, after = trials.scores([values, scaled]).mean(1)
    return (scaled, scaled_nees) if abs(after - before) < MATTERS else (values, nees)


def _nees(trials: Trials, values: Values) -> float:
    """NEES of the position per component, in the median of the episodes.

    A mean would follow a single episode in which the filter diverges. NaN where there is none.
    """
    agent, name = trials.arm.made_agent(values), "position_nees"
    every = [scores(each, name) for each in trials.flown(values, agent, record=True)]
    return float(np.median([each.get(name, [np.nan]) for each in every]))


def _at_bound(arm: Arm, values: Values) -> list[str]:
    """Names of the parameters at an end of their range."""
    shares = {name: p.range.to_unit(values[name]) for name, p in arm.parameters.items()}
    return [name for name, share in shares.items() if not NEAR < share < 1.0 - NEAR]


def _compared(trials: Trials, searched: Values, values: Values) -> dict[str, Any]:
    """Comparison of the scores of tuned and delivered parameters on other seeds.

    The gain of a parameter is that over all others as searched and this one as delivered. Q and R
    are not yet scaled there: a sensor's R as delivered beside the scaled R of the others would
    count the scale as its gain. A gain over parameters that fail is NaN.
    """
    left_out = [{n: v for n, v in searched.items() if n != name} for name in searched]
    delivered, tuned, best, *others = trials.scores([{}, values, searched, *left_out])
    gains = [mean_interval(each) for each in (tuned - delivered, *(best - np.array(others)))]
    gain, *each = [[*astuple(g)] for g in gains]
    return {
        "fresh_delivered": float(delivered.mean()), "fresh_tuned": float(tuned.mean()),
        "gain": gain, "gain_of": dict(zip(searched, each, strict=True)),
    }  # fmt: skip
