"""
An unknown push
===============

A filter with an unknown input estimates the force on a boat together with its position and speed.
It assumes nothing about the force.
"""

import matplotlib.pyplot as plt
import numpy as np

from estimators import Gaussian, LinearModel, make, run
from estimators.consistency import simulate

# Position, speed and the acceleration by the push are measured.
model = LinearModel(
    A=[[1.0, 0.1], [0.0, 0.98]],
    C=[[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]],
    Q=1e-5 * np.eye(2),
    R=np.diag([0.04, 0.01, 0.09]),
    G=[[0.005], [0.1]],
    H=[[0.0], [0.0], [1.0]],
)
push = 2.0 * np.sign(np.sin(0.05 * np.arange(300.0)))[:, None, None]
prior = Gaussian([0.0, 0.0], 0.1 * np.eye(2))
truth = simulate(model, prior, np.random.default_rng(0), runs=2, steps=300, d=push)
series = run(make("kf-umv-ui", model), prior, truth.y)

time = 0.1 * np.arange(300)
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
axes.plot(time, series.input_mean[:, 0, 0], linewidth=1, label="estimated, kf-umv-ui")
axes.plot(time, push[:, 0, 0], color="black", label="the push")
axes.set(xlabel="time [s]", ylabel="acceleration [m/s²]", ylim=(-3, 5))
axes.legend(loc="upper right", ncols=2)
plt.show()
