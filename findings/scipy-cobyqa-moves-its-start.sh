#!/bin/sh
# Expected: minimize evaluates x0 first, so that a search with few evaluations never ends worse than it began.
# SciPy 1.17.1, method="COBYQA": a component of x0 that is nearer to a bound than initial_tr_radius, but not on it,
# is moved onto the bound, or one radius away from it, before anything is evaluated. The radius is 1 unless given,
# and half the narrowest range at most: in a unit box 0, 1/2 and 1 alone stay. Hurts who tunes gains that are good
# already with a few costly simulations: the result may be worse than what was handed in. Nelder-Mead, Powell and
# COBYLA evaluate x0 as it is. Instead: evaluate x0 yourself and keep the better one, as vessel-gym's tuning does.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/python" -m pip install -q --no-compile numpy==2.4.6 scipy==1.17.1
cd "$folder"
"$folder/env/bin/python" - <<'PY'
import numpy as np
import scipy
from scipy.optimize import minimize

print("SciPy", scipy.__version__)
start = np.array([0.2, 0.75])  # gains of a servo, as shares of their ranges, already the best
radius = {"initial_tr_radius": 0.3, "maxfev": 12}
plans = {
    "COBYQA": radius,
    "COBYQA, radius as delivered": {"maxfev": 12},
    "COBYLA": {"rhobeg": 0.3, "maxiter": 12},
    "Powell": {"maxfev": 12},
    "Nelder-Mead": {"maxfev": 12},
}
first, ends = {}, {}
for name, options in plans.items():
    seen = []

    def cost(gains):
        seen.append(np.array(gains))
        return float(np.abs(gains - start).sum())

    method = name.split(",")[0]
    found = minimize(cost, start, method=method, bounds=[(0.0, 1.0)] * 2, options=options)
    first[name], ends[name] = seen[0], found.fun
    print(f"{name}: begins at {seen[0].round(3)}, cost {found.fun:.4f} after {len(seen)}; at x0 {cost(start)}")

np.testing.assert_allclose(first["COBYQA"], [0.3, 0.7], atol=1e-9)
for name in plans:
    moved = name.startswith("COBYQA")
    assert np.allclose(first[name], start, atol=1e-12) != moved, name
    assert (ends[name] > 1e-3) == moved, name
PY
