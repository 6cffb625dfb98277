"""One training with or without the truth for its critic, measured on the way, and the mistake that lets it leak."""

from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

from agents.policies.checkpoint import write
from agents.rollouts import rollout
from agents.seeds import evaluation_seeds
from agents.training.algorithms import batch, describe, learner

POINTS = 4
"""Number of evaluations of a training, each on the same seeds, which no training uses."""
HALF, END = POINTS // 2 - 1, POINTS - 1
EPISODES = 100


@dataclass(frozen=True, eq=False)
class World:
    """An environment in which agents learn."""

    label: str
    steps: int
    memory: str = "none"
    options: dict[str, Any] = field(default_factory=dict)
    arms: tuple[str, ...] = ("observation", "truth")
    env_id: str = "SigmaCorvette-v0"


def learned(world: World, arm: str, seed: int) -> dict[str, list[Any]]:
    """Train once, and measure on the way: scores ``(points, EPISODES)``, explained variance ``(points,)``."""
    from stable_baselines3.common.callbacks import BaseCallback

    critic = None if arm == "observation" else "truth"
    described = describe(world.env_id, world.options, seed, world.steps, world.memory, critic)
    measured: dict[str, list[Any]] = {"steps": [], "score": [], "zeroed": [], "explained": []}

    class Measure(BaseCallback):
        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            done = len(measured["steps"])
            if done < END and self.num_timesteps * POINTS >= world.steps * (done + 1):
                measure(self.model)

    def measure(model: Any) -> None:
        measured["steps"].append(model.num_timesteps)
        measured["explained"].append(explained(model, described))
        if arm == "leak":
            measured["score"].append(flown(model, described))
            measured["zeroed"].append(flown(model, described, zeroed=True))
        else:
            with TemporaryDirectory() as folder:
                checkpoint = Path(folder) / "agent.zip"
                write(checkpoint, model, described)
                flights = rollout(checkpoint, world.env_id, evaluation_seeds(EPISODES), world.options, record=False)
            measured["score"].append(flights.score.tolist())

    with leaking() if arm == "leak" else nullcontext(), learner(described) as model:
        model.learn(described["steps"], callback=Measure())
        measure(model)
    return measured


def flown(model: Any, described: dict[str, Any], zeroed: bool = False) -> list[float]:
    """Scores of an actor that may need the truth, or of which it is kept, on the seeds of the others' flights."""
    with closing(batch(described, EPISODES)) as env:
        env.seed(evaluation_seeds(EPISODES)[0])
        seen, score = env.reset(), np.full(EPISODES, np.nan)
        while np.isnan(score).any():
            if zeroed:
                seen[:, env.seen :] = 0.0
            seen, _, dones, infos = env.step(model.predict(seen, deterministic=True)[0])
            for i in np.flatnonzero(dones & np.isnan(score)):
                score[i] = infos[i]["score"]
    return score.tolist()


def explained(model: Any, described: dict[str, Any]) -> float:
    """Explained variance of a critic: of discounted returns, on flights from which nobody learned.

    The flights are those of its own actor, exploring. They go on for twice as long as an episode, of which the first
    half is looked at: what a return lacks at the end has a weight of less than gamma to the power of the episode's
    steps.
    """
    import torch
    from sb3_contrib.common.recurrent.type_aliases import RNNStates

    gamma, policy, recurrent = model.gamma, model.policy, described["memory"] == "lstm"
    horizon = model.get_env().get_attr("max_episode_steps")[0]
    longer = described | {"env_options": described["env_options"] | {"max_episode_steps": 2 * horizon}}
    rewards, values, alive = [], [], [np.ones(EPISODES, bool)]
    policy.set_training_mode(False)
    with closing(batch(longer, EPISODES)) as env, torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(0)
        env.seed(evaluation_seeds(EPISODES, EPISODES)[0])
        seen, starts = env.reset(), torch.ones(EPISODES)
        if recurrent:
            layers, _, size = policy.lstm_hidden_state_shape
            nothing = torch.zeros(2, 2, layers, EPISODES, size)
            states = RNNStates(*((one[0], one[1]) for one in nothing))
        for _ in range(2 * horizon):
            if recurrent:
                actions, value, _, states = policy(torch.as_tensor(seen), states, starts)
            else:
                actions, value, _ = policy(torch.as_tensor(seen))
            seen, reward, dones, _ = env.step(actions.clamp(-1.0, 1.0).numpy())
            starts = torch.as_tensor(dones, dtype=torch.float32)
            rewards.append(np.where(alive[-1], reward, 0.0))
            values.append(value[:, 0].numpy())
            alive.append(alive[-1] & ~dones)
    returns, later = [], np.zeros(EPISODES)
    for reward in reversed(rewards):
        later = reward + gamma * later
        returns.append(later)
    counts = np.array(alive[:horizon])
    true, judged = np.array(returns[::-1])[:horizon][counts], np.array(values)[:horizon][counts]
    return float(1.0 - np.var(true - judged) / np.var(true))


@contextmanager
def leaking() -> Iterator[None]:
    """The mistake of the page: what begins the critic's network begins the actor's, too."""
    from stable_baselines3.common.torch_layers import MlpExtractor

    from agents.training.critic import TruthPolicy

    class Leak(TruthPolicy):
        def _build_mlp_extractor(self) -> None:
            super()._build_mlp_extractor()
            self.pi_features_extractor = self.vf_features_extractor
            size = self.pi_features_extractor.features_dim
            whole = MlpExtractor(size, self.net_arch, self.activation_fn, self.device)
            self.mlp_extractor.policy_net = whole.policy_net

    with patch("agents.training.critic.TruthPolicy", Leak):
        yield
