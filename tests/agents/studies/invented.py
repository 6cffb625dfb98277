"""Results that nobody flew, under the keys of a plan: scores follow from a quality of each estimator."""

from dataclasses import replace
from functools import cache
from zlib import crc32

import numpy as np

from agents.jobs import Outcome
from agents.metrics import metrics
from agents.studies.plan import Plan, plan
from agents.studies.records import RAW, Agent, Condition, Estimator, Study
from agents.studies.results import Results
from agents.studies.worlds import system_of
from vessel_gym.models.estimation import WITHOUT_COVARIANCE

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
    training_seeds=3,
    conditions=CONDITIONS,
    episodes=8,
):
    estimators = (*ENDS, *(Estimator(name, name) for name in ("kf-umv-ui", "kf", "ekf", "enkf")))
    return Study(
        "Which one?", tuple(environments), estimators, agents, conditions, episodes, training_seeds
    )


def results(planned: Plan | Study, quality=QUALITY, noise=0.01, **changed) -> Results:
    """What a run would give if scores were 0.1 + 0.8 of the quality, and 0.02 less away from home.

    ``changed`` are other qualities of estimators by "estimator in condition", spaces as underscores.
    """
    planned = planned if isinstance(planned, Plan) else plan(planned)
    outcome, n = Outcome(), planned.study.episodes
    for f in planned.flights:
        rng = np.random.default_rng(crc32(repr((f.job.label, f.policy, f.run)).encode()))
        weather = np.random.default_rng(7).normal(0.0, 0.02, n)
        run = rng.normal(0.0, 2.0 * noise) if f.job.needs else 0.0
        crossed = 0.02 * bool(f.job.needs and not f.home)
        level = changed.get(f"{f.estimator}_in_{f.condition}", quality[f.estimator])
        score = 0.1 + 0.8 * level + weather + run - crossed + rng.normal(0.0, noise, n)
        claims = 1.0 if f.estimator not in WITHOUT_COVARIANCE else np.nan
        figures = {m.key: rng.lognormal(0.0, 0.2, n) for m in metrics(system_of(f.environment))}
        figures |= {"nees": figures["nees"] * claims, "nees_in_band": 0.9 * claims}
        figures |= {"score": score, "end": [""] * n, "completed": True}
        outcome.values[f.job.key] = figures
        for need in f.job.needs:
            outcome.values[need.key] = {"steps": 200, "curve": [[100, level], [200, 2.0 * level]]}
        outcome.seconds[f.job.key] = 1e-5 * (1.0 + len(f.estimator)) * 100 * n
    return Results.of(planned, outcome)


@cache
def learned() -> Results:
    """Of the study with all agents, made once for all tests, which leave it as it is."""
    return results(study(agents=LEARNED, conditions=CONDITIONS[:3]))


def without(found: Results, unwanted, why: str | None = None) -> Results:
    """The results without the flights of which something holds; with a reason they have failed."""
    lost = {f.job.key for f in found.plan.flights if unwanted(f)}
    values = {key: each for key, each in found.outcome.values.items() if key not in lost}
    failures = dict.fromkeys(lost, why) if why else {}
    return Results.of(found.plan, replace(found.outcome, values=values, failures=failures))
