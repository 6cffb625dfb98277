"""filterpy: its calls and those of this package, and parts that do something else."""

# /// script
# dependencies = ["filterpy==2.0.0", "llvmlite==0.50.0", "numpy==2.4.6", "scipy==1.17.1"]
# ///

import re
from pathlib import Path

import numpy as np
from case import (
    COV,
    MEAN,
    NOTHING,
    PLANE,
    A,
    C,
    Q,
    R,
    Y,
    after,
    close,
    f,
    h,
    kf,
    pendulum,
    series,
)
from filterpy import kalman, stats
from filterpy.common import (
    Q_continuous_white_noise,
    Q_discrete_white_noise,
)

from estimators import (
    Gaussian,
    LinearModel,
    NonlinearModel,
    make,
    nees,
    rmse,
    run,
    smooth,
    van_loan,
    zero_order_hold,
)


def theirs(**changes):
    filter = kalman.KalmanFilter(2, 2)
    values = {"F": A, "H": C, "Q": Q, "R": R, "x": MEAN.copy(), "P": COV.copy()} | changes
    for name, value in values.items():
        setattr(filter, name, value)
    return filter


# calls
late = after(kf, Y)
means, covs, *_ = theirs().batch_filter(Y)
close(means, late.mean[1:])
close(theirs().rts_smoother(means, covs)[0], smooth(late).mean[1:])
close(theirs().batch_filter(Y, update_first=True)[0], series.mean)
drift, push = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
held = zero_order_hold(drift, push, 0.3)[1]
close(Q_discrete_white_noise(2, 0.3, 2.0), 2.0 * held @ held.T)
close(Q_continuous_white_noise(2, 0.3, 2.0), van_loan(drift, push, [[2.0]], 0.3)[1])
close(stats.NEES(Y, series.mean, series.cov), nees(series.mean, series.cov, Y))

# sigma points
for options in ({}, {"alpha": 0.3, "kappa": 1.0}):
    points = kalman.MerweScaledSigmaPoints(2, **{"alpha": 1.0, "beta": 2.0, "kappa": 0.0} | options)
    ukf = kalman.UnscentedKalmanFilter(2, 2, 1.0, h, lambda x, dt: f(x), points)
    ukf.x, ukf.P, ukf.Q, ukf.R = MEAN, COV, 0.1 * Q, 0.1 * R
    means, covs = ukf.batch_filter(PLANE)
    ours = after(make("ukf", pendulum, **options), PLANE)
    close(means, ours.mean[1:])
    close(ukf.rts_smoother(means, covs)[0], smooth(ours).mean[1:])
one = np.eye(1)
cubature = kalman.CubatureKalmanFilter(1, 1, 1.0, hx=lambda x: x, fx=lambda x, dt: x)
cubature.x, cubature.P, cubature.Q, cubature.R = np.zeros((1, 1)), one, one, one
cubature.predict()
cubature.update(one)
level = make("ukf", NonlinearModel(lambda x, u: x, lambda x, u: x, one, one), beta=0.0)
close(cubature.P, 1.5)
close(run(level, Gaussian([0.0], one), [[np.nan], [1.0]]).cov[-1], 2.0 / 3.0)

# several models
page = Path(__file__).parents[3] / "docs" / "recipes" / "several-models.md"
recipe, change = {"__name__": "recipe"}, np.array([[0.95, 0.05], [0.1, 0.9]])
exec(re.search(r"^```python\n(.*?)^```", page.read_text(), re.M | re.S)[1], recipe)
scales = np.array([1.0, 9.0])
modes = LinearModel(A, C, scales[:, None, None] * Q, R)
both = Gaussian(np.tile(MEAN, (2, 1)), COV)
measured = np.concatenate([NOTHING, Y[:30]])[:, None].repeat(2, 1)
ours = run(recipe["InteractingModels"](modes, change), both, measured)
bank = [theirs(Q=scale * Q) for scale in scales]
imm = kalman.IMMEstimator(bank, [0.5, 0.5], change)
for y in Y[:30]:
    imm.predict()
    imm.update(y)
close(imm.mu, ours.updated.probabilities[30])

# fixed lag
rng, noise = np.random.default_rng(0), Q_discrete_white_noise(2)
truth = [np.zeros(2)]
for kick in rng.normal(size=1_000):
    truth.append(A @ truth[-1] + kick * np.array([0.5, 1.0]))
truth, one = np.array(truth[1:]), np.array([[1.0]])
y, row = truth[:, :1] + rng.normal(size=(1_000, 1)), np.array([[1.0, 0.0]])
lagged = kalman.FixedLagSmoother(2, 1)
lagged.F, lagged.H, lagged.Q, lagged.R = A, row, noise, one
theirs_lagged = lagged.smooth_batch(y, N=4)[0][..., 0]
single = run(make("kf", LinearModel(A, row, noise, one)), Gaussian([0.0, 0.0], np.eye(2)), y)
errors = [rmse(each, truth)[0] for each in (theirs_lagged, single.mean, smooth(single, 4).mean)]
close(errors, [1.28, 0.86, 0.58], 0.005)
