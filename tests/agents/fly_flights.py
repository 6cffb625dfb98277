"""Fly what `flights.npz` holds, the flights of which `test_statistics.py` draws studies."""

from pathlib import Path

import numpy as np

from agents.rollouts import rollout
from agents.seeds import evaluation_seeds

ESTIMATORS = ("truth", "dead-reckoning", "kf-umv-ui", "kf", "measurement")


def main() -> None:
    seeds, arrays = evaluation_seeds(2000), {}
    for name in ESTIMATORS:
        flown = rollout("autopilot", "SigmaCorvette-v0", seeds, {"estimator": name}, record=False)
        arrays[name] = flown.score.astype(np.float32)
    np.savez_compressed(Path(__file__).parent / "flights.npz", **arrays)


if __name__ == "__main__":
    main()
