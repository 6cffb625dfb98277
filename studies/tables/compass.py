"""Table and figure of docs/suites.md: estimators over the correlation time of the magnetic compass' dynamic error."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from agents.plotting import PALETTE, styled
from agents.statistics import crossed_interval
from agents.studies.worlds import system_of
from studies.tables.arms import Arm
from studies.tables.markdown import ROOT, shown, table
from vessel_gym.sensors import Sensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ENVIRONMENT, COMPASS = "SigmaCorvette-v0", "gyro compass"
TIMES = (10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
"""Correlation times [s]; that of the suite `budget` is 30 s."""
ARMS = (
    Arm("`kf-umv-ui`", "kf-umv-ui"),
    Arm("`ekf` assuming waves", "ekf", {"assume": {"disturbance": "moderate", "as": "states"}}),
    Arm("`huber-kf`", "huber-kf", {"model": "nonlinear"}),
    Arm("`ekf`", "ekf"),
    Arm("`kf`", "kf"),
)
"""The first is compared with the others."""
PICTURE = ROOT / "docs/images/compass-memory.png"


def sensors(time: float) -> list[Sensor]:
    """Sensors of the suite `budget` with another correlation time [s] of the compass, which filters know."""
    return [
        each if each.name != COMPASS else replace(each, bias=replace(each.bias, time=time))
        for each in system_of(ENVIRONMENT).sensors_of("budget").each
    ]


def draw(figure: "Figure", less: dict[str, list[np.ndarray]]) -> None:
    """Means and 95 % intervals of paired differences over the correlation time, slightly apart for each estimator."""
    axes = figure.subplots()
    axes.axhline(0.0, color="black", linewidth=0.8, label=ARMS[0].label.strip("`"))
    for i, (label, values) in enumerate(less.items()):
        intervals = [crossed_interval(each[None]) for each in values]
        means, halves = ([getattr(of, key) for of in intervals] for key in ("mean", "half"))
        places = np.array(TIMES) * 1.06 ** (i - 1.5)
        axes.errorbar(
            places, means, halves, label=label.replace("`", ""), color=PALETTE[i], marker="osD^"[i], markersize=4,
            linewidth=1.0, capsize=2,
        )  # fmt: skip
    axes.set(
        xscale="log",
        xlabel="correlation time of the compass [s]",
        ylabel="score, less that of kf-umv-ui",
    )
    axes.legend(fontsize=8, ncols=2)


def compass() -> str:
    """Scores by correlation time, as paired differences to the first estimator's; draws them into `PICTURE`."""
    from matplotlib.figure import Figure

    ours, *others = ARMS
    scores = {
        time: {arm.label: arm.fly(ENVIRONMENT, sensors=sensors(time)).score for arm in ARMS}
        for time in TIMES
    }
    less = {arm.label: [of[arm.label] - of[ours.label] for of in scores.values()] for arm in others}
    with styled():
        figure = Figure(figsize=(7.0, 3.4), layout="constrained")
        draw(figure, less)
        figure.savefig(PICTURE, dpi=120)
    heads = ("correlation time", ours.label, *(f"{arm.label} − {ours.label}" for arm in others))
    rows = [
        (
            f"{time:g} s",
            shown(scores[time][ours.label]),
            *(shown(values[i]) for values in less.values()),
        )
        for i, time in enumerate(TIMES)
    ]
    return table(heads, rows)
