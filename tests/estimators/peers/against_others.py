"""Seven packages: NaN in a channel, masked arrays, and small units."""

# /// script
# dependencies = [
#   "cuthbert==0.1.1", "dynamax==1.0.3", "filterpy==2.0.0", "jax==0.10.2", "pykalman==0.11.2",
#   "simdkalman==1.0.4", "statsmodels==0.15.0", "torch==2.13.0", "torch-kf==0.4.3",
#   "llvmlite==0.50.0", "numpy==2.4.6", "scipy==1.17.1",
# ]
# ///

import cuthbert
import filterpy.kalman
import jax
import jax.numpy as jnp
import numpy as np
import pykalman
import simdkalman
import torch
import torch_kf
from case import COV, MEAN, A, C, Q, R, Y, after, close, kf, prior, series
from cuthbert.gaussian import kalman
from dynamax.linear_gaussian_ssm import LinearGaussianSSM
from statsmodels.tsa.statespace.kalman_filter import KalmanFilter

from estimators import Gaussian, LinearModel, make, run

jax.config.update("jax_enable_x64", True)


def of_filterpy(y):
    filter = filterpy.kalman.KalmanFilter(2, 2)
    filter.F, filter.H, filter.Q, filter.R, filter.x, filter.P = A, C, Q, R, MEAN, COV
    return filter.batch_filter(y, update_first=True)[:2]


def of_pykalman(y):
    return pykalman.KalmanFilter(A, C, Q, R, None, None, MEAN, COV).filter(y)


def of_dynamax(y, unit=1.0):
    ssm = LinearGaussianSSM(2, 2)
    parameters, _ = ssm.initialize(
        jax.random.PRNGKey(0),
        initial_mean=jnp.array(unit * MEAN),
        initial_covariance=jnp.array(unit**2 * COV),
        dynamics_weights=jnp.array(A),
        dynamics_covariance=jnp.array(unit**2 * Q),
        emission_weights=jnp.array(C),
        emission_covariance=jnp.array(unit**2 * R),
    )
    found = ssm.filter(parameters, jnp.array(y))
    return found.filtered_means, found.filtered_covariances


def of_cuthbert(y):
    start, drift, noise = (jnp.array(np.linalg.cholesky(cov)) for cov in (COV, Q, R))
    nothing = jnp.zeros(2)
    filter = kalman.build_filter(
        jnp.array(MEAN),
        start,
        lambda now: (jnp.array(A), nothing, drift),
        lambda now: (jnp.array(C), nothing, noise, now),
    )
    found = cuthbert.filter(filter, jnp.array(y), filter.init_prepare())
    return found.mean[1:], (found.chol_cov @ found.chol_cov.mT)[1:]


def of_torch_kf(y):
    state = torch_kf.GaussianState(torch.tensor(MEAN)[None, :, None], torch.tensor(COV)[None])
    filter = torch_kf.KalmanFilter(*map(torch.tensor, (A, C, Q, R)))
    found = filter.filter(state, torch.tensor(np.asarray(y))[:, None, :, None], return_all=True)
    return found.mean[:, 0, :, 0], found.covariance[:, 0]


def of_simdkalman(y):
    filter = simdkalman.KalmanFilter(A, Q, C, R)
    found = filter.compute(y[None], 0, MEAN, COV, filtered=True, smoothed=False).filtered.states
    return found.mean[0], found.cov[0]


def of_statsmodels(y):
    filter = KalmanFilter(k_endog=2, k_states=2)
    filter["transition"], filter["design"], filter["selection"] = A, C, np.eye(2)
    filter["state_cov"], filter["obs_cov"] = Q, R
    filter.initialize_known(MEAN, COV)
    filter.bind(y)
    found = filter.filter()
    return found.filtered_state.T, found.filtered_state_cov.T


CHANNEL, BOTH = Y.copy(), Y.copy()
CHANNEL[10:15, 0] = BOTH[10:15] = np.nan
READ = np.where(np.isnan(CHANNEL), 99.0, Y)
MASKED = np.ma.masked_array(READ, np.isnan(CHANNEL))
KINDS = {"channel": CHANNEL, "all": BOTH, "read": READ}


def kind(found, late=False):
    """How a series was read: as ours without a channel or without both, as numbers, or otherwise."""
    mean, cov = map(np.asarray, found)
    if np.isnan(mean[10:]).all():
        return "spreads"
    for name, y in KINDS.items():
        ours = after(kf, y) if late else run(kf, prior, y)
        means, covs = ours.mean[-50:], ours.cov[-50:]
        if np.allclose(mean, means, 1e-6, 1e-6) and np.allclose(cov, covs, 1e-6, 1e-6):
            return name
    measured = run(kf, prior, Y).cov
    return "as if measured" if np.allclose(cov, measured, 1e-6) else "otherwise"


EXPECTED = {
    of_filterpy: ("spreads", "as if measured"),
    of_pykalman: ("spreads", "all"),
    of_dynamax: ("spreads", "read"),
    of_cuthbert: ("channel", "read"),
    of_torch_kf: ("all", "read"),
    of_simdkalman: ("all", "read"),
    of_statsmodels: ("channel", "read"),
}
"""Of NaN in one of two channels, and of a masked array."""
for theirs, (nan, masked) in EXPECTED.items():
    found = tuple(kind(theirs(y.copy()), theirs is of_cuthbert) for y in (CHANNEL, MASKED))
    assert found == (nan, masked), (theirs.__name__, found)
masked = run(kf, prior, MASKED)
assert kind((masked.mean, masked.cov)) == "channel"

# units
small = 1e-6
system = LinearModel(A, C, *(small**2 * cov for cov in (Q, R)))
ours = run(make("kf", system), Gaussian(small * MEAN, small**2 * COV), small * Y)
close(ours.mean / small, series.mean)
unmeasured = np.array([MEAN, A @ MEAN, A @ A @ MEAN])
close(of_dynamax(small * Y, small)[0][:3] / small, unmeasured, 0.05)
assert np.abs(series.mean[:3] - unmeasured).max() > 1.0
