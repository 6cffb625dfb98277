"""`eskf`: on vectors an `ekf`; of attitudes as sure as it says, from any start, with a unit norm, for q as for -q."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import estimators.models
from estimators import (
    Belief,
    Delayed,
    Gaussian,
    InteractingMultipleModels,
    ManifoldGaussian,
    NonlinearModel,
    Recovery,
    by_age,
    chi_square_band,
    make,
    names,
    nees,
    run,
)
from estimators.engine.foreign import Inspection
from tests.estimators.cases import assert_covariance, assert_same, simulate, track, turning_vehicle

DT, DOWN, NORTH = 0.05, np.array([0.0, 0.0, 9.81]), np.array([0.5, 0.0, 0.8])


def times(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton's product of quaternions ``(..., 4)``, real part first."""
    a, v, b, w = p[..., :1], p[..., 1:], q[..., :1], q[..., 1:]
    return np.concatenate([a * b - (v * w).sum(-1, keepdims=True), a * w + b * v + np.cross(v, w)], -1)


def turn(e: np.ndarray) -> np.ndarray:
    """The quaternion of a rotation vector ``(..., 3)``."""
    half = 0.5 * np.linalg.norm(e, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * e], -1)


def vector(q: np.ndarray) -> np.ndarray:
    """The rotation vector of a quaternion, the short way."""
    q = np.where(q[..., :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    scale = np.where(sine > 0.0, 2.0 * np.arctan2(sine, q[..., :1]) / np.where(sine > 0.0, sine, 1.0), 2.0)
    return scale * q[..., 1:]


def away(x: np.ndarray, e: np.ndarray) -> np.ndarray:
    return np.concatenate([times(x[..., :4], turn(e[..., :3])), x[..., 4:] + e[..., 3:]], -1)


def error(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    turned = times(b[..., :4] * np.array([1.0, -1.0, -1.0, -1.0]), a[..., :4])
    return np.concatenate([vector(turned), a[..., 4:] - b[..., 4:]], -1)


def seen_in_body(q: np.ndarray, direction: np.ndarray) -> np.ndarray:
    zero = np.zeros(q.shape[:-1] + (1,))
    whole = np.concatenate([zero, np.broadcast_to(direction, q.shape[:-1] + (3,))], -1)
    return times(times(q * np.array([1.0, -1.0, -1.0, -1.0]), whole), q)[..., 1:]


def transition(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Attitude and bias of the gyroscope, which reads u [rad/s]."""
    q, bias = x[..., :4], x[..., 4:]
    return np.concatenate([times(q, turn(DT * (u - bias))), bias + 0.0 * u], -1)


def measurement(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    """Accelerometer and magnetometer of a body that hardly accelerates."""
    return np.concatenate([seen_in_body(x[..., :4], DOWN), seen_in_body(x[..., :4], NORTH)], -1)


GYRO, WALK = 0.01, 2e-4
ATTITUDE = NonlinearModel(
    transition, measurement, Q=np.diag([(GYRO * DT) ** 2] * 3 + [WALK**2 * DT] * 3),
    R=np.diag([0.3**2] * 3 + [0.05**2] * 3), difference=error, sum=away,
)  # fmt: skip
PRIOR = np.diag([0.1**2] * 3 + [0.02**2] * 3)


def _flown(rows: int, steps: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Priors anywhere, true states, gyroscope and measurements, each drawn as the model says."""
    rng = np.random.default_rng(seed)
    start = np.concatenate([Rotation.random(rows, rng=rng).as_quat(scalar_first=True), np.zeros((rows, 3))], -1)
    x = away(start, rng.normal(size=(rows, 6)) * np.sqrt(np.diag(PRIOR)))
    states, rates, measurements = [], [], []
    for k in range(steps):
        turning = np.array([0.5 * np.sin(0.1 * k), 0.4 * np.cos(0.07 * k), 0.3]) + np.zeros((rows, 3))
        states.append(x)
        measurements.append(measurement(x, None) + rng.normal(size=(rows, 6)) * np.sqrt(np.diag(ATTITUDE.R)))
        rates.append(turning + x[:, 4:])  # what the gyroscope reads, but for its noise, which is Q's
        x = away(transition(x, rates[-1]), rng.normal(size=(rows, 6)) * np.sqrt(np.diag(ATTITUDE.Q)))
    return start, np.array(states), np.array(rates), np.array(measurements)


def _tracked(start: np.ndarray, rates: np.ndarray, measurements: np.ndarray, model: Any = ATTITUDE) -> list[Belief]:
    filter = make("eskf", model)
    belief, beliefs = filter.init(ManifoldGaussian(start, PRIOR)), []
    for k, y in enumerate(measurements):
        belief = filter.predict(belief, rates[k - 1]) if k else belief
        belief = filter.update(belief, y)
        beliefs.append(belief)
    return beliefs


@pytest.mark.slow
def test_it_is_as_sure_of_an_attitude_as_it_should_be_wherever_that_starts():
    """1,500 runs: the mean NEES is in its 99 % band at 5 of 6 times at least."""
    start, states, rates, measurements = _flown(1500, 60, 0)
    beliefs = _tracked(start, rates, measurements)
    low, high = chi_square_band(1500, 6, 0.99)
    none = np.zeros((1500, 6))
    means = [nees(none, b.cov, error(x, b.mean)).mean() for b, x in zip(beliefs, states, strict=True)]
    assert sum(low <= mean <= high for mean in means[::10]) >= 5
    assert np.abs(np.linalg.norm(beliefs[-1].mean[:, :4], axis=-1) - 1.0).max() < 1e-12
    for belief in beliefs[::20]:
        assert_covariance(belief.cov)
        assert belief.healthy.all()
    final = np.linalg.norm(error(states[-1], beliefs[-1].mean)[:, :3], axis=-1)
    assert np.sqrt(np.mean(final**2)) < 0.05 < 0.1 * np.sqrt(3.0)


def test_a_quaternion_and_its_negative_are_the_same_attitude():
    start, _, rates, measurements = _flown(20, 30, 1)
    negative = start * np.array([-1.0] * 4 + [1.0] * 3)
    for one, other in zip(_tracked(start, rates, measurements), _tracked(negative, rates, measurements), strict=True):
        np.testing.assert_allclose(error(one.mean, other.mean), 0.0, atol=1e-12)
        np.testing.assert_allclose(one.cov, other.cov, rtol=0, atol=1e-12)
        np.testing.assert_allclose(one.innovation, other.innovation, rtol=0, atol=1e-12)


def test_the_frame_that_attitudes_are_counted_from_does_not_matter():
    """Everything turned by a rotation: errors are the body's own, so that nothing else changes."""
    frame = turn(np.array([1.0, -2.0, 0.5]))
    start, _, rates, measurements = _flown(10, 20, 2)
    turned = np.concatenate([times(np.broadcast_to(frame, (10, 4)), start[:, :4]), start[:, 4:]], -1)

    def seen(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        back = times(frame * np.array([1.0, -1.0, -1.0, -1.0]) + 0.0 * x[..., :4], x[..., :4])
        return measurement(np.concatenate([back, x[..., 4:]], -1), u)

    model = dataclasses.replace(ATTITUDE, measurement=seen)
    for one, other in zip(
        _tracked(start, rates, measurements), _tracked(turned, rates, measurements, model), strict=True
    ):
        np.testing.assert_allclose(one.cov, other.cov, rtol=0, atol=1e-10)
        np.testing.assert_allclose(one.innovation, other.innovation, rtol=0, atol=1e-9)


def test_missing_measurements_and_batches():
    start, _, rates, measurements = _flown(5, 12, 3)
    measurements[:, :, 3:][np.random.default_rng(3).random((12, 5)) < 0.5] = np.nan
    measurements[4] = np.nan
    batch = _tracked(start, rates, measurements)
    for i in range(5):
        for one, other in zip(batch, _tracked(start[i], rates[:, i], measurements[:, i]), strict=True):
            assert_same(one[i], other, 1e-12)
    np.testing.assert_allclose(batch[4].cov, make("eskf", ATTITUDE).predict(batch[3], rates[3]).cov, rtol=0, atol=1e-12)


def test_the_reset_of_an_attitude_is_that_of_the_book():
    """Sola (2017), sec. 6.3: ``I - [e]x / 2`` to first order in the error that was estimated."""
    model = NonlinearModel(
        lambda x, u: x, lambda x, u: seen_in_body(x, DOWN)[..., :2], 1e-6 * np.eye(3), 1e-4 * np.eye(2),
        difference=lambda a, b: vector(times(b * np.array([1.0, -1.0, -1.0, -1.0]), a)),
        sum=lambda x, e: times(x, turn(e)),
    )  # fmt: skip
    filter, cov = make("eskf", model), np.diag([0.1, 0.2, 0.3]) ** 2
    before = filter.init(ManifoldGaussian([1.0, 0.0, 0.0, 0.0], cov))
    after = filter.update(before, [0.2, -0.3])
    _, C = model.linearise_measurement(before.mean, None, before.cov)
    K = cov @ C.T @ np.linalg.inv(C @ cov @ C.T + model.R)
    e = model.difference(after.mean, before.mean)
    np.testing.assert_allclose(e, K @ after.innovation, rtol=0, atol=1e-12)
    skew = np.array([[0.0, -e[2], e[1]], [e[2], 0.0, -e[0]], [-e[1], e[0], 0.0]])
    G = np.eye(3) - 0.5 * skew
    expected = G @ (cov - K @ C @ cov) @ G.T
    assert np.abs(e).max() > 0.01
    # The rest is of second order, [e]x^2 / 12 and less; without the reset it would be of first.
    second = np.abs(e).max() ** 2 * np.abs(cov).max()
    assert np.abs(after.cov - expected).max() < second
    assert np.abs(after.cov - (cov - K @ C @ cov)).max() > 2.0 * np.abs(after.cov - expected).max()


def test_on_vectors_it_is_the_ekf_with_or_without_a_difference():
    system = turning_vehicle(0)
    record = simulate(system, 0, 4, 15)
    plain, ekf = make("eskf", system.model), make("ekf", system.model)
    ekf._programs = None  # the same NumPy
    tracks = [track(filter, system.rows(4), record) for filter in (plain, ekf)]
    for one, other in zip(*tracks, strict=True):
        assert_same(one, other)
    told = dataclasses.replace(
        system.model, state_angles=(), difference=lambda a, b: a - b, sum=lambda x, e: x + e,
    )  # fmt: skip
    prior = ManifoldGaussian(system.rows(4).mean, system.cov)
    for one, other in zip(track(make("eskf", told), prior, record), tracks[0], strict=True):
        assert_same(one, other, 1e-8)  # Jacobians by differences of other steps


def test_jacobians_of_ones_own_are_by_errors_and_compared():
    def jacobian(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        rate = DT * (u - x[..., 4:])
        A = np.zeros(x.shape[:-1] + (6, 6))
        A[..., :3, :3] = Rotation.from_rotvec(rate).as_matrix().mT
        A[..., 3:, 3:] = np.eye(3)
        # The right Jacobian of the step's rotation, by its series: a bias turns the body the other way.
        K = np.zeros(x.shape[:-1] + (3, 3))
        K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -rate[..., 2], rate[..., 1], -rate[..., 0]
        K = K - K.mT
        A[..., :3, 3:] = -DT * (np.eye(3) - K / 2.0 + K @ K / 6.0 - K @ K @ K / 24.0)
        return A

    start, _, rates, measurements = _flown(4, 10, 5)
    own = dataclasses.replace(ATTITUDE, transition_jacobian=jacobian)
    for one, other in zip(_tracked(start, rates, measurements, own), _tracked(start, rates, measurements), strict=True):
        assert_same(one, other, 1e-8)
    wrong = dataclasses.replace(ATTITUDE, transition_jacobian=lambda x, u: jacobian(x, u).mT)
    with pytest.raises(ValueError, match="transition_jacobian differs from transition: entry"):
        _tracked(start, rates, measurements, wrong)


def test_a_lost_row_begins_again_from_its_prior():
    start, _, rates, measurements = _flown(3, 3, 6)
    filter, belief = make("eskf", ATTITUDE), _tracked(start, rates, measurements)[-1]
    mean = np.where(np.arange(3)[:, None] == 1, np.nan, belief.mean)
    lost = filter.update(filter.predict(belief.replace(mean=mean), rates[2]), measurements[2])
    np.testing.assert_array_equal(lost.recovery, [Recovery.USUAL, Recovery.PRIOR, Recovery.USUAL])
    fresh = filter.update(filter.init(ManifoldGaussian(start, PRIOR)).replace(u=rates[2]), measurements[2])
    assert_same(lost[1:2], fresh[1:2], 1e-12, ignore=["recovery"])


def test_difference_and_sum_that_are_not_inverse_are_refused_in_a_sentence():
    prior = ManifoldGaussian(np.array([1.0, 0, 0, 0, 0, 0, 0]), PRIOR)
    for changes, sentence in (
        ({"difference": lambda a, b: 2.0 * error(a, b)}, "inverse of sum: component 0 of"),
        ({"difference": lambda a, b: error(b, a)}, "difference must be the inverse of sum"),
        ({"difference": lambda a, b: error(a, b)[..., :5]}, r"gave an error of shape \(5,\), expected \(6,\)"),
        ({"sum": lambda x, e: away(x, e)[..., :6]}, "sum must give a state like its first argument"),
        ({"sum": lambda x, e: np.concatenate([times(turn(e[..., :3]), x[..., :4]), x[..., 4:] + e[..., 3:]], -1)},
         "difference must be the inverse of sum"),
    ):  # fmt: skip
        filter = make("eskf", dataclasses.replace(ATTITUDE, **changes))
        with pytest.raises(ValueError, match=sentence):
            filter.init(prior)
    with pytest.raises(ValueError, match="the prior is for 7 errors, the model has 6"):
        make("eskf", ATTITUDE).init(Gaussian(np.zeros(7), np.eye(7)))
    with pytest.raises(ValueError, match="the prior is for 2 states, the model has 4"):
        make("ekf", turning_vehicle(0).model).init(ManifoldGaussian(np.zeros(4), np.eye(2)))
    for incomplete in ({"sum": None}, {"difference": None}):
        with pytest.raises(ValueError, match="difference and sum belong together: give both, or neither"):
            dataclasses.replace(ATTITUDE, **incomplete)
    with pytest.raises(ValueError, match="leave state_angles out"):
        dataclasses.replace(ATTITUDE, state_angles=(0,))


def test_states_of_another_length_are_refused_in_a_sentence():
    model = NonlinearModel(
        lambda q, u: q, lambda q, u: seen_in_body(q, DOWN), 1e-6 * np.eye(3), 0.1 * np.eye(3),
        difference=lambda a, b: vector(times(b * np.array([1.0, -1.0, -1.0, -1.0]), a)),
        sum=lambda x, e: times(x, turn(e)),
    )  # fmt: skip
    for _ in range(2):  # whether or not another filter has used the model
        filter = make("eskf", model)
        for plain in (np.zeros(3), np.ones((2, 3))):
            with pytest.raises(ValueError, match="the model has a difference: give the prior as ManifoldGaussian"):
                filter.init(Gaussian(plain, np.eye(3)))
        for length in (3, 5):
            with pytest.raises(ValueError, match=f"sum must take states and errors, .* state of {length} numbers"):
                filter.init(ManifoldGaussian(np.ones(length), np.eye(3)))
        belief = filter.init(ManifoldGaussian([1.0, 0.0, 0.0, 0.0], np.eye(3)))
    with pytest.raises(ValueError, match="the prior has a state of 5 numbers, the first prior had 4"):
        filter.init(ManifoldGaussian(np.ones(5), np.eye(3)))
    wrong = belief.replace(mean=np.ones(3))
    for step in (lambda: filter.predict(wrong), lambda: filter.update(wrong, np.zeros(3))):
        with pytest.raises(ValueError, match="the belief has a state of 3 numbers, the first prior had 4"):
            step()
    with pytest.raises(TypeError, match="belief must be of type Belief, got dict"):
        filter.predict({})


@pytest.mark.parametrize("name", [name for name in names() if name not in ("eskf", "kf")])
def test_other_filters_refuse_states_that_are_no_vectors(name: str):
    if name in ("kf-umv-ui-wdf", "ulise"):
        sentence = "needs (a LinearModel|states that are vectors)"
    else:
        sentence = f"{name} needs states that are vectors: for a model with a difference use eskf"
    model = dataclasses.replace(ATTITUDE, G=np.eye(6, 1), H=np.eye(6, 1))
    with pytest.raises(ValueError, match=sentence):
        make(name, model)
    with pytest.raises(ValueError, match="imm needs states that are vectors"):
        InteractingMultipleModels([make("eskf", ATTITUDE)], [[1.0]])


def test_whole_series_of_states_that_are_no_vectors_are_run_and_come_late():
    start, _, rates, measurements = _flown(4, 12, 3)
    filter, prior = make("eskf", ATTITUDE), ManifoldGaussian(start, PRIOR)
    series = run(filter, prior, measurements, u=rates)
    by_hand = _tracked(start, rates, measurements)
    assert np.isfinite(series.log_likelihood).all()
    delay = np.minimum(np.random.default_rng(0).integers(0, 4, measurements.shape), 11 - np.arange(12)[:, None, None])
    late = run(Delayed(filter, 3), prior, by_age(measurements, delay), u=rates)
    for found in (series, late):
        np.testing.assert_allclose(error(found.mean[-1], by_hand[-1].mean), 0.0, atol=1e-12)
        np.testing.assert_allclose(found.cov[-1], by_hand[-1].cov, rtol=0, atol=1e-12)


def test_functions_that_are_made_for_a_step_are_not_inspected(monkeypatch: pytest.MonkeyPatch):
    """Inspecting takes a hundred times as long as calling."""
    inspected = []
    refusal = Inspection("not here")
    monkeypatch.setattr(estimators.models, "inspection_of", lambda *given: inspected.append(given) or refusal)
    filter, start, u = make("eskf", ATTITUDE), np.eye(2, 7), np.zeros((2, 3))
    belief = filter.init(ManifoldGaussian(start, PRIOR))
    for _ in range(3):
        belief = filter.predict(filter.update(belief, measurement(start, u)), u)
    assert not inspected
