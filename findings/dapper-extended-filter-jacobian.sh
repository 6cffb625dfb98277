#!/bin/sh
# Expected: an extended Kalman filter takes the Jacobian of f at the estimate that it propagates.
# DAPPER 1.7.1 (da_methods/extended.py): ExtKF moves the mean first and takes Dyn.linear at the moved mean;
# ExtRTS of the same file takes it before the step. So the two have different filter estimates
# ("analysis", .a) on a nonlinear model. Hurts who quotes ExtKF as the EKF baseline: on this pendulum
# estimates are up to .23 rad apart. Instead: the .a statistics of ExtRTS(), which filters as textbooks do.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
pip="$folder/env/bin/python -m pip install -q --no-compile"
$pip numpy==2.4.6 scipy==1.17.1 matplotlib==3.11.2 pyyaml==6.0.4 tqdm==4.70.1 \
  colorama==0.4.6 tabulate==0.8.10 pathos==0.3.2 dill==0.3.8 ipython==9.18.1
$pip --no-deps DAPPER==1.7.1 patlib==0.3.7 struct-tools==0.2.5 mpl-tools==0.4.1 threadpoolctl==3.8.0  # not Jupyter
cd "$folder"
TQDM_DISABLE=1 "$folder/env/bin/python" -W ignore - <<'PY'
import dapper
import numpy as np
from dapper import da_methods, mods

print("DAPPER", dapper.__version__)


def step(x, t, dt):
    speed = x[..., 1] - 0.5 * np.sin(x[..., 0])
    return np.stack([x[..., 0] + 0.5 * speed, speed], -1)


def slope(x, t, dt):
    bend = -0.5 * np.cos(x[0])
    return np.array([[1.0 + 0.5 * bend, 0.5], [bend, 1.0]])


row = np.array([[1.0, 0.0]])
Q, R, steps = 0.01, 0.05, 1_000
HMM = mods.HiddenMarkovModel(
    {"M": 2, "model": step, "linear": slope, "noise": Q},
    {"M": 1, "model": lambda x: x @ row.T, "linear": lambda x: row, "noise": R},
    mods.Chronology(1.0, dko=1, K=steps),
    mods.GaussRV(mu=np.array([0.0, 1.0]), C=0.5),
)
dapper.set_seed(3)
x, y = HMM.simulate()
mean, cov = np.array([0.0, 1.0]), 0.5 * np.eye(2)
textbook = []
for k in range(steps):
    F = slope(mean, 0.0, 1.0)
    mean, cov = step(mean, 0.0, 1.0), F @ cov @ F.T + Q * np.eye(2)
    gain = cov @ row.T / (row @ cov @ row.T + R)
    mean, cov = mean + gain @ (y[k] - row @ mean), cov - gain @ row @ cov
    textbook.append(mean)
textbook = np.array(textbook)
apart = {}
for method in da_methods.ExtKF(), da_methods.ExtRTS():
    method.assimilate(HMM, x, y)
    analysis = np.asarray(method.stats.mu.a)
    name, rmse = method.da_method, np.sqrt(np.mean(np.square(analysis - x[1:])))
    apart[name] = np.abs(analysis - textbook).max()
    print(name, "RMSE", rmse.round(4), "largest distance from the textbook", apart[name].round(6))

assert apart["ExtRTS"] < 1e-9
assert apart["ExtKF"] > 0.01
PY
