"""Kernels of underwater vehicles on truth states, which hold the current after the vehicle's own state."""

from collections.abc import Callable

import numpy as np

Function = Callable[..., np.ndarray]


def rates_of_truth(kernel: np.ufunc, own: int) -> Function:
    """From ``(truth, control, c)`` to the rates of the truth, whose first ``own`` numbers are the vehicle's."""

    def rates(truth: np.ndarray, control: np.ndarray, c: np.ndarray) -> np.ndarray:
        moving = kernel(truth[..., :own], control, truth[..., own:], c)
        return np.concatenate([moving, np.zeros(moving.shape[:-1] + (truth.shape[-1] - own,))], -1)

    return rates


def step_of_truth(kernel: np.ufunc, own: int) -> Function:
    """From ``(truth, control, c, dt, substeps)`` to the truth after a step over which the current is held."""

    def step(truth: np.ndarray, control: np.ndarray, c: np.ndarray, dt: float, substeps: int) -> np.ndarray:
        current = truth[..., own:]
        moved = kernel(truth[..., :own], control, current, c, dt, substeps)
        return np.concatenate([moved, np.broadcast_to(current, moved.shape[:-1] + current.shape[-1:])], -1)

    return step
