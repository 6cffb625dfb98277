"""What follows where the episodes of a batch end: Gymnasium's three modes, and resets of some environments."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    FEW_MEMBERS,
    NATURE,
    SPREAD,
    assert_same_tree,
    every_environment,
    make_batch,
    random_walk,
    single_class,
)
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

EXACT = 1e-10
ROWS = 3
MODES = list(AutoresetMode)
ROUGH = {"sensors": "degraded", "disturbance": "rough", "mismatch": 0.2}

every_mode = pytest.mark.parametrize("mode", MODES)


def assert_same_as_gymnasium_s_loop(env_id: str, mode: AutoresetMode, **options: Any) -> None:
    """That a batch does what Gymnasium's own loop over single environments does; nature to the last bit."""
    few = FEW_MEMBERS.get(options.get("estimator", single_class(env_id).system.estimator))
    options |= {"max_episode_steps": 15, "estimator_options": few}
    native = make_batch(env_id, ROWS, autoreset_mode=mode, **options)
    loop = gym.make_vec(
        env_id, ROWS, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode.value}, **options
    )  # fmt: skip
    assert native.metadata["autoreset_mode"] is loop.metadata["autoreset_mode"]
    assert_same_tree(native.reset(seed=3), loop.reset(seed=3), "reset", EXACT)
    walk, ends = random_walk(3, ROWS, native.single_action_space.shape[0]), 0
    for step in range(35):
        actions = next(walk)
        one, other = native.step(actions), loop.step(actions)
        assert_same_tree(one, other, f"step {step}", EXACT)
        for key in NATURE:
            np.testing.assert_array_equal(one[4][key], other[4][key], f"{key} of step {step}")
        done = one[2] | one[3]
        ends += int(done.any())
        if mode is AutoresetMode.DISABLED and done.any():
            resets = (each.reset(options={"reset_mask": done}) for each in (native, loop))
            assert_same_tree(*resets, f"reset after {step}", EXACT)
    assert ends >= 2


@pytest.mark.slow
@every_mode
@pytest.mark.parametrize(("env_id", "estimator"), SPREAD)
def test_a_batch_does_what_gymnasiums_loop_does(env_id: str, estimator: str, mode: AutoresetMode):
    assert_same_as_gymnasium_s_loop(env_id, mode, estimator=estimator, **ROUGH)


@pytest.mark.slow
@every_mode
@every_environment
def test_a_reset_of_some_leaves_the_others_untouched(env_id: str, mode: AutoresetMode):
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
        for key in (key for key in out[4] if not key.startswith(("_", "final_"))):
            np.testing.assert_array_equal(out[4][key][others], unmasked[4][key][others], key)
        changed |= bool((out[0] != unmasked[0])[mask].any())
    assert changed


@pytest.mark.parametrize("mode", MODES[:2])
@pytest.mark.parametrize("env_id", ["SigmaCorvette-v0", "SegorogeniAUV-v0"])
def test_restarts_within_one_program_give_the_bits_of_stages(env_id: str, mode: AutoresetMode):
    """Episodes end one after the other, at a time limit, as some have been reset before."""
    assert AutoresetMode.DISABLED not in MODES[:2]
    options = {"autoreset_mode": mode, "max_episode_steps": 7}
    together, apart = (make_batch(env_id, ROWS, **options) for _ in range(2))
    apart.unwrapped.core._together = False
    walk, results = random_walk(5, ROWS, together.single_action_space.shape[0]), []
    for env in (together, apart):
        env.reset(seed=2)
    for step in range(18):  # in the last of which an episode starts, in both modes
        actions = next(walk)
        results = [env.step(actions) for env in (together, apart)]
        assert_same_tree(*results, f"step {step}", 0.0)
        for key in ("estimate", "_estimate"):
            results[0][4][key][:] = 0  # they are the caller's own
        if step in (1, 3):
            mask = np.arange(ROWS) == step // 2
            resets = [env.reset(options={"reset_mask": mask}) for env in (together, apart)]
            assert_same_tree(*resets, f"reset after {step}", 0.0)
    one, other = (env.unwrapped.core.now for env in (together, apart))
    for name in ("noise_before", "exogenous_before", "action", "episode"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)
    assert one.episode.min() > 1


@every_mode
def test_an_ended_environment_may_be_reset_by_hand(mode: AutoresetMode):
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


def test_a_step_after_the_end_is_refused_where_nothing_restarts():
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


def test_a_single_environment_that_has_ended_stays_ended():
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
    """Of what a perfect episode has earned in as many steps, or in all of its own."""
    core = make_batch(env_id, 2, max_episode_steps=1200, autoreset_mode="Disabled").unwrapped.core
    core.start(0)
    task = core.config.system.task
    a_step = task.perfect == task.horizon  # a reward of 1 in each
    for steps in (0, 1, task.horizon // 2, task.horizon, 1200):
        core.now.steps[:] = steps
        core.now.total[:] = steps if a_step else task.perfect * (steps > 0)
        expected = min(steps / task.horizon, 1.0) if a_step else float(steps > 0)
        np.testing.assert_allclose(core.score, expected, rtol=1e-15)
    core.now.total[:] = np.nextafter(core.now.total, np.inf)
    assert core.score.max() == 1.0


def test_an_unknown_mode_is_answered_with_those_that_exist():
    sentence = r"^unknown autoreset_mode 'next step'.*: choose from NextStep, SameStep, Disabled$"
    with pytest.raises(ValueError, match=sentence):
        gym.make_vec("SigmaCorvette-v0", num_envs=2, autoreset_mode="next step")


@pytest.mark.parametrize(
    ("wrong", "error"),
    [([True, False], TypeError), (np.array([1, 0]), TypeError), (np.array([True]), ValueError),
     (np.array([False, False]), ValueError)],
    ids=repr,
)  # fmt: skip
def test_a_mask_that_is_none_is_refused_and_changes_nothing(wrong: Any, error: type[Exception]):
    env, twin = (make_batch("SigmaCorvette-v0", 2) for _ in range(2))
    with pytest.raises(ResetNeeded, match=r"^the first reset must be of all environments$"):
        env.reset(seed=0, options={"reset_mask": np.array([True, False])})
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(error, match=r"^reset_mask must .*, got "):
        env.reset(seed=4, options={"reset_mask": wrong})
    actions = np.zeros((2, 1), np.float32)
    assert_same_tree(env.step(actions), twin.step(actions))


def test_a_reset_of_some_environments_may_seed_them():
    env = make_batch("SigmaCorvette-v0", 3)
    env.reset(seed=0)
    mask = np.array([False, True, True])
    observations, _ = env.reset(
        seed=[7, 40, 50], options={"reset_mask": mask}
    )  # the first counts for nothing
    for row, seed in ((1, 40), (2, 50)):
        expected, _ = gym.make("SigmaCorvette-v0").reset(seed=seed)
        assert_same_tree(observations[row], expected, "", EXACT)
    with pytest.raises(ValueError, match=r"^unknown reset option 'speed'"):
        env.reset(options={"reset_mask": mask, "speed": 1.0})
