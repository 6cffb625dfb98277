"""The contract that every registered environment keeps, whatever its vehicle and task."""

import re
from copy import deepcopy
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    CARRIED,
    ENVIRONMENTS,
    FEW_MEMBERS,
    MANUALS,
    MODES,
    REFUSED,
    SPREAD,
    assert_apart,
    assert_same_tree,
    assert_sound,
    every_environment,
    make_batch,
    make_core,
    observations,
    observations_when_truth_is_altered,
    random_walk,
    replayed,
    single_class,
)
from gymnasium.utils.env_checker import check_env
from refusals import refused
from test_autoreset import EXACT

from vessel_gym.sensors import SUITES, in_quality
from vessel_gym.tasks.track import Track

ROOT = Path(__file__).parents[2]


def at_sea(env_id: str) -> bool:
    """Whether it is about a ship on a track, which takes a hundred steps to lose."""
    return isinstance(single_class(env_id).system.task, Track)


every_pair = pytest.mark.parametrize(("env_id", "estimator"), CARRIED)
every_estimator = pytest.mark.parametrize(("env_id", "estimator"), SPREAD)
every_estimator_and_mode = pytest.mark.parametrize(
    ("env_id", "estimator", "observe"),
    [(*pair, "mean+std") for pair in SPREAD]
    + [
        (key, single_class(key).system.estimator, mode)
        for key in ENVIRONMENTS
        for mode in ("mean", "measurement")
    ],
)


# --- the checkers of others -----------------------------------------------------------------------


@every_estimator_and_mode
def test_gymnasium_and_stable_baselines3_find_nothing_to_warn_of(
    env_id: str, estimator: str, observe: str
):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = gym.make(env_id, estimator=estimator, observe=observe)
    checker.check_env(env.unwrapped, warn=True)
    checker.check_env(env, warn=True)  # as users hand it over: with Gymnasium's wrappers
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.slow
@every_environment
def test_gymnasium_finds_nothing_to_warn_of_in_the_pictures(
    env_id: str, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    check_env(gym.make(env_id, render_mode="rgb_array").unwrapped)


@pytest.mark.parametrize(
    ("env_id", "estimator"), [(key, name) for key, names in REFUSED.items() for name in names]
)
def test_filter_without_its_model_is_refused_with_condition(env_id: str, estimator: str):
    with refused(ValueError, f"{estimator} needs .*{REFUSED[env_id][estimator]}"):
        gym.make(env_id, estimator=estimator)


# --- one batch, many single environments ----------------------------------------------------------


@every_environment
def test_a_list_of_seeds_seeds_each_environment(env_id: str):
    seeds = [5, 900_000, 5, 2**40]
    batch, singles = make_batch(env_id, len(seeds)), [gym.make(env_id) for _ in seeds]
    for given in (seeds, np.array(seeds), None):
        observations, _ = batch.reset(seed=given)
        for i, env in enumerate(singles):
            expected, _ = env.reset(seed=None if given is None else seeds[i])
            assert_same_tree(observations[i], expected, f"first observation of row {i}", EXACT)


@every_environment
def test_environments_that_nobody_seeded_differ(env_id: str):
    batch = make_batch(env_id, 3)
    first, _ = batch.reset()
    again, _ = make_batch(env_id, 3).reset()
    assert len(np.unique(np.concatenate([first, again]), axis=0)) == 6


# --- truth never reaches an observation -----------------------------------------------------------


@pytest.mark.parametrize(("env_id", "estimator"), [pair for pair in SPREAD if pair[1] != "truth"])
def test_observation_does_not_leak_truth(env_id: str, estimator: str):
    few = FEW_MEMBERS.get(estimator)
    one, other, distance = observations_when_truth_is_altered(
        env_id, estimator=estimator, estimator_options=few, sensors="degraded"
    )
    assert_apart(distance)
    for mode in MODES:
        np.testing.assert_array_equal(one[mode], other[mode], err_msg=mode)
        assert (np.ptp(one[mode], axis=0)[:, :2].max(0) > 0.1).all(), (
            mode
        )  # and there was something to see


@pytest.mark.slow
@every_environment
@pytest.mark.parametrize(
    "options",
    [
        {"observe": "measurement", "estimator": "truth"},
        {"observe": "measurement", "estimator": "truth", "guidance": True},
        {"guidance": False},
    ],
    ids=["raw beside the oracle", "guided by measurements", "unguided"],
)
def test_guidance_and_ends_do_not_leak_truth(env_id: str, options: dict[str, Any]):
    one, other, distance = observations_when_truth_is_altered(env_id, sensors="degraded", **options)
    assert_apart(distance)
    for mode, seen in one.items():
        np.testing.assert_array_equal(seen, other[mode], err_msg=mode)
        assert (np.ptp(seen, axis=0)[:, :2] > 0.01).all(), mode


@every_environment
def test_a_belief_follows_without_the_truth_in_the_record(env_id: str):
    core = make_core(env_id, 2)
    core.start(0)
    before, now = core.now, core.step(np.full(core.action_shape, 0.1))
    truth = "state actuators slow noise exogenous noise_before exogenous_before parameters"
    blind = now.but(belief=before.belief, **dict.fromkeys(truth.split()))
    core.config.estimators[0].step(blind)
    np.testing.assert_array_equal(blind.belief.mean, now.belief.mean)


# --- what comes out -------------------------------------------------------------------------------


def scribble(tree: Any) -> None:
    """Overwrite every array in a tree with nonsense."""
    if isinstance(tree, dict):
        for value in tree.values():
            scribble(value)
    elif isinstance(tree, np.ndarray) and tree.dtype == object:
        for value in tree:
            scribble(value)
    elif isinstance(tree, np.ndarray) and tree.ndim:
        assert tree.flags.writeable
        tree[...] = ~tree if tree.dtype == bool else 77


@pytest.mark.slow
@every_estimator
@pytest.mark.parametrize("rows", [None, 3], ids=["single", "batch"])
def test_results_are_the_caller_s_own(env_id: str, estimator: str, rows: int | None):
    """They do not change later, and writing to them changes no later step."""
    options = {"estimator": estimator, "estimator_options": FEW_MEMBERS.get(estimator)}
    options |= {"sensors": "degraded", "observe": "mean+std", "max_episode_steps": 30}

    def fly(vandal: bool) -> list[Any]:
        env: Any = make_batch(env_id, rows, **options) if rows else gym.make(env_id, **options)
        out, record = env.reset(seed=1), []
        walk = random_walk(1, rows or 1, env.unwrapped.core.config.action_size)
        for _ in range(50):
            record.append(deepcopy(out) if vandal else out)
            actions = next(walk) if rows else next(walk)[0]
            if vandal:
                for part in (*out, env.unwrapped.truth):
                    scribble(part)
            ended = not rows and len(out) > 2 and (record[-1][2] or record[-1][3])
            out = env.reset() if ended else env.step(actions)
            if vandal:
                scribble(actions)
        return record

    for step, (one, other) in enumerate(zip(fly(False), fly(True), strict=True)):
        assert_same_tree(one, other, f"step {step}")


@every_environment
def test_info_holds_the_truth_that_the_environment_holds(env_id: str):
    for env in (make_batch(env_id, 3).unwrapped, gym.make(env_id).unwrapped):
        _, info = env.reset(seed=0)
        np.testing.assert_array_equal(info["truth"], env.truth)
    config, now = env.core.config, env.core.now
    column = dict(zip(config.true_state.names, info["truth"], strict=True))
    disturbance, vehicle = config.world.disturbance, config.system.vehicle
    slow = *disturbance.names, *config.sensors.bias_names
    for names, values in ((vehicle.state_names, now.state), (slow, now.slow)):
        for name, value in zip(names, values[0], strict=True):
            assert column.get(name, value) == value, name
    assert {*vehicle.state_names, *config.sensors.bias_names} <= column.keys()
    assert disturbance.assumed_as != "states" or {*disturbance.names} <= column.keys()


@every_environment
@pytest.mark.parametrize("mismatch", [0.0, 0.2])
def test_info_holds_the_parameters_of_an_episode_s_truth(env_id: str, mismatch: float):
    vehicle = single_class(env_id).system.vehicle
    nominal = vehicle.parameters(0.0, np.zeros((1, vehicle.normals)))[0]
    batch, episodes = make_batch(env_id, 3, mismatch=mismatch), []
    for seed in (5, None):
        drawn = batch.reset(seed=seed)[1]["parameters"]
        info = batch.step(np.zeros(batch.action_space.shape))[4]
        np.testing.assert_array_equal(info["parameters"], drawn)
        np.testing.assert_array_equal(drawn, batch.unwrapped.core.now.parameters)
        assert info["_parameters"].all()
        episodes.extend(drawn)
    assert len(np.unique(episodes, axis=0)) == (6 if mismatch else 1)
    assert mismatch or np.array_equal(episodes[0], nominal)


@pytest.mark.parametrize("env_id", MANUALS)
def test_the_docstring_says_what_every_key_of_info_is(env_id: str):
    table = single_class(env_id).__doc__.split("## Information")[1].split("## Arguments")[0]
    listed = re.findall(r"^- ``(\w+)``:", table, re.MULTILINE)
    assert sorted(listed) == sorted([*gym.make(env_id).reset(seed=0)[1], "sensor_faults"])


@pytest.mark.slow
@every_environment
def test_score_is_sum_of_rewards_over_that_of_perfect_episode(env_id: str):
    env = make_batch(env_id, 5, disturbance="rough")
    task = env.unwrapped.core.config.system.task
    assert (
        task.horizon <= gym.spec(env_id).max_episode_steps
    )  # of any vehicle: room for the longest
    total = np.zeros(5)
    env.reset(seed=2)
    walk = random_walk(2, 5, env.single_action_space.shape[0])
    ended = 0
    for _ in range(200):
        _, reward, terminated, truncated, info = env.step(next(walk))
        total += reward
        done = terminated | truncated
        if done.any():
            score = info["final_info"]["score"][done]
            np.testing.assert_allclose(score, total[done] / task.perfect, rtol=0, atol=1e-12)
            total[done] = 0.0
            ended += int(done.sum())
        np.testing.assert_allclose(info["score"], total / task.perfect, rtol=0, atol=1e-12)
    assert ended >= 3


# --- robustness -----------------------------------------------------------------------------------


@pytest.mark.slow
@every_environment
@pytest.mark.parametrize("steps", [2_000, pytest.param(28_000, marks=pytest.mark.nightly)])
def test_random_actions_leave_everything_finite_and_in_bounds(env_id: str, steps: int):
    """About so many steps over every estimator and suite; sea and mode of observation take turns."""
    nominal = single_class(env_id).system.nominal_sensors
    worst = in_quality(nominal, dropout=0.7, outliers=0.2)  # long gaps and absurd measurements
    broken = [replace(each, outlier_scale=1e4) for each in worst]
    names, seas = (
        [name for key, name in CARRIED if key == env_id],
        single_class(env_id).system.disturbances,
    )
    combinations = list(product(names, (*SUITES, broken)))[:: 5 if steps < 10_000 else 1]
    for i, (name, suite) in enumerate(combinations):
        env = make_batch(
            env_id, 4, estimator=name, estimator_options=FEW_MEMBERS.get(name), sensors=suite, mismatch=0.25 * (i % 2),
            disturbance=list(seas)[i % len(seas)], observe=MODES[i // len(seas) % len(MODES)],
        )  # fmt: skip
        core = env.unwrapped.core
        assert_sound(core, env.reset(seed=i)[0], None, core.info())
        walk = random_walk(i, 4, core.config.action_size)
        for _ in range(steps // len(combinations) // 4 + 1):
            observation, reward, _, _, info = env.step(next(walk))
            assert_sound(core, observation, reward, info)
            if "final_info" in info:
                final = np.stack(list(info["final_obs"][info["_final_obs"]]))
                assert_sound(core, final, None, info["final_info"])


ABSURD = np.array([0.0, 1e300, -1e300, 5e-324])
"""A value for each row; the first row's does not arrive."""


@pytest.mark.slow
@every_pair
def test_absurd_measurements_leave_everything_finite(env_id: str, estimator: str):
    rows = len(ABSURD)
    core = make_core(
        env_id, rows, estimator=estimator, estimator_options=FEW_MEMBERS.get(estimator)
    )

    def check(reward: np.ndarray | None) -> None:
        info = core.info()
        for observation in observations(core).values():
            assert_sound(core, observation, reward, info)

    p = core.config.sensors.size
    absurd = (
        np.repeat(ABSURD[:, None], p, axis=1),
        np.repeat(np.arange(rows)[:, None] > 0, p, axis=1),
    )
    rng, sampled, replay = np.random.default_rng(1), core.config.delivery, replayed(core)
    replay.given = *absurd, None
    core.start(1)
    check(None)
    walk = random_walk(1, rows, core.config.action_size)
    for step in range(65):
        # For 25 steps every measurement is absurd, then some, then none.
        chosen, now = rng.random((rows, p)) < (1.0 if step < 25 else 0.3), core.now
        biases = now.slow[:, core.config.world.size :]
        nominal = core.config.sensors.exact(now.state, now.exogenous, biases)
        replay.given = np.where(chosen, absurd[0], nominal), np.where(chosen, absurd[1], True), None
        if step == 50:
            core.config.delivery = sampled
        check(core.step(next(walk)).reward)


@pytest.mark.slow
@every_pair
def test_diverged_estimate_leaves_everything_finite(env_id: str, estimator: str):
    scales = np.array([1e3, 1e30, 1e150, 1e300])[:, None]  # one for each row
    few = FEW_MEMBERS.get(estimator)
    options = {
        "estimator": estimator,
        "estimator_options": few,
        "observe": "mean+std",
        "sensors": "degraded",
    }
    core = make_core(env_id, 4, **options)
    core.start(3)
    walk = random_walk(3, 4, core.config.action_size)
    for step in range(50):
        if step == 10:
            core.now.belief = core.now.belief.replace(mean=scales * (core.now.belief.mean + 1.0))
        reward = core.step(next(walk)).reward
        assert_sound(core, core.observe(), reward, core.info())
