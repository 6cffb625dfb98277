"""The contract that every registered environment keeps, whatever its vehicle and task."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    BROKEN,
    CARRIED,
    ENVIRONMENTS,
    FEW_MEMBERS,
    MANUALS,
    MODES,
    OURS,
    REFUSED,
    SPREAD,
    assert_apart,
    assert_same_tree,
    assert_sound,
    copy_tree,
    every_environment,
    make_batch,
    make_core,
    observations,
    observations_when_truth_is_altered,
    random_walk,
    silent,
    single_class,
    soak,
    vector_class,
)
from gymnasium.utils.env_checker import check_env
from refusals import refused
from test_autoreset import EXACT, ROUGH, assert_same_in_every_mode

from vessel_gym.sensors import SUITES
from vessel_gym.simulation.core import Core
from vessel_gym.simulation.world import World
from vessel_gym.tasks.track import Track

ROOT = Path(__file__).parents[2]
SOAK_STEPS = 28_000


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


@pytest.mark.slow
def test_gymnasium_makes_environments_without_package_import():
    program = f"""
import sys
import gymnasium
assert "vessel_gym" not in sys.modules
for env_id in {OURS}:
    env = gymnasium.make("vessel_gym:" + env_id)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    batch = gymnasium.make_vec("vessel_gym:" + env_id, num_envs=2, vectorization_mode="vector_entry_point")
    batch.reset(seed=0)
    batch.step(batch.action_space.sample())
for heavy in ("torch", "stable_baselines3", "pygame", "matplotlib", "agents"):
    assert heavy not in sys.modules, heavy
"""
    run = [sys.executable, "-W", "error", "-c", program]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""


# --- one batch, many single environments ----------------------------------------------------------


@pytest.mark.slow
@every_estimator
def test_row_i_of_batch_is_single_environment_seeded_s_plus_i(env_id: str, estimator: str):
    assert_same_in_every_mode(env_id, estimator, **ROUGH)


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
def test_a_second_reset_without_a_seed_begins_another_episode(env_id: str):
    one, other = gym.make(env_id), gym.make(env_id)
    first, _ = one.reset(seed=4)
    second, _ = one.reset()
    assert not np.array_equal(first, second)
    other.reset(seed=4)
    np.testing.assert_array_equal(second, other.reset()[0])
    np.testing.assert_array_equal(first, one.reset(seed=4)[0])


@every_environment
def test_environments_that_nobody_seeded_differ(env_id: str):
    batch = make_batch(env_id, 3)
    first, _ = batch.reset()
    again, _ = make_batch(env_id, 3).reset()
    assert len(np.unique(np.concatenate([first, again]), axis=0)) == 6


# --- swapping the estimator -----------------------------------------------------------------------


def fly_reacting(
    env_id: str, quiet: bool, steps: int, **options: Any
) -> dict[tuple, dict[str, np.ndarray]]:
    """Every episode ``(row, number)`` of a batch whose agent reacts to what it sees: what nature did in it."""
    cls = vector_class(env_id)
    rows = 6
    env = cls(num_envs=rows, max_episode_steps=75, autoreset_mode="SameStep", **options)
    if quiet:
        was = (
            env.core.config.world
        )  # which others share; the filter takes its sensors for what they were
        sensors = silent(env.core.config.sensors)
        env.core.config.world = World(was.forces, sensors)
        env.core._together = False  # a whole step's program has the sensors of the other world
    rng = np.random.default_rng(2)
    weights = rng.normal(
        0.0, 1.0, (rows, env.core.config.observation_size, env.core.config.action_size)
    )
    series: dict[tuple, dict[str, list[np.ndarray]]] = {}
    number = np.zeros(rows, int)

    def keep(row: int, info: dict[str, np.ndarray], **more: np.ndarray) -> None:
        episode = series.setdefault((row, int(number[row])), {})
        for key in ("unknown_input", "measurement", "available", "truth"):
            episode.setdefault(key, []).append(info[key][row])
        for key, value in more.items():
            episode.setdefault(key, []).append(value[row].copy())

    observations, info = env.reset(seed=8)
    for step in range(steps + 1):
        for row in range(rows):
            keep(row, info, slow=env.core.now.slow)
        if step == steps:
            break
        actions = np.tanh(np.einsum("bk,bka->ba", observations, weights)).astype(np.float32)
        observations, _, terminated, truncated, info = env.step(actions)
        for row in np.flatnonzero(terminated | truncated):
            keep(row, info["final_info"])
            number[row] += 1
    return {
        key: {name: np.stack(values) for name, values in episode.items()}
        for key, episode in series.items()
    }


@pytest.mark.slow
@every_environment
@pytest.mark.parametrize("quiet", [False, True], ids=["as it is", "with nothing to read but noise"])
def test_nature_is_equal_under_every_estimator(env_id: str, quiet: bool):
    names = [name for key, name in SPREAD if key == env_id]
    steps = 1200 if at_sea(env_id) else 320
    options = {"sensors": "degraded", "disturbance": "rough", "mismatch": 0.2, "steps": steps}
    # What a field of waves does to a ship depends on where she is, and not only on the waves.
    same = "unknown_input", "slow", "available", *(("measurement",) if quiet else ())
    same = same[at_sea(env_id) :]
    reference = fly_reacting(env_id, quiet, estimator=names[0], **options)
    elsewhere = 0
    for name in names[1:]:
        other = fly_reacting(
            env_id, quiet, estimator=name, estimator_options=FEW_MEMBERS.get(name), **options
        )
        common = set(reference) & set(other)
        lengths = np.array(
            [(len(reference[key]["truth"]), len(other[key]["truth"])) for key in sorted(common)]
        )
        # six rows, four episodes and more; the last of a row may have only begun
        assert (lengths.min(-1) > 1).sum() >= 6 * 4
        different = 0
        for key in common:
            one, two = reference[key], other[key]
            for what in same:
                k = min(len(one[what]), len(two[what]))
                np.testing.assert_array_equal(
                    one[what][:k], two[what][:k], err_msg=f"{what} with {name} in {key}"
                )
            k = min(len(one["truth"]), len(two["truth"]))
            different += not np.array_equal(one["truth"][:k], two["truth"][:k])
        assert different > len(common) / 2  # the agents did react to another estimator
        elsewhere += int((lengths[:, 0] != lengths[:, 1]).sum())
    # and episodes ended at other times, but for ships, most of which random agents keep until time
    # is up
    assert at_sea(env_id) or elsewhere > 3 * (len(names) - 1)


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


def test_a_leak_of_guidance_would_be_seen(monkeypatch: pytest.MonkeyPatch):
    """That leaks of estimates would be, the oracle shows."""

    def step(core: Core, *args: Any, **kwargs: Any) -> Any:
        now = honest(core, *args, **kwargs)
        mean, places = now.raw.mean.copy(), core.config.prior_index
        mean[:, : len(places)] = now.state[:, places]
        now.raw = now.raw.replace(mean=mean)
        return now

    honest = Core.step
    monkeypatch.setattr(Core, "step", step)
    options = {"observe": "measurement", "guidance": True}
    one, other, _ = observations_when_truth_is_altered("Usbl-v0", **options)
    assert (one["measurement"] != other["measurement"]).any(-1).mean() > 0.5


@every_environment
def test_the_oracle_alone_follows_the_altered_truth(env_id: str):
    one, other, _ = observations_when_truth_is_altered(
        env_id, estimator="truth", sensors="degraded"
    )
    for mode in ("mean", "mean+std"):
        assert (one[mode] != other[mode]).any(-1).all(), mode


@every_environment
def test_a_belief_follows_without_the_truth_in_the_record(env_id: str):
    core = make_core(env_id, 2, seed=0)
    core.reset()
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
        tree[...] = True if tree.dtype == bool else 77


@pytest.mark.slow
@every_estimator
def test_writing_to_results_changes_no_later_step(env_id: str, estimator: str):
    def fly(env: Any, vandal: bool) -> list[Any]:
        record = []
        out = env.reset(seed=1)
        walk = random_walk(1, batch_rows, env.unwrapped.core.config.action_size)
        for _ in range(50):
            record.append(copy_tree(out))
            if vandal:
                for part in out:
                    scribble(part)
                scribble(env.unwrapped.truth)
            actions = next(walk)[0] if batch_rows == 1 else next(walk)
            out = env.step(actions)
            if vandal:
                scribble(actions)
            if batch_rows == 1 and (out[2] or out[3]):
                record.append(copy_tree(out))
                out = env.reset()
        return record

    options = {"estimator": estimator, "estimator_options": FEW_MEMBERS.get(estimator)}
    options |= {"sensors": "degraded", "observe": "mean+std"}
    for batch_rows in (1, 3):
        envs = [
            (
                gym.make(env_id, **options)
                if batch_rows == 1
                else make_batch(env_id, batch_rows, **options)
            )
            for _ in range(2)
        ]
        one, other = fly(envs[0], False), fly(envs[1], True)
        for step, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_same_tree(a, b, f"step {step}")


@pytest.mark.slow
@every_estimator
def test_results_do_not_change_later(env_id: str, estimator: str):
    options = {"estimator": estimator, "estimator_options": FEW_MEMBERS.get(estimator)}
    env = make_batch(
        env_id, 3, max_episode_steps=40, sensors="degraded", disturbance="rough", **options
    )
    kept = [env.reset(seed=3)]
    copies = [copy_tree(kept[0])]
    walk = random_walk(3, 3, env.single_action_space.shape[0])
    ends = 0
    for _ in range(70):
        kept.append(env.step(next(walk)))
        copies.append(copy_tree(kept[-1]))
        ends += "final_info" in kept[-1][4]
    assert ends
    for step, (one, other) in enumerate(zip(kept, copies, strict=True)):
        assert_same_tree(one, other, f"step {step}")


@every_environment
def test_info_holds_the_truth_that_the_environment_holds(env_id: str):
    batch, single = make_batch(env_id, 3), gym.make(env_id)
    _, info = batch.reset(seed=0)
    np.testing.assert_array_equal(info["truth"], batch.unwrapped.truth)
    _, info = single.reset(seed=0)
    np.testing.assert_array_equal(info["truth"], single.unwrapped.truth)
    config, now = single.unwrapped.core.config, single.unwrapped.core.now
    assert single.unwrapped.truth.shape == (len(config.true_state.names),)
    column = dict(zip(config.true_state.names, info["truth"], strict=True))
    slow = *config.world.disturbance.names, *config.sensors.bias_names
    for names, values in ((config.system.vehicle.state_names, now.state), (slow, now.slow)):
        for name, value in zip(names, values[0], strict=True):
            assert column.get(name, value) == value, name
    disturbance = config.world.disturbance
    assert {*config.system.vehicle.state_names, *config.sensors.bias_names} <= column.keys()
    assert disturbance.assumed_as != "states" or {*disturbance.names} <= column.keys()


@every_environment
def test_info_holds_the_parameters_that_an_episode_s_truth_has(env_id: str):
    vehicle = single_class(env_id).system.vehicle
    nominal = vehicle.parameters(0.0, np.zeros((1, vehicle.normals)))[0]
    assert nominal.shape == (len(vehicle.parameter_names),)
    for mismatch in (0.0, 0.2):
        batch, single = (
            make_batch(env_id, 3, mismatch=mismatch),
            gym.make(env_id, mismatch=mismatch),
        )
        action = np.zeros(single.action_space.shape)
        episodes = []
        for seed in (5, None):
            drawn = batch.reset(seed=seed)[1]["parameters"]
            first = single.reset(seed=seed)[1]["parameters"]
            info = batch.step(np.tile(action, (3, 1)))[4]
            for row in (*drawn, *info["parameters"], first):
                assert np.isfinite(row).all()
                assert np.array_equal(row, nominal) == (mismatch == 0.0)
            assert info["_parameters"].all()
            np.testing.assert_array_equal(info["parameters"], drawn)
            np.testing.assert_array_equal(drawn, batch.unwrapped.core.now.parameters)
            np.testing.assert_array_equal(drawn[0], first)
            np.testing.assert_array_equal(single.step(action)[4]["parameters"], first)
            episodes.append(drawn)
        assert len(np.unique(np.concatenate(episodes), axis=0)) == (1 if mismatch == 0.0 else 6)


@pytest.mark.parametrize("env_id", MANUALS)
def test_the_docstring_says_what_every_key_of_info_is(env_id: str):
    table = single_class(env_id).__doc__.split("## Information")[1].split("## Arguments")[0]
    listed = re.findall(r"^- ``(\w+)``:", table, re.MULTILINE)
    assert listed == [*gym.make(env_id).reset(seed=0)[1], "sensor_faults"]


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
@pytest.mark.parametrize("steps", [2_000, pytest.param(SOAK_STEPS, marks=pytest.mark.nightly)])
def test_random_actions_leave_everything_finite_and_in_bounds(
    env_id: str, steps: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(SUITES, "broken", BROKEN)
    seen = soak(env_id, steps, turns=1 if steps == SOAK_STEPS else 2)
    assert seen.steps >= steps
    if (
        steps == SOAK_STEPS
    ):  # in the two dozen steps a filter of the selection, rounding decides how many end
        assert seen.ended >= (1 if at_sea(env_id) else 51)
    assert seen.missing > 0.1 * seen.steps


@pytest.mark.slow
@every_environment
def test_most_mismatched_vehicle_stays_finite(env_id: str):
    """Corners of what ``mismatch`` may draw, steered hard: one environment in some thousands comes near to one."""
    rows = 512
    few = FEW_MEMBERS.get(single_class(env_id).system.estimator)
    core = make_core(env_id, rows, estimator_options=few, mismatch=0.25, disturbance="calm")
    core.reset()
    rng = np.random.default_rng(0)
    core.now.parameters = core.config.system.vehicle.parameters(
        0.25, rng.choice([-9.0, 9.0], (rows, core.config.system.vehicle.normals))
    )
    start = np.abs(core.truth).max(0)
    for step in range(240):
        reward = core.step(
            np.full((rows, core.config.action_size), 1.0 if step % 160 < 80 else -1.0)
        ).reward
        if step % 8 == 0:  # what is lost stays lost
            assert_sound(core, core.observe(), reward, core.info())
    assert (np.abs(core.truth) < 1e4 + 100.0 * start).all()


ABSURD = np.array([0.0, np.nan, np.inf, -np.inf, 1e300, -1e300, 5e-324])
"""A value for each row; the first row's does not arrive."""


@pytest.mark.slow
@every_pair
def test_absurd_measurements_leave_everything_finite(env_id: str, estimator: str):
    rows = len(ABSURD)
    core = make_core(
        env_id, rows, seed=1, estimator=estimator, estimator_options=FEW_MEMBERS.get(estimator)
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
    rng = np.random.default_rng(1)
    core.reset(measurements=absurd)
    check(None)
    walk = random_walk(1, rows, core.config.action_size)
    for step in range(65):
        # For 25 steps every measurement is absurd, then some, then none.
        chosen = rng.random((rows, p)) < (1.0 if step < 25 else 0.3 if step < 50 else 0.0)
        measurements = None
        if step < 50:
            nominal = core.config.sensors.exact(
                core.now.state, core.now.exogenous, core.now.slow[:, core.config.world.size :]
            )
            measurements = np.where(chosen, absurd[0], nominal), np.where(chosen, absurd[1], True)
        reward = core.step(next(walk), measurements=measurements).reward
        check(reward)


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
    core = make_core(env_id, 4, seed=3, **options)
    core.reset()
    walk = random_walk(3, 4, core.config.action_size)
    for step in range(50):
        if step == 10:
            core.now.belief = core.now.belief.replace(mean=scales * (core.now.belief.mean + 1.0))
        reward = core.step(next(walk)).reward
        assert_sound(core, core.observe(), reward, core.info())
