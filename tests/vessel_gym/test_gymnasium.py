"""What Gymnasium offers around an environment works on both faces: wrappers, videos, copies, seeds, success."""

import copy
import pickle
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    CARRIED,
    FEW_MEMBERS,
    MANUALS,
    assert_same_tree,
    copy_tree,
    every_environment,
    make_batch,
    random_walk,
    single_class,
)
from gymnasium import wrappers as single_wrappers
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as wrappers
from test_time_at_sea import at_sea

from agents import load_agent

CORVETTE = "SigmaCorvette-v0"
every_estimator = pytest.mark.parametrize(("env_id", "estimator"), CARRIED)
every_mode = pytest.mark.parametrize("mode", list(AutoresetMode))


# --- wrappers of batches --------------------------------------------------------------------------


def same(value: Any) -> Any:
    return value


WRAPPED: dict[str, Callable[[Any], Any]] = {
    "VectorizeTransformObservation": lambda env: wrappers.VectorizeTransformObservation(
        env,
        single_wrappers.TransformObservation,
        func=same,
        observation_space=env.single_observation_space,
    ),
    "DictInfoToList": wrappers.DictInfoToList,
    "FlattenObservation": wrappers.FlattenObservation,
    "NormalizeObservation": wrappers.NormalizeObservation,
    "RescaleAction": lambda env: wrappers.RescaleAction(env, np.float32(-2.0), np.float32(2.0)),
    "NormalizeReward": wrappers.NormalizeReward,
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
}
"""One of each kind: of parts of single ones, infos, spaces, autoreset, actions, rewards and episodes."""


def allowed(name: str) -> set[AutoresetMode]:
    """The modes in which Gymnasium lets a wrapper work: those of observations know no SAME_STEP, one no DISABLED."""
    if name == "NormalizeObservation":
        return {AutoresetMode.NEXT_STEP}
    return set(AutoresetMode) - (
        {AutoresetMode.SAME_STEP} if name.endswith("Observation") else set()
    )


def fly_wrapped(env: Any, mode: AutoresetMode, steps: int = 14) -> list[Any]:
    """What reset and each step of a wrapped batch give, with resets where nothing else restarts an episode."""
    out = [env.reset(seed=1)]
    walk = random_walk(1, env.num_envs, env.single_action_space.shape[0])
    for _ in range(steps):
        out.append(copy_tree(env.step(next(walk))))
        done = out[-1][2] | out[-1][3]
        if mode is AutoresetMode.DISABLED and done.any():
            out.append(env.reset(options={"reset_mask": done}))
    return out


@pytest.mark.slow
@every_mode
@pytest.mark.parametrize("name", WRAPPED)
def test_wrappers_do_to_our_batches_what_they_do_to_gymnasiums(name: str, mode: AutoresetMode):
    native = make_batch(CORVETTE, 3, autoreset_mode=mode, max_episode_steps=5)
    loop = gym.make_vec(
        CORVETTE,
        3,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        max_episode_steps=5,
    )
    if mode not in allowed(name):
        for env in (native, loop):
            with pytest.raises(ValueError, match=r"Expected .*autoreset_mode"):
                WRAPPED[name](env)
        return
    expected = WRAPPED[name](loop)
    env = WRAPPED[name](native)
    assert env.observation_space == expected.observation_space
    assert env.action_space == expected.action_space
    for step, (one, other) in enumerate(
        zip(fly_wrapped(env, mode), fly_wrapped(expected, mode), strict=True)
    ):
        assert len(one) == len(other)
        for a, b in zip(one[:-1], other[:-1], strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-6, err_msg=f"step {step}")
        if name == "DictInfoToList":
            assert [set(info) for info in one[-1]] == [set(info) for info in other[-1]]
        else:
            assert set(one[-1]) == set(other[-1])


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


@pytest.mark.slow
def test_gymnasium_shows_a_batch_in_a_window(monkeypatch: pytest.MonkeyPatch):
    """With a stand-in for OpenCV, which only scales here: every second pixel."""
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    scaled = types.SimpleNamespace(
        resize=lambda image, size: image[:: image.shape[0] // size[1], ::2][: size[1], : size[0]]
    )
    monkeypatch.setitem(sys.modules, "cv2", scaled)
    env = wrappers.HumanRendering(
        make_batch(CORVETTE, 4, autoreset_mode="NextStep", render_mode="rgb_array")
    )
    env.reset(seed=0)
    shown = pygame.surfarray.array3d(env.window)
    assert shown.shape == (1008, 720, 3)
    quarters = [shown[i : i + 504, j : j + 360] for i in (0, 504) for j in (0, 360)]
    assert all(len(np.unique(quarter.reshape(-1, 3), axis=0)) > 50 for quarter in quarters)
    env.close()


@pytest.mark.slow
def test_a_video_of_an_episode_is_written(tmp_path: Path):
    pytest.importorskip("pygame")
    pytest.importorskip("moviepy")
    import imageio_ffmpeg

    env: Any = make_batch(
        CORVETTE, 2, autoreset_mode="NextStep", render_mode="rgb_array", max_episode_steps=4
    )
    env = wrappers.RecordVideo(
        env, str(tmp_path / "videos"), episode_trigger=lambda episode: episode == 0
    )
    env.reset(seed=0)
    for _ in range(6):
        env.step(env.action_space.sample())
    env.close()
    (video,) = (tmp_path / "videos").iterdir()
    assert (
        imageio_ffmpeg.count_frames_and_secs(str(video))[0] == 5
    )  # the first observation's and four steps'


def test_pictures_outlive_an_environment_that_quits_pygame():
    pygame = pytest.importorskip("pygame")
    env = flown(CORVETTE)
    before = env.render()
    pygame.quit()  # as Gymnasium's own environments do when they close
    np.testing.assert_array_equal(env.render(), before)


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
        shaped = same if rows > 1 else lambda actions: actions[0]
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


@pytest.mark.slow
@pytest.mark.parametrize("made", [pickled, copy.deepcopy], ids=["pickle", "deepcopy"])
def test_copy_shows_whole_episode_and_leaves_original_alone(made: Callable):
    pytest.importorskip("pygame")
    for env in (flown("SigmaCorvette-v0"), gym.make("SigmaCorvette-v0", render_mode="rgb_array")):
        if not isinstance(env, gym.vector.VectorEnv):
            env.reset(seed=1)
            env.step(np.zeros(env.action_space.shape, np.float32))
        twin = made(env)
        before = env.render()
        np.testing.assert_array_equal(before, twin.render())
        twin.step(np.ones(env.action_space.shape, np.float32))
        np.testing.assert_array_equal(before, env.render())
        env.step(np.ones(env.action_space.shape, np.float32))
        np.testing.assert_array_equal(env.render(), twin.render())


# --- seeds ----------------------------------------------------------------------------------------


def test_np_random_seed_is_seed_of_environment():
    for env in (gym.make("SigmaCorvette-v0").unwrapped, make_batch("SigmaCorvette-v0", 3)):
        env.reset(seed=7)
        assert env.np_random_seed == 7
        assert env.np_random.random() == seeding.np_random(7)[0].random()
        env.reset()
        assert env.np_random_seed == 7


def test_np_random_seed_repeats_unseeded_episode():
    for make in (
        lambda: gym.make("SigmaCorvette-v0").unwrapped,
        lambda: make_batch("SigmaCorvette-v0", 3),
    ):
        asked, unasked = make(), make()
        told = asked.np_random_seed
        first, _ = asked.reset()
        assert asked.np_random_seed == told
        assert_same_tree(first, make().reset(seed=told)[0])
        first, _ = unasked.reset()
        assert_same_tree(first, make().reset(seed=unasked.np_random_seed)[0])


def test_seeds_that_no_one_number_tells_are_minus_one():
    env = make_batch(CORVETTE, 3)
    env.reset(seed=[4, 5, 6])
    assert env.np_random_seed == 4
    env.reset(seed=[4, 9, 6])
    assert env.np_random_seed == -1
    one, other = make_batch(CORVETTE, 3), make_batch(CORVETTE, 3)
    one.reset(seed=[4, 9, 6])
    other.reset(seed=[4, 9, 7])
    assert env.np_random.random() == one.np_random.random() != other.np_random.random()


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
def test_success_is_told_at_the_end_of_every_episode(env_id: str):
    """It is to arrive, and on a turning circle to hold the turn until time is up."""
    task = single_class(env_id).system.task
    rows = 2
    env = make_batch(env_id, rows, disturbance="calm", estimator="truth")
    controller = load_agent("autopilot", env)
    controller.reset(rows)
    observations, info = env.reset(seed=2)
    walk = random_walk(7, rows, env.single_action_space.shape[0])
    told = []
    for _ in range(gym.spec(env_id).max_episode_steps):
        actions = np.where(
            np.arange(rows)[:, None] == 0, controller.act(observations), next(walk)
        ).astype(np.float32)
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
