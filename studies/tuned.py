"""Tables of ``studies/tuned.toml``, in which every estimator is tuned with its controller.

They are read from ``results``, where ``vessel-gym ablate tuned`` leaves them, and ``ablate`` of
``tuned_each``, in which arms are tuned for each condition, of ``tuned_twice``, with twice as many
candidates, and of ``likelihood``. The files that come with the package are made by
``python -m studies.tuned``.
"""

from itertools import groupby
from typing import Any

import numpy as np
import pandas as pd

from agents.commands.ablate import STUDIES
from agents.jobs import load
from agents.page import text
from agents.seeds import tuning_seeds
from agents.statistics import crossed_interval, mean_interval
from agents.studies.plan import plan
from agents.studies.records import ORACLE
from agents.studies.study import read_study
from agents.studies.tables import tuning_findings
from agents.studies.worlds import system_of
from agents.tuning.arm import Arm
from agents.tuning.trials import Trials
from agents.tuning.tune import FRESH, tune
from agents.tuning.tuned import SHIPPED, load_tuned
from studies.markdown import NONE, ROOT, table
from studies.results import episodes

Episodes = dict[tuple[str, str], np.ndarray]

STUDY, EACH, LIKELIHOOD, TWICE = "tuned", "tuned_each", "likelihood", "tuned_twice"
AGENT = "autopilot"
TUNED = f"{AGENT}, tuned"


def arms(environment: str) -> pd.DataFrame:
    """Scores and costs of an environment's arms in words, a row for each condition and estimator.

    Costs are against the truth with its own tuned controller; 95 % hold for all of an
    environment at once, crossed over tunings and seeds. A dash: where an arm cannot be used.
    """
    delivered, once = (episodes(STUDY, environment, agent) for agent in (AGENT, TUNED))
    conditions, names = map(set, zip(*once, strict=True))
    each = {at: own for at, own in once.items() if at[0] == next(iter(once))[0]}
    if environment in read_study(STUDIES[EACH]).environments:
        each |= episodes(EACH, environment, TUNED)

    def cost(own: Episodes, condition: str, name: str) -> str:
        if (condition, name) not in own or name == ORACLE:
            return NONE
        lost = own[condition, ORACLE] - own[condition, name]
        return text(crossed_interval(lost, len(conditions) * (len(names) - 1)))

    likely = episodes(LIKELIHOOD, environment, TUNED)
    return pd.DataFrame(
        {
            "environment": environment, "condition": at[0], "estimator": at[1],
            "delivered": mean(delivered, at), "by likelihood": mean(likely, at),
            "tuned once": mean(once, at), "cost": cost(once, *at),
            "tuned for the condition": mean(each, at), "its cost": cost(each, *at),
        }
        for at in once
    )  # fmt: skip


def mean(own: Episodes, at: tuple[str, str]) -> str:
    """Mean score of an arm; a dash where it cannot be used."""
    return f"{own[at].mean():.3f}" if at in own else NONE


def scores(environment: str) -> str:
    """Scores in the first condition, and costs in all."""
    found = arms(environment).set_index(["estimator", "condition"])
    costs = found["cost"].unstack(sort=False).fillna(NONE)
    first, *others = costs
    ways = found[["delivered", "by likelihood", "tuned once"]].xs(first, level="condition")
    shown = ways.join(costs, how="right").fillna(NONE)
    heads = "delivered", "by likelihood", "tuned", f"cost: {first}", *others
    return table(["", *heads], [(f"`{name}`", *cells) for name, *cells in shown.itertuples()])


def everything() -> str:
    """All scores and costs, in a file beside the pages."""
    found = map(arms, read_study(STUDIES[STUDY]).environments)
    return _file("tuned.csv", pd.concat(found))


SUITES: dict[str, dict[str, Any]] = {
    name: {"sensors": name} for name in ("nominal", "budget", "denied")
}
SHIPS = SUITES | {"rough": {"disturbance": "rough"}, "mismatch .2": {"mismatch": 0.2}}
MIX = {
    "SigmaCorvette-v0": SHIPS, "SigmaChannel-v0": SHIPS, "SegorogeniAUV-v0": SUITES,
    "ItsunusaAUV-v0": SUITES, "PunaUAV-v0": SUITES,
}  # fmt: skip
"""Conditions for whose mean score the files that come with the package are tuned."""


def ship() -> None:
    """Tune the default estimator and the autopilot of each environment anew, for the package."""
    for environment, mix in MIX.items():
        own = {"estimator": system_of(environment).estimator}  # which may have another default
        tune(Arm(environment, options=own, conditions=tuple(mix.values()))).write(
            SHIPPED[environment]
        )


def shipped() -> str:
    """Scores with the files that come with the package, on seeds that no tuning has used."""
    rows, seeds = [], tuning_seeds(200, first=FRESH + 2000)
    for environment in MIX:
        tuned = load_tuned(environment)
        count = len(tuned.arm.conditions)
        before, after = Trials(tuned.arm, seeds).scores([{}, tuned.values])
        gains = np.split(after - before, count)
        cells = [*(text(mean_interval(gain, count)) for gain in gains), *[NONE] * len(SHIPS)]
        nees = f"{tuned.found['position_nees']:.2f}"
        rows.append([f"`{environment}`", f"`{tuned.arm.estimator}`", *cells[: len(SHIPS)], nees])
    return table(["gain of score", "estimator", *SHIPS, "NEES of the position"], rows)


def _file(name: str, found: pd.DataFrame) -> str:
    """A table in a file beside the pages, and what shows it on a page."""
    found.to_csv(ROOT / "docs" / name, index=False)
    return f"```{{csv-table}}\n:file: {name}\n:header-rows: 1\n```"


ROWS = {
    "perfect state knowledge (`truth`)": (ORACLE,),
    "`ekf`": ("ekf",),
    "`ekf-waves` (waves as states)": ("ekf-waves",),
    "`kf-umv-ui`": ("kf-umv-ui",),
    "`ukf`": ("ukf",),
    "`enkf`, `enkf-sr`": ("enkf", "enkf-sr"),
    "`huber-kf-nonlinear`, `huber-kf`": ("huber-kf-nonlinear", "huber-kf"),
    "`steady-kf` (constant gain)": ("steady-kf",),
    "raw measurements (`measurement`)": ("measurement",),
}
"""Estimators of a row of the table of all environments."""


def overview() -> str:
    """Scores in the first condition as delivered and tuned, a column an environment."""
    columns = {}
    for environment in read_study(STUDIES[STUDY]).environments:
        before, after = (episodes(STUDY, environment, name) for name in (AGENT, TUNED))
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


def tunings() -> str:
    """Cost, NEES, overfitting and scatter of the tunings of each arm, in the first condition.

    The cost is the loss under the truth's tuned controller minus what the arm's own controller wins
    back. Overfitting is the gain on tuning seeds minus the gain on other seeds. The scatter is the
    largest difference between the mean scores of two tunings. The last gain is that of the first
    tuning, on equal seeds.
    """
    folder, study = ROOT / "results" / STUDY / "jobs", read_study(STUDIES[STUDY])
    first, rows = study.conditions[0].name, list[dict[str, str]]()
    arms = groupby(
        plan(study).where(policy=TUNED, condition=first), lambda f: (f.environment, f.estimator)
    )
    jobs = {arm: [flight.job.needs[0] for flight in each] for arm, each in arms}
    fits = {
        arm: [load_tuned(folder / f"{job.key}.toml") for job in each] for arm, each in jobs.items()
    }
    for (environment, estimator), each in jobs.items():
        found = [record["values"] for job in each if (record := load(job, folder))]
        over, nees, bounds = tuning_findings(found)
        tuned = episodes(STUDY, environment, TUNED)
        own, best = tuned[first, estimator], tuned[first, ORACLE]
        mine, truths = fits[environment, estimator], fits[environment, ORACLE]
        under = Trials(mine[0].arm, study.seeds).scores(
            [fit.values | truth.values for fit, truth in zip(mine, truths, strict=True)]
        )
        twice, means = episodes(TWICE, environment, TUNED)[first, estimator], own.mean(1)
        rows.append({
            "environment": environment, "estimator": estimator,
            "loss under the truth's controller": text(crossed_interval(best - under)),
            "won back": text(crossed_interval(own - under)),
            "overfitting": text(over),
            "scatter": text(crossed_interval(own[[means.argmax()]] - own[[means.argmin()]])),
            "gain of twice as many candidates": text(crossed_interval(twice - own[:1])),
            "NEES of the position": nees, "at a bound": bounds,
        })  # fmt: skip
    return _file("tunings.csv", pd.DataFrame(rows))


if __name__ == "__main__":
    ship()
