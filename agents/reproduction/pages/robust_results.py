"""Results of the cells of the robust filters: errors over those of the KF, and the traits of a system behind them."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_are

from agents.reproduction.pages.comparison import geometric_ratio
from agents.reproduction.robust import cell_name, discretised, draw
from agents.reproduction.settings import robust as settings
from agents.reproduction.settings.robust import Condition
from agents.statistics import Interval

Results = Mapping[str, Mapping[str, Any]]
ROBUST = tuple(name for name, (kind, _) in settings.FILTERS.items() if kind == "robust-kf")
OTHERS = ("huber-kf", *ROBUST)
NOTHING = Condition()


def rmse_of_units(results: Results, population: str, condition: Condition, name: str) -> np.ndarray:
    """RMSE of each unit of an interval: of every system over its runs, or of every run of the single system."""
    values = np.asarray(results[cell_name(population, condition)][name])
    return values[0] if len(values) == 1 else np.sqrt(np.mean(values**2, axis=1))


def mean_ratio(results: Results, population: str, condition: Condition, name: str) -> Interval:
    """The geometric mean of a filter's RMSE over that of the KF on the same readings, one unit a pair."""
    return geometric_ratio(*(rmse_of_units(results, population, condition, filter) for filter in (name, "kf")))


def unit_ratios(results: Results, condition: Condition, name: str) -> np.ndarray:
    """Every random system's RMSE over that of the KF."""
    ours, kf = (rmse_of_units(results, settings.RANDOM, condition, filter) for filter in (name, "kf"))
    return ours / kf


def percent(value: float) -> str:
    """A share in words."""
    return f"{100.0 * value:g} %"


MODEL_ERRORS = {
    "least-favourable model": f"least-favourable model, c = {settings.LEAST_FAVOURABLE.tolerance:g}",
    "parameter error": f"A off by δ = {percent(settings.PARAMETERS.parameters)}",
}
SHOWN = (NOTHING, settings.OUTLIERS, settings.LEAST_FAVOURABLE, settings.PARAMETERS)
SHOWN_TITLES = (
    "nothing wrong",
    f"{percent(settings.OUTLIERS.rate)} outliers of {settings.OUTLIERS.size:g} σ",
    f"least favourable, c = {settings.LEAST_FAVOURABLE.tolerance:g}",
    f"A off by {percent(settings.PARAMETERS.parameters)}",
)


@cache
def system_traits() -> dict[str, np.ndarray]:
    """Of every random system: how well the readings show their weakest direction, and how sure its prediction is."""
    weakest, doubt = [], []
    for seed in settings.POPULATIONS[settings.RANDOM].seeds:
        model = discretised([draw(seed)])
        A, C, Q = model.A[0, 0], model.C[0, 0], model.Q[0, 0]
        P = solve_discrete_are(A.T, C.T, Q, model.R)
        weakest.append(np.linalg.svd(C, compute_uv=False)[-1])
        doubt.append(np.trace(C @ P @ C.T) / np.trace(model.R))
    return {"weakest": np.array(weakest), "doubt": np.array(doubt)}


WHERE = (
    ("huber-kf", settings.OUTLIERS, "doubt", "variance of the prediction / of the reading"),
    (ROBUST[1], NOTHING, "weakest", "smallest singular value of C"),
)
"""Filter, condition, trait of the system and its label: what explains where each filter gains or loses."""
