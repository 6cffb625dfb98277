"""Tables of the robust filters; the paper prints no number."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.statistics import Interval
from studies.papers.measures import Report, Results, Row, Table, between, geometric
from studies.papers.robust.experiment import Condition, job_name, sweeps


def report(settings: Mapping[str, Any], results: Results) -> Report:
    """Tables and measures, from the values of every job."""
    others = [name for name in settings["filters"] if name != "kf"]
    example, hit = results["example"], Condition(**settings["outliers"])
    conditions: Table = [("sweep", "value", "KF, RMSE", *(f"{name} / KF" for name in others))]
    for sweep, group in sweeps(settings).items():
        attribute = "rate" if "outliers" in sweep else sweep
        for condition in group:
            kf = np.exp(np.log(rmse(results, "random", condition, "kf")).mean())
            cells = (between(ratio(results, "random", condition, name), 3) for name in others)
            value = f"{getattr(condition, attribute):g}"
            conditions.append((sweep.replace("_", " "), value, f"{kf:.2f}", *cells))
    quantiles = {"best": 0.0, "10 %": 0.1, "median": 0.5, "90 %": 0.9, "worst": 1.0}
    systems: Table = [("condition", "filter", "systems below the KF [%]", *quantiles)]
    for key in ("nothing wrong", "outliers", "least_favourable", "parameters"):
        condition = Condition(**settings.get(key, {}))
        for name in others:
            of = rmse(results, "random", condition, name) / rmse(results, "random", condition, "kf")
            cells = (f"{q:.2f}" for q in np.quantile(of, [*quantiles.values()]))
            below = f"{100.0 * (of < 1.0).mean():.0f}"
            systems.append((key.replace("_", " "), name, below, *cells))
    error, gain, variance = (np.asarray(example[key]) for key in ("rmse", "gain", "variance"))
    figures: Table = [
        ("on the paper's system", "at the first measurement", "at the last"),
        ("RMSE", f"{error[0]:.2f}", f"{np.sqrt(np.mean(error[settings['skipped'] :] ** 2)):.2f}"),
        ("largest singular value of the gain", f"{gain[0]:.2f}", f"{gain[-1]:.2f}"),
        *((f"variance of x{i + 1}", f"{of[0]:.2f}", f"{of[-1]:.2f}")
          for i, of in enumerate(variance.T)),
        ("printed algorithm less kf, at most", f"{example['printed']:.0e}", ""),
    ]  # fmt: skip
    for name in settings["filters"]:
        affected = ratio(results, "paper", hit, name, Condition())
        figures.append((f"{name}, RMSE with outliers over without", between(affected, 2), ""))
    tables = {"conditions": conditions, "systems": systems, "figures": figures}
    return Report(tables, [Row(settings["paper"], "no number is printed")])


def rmse(results: Results, population: str, condition: Condition, name: str) -> np.ndarray:
    """RMSE of every system over its runs, or of every run of the single system."""
    values = np.asarray(results[job_name(population, condition)][name])
    return values[0] if len(values) == 1 else np.sqrt(np.mean(values**2, axis=1))


def ratio(
    results: Results,
    population: str,
    condition: Condition,
    name: str,
    without: Condition | None = None,
) -> Interval:
    """Geometric mean of RMSE over that of the KF, or over its own in the condition ``without``."""
    other = rmse(results, population, without or condition, name if without else "kf")
    return geometric(np.log(rmse(results, population, condition, name)) - np.log(other))
