"""Example episodes: flown at the typical seed, and a page to touch in the report."""

import json
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from invented import CORVETTE, SEGOROGENI, results, study

from agents.episodes import Episode, typical_seed
from agents.rollouts import rollout
from agents.studies.examples import example, examples
from agents.studies.plan import options
from agents.studies.records import Condition, Estimator
from agents.studies.report import write_report

CALM = Condition("calm", disturbance="calm")


def test_examples_show_the_best_the_reference_and_the_truth():
    found = results(replace(study(), compare_to="ekf"))
    chosen = examples(found)
    shown = {
        environment: [name for name, _ in job.arguments["estimators"]]
        for environment, job in chosen.items()
    }
    assert shown == {
        CORVETTE: ["kf-umv-ui", "ekf", "truth"],
        SEGOROGENI: ["enkf", "ekf", "truth"],
    }
    for environment, job in chosen.items():
        assert job.arguments["environment"] == environment
        assert job.arguments["seeds"] == found.plan.study.seeds
        assert all(given["disturbance"] == "moderate" for _, given in job.arguments["estimators"])


@pytest.mark.slow
@pytest.mark.parametrize("environment", [CORVETTE, SEGOROGENI, "ItsunusaAUV-v0", "PunaUAV-v0"])
def test_example_is_what_is_flown_and_survives_its_store(environment):
    names = ["ekf", "measurement"]
    given = [(name, options(study(), CALM, Estimator(name, name), environment)) for name in names]
    shown = Episode(json.loads(json.dumps(example(environment, given, "autopilot", [3], {}))))
    for name in names:
        alone = rollout(
            "autopilot", environment, [3], {"estimator": name, "disturbance": "calm"}, record=False
        )
        assert shown.scores[name] == alone.score[0]
    for flight in shown.page["flights"]:
        assert (flight["root"] is None) == (flight["estimator"] == "measurement")


def test_typical_seed_has_scores_nearest_to_their_means():
    rng = np.random.default_rng(0)
    scores = rng.normal(size=(3, 40)) * [[1.0], [10.0], [0.1]]
    scores[:, 17] = scores[:, np.arange(40) != 17].mean(1)
    assert typical_seed(scores, range(100, 140)) == 117
    scores[2] = 0.5  # the same at every seed
    assert typical_seed(scores, range(100, 140)) == 117
    assert typical_seed(scores[:, :1], [5]) == 5


@pytest.mark.nightly
def test_a_report_plays_what_was_flown(tmp_path):
    found = results(study((SEGOROGENI,)))
    job = examples(found)[SEGOROGENI]
    flown = example(**job.arguments)
    page = write_report(found, tmp_path, {SEGOROGENI: flown}).read_text(encoding="utf-8")
    (document,) = re.findall(r'<iframe srcdoc="([^"]*)"', page)
    assert unescape(document) == Episode(flown).html()
