#!/bin/sh
# Expected: the covariance of a bank of filters is the sum of p (P + (x_i - x)(x_i - x)') over all filters.
# filterpy 2.0.0 (mmae.py): the sum pairs filter i with component i of the mean. It stops at the number of
# states, and takes the distance of each estimate from that one number. A bank of three filters of one
# state counts the first alone: variance .97 for 2.60, or 0 if the first filter is ruled out.
# Hurts who gates or plots with MMAEFilterBank.P; x and p are right. Instead: form the sum from bank.filters.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/python" -m pip install -q --no-compile filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
"$folder/env/bin/python" -W ignore - <<'PY'
import filterpy
import numpy as np
from filterpy.kalman import KalmanFilter, MMAEFilterBank

print("filterpy", filterpy.__version__)


def bank(starts):
    filters = []
    for start in starts:
        kf = KalmanFilter(1, 1)
        kf.F = kf.H = np.eye(1)
        kf.x, kf.R = np.array([[start]]), 100.0 * np.eye(1)
        filters.append(kf)
    return MMAEFilterBank(filters, (1 / 3, 1 / 3, 1 / 3), 1, H=np.eye(1))


found = {}
for starts in ((0.0, 1.0, 2.0), (1_000.0, 1.0, 2.0)):
    mmae = bank(starts)
    mmae.predict()
    mmae.update(np.array([[1.0]]))
    pairs = list(zip(mmae.p, mmae.filters, strict=True))
    mean = sum(p * kf.x for p, kf in pairs)
    right = sum(p * (kf.P + (kf.x - mean) ** 2) for p, kf in pairs).item()
    found[starts] = mmae.P.item(), right
    print("starts", starts, "P", round(mmae.P.item(), 4), "right", round(right, 4))
    assert np.allclose(mmae.x, mean)

assert np.allclose(found[0.0, 1.0, 2.0], [0.97239159, 2.60051562])
assert found[1_000.0, 1.0, 2.0][0] < 1e-9 < 2.0 < found[1_000.0, 1.0, 2.0][1]
PY
