"""
Measurements with outliers
==========================

One measurement in twelve is far off. The Kalman filter follows it. In ``huber-kf``, Huber's loss
limits how far outliers move the estimate.
"""

import matplotlib.pyplot as plt
import numpy as np

from estimators import Gaussian, LinearModel, make, run
from estimators.consistency import simulate

model = LinearModel([[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0]], np.diag([1e-3, 1e-4]), [[1.0]])
prior = Gaussian([0.0, 0.0], np.diag([1.0, 0.1]))
rng = np.random.default_rng(3)
truth = simulate(model, prior, rng, runs=2, steps=60)
wild = rng.random(truth.y.shape) < 1 / 12
y = truth.y + wild * rng.choice([-15.0, 15.0], truth.y.shape)

figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
axes.plot(y[:, 0, 0], ".", color="0.6", label="measurements")
axes.plot(truth.x[:, 0, 0], color="black", label="truth")
for name in ("kf", "huber-kf"):
    axes.plot(run(make(name, model), prior, y).mean[:, 0, 0], label=name)
axes.set(xlabel="step", ylabel="position [m]")
axes.legend(ncols=2)
plt.show()
