"""Bad input: one clear sentence where it enters, and nothing half done."""

import re
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    BLIND,
    CARRIED,
    ENVIRONMENTS,
    REFUSED,
    assert_same_tree,
    make_batch,
    make_core,
    random_walk,
    single_class,
    some_environments,
)
from refusals import refusal

from estimators.kalman import ExtendedKalmanFilter
from vessel_gym.configuration import OBSERVE
from vessel_gym.estimation import estimator_names
from vessel_gym.sensors import SUITE_NAMES
from vessel_gym.tasks.dive import Dive


def refusals_to_make(env_id: str, expected: type[Exception], **options: Any) -> list[str]:
    """What both faces say to the same constructor options."""
    single = refusal(expected, gym.make, env_id, **options)
    batch = refusal(expected, gym.make_vec, env_id, num_envs=2, **options)
    return [single, batch]


# --- names ------------------------------------------------------------------------------------------


@pytest.mark.slow
@some_environments
@pytest.mark.parametrize(
    ("option", "wrong"),
    [
        ("estimator", "kalman"), ("estimator", ""), ("estimator", 3), ("sensors", "perfect"), ("sensors", ""),
        ("sensors", None), ("sensors", 3), ("sensors", ["nominal"]), ("sensors", []), ("sensors", {"nominal": 1}),
        ("sensors", np.zeros(2)),
        ("disturbance", "hurricane"), ("disturbance", "Rough"), ("disturbance", {}), ("disturbance", None),
        ("disturbance", ["calm"]), ("observe", "truth"), ("observe", ["mean"]), ("estimator", ["ekf"]),
    ],
)  # fmt: skip
def test_an_unknown_name_is_answered_with_those_that_exist(env_id: str, option: str, wrong: Any):
    system = single_class(env_id).system
    known = {
        "estimator": [name for name in estimator_names() if name not in REFUSED.get(env_id, {})],
        "sensors": SUITE_NAMES, "disturbance": system.disturbances, "observe": OBSERVE,
    }[option]  # fmt: skip
    # what might have been an object of one's own is of the wrong type
    kind = TypeError if option in ("sensors", "disturbance") and not isinstance(wrong, str) else ValueError
    for message in refusals_to_make(env_id, kind, **{option: wrong}):
        assert repr(wrong) in message
        for name in known:
            assert name in message


@some_environments
def test_a_name_that_is_nearly_right_is_answered_with_the_one_that_was_meant(env_id: str):
    for message in refusals_to_make(env_id, ValueError, estimator="enkfsr"):
        assert "did you mean 'enkf-sr'?" in message


@pytest.mark.slow
@some_environments
@pytest.mark.parametrize("wrong", ["kf-umv", "kf-umv-iu", "kf-umv-ui-wd", "ulis", "ekf-ui", "k"])
def test_no_estimator_is_offered_that_refuses_the_vehicle(env_id: str, wrong: str):
    for message in refusals_to_make(env_id, ValueError, estimator=wrong):
        offered = re.findall(r"did you mean '(.*?)'", message) + message.split("choose from ")[1].split(", ")
        assert not set(offered) & set(REFUSED.get(env_id, {}))
        assert set(offered) <= set(estimator_names())


def test_the_corvette_is_still_offered_the_filter_that_it_carries():
    for message in refusals_to_make("SigmaCorvette-v0", ValueError, estimator="kf-umv-u"):
        assert "did you mean 'kf-umv-ui'?" in message


@some_environments
def test_an_unknown_render_mode_is_answered_with_those_that_exist(env_id: str):
    message = refusal(ValueError, single_class(env_id), render_mode="ascii")
    for name in ("'ascii'", "human", "rgb_array"):
        assert name in message


@some_environments
def test_an_argument_that_the_environment_does_not_have_is_answered_with_those_that_it_has(env_id: str):
    for message in refusals_to_make(env_id, TypeError, sensor="clean", estimator="nonsense"):
        assert message.startswith(f"unknown argument of {env_id} 'sensor' (did you mean 'sensors'?): choose from ")
        for name in ("estimator", "estimator_options", "sensors", "disturbance", "mismatch", "observe"):
            assert name in message
        assert "others" not in message


# --- estimators -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("env_id", "estimator"), [case for case in BLIND if case[1] != "ekf"])
def test_an_unknown_estimator_option_is_named_and_answered_with_those_that_exist(env_id: str, estimator: str):
    for message in refusals_to_make(env_id, TypeError, estimator=estimator, estimator_options={"gain": 1.0}):
        assert message.startswith(f"{estimator} has no option 'gain': it takes ")


@some_environments
@pytest.mark.parametrize("estimator", ["truth", "ekf"])
def test_an_option_of_an_estimator_without_any_is_named(env_id: str, estimator: str):
    for message in refusals_to_make(env_id, TypeError, estimator=estimator, estimator_options={"gain": 1.0}):
        assert message.startswith(f"{estimator} has no option 'gain': it takes ")


BAD_VALUES = {
    "kf-umv-ui": ("input_prior", -1.0, "positive semidefinite"),
    "ukf": ("alpha", 0.0, "positive"),
    "enkf": ("members", 1, "a whole number of at least 2"),
    "robust-kf": ("radius", -1.0, "finite and not negative"),
}


@pytest.mark.parametrize(("env_id", "estimator"), [case for case in CARRIED if case[1] in BAD_VALUES])
def test_a_bad_value_of_an_estimator_option_is_named(env_id: str, estimator: str):
    option, value, law = BAD_VALUES[estimator]
    for message in refusals_to_make(env_id, ValueError, estimator=estimator, estimator_options={option: value}):
        assert f"{option} must be {law}" in message


@some_environments
def test_an_unknown_filter_model_is_answered_with_those_that_exist(env_id: str):
    system = single_class(env_id).system
    options = {"estimator": "kf", "estimator_options": {"model": "perfect"}}
    for message in refusals_to_make(env_id, ValueError, **options):
        assert "unknown filter model 'perfect'" in message
        for name in {system.filter_model, *system.filter_models.values()}:
            assert name in message


@pytest.mark.parametrize("env_id", [env_id for env_id in ENVIRONMENTS if env_id != "ThesisCorvette-v0"])
@pytest.mark.parametrize("estimator", ["kf", "ulise"])
def test_a_linear_filter_refuses_a_nonlinear_model_by_name(env_id: str, estimator: str):
    options = {"estimator": estimator, "estimator_options": {"model": "nonlinear"}}
    for message in refusals_to_make(env_id, ValueError, **options):
        assert re.match(f"{estimator} needs a LinearModel", message)


GOOD_VALUES = {
    "kf": {"input_cov": 1e-4, "assume": {"as": "unknown-input"}},
    "ukf": {"alpha": 0.5},
    "enkf": {"members": 80},
}


@pytest.mark.parametrize(("env_id", "estimator"), [case for case in CARRIED if case[1] in GOOD_VALUES])
def test_estimator_options_that_were_passed_are_not_changed(env_id: str, estimator: str):
    system = single_class(env_id).system
    options = GOOD_VALUES[estimator] | {"model": system.filter_models.get(estimator, system.filter_model)}
    passed = deepcopy(options)
    gym.make(env_id, estimator=estimator, estimator_options=passed)
    assert passed == options


@some_environments
def test_a_function_that_builds_no_filter_is_refused(env_id: str):
    for message in refusals_to_make(env_id, TypeError, estimator=lambda model: "no filter"):
        assert message.startswith("estimator must return an estimators.Filter, got str")


@some_environments
@pytest.mark.parametrize("wrong", ["foo", ["members"], 3, 0, False, (), {3: 1.0}], ids=repr)
def test_estimator_options_that_are_no_dictionary_are_refused(env_id: str, wrong: Any):
    for message in refusals_to_make(env_id, TypeError, estimator_options=wrong):
        assert f"estimator_options must be a dictionary of values by name, or None, got {wrong!r}" in message


@some_environments
@pytest.mark.parametrize("wrong", [["nonlinear"], None, 3], ids=repr)
def test_a_filter_model_that_is_no_name_is_refused(env_id: str, wrong: Any):
    for estimator in ("ekf", ExtendedKalmanFilter):
        options = {"estimator": estimator, "estimator_options": {"model": wrong}}
        for message in refusals_to_make(env_id, TypeError, **options):
            assert "model must be the name of a filter model" in message


@some_environments
def test_a_filter_that_is_built_already_is_refused_and_so_is_a_class_that_is_no_filter(env_id: str):
    built = single_class(env_id)().core.filter
    for wrong, kind in ((built, f"an instance of {type(built).__name__}"), (dict, "<class 'dict'>")):
        for message in refusals_to_make(env_id, TypeError, estimator=wrong):
            assert message.startswith("estimator must be a name, a Filter class or a function of the model that ")
            assert f"got {kind}" in message


# --- numbers ----------------------------------------------------------------------------------------


@some_environments
@pytest.mark.parametrize("wrong", [-0.01, 0.41, np.nan, np.inf, "0.1", None, True, [0.1], 1e20, 1j], ids=str)
def test_a_mismatch_out_of_range_is_refused_with_the_range(env_id: str, wrong: Any):
    for message in refusals_to_make(env_id, ValueError, mismatch=wrong):
        assert message == f"mismatch must be between 0 and 0.25, got {wrong!r}"


@some_environments
@pytest.mark.parametrize("right", [0, 0.25, np.float64(0.2), np.float32(0.2), np.int64(0)], ids=repr)
def test_any_number_in_range_is_a_mismatch(env_id: str, right: Any):
    gym.make(env_id, mismatch=right).reset(seed=0)


@some_environments
@pytest.mark.parametrize("wrong", [0, -1, 2.5, 2.0, True, "3", None, np.nan], ids=repr)
def test_a_wrong_number_of_environments_is_refused(env_id: str, wrong: Any):
    message = refusal(ValueError, gym.make_vec, env_id, num_envs=wrong, vectorization_mode="vector_entry_point")
    assert message == f"num_envs must be a positive whole number, got {wrong!r}"


@some_environments
@pytest.mark.parametrize("wrong", [0, -5, 2.5, True, "60"], ids=repr)
def test_a_wrong_time_limit_is_refused(env_id: str, wrong: Any):
    message = refusal(ValueError, make_batch, env_id, 2, max_episode_steps=wrong)
    assert "max_episode_steps must be" in message
    assert repr(wrong) in message


# --- seeds ------------------------------------------------------------------------------------------


@pytest.mark.slow
@some_environments
@pytest.mark.parametrize("wrong", [-1, 1.5, "7", True, [1, 2], [1, 2, 3, 4], [1, -2, 3], [1, 2.5, 3], [1, "2", 3],
                                   [1, None, 3], [True, 2, 3], np.array([1.0, 2.0, 3.0])], ids=repr)  # fmt: skip
def test_a_wrong_seed_of_a_batch_is_refused_and_the_old_one_stands(env_id: str, wrong: Any):
    env, twin = make_batch(env_id, 3), make_batch(env_id, 3)
    env.reset(seed=1)
    twin.reset(seed=1)
    message = refusal(ValueError, env.reset, seed=wrong)
    assert "seed" in message
    if isinstance(wrong, list) and len(wrong) != 3:
        assert message == f"got {len(wrong)} seeds for 3 environments"
    actions = next(random_walk(0, 3, env.single_action_space.shape[0]))
    assert_same_tree(env.step(actions), twin.step(actions))
    assert_same_tree(env.reset(), twin.reset())


@pytest.mark.slow
@some_environments
@pytest.mark.parametrize("wrong", [-1, 1.5, "7", [1], True, np.array([1])], ids=repr)
def test_a_wrong_seed_of_a_single_environment_is_refused_and_the_old_one_stands(env_id: str, wrong: Any):
    env, twin = gym.make(env_id), gym.make(env_id)
    env.reset(seed=1)
    twin.reset(seed=1)
    assert refusal(ValueError, env.reset, seed=wrong).startswith("seed")
    assert_same_tree(env.reset(), twin.reset())
    assert env.unwrapped.np_random_seed == 1


@some_environments
def test_any_whole_number_is_a_seed_of_either_face(env_id: str):
    for seed in (np.int64(7), np.uint8(7), np.array(7)):
        batch = make_batch(env_id, 1)
        assert_same_tree(batch.reset(seed=seed), batch.reset(seed=7))
    single = gym.make(env_id)
    assert_same_tree(single.reset(seed=np.int64(7)), single.reset(seed=7))
    for seed in (2**32 + 7, 2**200):
        assert (single.reset(seed=seed)[0] != single.reset(seed=7)[0]).any()


# --- reset options ----------------------------------------------------------------------------------


@some_environments
def test_an_unknown_reset_option_is_named(env_id: str):
    for env in (gym.make(env_id), make_batch(env_id, 2)):
        message = refusal(ValueError, env.reset, seed=0, options={"speed": 3.0})
        assert message.startswith("unknown reset option 'speed'")
        assert ": choose from " in message or env_id == "Docking-v0"  # which has none


@some_environments
@pytest.mark.parametrize("wrong", [[1], "goal", 3, 0, {3: 1.0}], ids=repr)
def test_reset_options_that_are_no_dictionary_are_refused(env_id: str, wrong: Any):
    for env in (gym.make(env_id), make_batch(env_id, 2)):
        message = refusal(TypeError, env.reset, seed=0, options=wrong)
        assert message == f"options must be a dictionary of values by name, or None, got {wrong!r}"


@pytest.mark.parametrize(
    "env_id", [key for key in ENVIRONMENTS if "missed the goal" in single_class(key).system.task.end_reasons]
)
@pytest.mark.parametrize("far", [1e7, -1e7, 1e308, -1e308])
def test_a_goal_on_the_other_side_of_the_earth_is_refused_with_the_range(env_id: str, far: float):
    for goal in ((far, 0.0, 1.0), (1.0, far, far)):
        message = refusal(ValueError, gym.make(env_id).reset, seed=0, options={"goal": goal})
        assert message.startswith("goal must lie within 100000 m of the ")


def test_obstacles_and_radii_beyond_the_horizon_are_refused_with_the_range():
    for obstacle in ((1e7, 0.0, 50.0), (300.0, 0.0, 1e300)):
        message = refusal(ValueError, gym.make("PunaUAV-v0").reset, seed=0, options={"obstacles": [obstacle]})
        assert message.startswith("obstacles must lie within 100000 m of the origin")
    for radius in (1e7, -1e300):
        message = refusal(ValueError, gym.make("SigmaCorvette-v0").reset, seed=0, options={"radius": radius})
        assert message == f"radius must be at most 100000 m to either side, got {radius!r}"


@pytest.mark.parametrize("wrong", [0.0, 10.0, -200.0, np.nan, np.inf, -np.inf])
def test_a_radius_that_the_corvette_cannot_hold_is_refused_with_the_limit(wrong: float):
    for env in (gym.make("SigmaCorvette-v0"), make_batch("SigmaCorvette-v0", 2)):
        message = refusal(ValueError, env.reset, seed=0, options={"radius": wrong})
        assert message == f"radius must be at least 253 m to either side, got {wrong!r}"


@pytest.mark.parametrize("wrong", ["wide", None, [300.0, 400.0, 500.0]], ids=repr)
def test_a_radius_that_is_no_number_is_refused(wrong: Any):
    for env in (gym.make("SigmaCorvette-v0"), make_batch("SigmaCorvette-v0", 2)):
        assert "radius must be" in refusal(ValueError, env.reset, seed=0, options={"radius": wrong})


@pytest.mark.parametrize("env_id", [key for key in ENVIRONMENTS if isinstance(single_class(key).system.task, Dive)])
@pytest.mark.parametrize("wrong", ["deep", None, 3.0, [1.0, 2.0], [8.0, np.nan, 2.0], [[9.0, 0.0, 2.0]]], ids=repr)
def test_a_goal_that_is_no_place_is_refused(env_id: str, wrong: Any):
    for env in (gym.make(env_id), make_batch(env_id, 2)):
        message = refusal(ValueError, env.reset, seed=0, options={"goal": wrong})
        assert message == f"goal must be three finite numbers, metres north, east and down, got {wrong!r}"


@some_environments
@pytest.mark.parametrize("seed", [None, 9])
def test_a_refused_reset_changes_nothing(env_id: str, seed: int | None):
    env, twin = make_batch(env_id, 2), make_batch(env_id, 2)
    for one in (env, twin):
        one.reset(seed=1)
    refusal(ValueError, env.reset, seed=seed, options={"speed": 3.0})
    actions = next(random_walk(0, 2, env.single_action_space.shape[0]))
    assert_same_tree(env.step(actions), twin.step(actions))
    assert_same_tree(env.reset(), twin.reset())


# --- actions ----------------------------------------------------------------------------------------


@pytest.mark.slow
@some_environments
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_not_finite_is_refused_and_changes_nothing(env_id: str, value: float):
    for env, twin in (
        (gym.make(env_id, disable_env_checker=True), gym.make(env_id, disable_env_checker=True)),
        (make_batch(env_id, 3), make_batch(env_id, 3)),
    ):
        env.reset(seed=1)
        twin.reset(seed=1)
        action = np.zeros(env.action_space.shape, np.float32)
        bad = action.copy()
        bad.flat[-1] = value
        assert refusal(ValueError, env.unwrapped.step, bad) == "action must be finite, got NaN or infinity"
        assert_same_tree(env.step(action), twin.step(action))


@some_environments
def test_an_action_of_the_wrong_shape_is_refused_with_both_shapes(env_id: str):
    size = len(single_class(env_id).system.vehicle.action_names)
    single = single_class(env_id)()
    single.reset(seed=0)
    for shape in ((), (size + 1,), (1, size), (size, 2), (0,)):
        message = refusal(ValueError, single.step, np.zeros(shape))
        assert message == f"action has shape {shape}, expected {(size,)}"
    for rows in (1, 3):
        batch = make_batch(env_id, rows)
        batch.reset(seed=0)
        for shape in ((), (rows,), (rows + 1, size), (rows, size + 1), (size, rows, 1)):
            message = refusal(ValueError, batch.step, np.zeros(shape))
            assert message == f"action has shape {shape}, expected {(rows, size)}"


@pytest.mark.slow
@some_environments
@pytest.mark.parametrize(
    "wrong", ["hard to port", None, {"rudder": 1.0}, ["0.5"], [[1.0], [1.0, 2.0]], np.array([1j]), [None]], ids=repr
)
def test_an_action_that_is_no_array_of_numbers_is_refused(env_id: str, wrong: Any):
    for env in (single_class(env_id)(), make_batch(env_id, 2)):
        env.reset(seed=0)
        assert refusal(ValueError, env.step, wrong) == f"action must be an array of numbers, got {wrong!r}"


# --- injected measurements ------------------------------------------------------------------------------


@some_environments
def test_injected_measurements_of_the_wrong_form_are_refused_and_change_nothing(env_id: str):
    core, twin = make_core(env_id, 2), make_core(env_id, 2)
    core.reset()
    twin.reset()
    p, action = core.sensors.size, np.zeros((2, core.action_size))
    y, mask = np.zeros((2, p)), np.ones((2, p), bool)
    for wrong in (3, "y", y, (y,), (y, mask, mask), ("y", mask), (y, None)):
        assert refusal(TypeError, core.step, action, measurements=wrong).startswith("measurements must be two arrays")
        assert refusal(TypeError, core.reset, measurements=wrong).startswith("measurements must be two arrays")
    for wrong in ((y[:1], mask), (y, mask[:, 1:]), (y.T, mask.T) if p != 2 else (y[0], mask[0])):
        expected = f"measurements have the shapes {wrong[0].shape} and {wrong[1].shape}, expected {(2, p)} each"
        assert refusal(ValueError, core.step, action, measurements=wrong) == expected
        assert refusal(ValueError, core.reset, measurements=wrong) == expected
    for one in (core, twin):
        one.step(action)
    assert_same_tree(core.info(), twin.info())


@some_environments
def test_an_action_beyond_its_bounds_is_clipped_as_documented(env_id: str):
    one, other = make_batch(env_id, 2), make_batch(env_id, 2)
    one.reset(seed=0)
    other.reset(seed=0)
    full = np.ones(one.action_space.shape)
    for _ in range(5):
        assert_same_tree(one.step(1e30 * full), other.step(full))


# --- order of calls ---------------------------------------------------------------------------------


@some_environments
def test_a_step_before_the_first_reset_says_what_to_do(env_id: str):
    size = len(single_class(env_id).system.vehicle.action_names)
    expected = (gym.error.ResetNeeded, RuntimeError, ValueError)
    for env, shape in (
        (gym.make(env_id), (size,)), (single_class(env_id)(), (size,)), (make_batch(env_id, 2), (2, size)),
    ):  # fmt: skip
        assert "reset" in refusal(expected, env.step, np.zeros(shape, np.float32))


@some_environments
def test_reading_the_truth_before_the_first_reset_says_what_to_do(env_id: str):
    for env in (single_class(env_id)(), make_batch(env_id, 2)):
        assert "reset" in refusal((gym.error.ResetNeeded, RuntimeError, ValueError), lambda env=env: env.truth)
