"""What is lost when an update goes wrong: the offending measurement, and nothing that was known without it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators import (
    Belief,
    Filter,
    Gaussian,
    LinearModel,
    Measurement,
    NonlinearModel,
    RandomKeys,
    Recovery,
    make,
    names,
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
UNKNOWN_INPUT = ("kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise")


def _model(
    name: str, C: np.ndarray, R: np.ndarray, nonlinear: bool = False, Q: float = 0.0
) -> LinearModel:
    """Three constants, and for filters that want one an input that no perfect measurement shows."""
    C, R = np.asarray(C, float), np.asarray(R, float)
    unknown = {}
    if name in UNKNOWN_INPUT:
        C = np.concatenate([C, [[0.0, 0.0, 1.0]]])
        R = np.pad(R, (0, 1))
        R[-1, -1] = 1.0
        H = np.zeros((len(C), 1))
        H[-1] = 1.0
        unknown = {"G": [[0.0], [0.0], [1.0]], "H": H if name == "kf-umv-ui" else None}
    return LinearModel(I3, C, Q * I3, R, **unknown)


PERFECT = [name for name in names() if name != "pf"]
"""Filters that take measurements without noise."""


def _make(name: str, model: LinearModel) -> Filter:
    return make(name, model, **({"members": 20} if name in ("enkf", "enkf-sr", "etkf") else {}))


def _seen(filter: Filter, x: np.ndarray, steps: int) -> Belief:
    """The belief after perfect measurements of a constant, from a prior at the origin."""
    rng = np.random.default_rng(0)
    belief = filter.init(Gaussian(np.zeros(3), 4.0 * I3), rng=rng)
    for k in range(steps):
        belief = filter.predict(belief, rng=rng) if k else belief
        belief = filter.update(belief, filter.model.measurement(x, None), rng=rng)
        for name, array in arrays(belief).items():
            assert np.isfinite(array).all(), name
        values = np.linalg.eigvalsh(belief.cov)
        assert values[0] >= -1e-10 * values.sum()
    return belief


@pytest.mark.parametrize("name", PERFECT)
def test_a_redundant_perfect_sensor_takes_nothing_away(name: str):
    """With every state read perfectly, and their sum, S is singular, and after that nothing but rounding."""
    model = _model(name, [*I3, [1.0, 1.0, 1.0]], np.zeros((4, 4)))
    belief = _seen(_make(name, model), KNOWN, steps=5)
    np.testing.assert_allclose(belief.mean, KNOWN, rtol=0, atol=1e-9)
    assert belief.recovery < Recovery.PRIOR


@pytest.mark.parametrize("name", [name for name in PERFECT if name not in UNKNOWN_INPUT])
def test_two_equal_perfect_sensors_are_one_and_said_to_be(name: str):
    twice = _make(
        name,
        _model(name, [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], np.zeros((3, 3)), Q=0.1),
    )
    rng = np.random.default_rng(1)
    belief = twice.init(Gaussian(np.zeros(3), 4.0 * I3), rng=rng)
    for k in range(4):
        belief = twice.predict(belief, rng=rng) if k else belief
        belief = twice.update(belief, [5.0, 5.0, 6.0], rng=rng)
        assert belief.recovery == Recovery.PSEUDO_INVERSE
        assert not belief.healthy
        assert "repeat others" in belief.reasons.item()
        np.testing.assert_allclose(belief.mean[:2], [5.0, 6.0], rtol=0, atol=1e-9)
    assert belief.available.all()


def test_the_pseudo_inverse_is_the_filter_without_the_redundant_sensor():
    rng = np.random.default_rng(2)
    C = rng.normal(size=(2, 3))
    A, Q = 0.9 * np.linalg.qr(rng.normal(size=(3, 3)))[0], 0.1 * I3
    filters = [
        make("kf", LinearModel(A, rows, Q, np.zeros((len(rows),) * 2)))
        for rows in (C, [*C, C[0] + C[1]])
    ]
    beliefs = [filter.init(Gaussian(np.zeros((4, 3)), I3)) for filter in filters]
    for _ in range(5):
        y = rng.normal(size=(4, 2))
        measurements = [y, np.concatenate([y, y.sum(-1, keepdims=True)], -1)]
        beliefs = [
            f.update(f.predict(b), r)
            for f, b, r in zip(filters, beliefs, measurements, strict=True)
        ]
        assert (beliefs[1].recovery == Recovery.PSEUDO_INVERSE).all()
        np.testing.assert_allclose(beliefs[1].mean, beliefs[0].mean, rtol=0, atol=1e-10)
        np.testing.assert_allclose(beliefs[1].cov, beliefs[0].cov, rtol=0, atol=1e-10)


def test_perfect_sensors_that_contradict_each_other_are_met_half_way():
    filter = make("kf", LinearModel([[1.0]], [[1.0], [1.0]], [[1.0]], np.zeros((2, 2))))
    belief = filter.update(filter.init(Gaussian([0.0], [[1.0]])), [1.0, 2.0])
    assert belief.mean[0] == pytest.approx(1.5, abs=1e-12)
    assert belief.recovery == Recovery.PSEUDO_INVERSE


def test_where_channels_cannot_be_mixed_the_one_that_repeats_another_is_left_out():
    model = _model(
        "kf", [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], np.zeros((3, 3)), Q=0.1
    )
    filter = make("kf", model)
    filter.mixes = False
    belief = filter.update(filter.init(Gaussian(np.zeros(3), I3)), [5.0, 5.0, 6.0])
    assert belief.recovery == Recovery.WITHOUT_CHANNEL
    np.testing.assert_array_equal(belief.available, [True, False, True])
    np.testing.assert_allclose(belief.mean[:2], [5.0, 6.0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "name",
    [
        "ekf",
        "iekf",
        "ukf",
        "enkf",
        "etkf",
        "pf",
        "huber-kf",
        "robust-kf",
    ],
)
def test_a_channel_whose_expectation_is_not_finite_is_left_out_alone(name: str):
    def measurement(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        return np.concatenate(
            [x[..., :2], np.sqrt(x[..., 2:])], -1
        )  # of a negative number at the prior

    model = NonlinearModel(lambda x, u: x, measurement, 0.1 * I3, I3)
    prior = Gaussian([[1.0, 2.0, -50.0], [1.0, 2.0, 50.0]], I3)
    filter = _make(name, model)
    beliefs = []
    for mask in (None, [[True, True, False], [True, True, True]]):
        rng = RandomKeys.seeded(range(2))
        beliefs.append(
            filter.update(filter.init(prior, rng=rng), [2.0, 3.0, 7.0], rng=rng, available=mask)
        )
    failed, masked = beliefs
    np.testing.assert_array_equal(failed.recovery, [Recovery.WITHOUT_CHANNEL, Recovery.USUAL])
    np.testing.assert_array_equal(failed.available, masked.available)
    if not filter.random or name != "enkf":  # the enkf drew measurements once in vain
        assert_same(failed, masked, 1e-12, ignore=["recovery"])
    assert np.abs(failed.mean[0, :2] - [1.5, 2.5]).max() < 0.5


@one_of_each()
def test_a_measurement_beyond_all_numbers_costs_that_measurement(case: Case):
    """The innovation overflows: the prediction stands, and no more is lost than the measurement."""
    system = case.system(0)
    filter, rng = case.make(system.model), np.random.default_rng(0)
    record = simulate(system, 0, 3, 3)
    belief = filter.predict(
        filter.update(filter.init(system.rows(3), rng=rng), record.y[0], rng=rng),
        record.u[0],
        rng=rng,
    )
    belief = belief.replace(mean=np.where(np.arange(3)[:, None] == 1, -1e300, belief.mean))
    if belief.ensemble is not None:
        belief = belief.replace(
            ensemble=np.where(np.arange(3)[:, None, None] == 1, -1e300, belief.ensemble)
        )
    y = np.where(np.arange(3)[:, None] == 1, np.finfo(float).max, record.y[1])
    updated = filter.update(belief, y, rng=rng)
    for name, array in arrays(updated).items():
        assert np.isfinite(array).all(), name
    assert updated.healthy[[0, 2]].all()


class _Broken(Filter):
    """A filter of one's own whose update gives nothing but NaN."""

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: object) -> Belief:
        return belief

    def _update(self, belief: Belief, measurement: object, rng: object) -> Belief:
        return belief.replace(mean=np.full_like(belief.mean, np.nan))


class _Negative(_Broken):
    def _update(self, belief: Belief, measurement: object, rng: object) -> Belief:
        return belief.replace(cov=-belief.cov)


class _Solving(Filter):
    """A Kalman filter in plain NumPy."""

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: object) -> Belief:
        return belief

    def _update(self, belief: Belief, measurement: Measurement, rng: object) -> Belief:
        cross = measurement.C @ belief.cov
        S = cross @ measurement.C.mT + measurement.R
        K = np.linalg.solve(S, cross).mT
        return Belief.updated(
            belief,
            belief.mean + np.matvec(K, measurement.innovation),
            belief.cov - K @ S @ K.mT,
            measurement,
            S,
        )


def test_a_filter_of_ones_own_that_meets_a_singular_matrix_recovers_in_that_row_alone():
    """Two perfect sensors of one state; in the second row only one of them gives a measurement."""
    model = LinearModel(np.eye(2), [[1.0, 0.0], [1.0, 0.0]], np.eye(2), np.zeros((2, 2)))
    filter = _Solving(model)
    belief = filter.init(Gaussian(np.zeros((3, 2)), np.eye(2)))
    updated = filter.update(filter.predict(belief), [[1.0, 1.0], [2.0, np.nan], [3.0, 3.0]])
    np.testing.assert_allclose(
        updated.mean, [[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]], rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(
        updated.cov, np.tile(np.diag([0.0, 1.0]), (3, 1, 1)), rtol=0, atol=1e-12
    )
    np.testing.assert_array_equal(
        updated.recovery, [Recovery.PSEUDO_INVERSE, Recovery.USUAL, Recovery.PSEUDO_INVERSE]
    )
    alone = filter.update(filter.init(Gaussian(np.zeros(2), np.eye(2))), [1.0, 1.0])
    np.testing.assert_array_equal(alone.mean, updated.mean[0])


@pytest.mark.parametrize("broken", [_Broken, _Negative])
def test_a_filter_of_ones_own_that_always_fails_keeps_its_prediction_and_says_so(
    broken: type[Filter],
):
    filter = broken(LinearModel(I3, I3, I3, I3))
    belief = filter.init(Gaussian(np.tile(KNOWN, (2, 1)), I3))
    for _ in range(3):
        belief = filter.update(filter.predict(belief), np.zeros(3))
        np.testing.assert_array_equal(belief.mean, np.tile(KNOWN, (2, 1)))
        np.testing.assert_array_equal(belief.cov, np.tile(I3, (2, 1, 1)))
        np.testing.assert_array_equal(belief.recovery, Recovery.PREDICTION)


@some_cases("kf", "kf-umv-ui")
def test_what_a_driver_says_of_a_missing_measurement_does_not_matter(case: Case):
    """Receivers send NaN or infinity as the variance of what they did not see."""
    system = case.system(0)
    filter, p = case.make(system.model), system.model.p
    record = simulate(system, 0, 3, 2)
    predicted = filter.predict(filter.update(filter.init(system.rows(3)), record.y[0]), record.u[0])
    mask = np.arange(p) != 0
    missing = filter.update(predicted, record.y[1], available=mask)
    for variance in (np.nan, np.inf, -0.5):
        R = np.array(system.model.R)
        R[0], R[:, 0] = variance, variance
        assert_same(filter.update(predicted, record.y[1], available=mask, R=R), missing, 1e-13)
        if not np.isfinite(variance):  # then the measurement is missing, whatever it says
            assert_same(filter.update(predicted, record.y[1], R=R), missing, 1e-13)
    for wrong, sentence in (
        (-0.5 * np.eye(p), "R must be positive semidefinite, its smallest eigenvalue is -0.5"),
        (np.eye(p) + np.triu(np.full((p, p), 0.2), 1), "R must be symmetric"),
    ):
        with pytest.raises(ValueError, match=sentence):
            filter.update(predicted, record.y[1], R=wrong)


def test_an_input_that_shows_where_the_rest_is_perfect_is_seen_there():
    """The innovation covariance is singular, and the unknown input lies outside its range."""
    C = np.concatenate([I3, [[1.0, 1.0, 1.0]]])
    model = LinearModel(
        I3, C, 0.0 * I3, np.zeros((4, 4)), G=[[0.0], [0.0], [1.0]], H=[[0.0], [0.0], [1.0], [0.0]]
    )
    for name in ("kf-umv-ui", "ulise"):
        filter, x = make(name, model), np.array(KNOWN)
        belief = filter.init(Gaussian(np.zeros(3), 4.0 * I3))
        for k in range(6):
            if k:
                belief, x = filter.predict(belief), x + [0.0, 0.0, 0.3]
            belief = filter.update(belief, C @ x + [0.0, 0.0, 0.3, 0.0])
            np.testing.assert_allclose(belief.mean, x, rtol=0, atol=1e-9)
        np.testing.assert_allclose(belief.input_mean, [0.3], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["kf", "huber-kf", "robust-kf", "kf-umv-ui"])
def test_a_precise_measurement_of_what_was_unknown_leaves_a_covariance(name: str):
    """A variance of 1e26 read to 1 leaves nothing but rounding; it must not have a negative eigenvalue."""
    rng = np.random.default_rng(4)
    for _ in range(4):
        root = rng.normal(size=(3, 3))
        unknown = (
            {"G": rng.normal(size=(3, 1)), "H": rng.normal(size=(2, 1))}
            if name == "kf-umv-ui"
            else {}
        )
        model = LinearModel(
            I3, rng.normal(size=(2, 3)), 1e12 * root @ root.T, I3[:2, :2], **unknown
        )
        filter = make(name, model)
        belief = filter.init(Gaussian(np.zeros(3), 1e26 * root @ root.T))
        for _ in range(2):
            belief = filter.predict(filter.update(belief, rng.normal(size=2)))
            belief = filter.update(belief, rng.normal(size=2))
            values = np.linalg.eigvalsh(belief.cov / np.abs(belief.cov).max())
            assert values[0] >= -1e-10 * values.sum()
            assert belief.recovery < Recovery.PRIOR


def test_a_row_that_recovers_draws_as_it_would_alone():
    """What one row needs to recover costs its neighbours no random numbers, sick or not."""
    model = LinearModel(I3, [*I3[:2], I3[0]], 0.1 * I3, np.zeros((3, 3)))
    filter = make("enkf", model, members=4, draws="independent")
    y = np.array([[1.0, 2.0, 1.0], [1e308, 2.0, np.nan], [1.0, np.nan, np.nan]])
    means = np.array([[0.0, 0.0, 0.0], [-1e308, 0.0, 0.0], [0.0, 0.0, 0.0]])

    def updated(rows: slice) -> Belief:
        rng = RandomKeys.seeded(range(3)[rows])
        return filter.update(filter.init(Gaussian(means[rows], I3), rng=rng), y[rows], rng=rng)

    together = updated(slice(None))
    assert len(set(together.recovery.tolist())) > 1
    for row in range(3):
        assert_same(together[row : row + 1], updated(slice(row, row + 1)), 1e-12)


# --- what needs no recovery -----------------------------------------------------------------------


class _Unsymmetrised(Filter):
    """The formulas of a textbook, whose covariance is symmetric but for rounding."""

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: object) -> Belief:
        A = self.model.A
        return Belief.predicted(
            belief, np.matvec(A, belief.mean), A @ belief.cov @ A.mT + self.model.Q, u
        )

    def _update(self, belief: Belief, measurement: Measurement, rng: object) -> Belief:
        C, P = measurement.C, belief.cov
        S = C @ P @ C.mT + measurement.R
        K = P @ C.mT @ np.linalg.inv(S)
        return Belief.updated(
            belief,
            belief.mean + np.matvec(K, measurement.innovation),
            P - K @ C @ P,
            measurement,
            S,
        )


@pytest.fixture
def recoveries(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Rows of every recovery."""
    rows: list[int] = []
    usual = Filter._recovered

    def counted(self: Filter, belief: Belief, *others: Any) -> Belief:
        rows.append(belief.mean[..., 0].size)
        return usual(self, belief, *others)

    monkeypatch.setattr(Filter, "_recovered", counted)
    return rows


def test_a_covariance_that_is_symmetric_but_for_rounding_needs_no_recovery(recoveries: list[int]):
    system = kalman_system(3)
    record, beliefs = simulate(system, 0, 5, 200), []
    model = replace(system.model, B=None)
    for filter in (_Unsymmetrised(model), make("kf", model)):
        belief = filter.init(system.rows(5))
        for y in record.y:
            belief = filter.update(filter.predict(belief), y)
            np.testing.assert_array_equal(belief.cov, belief.cov.mT)
            assert belief.healthy.all()
        beliefs.append(belief)
    assert_same(*beliefs, 1e-9)
    assert recoveries == []


@pytest.mark.parametrize(
    "name", ["kf", "ekf", "ukf", "huber-kf", "robust-kf", "kf-umv-ui", "ulise"]
)
@pytest.mark.parametrize("precision", [1e5, 1e9, 1e13])
def test_a_precise_measurement_that_leaves_a_covariance_needs_no_recovery(
    name: str, precision: float, recoveries: list[int]
):
    unknown = {"G": I3[:, :1], "H": [[1.0], [0.0], [0.0]]} if name in UNKNOWN_INPUT else {}
    C = np.array([[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, 0.3, 1.0]])
    filter = make(name, LinearModel(I3, C, 1e-3 * I3, I3 / precision, **unknown))
    belief = filter.init(Gaussian(np.zeros((4, 3)), I3))
    for _ in range(3):
        belief = filter.update(filter.predict(belief), np.zeros(3))
        assert belief.healthy.all()
        assert (np.linalg.eigvalsh(belief.cov)[..., 0] >= -1e-12 * np.trace(belief.cov[0])).all()
    assert recoveries == []


def test_of_many_rows_those_recover_that_have_to(recoveries: list[int]):
    """A measurement that leaves a covariance in one row, one beyond all numbers in another."""
    filter = make("kf", LinearModel(I3, I3, I3, 1e-6 * I3))
    belief = filter.init(Gaussian([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [-1e308, 0.0, 0.0]], I3))
    updated = filter.update(belief, [[1.0, 1.0, 1.0], [2.0, np.nan, 0.0], [1e308, 0.0, 0.0]])
    np.testing.assert_array_equal(updated.healthy, [True, True, False])
    assert recoveries == [1]
