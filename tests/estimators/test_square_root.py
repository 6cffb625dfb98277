"""What `srkf` promises beyond the common laws: a root of its covariance, and digits that the covariance has lost."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import Belief, Gaussian, LinearModel, NonlinearModel, Recovery, RootBelief, make
from estimators.square_root import triangular
from tests.estimators.cases import (
    assert_same,
    kalman_system,
    random_covariance,
    rounding,
    simulate,
    some_measurements,
    track,
    turning_vehicle,
)


def _exact(prior: np.ndarray, C: np.ndarray, variances: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance in rational numbers: the inverse of the information, which Gauss and Jordan find."""
    n = len(prior)
    information = [[Fraction(int(i == j)) / Fraction(prior[i]) for j in range(n)] for i in range(n)]
    for row, variance in zip(C, variances, strict=True):
        for i in range(n):
            for j in range(n):
                information[i][j] += Fraction(row[i]) * Fraction(row[j]) / Fraction(variance)
    whole = [row + [Fraction(int(i == j)) for j in range(n)] for i, row in enumerate(information)]
    for i in range(n):
        whole[i] = [value / whole[i][i] for value in whole[i]]
        for k in set(range(n)) - {i}:
            whole[k] = [a - whole[k][i] * b for a, b in zip(whole[k], whole[i], strict=True)]
    cov = [row[n:] for row in whole]
    told = [sum(Fraction(row[i]) * Fraction(v) / Fraction(r) for row, v, r in zip(C, y, variances, strict=True))
            for i in range(n)]  # fmt: skip
    mean = [sum(c * t for c, t in zip(row, told, strict=True)) for row in cov]
    return np.array([float(v) for v in mean]), np.array([[float(v) for v in row] for row in cov])


def _nearly_alike(name: str, delta: float) -> tuple[Belief, np.ndarray, np.ndarray]:
    """Two very precise measurements that are nearly the same, then a third, and what they should give.

    Source: Grewal & Andrews, Kalman Filtering: Theory and Practice, the ill-conditioned update of sec. 6.2.
    """
    C = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0 + delta], [1.0, -1.0, 0.0]])
    variances, y = np.array([delta**2, delta**2, 1.0]), np.array([1.0, 1.0 + 3.0 * delta, 0.5])
    filter = make(name, LinearModel(np.eye(3), C, np.zeros((3, 3)), np.diag(variances)))
    belief = filter.update(filter.init(Gaussian(np.zeros(3), np.eye(3))), y, available=[True, True, False])
    belief = filter.update(filter.predict(belief), y, available=[False, False, True])
    return belief, *_exact(np.ones(3), C, variances, y)


@pytest.mark.parametrize("delta", [1e-8, 1e-9, 1e-10])
def test_where_the_covariance_has_lost_its_digits_its_root_has_them(delta: float):
    belief, mean, cov = _nearly_alike("srkf", delta)
    assert np.linalg.cond(belief.root) ** 2 > 1e16
    assert belief.healthy
    # Errors of the condition of the root, 1 / delta, where those of the covariance would be of its square.
    close = {"rtol": 0, "atol": 100.0 * np.finfo(float).eps / delta}
    np.testing.assert_allclose(belief.cov, cov, **close)
    np.testing.assert_allclose(belief.mean, mean, **close)
    assert np.linalg.svd(belief.root)[1][-1] > 0.0
    smallest = np.sqrt(1.0 / np.linalg.eigvalsh(_information(delta))[-1])
    assert np.linalg.svd(belief.root)[1][-1] == pytest.approx(smallest, rel=1e-2)
    plain, _, _ = _nearly_alike("kf", delta)
    assert np.abs(plain.cov - cov).max() > 0.05
    assert np.abs(plain.mean - mean).max() > 0.05


def _information(delta: float) -> np.ndarray:
    C = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0 + delta]])
    return np.eye(3) + C.T @ C / delta**2 + np.outer([1.0, -1.0, 0.0], [1.0, -1.0, 0.0])


@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_kf_to_rounding_with_measurements_missing(seed: int):
    system = kalman_system(seed)
    record = simulate(system, seed, 6, 40)
    available = some_measurements(np.random.default_rng(seed), system.model.p, 40, 6)
    roots, plain = (track(make(name, system.model), system.rows(6), record, available=available) for name in NAMES)
    for one, other, tolerance in zip(
        roots, plain, rounding(make("kf", system.model), system.rows(6), record, available), strict=True
    ):
        assert_same(_without_root(one), other, tolerance)


NAMES = "srkf", "kf"


def _without_root(belief: RootBelief) -> Belief:
    return Belief(**{name: getattr(belief, name) for name in Belief.__dataclass_fields__})


def test_on_a_nonlinear_model_it_is_the_ekf():
    system = turning_vehicle(2)
    record = simulate(system, 2, 4, 20)
    roots, plain = (track(make(name, system.model), system.rows(4), record) for name in ("srkf", "ekf"))
    tolerances = rounding(make("ekf", system.model), system.rows(4), record)
    for one, other, tolerance in zip(roots, plain, tolerances, strict=True):
        assert_same(_without_root(one), other, tolerance)


def test_the_belief_carries_a_triangular_root_of_its_covariance_always():
    system = kalman_system(4)
    record = simulate(system, 4, 5, 10)
    filter = make("srkf", system.model)
    belief = filter.init(system.rows(5))
    for k in range(10):
        updated = filter.update(belief, record.y[k])
        belief = filter.predict(updated, record.u[k])
        for L, cov in ((updated.root, updated.cov), (belief.root, belief.cov)):
            np.testing.assert_array_equal(L, np.tril(L))
            assert (L.diagonal(0, -2, -1) >= 0.0).all()
            np.testing.assert_allclose(L @ L.mT, cov, rtol=0, atol=1e-14 * cov.max())


def test_who_replaces_a_covariance_gets_a_root_of_it_and_other_rows_keep_theirs():
    filter = make("srkf", kalman_system(0).model)
    belief = filter.init(kalman_system(0).rows(3))
    cov = np.array(belief.cov)
    cov[1] = random_covariance(np.random.default_rng(0), 4)
    changed = belief.replace(cov=cov)
    np.testing.assert_array_equal(changed.root[[0, 2]], belief.root[[0, 2]])
    np.testing.assert_allclose(changed.root @ changed.root.mT, cov, rtol=0, atol=1e-14)


def test_states_and_measurements_without_noise_are_taken_as_they_are():
    """P-, Q and R of less than full rank: the roots have zeros, and no more is made of them."""
    model = LinearModel([[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0]], np.diag([0.0, 0.1]), [[0.0]])
    roots, plain = (make(name, model) for name in NAMES)
    prior = Gaussian([0.0, 1.0], np.diag([1.0, 0.0]))
    one, other = roots.init(prior), plain.init(prior)
    for y in (0.3, 1.4, 2.2):
        one, other = (f.predict(f.update(b, [y])) for f, b in ((roots, one), (plain, other)))
        assert max(one.recovery, other.recovery) < Recovery.WITHOUT_CHANNEL
        np.testing.assert_allclose(one.mean, other.mean, rtol=0, atol=1e-12)
        np.testing.assert_allclose(one.cov, other.cov, rtol=0, atol=1e-12)


def test_a_function_that_fails_costs_no_more_than_its_row():
    model = NonlinearModel(lambda x, u: np.sqrt(x), lambda x, u: x, 0.1 * np.eye(2), np.eye(2))
    filter = make("srkf", model)
    belief = filter.init(Gaussian([[1.0, 4.0], [-1.0, 4.0]], 0.01 * np.eye(2)))
    belief = filter.update(filter.predict(belief), [[1.0, 2.0], [1.0, 2.0]])
    np.testing.assert_array_equal(belief.recovery, [Recovery.USUAL, Recovery.PRIOR])
    assert np.isfinite(belief.root).all()
    np.testing.assert_allclose(belief.root @ belief.root.mT, belief.cov, rtol=0, atol=1e-14)


@settings(derandomize=True, max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), m=st.integers(1, 5), k=st.integers(1, 8), spread=st.floats(0.0, 60.0))
def test_a_triangle_has_the_square_of_what_it_was_made_of(seed: int, m: int, k: int, spread: float):
    rng = np.random.default_rng(seed)
    array = rng.normal(size=(3, m, k + m)) * 10.0 ** rng.uniform(-spread, spread, (3, 1, 1))
    array[1] = np.nan
    L = triangular(array)
    assert np.isnan(L[1]).all()
    for i in (0, 2):
        np.testing.assert_array_equal(L[i], np.tril(L[i]))
        size = np.abs(array[i]).max() ** 2
        np.testing.assert_allclose(L[i] @ L[i].T / size, array[i] @ array[i].T / size, rtol=0, atol=1e-13)
