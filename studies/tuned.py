"""Tables of ``studies/tuned.toml``, in which every estimator is tuned with its controller.

They are read from ``results``, where ``vessel-gym ablate tuned`` leaves them, and ``ablate`` of
``tuned_each``, in which arms are tuned for each condition, and of ``likelihood``. ``python -m
studies.tuned`` tunes the autopilots for their defaults.
"""

from itertools import groupby
from typing import Any

import numpy as np
import pandas as pd

from agents import rollout
from agents.commands.ablate import STUDIES
from agents.jobs import load
from agents.page import mean_and_half, text
from agents.policies.checkpoint import description, packaged
from agents.statistics import crossed_interval
from agents.studies.plan import plan
from agents.studies.records import ORACLE
from agents.studies.study import read_study
from agents.studies.tables import tuning_findings
from agents.studies.worlds import system_of
from agents.tuning.arm import Arm
from agents.tuning.trials import Trials
from agents.tuning.tune import tune
from agents.tuning.tuned import load_tuned
from studies.comparisons import arm_metrics
from studies.markdown import NONE, ROOT, table
from studies.results import episodes

Episodes = dict[tuple[str, str], np.ndarray]

STUDY, EACH, LIKELIHOOD = "tuned", "tuned_each", "likelihood"
AGENT = "autopilot"
TUNED = f"{AGENT}, tuned"
PACKAGED = "SigmaCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0"
"""Environments with a trained agent in the package."""


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
CHANNEL = SHIPS | {
    "quartering": {"disturbance": "moderate quartering"},
    "rough quartering": {"disturbance": "rough quartering"},
}
MIX = {
    "SigmaCorvette-v0": SHIPS, "SigmaChannel-v0": CHANNEL, "SegorogeniAUV-v0": SUITES,
    "ItsunusaAUV-v0": SUITES, "PunaUAV-v0": SUITES,
}  # fmt: skip
"""Conditions for whose mean score the defaults of the autopilots are tuned."""


def tune_defaults() -> None:
    """Tune the autopilot of each environment on its default filter, into ``results/defaults``."""
    folder = ROOT / "results" / "defaults"
    folder.mkdir(parents=True, exist_ok=True)
    for environment, mix in MIX.items():
        own = {"estimator": system_of(environment).estimator}  # which may have another default
        arm = Arm(environment, options=own, conditions=tuple(mix.values()), picked=("agent",))
        tune(arm, 60, 200, fresh=200).write(folder / f"{environment}.toml")


def defaults() -> str:
    """Score of each environment's defaults in each condition, and NEES/n of the position."""
    rows = []
    for environment, mix in MIX.items():
        cells = [NONE] * len(CHANNEL)
        for i, options in enumerate(mix.values()):
            of = arm_metrics("default", environment, **options)
            nees = np.median(of["position_nees"])
            cells[i] = f"{mean_and_half(of['score'])}; {nees:.2f}"
        rows.append([f"`{environment}`", f"`{system_of(environment).estimator}`", *cells])
    return table(["score; NEES/n of the position", "estimator", *CHANNEL], rows)


def packaged_agents() -> str:
    """The trained agents of the package beside the autopilots, as delivered and tuned."""
    study, rows = read_study(STUDIES[STUDY]), []
    tuning: Any = study.tune
    most = 1e-6 * tuning.evaluations * tuning.episodes
    for environment in PACKAGED:
        system, first = system_of(environment), study.conditions[0].name
        name, horizon = system.estimator, system.task.horizon
        plain, tuned = (episodes(STUDY, environment, of)[first, name] for of in (AGENT, TUNED))
        ppo = rollout("ppo", environment, study.seeds, record=False).score
        told = description(packaged(environment)) or {}
        cells = map(mean_and_half, (plain, tuned, ppo, ppo - plain, ppo - tuned))
        steps = f"{most * horizon:.1f}; {1e-6 * told['trained_steps']:.1f}"
        rows.append((f"`{environment}`", f"`{name}`", *cells, steps))
    header = (
        "", "estimates", "`autopilot`", "tuned", "`ppo`", "`ppo` − `autopilot`", "`ppo` − tuned",
        "10⁶ steps at most: tuning; training",
    )  # fmt: skip
    return table(header, rows)


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
    largest difference between the mean scores of two tunings. What the second half of the
    candidates gained is a mean over the tunings, on their own seeds.
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
        means, curves = own.mean(1), [np.array(fit.found["best_so_far"]) for fit in mine]
        late = np.mean([curve[-1] - curve[len(curve) // 2 - 1] for curve in curves])
        rows.append({
            "environment": environment, "estimator": estimator,
            "loss under the truth's controller": text(crossed_interval(best - under)),
            "won back": text(crossed_interval(own - under)),
            "overfitting": text(over),
            "scatter": text(crossed_interval(own[[means.argmax()]] - own[[means.argmin()]])),
            "gain of the second half of the candidates": f"{late:.3f}",
            "NEES of the position": nees, "at a bound": bounds,
        })  # fmt: skip
    return _file("tunings.csv", pd.DataFrame(rows))


if __name__ == "__main__":
    tune_defaults()
