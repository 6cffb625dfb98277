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

from estimators.kalman import ExtendedKalmanFilter
from vessel_gym.models.estimation import estimator_names
from vessel_gym.sensors import SUITE_NAMES
from vessel_gym.simulation.configuration import OBSERVE

SHIP, AUV = "SigmaCorvette-v0", "SegorogeniAUV-v0"


# --- options of an environment --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "wrong", "kind"),
    [
        ("estimator", "kalman", ValueError), ("estimator", ["ekf"], ValueError), ("sensors", "perfect", ValueError),
        ("sensors", {"nominal": 1}, TypeError), ("disturbance", "Rough", ValueError), ("disturbance", None, TypeError),
        ("observe", "truth", ValueError),
    ],
)  # fmt: skip
def test_an_unknown_name_is_answered_with_those_that_exist(
    option: str, wrong: Any, kind: type[Exception]
):
    known = {
        "estimator": [name for name in estimator_names() if name not in REFUSED.get(SHIP, {})],
        "sensors": SUITE_NAMES, "disturbance": single_class(SHIP).system.disturbances, "observe": OBSERVE,
    }[option]  # fmt: skip
    message = refusal(kind, gym.make, SHIP, **{option: wrong})
    assert repr(wrong) in message
    for name in known:
        assert name in message


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_an_unknown_argument_is_answered_in_pythons_words(make: Any):
    """Libraries that try an argument go on without it where they read these words."""
    with pytest.raises(
        TypeError, match=r"^\w+Env.__init__\(\) got an unexpected keyword argument 'frameskip': ch"
    ):
        make(SHIP, frameskip=1)


def test_no_estimator_is_offered_that_refuses_the_vehicle():
    message = refusal(ValueError, gym.make, AUV, estimator="kf-umv-u")
    listed, endings = re.search(
        r"choose from (.*); a filter's name may end in (.*)", message
    ).groups()
    offered = [*re.findall(r"did you mean '(.*?)'", message), *listed.split(", ")]
    assert "-waves" in endings
    assert not set(offered) & set(REFUSED[AUV])
    assert set(offered) <= set(estimator_names())
    assert "did you mean 'kf-umv-ui'?" in refusal(ValueError, gym.make, SHIP, estimator="kf-umv-u")


@pytest.mark.parametrize(
    ("options", "kind", "sentence"),
    [
        ({"render_mode": "ascii"}, ValueError, "'ascii'.*human.*rgb_array"),
        ({"sensor": "clean", "estimator": "nonsense"}, TypeError,
         r"unexpected keyword argument 'sensor' \(did you mean 'sensors'\?\): choose from .*estimator"),
        ({"estimator": lambda model: "no filter"}, TypeError, "^estimator must return an estimators.Filter, got str"),
        ({"estimator": dict}, TypeError, "^estimator must be a name, a Filter class or a .*got <class 'dict'>"),
        ({"estimator_options": ["members"]}, TypeError,
         r"estimator_options must be a dictionary of values by name, or None, got \['members'\]"),
        ({"estimator": "ekf", "estimator_options": {"gain": 1.0}}, TypeError,
         "^ekf has no option 'gain': it takes "),
        ({"estimator": "truth", "estimator_options": {"gain": 1.0}}, TypeError,
         "^truth has no option 'gain': it takes "),
        ({"estimator": "enkf", "estimator_options": {"members": 1}}, ValueError,
         "members must be a whole number of at least 2"),
        ({"estimator": "kf", "estimator_options": {"model": "perfect"}}, ValueError,
         "unknown filter model 'perfect': choose from nonlinear, linear"),
        ({"estimator": "kf", "estimator_options": {"model": "nonlinear"}}, ValueError, "^kf needs a LinearModel"),
        ({"estimator": ExtendedKalmanFilter, "estimator_options": {"model": None}}, TypeError,
         "model must be the name of a filter model"),
        *(({"mismatch": wrong}, ValueError, f"^mismatch must be between 0 and 0.25, got {re.escape(repr(wrong))}$")
          for wrong in (-0.01, 0.41, np.nan, "0.1", True)),
    ],
)  # fmt: skip
def test_an_option_that_makes_no_sense_is_refused_in_a_sentence(
    options: dict[str, Any], kind: type[Exception], sentence: str
):
    assert re.search(sentence, refusal(kind, single_class(SHIP), **options))


def test_a_filter_that_is_built_already_is_refused():
    built = single_class(SHIP)().core.config.estimation.filter
    message = refusal(TypeError, gym.make, SHIP, estimator=built)
    assert f"got an instance of {type(built).__name__}" in message


def test_estimator_options_that_were_passed_are_not_changed():
    passed = {"input_cov": 1e-4, "assume": {"as": "unknown-input"}, "model": "linear"}
    before = deepcopy(passed)
    gym.make(SHIP, estimator="kf", estimator_options=passed)
    assert passed == before


@pytest.mark.parametrize("name", ["num_envs", "max_episode_steps"])
@pytest.mark.parametrize("wrong", [0, -1, 2.5, True, "3"], ids=repr)
def test_a_count_that_is_no_positive_whole_number_is_refused(name: str, wrong: Any):
    message = refusal(ValueError, make_batch, SHIP, **({"num_envs": 2} | {name: wrong}))
    assert f"{name} must be" in message
    assert repr(wrong) in message


# --- resets ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong", [-1, 1.5, "7", True, [1, 2], [1, -2, 3], [1, None, 3], np.ones(3)], ids=repr
)
def test_a_wrong_seed_is_refused_and_the_old_one_stands(wrong: Any):
    env, twin = make_batch(SHIP, 3), make_batch(SHIP, 3)
    env.reset(seed=1)
    twin.reset(seed=1)
    message = refusal(ValueError, env.reset, seed=wrong)
    assert "seed" in message
    if isinstance(wrong, list) and len(wrong) == 2:
        assert message == "got 2 seeds for 3 environments"
    assert_same_tree(env.reset(), twin.reset())


def test_any_whole_number_is_a_seed_of_either_face():
    batch, single = make_batch(SHIP, 1), gym.make(SHIP)
    for seed in (np.int64(7), np.uint8(7), np.array(7)):
        assert_same_tree(batch.reset(seed=seed), batch.reset(seed=7))
    assert_same_tree(single.reset(seed=np.int64(7)), single.reset(seed=7))
    for seed in (2**32 + 7, 2**200):
        assert (single.reset(seed=seed)[0] != single.reset(seed=7)[0]).any()


@pytest.mark.parametrize(
    ("env_id", "options", "kind", "sentence"),
    [
        (SHIP, {"speed": 3.0}, ValueError, "unknown reset option 'speed': choose from "),
        (SHIP, [1], TypeError, "options must be a dictionary of values by name, or None, got [1]"),
        (SHIP, {"radius": 10.0}, ValueError, "radius must be 253 to 100000 m to either side, got 10.0"),
        (AUV, {"goal": (1e7, 0.0, 1.0)}, ValueError, "goal must be three numbers within +-100000, "),
    ],
)  # fmt: skip
def test_a_refused_reset_says_why_and_changes_nothing(
    env_id: str, options: Any, kind: type[Exception], sentence: str
):
    env, twin = make_batch(env_id, 2), make_batch(env_id, 2)
    for one in (env, twin):
        one.reset(seed=1)
    assert refusal(kind, env.reset, seed=9, options=options).startswith(sentence)
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
