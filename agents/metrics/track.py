"""Metrics of ships on a track, from a rollout's truth and estimates."""

import numpy as np

from agents.metrics import core_of, nees_in, register_metrics, rms, rmse
from agents.metrics.costs import tails
from agents.metrics.metric import described
from agents.metrics.turning import ESTIMATES, input_error, propulsion_costs
from agents.rollouts import Rollout
from vessel_gym.tasks.track import Track

METRICS = described(
    "track",
    position_rmse=rmse("x", "y"),
    position_nees=nees_in("x", "y"),
    current_rmse=rmse("current north", "current east"),
    **ESTIMATES,
)


def compute(rollout: Rollout) -> dict[str, np.ndarray]:
    """Metrics that have no function of their own, ``(N,)`` by key; NaN where there is no roll."""
    core, h, alive = core_of(rollout), rollout.history, rollout.alive
    task, names = core.task, core.vehicle.state_names
    scenario = task.scenario_of(h["reference"][0])
    along, off = task.on_track(scenario, h["truth"][..., [names.index("x"), names.index("y")]])
    unknown = np.full(len(scenario), np.nan)
    margin = task.margin if hasattr(task, "margin") else task.DISTANCE_TOLERANCE
    return {
        "track_error": rms(off, alive),
        "roll": (
            np.rad2deg(rms(h["truth"][..., names.index("phi")], alive))
            if "phi" in names
            else unknown
        ),
        "input_rmse": 1e3 * input_error(rollout),
        **tails("off_track", off, alive, margin),
        **propulsion_costs(rollout, along[rollout.length, np.arange(len(scenario))] - along[0]),
    }


register_metrics(Track, METRICS, compute)
