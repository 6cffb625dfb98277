"""What a lost row costs: the measurement or the step that went wrong, in that row, and nothing else."""

import numpy as np
import pytest

from estimators import (
    Belief,
    Filter,
    Gaussian,
    LinearModel,
    NonlinearModel,
    RandomKeys,
    compiled,
    make,
)
from tests.estimators.cases import (
    Case,
    arrays,
    assert_same,
    kalman_system,
    one_of_each,
    simulate,
    some_cases,
)

I3 = np.eye(3)
KNOWN = np.array([5.0, 6.0, 7.0])
UNKNOWN_INPUT = "kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"


def _assert_finite(belief: Belief) -> None:
    for name, array in arrays(belief).items():
        assert name == "u" or np.isfinite(array).all(), name


# --- singular systems -----------------------------------------------------------------------------


def _singular(name: str, seed: int) -> tuple[LinearModel | NonlinearModel, np.ndarray]:
    """A random model whose noises lack rank, with a channel that may repeat others, and such a prior covariance."""
    rng, n, p = np.random.default_rng(seed), 3, 4
    A, B, C = (rng.normal(size=shape) for shape in ((n, n), (n, 1), (p, n)))
    C[3] = C[0] + seed % 2 * C[1]
    R = np.diag(rng.integers(0, 2, p) * 10.0 ** rng.uniform(-9, 1, p)) * (seed % 3 > 0)
    R[3] = 0.0
    few, more = rng.normal(size=(n, seed % 3)), rng.normal(size=(n, 1 + seed % 3))
    Q, P = 10.0 ** rng.uniform(-6, 2) * few @ few.T, 100.0 * more @ more.T
    unknown = {"G": rng.normal(size=(n, 1)), "H": rng.normal(size=(p, 1))}
    unknown = unknown if name in UNKNOWN_INPUT else {}
    if name in ("kf", "ulise") or seed % 2:
        return LinearModel(A, C, Q, R, B=B, **unknown), P
    way = compiled if seed % 4 else lambda f: f
    f = way(lambda x, u: np.matvec(A, x) + np.sin(x) * u)
    return NonlinearModel(
        f, way(lambda x, u: np.matvec(C, x) + 0.1 * x[..., :1] ** 2), Q, R, **unknown
    ), P


@pytest.mark.parametrize("name", [
    "ekf", "ukf", "kf-umv-ui", "enkf",  # kf is ekf on a linear model
    *(pytest.param(name, marks=pytest.mark.nightly) for name in ("huber-kf", "ulise")),
])  # fmt: skip
def test_singular_systems_leave_no_nan_and_other_rows_alone(name: str):
    """18,000 predictions and updates, some of absurd measurements and inputs; a few rows alone give the same bits."""
    rows, some, lost, keys = 36, slice(0, 36, 7), 0, RandomKeys.seeded(range(36))
    for seed in range(6):
        model, P = _singular(name, seed)
        filter, rng = make(name, model), np.random.default_rng(seed)
        belief = filter.init(Gaussian(rng.normal(size=(rows, 3)), P), rng=keys)
        alone = belief[some]
        for k in range(12):
            u, now = rng.normal(size=(rows, 1)), keys.at(k)
            with np.errstate(over="ignore"):
                y = model.measurement(belief.mean, u) + rng.normal(size=(rows, 4))
                u[rng.random(rows) < 0.05] = np.nan
                y[rng.random(y.shape) < 0.2], y[rng.random(y.shape) < 0.02] = np.nan, 1e300
                ahead, alone = (
                    filter.predict(belief, u, now),
                    filter.predict(alone, u[some], now[some]),
                )
                belief = filter.update(ahead, y, rng=now)
                alone = filter.update(alone, y[some], rng=now[some])
            for each in (ahead, belief):
                _assert_finite(each)
                values = np.linalg.eigvalsh(each.cov)
                assert (values[..., 0] >= -1e-9 * values[..., -1]).all()
                lost += (~each.healthy).sum()
            assert_same(belief[some], alone)
    assert lost > 500


@pytest.mark.parametrize("name", ["kf", "ukf"])
def test_a_step_without_noise_is_its_prediction_and_update(name: str):
    """What a channel without noise leaves of a variance is rounding, and goes in both ways."""
    A, C = np.random.default_rng(1).normal(size=(2, 3, 3))
    filter = make(name, LinearModel(A, C, 0.0 * I3, 0.0 * I3))
    belief = filter.init(Gaussian(KNOWN, 1e4 * I3))
    for _ in range(4):
        joined, belief = filter.step(belief, KNOWN), filter.update(filter.predict(belief), KNOWN)
        np.testing.assert_array_equal(joined.cov, belief.cov)


@pytest.mark.parametrize("name", ["kf-umv-ui", "ulise"])
def test_an_unknown_input_without_noise_is_known_exactly(name: str):
    """The innovation covariance is singular, and the unknown input lies outside its range."""
    C = np.concatenate([I3, [[1.0, 1.0, 1.0]]])
    G, H = I3[:, 2:], np.eye(4)[:, 2:3]
    filter, x = make(name, LinearModel(I3, C, 0.0 * I3, np.zeros((4, 4)), G=G, H=H)), KNOWN
    belief = filter.init(Gaussian(np.zeros(3), 4.0 * I3))
    for k in range(6):
        if k:
            belief, x = filter.predict(belief), x + [0.0, 0.0, 0.3]
        belief = filter.update(belief, C @ x + [0.0, 0.0, 0.3, 0.0])
        np.testing.assert_allclose(belief.mean, x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(belief.input_mean, [0.3], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["kf", "ukf", "huber-kf", "robust-kf", "kf-umv-ui", "ulise"])
@pytest.mark.parametrize("precision", [1e5, 1e13, 1e26])
def test_a_precise_measurement_leaves_a_covariance(name: str, precision: float):
    """Mere rounding must not have a negative eigenvalue, and up to 1e13 the row is not even lost."""
    unknown = {"G": I3[:, :1], "H": I3[:, :1]} if name in UNKNOWN_INPUT else {}
    C = np.array([[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, 0.3, 1.0]])
    filter = make(name, LinearModel(I3, C, 1e-3 * I3, I3 / precision, **unknown))
    belief = filter.init(Gaussian(np.zeros((4, 3)), I3))
    for _ in range(3):
        belief = filter.update(filter.predict(belief), np.zeros(3))
        assert belief.healthy.all() or precision > 1e13
        assert (np.linalg.eigvalsh(belief.cov)[..., 0] >= -1e-12 * np.trace(belief.cov[0])).all()


# --- numbers that are not finite ------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ekf", "ukf", "enkf", "etkf", "pf", "huber-kf", "robust-kf"])
def test_a_channel_that_is_not_finite_costs_that_channel_alone(name: str):
    """The root of a negative number, and in the third row the slope of the root at 0."""

    def measurement(x: np.ndarray, u: None) -> np.ndarray:
        return np.concatenate([x[..., :2], np.sqrt(x[..., 2:])], -1)

    model = NonlinearModel(lambda x, u: x, measurement, 0.1 * I3, I3)
    slopes = not make(name, model).random and name != "ukf"
    prior = Gaussian(
        [[1.0, 2.0, -50.0], [1.0, 2.0, 50.0], [1.0, 2.0, 0.0 if slopes else -60.0]], I3
    )
    filter, keys = make(name, model), RandomKeys.seeded(range(3))
    seen = np.array([[True, True, False], [True, True, True], [True, True, False]])
    before = filter.init(prior, rng=keys)
    failed, masked = (
        filter.update(before, [2.0, 3.0, 7.0], rng=keys, available=mask) for mask in (None, seen)
    )
    np.testing.assert_array_equal(failed.available, seen)
    np.testing.assert_array_equal(failed.healthy, [False, True, False])
    assert_same(failed, masked, 1e-12, ignore=["healthy"])
    np.testing.assert_allclose(failed.mean[:, :2], [[1.5, 2.5]] * 3, rtol=0, atol=0.5)


@one_of_each()
def test_a_lost_row_keeps_its_values_for_a_step_and_goes_on(case: Case):
    """A measurement beyond all numbers in row 1, a known input that is none in row 2; rows 0 and 3 keep their bits."""
    system, rows = case.system(0), 4
    filter, keys = case.make(system.model), RandomKeys.seeded(range(rows))
    record = simulate(system, 0, rows, 4)
    begun = filter.update(filter.init(system.rows(rows), rng=keys), record.y[0], rng=keys)

    def run(u: np.ndarray, y: np.ndarray, part: slice = slice(None)) -> list[Belief]:
        beliefs = [begun[part]]
        for k, known, measured in ((1, u, y), (2, record.u[1], record.y[2])):
            now = keys.at(k)[part]
            predicted = filter.predict(beliefs[-1], known[part], rng=now)
            beliefs += [predicted, filter.update(predicted, measured[part], rng=now)]
        return beliefs

    u, y, others = record.u[0].copy(), record.y[1].copy(), np.array([True, False, False, True])
    u[2], y[1] = np.nan, np.finfo(float).max
    with np.errstate(all="ignore"):
        usual, odd, alone = run(record.u[0], record.y[1]), run(u, y), run(u, y, slice(2, 3))
    for one, other in zip(odd, usual, strict=True):
        _assert_finite(one)
        assert_same(one[others], other[others])
    for one, other in zip(odd, alone, strict=True):
        assert_same(one[2:3], other)
    np.testing.assert_array_equal(odd[1].healthy, [True, True, False, True])
    np.testing.assert_array_equal(odd[1].mean[2], begun.mean[2])
    assert not odd[2].healthy[2]  # an update tells of its step's prediction, too
    for row in np.flatnonzero(~odd[2].healthy & odd[1].healthy):
        np.testing.assert_array_equal(odd[2].mean[row], odd[1].mean[row])
    assert odd[-1].healthy[[0, 2, 3]].all()


@some_cases("kf", "kf-umv-ui")
def test_the_variance_of_a_missing_measurement_has_no_effect(case: Case):
    """Receivers send NaN or infinity as the variance of what they did not see."""
    system = case.system(0)
    filter, p = case.make(system.model), system.model.p
    predicted = filter.predict(filter.init(system.rows(3)), np.ones(system.m))
    y, mask = np.ones(p), np.arange(p) != 0
    missing = filter.update(predicted, y, available=mask)
    for variance in (np.nan, np.inf, -0.5):
        R = np.array(system.model.R)
        R[0], R[:, 0] = variance, variance
        assert_same(filter.update(predicted, y, available=mask, R=R), missing, 1e-13)
        if not np.isfinite(variance):  # then the measurement is missing, whatever it says
            assert_same(filter.update(predicted, y, R=R), missing, 1e-13)
    for wrong, sentence in (
        (-0.5 * np.eye(p), "R must be positive semidefinite, its smallest eigenvalue is -0.5"),
        (np.eye(p) + np.triu(np.full((p, p), 0.2), 1), "R must be symmetric"),
    ):
        with pytest.raises(ValueError, match=sentence):
            filter.update(predicted, y, R=wrong)


# --- a filter of one's own ------------------------------------------------------------------------


class _Textbook(Filter):
    """A Kalman filter in plain NumPy, with an inverse, whose covariance is symmetric but for rounding."""

    def _predict(self, belief, u, mean, A, Q):
        return {"mean": mean, "cov": A @ belief.cov @ A.mT + Q}

    def _update(self, belief, u, e, C, R, available):
        S = C @ belief.cov @ C.mT + R
        K = belief.cov @ C.mT @ np.linalg.inv(S)
        return {"mean": belief.mean + np.matvec(K, e), "cov": belief.cov - K @ C @ belief.cov}


def test_textbook_formulas_are_healthy_and_the_kalman_filter():
    system = kalman_system(3)
    record, beliefs = simulate(system, 0, 5, 200), []
    for filter in (_Textbook(system.model), make("kf", system.model)):
        belief = filter.init(system.rows(5))
        for u, y in zip(record.u, record.y, strict=True):
            belief = filter.update(filter.predict(belief, u), y)
            assert belief.healthy.all()
        beliefs.append(belief)
    assert_same(*beliefs, 1e-9)


def test_inverting_a_singular_matrix_loses_that_row_alone():
    """Two perfect sensors of one state, of which one is missing in the second row."""
    model = LinearModel(np.eye(2), [[1.0, 0.0], [1.0, 0.0]], np.eye(2), np.zeros((2, 2)))
    filter = _Textbook(model)
    predicted = filter.predict(filter.init(Gaussian(np.zeros((3, 2)), np.eye(2))))
    updated = filter.update(predicted, [[1.0, 1.0], [2.0, np.nan], [3.0, 3.0]])
    np.testing.assert_array_equal(updated.healthy, [False, True, False])
    np.testing.assert_array_equal(updated.mean, [[0.0, 0.0], [2.0, 0.0], [0.0, 0.0]])
    np.testing.assert_array_equal(updated.cov[0], predicted.cov[0])
    assert_same(filter.update(predicted[1], [2.0, np.nan]), updated[1])
