"""Fly what `flights.npz` holds, the population of which `test_statistics.py` draws studies: some minutes."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from agents.controllers.turning import ON_TRACK, TrackAutopilot
from agents.rollouts import rollout
from agents.seeds import evaluation_seeds
from agents.studies.worlds import system_of

ENVIRONMENT = "SigmaCorvette-v0"
ESTIMATORS = ("truth", "dead-reckoning", "kf-umv-ui", "kf", "measurement")
CONTROLLERS = 32
SPREAD = 0.35
"""Standard deviation of the logarithm of each of a controller's tolerances."""


def main() -> None:
    flown = {
        name: (
            rollout(
                "autopilot", ENVIRONMENT, evaluation_seeds(2000), {"estimator": name}, record=False
            ).score
        )
        for name in ESTIMATORS
    }
    rng, own, runs = np.random.default_rng(0), ON_TRACK, []
    for factors in np.exp(rng.normal(0.0, SPREAD, (CONTROLLERS, 4))):
        heading, rate, rudder, integral = factors
        tolerances = replace(
            own,
            heading=own.heading * heading,
            yaw_rate=own.yaw_rate * rate,
            rudder_rate=own.rudder_rate * rudder,
            integral=own.integral * integral,
        )
        controller = type("Drawn", (TrackAutopilot,), {"tolerances": tolerances})(
            system_of(ENVIRONMENT)
        )
        runs.append(rollout(controller, ENVIRONMENT, evaluation_seeds(500), record=False).score)
    arrays = {
        name: values.astype(np.float32)
        for name, values in (flown | {"runs": np.array(runs)}).items()
    }
    np.savez_compressed(Path(__file__).parent / "flights.npz", **arrays)


if __name__ == "__main__":
    main()
