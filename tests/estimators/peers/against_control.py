"""python-control: the gain of dlqe, and the prior covariance of its estimators."""

# /// script
# dependencies = ["control==0.10.2", "llvmlite==0.50.0", "numpy==2.4.6", "scipy==1.17.1"]
# ///

import control
import numpy as np
from case import COV, MEAN, A, C, Q, R, Y, close, kf, prior, series

from estimators import run

gain, cov, _ = control.dlqe(A, np.eye(2), C, Q, R)
settled = run(kf, prior, np.tile(Y, (10, 1))).predicted.cov[-1]
close(cov, settled)
close(gain, A @ settled @ C.T @ np.linalg.inv(C @ settled @ C.T + R))

system = control.ss(A, np.eye(2), C, np.zeros((2, 2)), True)
times, inputs = np.arange(50.0), np.vstack([Y.T, np.zeros((2, 50))])
first, second = (
    control.input_output_response(
        control.create_estimator_iosystem(system, Q, R, P0=P0), times, inputs
    ).states
    for P0 in (COV, 100.0 * COV)
)
np.testing.assert_array_equal(first, second)
close(first[:, 0], np.zeros(6))
estimator = control.create_estimator_iosystem(system, Q, R)
found = control.input_output_response(estimator, times, inputs, [MEAN, COV]).states
close(found[:2].T, series.predicted.mean)
close(found[2:].T, series.predicted.cov)
