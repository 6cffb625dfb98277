"""Numbers from the literature, and cases small enough to work out by hand."""

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, make

KALMAN = ["kf", "ekf", "ukf"]


def darouach() -> LinearModel:
    """The example of Darouach, Zasadzinski & Xu (1995), section 5."""
    return LinearModel(
        A=[[0.0, 0.6, 0.075], [0.75, 0.0, 0.0], [0.0, 0.75, 0.0375]],
        C=[[1.0, 1.0, 0.0], [0.0, 1.0, 1.0]],
        G=[[0.0], [1.0], [1.0]],
        Q=np.diag([3.0, 6.0, 9.0]),
        R=12.0 * np.eye(2),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"])
def test_without_feedthrough_the_filter_settles_at_the_covariance_of_darouach_1995(name: str):
    filter = make(name, darouach())
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
    assert np.trace(belief.cov) == pytest.approx(20.94550, abs=6e-6)
    assert belief.input_cov[0, 0] == pytest.approx(7.06987, abs=6e-6)


def test_wdf_steady_gain_gives_the_same_covariance_through_the_error_equation():
    """The settled covariance solves the Lyapunov equation of the error that its own gain leaves."""
    model = darouach()
    filter = make("kf-umv-ui-wdf", model)
    belief = filter.init(Gaussian(np.zeros(3), np.eye(3)))
    for _ in range(500):
        belief = filter.update(filter.predict(belief), np.zeros(2))
    predicted = filter.predict(belief)
    corrections = [
        filter.update(predicted, model.C @ predicted.mean + e).mean - predicted.mean
        for e in np.eye(2)
    ]
    gain = np.array(corrections).T
    left = np.eye(3) - gain @ model.C
    np.testing.assert_allclose(left @ model.G, 0.0, atol=1e-12)  # the input leaves no error behind
    after = left @ (model.A @ belief.cov @ model.A.T + model.Q) @ left.T + gain @ model.R @ gain.T
    np.testing.assert_allclose(after, belief.cov, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", KALMAN)
def test_a_random_walk_settles_at_the_golden_ratio(name: str):
    """With Q = R = 1 the predicted variance solves P^2 = P + 1; the gain is P / (P + 1) = 1 / P."""
    filter = make(name, LinearModel(A=[[1.0]], C=[[1.0]], Q=[[1.0]], R=[[1.0]]))
    belief = filter.init(Gaussian([0.0], [[5.0]]))
    for _ in range(60):
        belief = filter.predict(filter.update(belief, [0.0]))
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    assert belief.cov[0, 0] == pytest.approx(golden, rel=1e-14)
    assert filter.update(belief, [1.0]).mean[0] == pytest.approx(1.0 / golden, rel=1e-14)


@pytest.mark.parametrize("name", KALMAN)
def test_a_perfect_measurement_is_believed_and_leaves_no_variance(name: str):
    filter = make(name, LinearModel(A=np.eye(2), C=np.eye(2), Q=np.eye(2), R=np.zeros((2, 2))))
    belief = filter.update(filter.init(Gaussian([5.0, -5.0], [[2.0, 0.5], [0.5, 1.0]])), [1.0, 2.0])
    np.testing.assert_allclose(belief.mean, [1.0, 2.0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(belief.cov, 0.0, atol=1e-14)
