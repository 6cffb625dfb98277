"""The truth for the critic alone: the actor has no input for it, in the network, the learning and the flight."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from refusals import refused
from sb3_contrib.common.recurrent.type_aliases import RNNStates
from short_training import STEPS, TINY
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

import agents.training.algorithms
import agents.training.critic
from agents import load_agent, rollout, save_agent
from agents.training.algorithms import MEMORIES, train
from agents.training.critic import TruthLstmPolicy, TruthPolicy, TruthVecEnv
from agents.training.vec_env import StableBaselinesVecEnv
from studies.critic.benchmark import leaking

ENV = "SigmaCorvette-v0"
RAW = {"observe": "measurement", "estimator": "measurement"}
VEHICLES = ("SigmaCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0", "ThesisCorvette-v0")
SEEN, TRUTH, ROWS = 5, 4, 6
FRAMES = {"none": 1, "frames": 3, "lstm": 1}


# --- the network --------------------------------------------------------------------------------------


def policy_of(kind: type, frames: int = 1) -> Any:
    space = gym.spaces.Box(-10.0, 10.0, (frames * (SEEN + TRUTH),), np.float32)
    network: dict[str, Any] = {"lstm_hidden_size": 4} if issubclass(kind, TruthLstmPolicy) else {}
    torch.manual_seed(0)
    done = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
    return kind(space, done, lambda _: 1e-3, net_arch=[8], seen=SEEN, truth=TRUTH, frames=frames, **network)


@torch.no_grad()
def outputs(policy: Any, observations: np.ndarray, truths: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """All that an actor gives for observations ``(steps, rows, frames, seen)`` beside truths, and the critic's values.

    Sampled with the same seed. An actor that remembers goes through the steps one by one, and then again in one batch
    of sequences, as when it learns.
    """
    whole = torch.as_tensor(np.concatenate([observations, truths], -1)).flatten(-2)
    recurrent = isinstance(policy, TruthLstmPolicy)
    rows, begun = whole.shape[1], torch.zeros(whole.shape[1])
    nothing: Any = None
    if recurrent:
        layers, _, size = policy.lstm_hidden_state_shape
        nothing = RNNStates(*((torch.zeros(layers, rows, size), torch.zeros(layers, rows, size)) for _ in range(2)))
    given, values = {}, []
    for how in ("deterministic", "sampled"):
        torch.manual_seed(1)
        states = nothing
        for step, seen in enumerate(whole):
            memory = (states, begun) if recurrent else ()
            action, value, log_prob, *after = policy(seen, *memory, deterministic=how == "deterministic")
            distribution = policy.get_distribution(seen, *((states.pi, begun) if recurrent else ()))
            normal = (distribution[0] if recurrent else distribution).distribution
            given_now = {"action": action, "log-probability": log_prob, "mean": normal.mean, "spread": normal.stddev}
            if recurrent:
                states = after[0]
                given_now |= {"hidden": states.pi[0], "cell": states.pi[1]}
            given |= {f"{name}, {how}, step {step}": each for name, each in given_now.items()}
            values.append(value)
    batch = whole.swapaxes(0, 1).flatten(0, 1)
    taken = torch.linspace(-1.0, 1.0, len(batch))[:, None].repeat(1, *policy.action_space.shape)
    value, log_prob, entropy = policy.evaluate_actions(
        batch, taken, *((nothing, torch.zeros(len(batch))) if recurrent else ())
    )
    given |= {"log-probability, learning": log_prob, "entropy, learning": entropy}
    return {name: each.numpy() for name, each in given.items()}, torch.cat([*values, value]).numpy()


FILLINGS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "zeros": np.zeros_like,
    "other numbers": lambda truth: np.random.default_rng(2).uniform(-10.0, 10.0, truth.shape).astype(np.float32),
    "huge numbers": lambda truth: np.full_like(truth, 1e30),
    "infinity": lambda truth: np.full_like(truth, np.inf),
    "NaN, which passes through a weight of 0, too": lambda truth: np.full_like(truth, np.nan),
}


def leaks(policy: Any, seen: int = SEEN, truth: int = TRUTH, frames: int = 1) -> set[str]:
    """What of an actor's outputs is not the same, bit for bit, for every critic's input."""
    policy.set_training_mode(False)
    rng = np.random.default_rng(1)
    observations = rng.uniform(-3.0, 3.0, (3, ROWS, frames, seen)).astype(np.float32)
    truths = rng.uniform(-3.0, 3.0, (3, ROWS, frames, truth)).astype(np.float32)
    expected, values = outputs(policy, observations, truths)
    found = {name for name, each in expected.items() if not np.isfinite(each).all()}
    assert np.isfinite(values).all()
    for filling, fill in FILLINGS.items():
        try:
            given, judged = outputs(policy, observations, fill(truths))
        except ValueError:  # torch makes no distribution of what is not a number
            found.add(f"distribution, {filling}")
            continue
        assert (judged != values).all()  # it does reach the critic
        found |= {name for name, each in given.items() if each.tobytes() != expected[name].tobytes()}
    return found


@pytest.mark.parametrize("memory", MEMORIES)
def test_the_actor_s_outputs_do_not_depend_on_the_critic_s_input_bit_for_bit(memory: str):
    policy = policy_of(TruthLstmPolicy if memory == "lstm" else TruthPolicy, FRAMES[memory])
    assert leaks(policy, frames=FRAMES[memory]) == set()


@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize("memory", ["none", pytest.param("frames", marks=pytest.mark.slow), "lstm"])
def test_and_after_it_has_learned(tmp_path: Path, saved: list[Any], memory: str):
    train(ENV, tmp_path / "agent.zip", RAW, steps=STEPS, memory=memory, critic="truth")
    batch = saved[0].get_env()
    assert leaks(saved[0].policy, batch.seen, batch.truth, FRAMES[memory]) == set()


class WithoutGain(TruthPolicy):
    """The truth comes to the actor, through weights of 0."""

    def __init__(self, *spaces: Any, **network: Any) -> None:
        super().__init__(*spaces, **network)
        self.side = torch.nn.Linear(TRUTH, 2, bias=False)
        torch.nn.init.zeros_(self.side.weight)

    def forward(self, seen: torch.Tensor, deterministic: bool = False) -> Any:
        action, value, log_prob = super().forward(seen, deterministic)
        return action + self.side(seen[:, SEEN:]), value, log_prob


class Spread(TruthPolicy):
    """The actor's exploration, not its mean, depends on the critic's input."""

    def forward(self, seen: torch.Tensor, deterministic: bool = False) -> Any:
        self.log_std.copy_(0.1 * seen[:, SEEN].mean())
        return super().forward(seen, deterministic)


class Tail(TruthPolicy):
    """The actor takes the last columns for its own."""

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        first = self.pi_features_extractor.forward
        self.pi_features_extractor.forward = lambda seen: first(seen.flip(-1))  # type: ignore[method-assign]


class Remembered(TruthLstmPolicy):
    """The actor goes on from the critic's memory: nothing shows at the first step."""

    def forward(self, seen: Any, states: Any, starts: Any, deterministic: bool = False) -> Any:
        *given, after = super().forward(seen, states, starts, deterministic)
        return *given, RNNStates(after.vf, after.vf)


class Learned(TruthPolicy):
    """What acts is clean, and what learns is not."""

    def evaluate_actions(self, seen: Any, actions: torch.Tensor) -> Any:
        value, log_prob, entropy = super().evaluate_actions(seen, actions)
        return value, log_prob + 0.1 * seen[:, -1], entropy


@pytest.mark.parametrize("mutant", [WithoutGain, Spread, Tail, Remembered, Learned])
def test_a_policy_that_leaks_is_found(mutant: type):
    found = leaks(policy_of(mutant))
    assert found
    one_mean = {name for name in found if name.startswith("mean") and name.endswith("step 0")}
    assert bool(one_mean) == (mutant is Tail)  # the plain question would see this one alone


def test_the_leak_of_the_page_is_found_in_all_that_the_actor_does():
    with leaking():
        policy = policy_of(agents.training.critic.TruthPolicy)
    found = leaks(policy)
    assert {name.split(",")[0] for name in found} == {"action", "log-probability", "mean", "distribution"}
    assert "log-probability, learning" in found


@pytest.mark.parametrize("kind", [TruthPolicy, TruthLstmPolicy])
def test_neither_learns_by_the_other_s_error(kind: type):
    policy = policy_of(kind)
    rows = torch.rand(ROWS, SEEN + TRUTH, requires_grad=True)
    memory: tuple[Any, ...] = ()
    if kind is TruthLstmPolicy:
        memory = RNNStates(*((torch.zeros(1, 1, 4), torch.zeros(1, 1, 4)) for _ in range(2))), torch.zeros(ROWS)
    values, log_prob, _ = policy.evaluate_actions(rows, torch.rand(ROWS, 2), *memory)
    moved = {}
    for name, loss in (("critic", values), ("actor", log_prob)):
        policy.zero_grad()
        rows.grad = None
        loss.sum().backward(retain_graph=True)
        moved[name] = {key for key, each in policy.named_parameters() if each.grad is not None}
        felt = rows.grad[:, SEEN:].abs().sum().item()
        assert (felt > 0.0) == (name == "critic")
    assert not moved["actor"] & moved["critic"]
    assert moved["actor"] | moved["critic"] == {key for key, _ in policy.named_parameters()}
    assert {id(each) for group in policy.optimizer.param_groups for each in group["params"]} == {
        id(each) for each in policy.parameters()
    }  # and all of them are learned


# --- the critic's input --------------------------------------------------------------------------


def beside(rows: int = ROWS, env_id: str = ENV, **options: Any) -> TruthVecEnv:
    return TruthVecEnv(gym.make_vec(env_id, num_envs=rows, **options))


def leaning(steps: int, size: int, rows: int = ROWS) -> np.ndarray:
    """Actions that end some episodes early."""
    rng = np.random.default_rng(3)
    lean = np.where(np.arange(rows) % 2, 1.0, 0.0)[:, None]
    return np.clip(lean + rng.normal(0.0, 0.2, (steps, rows, size)), -1.0, 1.0).astype(np.float32)


@pytest.mark.parametrize("env_id", VEHICLES)
def test_the_critic_s_input_is_the_observation_of_the_oracle(env_id: str):
    env = beside(env_id=env_id, estimator="truth", disturbance="rough", max_episode_steps=15)
    env.seed(5)
    seen = env.reset()
    assert env.seen == env.truth
    for action in leaning(40, env.action_space.shape[0]):
        np.testing.assert_allclose(seen[:, env.seen :], seen[:, : env.seen], rtol=1e-5, atol=1e-5)
        seen, _, dones, infos = env.step(action)
        for i in np.flatnonzero(dones):
            end = infos[i]["terminal_observation"]
            np.testing.assert_allclose(end[env.seen :], end[: env.seen], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("options", [{}, RAW, {"observe": "mean+std"}, {"observe": "measurement", "guidance": True}])
def test_the_agent_s_part_and_all_else_is_that_of_the_plain_adapter(options: dict[str, Any]):
    plain = StableBaselinesVecEnv(gym.make_vec(ENV, num_envs=ROWS, max_episode_steps=30, **options))
    env = beside(max_episode_steps=30, **options)
    assert env.observation_space.shape == (env.seen + env.truth,)
    for each in (plain, env):
        each.seed(7)
    expected, seen = plain.reset(), env.reset()
    ended = 0
    for action in leaning(70, 1):
        assert env.observation_space.contains(seen[0])
        np.testing.assert_array_equal(seen[:, : env.seen], expected)
        expected, *others, infos = plain.step(action)
        seen, *theirs, other_infos = env.step(action)
        for one, other in zip(others, theirs, strict=True):
            np.testing.assert_array_equal(one, other)
        for one, other in zip(infos, other_infos, strict=True):
            assert one.keys() == other.keys()
            if one:
                ended += 1
                np.testing.assert_array_equal(other["terminal_observation"][: env.seen], one["terminal_observation"])
                assert one["TimeLimit.truncated"] == other["TimeLimit.truncated"]
                assert one["score"] == other["score"]
    assert ended >= 2 * ROWS


def test_the_critic_s_input_does_not_depend_on_the_agent_s():
    """Under measurements, too, and whichever estimator is named: what is true depends on the actions alone."""
    truths_of = []
    for options in ({}, RAW, {"estimator": "ekf"}, {"estimator": "dead-reckoning", "observe": "mean+std"}):
        env = beside(**options)
        env.seed(7)
        truths = [env.reset()[:, env.seen :]]
        truths += [env.step(action)[0][:, env.seen :] for action in leaning(30, 1)]
        truths_of.append(np.stack(truths))
    for other in truths_of[1:]:
        np.testing.assert_array_equal(other, truths_of[0])


def test_at_an_episode_s_end_the_critic_s_input_is_of_this_episode_and_not_of_the_next():
    short, longer = beside(max_episode_steps=20), beside(max_episode_steps=21)
    for env in (short, longer):
        env.seed(7)
        env.reset()
    for action in leaning(20, 1) * 0.1:
        seen, _, dones, infos = short.step(action)
        expected = longer.step(action)[0]
    assert dones.all()
    np.testing.assert_array_equal(np.stack([info["terminal_observation"] for info in infos]), expected)
    assert (np.abs(seen - expected)[:, short.seen :].max(-1) > 1e-3).all()


def test_frames_have_the_truth_of_their_own_moment_beside_them():
    env, stacked = beside(), VecFrameStack(beside(), 3)
    for each in (env, stacked):
        each.seed(7)
    seen, frames = env.reset(), stacked.reset()
    lived = [np.zeros_like(seen)] * 2 + [seen]
    for action in leaning(6, 1):
        np.testing.assert_array_equal(frames, np.concatenate(lived[-3:], -1))
        lived.append(env.step(action)[0])
        frames = stacked.step(action)[0]
    actor = TruthPolicy(
        stacked.observation_space, env.action_space, lambda _: 0.0, seen=env.seen, truth=env.truth, frames=3
    ).pi_features_extractor
    own = np.concatenate([each[:, : env.seen] for each in lived[-3:]], -1)
    np.testing.assert_array_equal(actor(torch.as_tensor(frames)).numpy(), own)
    np.testing.assert_array_equal(actor(torch.as_tensor(own)).numpy(), own)  # in flight


def test_an_end_that_is_overwritten_is_refused_in_a_sentence(tmp_path: Path):
    batch = gym.make_vec(ENV, num_envs=2, autoreset_mode=AutoresetMode.SAME_STEP)
    with refused(ValueError, "critic='truth' asks for the truth at the end of an episode"):
        TruthVecEnv(batch)


# --- training and flight ------------------------------------------------------------------------------


@pytest.mark.usefixtures("tiny")
def test_what_flies_depends_on_nothing_that_is_the_critic_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Flown with the critic's weights not a number, and with whoever asks for the truth refused."""
    path = train(ENV, tmp_path / "agent.zip", steps=STEPS, critic="truth")
    expected = rollout(str(path), ENV, [1, 2], record=False)
    monkeypatch.setattr(agents.training.critic, "oracle_view", lambda core: pytest.fail("it asked for the truth"))
    agent = load_agent(path, gym.make(ENV))
    network = agent._policy.network
    with torch.no_grad():
        for name, each in network.named_parameters():
            if "value_net" in name:
                each.fill_(torch.nan)
    np.testing.assert_array_equal(rollout(agent, ENV, [1, 2], record=False).score, expected.score)


@pytest.mark.usefixtures("tiny")
def test_an_agent_saved_by_hand_and_one_that_stable_baselines3_saved_fly_alike(tmp_path: Path, saved: list[PPO]):
    train(ENV, tmp_path / "agent.zip", steps=STEPS, critic="truth")
    saved[0].save(tmp_path / "theirs.zip")
    env = beside()
    again = PPO.load(tmp_path / "theirs.zip", env=env, device="cpu")
    ours = save_agent(again, tmp_path / "ours.zip")
    one, other = (rollout(str(path), ENV, [1, 2], record=False) for path in (ours, tmp_path / "agent.zip"))
    np.testing.assert_array_equal(one.score, other.score)


@pytest.mark.usefixtures("tiny")
def test_statistics_of_the_truth_are_no_agent_s(tmp_path: Path, saved: list[PPO]):
    train(ENV, tmp_path / "agent.zip", steps=STEPS, critic="truth")
    model = saved[0]
    model.env = None
    model.set_env(VecNormalize(beside(TINY["num_envs"])))
    with refused(ValueError, r"VecNormalize.* critic"):
        save_agent(model, tmp_path / "normalised.zip")


@pytest.mark.parametrize("critic", ["truht", "oracle", "", "none", True, 1, ["truth"]])
def test_another_critic_is_refused_in_a_sentence_before_anything_is_made(tmp_path: Path, critic: Any):
    with refused(ValueError, r"critic must be 'truth', or None .*, got"):
        train(ENV, tmp_path / "agent.zip", critic=critic)
    assert list(tmp_path.iterdir()) == []
