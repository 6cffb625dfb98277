"""Table of docs/any-environment.md: what learning on estimates keeps of learning on the truth."""

from functools import partial
from pathlib import Path

import numpy as np

from agents.files import compute_once
from agents.policies.network import one_thread
from studies.tables.markdown import ROOT, shown, table
from studies.third_party.benchmark import ARMS, TRIALS, Trial, learned, random

RUNS = 3
"""Training seeds."""
RESULTS = ROOT / "results/third-party"


def returns(out: Path = RESULTS) -> str:
    """Returns of agents that PPO trains on the truth and on a `ukf` with noisy measurements.

    A training whose result is there is not repeated. All of them take half an hour.
    """
    found = {}
    with one_thread():
        for trial in TRIALS.values():
            each = (_returns(out, trial, arm) for arm in ARMS)
            found[trial] = np.array(random(trial)), *each
    return returns_table(found)


def returns_table(found: dict[Trial, tuple[np.ndarray, ...]]) -> str:
    """Returns of random actions ``(episodes,)``, on the truth and on estimates ``(runs, episodes)``, and shares kept.

    What the estimate keeps is of what learning on the truth gains over random actions, paired by evaluation seed.
    """
    rows = []
    for trial, (chance, truth, estimate) in found.items():
        gain = np.mean(truth) - np.mean(chance)
        share = 1.0 + (estimate - truth) / gain
        row = (*(shown(each, 1) for each in (chance, truth, estimate)), shown(100.0 * share, 1) + " %")
        rows.append((f"{trial.env_id}, {trial.steps:,} steps", *row))
    heads = f"{len(truth)} trainings each"
    return table((heads, "random actions", "PPO on the truth", "PPO on `ukf`", "of the gain over random actions"), rows)


def _returns(out: Path, trial: Trial, arm: str) -> np.ndarray:
    """Returns of the agents of an arm ``(runs, episodes)``."""
    files = ((out / f"{trial.env_id}-{arm}-{seed}.json", partial(learned, trial, arm, seed)) for seed in range(RUNS))
    return np.array([compute_once(path, compute) for path, compute in files])
