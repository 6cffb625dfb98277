"""PPO training: repeatable, on its own seeds, with policies that fly as the model."""

import dataclasses
from pathlib import Path
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import numpy as np
import pytest
import torch
from short_training import STEPS, TINY

from agents import load_agent
from agents.policies.checkpoint import description
from agents.seeds import evaluation_seeds, training_seed, tuning_seeds
from agents.training.algorithms import (
    MEMORIES,
    batch,
    describe,
    hyperparameters,
    read_settings,
    train,
    tuned_settings,
)
from agents.training.vec_env import StableBaselinesVecEnv
from estimators import ExtendedKalmanFilter, compiled
from vessel_gym.envs import (
    SegorogeniAUVEnv,
    SigmaChannelEnv,
    SigmaCorvetteEnv,
    register_environment,
)
from vessel_gym.simulation.core import Core

ENV = "SigmaCorvette-v0"
RAW = {"observe": "measurement", "estimator": "measurement"}
tiny = pytest.mark.usefixtures("tiny")


@tiny
@pytest.mark.slow
@pytest.mark.parametrize("memory", MEMORIES)
def test_policy_depends_on_seed_alone(tmp_path: Path, memory: str):
    """On one machine: training carries rounding of another far. Evaluations change nothing."""
    one, other, third = (
        train(ENV, tmp_path / name, RAW, seed, STEPS, memory=memory, folder=folder).read_bytes()
        for name, seed, folder in (
            ("one", 3, None),
            ("other", 3, tmp_path / "a"),
            ("third", 4, None),
        )
    )
    assert one == other != third
    assert (tmp_path / "a" / "evaluations.npz").exists()


@tiny
@pytest.mark.slow
@pytest.mark.parametrize(("seed", "memory"), [(0, "none"), (3, "lstm")])
def test_training_flies_its_own_seeds_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, memory: str
):
    flown: list[tuple[int, ...]] = []
    original = Core.advance

    def step(core: Core, *args: Any, **kwargs: Any) -> Any:
        flown.append(tuple(core.seeds))
        return original(core, *args, **kwargs)

    monkeypatch.setattr(Core, "advance", step)
    train(ENV, tmp_path / "agent", seed=seed, steps=STEPS, memory=memory)
    first, rows = training_seed(seed), TINY["n_envs"]
    assert len(flown) == STEPS // rows
    assert set(flown) == {tuple(range(first, first + rows))}
    assert not set(flown[0]) & {*evaluation_seeds(1_000_000), *tuning_seeds(1_000_000)}


@tiny
@pytest.mark.parametrize(
    ("memory", "options"), [("none", {"observe": "mean+std"}), ("lstm", RAW), ("frames", RAW)]
)
def test_policy_acts_as_saved_actor_with_memory_in_each_row(
    tmp_path: Path, models: list[Any], memory: str, options: dict[str, Any]
):
    path = train(ENV, tmp_path / "agent", options, steps=STEPS, memory=memory)
    model, frames, rows = models[0], 3 if memory == "frames" else 1, 5
    env = gym.make(ENV, **options)
    size = env.observation_space.shape[0]
    agent, alone = load_agent(path, env), load_agent(path, env)
    agent.reset(rows)
    past = np.zeros((frames, rows, size), np.float32)
    rng, state, starts = np.random.default_rng(0), None, np.ones(rows, bool)
    for _ in range(4):
        new = rng.uniform(-3.0, 3.0, past[0].shape).astype(np.float32)
        past = np.concatenate([past[1:], new[None]])
        seen = np.concatenate(list(past), -1)
        expected, state = model.predict(seen, state, starts, deterministic=True)
        actions = agent.act(new)
        np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-6)
        np.testing.assert_allclose(alone.act(new[2:3]), actions[2:3], rtol=0, atol=1e-6)
        assert env.action_space.contains(actions[0])
        starts[:] = False
    assert description(path)["policy"]["observations"] == [frames * size]
    agent.reset(rows)
    assert (np.abs(agent.act(new) - actions).max() > 1e-5) == (memory != "none")


@pytest.mark.parametrize("env_id", [ENV, "PunaUAV-v0"])
def test_training_on_raw_measurements_runs_no_filter(env_id: str):
    """Observations, rewards and ends equal those with the environment's filter to the last bit."""
    options = {"observe": "measurement", "sensors": "degraded", "max_episode_steps": 15}
    ours = batch(describe(env_id, options, 0, None), 3)
    env = gym.make_vec(env_id, num_envs=3, **options)
    theirs = StableBaselinesVecEnv(env, ours.reward_scale)
    assert (
        ours.env.unwrapped.core.config.estimation.filter.name
        == "measurement"
        != env.unwrapped.core.config.estimation.filter.name
    )
    kept = describe(env_id, options | {"termination": "belief"}, 0, None)  # which the filter says
    assert (
        batch(kept, 1).env.unwrapped.core.config.estimation.filter.name
        == env.unwrapped.core.config.estimation.filter.name
    )
    for each in (ours, theirs):
        each.seed(tuning_seeds(1)[0])
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    rng, size = np.random.default_rng(0), ours.action_space.shape
    for _ in range(40):
        actions = rng.uniform(-1.0, 1.0, (3, *size)).astype(np.float32)
        for one, other in zip(ours.step(actions)[:3], theirs.step(actions)[:3], strict=True):
            np.testing.assert_array_equal(one, other)


@tiny
def test_policy_tells_how_it_was_trained(tmp_path: Path):
    options = {"estimator": ExtendedKalmanFilter}
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        described = description(train(ENV, tmp_path / "agent", options, steps=STEPS))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)
    assert described.items() >= describe(ENV, options, 0, STEPS).items()
    assert described["trained_steps"] == STEPS
    assert "ExtendedKalmanFilter" in described["env_options"]["estimator"]


def test_hyperparameters_have_names_of_rl_zoo3():
    plain, frames, lstm = (hyperparameters("SegorogeniAUV-v0", memory) for memory in MEMORIES)
    assert frames["frame_stack"] == 20
    assert "frame_stack" not in plain
    network = {"net_arch": [64, 64], "log_std_init": -1.6, "lstm_hidden_size": 64}
    assert lstm["policy_kwargs"] == network
    assert (plain["learning_rate"], plain["n_timesteps"]) == ("lin_1e-3_1e-5", 2_500_000)
    changed = {"policy_kwargs": {"net_arch": [8]}, "learning_rate": "lin_1e-3", "target_kl": 0.1}
    found = hyperparameters(ENV, changed=changed)
    assert found["policy_kwargs"] == {"net_arch": [8], "log_std_init": -1.6}
    assert found.items() >= {"learning_rate": "lin_1e-3", "target_kl": 0.1, "n_envs": 128}.items()
    for name, value in {"ent_coef": "auto_0.1", "gradient_steps": -1, "noise_std": 0.2}.items():
        assert hyperparameters(ENV, "none", {name: value}, "sac")[name] == value


def test_subclass_has_settings_of_nearest_task(tmp_path):
    file = tmp_path / "settings.toml"
    dive = SegorogeniAUVEnv.system
    corvette, channel = SigmaCorvetteEnv.system, SigmaChannelEnv.system
    with patch("vessel_gym.envs.own.check_system"), patch.dict(gym.registry):
        for name, system in {"corvette": corvette, "dive": dive, "channel": channel}.items():
            gentle = compiled(type("Gentle", (type(system.task),), {}))
            gentler = compiled(type("Gentler", (gentle,), {}))
            given = (f.name for f in dataclasses.fields(system.task) if f.init)
            fields = {field: getattr(system.task, field) for field in given}
            own = dataclasses.replace(system, name=f"Gentler-{name}-v0", task=gentler(**fields))
            register_environment(own)
        for name, like in (("corvette", ENV), ("dive", "SegorogeniAUV-v0")):
            found = tuned_settings("ppo", f"Gentler-{name}-v0")
            assert found == (like, tuned_settings("ppo", like)[1])
        # of a channel, and of an algorithm that is tuned for none, there are the defaults alone
        assert tuned_settings("ppo", "Gentler-channel-v0")[0] == "default"
        assert tuned_settings("sac", "Gentler-corvette-v0")[0] == "default"
        file.write_text('["CartPole-v1"]\nn_steps = 8\n[default]\nn_steps = 4\n')
        assert read_settings(file, "Gentler-dive-v0") == ("default", {"n_steps": 4})


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((ENV, "elephant"), "unknown memory 'elephant': choose from none, frames, lstm"),
        ((ENV, "lstm", None, "sac"), "sac trains agents without a memory"),
        ((ENV, "none", None, "dqn"), "unknown algorithm 'dqn'"),
        ((ENV, "none", {"gama": 0.9}), r"unknown setting 'gama' \(did you mean 'gamma'\?\)"),
        ((ENV, "none", {"clip_range": "lin_x"}), "the setting clip_range must be such as 0.2"),
    ],
)
def test_what_is_no_hyperparameter_is_refused(arguments: Any, sentence: str):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        hyperparameters(*arguments)


@pytest.mark.parametrize(
    ("changed", "steps", "sentence"),
    [
        ({"batch_size": 1}, STEPS, "`batch_size` must be greater than 1"),
        ({"n_envs": 0}, STEPS, "n_envs must be a whole number of at least 1"),
        ({}, 7, "steps must be a whole number of at least 8, got 7"),
    ],
)
def test_bad_settings_are_refused_and_leave_nothing_behind(
    tmp_path: Path, changed: dict[str, Any], steps: int, sentence: str
):
    with pytest.raises(ValueError, match=sentence):
        train(ENV, tmp_path / "agent", steps=steps, settings=TINY | changed)
    assert list(tmp_path.iterdir()) == []


@tiny
def test_policy_stays_whole_when_another_training_breaks_off(
    tmp_path: Path,
):
    """Names with a point in them, as in a sweep, stay apart."""
    reported: list[tuple[int, int, float]] = []
    given: Any = {"steps": 375, "progress": lambda *args: reported.append(args)}
    paths = [train(ENV, tmp_path / "new" / name, **given) for name in ("rate-0.1", "0.2.zip")]
    expected = [(0, 384), (128, 384), (256, 384), (384, 384)]
    assert [each[:2] for each in reported] == 2 * expected
    assert paths == [tmp_path / "new" / name for name in ("rate-0.1.npz", "0.2.npz")]
    before = paths[0].read_bytes()

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(ENV, paths[0], steps=STEPS, progress=interrupt)
    assert paths[0].read_bytes() == before
    assert set(paths[0].parent.iterdir()) == set(paths)
