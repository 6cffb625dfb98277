#!/usr/bin/env bash
# One would expect "nautical" directions of a "wavespectra-compatible" spectrum to say where
# the waves come from, clockwise from north. They say where the waves run to, counter-clockwise from
# east, a mirrored sense that no turn mends; wavespectra 4.9.0 takes them as they are (diwasp 0.1.1,
# function diwasp; README on `dir`, attribute "conventions"). Hurts who makes a sea from an ADCP's
# or a buoy's record: waves from ahead become beam seas. Instead: from = (270 - dir) mod 360, and a
# record of one known direction as a test.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile diwasp==0.1.1 wavespectra==4.9.0 \
    xarray==2026.9.0 pandas==3.1.1 scipy==1.17.1 numpy==2.4.6

"$folder/env/bin/python" -W ignore - <<'EOF'
from importlib.metadata import version

import numpy as np
import pandas as pd
import wavespectra  # noqa: F401, adds .spec
from diwasp import diwasp

rng = np.random.default_rng(0)
time, depth, height, g = np.arange(0, 1800, 0.5), 20.0, 0.5, 9.81


def record(to):  # pressure [m of water], east and north velocity half a metre above the ground
    pressure, speed = rng.normal(0, 1e-4, (2, time.size))
    for f in np.linspace(0.08, 0.2, 60):
        omega = 2 * np.pi * f
        k = omega**2 / g
        for _ in range(100):
            k = 0.5 * (k + omega**2 / g / np.tanh(k * depth))
        wave = 0.2 * np.exp(-(((f - 0.12) / 0.02) ** 2))
        wave = wave * np.cos(rng.uniform(0, 2 * np.pi) - omega * time)  # runs along `to`
        pressure += wave * np.cosh(k * height) / np.cosh(k * depth)
        speed += wave * omega * np.cosh(k * height) / np.sinh(k * depth)
    east, north = np.sin(np.radians(to)), np.cos(np.radians(to))
    index = pd.date_range("2026-01-01", periods=time.size, freq="500ms")
    noise = rng.normal(0, 1e-4, (2, time.size))
    return pd.DataFrame(
        {"p": pressure, "u": speed * east + noise[0], "v": speed * north + noise[1]}, index)


print("diwasp", version("diwasp"), "wavespectra", version("wavespectra"))
for to in 0, 45, 90, 200:
    sea = diwasp(record(to), {"p": "pres", "u": "velx", "v": "vely"}, depth=depth, z=height,
                 window_length=1800, verbose=0)
    mean, hs = (float(x.isel(time=0)) for x in (sea.spec.dm(), sea.spec.hs()))
    print(f"waves to {to:3}, from {(to + 180) % 360:3}: mean direction {mean:5.1f}, Hs {hs:.2f} m,",
          sea.attrs["conventions"])
    off = (mean - (90 - to) + 180) % 360 - 180
    assert abs(off) < 3, "directions are no longer counter-clockwise from east"
    assert abs((270 - mean - (to + 180) + 180) % 360 - 180) < 3
EOF
