#!/bin/sh
# Expected: a Kalman filter does not depend on units: with all variances times s^2 and measurements times s,
# estimates are times s. dynamax 1.0.3 (utils/utils.py, psd_solve, called by linear_gaussian_ssm): 1e-9 is
# added to the diagonal of S in every update, whatever its size, also in double precision. With standard
# deviations of 1e-6 the filter ignores its measurements, without a warning. Hurts who has radians per
# second, degrees of latitude or km. Instead: scale states and measurements to the order of 1.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/python" -m pip install -q --no-compile dynamax==1.0.3 jax==0.10.2 numpy==2.4.6 scipy==1.17.1
"$folder/env/bin/python" -W ignore - <<'PY'
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from dynamax.linear_gaussian_ssm import LinearGaussianSSM

jax.config.update("jax_enable_x64", True)
print("dynamax", version("dynamax"))
ssm, found = LinearGaussianSSM(1, 1), {}
for unit in (1.0, 1e-3, 1e-6):
    variance = unit**2 * jnp.eye(1)
    parameters, _ = ssm.initialize(
        jax.random.PRNGKey(0),
        initial_mean=jnp.zeros(1),
        initial_covariance=variance,
        dynamics_weights=jnp.eye(1),
        dynamics_covariance=variance,
        emission_weights=jnp.eye(1),
        emission_covariance=variance,
    )
    y = unit * jnp.array([[1.0], [2.0], [3.0]])
    found[unit] = np.asarray(ssm.filter(parameters, y).filtered_means[:, 0]) / unit
    print("unit", unit, "estimates / unit", found[unit].round(4))

assert np.allclose(found[1.0], [1 / 2, 7 / 5, 31 / 13])
assert np.abs(found[1e-6]).max() < 0.02
PY
