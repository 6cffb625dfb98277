"""Networks of policies: in NumPy, or in torch of no more parameters than a checkpoint holds."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import numpy as np
from gymnasium.spaces import Box

POLICIES = {
    "ActorCriticPolicy": "stable_baselines3.common.policies",
    "SACPolicy": "stable_baselines3.sac.policies",
    "TQCPolicy": "sb3_contrib.tqc.policies",
    "CrossQPolicy": "sb3_contrib.crossq.policies",
    "TD3Policy": "stable_baselines3.td3.policies",
    "RecurrentActorCriticPolicy": "sb3_contrib.common.recurrent.policies",
    "ARSPolicy": "sb3_contrib.ars.policies",
    "ARSLinearPolicy": "sb3_contrib.ars.policies",
    "LstmPolicy": "agents.policies.lstm",
}
"""Networks of checkpoints, and their modules."""


class Dense:
    """The actor of a plain policy in NumPy: dense layers of tanh, as torch computes them but for rounding.

    It is made of what a checkpoint says of its policy, and of its arrays by name.

    Raises:
        ValueError: if it is another network.
    """

    def __init__(self, settings: dict[str, Any], weights: dict[str, np.ndarray]) -> None:
        if (settings["class"], settings["network"]["activation_fn"]) != (
            "ActorCriticPolicy",
            "Tanh",
        ):
            raise ValueError("it is no network of dense layers of tanh")
        widths = settings["network"]["net_arch"]
        widths = widths["pi"] if isinstance(widths, dict) else widths
        names = (*(f"mlp_extractor.policy_net.{2 * i}" for i in range(len(widths))), "action_net")
        self._layers = [(weights[f"{name}.weight"], weights[f"{name}.bias"]) for name in names]
        self.observation_space, self.action_space = spaces(settings)
        sizes = [settings["observations"], *widths, settings["actions"]]
        for name, (weight, bias), before, after in zip(
            names, self._layers, sizes[:-1], sizes[1:], strict=True
        ):
            if (weight.shape, bias.shape) != ((after, before), (after,)):
                raise ValueError(f"{name} is no layer of {before} to {after} numbers")

    def predict(
        self, observations: np.ndarray, state: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """The mean actions, within the bounds; the state is nobody's."""
        *hidden, (last, bias) = self._layers
        for weight, shift in hidden:
            observations = np.tanh(observations @ weight.T + shift)
        return np.clip(observations @ last.T + bias, -1.0, 1.0), state


def spaces(settings: dict[str, Any]) -> tuple[Any, Any]:
    """Spaces of observations and of actions."""
    seen = Box(-np.inf, np.inf, (settings["observations"],), np.float32)
    return seen, Box(-1.0, 1.0, (settings["actions"],), np.float32)


def torch_policy(settings: dict[str, Any], arrays: dict[str, np.ndarray]) -> Any:
    """The network that the words tell of, with its weights."""
    import torch

    network = dict(settings["network"])
    if "activation_fn" in network:
        kind = getattr(torch.nn, network["activation_fn"])
        if not (isinstance(kind, type) and issubclass(kind, torch.nn.Module)):
            raise ValueError(f"{network['activation_fn']!r} is no activation")
        network["activation_fn"] = kind
    policy = getattr(import_module(POLICIES[settings["class"]]), settings["class"])
    weights = {name: torch.from_numpy(array) for name, array in arrays.items()}
    with _bounded(sum(array.size for array in arrays.values())):
        return built(policy, *spaces(settings), network, weights)


def _bounded(size: int) -> Any:
    """A context in which torch makes no more parameters than ``size`` numbers, those of the file."""
    from torch import Tensor, empty
    from torch.overrides import TorchFunctionMode

    class Bounded(TorchFunctionMode):
        left = size

        def __torch_function__(
            self, func: Any, types: Any, args: Any = (), kwargs: Any = None
        ) -> Any:
            made = func(*args, **(kwargs or {}))
            numbers = made.numel() if isinstance(made, Tensor) else 0
            self.left -= numbers if func is empty else 0
            if self.left < 0 or numbers > size:
                raise ValueError("it describes a larger network than its weights are of")
            return made

    return Bounded()


def built(policy: type, seen: Any, done: Any, network: dict[str, Any], weights: Any) -> Any:
    """A policy with its weights, ready to fly."""
    import torch
    from sb3_contrib.ars.policies import ARSPolicy

    rate = () if issubclass(policy, ARSPolicy) else (lambda _: 0.0,)
    with torch.random.fork_rng(devices=[]):  # its first weights are drawn, and thrown away
        built = policy(seen, done, *rate, **network)
    built.load_state_dict(weights)
    built.set_training_mode(False)
    return built


@contextmanager
def one_thread() -> Iterator[None]:
    """For small networks a second thread costs more than it brings; the user's own get theirs back."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
