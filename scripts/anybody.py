"""What an agent learns from noisy readings in other people's environments: ``python -m scripts.anybody``."""

import json
from pathlib import Path

import numpy as np

from agents.anybody_trial import ARMS, EPISODES, TRIALS, Trial, learned, random
from agents.checkpoint import one_thread
from agents.files import replacing
from agents.statistics import crossed_interval
from scripts.console import asked, command, in_range, progress_bar, put
from scripts.tables import ROOT, table

PAGE = ROOT / "docs/any-environment.md"


def main(runs: int = 3, out: Path = Path("results/anybody")) -> None:
    """Train PPO on the truth and on a `ukf` with noisy readings, and write the table of docs/any-environment.md.

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
            path = _result(out, trial, arm, seed)
            if not path.exists():
                returns = learned(trial, arm, seed)
                with replacing(path) as temporary:
                    temporary.write_text(json.dumps(returns), encoding="utf-8")
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
        row = (_words(np.atleast_2d(chance), 1), _words(truth, 1), _words(estimate, 1), _words(100.0 * share, 1) + " %")
        rows.append((f"{trial.env_id}, {trial.steps:,} steps", *row))
    heads = f"{len(truth)} trainings each"
    return table((heads, "random actions", "PPO on the truth", "PPO on `ukf`", "of the gain over random actions"), rows)


def _words(values: np.ndarray | list[float], decimals: int) -> str:
    interval = crossed_interval(np.asarray(values))
    assert interval is not None, f"{EPISODES} episodes have an interval"
    return f"{interval.mean:,.{decimals}f} ± {interval.half:.{decimals}f}"


def _result(out: Path, trial: Trial, arm: str, seed: int) -> Path:
    return out / f"{trial.env_id}-{arm}-{seed}.json"


if __name__ == "__main__":
    command(main)
