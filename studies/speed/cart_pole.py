"""Gymnasium's CartPole-v1 as a model: positions and angles are read with noise, and rates are not."""

from typing import Any

import numpy as np

from estimators import Gaussian, NonlinearModel


def balance(x: np.ndarray, u: Any) -> np.ndarray:
    """A step of CartPole-v1."""
    place, speed, angle, rate = np.moveaxis(x, -1, 0)
    sine, cosine = np.sin(angle), np.cos(angle)
    force = (20.0 * u[..., 0] - 10.0 + 0.05 * rate**2 * sine) / 1.1
    turn = (9.8 * sine - cosine * force) / (0.5 * (4.0 / 3.0 - 0.1 * cosine**2 / 1.1))
    push = force - 0.05 * turn * cosine / 1.1
    return np.stack(
        [place + 0.02 * speed, speed + 0.02 * push, angle + 0.02 * rate, rate + 0.02 * turn], -1
    )


CART_POLE: dict[str, Any] = {
    "model": NonlinearModel(
        balance, lambda x, u: x[..., [0, 2]], 1e-8 * np.eye(4), np.diag([4e-4, 1e-4])
    ),
    "prior": Gaussian(np.zeros(4), np.eye(4) * 0.05**2 / 3.0),
}
