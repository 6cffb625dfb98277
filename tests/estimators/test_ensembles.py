"""The laws of ensemble filters, against dense formulas, and what their options promise."""

import dataclasses
import tracemalloc
from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import sqrtm

from estimators import Belief, Gaussian, LinearModel, NonlinearModel, RandomKeys, make, wrap
from estimators.analysis import exact_noise
from tests.estimators.cases import (
    Case,
    System,
    arrays,
    assert_same,
    every_case,
    kalman_system,
    random_covariance,
    simulate,
    track,
    turning_vehicle,
    without_channel,
)

NAMES = ["enkf", "etkf"]
SIZES = [(3, 5, 6), (8, 3, 1), (60, 4, 2)]  # members, states, measurements


def _numbers(*rows: int) -> RandomKeys:
    return RandomKeys.seeded(rows).of(7)


def _spread(belief: Belief) -> tuple[np.ndarray, np.ndarray]:
    """Anomalies of the members, and the covariance that they should have stored."""
    anomalies = belief.ensemble - belief.ensemble.mean(-2, keepdims=True)
    return anomalies, np.swapaxes(anomalies, -1, -2) @ anomalies / (anomalies.shape[-2] - 1)


def _predicted(name: str, members: int, n: int, p: int, seed: int = 0, **options: object):
    """A system, its filter and a prediction for three rows some way into a run."""
    system = kalman_system(seed, n=n, p=p)
    filter = make(name, system.model, members=members, draws="independent", **options)
    record = simulate(system, seed, runs=3, steps=3)
    belief = track(filter, system.rows(3), record, np.random.default_rng(seed))[-1]
    return (
        system,
        filter,
        filter.predict(belief, record.u[-1], rng=np.random.default_rng(1)),
        record.y[-1],
    )


# --- the moments are those of the members ---------------------------------------------------------


# --- 2. square-root filters -----------------------------------------------------------------------


@pytest.mark.parametrize(("members", "n", "p"), SIZES)
def test_the_transform_is_the_symmetric_root_of_the_textbook(members: int, n: int, p: int):
    """``(I + Y R^-1 Y' / (N - 1))^-1/2`` as an N x N matrix, by scipy."""
    system, filter, before, y = _predicted("etkf", members, n, p)
    after = filter.update(before, y, rng=np.random.default_rng(0))
    for row in range(3):
        A = _spread(before[row])[0]
        Y = A @ system.model.C.T
        T = np.linalg.inv(
            sqrtm(np.eye(members) + Y @ np.linalg.inv(system.model.R) @ Y.T / (members - 1)).real
        )
        np.testing.assert_allclose(_spread(after[row])[0], T @ A, rtol=0, atol=1e-11)


def test_etkf_and_enkf_sr_are_one_class():
    one, other = (make(name, kalman_system(0).model) for name in ("etkf", "enkf-sr"))
    assert type(one) is type(other)
    assert (one.name, other.name) == ("etkf", "enkf-sr")


def test_perfect_and_very_precise_measurements_keep_their_digits():
    """R = 0 needs no inverse, and R = 1e-14 P leaves R, to the eight digits that the members have left.

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


def _solved(A: list, B: list) -> list:
    """``A^-1 B`` of rational numbers, by Gauss and Jordan."""
    rows = [[*a, *b] for a, b in zip(A, B, strict=True)]
    for i in range(len(rows)):
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in set(range(len(rows))) - {i}:
            rows[k] = [a - rows[k][i] * b for a, b in zip(rows[k], rows[i], strict=True)]
    return [row[len(A) :] for row in rows]


@pytest.mark.parametrize(
    ("p", "R", "median", "worst"),
    [
        (2, 1e-6, 3e-16, 7e-16), (2, 1e-12, 3e-16, 9e-16), (2, 1e-18, 3e-16, 7e-16),
        (4, 1e-6, 2e-12, 1e-11), (4, 1e-9, 7e-11, 4e-8), (4, 1e-12, 9e-9, 1e-5),
        (6, 1e-6, 1e-12, 5e-12), (6, 1e-12, 1e-9, 5e-9), (6, 1e-15, 4e-8, 2e-7), (6, 1e-18, 1e-6, 5e-6),
    ],
)  # fmt: skip
def test_precise_measurements_cost_the_digits_that_are_printed(
    p: int, R: float, median: float, worst: float
):
    """Against rational arithmetic, three states and five members: within ten times what docs say, and the mean is."""
    exact, errors = np.vectorize(lambda value: Fraction(float(value)), otypes=[object]), []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        C = rng.normal(size=(p, 3))
        filter = make(
            "etkf",
            LinearModel(np.eye(3), C, np.eye(3), R * np.eye(p)),
            members=5,
            draws="independent",
        )
        before = filter.init(Gaussian(np.zeros(3), np.eye(3)), rng=rng)
        y = C @ rng.normal(size=3) + np.sqrt(R) * rng.normal(size=p)
        after = filter.update(before, y, rng=rng)
        X, C, y, noise = (exact(array) for array in (before.ensemble, C, y, R * np.eye(p)))
        centre = X.sum(0) / 5
        P = (X - centre).T.dot(X - centre) / 4
        gain = np.array(_solved((C.dot(P).dot(C.T) + noise).tolist(), C.dot(P).tolist())).T
        mean = (centre + gain.dot(y - C.dot(centre))).astype(float)
        cov = (P - gain.dot(C).dot(P)).astype(float)
        errors.append(np.abs(after.cov - cov).max() / np.abs(cov).max())
        assert np.abs(after.mean - mean).max() < 1e-7 * np.abs(mean).max()
    assert np.median(errors) < 10.0 * median
    assert max(errors) < 10.0 * worst


# --- 1. linear and Gaussian -----------------------------------------------------------------------


def _nearly_constant_state() -> tuple[LinearModel, np.ndarray]:
    """Six states, one known at first and one nearly constant, noise of rank 3, correlated measurements; a prior."""
    rng = np.random.default_rng(0)
    A = 0.95 * np.linalg.qr(rng.normal(size=(6, 6)))[0]
    A[5] = 0.999 * np.eye(6)[5]
    B = rng.normal(size=(6, 3))
    model = LinearModel(A, rng.normal(size=(3, 6)), 0.1 * B @ B.T, random_covariance(rng, 3))
    return model, np.diag([1.0, 1.0, 1.0, 0.0, 1.0, 1.0])


@pytest.mark.parametrize("members", [None, 6 + 3 + 2])
@pytest.mark.parametrize("name", NAMES)
def test_with_exact_draws_the_filter_is_the_kalman_filter(name: str, members: int | None):
    """Over 500 steps with 30 % of measurements missing, to 1e-8; independent draws of 64 members differ by 0.1."""
    model, cov = _nearly_constant_state()
    rows, rng, keys = 4, np.random.default_rng(1), _numbers(*range(4))
    kf, filter = make("kf", model), make(name, model, members=members)
    prior = Gaussian(np.zeros((rows, 6)), cov)
    exact, belief = kf.init(prior), filter.init(prior, rng=keys.at(0))
    for k in range(1, 501):
        y, available = rng.normal(size=(rows, 3)), rng.random((rows, 3)) < 0.7
        exact = kf.update(kf.predict(exact), y, available=available)
        ahead = filter.predict(belief, rng=keys.at(k))
        belief = filter.update(ahead, y, rng=keys.at(k), available=available)
        np.testing.assert_allclose(belief.mean, exact.mean, rtol=0, atol=1e-8)
        np.testing.assert_allclose(belief.cov, exact.cov, rtol=0, atol=1e-8)
    np.testing.assert_allclose(_spread(belief)[1], exact.cov, rtol=0, atol=1e-8)


@pytest.mark.parametrize(("n", "r", "members"), [(6, 3, 11), (16, 10, 64), (26, 12, 64)])
def test_exact_draws_have_exact_moments(n: int, r: int, members: int):
    """Mean 0, covariance I and no correlation with anomalies of any size, one of which repeats another: to 1e-12."""
    rng = np.random.default_rng(2)
    A = rng.normal(size=(20, n, members)) * 10.0 ** rng.uniform(-3.0, 3.0, (n, 1))
    A[:, 1] = -2.0 * A[:, 0]
    A -= A.mean(-1, keepdims=True)
    z = exact_noise(np.eye(r), rng.normal(size=(20, r, members)), A, A @ A.mT)
    unit = A / np.sqrt(np.square(A).mean(-1, keepdims=True))
    np.testing.assert_allclose(z.mean(-1), 0.0, atol=1e-12)
    np.testing.assert_allclose(
        z @ z.mT / (members - 1), np.broadcast_to(np.eye(r), (20, r, r)), atol=1e-12
    )
    np.testing.assert_allclose(z @ unit.mT / members, 0.0, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_the_default_has_enough_members_for_exact_draws_and_fewer_are_warned_of(name: str):
    """64, or the next multiple of 8 from n + max(rank Q, p) + 2 on."""
    for n, p, members in ((4, 3, 64), (31, 1, 64), (32, 3, 72), (4, 60, 72)):
        model = LinearModel(np.eye(n), np.ones((p, n)), np.eye(n), np.eye(p))
        assert make(name, model).members == members
    model = LinearModel(np.eye(4), np.eye(3, 4), np.eye(4), np.eye(3))
    with pytest.warns(
        UserWarning, match="^an ensemble of 9 members has independent draws: exact ones need 10"
    ) as seen:
        few = make(name, model, members=9)
    assert len(seen) == 1
    plain, prior = (
        make(name, model, members=9, draws="independent"),
        Gaussian(np.zeros((1, 4)), np.eye(4)),
    )
    assert_same(few.init(prior, rng=_numbers(0)), plain.init(prior, rng=_numbers(0)))
    with pytest.raises(ValueError, match="draws must be 'exact' or 'independent'"):
        make(name, model, draws="some")


# --- members outside the model's domain -----------------------------------------------------------


@pytest.mark.parametrize("members", [64, 1000])
@pytest.mark.parametrize("root", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_a_member_outside_the_models_domain_is_drawn_again_and_the_others_stay(
    name: str, root: bool, members: int
):
    """A tank that drains by the root of its level, near empty: no row begins again, and the error is that of `ekf`.

    Measured is the level or its root, so that members have no transition, or no measurement either.
    """

    def measured(x: np.ndarray, u: None) -> np.ndarray:
        return np.sqrt(x) if root else x

    model = NonlinearModel(
        lambda x, u: x - 0.05 * np.sqrt(x) + 0.01, measured, [[0.01**2]], [[0.05**2]]
    )
    rng, rows = np.random.default_rng(0), 20
    x, prior = np.full((rows, 1), 0.04), Gaussian(np.full((rows, 1), 0.04), [[1e-4]])
    ekf, filter, keys = (
        make("ekf", model),
        make(name, model, members=members),
        _numbers(*range(rows)),
    )
    beliefs = [ekf.init(prior), filter.init(prior, rng=keys.at(0))]
    squares = np.zeros(2)
    for k in range(1, 101):
        x = np.maximum(model.transition(x, None) + 0.01 * rng.normal(size=(rows, 1)), 1e-4)
        y = measured(x, None) + 0.05 * rng.normal(size=(rows, 1))
        beliefs = [
            f.advance(b, None, y, None, keys.at(k))
            for f, b in zip((ekf, filter), beliefs, strict=True)
        ]
        assert beliefs[1].healthy.all()
        squares += [np.square(b.mean - x).mean() for b in beliefs]
    assert squares[1] < 1.02 * squares[0]


def test_a_member_that_is_drawn_again_leaves_other_rows_and_members_alone():
    """To the last bit, alone and in a batch; where no more than n are left, the row begins again from its prior."""
    model = NonlinearModel(
        lambda x, u: 0.9 * np.sqrt(x), lambda x, u: x, 1e-4 * np.eye(2), np.eye(2)
    )
    filter, keys = make("enkf", model), _numbers(*range(4))
    belief = filter.init(Gaussian(np.full((4, 2), 9.0), np.eye(2)), rng=keys.at(0))
    ensemble = np.array(belief.ensemble)
    ensemble[1, :5], ensemble[3, 2:] = -1.0, -1.0
    changed = filter.predict(belief.replace(ensemble=ensemble), rng=keys.at(1))
    plain, alone = filter.predict(belief, rng=keys.at(1)), filter.predict(
        belief[1:2].replace(ensemble=ensemble[1:2]), rng=keys[1:2].at(1)
    )  # fmt: skip
    for row in (0, 2):
        assert_same(changed[row], plain[row])
    assert_same(changed[1:2], alone)
    assert np.isfinite(changed.ensemble[:3]).all()
    np.testing.assert_allclose(changed.ensemble[1, 5:], plain.ensemble[1, 5:], rtol=0, atol=0.05)
    assert np.abs(changed.ensemble[1, :5] - changed.mean[1]).max() < 4.0 * np.sqrt(
        changed.cov[1].max()
    )
    after = filter.update(changed, np.full(2, 3.0), rng=keys.at(1))
    assert after.healthy.tolist() == [True, True, True, False]


# --- as 1 / sqrt(N) -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_filter_tends_to_the_kalman_filter_as_one_over_the_root_of_members(name: str):
    system, runs, steps = kalman_system(0), 200, 6
    record = simulate(system, 0, runs, steps)
    exact = track(make("kf", system.model), system.rows(runs), record)[-1]
    sizes, errors = (25, 100, 400), []
    for members in sizes:
        filter = make(name, system.model, members=members, draws="independent")
        belief = track(filter, system.rows(runs), record, np.random.default_rng(0))
        errors.append([
            np.sqrt(((belief[-1].mean - exact.mean) ** 2).mean()), np.sqrt(((belief[-1].cov - exact.cov) ** 2).mean()),
        ])  # fmt: skip
    slopes = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    # Over 200 runs each error is known to about 3 %, a slope to about 0.01; small ensembles bend it
    # a little more.
    assert (np.abs(slopes + 0.5) < 0.06).all(), slopes


def test_measurement_noise_is_counted_once():
    """P = R = 1 leave 0.5: exactly for the square root, and in expectation for perturbed measurements."""
    model = LinearModel(A=[[1.0]], C=[[1.0]], Q=[[0.0]], R=[[1.0]])
    rng = np.random.default_rng(0)
    filter = make("etkf", model, members=5)
    before = filter.init(Gaussian([0.0], [[1.0]]), rng=rng)
    before = before.replace(ensemble=before.ensemble / np.sqrt(before.cov), cov=np.ones((1, 1)))
    assert filter.update(before, [1.0], rng=rng).cov[0, 0] == pytest.approx(0.5, abs=1e-14)
    filter = make("enkf", model, members=20_000)
    after = filter.update(filter.init(Gaussian([0.0], [[1.0]]), rng=rng), [1.0], rng=rng)
    assert after.cov[0, 0] == pytest.approx(
        0.5, abs=4 * 0.5 * np.sqrt(2.0 / 20_000)
    )  # four standard errors


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_errors_are_as_large_as_a_large_ensemble_says_but_for_its_sample_size(name: str):
    """The inverse of a sample covariance is too large by (N - 1) / (N - n - 2) (Anderson 2003, sec. 7.7)."""
    system, runs, members = kalman_system(1), 400, 100
    n = system.model.n
    record = simulate(system, 20, runs, 5)
    filter = make(name, system.model, members=members, draws="independent")
    final = track(filter, system.rows(runs), record, np.random.default_rng(0))[-1]
    error = record.x[-1] - final.mean
    mean = (
        np.einsum("ri,rij,rj->r", error, np.linalg.inv(final.cov), error).mean()
        * (members - n - 2)
        / (members - 1)
    )
    # Mean of 400 values of about chi-square law: standard deviation sqrt(2 n / 400); four of them,
    # and 3 % for the gain's own error, which the factor leaves out.
    assert abs(mean / n - 1.0) < 4.0 * np.sqrt(2.0 / (n * runs)) + 0.03


# --- process noise --------------------------------------------------------------------------------


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
@pytest.mark.parametrize("name", NAMES)
def test_process_noise_takes_as_many_numbers_a_member_as_its_rank(name: str, rank: int):
    root = np.random.default_rng(0).normal(size=(4, rank))
    Q = root @ root.T
    model = LinearModel(A=np.eye(4), C=np.eye(4), Q=Q, R=np.eye(4))
    filter, rng = make(name, model, members=20_000), _Counting()
    start = filter.init(Gaussian(np.ones(4), np.zeros((4, 4))), rng=rng)
    rng.drawn = 0
    after = filter.predict(start, rng=rng)
    assert rng.drawn == rank * 20_000
    np.testing.assert_allclose(after.mean, 1.0, rtol=0, atol=1e-12)  # the noise is centred
    # Five standard errors of a sample covariance, sqrt((Q_ij^2 + Q_ii Q_jj) / N).
    sd = np.sqrt((Q**2 + np.outer(np.diag(Q), np.diag(Q))) / 20_000)
    assert (np.abs(after.cov - Q) <= 5.0 * sd + 1e-15).all()


def test_a_square_root_update_draws_nothing():
    filter, rng = make("etkf", kalman_system(0).model, members=6, draws="independent"), _Counting()
    belief = filter.init(Gaussian(np.zeros(4), np.eye(4)), rng=rng)
    rng.drawn = 0
    filter.update(belief, np.zeros(3), rng=rng)
    assert rng.drawn == 0


# --- options --------------------------------------------------------------------------------------


# --- missing measurements -------------------------------------------------------------------------


@pytest.mark.parametrize("j", range(3))
@every_case("square-root", "linear")
def test_masking_a_channel_of_a_square_root_filter_equals_a_model_without_it(case: Case, j: int):
    system = case.system(0)
    record = simulate(system, 0, runs=3, steps=15)
    kept = np.arange(3) != j
    masked = track(
        case.make(system.model),
        system.rows(3),
        record,
        _numbers(0, 1, 2),
        np.broadcast_to(kept, record.y.shape),
    )
    reduced = track(
        case.make(without_channel(system.model, j)), system.rows(3), record._replace(y=record.y[..., kept]),
        _numbers(0, 1, 2),
    )  # fmt: skip
    for one, other in zip(masked, reduced, strict=True):
        np.testing.assert_allclose(one.ensemble, other.ensemble, rtol=0, atol=1e-11)


@every_case("ensemble")
def test_an_update_without_measurements_leaves_the_members_alone(case: Case):
    system = case.system(0)
    filter, rng = case.make(system.model), np.random.default_rng(0)
    before = filter.init(system.rows(3), rng=rng)
    before = before.replace(u=np.zeros((3, system.m)))
    after = filter.update(before, np.full(system.model.p, np.nan), rng=rng)
    scale = np.abs(before.cov).max()
    np.testing.assert_array_equal(after.innovation, 0.0)
    np.testing.assert_allclose(after.ensemble, before.ensemble, rtol=0, atol=1e-13 * scale)


# --- random numbers -------------------------------------------------------------------------------


@every_case("ensemble")
def test_missing_random_numbers_or_those_of_other_rows_are_named(case: Case):
    system = case.system(0)
    filter = case.make(system.model)
    belief = filter.init(system.rows(3), rng=np.random.default_rng(0))
    y, u = np.zeros((3, system.model.p)), np.zeros((3, system.m))
    steps = [
        lambda rng: filter.init(system.rows(3), rng=rng),
        lambda rng: filter.predict(belief, u, rng=rng),
        lambda rng: filter.update(belief, y, u=u, rng=rng),
    ]
    for step in steps:
        with pytest.raises(ValueError, match=rf"^{case.name} draws random numbers: pass rng"):
            step(None)
        with pytest.raises(ValueError, match=r"^rng has keys for rows \(2,\), expected \(3,\)"):
            step(_numbers(0, 1))


@every_case("ensemble")
def test_one_generator_serves_a_whole_batch_and_every_row_is_different(case: Case):
    system = case.system(0)
    filter = case.make(system.model)
    record = simulate(system, 0, runs=1, steps=4)
    same = record._replace(y=np.repeat(record.y, 3, 1), u=np.repeat(record.u, 3, 1))
    one, again = (
        track(filter, system.rows(3), same, np.random.default_rng(5))[-1] for _ in range(2)
    )
    assert_same(one, again)
    assert np.abs(one.ensemble[0] - one.ensemble[1]).max() > 1e-3


# --- recovery -------------------------------------------------------------------------------------


@every_case("ensemble")
def test_a_lost_row_is_drawn_again_from_its_prior_and_leaves_the_others_alone(case: Case):
    system = case.system(0)
    filter = case.make(system.model)
    record = simulate(system, 0, runs=3, steps=4)

    def run(lost: bool) -> list[Belief]:
        rng, beliefs = _numbers(0, 1, 2), []
        belief = filter.init(system.rows(3), rng=rng)
        for k in range(4):
            belief = filter.predict(belief, record.u[k], rng=rng.at(k))
            if lost and k == 1:
                ensemble = belief.ensemble.copy()
                ensemble[1, 0] = np.nan
                belief = belief.replace(ensemble=ensemble)
            belief = filter.update(belief, record.y[k], rng=rng.at(k))
            beliefs.append(belief)
        return beliefs

    for k, (one, other) in enumerate(zip(run(True), run(False), strict=True)):
        np.testing.assert_array_equal(one.healthy, [True, k != 1, True])
        assert_same(one[[0, 2]], other[[0, 2]], 1e-12)
        for name, array in arrays(one).items():
            assert np.isfinite(array).all(), name
    fresh = run(True)[1]
    own = _numbers(1).at(1)  # the numbers of the step at which it was lost
    begun = filter.init(system.rows(1), rng=own).replace(u=record.u[1][1:2])
    expected = filter.update(begun, record.y[1][1:2], rng=own)
    np.testing.assert_allclose(fresh.ensemble[1:2], expected.ensemble, rtol=0, atol=1e-12)


# --- angles ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("folded", [False, True])
def test_an_angle_of_which_nothing_was_known_is_known_as_well_as_it_was_read(
    name: str, folded: bool
):
    """A prior wider than a turn; and a model whose noise has spread the members over more than that."""

    def angle(x: np.ndarray) -> np.ndarray:
        return np.arctan2(np.sin(x), np.cos(x)) if folded else x

    sd, centres = 0.05, np.linspace(-20.0, 20.0, 30)[:, None]
    for prior, Q in ((3.0, 0.0), (0.1, 9.0)):
        model = NonlinearModel(
            lambda x, u: angle(x), lambda x, u: angle(x), [[Q]], [[sd**2]], state_angles=(0,), measurement_angles=(0,)
        )  # fmt: skip
        filter_ = make(name, model, members=100)
        numbers = RandomKeys.seeded(range(30))
        belief = filter_.init(Gaussian(centres, np.full((30, 1, 1), prior**2)), numbers)
        truth = centres + 3.0 * np.sin(np.arange(30.0))[:, None]
        for k in (1, 3, 5):
            ahead = filter_.predict(belief, rng=numbers.at(k))
            belief = filter_.update(ahead, angle(truth), rng=numbers.at(k + 1))
        # Of 100 members the mean of perturbed measurements is a tenth of the noise off, and the
        # deviation 7 % in 1 sd.
        assert np.abs(wrap(belief.mean - truth)).max() < 0.6 * sd
        assert np.sqrt(belief.cov).max() < 1.4 * sd


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_vehicle_is_followed_by_range_and_bearing_as_the_extended_filter_follows_it(name: str):
    system = turning_vehicle(0)
    record = simulate(system, 0, runs=100, steps=100)
    errors = []
    for filter, rng in (
        (make("ekf", system.model), None),
        (make(name, system.model, members=50), _numbers(*range(100))),
    ):
        beliefs = track(filter, system.rows(100), record, rng)[20:]
        error = np.array([b.mean[:, :2] for b in beliefs]) - record.x[20:, :, :2]
        errors.append(np.sqrt((error**2).mean()))
    assert errors[1] < 1.1 * errors[0]


# --- models ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_noise_that_is_a_function_of_the_known_input_is_the_noise_at_that_input(name: str):
    model = kalman_system(0).model
    changing = dataclasses.replace(
        model,
        Q=lambda u: model.Q * u[..., :1, None] ** 2,
        R=lambda u: model.R * u[..., 1:, None] ** 2,
    )
    fixed = dataclasses.replace(model, R=9.0 * model.R)
    u, y = np.tile([2.0, 3.0], (3, 1)), np.zeros((3, 3))
    beliefs = []
    for m in (changing, fixed):
        filter = make(name, m, members=20_000)
        belief = filter.init(Gaussian(np.zeros((3, 4)), np.eye(4)), rng=np.random.default_rng(0))
        beliefs.append((filter, belief, filter.predict(belief, u, rng=np.random.default_rng(1))))
    before, predicted = beliefs[0][1], beliefs[0][2]
    expected = model.A @ before.cov @ model.A.T + 4.0 * model.Q
    # Five standard errors of a sample covariance of 20,000.
    size = np.diagonal(expected, axis1=-2, axis2=-1)
    assert (np.abs(predicted.cov - expected) < 5.0 * np.sqrt(2.0 / 20_000) * size.max()).all()
    one, other = (f.update(predicted, y, rng=np.random.default_rng(2)) for f, *_ in beliefs)
    assert_same(one, other, 1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_an_unknown_input_in_the_model_is_ignored(name: str):
    system = kalman_system(0)
    driven = dataclasses.replace(system.model, G=np.ones((4, 1)), H=np.ones((3, 1)))
    record = simulate(system, 0, runs=2, steps=4)
    one, other = (
        track(
            make(name, model, members=9, draws="independent"),
            system.rows(2),
            record,
            _numbers(0, 1),
        )[-1]
        for model in (system.model, driven)
    )
    assert_same(one, other)


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_options_that_make_no_sense_are_named_with_their_value(name: str):
    model = kalman_system(0).model
    for members in (1, 0, -3, 2.5, True):
        with pytest.raises(
            ValueError, match=f"^members must be a whole number of at least 2, got {members}"
        ):
            make(name, model, members=members)
    for inflation in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"^inflation must be a positive number, got"):
            make(name, model, inflation=inflation)


# --- memory ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_as_large_as_the_square_of_the_members(name: str):
    system: System = kalman_system(0)
    N = 20_000
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
