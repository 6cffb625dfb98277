#!/bin/sh
# Expected: on a linear model a cubature Kalman filter is the Kalman filter (Arasaratnam & Haykin 2009 draw
# new points from the predicted covariance). filterpy 2.0.0 (CubatureKalmanFilter.py): update uses the
# points of predict, which lack Q. So the gain is that of process noise F Q F', and P is too large by Q.
# UnscentedKalmanFilter of the same version draws anew. Hurts who compares filters: on x = .5 x + w the RMSE
# is .86 for .73. Instead: UnscentedKalmanFilter with MerweScaledSigmaPoints(n, alpha=1, beta=0, kappa=0),
# which has the cubature points.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/python" -m pip install -q --no-compile filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
"$folder/env/bin/python" -W ignore - <<'PY'
import filterpy
import numpy as np
from filterpy.kalman import (
    CubatureKalmanFilter,
    KalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
)

print("filterpy", filterpy.__version__)


def move(x, dt):
    return 0.5 * x


def see(x):
    return x


points = MerweScaledSigmaPoints(1, 1.0, 0.0, 0.0)
kf = KalmanFilter(1, 1)
kf.F, kf.H = 0.5 * np.eye(1), np.eye(1)
filters = {
    "kalman": kf,
    "cubature": CubatureKalmanFilter(1, 1, 1.0, hx=see, fx=move),
    "unscented": UnscentedKalmanFilter(1, 1, 1.0, see, move, points),
}
rng = np.random.default_rng(0)
truth = [0.0]
for push in rng.normal(size=2_000):
    truth.append(0.5 * truth[-1] + push)
truth = np.array(truth[1:])
y = truth + rng.normal(size=2_000)
first, rmse = {}, {}
for name, filter in filters.items():
    filter.P, filter.Q, filter.R = np.eye(1), np.eye(1), np.eye(1)
    errors = []
    for k, z in enumerate(y):
        filter.predict()
        filter.update(np.array([[z]]) if name == "cubature" else np.array([z]))
        if k == 0:
            first[name] = [np.asarray(part).item() for part in (filter.S, filter.K, filter.P)]
        errors.append(np.asarray(filter.x).item() - truth[k])
    rmse[name] = np.sqrt(np.mean(np.square(errors)))
    print(name, "first S, K, P:", np.round(first[name], 3), "RMSE", rmse[name].round(3))

assert np.allclose(first["kalman"], [2.25, 1.25 / 2.25, 1.25 / 2.25])
assert np.allclose(first["unscented"], first["kalman"])
assert np.allclose(first["cubature"], [1.25, 0.2, 1.2])
assert rmse["cubature"] > 1.05 * rmse["kalman"]
PY
