"""How much each factor moves the score: results made to have a known answer, and what is said of them."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from invented import (
    CONDITIONS,
    CORVETTE,
    LEARNED,
    QUALITY,
    SEGOROGENI,
    results,
    study,
    without,
)
from scipy.stats import binom

from agents.statistics import crossed_interval, mean_interval
from agents.studies.answer import answer
from agents.studies.effects import (
    _numbered,
    contrasts,
    effects,
    interactions,
    levels,
)
from agents.studies.plan import plan
from agents.studies.records import Condition, Estimator, Tuning
from agents.studies.results import Results, at

NAMES = ("kf-umv-ui", "kf", "ekf", "enkf")
SUITES = (
    Condition("ours"),
    Condition("cheap", sensors="budget"),
    Condition("RTK", sensors={"receiver": "RTK"}),
)
FLAT = dict.fromkeys(QUALITY, 0.6) | {"truth": 1.0, "dead-reckoning": 0.0}


def crossed(conditions=SUITES, environments=(CORVETTE,), episodes=20, compare_to=""):
    asked = study(environments, conditions=conditions, episodes=episodes)
    return replace(asked, compare_to=compare_to)


def moved(change, conditions=SUITES, quality=FLAT):
    """Qualities of all filters by condition, those of the quality and a change by condition."""
    return {
        f"{n}_in_{c.name}": quality[n] + change.get(c.name, 0.0) for n in NAMES for c in conditions
    }


def said(found):
    """The sentences of the answer, joined."""
    return " ".join(answer(found))


def of(found, factor):
    return next(each for each in effects(found) if each.factor == factor)


def test_a_boat_builder_hears_first_that_sensors_matter():
    change = {"RTK": 0.15, "cheap": -0.2}
    quality = FLAT | {"ekf": 0.625}
    asked = crossed(compare_to="kf")
    found = results(asked, quality, noise=2e-3, **moved(change, quality=quality))
    first, second = effects(found)[:2]
    assert (first.factor, first.reference, first.best) == ("sensors", "nominal", "receiver: RTK")
    assert first.gain.mean == pytest.approx(0.8 * 0.15, abs=3e-3)
    assert (first.worst, second.factor, second.best) == ("budget", "estimator", "ekf")
    assert second.gain.mean == pytest.approx(0.8 * 0.025, abs=3e-3)
    assert re.match(
        r"There is a gain from the sensors: with receiver: RTK the autopilot scores 0\.1\d+ ± \S+"
        r" more than with nominal\. There is a gain from the estimator: with ekf the autopilot"
        r" scores 0\.0\d+ ± \S+ more than with kf\. Score is lost with budget \(sensors: −0\.1",
        said(found),
    )


def test_where_nothing_matters_nothing_is_named():
    """Of 40 studies of equal levels, at most 7 name one: 5 % do, 8 or more once in a thousand.

    With seven levels beside the reference, intervals for one level alone name one in a quarter.
    """
    compasses = "nominal", "fibre-optic", "IMO gyro-compass", "magnetic"
    conditions = [
        Condition(f"{receiver} {compass}", sensors={"receiver": receiver, "gyro compass": compass})
        for receiver in ("nominal", "RTK")
        for compass in compasses
    ]
    found = results(crossed(conditions), FLAT)
    rng, named = np.random.default_rng(0), 0
    for _ in range(40):
        table = found.table.assign(score=rng.normal(0.5, 0.02, len(found.table)))
        effect = of(replace(found, table=table), "sensors")
        named += effect.gain.excludes_zero or effect.loss.excludes_zero
    assert named <= binom.isf(1e-3, 40, 0.05)
    assert re.search(
        r"^No level of any factor scores significantly more than its reference\. No significant"
        r" effect: \w+ \(\S+ ± \S+\) and \w+ \(\S+ ± \S+\)\. ", said(found),
    )  # fmt: skip


def test_a_trend_over_rates_is_a_loss_of_the_sensor_rate():
    words = ("SBAS", "SBAS at 0.5 Hz", "SBAS at 0.2 Hz")
    conditions = tuple(
        Condition(f"{r} Hz", sensors={"receiver": w})
        for r, w in zip((1, 0.5, 0.2), words, strict=True)
    )
    change = {"0.5 Hz": -0.05, "0.2 Hz": -0.2}
    found = results(crossed(conditions), FLAT, noise=2e-3, **moved(change, conditions))
    effect = of(found, "sensor rate")
    assert (effect.reference, effect.best, effect.gain.mean) == ("its own", "its own", 0.0)
    assert effect.worst == "receiver: 0.2 Hz"
    assert "Score is lost with receiver: 0.2 Hz (sensor rate: −0.16" in said(found)
    assert sum(step.mean for step in effect.trend) == pytest.approx(effect.loss.mean)
    told = (
        r"The score falls with each step of the sensor rate: −0\.04\d* ± \S+ and −0\.12\d* ± \S+\. "
    )
    assert re.search(told, said(found))


@pytest.mark.parametrize(
    ("errors", "change", "moves"),
    [
        ((0.0, 0.1, 0.2), (0.0, -0.05, -0.2), "falls"),
        ((0.2, 0.1, 0.0), (0.0, 0.05, 0.1), "rises"),
        ((0.0, 0.2, 0.1), (0.0, -0.05, -0.2), None),  # not in order
        ((0.0, 0.1, 0.2), (0.0, -0.2, -0.05), None),  # down and up
        ((0.0, 0.1, 0.2), (0.0, 0.0, -0.2), None),  # one step by chance
        ((0.0, 0.1), (0.0, -0.2), None),  # one step alone
    ],
)
def test_a_trend_is_a_score_that_moves_with_each_step(errors, change, moves):
    conditions = tuple(Condition(str(e), mismatch=e) for e in errors)
    by_name = {c.name: each for c, each in zip(conditions, change, strict=True)}
    asked = crossed(conditions, (CORVETTE, SEGOROGENI))
    found = results(asked, FLAT, noise=2e-3, **moved(by_name, conditions))
    told = re.findall(r"The score (\w+) with each step of the (\w+ \w+):", said(found))
    assert told == ([(moves, "model error")] if moves else [])


@pytest.mark.parametrize(
    "levels",
    [
        ("none", "gps: 0.1 s", "compass: 0.2 s", "gyro: 0.3 s"),
        ("10 Hz", "weird", "5 Hz", "1 Hz"),
        ("none", "3 sensors", "5 sensors"),
        ("none", "calm etc. sea", "rough"),
    ],
)
def test_levels_of_several_quantities_have_no_order(levels):
    assert not _numbered(levels)
    assert _numbered(("none", "gps: 1e-05 s", "gps: 0.2 s"))


def test_missing_jobs_leave_only_complete_cells():
    whole = results(crossed(), FLAT, **moved({"RTK": 0.1}))
    lost = without(whole, lambda f: (f.estimator, f.condition) == ("ekf", "RTK"))
    kept = replace(whole, table=whole.table[(whole.table.estimator != "ekf")])
    assert of(lost, "sensors").gain == of(kept, "sensors").gain
    assert of(lost, "sensors").loss == of(whole, "sensors").loss
    assert answer(lost)[-1].startswith("1 of 18 results are missing")


def test_raw_measurements_and_ends_are_no_filters():
    asked = crossed(SUITES[:1])
    asked = replace(asked, estimators=(*asked.estimators, Estimator("held", "measurement")))
    found = results(asked, QUALITY | {"held": 0.99})
    effect = of(found, "estimator")
    assert effect.best == "kf-umv-ui"
    assert effect.worst == "kf"


def test_best_level_is_that_of_each_environment():
    found = results(crossed(SUITES[:1], (CORVETTE, SEGOROGENI), compare_to="ekf"), noise=1e-3)
    effect = of(found, "estimator")
    assert (effect.reference, effect.best) == ("ekf", "each environment's best")
    assert effect.gain.mean == pytest.approx(0.8 * (0.20 + 0.05) / 2, abs=2e-3)


@pytest.mark.parametrize("runs", [5, 4, 1])
def test_agents_are_compared_at_home_over_their_runs(runs):
    """Without a run that lacks a condition; a single run has no interval."""
    policy = "PPO trained on ekf"
    agents, training_seeds = LEARNED[:2], runs + (runs == 4)
    found = results(study((CORVETTE,), agents, training_seeds, CONDITIONS[::2]))
    if runs == 4:
        found = without(found, lambda f: (f.policy, f.run, f.condition) == (policy, 2, "rough"))
    table = found.table.assign(score=found.table.score + 0.1 * (found.table.policy == policy))
    found = replace(found, table=table)
    ours, theirs = (at(found.score, policy=name, estimator="ekf") for name in (policy, "autopilot"))
    gaps = [
        (ours.xs(run, level="run") - theirs.xs(0, level="run")).mean()
        for run in ours.index.unique("run")
        if (runs, run) != (4, 2)
    ]
    agent = of(found, "agent")
    assert (agent.reference, agent.best) == ("autopilot", policy)
    if runs == 1:
        assert agent.gain.mean == pytest.approx(gaps[0].mean())
        assert "from the agent" not in said(found)
    else:
        expected = crossed_interval(np.array(gaps), 2)
        assert (agent.gain.low, agent.gain.high) == pytest.approx((expected.low, expected.high))
        assert f"gain from the agent: {policy} scores " in said(found)


def test_tuning_is_a_factor():
    tuned = plan(study((CORVETTE,), episodes=20))
    again = tuple(replace(f, policy="autopilot, tuned") for f in tuned.flights)
    asked = replace(tuned.study, tune=Tuning())
    both = replace(tuned, study=asked, flights=(*tuned.flights, *again))
    made = results(tuned)
    table = made.table.assign(policy="autopilot, tuned")
    table["score"] += 0.05 * (~table.estimator.isin(["truth", "dead-reckoning"]))
    effect = of(Results(both, pd.concat([made.table, table], ignore_index=True)), "tuning")
    assert (effect.reference, effect.best) == ("delivered parameters", "tuned parameters")
    assert (effect.gain.mean, effect.gain.half) == pytest.approx((0.05, 0.0), abs=1e-9)


def test_effects_of_tuned_arms_are_crossed_over_tunings():
    asked = replace(crossed(compare_to="kf"), tune=Tuning(tunings=4))
    found = results(asked, FLAT, noise=0.02, **moved({"RTK": 0.1}))
    score = found.wide("score").xs((CORVETTE, "autopilot, tuned"), level=["environment", "policy"])
    score = score[score.index.get_level_values("estimator").isin(NAMES)]
    gaps = (score.loc["RTK"] - score.loc["ours"]).groupby("run").mean().to_numpy()
    expected, gain = crossed_interval(gaps, 2), of(found, "sensors").gain
    assert (gain.mean, gain.half) == pytest.approx((expected.mean, expected.half))
    assert expected.half > mean_interval(gaps.mean(axis=0), 2).half


def test_factors_that_change_together_are_one():
    conditions = (
        Condition("a"),
        Condition("b", disturbance="rough", mismatch=0.2),
        Condition("c", sensors="budget"),
    )
    found = results(crossed(conditions), FLAT)
    names = {effect.factor: effect.worst for effect in effects(found)}
    assert set(names) == {"sensors", "disturbance and model error", "estimator"}
    assert names["disturbance and model error"] in ("rough, 20 %", "moderate, 0 %")


def test_interaction_larger_than_main_effect_is_said():
    """A filter that gains with cheap sensors what it loses with others has no main effect."""
    changed = {"kf_in_ours": 0.5, "kf_in_cheap": 0.7, "kf_in_RTK": 0.6}
    found = results(crossed(), FLAT, noise=2e-3, **changed)
    first = interactions(found)[0]
    assert (first.factor, first.level, first.other, first.at) == (
        "estimator",
        "kf",
        "sensors",
        "budget",
    )
    assert first.change.mean == pytest.approx(0.8 * 0.2, abs=5e-3)
    assert (
        f"In {CORVETTE} the effect of the estimator depends on the sensors: with budget the"
        " difference that kf makes changes by +0.1" in said(found)
    )
    assert not interactions(results(crossed(), FLAT, noise=2e-3, **moved({"RTK": 0.1})))


def test_levels_without_complete_cells_are_left_out():
    index = pd.MultiIndex.from_tuples(
        [("x", "a", "1"), ("x", "b", "1"), ("x", "a", "2"), ("x", "b", "2"), ("x", "c", "3")],
        names=["environment", "factor", "other"],
    )
    table = pd.DataFrame({0: [1.0, 2.0, 3.0, 6.0, 9.0]}, index)
    found = contrasts(table, "factor", "a")
    assert list(found) == ["b"]
    assert found["b"][0].tolist() == [1.0, 3.0]
    assert contrasts(table, "factor", "nosuch") == {}


@pytest.mark.parametrize(
    ("condition", "factor", "level"),
    [
        (Condition("x", sensors={"receiver": "nominal at 0.5 Hz"}), "sensors", "nominal"),
        (
            Condition("x", sensors={"receiver": "nominal at 0.5 Hz"}),
            "sensor rate",
            "receiver: 0.5 Hz",
        ),
        (Condition("x", mismatch=0.1), "model error", "10 %"),
        (Condition("x", latency={"receiver": 1.5}), "latency", "receiver: 1.5 s"),
        (
            Condition("x", faults=({"sensor": "receiver", "kind": "loss"},)),
            "faults",
            "receiver: loss",
        ),
    ],
)
def test_levels_are_in_words(condition, factor, level):
    assert levels(condition)[factor] == level
    assert {k: v for k, v in levels(condition).items() if k not in ("sensor rate", factor)} == {
        k: v for k, v in levels(Condition("y")).items() if k not in ("sensor rate", factor)
    }
