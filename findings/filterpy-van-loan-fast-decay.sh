#!/bin/sh
# Expected: over a long step the transition matrix of a stable model tends to 0, and its noise to the stationary
# covariance. filterpy 2.0.0 (common/discretization.py, van_loan_discretization): it takes one exponential, which
# also contains exp(-F dt), so a fast decay swamps all else. With time constants of .05, 1 and 100 s the covariance
# has a negative eigenvalue at a step of 2 s, and at 3 s it is 1e33. No error, no warning. Hurts who bridges a gap
# in a log, or models a fast actuator beside a slow bias. Instead: discretise a part of the step of at most a few
# of the fastest time constants, and double it: Q <- F Q F' + Q, F <- F F.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/python" -m pip install -q --no-compile filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
"$folder/env/bin/python" -W error - <<'PY'
import filterpy
import numpy as np
from filterpy.common import van_loan_discretization

print("filterpy", filterpy.__version__)
F = np.array([[-20.0, 0.0, 0.0], [1.0, -0.01, 0.0], [0.0, 1.0, -1.0]])
G = np.diag([2.0, 0.1, 0.3])


def doubled(dt, parts=32):
    transition, noise = van_loan_discretization(F, G, dt / parts)
    while parts > 1:
        noise = transition @ noise @ transition.T + noise
        transition, parts = transition @ transition, parts // 2
    return transition, noise


for dt in (0.5, 2.0, 3.0):
    once, right = van_loan_discretization(F, G, dt), doubled(dt)
    error = [np.abs(a - b).max() for a, b in zip(once, right)]
    lowest = [np.linalg.eigvalsh(noise)[0] for _, noise in (once, right)]
    print(f"dt {dt}: errors of F {error[0]:.1e}, of Q {error[1]:.1e};", end=" ")
    print(f"smallest eigenvalue of Q {lowest[0]:.1e}, doubled {lowest[1]:.1e}")
    assert lowest[1] > 0.0
    if dt == 0.5:
        assert max(error) < 1e-9
    else:
        assert lowest[0] < 0.0, "the covariance is one now"
assert error[0] > 1e3 and error[1] > 1e20, "a step of 3 s is right now"
PY
