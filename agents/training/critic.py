"""The truth for the critic alone: it judges by the truth what an actor does that never sees it (docs/critic.md).

The critic's input stands beside the agent's observation, and the networks part them again: what the actor computes has
no term in which the truth occurs. The environment knows nothing of all this.

Sources: Pinto et al. (2018), "Asymmetric actor critic for image-based robot learning"; Baisero and Amato (2022),
"Unbiased asymmetric reinforcement learning under partial observability", for why the critic sees what the agent sees,
too: how much a true state is worth depends on what an agent that does not know it believes.
"""

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, FlattenExtractor, MlpExtractor

from agents.policies.lstm import LstmPolicy
from agents.training.vec_env import StableBaselinesVecEnv
from vessel_gym.core import Core
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.tasks.task import Estimate


def oracle_view(core: Core) -> np.ndarray:
    """Observations in mode ``"mean"`` of the oracle as the estimator ``(B, m)``, float32.

    The task's own view of the true state, flow and unknown input: of order 1 already, and bounded.
    """
    task, vehicle = core.task, core.vehicle
    state = core.state[:, [vehicle.state_names.index(name) for name in vehicle.estimated(vehicle.kinds[0])]]
    flow = core.exogenous[:, len(vehicle.increments) : len(vehicle.increments) + len(vehicle.ambient_flows)]
    true = Estimate(state, flow, np.nan_to_num(core.unknown_input))  # NaN is what only a filter thinks there is
    seen = task.observe(true, task.reference(core.scenario, core.steps, state), core.actuators)
    return np.clip(seen, -task.BOUND, task.BOUND).astype(np.float32)


class TruthVecEnv(StableBaselinesVecEnv):
    """A batch whose observations ``(B, seen + truth)`` are the agent's, and beside them what its critic may know.

    Args:
        env: The batch, not wrapped.
        reward_scale: Factor of the rewards that are learned from.

    Raises:
        ValueError: for ``SAME_STEP`` autoreset, which leaves nothing of the truth in which an episode ended.
    """

    def __init__(self, env: VesselVectorEnv, reward_scale: float = 1.0) -> None:
        super().__init__(env, reward_scale)
        if not self._resets:
            raise ValueError(
                "critic='truth' asks for the truth at the end of an episode, which autoreset_mode='SameStep' has "
                "overwritten: leave that out"
            )
        self._core = core = env.core
        self.seen = core.observation_size
        self.truth = core.task.sizes(core.sensors.size, len(core.composition.names))["guided"]
        bound = core.task.BOUND
        self.observation_space = Box(-bound, bound, (self.seen + self.truth,), np.float32)

    def _observed(self, observations: np.ndarray) -> np.ndarray:
        return np.concatenate([observations, oracle_view(self._core)], -1)


class _Seen(BaseFeaturesExtractor):
    """The agent's part of observations, whether the truth stands beside it or not: in flight it does not."""

    def __init__(self, space: Any, seen: int, frames: int) -> None:
        super().__init__(space, frames * seen)
        self._seen, self._frames = seen, frames

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return observations.unflatten(-1, (self._frames, -1))[..., : self._seen].flatten(-2)


class _TruthForCritic(ActorCriticPolicy):
    """An actor that takes the agent's part of observations, and a critic that takes all.

    ``seen`` and ``truth`` say how much of a frame is the agent's and how much the critic's alone; ``rate`` is the
    learning rate by the share of the training that remains, the rest as of other policies.
    """

    def __init__(
        self, space: Box, action_space: Any, rate: Any, *, seen: int, truth: int, frames: int, **network: Any
    ) -> None:
        self._whole = Box(-np.inf, np.inf, (frames * (seen + truth),), np.float32)
        super().__init__(
            space, action_space, rate, features_extractor_class=_Seen,
            features_extractor_kwargs={"seen": seen, "frames": frames}, share_features_extractor=False, **network,
        )  # fmt: skip

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        self.vf_features_extractor = FlattenExtractor(self._whole)


class TruthPolicy(_TruthForCritic):
    """stable-baselines3's ``MlpPolicy`` with the truth for the critic alone."""

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        whole = MlpExtractor(self.vf_features_extractor.features_dim, self.net_arch, self.activation_fn, self.device)
        self.mlp_extractor.value_net = whole.value_net


class TruthLstmPolicy(_TruthForCritic, LstmPolicy):
    """`LstmPolicy` with the truth for the critic alone, which remembers both in an LSTM of its own."""

    def __init__(self, space: Box, action_space: Any, rate: Any, **network: Any) -> None:
        super().__init__(space, action_space, rate, **network)
        own = self.lstm_actor
        size = self.vf_features_extractor.features_dim
        self.lstm_critic = torch.nn.LSTM(size, own.hidden_size, own.num_layers, **self.lstm_kwargs)
        self.optimizer = self.optimizer_class(self.parameters(), lr=rate(1), **self.optimizer_kwargs)  # type: ignore[call-arg]
