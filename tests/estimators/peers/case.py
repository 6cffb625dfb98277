"""One small system for the comparisons: position and speed, both measured, and a pendulum."""

import numpy as np

from estimators import Gaussian, LinearModel, NonlinearModel, make, run

A, C = np.array([[1.0, 1.0], [0.0, 1.0]]), np.eye(2)
Q, R = np.diag([0.1, 0.2]), np.diag([0.5, 0.8])
MEAN, COV = np.array([0.0, 1.0]), np.diag([1.0, 0.5])
NOTHING = np.full((1, 2), np.nan)
Y = np.cumsum(np.random.default_rng(0).normal(size=(50, 2)), 0)
PLANE = Y / 70.0 + np.stack([np.sin(0.1 * np.arange(50)), np.cos(0.1 * np.arange(50))], -1)


def f(x, u=None):
    """Angle and speed of a pendulum, one step on."""
    speed = x[..., 1] - 0.5 * np.sin(x[..., 0])
    return np.stack([x[..., 0] + 0.5 * speed, speed], -1)


def h(x, u=None):
    """Its position in the plane."""
    return np.stack([np.sin(x[..., 0]), np.cos(x[..., 0])], -1)


model, pendulum = LinearModel(A, C, Q, R), NonlinearModel(f, h, 0.1 * Q, 0.1 * R)
prior, kf = Gaussian(MEAN, COV), make("kf", model)
series = run(kf, prior, Y)


def after(filter, y, **more):
    """Series in which a prediction precedes the first measurement: nothing comes before it."""
    return run(filter, prior, np.concatenate([NOTHING, y]), **more)


def close(theirs, ours, tolerance=1e-9):
    """Assert equality up to the rounding of another order of operations."""
    theirs = np.reshape(theirs, np.shape(ours))
    np.testing.assert_allclose(theirs, ours, rtol=tolerance, atol=tolerance)
