#!/usr/bin/env bash
# One would expect yaw, pitch and roll "following the z-y'-x'' convention" to be navigation's
# angles, R = Rz(yaw) Ry(pitch) Rx(roll). They are those of Rx Ry Rz: each angle alone is right, so
# simple checks pass, but at 20 degrees of roll a heading of 40 is read as 38.3 with 12.7 degrees of
# pitch (pyquaternion 0.9.9, yaw_pitch_roll; its docstring states both orders). Hurts who reads an
# IMU's quaternions as headings. Instead: scipy's Rotation.from_quat([x, y, z, w]).as_euler("ZYX"),
# in capital letters.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile pyquaternion==0.9.9 numpy==2.4.6 scipy==1.17.1

"$folder/env/bin/python" - <<'EOF'
from importlib.metadata import version

import numpy as np
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation

print("pyquaternion", version("pyquaternion"))
print("yaw, pitch, roll [deg]:  built from    pyquaternion    scipy")
seen = {}
for angles in (40, 0, 0), (0, 0, 20), (40, 0, 20), (90, 10, 20), (200, 5, 25):
    z, y, x = (Quaternion(axis=axis, degrees=angle)
               for axis, angle in zip(np.eye(3)[::-1], angles, strict=True))
    ship = z * y * x  # heading first, then pitch about the new y axis, then roll
    seen[angles] = np.degrees(ship.yaw_pitch_roll)
    w, *vector = ship.elements
    right = Rotation.from_quat([*vector, w]).as_euler("ZYX", degrees=True)
    other = Rotation.from_matrix(ship.rotation_matrix).as_euler("XYZ", degrees=True)[::-1]
    print(angles, seen[angles].round(1), right.round(1))
    assert np.allclose((right - angles + 180) % 360, 180)
    assert np.allclose(seen[angles], other), "the order of the angles has changed"

assert np.allclose(seen[40, 0, 0], (40, 0, 0)) and np.allclose(seen[0, 0, 20], (0, 0, 20))
assert np.allclose(seen[40, 0, 20], (38.26, 12.70, 15.58), atol=0.01)
EOF
