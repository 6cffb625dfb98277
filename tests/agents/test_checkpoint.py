"""Policies in files: they fly as the model that was saved, and no file runs anything."""

import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from refusals import refused
from sb3_contrib import ARS, TQC, TRPO, CrossQ, RecurrentPPO
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecEnv,
    VecEnvWrapper,
    VecFrameStack,
    VecNormalize,
)

from agents import load_agent, save_agent
from agents.training.vec_env import StableBaselinesVecEnv

ENV = "SigmaCorvette-v0"
ROWS = 4
SHORT = {"n_steps": 16, "batch_size": 32, "n_epochs": 1}
REPLAY = {"learning_starts": 8}
ALGORITHMS: dict[str, tuple[Any, str, dict[str, Any]]] = {
    "PPO": (PPO, "MlpPolicy", SHORT),
    "PPO with gSDE": (PPO, "MlpPolicy", SHORT | {"use_sde": True}),
    "A2C": (A2C, "MlpPolicy", {}),
    "RecurrentPPO": (RecurrentPPO, "MlpLstmPolicy", SHORT),
    "SAC": (SAC, "MlpPolicy", REPLAY),
    "TD3": (TD3, "MlpPolicy", REPLAY),
    "DDPG": (DDPG, "MlpPolicy", REPLAY),
    "TQC": (TQC, "MlpPolicy", REPLAY),
    "CrossQ": (CrossQ, "MlpPolicy", REPLAY),
    "TRPO": (TRPO, "MlpPolicy", {"n_steps": 16, "batch_size": 64}),
    "ARS": (ARS, "MlpPolicy", {"n_delta": 2}),
    "linear ARS": (ARS, "LinearPolicy", {"n_delta": 2}),
}


def adapter(**options: Any) -> StableBaselinesVecEnv:
    return StableBaselinesVecEnv(gym.make_vec(ENV, num_envs=ROWS, max_episode_steps=20, **options))


def trained(name: str, env: VecEnv, activation: Any = torch.nn.Tanh) -> Any:
    algorithm, policy, settings = ALGORITHMS[name]
    network = {} if policy == "LinearPolicy" else {"net_arch": [8], "activation_fn": activation}
    model = algorithm(policy, env, policy_kwargs=network, seed=0, device="cpu", **settings)
    return model.learn(16 * ROWS)


def observed(rows: int = 5) -> np.ndarray:
    return np.random.default_rng(0).uniform(-3.0, 3.0, (rows, 11)).astype(np.float32)


def flown(path: Path, observations: np.ndarray) -> np.ndarray:
    agent = load_agent(path, gym.make(ENV))
    agent.reset(len(observations))
    return agent.act(observations)


@pytest.mark.slow
@pytest.mark.parametrize("name", ALGORITHMS)
def test_an_agent_of_any_algorithm_flies_as_it_was_trained(tmp_path: Path, name: str):
    model = trained(name, adapter())
    expected, _ = model.predict(observed(), deterministic=True)
    ours = save_agent(model, tmp_path / "ours")
    assert ours == tmp_path / "ours.npz"
    np.testing.assert_allclose(flown(ours, observed()), expected, rtol=0, atol=1e-6)
    model.save(theirs := tmp_path / "theirs.zip")
    with refused(ValueError, r"theirs\.zip was not saved by .* agents.save_agent\(model, path\)"):
        load_agent(theirs, gym.make(ENV))
    save_agent(model, theirs)  # beside it, where the name of the model finds it
    assert (tmp_path / "theirs.npz").read_bytes() == ours.read_bytes()
    np.testing.assert_array_equal(flown(theirs, observed()), flown(ours, observed()))


@pytest.mark.slow
@pytest.mark.parametrize("frames", [1, 3])
def test_statistics_of_observations_are_saved_and_frozen(tmp_path: Path, frames: int):
    def wrapped() -> VecEnv:
        env = VecNormalize(adapter(), clip_obs=0.5, epsilon=1e-3)
        return VecFrameStack(env, frames) if frames > 1 else env

    model = trained("PPO", wrapped())
    own, raw = model.get_env(), adapter()
    model.get_vec_normalize_env().training = False
    agent = load_agent(save_agent(model, tmp_path / "agent"), gym.make(ENV, max_episode_steps=20))
    for env in (own, raw):
        env.seed(3)
    seen, plain = own.reset(), raw.reset()
    agent.reset(ROWS)
    for _ in range(5):
        expected, _ = model.predict(seen, deterministic=True)
        actions = agent.act(plain)
        np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-6)
        seen, plain = own.step(expected)[0], raw.step(expected)[0]


@pytest.mark.parametrize("single", [False, True])
def test_normalised_rewards_make_no_difference(tmp_path: Path, single: bool):
    env = DummyVecEnv([lambda: gym.make(ENV)]) if single else adapter()
    model = trained("A2C", VecNormalize(env, norm_obs=False))
    expected, _ = model.predict(observed(), deterministic=True)
    path = save_agent(model, tmp_path / "agent")
    np.testing.assert_allclose(flown(path, observed()), expected, rtol=0, atol=1e-6)
    with refused(ValueError, "trained on observe='mean', this environment gives 'measurement'"):
        load_agent(path, gym.make(ENV, observe="measurement"))


class Mirrored(VecEnvWrapper):
    def reset(self) -> np.ndarray:
        return -self.venv.reset()

    def step_wait(self) -> Any:
        observations, *rest = self.venv.step_wait()
        return -observations, *rest


class Extractor(torch.nn.Flatten):
    """A user's own beginning of a network."""

    def __init__(self, space: gym.Space) -> None:
        super().__init__()
        self.features_dim = int(np.prod(space.shape))

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        return -seen


def test_what_cannot_be_stored_is_refused_before_writing(tmp_path: Path):
    batch = adapter().env
    batch.metadata = batch.metadata | {"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}
    wrapped = gym.wrappers.vector.TransformAction(batch, lambda action: -action)
    single = gym.wrappers.TransformObservation(gym.make(ENV), lambda seen: -seen, None)
    bare = PPO("MlpPolicy", adapter(), device="cpu")
    bare.env = None
    own = {"features_extractor_class": Extractor}
    cases: list[tuple[Any, str]] = [
        (PPO("MlpPolicy", Mirrored(adapter()), device="cpu"), "what Mirrored does to observations"),
        (PPO("MlpPolicy", StableBaselinesVecEnv(wrapped), device="cpu"), "what TransformAction"),
        (A2C("MlpPolicy", DummyVecEnv([lambda: single]), device="cpu"), "TransformObservation"),
        (PPO("MlpPolicy", VecNormalize(VecFrameStack(adapter(), 3)), device="cpu"), "VecFrameSta"),
        (
            PPO("MlpPolicy", adapter(), policy_kwargs=own, device="cpu"),
            "cannot store .* with reset",
        ),
        (trained("PPO", adapter(), torch.nn.Softsign), "cannot store .* with reset and act"),
        (PPO("MlpPolicy", "CartPole-v1", device="cpu"), "cannot store .* with reset and act"),
        (bare, "model.set_env"),
    ]
    for model, sentence in cases:
        with refused(ValueError, sentence):
            save_agent(model, tmp_path / "agent")
    with pytest.raises(TypeError, match="saves what stable-baselines3 trained, got 'agent'"):
        save_agent("agent", tmp_path / "agent")
    assert list(tmp_path.iterdir()) == []


# --- files that mean harm, or are broken ----------------------------------------------------------


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """One agent, as we save it and as stable-baselines3 does."""
    folder = tmp_path_factory.mktemp("checkpoints")
    model = trained("PPO", VecNormalize(adapter()))
    model.save(folder / "theirs.zip")
    return save_agent(model, folder / "ours"), folder / "theirs.zip"


def test_agent_of_another_environment_or_vehicle_is_refused(
    tmp_path: Path, checkpoints: tuple[Path, Path]
):
    """Ships of vehicle files have one id."""
    ship = "vessel_gym/Ship-v0"
    load_agent(checkpoints[0], gym.make(ship, vessel="corvette"))
    another = "trained in another environment: on observations of shape"
    for path, env, sentence in (
        (checkpoints[0], gym.make("ItsunusaAUV-v0"), rf"{another} \[11\] .*\[1\], not \[14\]"),
        (checkpoints[0], gym.make(ship, vessel="mariner"), f"another vehicle, that of {ENV}"),
    ):
        with refused(ValueError, sentence):
            load_agent(path, env)


class Payload:
    """Makes a folder, if there is none yet, when it is unpickled."""

    def __init__(self, canary: Path) -> None:
        self.canary = canary

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return os.makedirs, (str(self.canary), 0o777, True)


def test_a_model_of_stable_baselines3_runs_nothing(tmp_path: Path):
    canary = tmp_path / "canary"
    model = PPO("MlpPolicy", adapter(), device="cpu")
    model.verbose = Payload(canary)
    model.save(tmp_path / "agent.zip")
    with refused(ValueError, r"agent\.zip was not saved by"):
        load_agent(tmp_path / "agent.zip", gym.make(ENV))
    assert not canary.exists()


def described(arrays: dict[str, Any], **changed: Any) -> None:
    text = json.loads(str(arrays["description"]))
    text["policy"] |= changed
    arrays["description"] = np.array(json.dumps(text))


BROKEN: dict[str, Callable[[dict[str, Any], Path], Any]] = {
    "a weight missing": lambda a, _: a.pop("0.weight"),
    "weights that are not finite": lambda a, _: a.update({"0.bias": a["0.bias"] * np.nan}),
    "an unknown layer": lambda a, _: described(a, layers=["affine", "system", "affine"]),
    "a field of another version": lambda a, _: described(a, network={}),
    "other observations": lambda a, _: described(a, observations=[3]),
    "a description without a policy": lambda a, _: a.update(description=np.array("{}")),
} | {
    f"a payload as {name}": lambda a, canary, name=name: a.update(
        {name: np.array([Payload(canary)])}
    )
    for name in ("description", "0.weight", "more")
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_policy_is_refused_and_runs_nothing(
    tmp_path: Path, checkpoints: tuple[Path, Path], fault: str
):
    canary = tmp_path / "canary"
    pickle.loads(pickle.dumps(Payload(canary)))
    canary.rmdir()  # the payload works
    with np.load(checkpoints[0]) as file:
        arrays = dict(file)
    BROKEN[fault](arrays, canary)
    np.savez(tmp_path / "agent.npz", **arrays)
    with refused(ValueError, r"agent\.npz is not a checkpoint of an agent, or is damaged"):
        load_agent(tmp_path / "agent.npz", gym.make(ENV))
    assert not canary.exists()


def test_a_file_that_is_no_checkpoint_is_refused_in_a_sentence(
    tmp_path: Path, checkpoints: tuple[Path, Path]
):
    (tmp_path / "notes.txt").write_text("no checkpoint")
    (tmp_path / "empty.zip").write_bytes(b"")
    for whole in checkpoints:
        half = whole.read_bytes()[: whole.stat().st_size // 2]
        (tmp_path / f"half-{whole.name}").write_bytes(half)
    for path in tmp_path.iterdir():
        with refused(ValueError, f"{path.name} (is not a checkpoint|was not saved by)"):
            load_agent(path, gym.make(ENV))
