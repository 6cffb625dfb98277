"""Example episodes: flown at a seed that nobody chose, and small enough to be kept."""

import json

import numpy as np
import pytest
from invented import CORVETTE, SEGOROGENI, study

from agents.rollouts import rollout
from agents.scores import scores
from agents.studies.examples import POINTS, _unknown, example, examples
from agents.studies.plan import options, plan
from agents.studies.study import Condition, Estimator

CALM = Condition("calm", disturbance="calm")


def flown(environment, estimator, seed=0):
    return example(environment, options(CALM, Estimator(estimator, estimator), environment), "autopilot", seed, {})


def test_examples_are_of_the_first_seed_and_condition_on_the_default_two_others_and_dead_reckoning():
    chosen = examples(plan(study()))
    assert [name for environment, name in chosen if environment == CORVETTE] == [
        "kf-umv-ui", "kf", "enkf", "dead-reckoning",
    ]  # fmt: skip
    assert [name for environment, name in chosen if environment == SEGOROGENI] == ["enkf", "ekf", "dead-reckoning"]
    for (environment, _), cell in chosen.items():
        assert cell.arguments["environment"] == environment
        assert cell.arguments["seed"] == 0
        assert cell.arguments["options"]["disturbance"] == "moderate"


@pytest.mark.slow
@pytest.mark.parametrize("environment", [CORVETTE, SEGOROGENI, "ItsunusaAUV-v0", "PunaUAV-v0"])
def test_an_example_holds_thin_tracks_that_begin_together_and_errors_within_reason(environment):
    shown = flown(environment, "ekf")
    tracks = {kind: np.array(track) for kind, track in shown["tracks"].items()}
    assert set(tracks) == {"commanded", "true", "believed"}
    for track in (*tracks.values(), shown["time"], shown["error"], shown["two_sigma"]):
        assert 2 <= len(track) <= POINTS
        assert np.isfinite(track).all()
    size = np.ptp(tracks["true"], axis=0).max()
    assert np.ptp([track[0] for track in tracks.values()], axis=0).max() < 0.05 * size
    assert np.abs(np.array(shown["error"])).max() < 5.0 * np.max(shown["two_sigma"])
    ends = tracks["true"][-1] - tracks["commanded"][-1] if environment != CORVETTE else np.zeros(2)
    assert np.abs(ends).max() < 0.1 * size  # on a filter, in calm water or air, the goal is reached
    json.dumps([shown["end"], shown["score"], shown["what"], shown["unit"], shown["axes"], shown["down"]])


@pytest.mark.slow
def test_across_the_path_the_error_is_no_longer_than_that_of_the_position():
    shown = flown(SEGOROGENI, "ekf")
    apart = np.linalg.norm(np.subtract(shown["tracks"]["true"], shown["tracks"]["believed"]), axis=1)
    assert np.all(np.abs(shown["error"]) <= apart + 1e-9)
    assert np.max(np.abs(shown["error"])) > 0.2 * apart.max()


@pytest.mark.slow
def test_what_claims_no_covariance_has_no_band():
    assert flown(CORVETTE, "measurement")["two_sigma"] is None
    truth = flown(CORVETTE, "truth")
    assert truth["two_sigma"] is None
    assert np.abs(truth["error"]).max() < 1e-9


@pytest.mark.slow
def test_of_an_unknown_task_the_first_component_is_shown():
    episode = rollout("autopilot", "ThesisCorvette-v0", [0], {"estimator": "kf-umv-ui"})
    shown = _unknown(episode)
    assert shown["tracks"] == {}
    rms = np.sqrt(np.mean(np.square(shown["error"])))
    assert rms == pytest.approx(float(scores(episode)["sway_rmse"][0]), rel=0.2)  # thinned
