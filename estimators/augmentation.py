"""Models without feedthrough from models with it, by making the unknown input a state."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estimators.discretisation import with_inputs
from estimators.engine import compiled
from estimators.linalg import joined
from estimators.models import LinearModel, NonlinearModel
from estimators.varying import is_compiled


def stacked(model: "LinearModel | NonlinearModel") -> "LinearModel | NonlinearModel":
    """A model without feedthrough, whose states n + 1 to n + q are the unknown input.

    ``(x, d)+ = [A, G; 0, 0] (x, d) + [0; I] d(k+1)`` and ``y = [C, H] (x, d)``. So filters that
    need H = 0 can use a model with feedthrough. At step k they estimate the new model's input of
    step k - 1, which is d(k). Give the filter one prior
    of (x, d).

    Args:
        model: A model with unknown inputs, and H of rank q if an unbiased filter is to estimate
            them. Jacobians that you gave to it are not used.

    Raises:
        ValueError: if the model has no unknown input, or has ``delayed_feedthrough=True``.
    """
    n, q = model.n, model.q
    if q == 0 or model.delayed_feedthrough:
        raise ValueError(
            "stacked needs an unknown input that feeds through at once: give the model G, H or both"
        )
    options: dict[str, Any] = {
        "Q": _assembled(model, lambda Q: with_inputs(Q, np.zeros((n, q))), "Q"),
        "R": model.R, "G": np.eye(n + q, q, -n), "H": np.zeros((model.p, q)),
        "state_angles": model.state_angles, "measurement_angles": model.measurement_angles,
    }  # fmt: skip
    if isinstance(model, LinearModel):
        return LinearModel(
            _assembled(model, with_inputs, "A", "G"),
            _assembled(model, lambda C, H: joined([C, H], -1), "C", "H"),
            B=None if model.B is None else _assembled(
                model, lambda B: joined([B, np.zeros((q, B.shape[-1]))], -2), "B"
            ), **options,
        )  # fmt: skip

    def transition(z: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        x, d = z[..., :n], z[..., n:]
        moved = model.evaluated("transition", x, u)
        moved = moved + np.matvec(model.input_matrix(x, u), d)
        return np.concatenate([moved, np.zeros(moved.shape[:-1] + (q,))], -1)

    def measurement(z: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        expected = model.evaluated("measurement", z[..., :n], u)
        return expected + np.matvec(model.value("H", u), z[..., n:])

    return NonlinearModel(
        _function(transition, model.transition, model.G),
        _function(measurement, model.measurement, model.H),
        **options,
    )


def _assembled(model: Any, assemble: Callable[..., np.ndarray], *names: str) -> Any:
    """A matrix assembled from matrices of a model; a function of u if one of them is."""
    parts = [getattr(model, name) for name in names]
    if not any(map(callable, parts)):
        return assemble(*parts)
    return _function(lambda u: assemble(*(model.value(name, u) for name in names)), *parts)


def _function(function: Any, *parts: Any) -> Any:
    """A function that uses others, compiled if they all are."""
    return compiled(function) if all(map(is_compiled, parts)) else function
