"""What Gymnasium asks of an environment holds for both faces: pictures, copies, seeds, info, success."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    CARRIED,
    FEW_MEMBERS,
    MANUALS,
    assert_same_tree,
    every_environment,
    make_batch,
    random_walk,
    single_class,
)
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from test_time_at_sea import at_sea

from agents import load_agent

CORVETTE = "SigmaCorvette-v0"
every_estimator = pytest.mark.parametrize(("env_id", "estimator"), CARRIED)
every_mode = pytest.mark.parametrize("mode", list(AutoresetMode))


# --- pictures -------------------------------------------------------------------------------------


def flown(
    env_id: str, mode: AutoresetMode = AutoresetMode.NEXT_STEP, steps: int = 6, **options: Any
) -> Any:
    env = make_batch(env_id, 2, autoreset_mode=mode, render_mode="rgb_array", **options)
    env.reset(seed=4)
    walk = random_walk(4, 2, env.single_action_space.shape[0])
    for _ in range(steps):
        env.step(next(walk))
    return env


@pytest.mark.slow
@every_environment
def test_batch_shows_of_each_row_what_single_environment_shows(env_id: str):
    pytest.importorskip("pygame")
    env = flown(env_id)
    frames = env.render()
    assert isinstance(frames, tuple)
    walk = random_walk(4, 2, env.single_action_space.shape[0])
    actions = [next(walk) for _ in range(6)]
    for row, frame in enumerate(frames):
        single = gym.make(env_id, render_mode="rgb_array")
        single.reset(seed=4 + row)
        for action in actions:
            single.step(action[row])
        np.testing.assert_array_equal(frame, single.render())
    assert (frames[0] != frames[1]).any()
    env.close()
    assert env.render() is None


@pytest.mark.slow
@every_mode
def test_a_new_episode_begins_a_new_picture_and_the_others_go_on(mode: AutoresetMode):
    pytest.importorskip("pygame")
    env, twin = (flown(CORVETTE, mode, steps=6) for _ in range(2))
    mask = np.array([True, False])
    env.reset(options={"reset_mask": mask})
    assert (env.render()[0] != twin.render()[0]).any()
    np.testing.assert_array_equal(env.render()[1], twin.render()[1])
    single = gym.make(CORVETTE, render_mode="rgb_array")
    single.reset(seed=4)
    single.reset()
    np.testing.assert_array_equal(env.render()[0], single.render())


def test_a_batch_that_is_not_asked_for_pictures_keeps_none():
    env = make_batch(CORVETTE, 2)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="without a render_mode"):
        assert env.render() is None
    assert env.unwrapped._renderers == []
    with pytest.raises(ValueError, match=r"^unknown render_mode 'human': choose from "):
        make_batch(CORVETTE, 2, render_mode="human")


# --- copies ---------------------------------------------------------------------------------------


def pickled(env: Any) -> Any:
    return pickle.loads(pickle.dumps(env))


@pytest.mark.slow
@every_estimator
def test_a_copy_goes_on_bit_for_bit(env_id: str, estimator: str):
    """With late measurements and faults of sensors too."""
    options = {
        "estimator": estimator,
        "estimator_options": FEW_MEMBERS.get(estimator),
        "observe": "mean+std",
    }
    options |= at_sea(env_id) | {"max_episode_steps": 8}
    for env in (
        make_batch(env_id, 3, **options),
        gym.make(env_id, disable_env_checker=True, **options),
    ):
        size = env.action_space.shape[-1]
        rows = env.num_envs if isinstance(env, gym.vector.VectorEnv) else 1
        shaped = lambda actions, rows=rows: actions if rows > 1 else actions[0]  # noqa: E731
        for made in (pickled, copy.deepcopy):
            walk = random_walk(2, rows, size)
            fresh = made(env)
            assert_same_tree(env.reset(seed=3), fresh.reset(seed=3))
            for _ in range(4):
                env.step(shaped(next(walk)))
            if rows > 1:  # rows that are not in step with each other
                env.reset(options={"reset_mask": np.array([False, True, False])})
                env.step(shaped(next(walk)))
            twin = made(env)
            for step in range(6):  # over the end of an episode
                actions = shaped(next(walk))
                one, other = env.step(actions), twin.step(actions)
                assert_same_tree(one, other, f"{made.__name__}, step {step}")
                if rows == 1 and (one[2] or one[3]):
                    assert_same_tree(env.reset(), twin.reset())
            assert_same_tree(env.reset(), twin.reset())


# --- seeds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make", [lambda: gym.make(CORVETTE).unwrapped, lambda: make_batch(CORVETTE, 3)]
)
def test_np_random_seed_repeats_an_episode(make: Callable[[], Any]):
    env = make()
    env.reset(seed=7)
    assert env.np_random_seed == 7
    assert env.np_random.random() == seeding.np_random(7)[0].random()
    env.reset()
    assert env.np_random_seed == 7
    asked, unasked = make(), make()
    told = asked.np_random_seed
    first, _ = asked.reset()
    assert asked.np_random_seed == told
    assert_same_tree(first, make().reset(seed=told)[0])
    first, _ = unasked.reset()
    assert_same_tree(first, make().reset(seed=unasked.np_random_seed)[0])


# --- info -----------------------------------------------------------------------------------------


@every_environment
def test_info_holds_numbers_that_tensors_can_hold(env_id: str):
    """A word in ``info`` ends TorchRL's batches with a KeyError (0.14.1)."""
    single, batch = gym.make(env_id).unwrapped, make_batch(env_id, 2)
    for env in (single, batch):
        _, info = env.reset(seed=0)
        stepped = env.step(np.zeros(env.action_space.shape, np.float32))[4]
        for name, value in (info | stepped).items():
            assert np.asarray(value).dtype.kind in "bif", name
    assert single.end_reasons[0] == batch.end_reasons[0] == ""


# --- success --------------------------------------------------------------------------------------


@pytest.mark.slow
@every_environment
def test_success_is_a_fact_of_the_end_of_an_episode(env_id: str):
    """It is to arrive, and on a turning circle to hold the turn until time is up."""
    task = single_class(env_id).system.task
    rows = 2
    env = make_batch(env_id, rows, disturbance="calm", estimator="truth")
    controller = load_agent("autopilot", env)
    controller.reset(rows)
    observations, info = env.reset(seed=2)
    told = []
    for _ in range(gym.spec(env_id).max_episode_steps):
        actions = controller.act(observations)
        actions[1] = -1.0  # hard over to port, which loses every task
        assert not info["is_success"].any()
        observations, _, terminated, truncated, info = env.step(actions)
        for row in np.flatnonzero(terminated | truncated):
            final = info["final_info"]
            assert final["is_success"].dtype == bool
            word = env.unwrapped.end_reasons[final["end"][row]]
            assert final["is_success"][row] == (word == task.success)
            told.append((row, bool(final["is_success"][row])))
        if {row for row, _ in told} == set(range(rows)):
            break
    assert (0, True) in told
    assert (1, False) in told
    assert env_id not in MANUALS or "is_success" in type(gym.make(env_id).unwrapped).__doc__
