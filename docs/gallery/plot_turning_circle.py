"""
One sea, three estimators
=========================

The same ship, the same waves, the same noise, bit for bit. What differs is who tells the autopilot
where she is.
"""

import matplotlib.pyplot as plt
import numpy as np

from agents import rollout
from agents.seeds import evaluation_seeds

figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for estimator in ("measurement", "ekf", "kf-umv-ui"):
    world = {"estimator": estimator, "disturbance": "rough"}
    flight = rollout("autopilot", "SigmaCorvette-v0", evaluation_seeds(1), world)
    truth, estimate = (
        flight.history[key][: flight.length[0] + 1, 0, :2] for key in ("truth", "estimate")
    )
    off = np.linalg.norm(estimate - truth, axis=1)
    axes.plot(
        0.5 * np.arange(len(off)),
        off,
        linewidth=1,
        label=f"{estimator}: score {flight.score[0]:.2f}",
    )
axes.set(xlabel="time [s]", ylabel="error of the estimated position [m]")
axes.legend()
plt.show()
