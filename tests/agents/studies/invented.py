"""Results that nobody flew, under the keys of a plan: scores follow from a quality of each estimator."""

from dataclasses import replace
from functools import cache
from zlib import crc32

import numpy as np

from agents.metrics import WITHOUT_COVARIANCE, metrics
from agents.studies.plan import Plan, plan
from agents.studies.records import RAW, Agent, Condition, Estimator, Study
from agents.studies.results import Results
from agents.studies.worlds import system_of

CORVETTE, SEGOROGENI = "SigmaCorvette-v0", "SegorogeniAUV-v0"
QUALITY = {
    "truth": 1.0,
    "kf-umv-ui": 0.95,
    "enkf": 0.8,
    "ekf": 0.75,
    "kf": 0.5,
    RAW: 0.4,
    "dead-reckoning": 0.0,
}
"""Share that an estimator keeps, but for noise; raw measurements stand for what learned agents make of them."""
ENDS = (Estimator("truth", "truth"), Estimator("dead-reckoning", "dead-reckoning"))
CLASSICAL = Agent("autopilot", "autopilot")
LEARNED = (
    CLASSICAL,
    Agent("PPO", "ppo", trained_on=("default", "ekf")),
    Agent("PPO, raw", "ppo", observe="measurement"),
    Agent("PPO, LSTM", "ppo", observe="measurement", memory="lstm"),
)
CONDITIONS = (
    Condition("nominal"),
    Condition("calm", disturbance="calm"),
    Condition("rough", disturbance="rough"),
    Condition("all wrong", sensors="degraded", mismatch=0.2),
)


def study(
    environments=(CORVETTE, SEGOROGENI),
    agents=(CLASSICAL,),
    training_seeds=5,
    conditions=CONDITIONS,
    episodes=8,
):
    estimators = (*ENDS, *(Estimator(name, name) for name in ("kf-umv-ui", "kf", "ekf", "enkf")))
    return Study(
        "Which one?", tuple(environments), estimators, agents, conditions, episodes, training_seeds
    )


def results(planned: Plan | Study, quality=QUALITY, noise=0.01) -> Results:
    """What flights would give if scores were 0.1 + 0.8 of the quality, less 0.02 for a policy off its own estimator."""
    planned = planned if isinstance(planned, Plan) else plan(planned)
    values, seconds, timings = {}, {}, {}
    for f in planned.flights:
        rng = np.random.default_rng(
            crc32(repr((f.job.label, f.condition, f.trained_on, f.training_seed)).encode())
        )
        n = planned.study.episodes
        weather = np.random.default_rng(7).normal(0.0, 0.02, n)
        run = 0.0 if f.training_seed is None else rng.normal(0.0, 2.0 * noise)
        crossed = 0.02 * (f.trained_on not in ("", f.flown_on))
        score = (
            0.1 + 0.8 * quality[f.flown_on] + weather + run - crossed + rng.normal(0.0, noise, n)
        )
        claims = f.flown_on not in WITHOUT_COVARIANCE
        figures = {m.key: rng.lognormal(0.0, 0.2, n) for m in metrics(system_of(f.environment))}
        figures |= {"score": score} | ({} if claims else {"nees": np.full(n, np.nan)})
        values[f.job.key] = {
            "figures": {key: each.tolist() for key, each in figures.items()},
            "nees_in_band": 0.9 if claims else None,
            "nis_in_band": 0.95 if claims else None,
            "diverged": [False] * n,
            "ends": [""] * n,
            "steps": 100 * n,
        }
        seconds[f.job.key] = 1e-5 * (1.0 + len(f.flown_on)) * 100 * n
        if f.job.arguments.get("timed_beside"):
            timings[f.job.key] = [(n, 1e-5 * (1.0 + len(f.flown_on)), 1e-5), (1, 2e-4, 1e-4)]
        for training in f.job.needs:
            values[training.key] = {"steps": 1000}
    return Results(planned, values, {}, seconds, timings=timings)


@cache
def learned() -> Results:
    """Of the study with all agents, made once for all tests, which leave it as it is."""
    return results(study(agents=LEARNED))


def without(found: Results, unwanted, why: str | None = None) -> Results:
    """The same without the flights of which something holds; with a reason they have failed."""
    keys = {f.job.key for f in found.plan.flights if unwanted(f)}
    values = {key: value for key, value in found.values.items() if key not in keys}
    return replace(found, values=values, failures=dict.fromkeys(keys, why) if why else {})
