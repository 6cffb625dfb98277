"""statsmodels: its state-space form, and the process noise that a new model lacks."""

# /// script
# dependencies = ["statsmodels==0.15.0", "llvmlite==0.50.0", "numpy==2.4.6", "scipy==1.17.1"]
# ///

import numpy as np
from case import COV, MEAN, A, C, Q, R, Y, close, prior, series
from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother

from estimators import LinearModel, make, run, smooth


def theirs(selection=None):
    smoother = KalmanSmoother(k_endog=2, k_states=2)
    smoother["transition"], smoother["design"] = A, C
    smoother["state_cov"], smoother["obs_cov"] = Q, R
    if selection is not None:
        smoother["selection"] = selection
    smoother.initialize_known(MEAN, COV)
    smoother.bind(Y)
    return smoother.smooth()


complete = theirs(np.eye(2))
close(complete.filtered_state.T, series.mean, 1e-8)  # it stops once the covariance settles
close(complete.smoothed_state.T, smooth(series).mean, 1e-8)
close(complete.llf, series.log_likelihood, 1e-8)
still = run(make("kf", LinearModel(A, C, 0.0 * Q, R)), prior, Y)
close(theirs().filtered_state.T, still.mean, 1e-8)
