#!/usr/bin/env bash
# One would expect brown noise (exponent 2) to be a random walk, sqrt(n) times as far off after n
# steps as after one. But the inverse Fourier transform over the record makes it periodic: the last
# sample lies one step from the first, and lags beyond half the record shrink (colorednoise 2.2.0,
# powerlaw_psd_gaussian; not documented). Hurts who makes a gyro's bias with it: each episode ends
# with the bias it began with. Instead: cumulative sums of white noise, or a sensor's Bias(...) as a
# random walk; for other exponents draw many times the length and keep a small part.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile colorednoise==2.2.0 numpy==2.4.6

"$folder/env/bin/python" - <<'EOF'
from importlib.metadata import version

import colorednoise
import numpy as np


def moved(records, lag):  # RMS distance between the first sample and the one at the lag
    return np.sqrt(np.mean((records[:, lag] - records[:, 0]) ** 2))


n = 3600  # a bias at 1 Hz for an hour
brown = colorednoise.powerlaw_psd_gaussian(2, (2000, n), random_state=1)
step = np.sqrt(np.mean(np.diff(brown) ** 2))
walk = np.cumsum(np.random.default_rng(1).normal(0, step, (2000, n)), axis=1)

print("colorednoise", version("colorednoise"))
print("RMS movement in steps' RMS after n samples: brown noise, a random walk, sqrt(n)")
for lag in 1, 100, 900, 1800, 2700, 3500, 3599:
    print(f"{lag:5d} {moved(brown, lag) / step:8.1f} {moved(walk, lag) / step:8.1f}"
          f" {lag ** 0.5:8.1f}")

assert moved(brown, n - 1) < 1.1 * step, "the record's end no longer meets its start"
assert moved(brown, 3500) < 0.2 * moved(walk, 3500), "long lags no longer shrink"
assert 0.8 < moved(brown, 100) / moved(walk, 100) < 1.2, "short lags differ, too"
EOF
