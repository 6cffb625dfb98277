#!/bin/sh
# Expected: without a measurement a filter's log-likelihood is 0, and mode probabilities of an IMM follow
# their transitions alone. filterpy 2.0.0 (kalman_filter.py, EKF.py, UKF.py, IMM.py): after update(None)
# KalmanFilter has the density of an innovation of zero, EKF and UKF repeat the last value. So an
# IMMEstimator turns to the mode with the smallest S: after a gap of ten steps a failed sensor is
# "healthy" with .998. Hurts who sums log_likelihood over a log with gaps or diagnoses faults.
# Instead: add 0 for None, and for an IMM set mu = cbar in a gap.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/python" -m pip install -q --no-compile filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
"$folder/env/bin/python" -W ignore - <<'PY'
import filterpy
import numpy as np
from filterpy.kalman import (
    ExtendedKalmanFilter,
    IMMEstimator,
    KalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
)

print("filterpy", filterpy.__version__)
one = np.eye(1)


def level(r=1.0):
    kf = KalmanFilter(1, 1)
    kf.F, kf.H, kf.R, kf.Q = one, one, r * one, 0.01 * one
    return kf


kf = level()
ekf = ExtendedKalmanFilter(1, 1)
points = MerweScaledSigmaPoints(1, 1.0, 2.0, 0.0)
ukf = UnscentedKalmanFilter(1, 1, 1.0, lambda x: x, lambda x, dt: x, points)
linear = (lambda x: one, lambda x: x)
found = {}
for name, filter, more in (("kf", kf, ()), ("ekf", ekf, linear), ("ukf", ukf, ())):
    found[name] = []
    for z in (np.array([3.0]), None):
        filter.predict()
        filter.update(z, *more)
        found[name].append(float(filter.log_likelihood))
    print(name, "log-likelihood of a measurement, of none:", np.round(found[name], 3))

modes = [level(1.0), level(100.0)]  # a sensor that works, and one that failed
change = np.array([[0.99, 0.01], [0.01, 0.99]])
imm = IMMEstimator(modes, [0.5, 0.5], change)
imm.predict()
imm.update(np.array([[20.0]]))
right = imm.mu.copy()
print("failed, after a measurement of 20:", imm.mu[1].round(4))
for _ in range(10):
    imm.predict()
    imm.update(None)
    right = right @ change
print("failed, after ten steps of none:", imm.mu[1].round(4), "; right:", right[1].round(4))

assert found["kf"][1] < -0.9
assert found["ekf"][1] == found["ekf"][0]
assert found["ukf"][1] == found["ukf"][0]
assert imm.mu[1] < 0.01 < 0.9 < right[1]
PY
