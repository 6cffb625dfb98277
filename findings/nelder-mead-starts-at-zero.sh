#!/usr/bin/env bash
# One would not expect it to matter to Nelder-Mead where zero lies on a scale in decades. But its
# first step is 5 % of a coordinate, and 0.00025 where the coordinate is 0: a score in whole
# millimetres is flat there, and the search ends where it began, with success True, while the same
# start called 1 finds the optimum (SciPy 1.17.1, minimize; neither width is documented). Hurts who
# tunes log10(q) of a filter from q = 1 on rounded scores or counts. Instead: options=
# {"initial_simplex": ...} of half a decade, and a look at the values that were tried.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile scipy==1.17.1 numpy==2.4.6

"$folder/env/bin/python" - <<'EOF'
from importlib.metadata import version

import numpy as np
from scipy.optimize import minimize

steps, episodes, q, r = 100, 200, 1e-3, 1.0
rng = np.random.default_rng(0)
level = np.cumsum(rng.normal(0, q**0.5, (steps, episodes)), axis=0)
measured = level + rng.normal(0, r**0.5, level.shape)


def score(decades):  # RMS error [m] at the end with the filter's q, in whole millimetres
    x, p = np.zeros(episodes), 1.0
    for y in measured:
        p += 10.0**decades
        gain = p / (p + r)
        x, p = x + gain * (y - x), (1 - gain) * p
    return round(float(np.sqrt(np.mean((x - level[-1]) ** 2))), 3)


def search(zero, simplex=None):  # from q = 1, which the scale calls `zero`
    tried = []

    def function(z):
        tried.append(z[0] - zero)
        return score(tried[-1])

    options = {} if simplex is None else {"initial_simplex": simplex}
    found = minimize(function, [float(zero)], method="Nelder-Mead", options=options)
    print(f"q = 1 is called {zero}: success {found.success}, log10(q) {found.x[0] - zero:7.4f},"
          f" RMS error {found.fun:.3f} m, {found.nfev} evaluations, first step"
          f" {tried[1] - tried[0]:.5f} decades")
    return found.x[0] - zero, found.fun, found.success


print("SciPy", version("scipy"))
print("RMS error [m] by log10(q):", {d: score(d) for d in range(-6, 2)})
stuck, shifted, wide = search(0), search(1), search(0, [[0.0], [-0.5]])
assert stuck[2] and abs(stuck[0]) < 0.01, "it no longer stops at the start"
assert shifted[1] < 0.4 * stuck[1], "the same start called 1 stops, too"
assert wide[1] < 0.4 * stuck[1], "a wide simplex does not help"
EOF
