"""Bad input: one clear sentence where it enters, and nothing half done.

Each validator is tested once: options on one environment, in one of its two faces; `test_fuzz.py`
tries all of them.
"""

import re
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import REFUSED, assert_same_tree, make_batch, random_walk, single_class
from refusals import refusal

from vessel_gym.models.estimation import estimator_names
from vessel_gym.sensors import SUITE_NAMES
from vessel_gym.simulation.configuration import OBSERVE

SHIP, AUV = "SigmaCorvette-v0", "SegorogeniAUV-v0"


# --- options of an environment --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "wrong", "known"),
    [("estimator", "kalman", estimator_names()), ("sensors", "perfect", SUITE_NAMES),
     ("disturbance", "Rough", single_class(SHIP).system.disturbances), ("observe", "truth", OBSERVE)],
)  # fmt: skip
def test_an_unknown_name_is_answered_with_those_that_exist(option: str, wrong: str, known: Any):
    message = refusal(ValueError, gym.make, SHIP, **{option: wrong})
    assert repr(wrong) in message
    for name in set(known) - set(REFUSED.get(SHIP, {})):
        assert name in message


def test_an_unknown_estimator_is_answered_with_all_names():
    message = refusal(ValueError, gym.make, SHIP, estimator="kf-umv-u")
    listed, endings = re.search(
        r"choose from (.*); a filter's name may end in (.*)", message
    ).groups()
    assert "-waves" in endings
    assert listed.split(", ") == [*estimator_names()]
    assert "did you mean 'kf-umv-ui'?" in message


@pytest.mark.parametrize(
    ("options", "kind", "sentence"),
    [
        ({"sensor": "clean", "estimator": "nonsense"}, TypeError,
         r"unexpected keyword argument 'sensor' \(did you mean 'sensors'\?\): choose from .*estimator"),
        ({"estimator": lambda model: "no filter"}, TypeError, "^estimator must return an estimators.Filter, got str"),
        ({"estimator": "truth", "estimator_options": {"gain": 1.0}}, TypeError,
         "^truth has no option 'gain': it takes "),
        ({"estimator": "kf", "estimator_options": {"model": "perfect"}}, ValueError,
         "unknown filter model 'perfect': choose from nonlinear, linear"),
    ],
)  # fmt: skip
def test_an_option_that_makes_no_sense_is_refused_in_a_sentence(
    options: dict[str, Any], kind: type[Exception], sentence: str
):
    assert re.search(sentence, refusal(kind, single_class(SHIP), **options))


def test_estimator_options_that_were_passed_are_not_changed():
    passed = {"input_cov": 1e-4, "assume": {"as": "unknown-input"}, "model": "linear"}
    before = deepcopy(passed)
    gym.make(SHIP, estimator="kf", estimator_options=passed)
    assert passed == before


# --- resets ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"seed": -1}, "seeds must be "), ({"seed": True}, "seed must be "),
        ({"seed": [1, 2, 3]}, "got 3 seeds for 2 environments$"), ({"seed": [1, None]}, "seeds must be "),
        ({"options": {"speed": 3.0}}, "unknown reset option 'speed': choose from "),
    ],
)  # fmt: skip
def test_a_refused_reset_says_why_and_changes_nothing(wrong: dict[str, Any], sentence: str):
    env, twin = make_batch(SHIP, 2), make_batch(SHIP, 2)
    for one in (env, twin):
        one.reset(seed=1)
    assert re.match(sentence, refusal(ValueError, env.reset, **{"seed": 9} | wrong))
    actions = next(random_walk(0, 2, env.single_action_space.shape[0]))
    assert_same_tree(env.step(actions), twin.step(actions))
    assert_same_tree(env.reset(), twin.reset())


# --- steps ----------------------------------------------------------------------------------------


def test_an_action_beyond_its_bounds_is_clipped_as_documented():
    one, other = make_batch(AUV, 2), make_batch(AUV, 2)
    one.reset(seed=0)
    other.reset(seed=0)
    full = np.ones(one.action_space.shape)
    for _ in range(5):
        assert_same_tree(one.step(1e30 * full), other.step(full))


def test_what_comes_before_the_first_reset_says_what_to_do():
    expected = (gym.error.ResetNeeded, RuntimeError, ValueError)
    for env, shape in (
        (gym.make(AUV), (3,)),
        (single_class(AUV)(), (3,)),
        (make_batch(AUV, 2), (2, 3)),
    ):
        assert "reset" in refusal(expected, env.step, np.zeros(shape, np.float32))
        assert "reset" in refusal(expected, lambda env=env: env.unwrapped.truth)
