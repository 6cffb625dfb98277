"""Actors of policies in NumPy, and their export from stable-baselines3."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

ACTIVATIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "Tanh": np.tanh,
    "ReLU": lambda values: np.maximum(values, 0.0),
}
"""Activation functions by their name in `torch.nn`."""
_BLOCKS = ("lstm_actor", "mlp_extractor.policy_net", "actor.latent_pi", "actor.mu", "action_net")
"""Parts of actors in the order of their computation; a policy has some of them."""
_LSTM = ("weight_ih_l0", "weight_hh_l0", "bias_ih_l0", "bias_hh_l0")


@dataclass(frozen=True)
class Network:
    """Layers of an actor, computed as by torch but for rounding.

    Attributes:
        layers: Kinds of the layers in their order: ``"affine"``, ``"lstm"`` or an activation.
        arrays: Parameters, as ``"<number of the layer>.<name>"``; a weight that is a vector scales
            each component.
        squash: Scale the outputs from [-1, 1] to the bounds of the actions; otherwise clip them.
        space: Space of the actions, with their bounds.
    """

    layers: list[str]
    arrays: dict[str, np.ndarray]
    squash: bool
    space: Any

    def __call__(self, values: np.ndarray, state: Any = None) -> tuple[np.ndarray, Any]:
        """Mean actions ``(B, a)`` and the next recurrent state, for observations ``(B, k)``."""
        for i, layer in enumerate(self.layers):
            if layer == "lstm":
                parameters = [self.arrays[f"{i}.{name}"] for name in _LSTM]
                values, state = _lstm(values, state, *parameters)
            elif layer == "affine":
                weight, bias = self.arrays[f"{i}.weight"], self.arrays[f"{i}.bias"]
                values = (values @ weight.T if weight.ndim == 2 else values * weight) + bias
            else:
                values = ACTIVATIONS[layer](values)
        low, high = self.space.low, self.space.high
        if self.squash:
            return low + 0.5 * (values + 1.0) * (high - low), state
        return np.clip(values, low, high), state


def _lstm(
    values: np.ndarray, state: Any, W: np.ndarray, U: np.ndarray, b: np.ndarray, c: np.ndarray
) -> tuple[np.ndarray, Any]:
    """Hidden values, and the state of hidden and cell values; zeros before the first step."""
    hidden, cell = state or (np.zeros((len(values), len(U) // 4), np.float32),) * 2
    enter, forget, new, leave = np.split(values @ W.T + b + hidden @ U.T + c, 4, axis=-1)
    cell = _sigmoid(forget) * cell + _sigmoid(enter) * np.tanh(new)
    hidden = _sigmoid(leave) * np.tanh(cell)
    return hidden, (hidden, cell)


def _sigmoid(values: np.ndarray) -> np.ndarray:
    return 0.5 * (1.0 + np.tanh(0.5 * values))


def exported(policy: Any) -> Network:
    """The deterministic actor of a policy of stable-baselines3 or sb3-contrib.

    Raises:
        ValueError: if its actions are not those of a chain of known layers.
    """
    space = policy.action_space
    try:
        network = Network(*_chain(policy), policy.squash_output, space)
        trial = np.random.default_rng(0).normal(size=(8, *policy.observation_space.shape))
        observations = trial.astype(np.float32)
        expected, _ = policy.predict(observations, deterministic=True)
        error = np.abs(network(observations)[0] - expected) / (space.high - space.low)
        same = (error < 1e-4).all()
    except (AttributeError, KeyError, TypeError, ValueError):
        same = False
    if not same:
        raise ValueError(
            f"cannot store a {type(policy).__name__} of such layers or spaces in arrays:"
            " wrap it in an object with reset and act"
        )
    return network


def _chain(policy: Any) -> tuple[list[str], dict[str, np.ndarray]]:
    """Layers from the observations to the actions, and their parameters."""
    parts = dict(policy.named_modules())
    blocks = [parts[name] for name in _BLOCKS if name in parts]
    layers: list[str] = []
    arrays: dict[str, np.ndarray] = {}
    for module in (leaf for block in blocks for leaf in block.modules()):
        kind, number = type(module).__name__, len(layers)
        found = {key: value.numpy(force=True) for key, value in module.state_dict().items()}
        if kind == "Linear":
            found.setdefault("bias", np.zeros(module.out_features, np.float32))
        elif kind == "BatchRenorm1d":
            scale = found["scale"] / np.sqrt(found["ra_var"] + module.eps)
            found = {"weight": scale, "bias": found["bias"] - found["ra_mean"] * scale}
        elif kind != "LSTM" and kind not in ACTIVATIONS:
            continue  # a container, or a layer that shows in the actions
        layers.append("lstm" if kind == "LSTM" else "affine" if found else kind)
        arrays |= {f"{number}.{key}": value for key, value in found.items()}
    if policy.squash_output and layers[-1] != "Tanh":
        layers.append("Tanh")
    return layers, arrays
