"""Numbers from the literature, and cases small enough to work out by hand."""

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, make
from tests.estimators.cases import INPUT_PRIOR, kalman_system

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
    expected = [[4.83795, -3.12018, 2.26130], [-3.12018, 6.94718, -2.86068], [2.26130, -2.86068, 9.16037]]
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
    corrections = [filter.update(predicted, model.C @ predicted.mean + e).mean - predicted.mean for e in np.eye(2)]
    gain = np.array(corrections).T
    left = np.eye(3) - gain @ model.C
    np.testing.assert_allclose(left @ model.G, 0.0, atol=1e-12)  # the input leaves no error behind
    after = left @ (model.A @ belief.cov @ model.A.T + model.Q) @ left.T + gain @ model.R @ gain.T
    np.testing.assert_allclose(after, belief.cov, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", KALMAN)
def test_measurement_noise_is_counted_once(name: str):
    """Prior and measurement of variance 1 leave 0.5: 0.747 comes from counting R twice, 0.25 from not counting it."""
    filter = make(name, LinearModel(A=[[1.0]], C=[[1.0]], Q=[[0.0]], R=[[1.0]]))
    belief = filter.update(filter.init(Gaussian([0.0], [[1.0]])), [1.0])
    assert belief.cov[0, 0] == pytest.approx(0.5, abs=1e-15)
    assert belief.mean[0] == pytest.approx(0.5, abs=1e-15)
    assert belief.innovation_cov[0, 0] == pytest.approx(2.0, abs=1e-15)


@pytest.mark.parametrize("name", KALMAN)
def test_the_variance_of_a_constant_falls_as_one_over_the_number_of_measurements(name: str):
    filter = make(name, LinearModel(A=[[1.0]], C=[[1.0]], Q=[[0.0]], R=[[2.0]]))
    belief = filter.init(Gaussian([0.0], [[1.0]]))
    measurements = np.arange(20.0)
    for k, y in enumerate(measurements, start=1):
        belief = filter.update(filter.predict(belief), [y])
        # Prior information 1, and 1/2 from each measurement.
        assert belief.cov[0, 0] == pytest.approx(1.0 / (1.0 + 0.5 * k), rel=1e-13)
        assert belief.mean[0] == pytest.approx(0.5 * measurements[:k].sum() / (1.0 + 0.5 * k), rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("name", KALMAN)
def test_a_random_walk_settles_at_the_golden_ratio(name: str):
    """With Q = R = 1 the predicted variance solves P^2 = P + 1, and the gain is P / (P + 1) = 1 / P."""
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


def test_feedthrough_with_as_many_measurements_as_inputs_tells_the_input_and_nothing_of_the_state():
    model = LinearModel(A=[[0.5]], C=[[1.0]], G=[[1.0]], H=[[2.0]], Q=[[3.0]], R=[[5.0]])
    filter = make("kf-umv-ui", model, input_prior=INPUT_PRIOR)
    belief = filter.update(filter.init(Gaussian([1.0], [[7.0]])), [9.0])
    assert belief.mean[0] == pytest.approx(1.0, abs=1e-14)
    assert belief.cov[0, 0] == pytest.approx(7.0, abs=1e-13)
    assert belief.input_mean[0] == pytest.approx((9.0 - 1.0) / 2.0, abs=1e-14)
    assert belief.input_cov[0, 0] == pytest.approx((7.0 + 5.0) / 4.0, abs=1e-13)
    assert belief.state_input_cov[0, 0] == pytest.approx(-7.0 / 2.0, abs=1e-13)
    predicted = filter.predict(belief)
    assert predicted.mean[0] == pytest.approx(0.5 * 1.0 + 4.0, abs=1e-14)
    # x+ = 0.5 x + d + w with var(x) = 7, var(d) = 3, cov(x, d) = -3.5.
    assert predicted.cov[0, 0] == pytest.approx(0.25 * 7.0 + 3.0 + 2 * 0.5 * -3.5 + 3.0, abs=1e-13)


def test_without_feedthrough_a_measurement_of_the_whole_driven_state_is_the_estimate():
    """With C = G = 1 nothing else is known of the state than its measurement: x = y, P = R."""
    model = LinearModel(A=[[0.5]], C=[[1.0]], G=[[1.0]], Q=[[3.0]], R=[[5.0]])
    filter = make("kf-umv-ui-wdf", model)
    belief = filter.update(filter.init(Gaussian([1.0], [[7.0]])), [2.0])
    first = 1.0 + 7.0 / 12.0  # no input came before the first measurement: a Kalman update
    assert belief.mean[0] == pytest.approx(first, abs=1e-14)
    belief = filter.update(filter.predict(belief), [9.0])
    assert belief.mean[0] == pytest.approx(9.0, abs=1e-13)
    assert belief.cov[0, 0] == pytest.approx(5.0, abs=1e-13)
    assert belief.input_mean[0] == pytest.approx(9.0 - 0.5 * first, abs=1e-13)
    assert belief.input_cov[0, 0] == pytest.approx(0.25 * 35.0 / 12.0 + 3.0 + 5.0, abs=1e-13)


@pytest.mark.parametrize("name", KALMAN)
def test_the_likelihood_of_a_run_is_that_of_the_joint_gaussian(name: str):
    """Innovations and their covariances factor the joint density of all measurements, worked out in one piece."""
    system, steps = kalman_system(4), 5
    model = system.model
    n, p = model.n, model.p
    rng = np.random.default_rng(4)
    y, u = rng.normal(size=(steps, p)), np.zeros((steps, system.m))
    # y_k = C A^k x_0 + sum_j C A^(k-1-j) w_j + v_k, as one linear map of independent Gaussians.
    powers = [np.linalg.matrix_power(model.A, k) for k in range(steps)]
    map_x = np.vstack([model.C @ power for power in powers])
    map_w = np.zeros((steps * p, (steps - 1) * n))
    for k in range(steps):
        for j in range(k):
            map_w[k * p : (k + 1) * p, j * n : (j + 1) * n] = model.C @ powers[k - 1 - j]
    joint = map_x @ system.cov @ map_x.T + map_w @ np.kron(np.eye(steps - 1), model.Q) @ map_w.T
    joint += np.kron(np.eye(steps), model.R)
    residual = y.ravel() - map_x @ system.mean
    expected = residual @ np.linalg.solve(joint, residual) + np.linalg.slogdet(joint)[1]
    filter = make(name, model)
    belief, total = filter.init(system.prior), 0.0
    for k in range(steps):
        belief = filter.predict(belief, u[k]) if k else belief
        belief = filter.update(belief, y[k])
        e, S = belief.innovation, belief.innovation_cov
        total += e @ np.linalg.solve(S, e) + np.linalg.slogdet(S)[1]
    assert total == pytest.approx(expected, rel=1e-12)
