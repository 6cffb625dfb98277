"""Tables of ``studies/tuned.toml``, in which every estimator is tuned with its controller.

They are read from ``results/tuned``, where ``vessel-gym ablate tuned`` leaves them.
"""

from collections.abc import Iterator
from itertools import groupby

import numpy as np

from agents.commands.ablate import STUDIES
from agents.jobs import load
from agents.page import interval
from agents.seeds import tuning_seeds
from agents.statistics import crossed_interval
from agents.studies.plan import Flight, plan
from agents.studies.records import ORACLE
from agents.studies.study import read_study
from agents.tuning.trials import Trials
from agents.tuning.tune import FRESH
from agents.tuning.tuned import load_tuned
from studies.markdown import NONE, ROOT, table
from studies.results import episodes

STUDY = "tuned"
AGENT = "autopilot"


def scores(environment: str) -> str:
    """Scores as delivered and tuned, and the cost against the truth's own tuned controller.

    95 % hold for all costs of an environment at once. They are crossed over tunings and seeds.
    """
    before, after = (episodes(STUDY, environment, name) for name in (AGENT, f"{AGENT}, tuned"))
    conditions = list(dict.fromkeys(condition for condition, _ in after))
    names = dict.fromkeys(name for _, name in after)
    compared = len(conditions) * (len(names) - 1)

    def cell(condition: str, name: str) -> str:
        if (at := (condition, name)) not in after:
            return NONE
        gain = f"{before[at].mean():.3f} → {after[at].mean():.3f}"
        cost = crossed_interval(after[condition, ORACLE] - after[at], compared)
        return gain if name == ORACLE else f"{gain}; {interval(cost)}"

    rows = [[f"`{name}`", *(cell(each, name) for each in conditions)] for name in names]
    return table(["delivered → tuned; cost", *conditions], rows)


ROWS = {
    "perfect state knowledge": (ORACLE,),
    "EKF": ("ekf",),
    "EKF with waves as states": ("ekf-waves",),
    "KF-UMV-UI": ("kf-umv-ui",),
    "UKF": ("ukf",),
    "EnKF, EnKF-SR": ("enkf", "enkf-sr"),
    "Huber's filter": ("huber-kf-nonlinear", "huber-kf"),
    "constant gain": ("steady-kf",),
    "raw measurements": ("measurement",),
}
"""Estimators of a row of the table of all environments."""


def overview() -> str:
    """Scores in the first condition as delivered and tuned, a column an environment."""
    columns = {}
    for environment in read_study(STUDIES[STUDY]).environments:
        before, after = (episodes(STUDY, environment, name) for name in (AGENT, f"{AGENT}, tuned"))
        first = next(iter(after))[0]
        columns[environment] = {
            name: f"{before[first, name].mean():.2f} → **{after[first, name].mean():.2f}**"
            for condition, name in after
            if condition == first
        }
    rows = [
        [title, *(next((c[n] for n in names if n in c), NONE) for c in columns.values())]
        for title, names in ROWS.items()
    ]
    return table(["score: as delivered → **tuned**", *(f"`{name}`" for name in columns)], rows)


def _tunings() -> Iterator[tuple[tuple[str, str], list[Flight]]]:
    """Tuned arms by environment and estimator, with a flight for each tuning."""
    first = {
        (f.environment, f.estimator, f.run): f
        for f in plan(read_study(STUDIES[STUDY])).flights
        if f.policy == f"{AGENT}, tuned"
    }
    for arm, flights in groupby(first.values(), lambda f: (f.environment, f.estimator)):
        yield arm, list(flights)


def tunings() -> str:
    """NEES, overfitting and scatter of the tunings of each arm.

    Overfitting is the gain on tuning seeds less that on other seeds. The scatter is the largest
    difference between the scores of two tunings, on the same seeds.
    """
    folder, rows = ROOT / "results" / STUDY / "jobs", []
    for (environment, estimator), flights in _tunings():
        jobs = [flight.job.needs[0] for flight in flights]
        found = [record["values"] for job in jobs if (record := load(job, folder))]
        fits = [load_tuned(folder / f"{job.key}.toml") for job in jobs]
        over = [f["after"] - f["before"] - f["gain"][0] for f in found]
        on = Trials(fits[0].arm, tuning_seeds(200, first=FRESH + 1000))
        each = on.scores([fit.values for fit in fits])
        means = each.mean(1)
        one, other = each[means.argmax()], each[means.argmin()]
        apart = interval(crossed_interval((one - other)[None]))
        bounds = sorted({name for f in found for name in f["at_bound"]})
        nees = np.mean([f["position_nees"] for f in found])
        rows.append([
            f"`{environment}`", f"`{estimator}`", NONE if np.isnan(nees) else f"{nees:.2f}",
            interval(crossed_interval(np.array(over)[None])), apart,
            ", ".join(bounds) or NONE,
        ])  # fmt: skip
    heads = "", "estimator", "NEES of the position", "overfitting", "scatter", "at a bound"
    return table(heads, rows)
