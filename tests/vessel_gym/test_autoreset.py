"""What follows where the episodes of a batch end: Gymnasium's three modes, and resets of some environments."""

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    FEW_MEMBERS,
    NATURE,
    assert_same_tree,
    every_environment,
    make_batch,
    random_walk,
    row_of,
    single_class,
)
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

EXACT = 1e-10
ROWS = 3
MODES = list(AutoresetMode)
ROUGH = {"sensors": "degraded", "disturbance": "rough", "mismatch": 0.2}

every_mode = pytest.mark.parametrize("mode", MODES)
with_and_without_randomness_of_its_own = pytest.mark.parametrize(
    "estimator", ["measurement", "enkf"]
)


def wild_actions(row: int, episode: int, size: int) -> Iterator[np.ndarray]:
    """Actions that depend on the episode alone, whenever it is flown, and end it early."""
    walk = random_walk(100 * row + episode, 1, size)
    return (actions[0] for actions in walk)


def fly(
    mode: AutoresetMode, env_id: str, steps: int, **options: Any
) -> dict[tuple[int, int], list[Any]]:
    """Every episode (row, number) of a batch: what each reset and step of it gave."""
    env = make_batch(env_id, ROWS, autoreset_mode=mode, **options)
    size = env.single_action_space.shape[0]
    episode = np.zeros(ROWS, int)
    actions = [wild_actions(row, 0, size) for row in range(ROWS)]
    observations, info = env.reset(seed=5)
    flown = {(row, 0): [(observations[row], row_of(info, row))] for row in range(ROWS)}

    def begin(row: int) -> None:
        episode[row] += 1
        actions[row] = wild_actions(row, int(episode[row]), size)
        flown[row, int(episode[row])] = [(observations[row], row_of(info, row))]

    done = np.zeros(ROWS, bool)
    for _ in range(steps):
        ignored = np.full(
            size, np.nan, np.float32
        )  # the action of an environment that is only reset
        chosen = np.stack([ignored if done[row] else next(actions[row]) for row in range(ROWS)])
        observations, rewards, terminated, truncated, info = env.step(chosen)
        for row in range(ROWS):
            if done[row]:  # in this step a new episode has begun
                assert rewards[row] == 0.0
                assert not terminated[row] | truncated[row]
                begin(row)
                continue
            last, ended = (observations[row], info), terminated[row] | truncated[row]
            if ended and mode is AutoresetMode.SAME_STEP:
                last = info["final_obs"][row], info["final_info"]
            step = last[0], rewards[row], terminated[row], truncated[row], row_of(last[1], row)
            flown[row, int(episode[row])].append(step)
        done = (terminated | truncated) & (not done.any() or ~done)
        if mode is AutoresetMode.SAME_STEP:
            for row in np.flatnonzero(done):
                begin(row)
            done[:] = False
        if mode is AutoresetMode.DISABLED and done.any():
            observations, info = env.reset(options={"reset_mask": done})
            for row in np.flatnonzero(done):
                begin(row)
            done[:] = False
    return flown


@pytest.mark.slow
@with_and_without_randomness_of_its_own
@every_environment
def test_the_episodes_of_a_row_are_the_same_in_every_mode_and_in_a_single_environment(
    env_id: str, estimator: str
):
    assert_same_in_every_mode(env_id, estimator, **ROUGH)


def assert_same_in_every_mode(env_id: str, estimator: str, **options: Any) -> None:
    """That episodes of a batch, in each mode, are those of single environments."""
    options |= {
        "estimator": estimator,
        "estimator_options": FEW_MEMBERS.get(estimator),
        "max_episode_steps": 25,
    }
    modes = {mode: fly(mode, env_id, 56, **options) for mode in MODES}
    complete = 0
    for row in range(ROWS):
        single = gym.make(env_id, disable_env_checker=True, **options)
        out: Any = single.reset(seed=5 + row)
        for number in range(4):
            actions = wild_actions(row, number, single.action_space.shape[0])
            episodes = [flown[row, number] for flown in modes.values() if (row, number) in flown]
            for step in range(max(map(len, episodes), default=0)):
                for episode in episodes:
                    if step < len(episode):
                        assert_same_episode(
                            episode[step], out, f"row {row}, episode {number}, step {step}"
                        )
                if not (ended := len(out) > 2 and (out[2] or out[3])):
                    out = single.step(next(actions))
            complete += len(episodes) == len(MODES) and ended
            out = single.reset()
    assert complete >= 2 * ROWS


def assert_same_episode(one: tuple[Any, ...], other: tuple[Any, ...], where: str) -> None:
    """A step out of a batch against a single environment's, which gives Python's numbers."""
    for a, b in zip(one[:-1], other[:-1], strict=True):
        assert_same_tree(np.asarray(a), np.asarray(b), where, EXACT)
    assert set(one[-1]) == set(other[-1])
    for key, value in other[-1].items():
        tolerance = 0.0 if key in NATURE else EXACT
        assert_same_tree(np.asarray(one[-1][key]), np.asarray(value), f"{where}, {key}", tolerance)


@pytest.mark.slow
@every_mode
@every_environment
def test_a_batch_does_what_gymnasiums_own_loop_over_single_environments_does(
    env_id: str, mode: AutoresetMode
):
    native = make_batch(env_id, ROWS, autoreset_mode=mode, max_episode_steps=15, **ROUGH)
    loop = gym.make_vec(
        env_id, ROWS, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode.value}, max_episode_steps=15,
        **ROUGH,
    )  # fmt: skip
    assert native.metadata["autoreset_mode"] is loop.metadata["autoreset_mode"]
    assert_same_tree(native.reset(seed=3), loop.reset(seed=3), "reset", EXACT)
    walk = random_walk(3, ROWS, native.single_action_space.shape[0])
    ends = 0
    for step in range(35):
        actions = next(walk)
        out = native.step(actions)
        assert_same_tree(out, loop.step(actions), f"step {step}", EXACT)
        done = out[2] | out[3]
        ends += int(done.any())
        if mode is AutoresetMode.DISABLED and done.any():
            one, other = ({"reset_mask": done} for _ in range(2))
            assert_same_tree(
                native.reset(options=one), loop.reset(options=other), f"reset after {step}", EXACT
            )
    assert ends >= 2


@pytest.mark.slow
@every_mode
@every_environment
def test_a_reset_of_some_environments_leaves_the_others_untouched(env_id: str, mode: AutoresetMode):
    # To the last bit, and with `ekf`: a linear filter keeps one covariance for rows that agree, so
    # its last bits follow all rows.
    options = {"estimator": "ekf", "observe": "mean+std", **ROUGH}
    env, twin = (make_batch(env_id, ROWS, autoreset_mode=mode, **options) for _ in range(2))
    last, _ = env.reset(seed=1)
    twin.reset(seed=1)
    mask = np.array([False, True, False])
    walk = random_walk(4, ROWS, env.single_action_space.shape[0])
    others = ~mask
    changed = False
    for step in range(12):  # before any episode ends
        if step == 6:
            options = {"reset_mask": mask}
            before = env.unwrapped.core.info()
            observations, info = env.reset(options=options)
            assert options == {"reset_mask": mask}  # what was handed in stays as it was
            np.testing.assert_array_equal(observations[others], last[others])
            for key in before:
                assert info[f"_{key}"].tolist() == mask.tolist()
                assert not np.any(info[key][others]), key  # no news of them
                np.testing.assert_array_equal(
                    env.unwrapped.core.info()[key][others], before[key][others], key
                )
        actions = next(walk)
        out, unmasked = env.step(actions), twin.step(actions)
        last = out[0]
        for one, other in zip(out[:4], unmasked[:4], strict=True):
            np.testing.assert_array_equal(one[others], other[others])
        for key in row_of(out[4], 0):
            np.testing.assert_array_equal(out[4][key][others], unmasked[4][key][others], key)
        changed |= bool((out[0] != unmasked[0])[mask].any())
    assert changed


@every_mode
def test_an_ended_environment_may_be_reset_by_hand_before_it_resets_itself(mode: AutoresetMode):
    env = make_batch("SigmaCorvette-v0", 2, autoreset_mode=mode, max_episode_steps=3)
    env.reset(seed=0)
    idle = np.zeros((2, 1), np.float32)
    for _ in range(3):
        out = env.step(idle)
    assert out[3].all()
    env.reset(options={"reset_mask": np.array([True, False])})
    if mode is AutoresetMode.DISABLED:
        env.reset(options={"reset_mask": np.array([False, True])})
    rewards = env.step(idle)[1]
    assert rewards[0] > 0.0
    assert (rewards[1] > 0.0) == (mode is not AutoresetMode.NEXT_STEP)


def test_where_nothing_restarts_an_episode_that_has_ended_a_step_is_refused_in_a_sentence():
    env = make_batch("SigmaCorvette-v0", 3, autoreset_mode="Disabled", max_episode_steps=2)
    env.reset(seed=0)
    env.reset(options={"reset_mask": np.array([True, False, False])})
    idle = np.zeros((3, 1), np.float32)
    env.step(idle)
    env.reset(options={"reset_mask": np.array([True, False, False])})
    _, _, terminated, truncated, _ = env.step(idle)
    assert truncated.tolist() == [False, True, True]
    state = env.unwrapped.core.truth.copy()
    with pytest.raises(
        ResetNeeded,
        match=r"^2 of 3 episodes have ended: call reset\(options=\{'reset_mask'.*before the",
    ):
        env.step(idle)
    np.testing.assert_array_equal(env.unwrapped.core.truth, state)
    env.reset(options={"reset_mask": terminated | truncated})
    env.step(idle)
    env.reset()
    env.step(idle)


def test_a_single_environment_that_has_ended_stays_ended_whatever_is_done():
    """A ship far off her track has lost her turn: steps beyond give nothing, move nothing and bring nothing back."""
    env = single_class("SigmaCorvette-v0")()
    env.reset(seed=0)
    found, lost = env.core.now.state, env.core.now.state + [0.0, 1e6, *[0.0] * 6]
    env.core.now.state = lost
    _, _, terminated, _, _ = env.step(np.zeros(1, np.float32))
    assert terminated
    env.core.now.state = found
    score, truth = env.core.score.copy(), env.truth
    for action in (0.0, 1.0):
        _, reward, terminated, truncated, info = env.step(np.full(1, action, np.float32))
        assert (reward, terminated, truncated) == (0.0, True, False)
        assert (info["score"], env.end_reasons[info["end"]]) == (score[0], "turn lost")
        np.testing.assert_array_equal(info["truth"], truth)
    with pytest.raises(ValueError, match="action must be finite"):
        env.step(np.full(1, np.nan, np.float32))
    env.reset()
    assert not env.step(np.zeros(1, np.float32))[2]


@pytest.mark.parametrize("env_id", ["SigmaCorvette-v0", "SegorogeniAUV-v0"])
def test_a_score_is_a_share_however_long_an_episode_is(env_id: str):
    """Twice the usual time at a reward of 1 a step is a score of 1, in a batch and in a single environment."""
    batch = make_batch(env_id, 2, max_episode_steps=1200, autoreset_mode="Disabled").unwrapped
    single = single_class(env_id)()
    for env in (batch, single):
        env.reset(seed=0)
        core = env.core
        task, rows, scores = core.config.system.task, core.num_envs, []
        for steps in (0, 1, task.horizon // 2, task.horizon, 1200, 10 * task.horizon):
            core.now.steps[:] = steps
            core.now.total[:] = min(steps, 1.0) * (
                steps if task.perfect == task.horizon else task.perfect
            )
            scores.append(core.score)
        usual = [steps / task.horizon for steps in (0, 1, task.horizon // 2)]
        expected = usual if task.perfect == task.horizon else [0.0, 1.0, 1.0]
        np.testing.assert_allclose(
            scores, np.repeat([[*expected, 1.0, 1.0, 1.0]], rows, 0).T, rtol=1e-15
        )
    core.now.total[:] = np.nextafter(core.now.total, np.inf)
    assert core.score.max() == 1.0


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, "SameStep", "Disabled"], ids=str)
def test_a_mode_is_told_as_gymnasiums_own_batches_are_told_it(mode: Any):
    env = gym.make_vec("SigmaCorvette-v0", num_envs=2, autoreset_mode=mode)
    assert env.metadata["autoreset_mode"] is AutoresetMode(mode)
    assert gym.make_vec(env.spec).metadata["autoreset_mode"] is AutoresetMode(mode)


@pytest.mark.parametrize("wrong", ["next step", None, 1, ["SameStep"]], ids=repr)
def test_an_unknown_mode_is_answered_with_those_that_exist(wrong: Any):
    with pytest.raises(
        ValueError,
        match=r"^unknown autoreset_mode .*: choose from 'NextStep', 'SameStep', 'Disabled'$",
    ):
        gym.make_vec("SigmaCorvette-v0", num_envs=2, autoreset_mode=wrong)


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        ([True, False], TypeError), (None, TypeError), (np.array([1, 0]), TypeError), (np.array([True]), ValueError),
        (np.array([[True, False]]), ValueError), (np.array([False, False]), ValueError),
    ],
    ids=repr,
)  # fmt: skip
def test_a_mask_that_is_none_is_refused_and_changes_nothing(wrong: Any, error: type[Exception]):
    env, twin = (make_batch("SigmaCorvette-v0", 2) for _ in range(2))
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(error, match=r"^reset_mask must .*, got "):
        env.reset(seed=4, options={"reset_mask": wrong})
    actions = np.zeros((2, 1), np.float32)
    assert_same_tree(env.step(actions), twin.step(actions))


def test_the_first_reset_is_of_all_environments():
    env = make_batch("SigmaCorvette-v0", 2)
    with pytest.raises(ResetNeeded, match=r"^the first reset must be of all environments$"):
        env.reset(seed=0, options={"reset_mask": np.array([True, False])})
    env.reset(seed=0, options={"reset_mask": np.array([True, True])})


def test_a_reset_of_some_environments_may_seed_them_and_pass_the_tasks_options():
    env = make_batch("SigmaCorvette-v0", 3)
    env.reset(seed=0)
    mask = np.array([False, True, True])
    observations, _ = env.reset(
        seed=[-7, 40, 50], options={"reset_mask": mask}
    )  # the first counts for nothing
    for row, seed in ((1, 40), (2, 50)):
        expected, _ = gym.make("SigmaCorvette-v0").reset(seed=seed)
        assert_same_tree(observations[row], expected, "", EXACT)
    with pytest.raises(ValueError, match=r"^unknown reset option 'speed'"):
        env.reset(options={"reset_mask": mask, "speed": 1.0})
    with pytest.raises(ValueError, match="seeds must be"):
        env.reset(seed=[1, -2, 3], options={"reset_mask": mask})
