"""
A gap in the measurements
=========================

A filter uses the measurements up to now, so in a gap its uncertainty grows. A smoother reduces it
with the later measurements.
"""

import matplotlib.pyplot as plt
import numpy as np

from estimators import Gaussian, LinearModel, make, run, smooth
from estimators.consistency import simulate

model = LinearModel([[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0]], np.diag([1e-3, 1e-2]), [[1.0]])
prior = Gaussian([0.0, 0.0], np.eye(2))
truth = simulate(model, prior, np.random.default_rng(1), runs=2, steps=60)
y = truth.y.copy()
y[20:40] = np.nan  # the receiver was off

series = run(make("kf", model), prior, y)
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for name, belief in (("filter", series), ("smoother", smooth(series))):
    mean, deviation = belief.mean[:, 0, 0], np.sqrt(belief.cov[:, 0, 0, 0])
    (line,) = axes.plot(mean, label=name)
    axes.fill_between(
        range(60), mean - 2 * deviation, mean + 2 * deviation, color=line.get_color(), alpha=0.2
    )
axes.plot(truth.x[:, 0, 0], color="black", linewidth=1, label="truth")
axes.set(xlabel="step", ylabel="position [m]")
axes.legend(loc="upper left")
plt.show()
