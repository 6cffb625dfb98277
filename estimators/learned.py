"""A filter whose gain is the output of a recurrent network (KalmanNet), in NumPy, with weights trained elsewhere."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self
from zipfile import BadZipFile, is_zipfile

import numpy as np

from estimators.belief import Belief
from estimators.checks import as_array, finite_array
from estimators.filter import Model, Rng
from estimators.kalman import GaussianFilter
from estimators.linalg import congruence, symmetrise
from estimators.measurement import Measurement

LARGEST = 1e6
"""Of what a network is fed with, in units of its scale: what is absurd is not to make it absurd for good."""


@dataclass(frozen=True, eq=False)
class GainNetwork:
    """A gated recurrent unit of k numbers, and a layer that makes a gain of what it remembers.

    It is fed with the innovation and with the last correction of the state, each in units of its scale, and no more
    than a million of them.

    Attributes:
        input_weights: ``(3 k, p + n)`` of reset, update and candidate, one below the other, as torch has them.
        hidden_weights: ``(3 k, k)``.
        input_bias: ``(3 k,)``.
        hidden_bias: ``(3 k,)``.
        gain_weights: ``(n p, k)``.
        gain_bias: ``(n p,)``.
        innovation_scale: ``(p,)``, positive.
        state_scale: ``(n,)``, positive.

    Raises:
        ValueError: if shapes do not fit each other, numbers are not finite or scales not positive.
    """

    input_weights: np.ndarray
    hidden_weights: np.ndarray
    input_bias: np.ndarray
    hidden_bias: np.ndarray
    gain_weights: np.ndarray
    gain_bias: np.ndarray
    innovation_scale: np.ndarray
    state_scale: np.ndarray

    def __post_init__(self) -> None:
        sizes = {field.name: as_array(field.name, getattr(self, field.name)).size for field in fields(self)}
        k, n, p = sizes["hidden_bias"] // 3, sizes["state_scale"], sizes["innovation_scale"]
        shapes = (3 * k, p + n), (3 * k, k), (3 * k,), (3 * k,), (n * p, k), (n * p,), (p,), (n,)
        for name, shape in zip(sizes, shapes, strict=True):
            array = np.array(finite_array(name, getattr(self, name), *shape))
            if name.endswith("scale") and not (array > 0.0).all():
                raise ValueError(f"{name} must be positive, got {array.min():g}")
            object.__setattr__(self, name, array)

    @property
    def size(self) -> int:
        """Length k of the hidden state."""
        return self.hidden_weights.shape[-1]

    def save(self, path: str | Path) -> None:
        """Write the weights to an ``.npz`` file of plain arrays, under exactly this name."""
        with open(path, "wb") as file:
            np.savez(file, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The weights of a file that `save` wrote; nothing in it is run.

        Raises:
            ValueError: if it holds anything but the arrays of a network.
            OSError: if it cannot be read.
        """
        names = [field.name for field in fields(cls)]
        if not is_zipfile(path):
            with open(path, "rb"):  # which says so if it cannot be read
                raise ValueError(f"{path} is no .npz file: no weights of a GainNetwork")
        with np.load(path, allow_pickle=False) as file:
            if sorted(file.files) != sorted(names):
                raise ValueError(f"{path} holds {', '.join(file.files)}: no weights of a GainNetwork")
            try:
                arrays = {name: file[name] for name in names}
            except (ValueError, BadZipFile) as error:
                raise ValueError(f"{path} holds more than plain arrays: no weights of a GainNetwork") from error
        return cls(**arrays)

    def __call__(
        self, hidden: np.ndarray, innovation: np.ndarray, correction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The hidden state after a measurement ``(..., k)``, and the gain ``(..., n, p)``."""
        seen = np.concatenate([innovation / self.innovation_scale, correction / self.state_scale], -1)
        seen = np.clip(seen, -LARGEST, LARGEST)
        input_gates = np.split(np.matvec(self.input_weights, seen) + self.input_bias, 3, -1)
        kept = np.split(np.matvec(self.hidden_weights, hidden) + self.hidden_bias, 3, -1)
        reset, update = (1.0 / (1.0 + np.exp(-(a + b))) for a, b in zip(input_gates[:2], kept[:2], strict=True))
        hidden = (1.0 - update) * np.tanh(input_gates[2] + reset * kept[2]) + update * hidden
        gain = np.matvec(self.gain_weights, hidden) + self.gain_bias
        gain = gain.reshape(gain.shape[:-1] + (self.state_scale.size, self.innovation_scale.size))
        return hidden, self.state_scale[:, None] * gain / self.innovation_scale


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LearnedGainBelief(Belief):
    """The belief of a filter whose gain a network says.

    Attributes:
        hidden: ``(..., k)`` what the network remembers.
        correction: ``(..., n)`` by how much the last measurement moved the mean.
    """

    hidden: np.ndarray
    correction: np.ndarray


class LearnedGainFilter(GaussianFilter[LearnedGainBelief], verified=True):
    """Predicted by the model, corrected with a gain that a recurrent network has learned: for a model known to be off.

    The network sees the innovation and the last correction. Of a missing measurement it sees 0, and of none at all
    nothing, so that it remembers what it did. `agents.training.learned_filter.train_filter` trains it.

    The covariance is that of this gain, ``(I - K C) P- (I - K C)' + K R K'``, if the model were right: what the filter
    makes of its model's errors is in its mean alone.

    Source: Revach, Shlezinger, Ni, Escoriza, van Sloun & Eldar (2022), KalmanNet: features F2 and F4, one gated unit.

    Args:
        model: That of the training; an unknown input in it is ignored.
        network: A `GainNetwork` for as many states and measurements.

    Raises:
        ValueError: if the network is for another number of states or measurements.
        TypeError: if it is none.
    """

    name = "LearnedGainFilter"
    record = LearnedGainBelief
    mixes = False  # the network knows the channels as they are
    sequential = False
    formulas = False

    def __init__(self, model: Model, network: GainNetwork) -> None:
        super().__init__(model)
        if not isinstance(network, GainNetwork):
            raise TypeError(f"network must be a GainNetwork, got {type(network).__name__}")
        sizes = network.state_scale.size, network.innovation_scale.size
        if sizes != (model.n, model.p):
            raise ValueError(
                f"the network is for {sizes[0]} states, {sizes[1]} measurements; the model has {model.n} and {model.p}"
            )
        self.network = network

    def _unseen(self, mean: np.ndarray) -> dict[str, Any]:
        return {"hidden": np.zeros(mean.shape[:-1] + (self.network.size,)), "correction": np.zeros(mean.shape)}

    def _own(self, before: LearnedGainBelief, mean: np.ndarray, u: np.ndarray | None) -> dict[str, Any]:
        return {"hidden": before.hidden, "correction": before.correction}

    def _update(self, belief: LearnedGainBelief, measurement: Measurement, rng: Rng) -> LearnedGainBelief:
        hidden, gain = self.network(belief.hidden, measurement.innovation, belief.correction)
        gain = np.where(measurement.available[..., None, :], gain, 0.0)
        correction, any_came = np.matvec(gain, measurement.innovation), measurement.available.any(-1, keepdims=True)
        S = congruence(measurement.C, belief.cov) + measurement.R
        cov = congruence(self._identity - gain @ measurement.C, belief.cov) + congruence(gain, measurement.R)
        return LearnedGainBelief.updated(
            belief, belief.mean + correction, symmetrise(cov), measurement, symmetrise(S),
            hidden=np.where(any_came, hidden, belief.hidden),
            correction=np.where(any_came, correction, belief.correction),
        )  # fmt: skip
