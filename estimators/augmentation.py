"""Models of other unknown inputs made of a model: without feedthrough, or with it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from estimators.engine.compiled import compiled
from estimators.linalg import joined
from estimators.models import LinearModel, NonlinearModel
from estimators.varying import Matrix, Schedule, is_compiled, resolve


def input_delayed(model: "LinearModel") -> "LinearModel":
    """A linear model whose measurements show d(k-1), as one of direct feedthrough of d(k).

    With ``x' = x - G d(k-1)`` and ``d' = d(k-1)``: ``x'+ = A x' + A G d' + B u``, ``y = C x' + (C G
    + H) d'``. So a filter that needs rank(H) = q takes a model of rank(C G + H) = q; it estimates
    x', and calls the input of the step before that of now. Exact where G does not change.

    Args:
        model: With unknown inputs, and H = 0 or ``delayed_feedthrough``.

    Raises:
        ValueError: if the model has no unknown input, or one that feeds through at once.
    """
    G: Any = model.G
    H: Any = model.H
    if model.q == 0 or (not model.delayed_feedthrough and (callable(H) or np.any(H))):
        raise ValueError(
            "input_delayed needs an unknown input without feedthrough: give the model G, and H = 0"
            " or delayed_feedthrough=True"
        )
    return LinearModel(
        model.A, model.C, model.Q, model.R, B=model.B,
        G=_assembled(lambda A, G: A @ G, model.A, G),
        H=_assembled(lambda C, G, H: C @ G + H, model.C, G, H),
        state_angles=model.state_angles, measurement_angles=model.measurement_angles,
    )  # fmt: skip


def stacked(model: "LinearModel | NonlinearModel") -> "LinearModel | NonlinearModel":
    """A model without feedthrough, of which states n + 1 to n + q are the unknown input.

    ``(x, d)+ = [A, G; 0, 0] (x, d) + [0; I] d(k+1)`` and ``y = [C, H] (x, d)``. So filters that
    need H = 0 take a model with feedthrough: what they call the input of the step before is the d
    that acts now. Begin with the input's prior beside that of the state. A model of
    ``delayed_feedthrough`` has d(k-1) for these states, which drives nothing more: ``(x, d)+ = [A,
    0; 0, 0] (x, d) + [G; I] d(k)``. Begin with zeros beside the state.

    Args:
        model: With unknown inputs, and H of rank q if an unbiased filter is to tell them. A
            Jacobian of your own is taken over unless G is a function of the state.

    Raises:
        ValueError: if the model has no unknown input.
    """
    n, p, q = model.n, model.p, model.q
    G: Any = model.G
    H: Any = model.H
    if q == 0:
        raise ValueError("stacked needs an unknown input: give the model G, H or both")
    ended, drive = model.delayed_feedthrough, np.eye(n + q, q, -n)
    if ended and callable(G):
        raise ValueError("stacked needs a constant G where the feedthrough is delayed")
    options: dict[str, Any] = {
        "Q": _assembled(lambda Q: _above(joined([Q, np.zeros((n, q))], -1), q), model.Q),
        "R": model.R, "G": drive + _above(G, q) if ended else drive, "H": np.zeros((p, q)),
        "state_angles": model.state_angles, "measurement_angles": model.measurement_angles,
    }  # fmt: skip
    if ended:  # d(k-1) is in the state already
        G = np.zeros((n, q))
    if isinstance(model, LinearModel):
        return LinearModel(
            _assembled(lambda A, G: _above(joined([A, G], -1), q), model.A, G),
            _assembled(lambda C, H: joined([C, H], -1), model.C, H),
            B=None if model.B is None else _assembled(lambda B: _above(B, q), model.B), **options,
        )  # fmt: skip
    return _stacked_nonlinear(model, G, options)


def _stacked_nonlinear(model: NonlinearModel, G: Any, options: dict[str, Any]) -> NonlinearModel:
    """The model of ``(x, d)`` where d drives x by G, and all else is as ``options`` say."""
    n, q, H, ended = model.n, model.q, model.H, model.delayed_feedthrough

    def transition(z: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        x, d = z[..., :n], z[..., n:]
        moved = model.transition(x, u) + np.matvec(G if ended else model.input_matrix(x, u), d)
        return np.concatenate([moved, np.zeros(moved.shape[:-1] + (q,))], -1)

    def measurement(z: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        return model.measurement(z[..., :n], u) + np.matvec(resolve(H, u), z[..., n:])

    moves, shows = None if callable(G) else model.transition_jacobian, model.measurement_jacobian
    return NonlinearModel(
        _function(transition, model.transition, model.G),
        _function(measurement, model.measurement, H),
        states=n + q, measurements=model.p, **options,
        transition_jacobian=moves and _function(
            lambda z, u: _above(joined([moves(z[..., :n], u), G], -1), q), moves),
        measurement_jacobian=shows and _function(
            lambda z, u: joined([shows(z[..., :n], u), resolve(H, u)], -1), shows, H),
    )  # fmt: skip


def _above(matrix: np.ndarray, q: int) -> np.ndarray:
    """A matrix ``(..., n, m)`` with q rows of zeros below."""
    return joined([matrix, np.zeros((q, matrix.shape[-1]))], -2)


def _assembled(assemble: Callable[..., np.ndarray], *parts: Matrix) -> Matrix:
    """A matrix of others: a function of u where one is, a `Schedule` where all have one grid."""
    functions: list[Any] = [part for part in parts if callable(part)]
    if not functions:
        return assemble(*parts)
    grids = {
        (each.component, each.scale, each.middle, len(each.table))
        if isinstance(each, Schedule)
        else each
        for each in functions
    }
    if len(grids) == 1 and isinstance(functions[0], Schedule):
        tables = (part.table if isinstance(part, Schedule) else part for part in parts)
        return replace(functions[0], table=assemble(*tables))
    return _function(lambda u: assemble(*(resolve(part, u) for part in parts)), *parts)


def _function(function: Any, *parts: Any) -> Any:
    """A function made of others, compiled where they are."""
    return compiled(function) if all(map(is_compiled, parts)) else function
