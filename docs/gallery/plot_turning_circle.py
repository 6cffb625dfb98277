"""
One sea, three estimators
=========================

Ship, waves and sensor noise are the same, bit for bit. In each episode the autopilot uses
another estimator.
"""

import matplotlib.pyplot as plt
import numpy as np

from agents import rollout
from agents.seeds import evaluation_seeds

figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for estimator in ("measurement", "ekf", "kf-umv-ui"):
    world = {"estimator": estimator, "disturbance": "rough"}
    episode = rollout("autopilot", "SigmaCorvette-v0", evaluation_seeds(1), world)
    truth, estimate = (
        episode.history[key][: episode.length[0] + 1, 0, :2] for key in ("truth", "estimate")
    )
    off = np.linalg.norm(estimate - truth, axis=1)
    axes.plot(
        0.5 * np.arange(len(off)),
        off,
        linewidth=1,
        label=f"{estimator}: score {episode.score[0]:.2f}",
    )
axes.set(xlabel="time [s]", ylabel="error of the estimated position [m]")
axes.set_ylim(top=1.3 * axes.get_ylim()[1])  # room for the legend
axes.legend(ncols=3, loc="upper center", fontsize="small")
plt.show()
