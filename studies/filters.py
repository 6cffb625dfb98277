"""Tables of docs/ on filters alone, without an environment's task, and on grades of sensors."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.page import mean_and_half
from agents.papers.robust.experiment import Condition, simulate, squared_errors
from agents.studies.worlds import system_of
from estimators import LinearModel
from studies.lorenz import BENCHMARKS, analysis_rmse
from studies.markdown import table
from vessel_gym.sensors import Sensor
from vessel_gym.sensors.grades import read_grades

RUNS, STEPS, SKIPPED = 1000, 200, 20
"""Runs and steps of the tables of robust filters, and steps that are not scored."""


# --- robust filters -------------------------------------------------------------------------------


def constant_velocity(intensity: float, measurement: float = 1.0) -> LinearModel:
    """Constant velocity under white acceleration [m2/s3]; the position is measured at 1 Hz."""
    A, C = np.array([[[[1.0, 1.0], [0.0, 1.0]]]]), np.array([[[[1.0, 0.0]]]])
    Q = intensity * np.array([[[[1.0 / 3.0, 0.5], [0.5, 1.0]]]])
    return LinearModel(A, C, Q, np.array([[measurement]]), 0.0 * C.mT)


def over_kf(
    model: LinearModel, world: LinearModel, condition: dict[str, float], seed: int, *arms: Any
) -> tuple[float, list[tuple[float, float]]]:
    """RMSE of `kf` on the model; of each arm its RMSE over that, and half of its 95 % interval.

    The interval is of the ratio linearised, over the same runs of the world.
    """
    record = simulate(model, world, Condition(**condition), STEPS, RUNS, seed)
    plain, *others = (
        squared_errors(arm, model, record)[SKIPPED:].mean(0)[0] for arm in ({"kind": "kf"}, *arms)
    )
    found = []
    for errors in others:
        mean = np.sqrt(errors.mean() / plain.mean())
        influence = 0.5 * mean * (errors / errors.mean() - plain / plain.mean())
        found.append((mean, 1.96 * influence.std(ddof=1) / np.sqrt(len(errors))))
    return np.sqrt(plain.mean()), found


def robust_losses() -> str:
    """RMSE of robust filters over that of `kf` with a right model and with wrong ones."""
    model = constant_velocity(0.01)
    cases: dict[str, tuple[LinearModel, dict[str, float]]] = {
        "as the model says": (model, {}),
        "σ tenfold in 10 % of measurements": (model, {"rate": 0.1, "size": 10.0}),
        "least-favourable model, 0.01": (model, {"tolerance": 0.01}),
        "least-favourable model, 0.1": (model, {"tolerance": 0.1}),
        "true Q ten times as large": (constant_velocity(10.0 * 0.01), {}),
        "true R four times as large": (constant_velocity(0.01, 4.0), {}),
    }
    robust = [{"kind": "robust-kf", "radius": radius} for radius in (0.01, 0.1)]
    rows = []
    for label, (world, condition) in cases.items():
        plain, found = over_kf(model, world, condition, 1, {"kind": "huber-kf"}, *robust)
        cells = (f"{mean:.3f} ± {half:.3f}" for mean, half in found)
        rows.append((label, f"{plain:.2f}", *cells))
    return table(("data", "`kf` RMSE", "`huber-kf`", "`robust-kf`, 0.01", "`robust-kf`, 0.1"), rows)


# --- other filters --------------------------------------------------------------------------------


def published_scores() -> str:
    """Analysis RMSE of ensemble and particle filters in 20 runs of each, and the published one.

    Filters that are the same transform share a row and are run once, under the first name.
    """
    rows = []
    for row in BENCHMARKS:
        ours = analysis_rmse(row, row.filters[0], 20)
        published = f"{row.published:g}" + "\\*" * row.reported_only
        rows.append((row.setting.name, ", ".join(row.filters), str(row.members), row.described,
                     mean_and_half(ours), f"{np.median(ours):.3f}", published))  # fmt: skip
    return table(("system", "filter", "N", "options", "our mean", "our median", "published"), rows)


# --- grades of sensors ----------------------------------------------------------------------------

GRADED = {
    "SigmaCorvette-v0": "Ships",
    "SegorogeniAUV-v0": "Underwater vehicles",
    "PunaUAV-v0": "Small aircraft",
}
"""Headings of the tables of grades, by environment."""


def sensor_grades() -> str:
    """Tables of the grades of sensors for each kind of vehicle, with suites and documents.

    Figures have the keys of a file of grades. What no document states has an asterisk.
    """
    parts = []
    for env_id, heading in GRADED.items():
        grades, rows = read_grades(system_of(env_id)), []
        for name, grade in ((name, grade) for name, of in grades.sensors.items() for grade in of):
            suites = [suite for suite, of in grades.suites.items() if of.get(name) == grade]
            label = f"{grade} (`{'`, `'.join(suites)}`)" if suites else grade
            given = grades.tables[name][grade]
            figures = _figures(grades.sensors[name][grade], given.get("assumed", ()))
            document = re.split(r" by| datasheet|,| \(|: ", given["source"])[0]
            rows.append((name, label, figures, document))
        heads = "sensor", "grade", "figures", "document"
        parts.append(f"### {heading}\n\n{table(heads, rows)}")
    return "\n\n".join(parts)


def _figures(sensor: Sensor, assumed: Sequence[str]) -> str:
    """The figures of a sensor that are not 0: one number for all channels, or one for each."""
    figures: dict[str, Any] = {key: getattr(sensor, key) for key in ("sd", "rate", "dropout")}
    if sensor.bias is not None:
        keys = ("start", "pace", "time", "constant")
        figures |= {key: getattr(sensor.bias, key) for key in keys}
    found = []
    for key, value in figures.items():
        if value is not None and np.any(value):
            values = np.atleast_1d(value).tolist()
            shown = values[:1] if len(set(values)) == 1 else values
            star = "*" if key in assumed else ""
            found.append(f"{key}{star} {' '.join(f'{each:g}' for each in shown)}")
    return ", ".join(found)
