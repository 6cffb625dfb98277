"""The laws of ensemble filters, against dense formulas, and what their options promise."""

import tracemalloc
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import sqrtm

from estimators import Gaussian, LinearModel, NonlinearModel, RandomKeys, make, wrap
from estimators.analysis import exact_noise
from tests.estimators.cases import (
    Case,
    assert_close,
    assert_same,
    every_case,
    kalman_system,
    random_covariance,
    simulate,
    track,
    without_channel,
)

NAMES = ["enkf", "etkf"]
both = pytest.mark.parametrize("name", NAMES)
INDEPENDENT = {"draws": "independent"}


def _numbers(rows: int) -> RandomKeys:
    return RandomKeys.seeded(range(rows)).of(7)


def _anomalies(ensemble: np.ndarray) -> np.ndarray:
    return ensemble - ensemble.mean(-2, keepdims=True)


# --- square-root filters --------------------------------------------------------------------------


@pytest.mark.parametrize(("members", "n", "p"), [(3, 5, 6), (8, 3, 1), (60, 4, 2)])
def test_the_transform_is_the_symmetric_root_of_the_textbook(members: int, n: int, p: int):
    """``(I + Y R^-1 Y' / (N - 1))^-1/2`` as an N x N matrix, by scipy."""
    system, rng = kalman_system(0, n=n, p=p), np.random.default_rng(0)
    model = system.model
    filter = make("etkf", model, members=members, **INDEPENDENT)
    before = filter.predict(filter.init(system.rows(3), rng=rng), np.ones((3, 2)), rng=rng)
    after = filter.update(before, np.ones((3, p)), rng=rng)
    for row in range(3):
        A = _anomalies(before.ensemble[row])
        Y = A @ model.C.T
        whole = np.eye(members) + Y @ np.linalg.inv(model.R) @ Y.T / (members - 1)
        T = np.linalg.inv(sqrtm(whole).real)
        np.testing.assert_allclose(_anomalies(after.ensemble[row]), T @ A, rtol=0, atol=1e-11)


def test_etkf_and_enkf_sr_are_one_class():
    one, other = (make(name, kalman_system(0).model) for name in ("etkf", "enkf-sr"))
    assert type(one) is type(other)
    assert (one.name, other.name) == ("etkf", "enkf-sr")


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
        (6, 1e-6, 1e-12, 5e-12), (6, 1e-12, 1e-9, 5e-9), (6, 1e-18, 1e-6, 5e-6),
    ],
)  # fmt: skip
def test_precise_measurements_cost_the_digits_that_are_printed(
    p: int, R: float, median: float, worst: float
):
    """Of three states and five members, by rational arithmetic: within ten times what docs say."""
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


@pytest.mark.parametrize("j", range(3))
@every_case("square-root", "linear")
def test_masking_a_channel_of_a_square_root_filter_equals_a_model_without_it(case: Case, j: int):
    system = case.system(0)
    record, prior = simulate(system, 0, runs=3, steps=15), system.rows(3)
    kept = np.arange(3) != j
    reduced = case.make(without_channel(system.model, j))
    masked = track(
        case.make(system.model), prior, record, _numbers(3), np.broadcast_to(kept, (15, 3))
    )
    fewer = track(reduced, prior, record._replace(y=record.y[..., kept]), _numbers(3))
    for one, other in zip(masked, fewer, strict=True):
        np.testing.assert_allclose(one.ensemble, other.ensemble, rtol=0, atol=1e-11)


# --- linear and Gaussian --------------------------------------------------------------------------


@pytest.mark.parametrize("members", [None, 6 + 3 + 2])
@both
def test_with_exact_draws_the_filter_is_the_kalman_filter(name: str, members: int | None):
    """Over 500 steps with 30 % of measurements missing, to 1e-8; independent draws differ by 0.1.

    Six states, one known at first, one nearly constant; noise of rank 3, correlated measurements.
    """
    rng = np.random.default_rng(0)
    A, B = 0.95 * np.linalg.qr(rng.normal(size=(6, 6)))[0], rng.normal(size=(6, 3))
    A[5] = 0.999 * np.eye(6)[5]
    model = LinearModel(A, rng.normal(size=(3, 6)), 0.1 * B @ B.T, random_covariance(rng, 3))
    prior = Gaussian(np.zeros((4, 6)), np.diag([1.0, 1.0, 1.0, 0.0, 1.0, 1.0]))
    kf, filter, keys = make("kf", model), make(name, model, members=members), _numbers(4)
    exact, belief = kf.init(prior), filter.init(prior, rng=keys.at(0))
    for k in range(1, 501):
        y, available = rng.normal(size=(4, 3)), rng.random((4, 3)) < 0.7
        exact = kf.update(kf.predict(exact), y, available=available)
        ahead = filter.predict(belief, rng=keys.at(k))
        belief = filter.update(ahead, y, rng=keys.at(k), available=available)
        np.testing.assert_allclose(belief.mean, exact.mean, rtol=0, atol=1e-8)
        np.testing.assert_allclose(belief.cov, exact.cov, rtol=0, atol=1e-8)
    spread = _anomalies(belief.ensemble)
    moment = spread.mT @ spread / (filter.members - 1)
    np.testing.assert_allclose(moment, exact.cov, rtol=0, atol=1e-8)


@pytest.mark.parametrize(("n", "r", "members"), [(6, 3, 11), (16, 10, 64), (26, 12, 64)])
def test_exact_draws_have_exact_moments(n: int, r: int, members: int):
    """Mean 0, covariance I, no correlation with anomalies of any size, also repeated: to 1e-12."""
    rng = np.random.default_rng(2)
    A = rng.normal(size=(20, n, members)) * 10.0 ** rng.uniform(-3.0, 3.0, (n, 1))
    A[:, 1] = -2.0 * A[:, 0]
    A -= A.mean(-1, keepdims=True)
    z = exact_noise(np.eye(r), rng.normal(size=(20, r, members)), A, A @ A.mT)
    unit = A / np.sqrt(np.square(A).mean(-1, keepdims=True))
    np.testing.assert_allclose(z.mean(-1), 0.0, atol=1e-12)
    np.testing.assert_allclose(z @ z.mT / (members - 1) - np.eye(r), 0.0, atol=1e-12)
    np.testing.assert_allclose(z @ unit.mT / members, 0.0, atol=1e-12)


@both
def test_the_default_has_enough_members_for_exact_draws_and_fewer_are_warned_of(name: str):
    """64, or the next multiple of 8 from n + max(rank Q, p) + 2 on."""
    for n, p, members in ((4, 3, 64), (31, 1, 64), (32, 3, 72), (4, 60, 72)):
        model = LinearModel(np.eye(n), np.ones((p, n)), np.eye(n), np.eye(p))
        assert make(name, model).members == members
    system = kalman_system(0)
    with pytest.warns(
        UserWarning, match="^an ensemble of 9 members has independent draws: exact ones need 10"
    ) as seen:
        few = make(name, system.model, members=9)
    assert len(seen) == 1
    plain = make(name, system.model, members=9, **INDEPENDENT)
    one, other = (filter.init(system.rows(1), rng=_numbers(1)) for filter in (few, plain))
    assert_same(one, other)


@pytest.mark.slow
@both
def test_the_filter_tends_to_the_kalman_filter_as_one_over_the_root_of_members(name: str):
    system, runs = kalman_system(0), 200
    record = simulate(system, 0, runs, 6)
    exact = track(make("kf", system.model), system.rows(runs), record)[-1]
    sizes, errors = (25, 100, 400), []
    for members in sizes:
        filter = make(name, system.model, members=members, **INDEPENDENT)
        belief = track(filter, system.rows(runs), record, np.random.default_rng(0))[-1]
        errors.append([(belief.mean - exact.mean).std(), (belief.cov - exact.cov).std()])
    slopes = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    # Over 200 runs each error is known to about 3 %, a slope to about 0.01; small ensembles bend it
    # a little more.
    assert (np.abs(slopes + 0.5) < 0.06).all(), slopes


@pytest.mark.slow
@both
def test_errors_are_as_large_as_a_large_ensemble_says_but_for_its_sample_size(name: str):
    """A sample covariance's inverse is too large by (N - 1) / (N - n - 2): Anderson (2003), 7.7."""
    system, runs, members = kalman_system(1), 400, 100
    n = system.model.n
    record = simulate(system, 20, runs, 5)
    filter = make(name, system.model, members=members, **INDEPENDENT)
    final = track(filter, system.rows(runs), record, np.random.default_rng(0))[-1]
    error = record.x[-1] - final.mean
    squares = np.vecdot(error, np.matvec(np.linalg.inv(final.cov), error))
    mean = squares.mean() * (members - n - 2) / (members - 1)
    # Mean of 400 values of about chi-square law: standard deviation sqrt(2 n / 400); four of them,
    # and 3 % for the gain's own error, which the factor leaves out.
    assert abs(mean / n - 1.0) < 4.0 * np.sqrt(2.0 / (n * runs)) + 0.03


# --- members outside the model's domain -----------------------------------------------------------


@pytest.mark.parametrize("members", [64, 1000])
@pytest.mark.parametrize("root", [False, True])
@both
def test_a_member_outside_the_models_domain_is_drawn_again_and_the_others_stay(
    name: str, root: bool, members: int
):
    """A tank that drains by the root of its level, near empty: the error is that of `ekf`.

    Measured is the level or its root, so that members have no transition, or no measurement either.
    """

    def measured(x: np.ndarray, u: None) -> np.ndarray:
        return np.sqrt(x) if root else x

    model = NonlinearModel(
        lambda x, u: x - 0.05 * np.sqrt(x) + 0.01, measured, [[0.01**2]], [[0.05**2]]
    )
    rng, rows = np.random.default_rng(0), 20
    x, prior, keys = np.full((rows, 1), 0.04), Gaussian([[0.04]] * rows, [[1e-4]]), _numbers(rows)
    filters = make("ekf", model), make(name, model, members=members)
    beliefs = [filter.init(prior, rng=keys.at(0)) for filter in filters]
    squares = np.zeros(2)
    for k in range(1, 101):
        x = np.maximum(model.transition(x, None) + 0.01 * rng.normal(size=(rows, 1)), 1e-4)
        y = measured(x, None) + 0.05 * rng.normal(size=(rows, 1))
        beliefs = [f.step(b, y, rng=keys.at(k)) for f, b in zip(filters, beliefs, strict=True)]
        assert beliefs[1].available.all()
        squares += [np.square(b.mean - x).mean() for b in beliefs]
    assert squares[1] < 1.02 * squares[0]


def test_a_member_that_is_drawn_again_leaves_other_rows_and_members_alone():
    """To the last bit, alone and in a batch; with n or fewer left, the row keeps what it had."""
    model = NonlinearModel(
        lambda x, u: 0.9 * np.sqrt(x), lambda x, u: x, 1e-4 * np.eye(2), np.eye(2)
    )
    filter, keys = make("enkf", model), _numbers(4)
    belief = filter.init(Gaussian(np.full((4, 2), 9.0), np.eye(2)), rng=keys.at(0))
    ensemble = np.array(belief.ensemble)
    ensemble[1, :5], ensemble[3, 2:] = -1.0, -1.0
    before = belief.replace(ensemble=ensemble)
    changed, plain = (filter.predict(each, rng=keys.at(1)) for each in (before, belief))
    assert_same(changed[1:2], filter.predict(before[1:2], rng=keys[1:2].at(1)))
    for row in (0, 2):
        assert_same(changed[row], plain[row])
    spread = 4.0 * np.sqrt(changed.cov[1].max())
    np.testing.assert_allclose(changed.ensemble[1, 5:], plain.ensemble[1, 5:], rtol=0, atol=0.05)
    assert np.abs(changed.ensemble[1, :5] - changed.mean[1]).max() < spread
    np.testing.assert_array_equal(changed.ensemble[3], before.ensemble[3])


# --- random numbers -------------------------------------------------------------------------------


class _Counting(np.random.Generator):
    """A Generator that counts the normals it is asked for."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))
        self.drawn = 0

    def standard_normal(self, size=None, dtype=np.float64, out=None):
        normals = super().standard_normal(size, dtype, out)
        self.drawn += normals.size
        return normals


@pytest.mark.parametrize("rank", [0, 1, 2, 4])
@both
def test_process_noise_takes_as_many_numbers_a_member_as_its_rank(name: str, rank: int):
    """And a square-root update none."""
    root = np.random.default_rng(0).normal(size=(4, rank))
    Q = root @ root.T
    filter = make(name, LinearModel(np.eye(4), np.eye(4), Q, np.eye(4)), members=100)
    rng = _Counting()
    start = filter.init(Gaussian(np.ones(4), np.zeros((4, 4))), rng=rng)
    rng.drawn = 0
    after = filter.predict(start, rng=rng)
    assert rng.drawn == rank * 100
    np.testing.assert_allclose(after.mean, 1.0, rtol=0, atol=1e-12)  # the noise is centred
    np.testing.assert_allclose(after.cov, Q, rtol=0, atol=1e-12)
    filter.update(after, np.ones(4), rng=rng)
    assert rng.drawn == (rank + 4 * (name == "enkf")) * 100


@every_case("ensemble")
def test_missing_random_numbers_or_those_of_other_rows_are_named(case: Case):
    system = case.system(0)
    filter, prior, generator = case.make(system.model), system.rows(3), np.random.default_rng(0)
    belief = filter.init(prior, rng=generator)
    y, u = np.zeros((3, system.model.p)), np.zeros((3, system.m))
    for step in (
        lambda rng: filter.init(prior, rng=rng),
        lambda rng: filter.predict(belief, u, rng=rng),
        lambda rng: filter.update(belief, y, u=u, rng=rng),
    ):
        with pytest.raises(ValueError, match=rf"^{case.name} draws random numbers: pass rng"):
            step(None)
        with pytest.raises(ValueError, match=r"^rng has keys for rows \(2,\), expected \(3,\)"):
            step(_numbers(2))


@every_case("ensemble")
def test_one_generator_serves_a_whole_batch_and_every_row_is_different(case: Case):
    """And an update without measurements leaves the members alone."""
    system = case.system(0)
    filter, u = case.make(system.model), np.ones((3, system.m))

    def predicted() -> object:
        rng = np.random.default_rng(5)
        return filter.predict(filter.init(system.rows(3), rng=rng), u, rng=rng)

    one = predicted()
    assert_same(one, predicted())
    assert np.abs(one.ensemble[0] - one.ensemble[1]).max() > 1e-3
    after = filter.update(one, np.full(system.model.p, np.nan), rng=np.random.default_rng(0))
    assert_close(after.ensemble, one.ensemble, 1e-13 * np.abs(one.cov).max())


# --- angles ---------------------------------------------------------------------------------------


@both
@pytest.mark.parametrize("folded", [False, True])
def test_an_angle_of_which_nothing_was_known_is_known_as_well_as_it_was_read(
    name: str, folded: bool
):
    """A prior wider than a turn; and noise that has spread the members over more than that."""

    def angle(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        return np.arctan2(np.sin(x), np.cos(x)) if folded else x

    sd, centres = 0.05, np.linspace(-20.0, 20.0, 30)[:, None]
    for prior, Q in ((3.0, 0.0), (0.1, 9.0)):
        model = NonlinearModel(
            angle, angle, [[Q]], [[sd**2]], state_angles=(0,), measurement_angles=(0,)
        )
        filter, numbers = make(name, model, members=100), _numbers(30)
        belief = filter.init(Gaussian(centres, [[prior**2]]), numbers)
        truth = centres + 3.0 * np.sin(np.arange(30.0))[:, None]
        for k in (1, 3, 5):
            ahead = filter.predict(belief, rng=numbers.at(k))
            belief = filter.update(ahead, angle(truth, None), rng=numbers.at(k + 1))
        # Of 100 members the mean of perturbed measurements is a tenth of the noise off, and the
        # deviation 7 % in 1 sd.
        assert np.abs(wrap(belief.mean - truth)).max() < 0.6 * sd
        assert np.sqrt(belief.cov).max() < 1.4 * sd


# --- models and options ---------------------------------------------------------------------------


@both
def test_noise_that_is_a_function_of_the_known_input_is_the_noise_at_that_input(name: str):
    """Moments are those of the model with this noise; an unknown input is ignored."""
    system = kalman_system(0)
    Q, R, beliefs = system.model.Q, system.model.R, []
    for changes in (
        {"Q": lambda u: Q * u[..., :1, None] ** 2, "R": lambda u: R * u[..., 1:, None] ** 2},
        {"Q": 4.0 * Q, "R": 9.0 * R, "G": np.ones((4, 1)), "H": np.ones((3, 1))},
    ):
        filter, keys = make(name, replace(system.model, **changes)), _numbers(3)
        belief = filter.init(system.rows(3), rng=keys)
        belief = filter.predict(belief, np.tile([2.0, 3.0], (3, 1)), rng=keys.at(1))
        beliefs.append(filter.update(belief, np.zeros((3, 3)), rng=keys.at(1)))
    one, other = beliefs
    np.testing.assert_allclose(one.mean, other.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(one.cov, other.cov, rtol=0, atol=1e-12)


@both
@pytest.mark.parametrize(
    ("option", "value", "kind"),
    [
        ("members", 1, "a whole number of at least 2"),
        ("members", 2.5, "a whole number of at least 2"),
        ("inflation", 0.0, "a positive number"), ("inflation", np.inf, "a positive number"),
        ("draws", "some", "'exact' or 'independent'"),
    ],
)  # fmt: skip
def test_options_that_make_no_sense_are_named_with_their_value(
    name: str, option: str, value: object, kind: str
):
    with pytest.raises(ValueError, match=f"^{option} must be {kind}, got '?{value}"):
        make(name, kalman_system(0).model, **{option: value})


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
