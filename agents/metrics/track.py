"""Metrics of ships on a track from a rollout's truth and estimates, and of turning circles on one."""

import numpy as np

from agents.metrics import core_of, position_nees, register_metrics, rms, rmse, turning
from agents.metrics.costs import tails
from agents.metrics.metric import described
from agents.metrics.turning import ESTIMATES, circle_fit, input_error, propulsion_costs
from agents.rollouts import Rollout
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.tasks.track import Track

METRICS = (
    *described(
        "track",
        position_rmse=rmse("x", "y"),
        current_rmse=rmse("current north", "current east"),
        **ESTIMATES,
    ),
    position_nees("x", "y"),
)


def compute(rollout: Rollout) -> dict[str, np.ndarray]:
    """Metrics that have no function of their own, ``(N,)`` by key; NaN where there is no unknown input or roll."""
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


def compute_on_circle(rollout: Rollout) -> dict[str, np.ndarray]:
    """Those of a turning circle; the circle is NaN for an episode that flew less than half of it."""
    curvature = core_of(rollout).task.scenario_of(rollout.history["reference"][0])[:, 2]
    radius_error, out_of_round = circle_fit(rollout, 1.0 / np.abs(curvature))
    return compute(rollout) | {"radius_error": radius_error, "out_of_round": out_of_round}


_OF_TURNS = {metric.key: metric for metric in turning.METRICS}
_ON_CIRCLE = (_OF_TURNS["steps"], *METRICS, _OF_TURNS["radius_error"], _OF_TURNS["out_of_round"])

register_metrics(Track, METRICS, compute)
register_metrics(CircleTrack, _ON_CIRCLE, compute_on_circle)
