#!/usr/bin/env bash
# One would expect a directional sea to keep its spectrum's energy from wherever it comes, if its
# directions cover the circle. But its spreading does not wrap angles: from -pi to pi, the grid of
# its example, waves that run towards pi have half the energy (1.41 m for 2 m), from 0 to 2 pi those
# towards 0 (MCSimPython 0.1.6, waves.wave_spectra.DirectionalSpectrum). Hurts who takes this sea
# for a ship or compares with it: seas from ahead or astern are too calm in silence. Instead: a grid
# of directions centred on the mean direction, and a look at 4 sqrt(m0).
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile MCSimPython==0.1.6 numpy==1.26.4 scipy==1.17.1 \
    matplotlib==3.11.2

"$folder/env/bin/python" -W ignore - <<'EOF'
from importlib.metadata import version

import numpy as np
from MCSimPython.waves.wave_spectra import JONSWAP, DirectionalSpectrum

omega = np.linspace(0.2, 2.5, 116)
_, density = JONSWAP(omega)(hs=2.0, tp=8.0, gamma=3.3)
along = 4 * np.sqrt(np.trapz(density, omega))


def height(angles, mean):
    sea = DirectionalSpectrum(omega, angles, mean, density, s=2)
    _, _, spectrum = sea.spectrum2d()
    return 4 * np.sqrt(np.trapz(np.trapz(spectrum, omega, axis=1), angles))


grids = {"-pi to pi": np.linspace(-np.pi, np.pi, 73), "0 to 2 pi": np.linspace(0, 2 * np.pi, 73)}
print("MCSimPython", version("MCSimPython"))
print(f"significant height of the spectrum {along:.3f} m; of the directional sea:")
print("waves run towards [deg]", *(f"{d:6}" for d in (0, 45, 90, 135, 160, 180)))
seen = {}
for name, angles in grids.items():
    seen[name] = [height(angles, np.radians(d)) for d in (0, 45, 90, 135, 160, 180)]
    print(f"directions {name}   ", *(f"{h:6.3f}" for h in seen[name]))
    centred = [height(angles - angles.mean() + np.radians(d), np.radians(d)) for d in (0, 180)]
    assert np.allclose(centred, along, rtol=1e-3), "a centred grid no longer keeps the height"

assert np.allclose(seen["-pi to pi"][:3], along, rtol=1e-3)
assert abs(seen["-pi to pi"][-1] / along - 0.5 ** 0.5) < 0.01, "waves to pi keep their energy"
assert abs(seen["0 to 2 pi"][0] / along - 0.5 ** 0.5) < 0.01, "waves to 0 keep their energy"
EOF
