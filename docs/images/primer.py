"""Draw the pictures of docs/primer.md with the package itself: ``python docs/images/primer.py``."""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import chi2

from estimators import Gaussian, LinearModel, make, nees, run
from estimators.consistency import simulate

HERE = Path(__file__).parent
STEP = 0.1  # s
POSITION = np.array([[1.0, STEP], [0.0, 0.98]])


def unknown_input() -> None:
    """A push, and its estimate by a filter that is told nothing of it."""
    model = LinearModel(
        POSITION, [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], 1e-5 * np.eye(2), np.diag([0.04, 0.01, 0.09]),
        G=[[0.005], [0.1]], H=[[0.0], [0.0], [1.0]],
    )  # fmt: skip
    push = 2.0 * np.sign(np.sin(0.05 * np.arange(300.0)))[:, None, None]
    prior = Gaussian([0.0, 0.0], 0.1 * np.eye(2))
    data = simulate(model, prior, np.random.default_rng(0), runs=2, steps=300, d=push)
    series = run(make("kf-umv-ui", model), prior, data.y)
    figure, axes = plt.subplots(figsize=(7, 2.8), layout="constrained")
    time = STEP * np.arange(300)
    axes.plot(time, series.input_mean[:, 0, 0], linewidth=1, label="estimate of kf-umv-ui")
    axes.plot(time, push[:, 0, 0], color="black", label="the push, unknown to the filter")
    axes.set(xlabel="time [s]", ylabel="push [m/s²]", ylim=(-3.2, 5.2))
    axes.legend(loc="upper right", ncols=2)
    figure.savefig(HERE / "primer-input.png", dpi=120)


def ensemble() -> None:
    """Members of an ensemble about the truth, and the NEES of an honest and of an overconfident filter."""
    model = LinearModel(POSITION, [[1.0, 0.0]], np.diag([1e-4, 1e-2]), [[1.0]])
    prior, runs, steps = Gaussian([0.0, 0.0], np.diag([4.0, 1.0])), 100, 120
    data = simulate(model, prior, np.random.default_rng(1), runs=runs, steps=steps)
    time = STEP * np.arange(steps)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    filter = make("enkf", model, members=30)
    belief, members, rng = (
        filter.init(prior, np.random.default_rng(2)),
        [],
        np.random.default_rng(3),
    )
    for k in range(steps):
        belief = filter.predict(belief, rng=rng) if k else belief
        belief = filter.update(belief, data.y[k, 0], rng=rng)
        members.append(belief.ensemble[:, 0])
    left.plot(time, np.array(members), color="tab:blue", alpha=0.3, linewidth=0.6)
    left.plot([], [], color="tab:blue", label="30 members")
    left.plot(time, data.x[:, 0, 0], color="black", label="truth")
    left.plot(time, data.y[:, 0, 0], ".", color="0.6", markersize=3, label="measurements")
    left.set(xlabel="time [s]", ylabel="position [m]")
    left.legend(loc="best", fontsize=8)
    for name, of in (
        ("right noise assumed", model),
        ("a tenth of it assumed", replace(model, Q=model.Q / 10)),
    ):
        series = run(make("kf", of), prior, data.y)
        right.plot(
            time, nees(series.updated.mean, series.updated.cov, data.x).mean(1) / 2, label=name
        )
    low, high = chi2.interval(0.95, 2 * runs)
    right.axhspan(
        low / (2 * runs), high / (2 * runs), color="0.85", label="95 % band of a consistent filter"
    )
    right.set(xlabel="time [s]", ylabel="NEES / 2", ylim=(0, 9))
    right.legend(loc="best", fontsize=8)
    figure.savefig(HERE / "primer-ensemble.png", dpi=120)


if __name__ == "__main__":
    for draw in (unknown_input, ensemble):
        draw()
