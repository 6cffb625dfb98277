"""Checkpoints: what they carry, and that a file runs nothing unless the user says so."""

import base64
import io
import json
import os
import pickle
import sys
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
import torch
from refusals import refused
from sb3_contrib import ARS, TQC, TRPO, CrossQ, RecurrentPPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecEnv,
    VecEnvWrapper,
    VecFrameStack,
    VecNormalize,
)

from agents import load_agent, rollout, save_agent
from agents.commands import evaluate
from agents.commands.console import command
from agents.policies.agent import TrainedAgent
from agents.policies.checkpoint import packaged
from agents.policies.stable import entries
from agents.training.vec_env import StableBaselinesVecEnv

ENV = "SigmaCorvette-v0"
ROWS = 4
SHORT = {"n_steps": 16, "batch_size": 32, "n_epochs": 1}
ALGORITHMS = [
    (PPO, "MlpPolicy", SHORT),
    (PPO, "MlpPolicy", SHORT | {"use_sde": True}),
    (A2C, "MlpPolicy", {}),
    (RecurrentPPO, "MlpLstmPolicy", SHORT),
    (SAC, "MlpPolicy", {"learning_starts": 8}),
    (TD3, "MlpPolicy", {"learning_starts": 8}),
    (DDPG, "MlpPolicy", {"learning_starts": 8}),
    (TQC, "MlpPolicy", {"learning_starts": 8}),
    (CrossQ, "MlpPolicy", {"learning_starts": 8}),
    (TRPO, "MlpPolicy", {"n_steps": 16, "batch_size": 64}),
    (ARS, "MlpPolicy", {"n_delta": 2}),
    (ARS, "LinearPolicy", {"n_delta": 2}),
]
NAMES = [
    "PPO", "PPO with gSDE", "A2C", "RecurrentPPO", "SAC", "TD3", "DDPG", "TQC", "CrossQ", "TRPO", "ARS", "linear ARS",
]  # fmt: skip


def adapter(**options: Any) -> StableBaselinesVecEnv:
    return StableBaselinesVecEnv(gym.make_vec(ENV, num_envs=ROWS, max_episode_steps=20, **options))


def trained(algorithm: Any, policy: Any, settings: dict[str, Any], env: VecEnv) -> Any:
    network = {} if policy == "LinearPolicy" else {"net_arch": [8], "activation_fn": torch.nn.ELU}
    model = algorithm(policy, env, policy_kwargs=network, seed=0, device="cpu", **settings)
    return model.learn(16 * ROWS)


def observed(rows: int = 5, size: int = 11) -> np.ndarray:
    return np.random.default_rng(0).uniform(-3.0, 3.0, (rows, size)).astype(np.float32)


def flown(path: Path, observations: np.ndarray, **trust: bool) -> np.ndarray:
    agent = load_agent(path, gym.make(ENV), **trust)
    agent.reset(len(observations))
    return agent.act(observations)


@pytest.mark.slow
@pytest.mark.parametrize(("algorithm", "policy", "settings"), ALGORITHMS, ids=NAMES)
def test_an_agent_of_any_algorithm_flies_as_it_was_trained(
    tmp_path: Path, algorithm: Any, policy: str, settings: dict[str, Any]
):
    model = trained(algorithm, policy, settings, adapter())
    expected, _ = model.predict(observed(), deterministic=True)
    ours = save_agent(model, tmp_path / "ours")
    np.testing.assert_array_equal(flown(ours, observed()), expected)
    model.save(tmp_path / "theirs.zip")
    again, theirs = (
        algorithm.load(path, env=adapter(), device="cpu")
        for path in (ours, tmp_path / "theirs.zip")
    )
    assert entries(again) == entries(theirs)  # settings, networks and optimisers
    np.testing.assert_array_equal(again.predict(observed(), deterministic=True)[0], expected)
    assert again.num_timesteps == model.num_timesteps
    again.learn(16 * ROWS, reset_num_timesteps=False)
    np.testing.assert_array_equal(flown(tmp_path / "theirs.zip", observed(), trust=True), expected)
    with refused(
        ValueError, r"theirs\.zip was not saved by .* run whatever code .* say trust=True"
    ):
        load_agent(tmp_path / "theirs.zip", gym.make(ENV))


@pytest.mark.slow
@pytest.mark.parametrize(
    "order", ["statistics of a frame", "statistics of all frames", "statistics"]
)
def test_the_statistics_of_observations_fly_with_the_agent_and_stay_as_they_were(
    tmp_path: Path, order: str
):
    def wrapped() -> VecEnv:
        if order == "statistics of a frame":
            return VecFrameStack(VecNormalize(adapter(), clip_obs=3.0), 3)
        if order == "statistics of all frames":
            return VecNormalize(VecFrameStack(adapter(), 3), epsilon=1e-3)
        return VecNormalize(adapter())

    model = trained(PPO, "MlpPolicy", SHORT, wrapped())
    path = save_agent(model, tmp_path / "agent.zip")
    own = model.get_env()
    norm = model.get_vec_normalize_env()
    norm.training = False
    agent = load_agent(path, gym.make(ENV, max_episode_steps=20))
    raw = adapter()
    for env in (own, raw):
        env.seed(3)
    seen, plain = own.reset(), raw.reset()
    agent.reset(ROWS)
    for _ in range(5):
        expected, _ = model.predict(seen, deterministic=True)
        actions = agent.act(plain)
        np.testing.assert_array_equal(actions, expected)
        seen, plain = own.step(expected)[0], raw.step(actions)[0]
    agent.reset(ROWS)
    first = agent.act(raw.reset() + 5.0)
    agent.reset(ROWS)
    agent._policy.statistics.clear()
    assert np.abs(agent.act(raw.reset() + 5.0) - first).max() > 1e-3  # they matter
    one, other = (rollout(path, ENV, [1, 2], record=False) for _ in range(2))
    np.testing.assert_array_equal(one.score, other.score)


@pytest.mark.slow
def test_an_agent_that_stable_baselines3_saved_without_its_statistics_is_not_flown_without_them(
    tmp_path: Path,
):
    model = trained(PPO, "MlpPolicy", SHORT, VecNormalize(adapter()))
    model.save(tmp_path / "agent.zip")
    model.get_vec_normalize_env().save(str(tmp_path / "statistics.pkl"))
    with refused(ValueError, r"trained under VecNormalize, whose statistics .*save_agent"):
        load_agent(tmp_path / "agent.zip", gym.make(ENV), trust=True)

    again = PPO.load(
        tmp_path / "agent.zip", env=VecNormalize.load(str(tmp_path / "statistics.pkl"), adapter())
    )
    one, other = (flown(save_agent(who, tmp_path / "ours"), observed()) for who in (model, again))
    np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_rewards_that_were_normalised_are_no_matter_of_the_flight(tmp_path: Path):
    model = trained(PPO, "MlpPolicy", SHORT, VecNormalize(adapter(), norm_obs=False))
    expected, _ = model.predict(observed(), deterministic=True)
    np.testing.assert_array_equal(
        flown(save_agent(model, tmp_path / "agent"), observed()), expected
    )


@pytest.mark.slow
def test_an_agent_from_a_single_environment_is_stored_as_one_from_a_batch(tmp_path: Path):
    model = trained(A2C, "MlpPolicy", {}, DummyVecEnv([lambda: gym.make(ENV)]))
    expected, _ = model.predict(observed(), deterministic=True)
    path = save_agent(model, tmp_path / "agent")
    np.testing.assert_array_equal(flown(path, observed()), expected)
    with refused(ValueError, "trained on observe='mean', this environment gives 'measurement'"):
        load_agent(path, gym.make(ENV, observe="measurement"))


class OwnPolicy(ActorCriticPolicy):
    """A user's own network."""


class Mirrored(VecEnvWrapper):
    def reset(self) -> np.ndarray:
        return -self.venv.reset()

    def step_wait(self) -> Any:
        observations, *rest = self.venv.step_wait()
        return -observations, *rest


@pytest.mark.slow
def test_what_cannot_be_stored_in_numbers_and_words_is_refused_before_anything_is_written(
    tmp_path: Path,
):
    batch = adapter().env
    batch.metadata = batch.metadata | {"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}
    wrapped = gym.wrappers.vector.TransformAction(batch, lambda action: -action)
    single = gym.wrappers.TransformObservation(gym.make(ENV), lambda seen: -seen, None)
    cases: list[tuple[Any, str]] = [
        (
            trained(PPO, "MlpPolicy", SHORT, Mirrored(adapter())),
            "what Mirrored does to observations",
        ),
        (
            PPO("MlpPolicy", StableBaselinesVecEnv(wrapped), device="cpu"),
            "what TransformAction does",
        ),
        (
            trained(A2C, "MlpPolicy", {}, DummyVecEnv([lambda: single])),
            "what TransformObservation does",
        ),
        (trained(PPO, OwnPolicy, SHORT, adapter()), "cannot store a .*OwnPolicy.* trust=True"),
        (
            PPO("MlpPolicy", "CartPole-v1", device="cpu"),
            "observations and actions are vectors of numbers are stored",
        ),
    ]
    own = PPO(
        "MlpPolicy", adapter(), policy_kwargs={"features_extractor_class": Extractor}, device="cpu"
    )
    cases.append((own, "cannot store policy_kwargs.'features_extractor_class'.* trust=True"))
    bare = trained(PPO, "MlpPolicy", SHORT, adapter())
    bare.env = None
    cases.append((bare, "model.set_env"))
    for model, sentence in cases:
        with refused(ValueError, sentence):
            save_agent(model, tmp_path / "agent.zip")
    with pytest.raises(
        TypeError, match="save_agent saves what stable-baselines3 trained, got 'agent'"
    ):
        save_agent("agent", tmp_path / "agent.zip")
    assert list(tmp_path.iterdir()) == []


class Extractor(torch.nn.Flatten):
    """A user's own beginning of a network."""

    def __init__(self, space: gym.Space) -> None:
        super().__init__()
        self.features_dim = int(np.prod(space.shape))


def test_an_agent_of_another_environment_is_answered_in_a_sentence(tmp_path: Path):
    path = save_agent(trained(PPO, "MlpPolicy", SHORT, adapter()), tmp_path / "agent")
    balancing = DQN("MlpPolicy", "CartPole-v1", device="cpu")
    balancing.save(tmp_path / "cart.zip")
    for name, env, sentence in (
        (
            path,
            "ItsunusaAUV-v0",
            r"trained in another environment: .* shape \(11,\) .*\(1,\), not \(14,\) and \(2,\)",
        ),
        (
            tmp_path / "cart.zip",
            ENV,
            r"trained in another environment: .* shape \(4,\) .*\(\), not \(11,\) and \(1,\)",
        ),
    ):
        with refused(ValueError, sentence):
            load_agent(name, gym.make(env), trust=True)


# --- files that mean harm, or are broken ----------------------------------------------------------


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """One agent, as we save it and as stable-baselines3 does."""
    folder = tmp_path_factory.mktemp("checkpoints")
    model = trained(PPO, "MlpPolicy", SHORT, VecNormalize(adapter()))
    model.save(folder / "theirs.zip")
    ours = save_agent(model, folder / "ours.zip")
    flown(ours, observed())
    return ours, folder / "theirs.zip"


class Payload:
    """What makes a folder, if there is none yet, when it is unpickled."""

    def __init__(self, canary: Path) -> None:
        self.canary = canary

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return os.makedirs, (str(self.canary), 0o777, True)


def changed(source: Path, target: Path, change: Callable[[dict[str, bytes]], None]) -> Path:
    with zipfile.ZipFile(source) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    change(content)
    with zipfile.ZipFile(target, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return target


def serialized(payload: Payload) -> dict[str, str]:
    return {":type:": "int", ":serialized:": base64.b64encode(cloudpickle.dumps(payload)).decode()}


def pickled_array(payload: Payload) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.array([payload], dtype=object), allow_pickle=True)
    return buffer.getvalue()


def torch_file(payload: Payload) -> bytes:
    buffer = io.BytesIO()
    torch.save({"payload": payload}, buffer)
    return buffer.getvalue()


def settings(content: dict[str, bytes], change: Callable[[dict[str, Any]], Any]) -> None:
    described = json.loads(content["vessel_gym.json"])
    change(described["policy"])
    content["vessel_gym.json"] = json.dumps(described).encode()


HARM: dict[str, Callable[[dict[str, bytes], Payload], Any]] = {
    "data": lambda c, p: c.update(data=json.dumps(json.loads(c.get("data", b"{}")) | {"n": serialized(p)}).encode()),
    "a network in data": lambda c, p: c.update(data=json.dumps({"policy_class": serialized(p)}).encode()),
    "policy.pth": lambda c, p: c.update({"policy.pth": torch_file(p)}),
    "variables": lambda c, p: c.update({"pytorch_variables.pth": pickle.dumps(p)}),
    "weights": lambda c, p: c.update({"weights/log_std.npy": pickled_array(p)}),
    "statistics": lambda c, p: c.update({"statistics/mean.npy": pickled_array(p)}),
    "settings": lambda c, p: c.update({"vessel_gym.json": json.dumps({"policy": serialized(p)}).encode()}),
    "a network": lambda c, p: settings(c, lambda policy: policy["network"].update(net_arch=serialized(p)))
    if "vessel_gym.json" in c else None,
}  # fmt: skip


@pytest.mark.parametrize("whose", ["ours", "theirs"])
@pytest.mark.parametrize("place", HARM)
def test_a_doctored_checkpoint_runs_nothing(
    tmp_path: Path, checkpoints: tuple[Path, Path], place: str, whose: str
):
    canary = tmp_path / "canary"
    pickle.loads(pickle.dumps(Payload(canary)))
    assert canary.exists()  # the payload works
    canary.rmdir()
    source = checkpoints[("ours", "theirs").index(whose)]
    path = changed(
        source, tmp_path / "agent.zip", lambda content: HARM[place](content, Payload(canary))
    )
    with suppress(ValueError):
        agent = load_agent(path, gym.make(ENV))
        agent.reset(1)
        agent.act(observed(1))
    assert not canary.exists()


def test_a_command_loads_what_is_not_ours_only_with_its_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    canary = tmp_path / "canary"
    model = PPO("MlpPolicy", adapter(), device="cpu")
    model.verbose = Payload(canary)
    model.save(tmp_path / "agent.zip")
    line = ["evaluate", "--agent", str(tmp_path / "agent.zip"), "--episodes", "1"]
    monkeypatch.setattr(sys, "argv", line)
    with pytest.raises(SystemExit) as stop:
        command(evaluate.main)
    assert stop.value.code == 2
    assert "--trust on a command line" in capsys.readouterr().err
    assert not canary.exists()
    monkeypatch.setattr(sys, "argv", [*line, "--trust"])
    command(evaluate.main)
    assert "Score" in capsys.readouterr().out
    assert canary.exists()


def array(values: Any) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asarray(values))
    return buffer.getvalue()


BROKEN: dict[str, Callable[[dict[str, bytes]], Any]] = {
    "no weights": lambda c: [c.pop(name) for name in list(c) if name.startswith("weights/")],
    "a weight missing": lambda c: c.pop("weights/log_std.npy"),
    "weights of another size": lambda c: settings(c, lambda policy: policy["network"].update(net_arch=[9])),
    "no settings of the network": lambda c: settings(c, lambda policy: policy.pop("network")),
    "an unknown policy": lambda c: settings(c, lambda policy: policy.update({"class": "os.system"})),
    "an activation that is none": lambda c: settings(c, lambda policy: policy["network"].update(activation_fn="init")),
    "weights beyond single precision": lambda c: c.update({"weights/action_net.bias.npy": array([1e300])}),
    "whole numbers for weights": lambda c: c.update({"weights/action_net.bias.npy": array([1])}),
    "statistics that divide by zero": lambda c: (
        c.update({"statistics/var.npy": array(np.zeros(11))}), settings(c, lambda policy: policy.update(epsilon=0.0))
    ),
    "a negative bound": lambda c: settings(c, lambda policy: policy.update(clip=-1.0)),
    "no frames": lambda c: settings(c, lambda policy: policy.update(frames=0)),
    "statistics of something else": lambda c: c.update({"statistics/mean.npy": c["weights/log_std.npy"]}),
    "settings that are no JSON": lambda c: c.update({"vessel_gym.json": b"{"}),
    "a policy that is no table": lambda c: c.update({"vessel_gym.json": b'{"policy": 3}'}),
    "weights that are not finite": lambda c: c.update(
        {"weights/log_std.npy": c["weights/log_std.npy"][:-4] + b"\xff" * 4}
    ),
}  # fmt: skip


LAST, LAYER = "weights/action_net.weight.npy", "weights/mlp_extractor.policy_net.{}.{}.npy"
DENSE: dict[str, Callable[[dict[str, bytes]], Any]] = {
    "a layer missing": lambda c: c.pop(LAST),
    "another network": lambda c: settings(c, lambda policy: policy["network"].update(activation_fn="ReLU")),
    "another observation": lambda c: settings(c, lambda policy: policy.update(observations=3)),
} | {
    f"a row of {name}": lambda c, name=name: c.update({name: array(np.load(io.BytesIO(c[name]))[:1])})
    for name in (LAYER.format(0, "weight"), LAYER.format(0, "bias"), LAYER.format(2, "bias"))
}  # fmt: skip
"""Faults of a policy that comes with the package and flies without torch."""


@pytest.mark.parametrize("fault", [*BROKEN, *DENSE])
def test_a_damaged_checkpoint_is_refused_in_a_sentence(
    tmp_path: Path, checkpoints: tuple[Path, Path], fault: str
):
    path, dense = tmp_path / "agent.zip", fault in DENSE
    changed(
        packaged(ENV) if dense else checkpoints[0], path, DENSE[fault] if dense else BROKEN[fault]
    )
    with refused(ValueError, r"agent\.zip is not a checkpoint of an agent, or is damaged"):
        TrainedAgent(path, gym.make(ENV), dense=True) if dense else load_agent(path, gym.make(ENV))


LARGE: dict[str, Callable[[dict[str, bytes]], Any]] = {
    "wide layers": lambda c: settings(c, lambda policy: policy["network"].update(net_arch=[3000, 3000])),
    "many layers": lambda c: settings(c, lambda policy: policy["network"].update(net_arch=[8] * 5000)),
    "wide layers beside a long array": lambda c: (
        c.update({"weights/action_net.bias.npy": array(np.zeros(3000, np.float32))}),
        settings(c, lambda policy: policy["network"].update(net_arch=[3000, 3000])),
    ),
    "a memory": lambda c: (
        c.update({"weights/action_net.bias.npy": array(np.zeros(1500, np.float32))}),
        settings(c, lambda policy: policy.update({"class": "LstmPolicy"})),
        settings(c, lambda policy: policy["network"].update(lstm_hidden_size=1500)),
    ),
    "observations": lambda c: settings(c, lambda policy: policy.update(observations=10**7)),
    "actions": lambda c: settings(c, lambda policy: policy.update(actions=10**7)),
}  # fmt: skip


@pytest.mark.parametrize("what", LARGE)
def test_sizes_are_compared_with_the_weights_before_anything_is_built(
    tmp_path: Path, checkpoints: tuple[Path, Path], what: str
):
    path = changed(checkpoints[0], tmp_path / "agent.zip", LARGE[what])
    with pytest.raises(
        ValueError, match=r"agent\.zip .*describes a larger network than its weights are of"
    ):
        load_agent(path, gym.make(ENV))


def test_entries_many_times_as_large_as_the_file_are_not_unpacked(
    tmp_path: Path, checkpoints: tuple[Path, Path]
):
    path = tmp_path / "agent.zip"
    path.write_bytes(checkpoints[0].read_bytes())
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("weights/more.npy", array(np.zeros(10**6)))
    with pytest.raises(ValueError, match=r"agent\.zip .*its entries hold \d+ bytes"):
        load_agent(path, gym.make(ENV))


@pytest.mark.slow
def test_an_agent_of_another_vehicle_of_equal_shape_is_refused(checkpoints: tuple[Path, Path]):
    """Ships of vehicle files have one id."""
    ship = "vessel_gym/Ship-v0"
    load_agent(checkpoints[0], gym.make(ship, vessel="corvette"))
    with pytest.raises(
        ValueError, match=rf"ours\.zip was trained on another vehicle, that of {ENV}: fly it there"
    ):
        load_agent(checkpoints[0], gym.make(ship, vessel="mariner"))


@pytest.mark.parametrize("trust", [False, True])
def test_a_file_that_is_no_checkpoint_is_refused_in_a_sentence(
    tmp_path: Path, checkpoints: tuple[Path, Path], trust: bool
):
    text, empty, other = tmp_path / "notes.txt", tmp_path / "empty.zip", tmp_path / "other.zip"
    text.write_text("no checkpoint")
    empty.write_bytes(b"")
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("readme", "something else")
    files = [text, empty, other]
    for whole in checkpoints:
        for share in (3, 2):
            files.append(tmp_path / f"{share}-{whole.name}")
            files[-1].write_bytes(whole.read_bytes()[: -whole.stat().st_size // share])
    for path in files:
        with refused(ValueError, f"{path.name} is not a checkpoint of an agent"):
            load_agent(path, gym.make(ENV), trust)
    path = tmp_path / "dense.zip"
    path.write_bytes(packaged(ENV).read_bytes()[:-1000])
    with refused(ValueError, r"dense\.zip is not a checkpoint of an agent"):
        TrainedAgent(path, gym.make(ENV), trust, dense=True)
