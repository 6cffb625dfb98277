"""Training for `estimators.LearnedGainFilter`, in torch: series of states and measurements make a gain."""

from dataclasses import fields
from typing import Any

import numpy as np

from agents.policies.network import one_thread
from estimators import GainNetwork, Gaussian, LinearModel, make, run
from estimators.angles import difference
from estimators.checks import as_array, integer, number, short_repr
from estimators.learned import LARGEST
from estimators.linalg import lacks_rank
from estimators.varying import resolve
from vessel_gym.extras import require


def train_filter(
    model: LinearModel,
    prior: Gaussian,
    x: np.ndarray,
    y: np.ndarray,
    u: np.ndarray | None = None,
    hidden: int = 24,
    epochs: int = 150,
    rate: float = 3e-3,
    seed: int = 0,
) -> GainNetwork:
    """The network whose gains make the means of a filter with this model, off as it may be, come near the states.

    It begins as the steady gain of a Kalman filter of the model. The mean square error of all states, each in units of
    what that filter leaves of it, is brought down over the whole length of the series, by Adam with a rate that falls
    to nothing. A fifth of the series is not learned from: the weights that did best there are kept, if only the first.

    Args:
        model: What the filter will believe, of arrays.
        prior: From which it will begin, one for all series.
        x: ``(T, series, n)`` states: the truth of simulations, or reference measurements.
        y: ``(T, series, p)`` measurements; NaN where none came.
        u: ``(T, series, m)`` known input over the step that follows; None: there is none.
        hidden: How many numbers the network remembers.
        epochs: How many times the series are seen, all at once.
        rate: Of learning.
        seed: Of the first weights.

    Raises:
        ValueError: if the series or the prior do not fit the model, states are not all finite, a channel is never
            read, the series are fewer than five, the model has functions for matrices, or its innovations have a
            singular covariance.
        ModuleNotFoundError: without torch.
    """
    require("torch")
    x, y, u = _checked(model, prior, x, y, u)
    hidden, epochs = integer("hidden", hidden, 1), integer("epochs", epochs, 1)
    rate = number("rate", rate, 0.0, np.inf, "a positive number")
    seed = integer("seed", seed, 0)
    moved = np.zeros(x.shape)  # what the known input does over the step before
    if u is not None and model.B is not None:
        moved[1:] = np.matvec(resolve(model.B, None), u[:-1])
    with one_thread():
        return _trained(model, prior, x, y, moved, _first(model, prior, x, y, u, hidden, seed), epochs, rate)


def _checked(model: Any, prior: Any, x: Any, y: Any, u: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """The series as arrays, after a check that they and the prior fit the model."""
    x, y = as_array("x", x), as_array("y", y)
    matrices = [getattr(model, name, None) for name in "ABCQR"]
    if not isinstance(model, LinearModel) or not all(a is None or getattr(a, "ndim", 0) == 2 for a in matrices):
        raise ValueError("train_filter needs a LinearModel of arrays: make a nonlinear one straight first")
    for name, series, size in (("x", x, model.n), ("y", y, model.p)):
        if series.ndim != 3 or series.shape[-1] != size or series.shape[:2] != x.shape[:2]:
            raise ValueError(f"{name} has shape {series.shape}, expected (T, series, {size}) with those of x")
    if x.shape[1] < 5:
        raise ValueError(f"train_filter needs five series at least, got {x.shape[1]}: it learns from four of five")
    if not np.isfinite(x).all():
        raise ValueError("x must be finite: it is the truth that is learned from")
    if not (read := np.isfinite(y).any((0, 1))).all():
        raise ValueError(f"y has no measurement of channel {read.argmin()}: leave it out of the model")
    if not isinstance(prior, Gaussian) or (prior.mean.shape, prior.cov.shape) != ((model.n,), (model.n, model.n)):
        raise ValueError(f"prior must be one Gaussian of {model.n} states for all series, got {short_repr(prior)}")
    u = None if u is None else as_array("u", u)
    if u is not None and (u.ndim != 3 or u.shape[:2] != x.shape[:2]):
        raise ValueError(f"u has shape {u.shape}, expected (T, series, m) = ({x.shape[0]}, {x.shape[1]}, m)")
    model.check_known_input(u)
    return x, y, u


def _first(
    model: LinearModel, prior: Gaussian, x: np.ndarray, y: np.ndarray, u: np.ndarray | None, hidden: int, seed: int
) -> GainNetwork:
    """A network that says the steady gain of the model's Kalman filter, nearly, in scales of what that one leaves."""
    filter = make("kf", model)
    beliefs = run(filter, prior, y, u).updated
    innovations = np.where(beliefs.available, beliefs.innovation, np.nan)
    state_scale = np.sqrt(np.square(difference(beliefs.mean, x, model.state_angles)).mean((0, 1)))
    innovation_scale = np.sqrt(np.nanmean(np.square(innovations), (0, 1)))
    steady = filter.init(prior)
    for _ in range(200):
        predicted = filter.predict(steady, None if u is None else u[0, 0])
        steady = filter.update(predicted, np.zeros(model.p))
    if lacks_rank(steady.innovation_cov):
        raise ValueError("the innovations have a singular covariance: give every channel noise of its own in R")
    gain = np.linalg.solve(steady.innovation_cov, model.C @ predicted.cov).T
    rng, n, p = np.random.default_rng(seed), model.n, model.p

    def drawn(*shape: int) -> np.ndarray:
        return rng.uniform(-1.0, 1.0, shape) / np.sqrt(hidden)

    return GainNetwork(
        drawn(3 * hidden, p + n), drawn(3 * hidden, hidden), drawn(3 * hidden), drawn(3 * hidden),
        0.01 * drawn(n * p, hidden), (gain * innovation_scale / state_scale[:, None]).ravel(), innovation_scale,
        state_scale,
    )  # fmt: skip


def means(network: dict[str, Any], model: LinearModel, start: np.ndarray, y: Any, moved: Any) -> Any:
    """The filter's means ``(T, series, n)``, as a tensor that can be differentiated by the network's weights.

    From a prior's mean ``start (n,)``, by measurements ``y (T, series, p)``, NaN for missing ones; ``moved
    (T, series, n)`` is the effect of the known input over the step before.
    """
    import torch

    A, C = torch.tensor(model.A), torch.tensor(model.C)
    mean = torch.tensor(start).expand(y.shape[1], model.n)
    memory, correction = mean.new_zeros(y.shape[1], network["hidden_weights"].shape[1]), torch.zeros_like(mean)
    available, means = torch.isfinite(y), []
    for k in range(len(y)):
        if k:
            mean = mean @ A.T + moved[k]
        e = wrapped(y[k] - mean @ C.T, model.measurement_angles)
        e = torch.where(available[k], torch.nan_to_num(e), 0.0)
        seen = torch.cat([e / network["innovation_scale"], correction / network["state_scale"]], -1)
        seen = seen.clamp(-LARGEST, LARGEST)
        after = torch.gru_cell(
            seen, memory, network["input_weights"], network["hidden_weights"], network["input_bias"],
            network["hidden_bias"],
        )  # fmt: skip
        gain = (after @ network["gain_weights"].T + network["gain_bias"]).reshape(-1, model.n, model.p)
        step = (gain @ (e / network["innovation_scale"])[..., None])[..., 0] * network["state_scale"]
        came = available[k].any(-1, keepdim=True)
        memory, correction = torch.where(came, after, memory), torch.where(came, step, correction)
        mean = mean + step
        means.append(mean)
    return torch.stack(means)


def wrapped(residual: Any, angles: tuple[int, ...]) -> Any:
    """A residual ``(..., n)``, a tensor, with its components in ``angles`` wrapped in place, as `difference` does."""
    import torch

    if angles:
        own = ..., list(angles)
        residual[own] = torch.remainder(residual[own] + torch.pi, 2.0 * torch.pi) - torch.pi
    return residual


def _trained(
    model: LinearModel, prior: Gaussian, x: np.ndarray, y: np.ndarray, moved: np.ndarray, first: GainNetwork,
    epochs: int, rate: float,
) -> GainNetwork:  # fmt: skip
    import torch

    network = {field.name: torch.as_tensor(getattr(first, field.name)).clone() for field in fields(first)}
    learned = [tensor.requires_grad_() for name, tensor in network.items() if not name.endswith("scale")]
    truth, measurements, pushed = (torch.as_tensor(array) for array in (x, y, moved))
    kept = torch.arange(x.shape[1]) % 5 == 4
    optimizer = torch.optim.Adam(learned, lr=rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs)
    best, found = np.inf, first
    for _ in range(epochs + 1):
        error = wrapped(means(network, model, prior.mean, measurements, pushed) - truth, model.state_angles)
        error = error / network["state_scale"]
        square = error.square().mean((0, 2))
        score = square.detach()[kept].mean().item()
        if score < best:
            best = score
            found = GainNetwork(**{name: tensor.detach().numpy().copy() for name, tensor in network.items()})
        optimizer.zero_grad()
        square[~kept].mean().backward()
        torch.nn.utils.clip_grad_norm_(learned, 1.0)
        optimizer.step()
        schedule.step()
    return found
