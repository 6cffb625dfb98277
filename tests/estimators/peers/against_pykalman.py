"""pykalman: varying matrices, offsets and the points of its unscented filters."""

# /// script
# dependencies = ["pykalman==0.11.2", "llvmlite==0.50.0", "numpy==2.4.6", "scipy==1.17.1"]
# ///

import numpy as np
from case import COV, MEAN, PLANE, A, Q, R, Y, close, f, h, pendulum, prior, series
from pykalman import AdditiveUnscentedKalmanFilter, KalmanFilter, UnscentedKalmanFilter, unscented

from estimators import Gaussian, LinearModel, NonlinearModel, make, run, smooth

# varying matrices and offsets
rng = np.random.default_rng(1)
table, moved, shift = rng.normal(size=(50, 2, 2)), rng.normal(size=(49, 2)), rng.normal(size=2)
theirs = KalmanFilter(A, table, Q, R, moved, shift, MEAN, COV)
B = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
varying = LinearModel(A, lambda u: table[u[..., 0].astype(int)], Q, R, B)
u = np.column_stack([np.arange(50.0), np.vstack([moved, moved[:1]])])
ours = run(make("kf", varying), prior, Y - shift, u=u)
close(theirs.filter(Y)[0], ours.mean)
close(theirs.loglikelihood(Y), ours.log_likelihood)

# sigma points
theirs = AdditiveUnscentedKalmanFilter(f, h, 0.1 * Q, 0.1 * R, MEAN, COV)
ours = run(make("ukf", pendulum, beta=0.0, kappa=1.0), prior, PLANE)
close(theirs.filter(PLANE)[0], ours.mean)
close(theirs.smooth(PLANE)[0], smooth(ours).mean)
one = np.ma.masked_array(PLANE, np.arange(100).reshape(50, 2) == 20)
gap = np.where(np.arange(50)[:, None] == 10, np.nan, PLANE)
close(theirs.filter(one)[0], run(ours.filter, prior, gap).mean)
np.testing.assert_raises_regex(
    ValueError,
    "beta must be at least",
    lambda: make("ukf", LinearModel(*4 * [np.eye(4)]), beta=0.0, kappa=-1.0),
)
points = unscented.moments2points(unscented.Moments(np.zeros(5), np.eye(5)))
close(unscented.unscented_transform(points, lambda x: x @ x)[1].covariance, -10.0)  # right is 10

# noise inside of f
theirs = UnscentedKalmanFilter(lambda x, w: A @ x + w, lambda x, v: x + v, Q, R, MEAN, COV)
close(theirs.filter(Y)[0], series.mean)


def inside(x, u):
    """Two states and their noise, whose next mean is zero."""
    return np.concatenate([x[..., :2] @ A.T + x[..., 2:], 0.0 * x[..., 2:]], -1)


wide = Gaussian([*MEAN, 0.0, 0.0], np.diag([*np.diag(COV), 0.1, 0.2]))
more = NonlinearModel(inside, lambda x, u: x[..., :2], np.diag([0.0, 0.0, 0.1, 0.2]), R)
close(run(make("ukf", more), wide, Y).mean[:, :2], series.mean)
