"""The laws of ensemble filters, against dense formulas, and what their options promise."""

import tracemalloc
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, NonlinearModel, RandomKeys, make, wrap
from tests.estimators.cases import (
    assert_close,
    assert_same,
    kalman_system,
)

NAMES = ["enkf", "etkf"]
both = pytest.mark.parametrize("name", NAMES)
INDEPENDENT = {"draws": "independent"}


def _numbers(rows: int) -> RandomKeys:
    return RandomKeys.seeded(range(rows)).of(7)


# --- square-root filters --------------------------------------------------------------------------


def test_etkf_and_enkf_sr_are_one_class():
    one, other = (make(name, kalman_system(0).model) for name in ("etkf", "enkf-sr"))
    assert type(one) is type(other)


def test_perfect_and_very_precise_measurements_keep_their_digits():
    """R = 0 needs no inverse, and R = 1e-14 P leaves R, to the eight digits that are left.

    A root of ``1 - s^2`` would be off by a percent.
    """
    for variance in (0.0, 1e-14):
        model = LinearModel(A=np.eye(2), C=[[1.0, 0.0]], Q=np.eye(2), R=[[variance]])
        filter, rng = make("etkf", model, members=10), np.random.default_rng(0)
        before = filter.init(Gaussian(np.zeros(2), np.eye(2)), rng=rng)
        after = filter.update(before, [1.0], rng=rng)
        P = before.cov[0, 0]
        assert after.healthy
        assert after.cov[0, 0] == pytest.approx(P * variance / (P + variance), rel=1e-7, abs=1e-30)


def _inverse(A: np.ndarray) -> np.ndarray:
    """Of rational numbers, by Gauss and Jordan."""
    rows = np.hstack([A, np.eye(len(A), dtype=int)])
    for i in range(len(A)):
        rows[i] /= rows[i, i]
        for k in set(range(len(A))) - {i}:
            rows[k] -= rows[k, i] * rows[i]
    return rows[:, len(A) :]


@pytest.mark.parametrize(
    ("p", "R", "median", "worst"),
    [
        (2, 1e-6, 3e-16, 7e-16), (2, 1e-18, 3e-16, 7e-16),
        (4, 1e-6, 2e-12, 1e-11), (4, 1e-12, 9e-9, 1e-5),
        (6, 1e-6, 2e-12, 1e-11), (6, 1e-12, 9e-9, 1e-5),
    ],
)  # fmt: skip
def test_precise_measurements_cost_the_digits_that_are_printed(
    p: int, R: float, median: float, worst: float
):
    """Of three states and five members, by rational arithmetic: within ten times what docs say.

    Two measurements cost no digits, however precise. Four or six are more than the three directions
    of the members, so that S is nearly singular: one form, p x p, serves for any number of them.
    """
    exact, errors = np.vectorize(lambda value: Fraction(float(value)), otypes=[object]), []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        C, noise = rng.normal(size=(p, 3)), R * np.eye(p)
        model = LinearModel(np.eye(3), C, np.eye(3), noise)
        filter = make("etkf", model, members=5, **INDEPENDENT)
        before = filter.init(Gaussian(np.zeros(3), np.eye(3)), rng=rng)
        y = C @ rng.normal(size=3) + np.sqrt(R) * rng.normal(size=p)
        after = filter.update(before, y, rng=rng)
        X, C, y, noise = (exact(array) for array in (before.ensemble, C, y, noise))
        centre = X.sum(0) / 5
        P = (X - centre).T.dot(X - centre) / 4
        gain = P.dot(C.T).dot(_inverse(C.dot(P).dot(C.T) + noise))
        mean = (centre + gain.dot(y - C.dot(centre))).astype(float)
        cov = (P - gain.dot(C).dot(P)).astype(float)
        errors.append(np.abs(after.cov - cov).max() / np.abs(cov).max())
        assert np.abs(after.mean - mean).max() < 1e-7 * np.abs(mean).max()
    assert np.median(errors) < 10.0 * median
    assert max(errors) < 10.0 * worst


# --- linear and Gaussian --------------------------------------------------------------------------


@pytest.mark.parametrize("members", [None, 6 + 3 + 2])
@both
def test_with_exact_draws_the_filter_is_the_kalman_filter(name: str, members: int | None):
    """Over 500 steps with 30 % of measurements missing, to 1e-8; independent draws differ by 0.1.

    Six states, one known at first; noise of rank 3, correlated measurements.
    """
    rng, model = np.random.default_rng(0), kalman_system(0, n=6).model
    B = rng.normal(size=(6, 3))
    model = replace(model, B=None, Q=0.1 * B @ B.T)
    prior = Gaussian(np.zeros((4, 6)), np.diag([1.0, 1.0, 1.0, 0.0, 1.0, 1.0]))
    kf, filter, keys = make("kf", model), make(name, model, members=members), _numbers(4)
    exact, belief = kf.init(prior), filter.init(prior, rng=keys.at(0))
    for k in range(1, 501):
        y, available = rng.normal(size=(4, 3)), rng.random((4, 3)) < 0.7
        exact = kf.update(kf.predict(exact), y, available=available)
        ahead = filter.predict(belief, rng=keys.at(k))
        belief = filter.update(ahead, y, rng=keys.at(k), available=available)
        assert_close(belief.mean, exact.mean, 1e-8)
        assert_close(belief.cov, exact.cov, 1e-8)
    assert_close(np.cov(belief.ensemble[0].T), exact.cov[0], 1e-8)


@both
def test_members_suffice_for_exact_draws_and_fewer_are_warned_of(name: str):
    """By default 64, or the next multiple of 8 from n + max(rank Q, p) + 2 on."""
    for n, p, members in ((4, 3, 64), (31, 1, 64), (32, 3, 72), (4, 60, 72)):
        model = LinearModel(np.eye(n), np.ones((p, n)), np.eye(n), np.eye(p))
        assert make(name, model).members == members
    system = kalman_system(0)
    with pytest.warns(UserWarning, match="^an ensemble of 9 members has independent draws: exact"):
        few = make(name, system.model, members=9)
    plain = make(name, system.model, members=9, **INDEPENDENT)
    assert_same(*(each.init(system.rows(1), rng=_numbers(1)) for each in (few, plain)))


# --- members outside the model's domain -----------------------------------------------------------


@pytest.mark.parametrize("root", [False, True])
@both
def test_a_member_outside_the_models_domain_is_drawn_again(name: str, root: bool):
    """A tank that drains by the root of its level, near empty: the error is that of `ekf`.

    Measured is the level or its root, so that members have no transition, or no measurement either.
    """

    def measured(x: np.ndarray, u: None) -> np.ndarray:
        return np.sqrt(x) if root else x

    def drained(x: np.ndarray, u: None) -> np.ndarray:
        return x - 0.05 * np.sqrt(x) + 0.01

    model = NonlinearModel(drained, measured, [[0.01**2]], [[0.05**2]])
    noise, x, keys = np.random.default_rng(0).normal(size=(100, 2, 20, 1)), 0.04, _numbers(20)
    filters = make("ekf", model), make(name, model)
    beliefs = [filter.init(Gaussian([[0.04]] * 20, [[1e-4]]), rng=keys.at(0)) for filter in filters]
    squares = np.zeros(2)
    for k, (w, v) in enumerate(noise, 1):
        x = np.maximum(drained(x, None) + 0.01 * w, 1e-4)
        y = measured(x, None) + 0.05 * v
        beliefs = [f.step(b, y, rng=keys.at(k)) for f, b in zip(filters, beliefs, strict=True)]
        assert beliefs[1].available.all()
        squares += [np.square(b.mean - x).mean() for b in beliefs]
    assert squares[1] < 1.02 * squares[0]


def test_a_member_drawn_again_leaves_other_rows_alone():
    """To the last bit; with n or fewer members left, the row keeps what it had."""
    small = 1e-4 * np.eye(2)
    model = NonlinearModel(lambda x, u: 0.9 * np.sqrt(x), lambda x, u: x, small, np.eye(2))
    filter, keys = make("enkf", model), _numbers(4)
    belief = filter.init(Gaussian(np.full((4, 2), 9.0), np.eye(2)), rng=keys.at(0))
    ensemble = np.array(belief.ensemble)
    ensemble[1, :5], ensemble[3, 2:] = -1.0, -1.0
    before = belief.replace(ensemble=ensemble)
    changed, plain = (filter.predict(each, rng=keys.at(1)) for each in (before, belief))
    assert_same(changed[1:2], filter.predict(before[1:2], rng=keys[1:2].at(1)))
    assert_same(changed[::2], plain[::2])
    np.testing.assert_allclose(changed.ensemble[1, 5:], plain.ensemble[1, 5:], rtol=0, atol=0.05)
    drawn = np.abs(changed.ensemble[1, :5] - changed.mean[1])
    assert drawn.max() < 4.0 * np.sqrt(changed.cov[1].max())
    np.testing.assert_array_equal(changed.ensemble[3], before.ensemble[3])


# --- angles ---------------------------------------------------------------------------------------


@both
@pytest.mark.parametrize("folded", [False, True])
def test_an_unknown_angle_is_known_as_well_as_it_was_measured(name: str, folded: bool):
    """A prior wider than a turn; and noise that has spread the members over more than that."""

    def angle(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        return wrap(x) if folded else x

    sd, centres, numbers = 0.05, np.linspace(-20.0, 20.0, 30)[:, None], _numbers(30)
    truth = centres + 3.0 * np.sin(np.arange(30.0))[:, None]
    angles = {"state_angles": (0,), "measurement_angles": (0,)}
    for prior, Q in ((3.0, 0.0), (0.1, 9.0)):
        model = NonlinearModel(angle, angle, [[Q]], [[sd**2]], **angles)
        filter = make(name, model, members=100)
        belief = filter.init(Gaussian(centres, [[prior**2]]), numbers)
        for k in range(1, 4):
            belief = filter.step(belief, angle(truth, None), rng=numbers.at(k))
        # Of 100 members the mean of perturbed measurements is a tenth of the noise off, and the
        # deviation 7 % in 1 sd.
        assert np.abs(wrap(belief.mean - truth)).max() < 0.6 * sd
        assert np.sqrt(belief.cov).max() < 1.4 * sd


@both
def test_nothing_is_as_large_as_the_square_of_the_members(name: str):
    system, N = kalman_system(0), 20_000
    filter, rng = make(name, system.model, members=N), np.random.default_rng(0)
    belief = filter.init(system.prior, rng=rng)
    tracemalloc.start()
    try:
        filter.update(filter.predict(belief, np.zeros(2), rng=rng), np.zeros(3), rng=rng)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # A dozen arrays of N x n, against 3.2 GB for one of N x N.
    assert 8 * N < peak < 12 * 8 * N * system.model.n
