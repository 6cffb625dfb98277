"""`vessel-gym budget`: from an environment and prices to the cheapest suite."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import agents.jobs
from agents.budget.report import conclusion
from agents.budget.result import Budget, budget_study
from agents.budget.search import TRUTH
from agents.budget.suites import choices_of, price_list, suites_of
from agents.commands import budget
from agents.policies.checkpoint import packaged
from agents.refusal import Refusal
from agents.rollouts import rollout
from agents.seeds import evaluation_seeds
from agents.statistics import Interval
from agents.studies.plan import plan
from agents.studies.records import EACH, Tuning
from agents.studies.worlds import graded_sensors, system_of

ENVIRONMENT = "few_grades:FewGrades-v0"
PRICES = """
[receiver]
nominal = 900
"four metres" = 400
"twelve metres" = 50
["gyro compass"]
nominal = 20_000
worst = 300
"""


def results(out: Path) -> dict[str, int]:
    """The files of a run's flights, each with a number that changes when it is written again."""
    return {path.name: path.stat().st_ino for path in (out / "jobs").iterdir()}


def small(out: Path, prices: Path | None, processes: int = 1) -> int:
    return budget.main(
        ENVIRONMENT, keep=0.8, prices=prices, episodes=128, out=out, processes=processes
    )


@pytest.mark.nightly
def test_interrupted_run_goes_on_to_same_answer(tmp_path, monkeypatch, capsys):
    (tmp_path / "prices.toml").write_text(PRICES)
    whole, broken, run = tmp_path / "whole", tmp_path / "broken", agents.jobs.run
    assert small(whole, tmp_path / "prices.toml") == 0
    printed = capsys.readouterr().out
    runs: Iterator[int] = iter(range(100))

    def interrupted(*arguments: Any, **keywords: Any) -> object:
        if next(runs) == 1:
            raise KeyboardInterrupt
        return run(*arguments, **keywords)

    monkeypatch.setattr(agents.jobs, "run", interrupted)
    with pytest.raises(KeyboardInterrupt, match="kept, and the same command goes on from there"):
        small(broken, tmp_path / "prices.toml")
    done = results(broken)
    assert 0 < len(done) < len(results(whole))
    assert small(broken, tmp_path / "prices.toml", processes=2) == 0
    assert done.items() <= results(broken).items()
    assert results(broken).keys() == results(whole).keys()
    for name in ("budget.html", "results.parquet"):
        assert (broken / name).read_bytes() == (whole / name).read_bytes()

    suite = printed.partition("state knowledge): ")[2].partition(".")[0]
    assert suite in (whole / "budget.html").read_text()
    table = pd.read_parquet(whole / "results.parquet")
    assert len(table[table.condition == suite]) >= 128 + 32
    assert not table.duplicated(["condition", "estimator", "seed"]).any()


def test_the_prices_that_a_run_writes_can_be_given_to_the_next(tmp_path, monkeypatch):
    def begun(*_: object) -> None:
        raise InterruptedError

    monkeypatch.setattr(Budget, "run", begun)
    for given in (None, tmp_path / "out" / "prices.toml"):
        with pytest.raises(InterruptedError):
            small(tmp_path / "out", given)


@pytest.fixture
def made(tmp_path: Path) -> Budget:
    """A search before it begins, in rough seas."""
    choices = choices_of(system_of(ENVIRONMENT))
    suites = suites_of(choices, price_list(choices, None))
    study = budget_study(ENVIRONMENT, "default", "autopilot", "rough", suites)
    return Budget(study, suites, 0.8, tmp_path)


def test_scores_are_those_of_rollout_on_suite(made: Budget):
    sensors = graded_sensors(ENVIRONMENT, {"receiver": "twelve metres", "gyro compass": "worst"})
    options = {"sensors": sensors, "disturbance": "rough"}
    flown = rollout("autopilot", "FewGrades-v0", evaluation_seeds(2, 7), options)
    np.testing.assert_array_equal(made.fly([0], 7, 2), [flown.score])


def test_arms_are_tuned_for_their_suite_the_truth_for_nominal(made: Budget, monkeypatch):
    made.study = replace(made.study, tune=Tuning(3, tunings=1, conditions=(EACH,)))
    asked = list[Any]()

    def run(jobs: list[Any], *_: object) -> agents.jobs.Outcome:
        asked.extend(jobs)
        return agents.jobs.Outcome()

    monkeypatch.setattr(agents.jobs, "run", run)
    assert made.fly([0, TRUTH], 7, 2) == [None, None]
    assert [job.arguments["first_seed"] for job in asked] == [7, 7]
    arms = [need.arguments for job in asked for need in job.needs]
    names = system_of(ENVIRONMENT).estimator, "truth"
    assert [arm["options"]["estimator"] for arm in arms] == [*names]
    assert [arm["conditions"] for arm in arms] == [
        [condition.options] for condition in (made.study.conditions[1], made.study.conditions[0])
    ]
    assert [arm["evaluations"] for arm in arms] == [3, 3]


def test_a_suite_on_which_the_estimator_is_refused_has_no_scores(made: Budget, monkeypatch):
    monkeypatch.setattr("agents.studies.plan.refusal", lambda *_: ValueError("no such filter"))
    assert made.fly([0], 0, 2) == [None]
    assert made.refusals == {"no such filter"}


def test_a_policy_is_known_by_its_content(tmp_path):
    mine, keys = tmp_path / "mine.npz", set()
    for content in (b"", b"another"):
        mine.write_bytes(packaged("SigmaCorvette-v0").read_bytes())
        study = budget_study("SigmaCorvette-v0", "default", str(mine), "rough", [])
        mine.write_bytes(content)
        keys |= {job.key for job in plan(study, metrics=False).jobs}
    assert len(keys) == 4  # of two estimators


def test_lower_rates_are_choices_of_their_own():
    choices = choices_of(system_of(ENVIRONMENT), (1.0, 0.5))
    assert {each.sensor.rate for each in choices["gyro compass"]} == {2.0, 1.0, 0.5}
    assert [each.words for each in choices["receiver"]] == [
        "nominal", "nominal at 0.5 Hz", "four metres", "four metres at 1 Hz", "four metres at 0.5 Hz", "twelve metres",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"keep": 0.0}, "--keep must be above 0 and at most 1, got 0"),
        ({"keep": float("nan")}, "--keep must be above 0 and at most 1, got nan"),
        ({"episodes": 31}, "--episodes must be from 32 to 500000, got 31"),
        ({"first_seed": 500_000}, "--first-seed must be at most 498976, got 500000"),
        ({"rates": (0.3,)}, "reads at 0.3 Hz, which does not divide the 2 steps a second"),
        ({"rates": (0.5, 2.0)}, "--rates must be above 0 and below 2 Hz, the highest of any"),
        ({"agent": "nosuch"}, "nosuch"),
        (
            {"agent": "ppo", "tune": 9},
            "--tune is for controllers: leave it out for a trained policy",
        ),
        ({"tune": -1}, "--tune must be a whole number of at least 0, got -1"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(tmp_path, arguments, sentence):
    with pytest.raises(Refusal, match=r"^[^\n]*$") as refused:
        budget.main(ENVIRONMENT, out=tmp_path / "out", **arguments)
    assert sentence in str(refused.value)
    assert not (tmp_path / "out").exists()


def test_conclusion_names_share_and_verdicts_of_cheaper_suites(made: Budget):
    made.answer = last = len(made.suites) - 1
    made.confirmed[last] = Interval(0.85, 0.8, 0.9)
    made.verdicts = {0: "falls short"}
    first, share, others = conclusion(made)
    assert "confirmed to reach 80 % of the reference score (truth: " in first
    assert share.endswith("it reaches 0.850 ± 0.050 of the reference score.")
    assert others == f"Cheaper suites: falls short (1) and not simulated ({last - 1})."
