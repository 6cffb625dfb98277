"""Learning from noisy measurements in environments of third parties: ``python -m studies.third_party``."""

import json
from functools import partial
from pathlib import Path

import numpy as np

from agents.commands.console import asked, command, in_range, progress_bar
from agents.files import compute_once
from agents.policies.network import one_thread
from studies.tables.markdown import ROOT, put, shown, table
from studies.third_party.benchmark import ARMS, TRIALS, Trial, learned, random

PAGE = ROOT / "docs/any-environment.md"


def main(runs: int = 3, out: Path = Path("results/third-party")) -> None:
    """Train PPO on the truth and on a `ukf` with noisy measurements, and write the table of docs/any-environment.md.

    A training whose result is there is not repeated. All of them take half an hour.

    Args:
        runs: Training seeds.
        out: Folder of the results.
    """
    with asked():
        in_range("--runs", runs, 2)  # one run has no interval
    todo = [(trial, arm, seed) for seed in range(runs) for trial in TRIALS.values() for arm in ARMS]
    with progress_bar("trainings", len(todo)) as advance, one_thread():
        for trial, arm, seed in todo:
            compute_once(_result(out, trial, arm, seed), partial(learned, trial, arm, seed))
            advance()
    found = {
        trial: {arm: np.array([json.loads(_result(out, trial, arm, seed).read_text()) for seed in range(runs)])
                for arm in ARMS}
        for trial in TRIALS.values()
    }  # fmt: skip
    put(PAGE, "table: learned", returns_table({trial: (random(trial), *by.values()) for trial, by in found.items()}))


def returns_table(found: dict[Trial, tuple[np.ndarray | list[float], ...]]) -> str:
    """Returns of random actions ``(episodes,)``, on the truth and on estimates ``(runs, episodes)``, and shares kept.

    What the estimate keeps is of what learning on the truth gains over random actions, paired by evaluation seed.
    """
    rows = []
    for trial, (chance, truth, estimate) in found.items():
        gain = np.mean(truth) - np.mean(chance)
        share = 1.0 + (np.asarray(estimate) - truth) / gain
        row = (*(shown(np.asarray(each), 1) for each in (chance, truth, estimate)), shown(100.0 * share, 1) + " %")
        rows.append((f"{trial.env_id}, {trial.steps:,} steps", *row))
    heads = f"{len(truth)} trainings each"
    return table((heads, "random actions", "PPO on the truth", "PPO on `ukf`", "of the gain over random actions"), rows)


def _result(out: Path, trial: Trial, arm: str, seed: int) -> Path:
    return out / f"{trial.env_id}-{arm}-{seed}.json"


if __name__ == "__main__":
    command(main)
