"""Numbers from the literature."""

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, make


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"])
def test_the_steady_covariance_is_that_of_darouach_1995(name: str):
    """The example of Darouach, Zasadzinski & Xu (1995), section 5."""
    model = LinearModel(
        A=[[0.0, 0.6, 0.075], [0.75, 0.0, 0.0], [0.0, 0.75, 0.0375]],
        C=[[1.0, 1.0, 0.0], [0.0, 1.0, 1.0]], Q=np.diag([3.0, 6.0, 9.0]), R=12.0 * np.eye(2),
        G=[[0.0], [1.0], [1.0]],
    )  # fmt: skip
    filter = make(name, model)
    belief = filter.init(Gaussian(np.zeros(3), 100.0 * np.eye(3)))
    for _ in range(500):
        belief = filter.update(filter.predict(belief), np.zeros(2))
    expected = [
        [4.83795, -3.12018, 2.26130],
        [-3.12018, 6.94718, -2.86068],
        [2.26130, -2.86068, 9.16037],
    ]
    # Half a unit in the last printed digit, and a little for printing.
    np.testing.assert_allclose(belief.cov, expected, rtol=0, atol=6e-6)
    assert belief.input_cov[0, 0] == pytest.approx(7.06987, abs=6e-6)
