"""The particle filter against exact filters: Kalman's where the model is linear, a grid where it is not."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from estimators import (
    Gaussian,
    LinearModel,
    NonlinearModel,
    ParticleFilter,
    RandomKeys,
    Recovery,
    make,
)
from estimators.particles import systematic
from tests.estimators.cases import arrays, assert_same, kalman_system, simulate, track


def _numbers(*rows: int) -> RandomKeys:
    return RandomKeys.seeded(rows).of(7)


# --- the exact posterior --------------------------------------------------------------------------


def _log_density(belief) -> np.ndarray:
    """Of the last measurement, by a Kalman filter, of the channels that arrived."""
    sizes = belief.available.sum(-1)
    e, S = belief.innovation, belief.innovation_cov
    return (
        -0.5 * (np.vecdot(e, np.linalg.solve(S, e[..., None])[..., 0]) + np.linalg.slogdet(S)[1])
        - 0.5 * np.log(2.0 * np.pi) * sizes
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_moments_and_likelihood_are_the_kalman_filters_as_far_as_the_particles_allow(seed: int):
    """Over 60 filters with numbers of their own the mean error is 0, and shrinks as the root of N says.

    What the filters average to has a standard error that their scatter tells. Five of these, for 6
    steps of 2 means, 3 covariances and a likelihood: a false alarm once in 5e4 tests, if a bias of
    order 1/N is left room: 3 / N of the spread.
    """
    system = kalman_system(seed, n=2, p=1)
    runs, steps, N = 60, 6, 2000
    record = simulate(system, seed, 1, steps)
    available = np.ones((steps, 1, 1), bool)
    available[3] = False
    same = record._replace(y=np.repeat(record.y, runs, 1), u=np.repeat(record.u, runs, 1))
    masks = np.repeat(available, runs, 1)
    filter = make("pf", system.model, particles=N)
    beliefs = track(filter, system.rows(runs), same, _numbers(*range(runs)), masks)
    exact = track(make("kf", system.model), system.rows(1), record, available=available)
    for belief, kalman in zip(beliefs, exact, strict=True):
        sd = np.sqrt(np.diagonal(kalman.cov[0]))
        pairs = (
            (belief.mean / sd, kalman.mean[0] / sd), (belief.cov / np.outer(sd, sd), kalman.cov[0] / np.outer(sd, sd)),
            (belief.log_likelihood, _log_density(kalman)[0]),
        )  # fmt: skip
        for mine, expected in pairs:
            error = mine - expected
            half = 5.0 * error.std(0, ddof=1) / np.sqrt(runs)
            assert (np.abs(error.mean(0)) <= half + 3.0 / N).all()
            assert (
                error.std(0) < 12.0 / np.sqrt(N)
            ).all()  # a filter that knows nothing would scatter by 1
    assert (beliefs[3].log_likelihood == 0.0).all()


def _growth(k: float) -> NonlinearModel:
    """The univariate nonstationary growth model of Netto et al. (1978), as Kitagawa (1987) and Gordon et al. (1993)."""
    return NonlinearModel(
        lambda x, u: 0.5 * x + 25.0 * x / (1.0 + x * x) + 8.0 * np.cos(1.2 * u), lambda x, u: x * x / 20.0,
        Q=[[10.0]], R=[[1.0]],
    )  # fmt: skip


def _on_a_grid(y: np.ndarray, prior: Gaussian) -> list[tuple[float, float, float]]:
    """Mean, variance and log density of each measurement of the growth model, by Bayes' rule on a grid."""
    model = _growth(0)
    x = np.linspace(-45.0, 45.0, 1201)
    step = x[1] - x[0]
    density = multivariate_normal.pdf(x, prior.mean[0], prior.cov[0, 0])
    out = []
    for k, measurement in enumerate(y):
        if k:
            moved = model.transition(x[:, None], np.array([float(k - 1)]))
            density = (
                np.exp(-0.5 * (x[:, None] - moved.T) ** 2 / 10.0)
                @ density
                * step
                / np.sqrt(20.0 * np.pi)
            )
        seen = density * np.exp(-0.5 * (measurement - x * x / 20.0) ** 2) / np.sqrt(2.0 * np.pi)
        total = seen.sum() * step
        density = seen / total
        mean = (x * density).sum() * step
        out.append((mean, ((x - mean) ** 2 * density).sum() * step, np.log(total)))
    return out


def _grown(seed: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    rng, model = np.random.default_rng(seed), _growth(0)
    x, truth = rng.normal(scale=np.sqrt(5.0), size=1), []
    for k in range(steps):
        if k:
            x = model.transition(x, np.array([float(k - 1)])) + np.sqrt(10.0) * rng.normal(size=1)
        truth.append(x)
    return np.array(truth), np.array(truth) ** 2 / 20.0 + rng.normal(size=(steps, 1))


def _followed(name: str, y: np.ndarray, runs: int, **options: object):
    prior = Gaussian(np.zeros((runs, 1)), [[5.0]])
    filter, numbers = make(name, _growth(0), **options), _numbers(*range(runs))
    belief, beliefs = filter.init(prior, rng=numbers), []
    for k, measurement in enumerate(y):
        if k:
            belief = filter.predict(belief, np.full((runs, 1), float(k - 1)), rng=numbers.at(k))
        belief = filter.update(belief, np.broadcast_to(measurement, (runs, 1)), rng=numbers.at(k))
        beliefs.append(belief)
    return beliefs


@pytest.mark.slow
def test_the_growth_model_is_followed_as_by_the_exact_filter_and_better_than_by_linearising():
    """Its posterior has two peaks, as the measurement does not show the sign. Bands as in the linear test."""
    runs, N = 20, 20_000  # peaks that hold 1e-4 of the mass make the variance, and need particles
    truth, y = _grown(3, 40)
    exact = _on_a_grid(y[:, 0], Gaussian([0.0], [[5.0]]))
    beliefs = _followed("pf", y, runs, particles=N)
    for belief, (mean, variance, log_density) in zip(beliefs, exact, strict=True):
        pairs = (
            ((belief.mean[:, 0] - mean) / np.sqrt(variance)), (belief.cov[:, 0, 0] / variance - 1.0),
            (belief.log_likelihood - log_density),
        )  # fmt: skip
        for error in pairs:
            assert abs(error.mean()) <= 5.0 * error.std(ddof=1) / np.sqrt(runs) + 10.0 / N
    far = [np.sqrt(np.mean([(b.mean[0, 0] - x[0]) ** 2 for b, x in zip(bs, truth, strict=True)]))
           for bs in (beliefs, _followed("ekf", y, 1))]  # fmt: skip
    best = np.sqrt(
        np.mean([(mean - x[0]) ** 2 for (mean, *_), x in zip(exact, truth, strict=True)])
    )
    assert far[0] < 1.05 * best
    assert far[1] > 1.5 * best


@pytest.mark.slow
def test_the_likelihood_is_unbiased():
    """The mean of its exponential over filters is the exact one (Del Moral 2004), here over 4000 with few particles."""
    system, runs, steps = kalman_system(2, n=2, p=1), 4000, 4
    record = simulate(system, 5, 1, steps)
    same = record._replace(y=np.repeat(record.y, runs, 1), u=np.repeat(record.u, runs, 1))
    exact = sum(_log_density(b)[0] for b in track(make("kf", system.model), system.rows(1), record))
    for options in ({"threshold": 0.5}, {"threshold": 1.0}, {"threshold": 0.0}):
        filter = make("pf", system.model, particles=20, **options)
        total = sum(
            b.log_likelihood for b in track(filter, system.rows(runs), same, _numbers(*range(runs)))
        )
        ratio = np.exp(total - exact)
        assert abs(ratio.mean() - 1.0) < 4.0 * ratio.std() / np.sqrt(runs)  # false alarm 6e-5 each
        assert abs(total.mean() - exact) > 4.0 * total.std() / np.sqrt(
            runs
        )  # its logarithm is not unbiased


# --- resampling -----------------------------------------------------------------------------------


@settings(derandomize=True, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    N=st.integers(2, 40),
    offset=st.floats(0.0, 1.0, exclude_max=True),
)
def test_systematic_resampling_copies_each_particle_as_often_as_its_weight_says_within_one(
    seed: int, N: int, offset: float
):
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.full(N, 0.2), 3)
    chosen = systematic(weights, np.full(3, offset))
    assert chosen.shape == (3, N)
    assert (np.diff(chosen) >= 0).all()
    for row, own in zip(chosen, weights, strict=True):
        assert (np.abs(np.bincount(row, minlength=N) - N * own) < 1.0 + 1e-9).all()


def test_systematic_resampling_is_unbiased():
    weights = np.array([0.05, 0.4, 0.0, 0.31, 0.24])
    offsets = (np.arange(10_000) + 0.5) / 10_000
    chosen = systematic(np.tile(weights, (10_000, 1)), offsets)
    counts = np.stack([(chosen == i).sum(-1).mean() for i in range(5)])
    np.testing.assert_allclose(
        counts, 5.0 * weights, rtol=0, atol=2e-4
    )  # a grid of offsets integrates to 1 / 10,000


def test_particles_are_resampled_where_few_count_and_have_equal_weights_then():
    system = kalman_system(0)
    record = simulate(system, 0, 20, 8)
    filter = make("pf", system.model, particles=100, threshold=0.3)
    numbers = _numbers(*range(20))
    belief, seen = filter.init(system.rows(20), rng=numbers), set()
    for k, y in enumerate(record.y):
        updated = filter.update(belief, y, rng=numbers.at(k))
        assert (updated.effective_size >= 1.0 - 1e-12).all()
        assert (updated.effective_size <= 100.0 + 1e-9).all()
        few = updated.effective_size < 30.0
        seen |= set(few.tolist())
        belief = filter.predict(updated, record.u[k], rng=numbers.at(k))
        np.testing.assert_allclose(belief.effective_size[few], 100.0, rtol=1e-12)
        np.testing.assert_allclose(belief.log_weights[few], -np.log(100.0), rtol=1e-14)
        np.testing.assert_allclose(
            belief.log_weights[~few], updated.log_weights[~few], rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(np.exp(belief.log_weights).sum(-1), 1.0, rtol=1e-12)
    assert seen == {True, False}


def test_jitter_moves_copies_apart_and_nothing_else():
    """Constants without process noise: without it particles run out, with it copies spread as its bandwidth says."""
    model, N = LinearModel(np.eye(2), np.eye(2), np.zeros((2, 2)), np.eye(2)), 4000
    plain, jittered = (make("pf", model, particles=N, threshold=1.0, jitter=j) for j in (0.0, 0.5))
    numbers = _numbers(0)[0]
    before = plain.init(Gaussian(np.zeros(2), np.diag([1.0, 4.0])), rng=numbers)
    before = plain.update(before, [1.0, 2.0], rng=numbers)
    one, other = (f.predict(before, rng=numbers.at(1)) for f in (plain, jittered))
    first = np.ones(N, bool)
    first[1:] = (one.particles[1:] != one.particles[:-1]).any(-1)
    np.testing.assert_array_equal(other.particles[first], one.particles[first])
    moved = (other.particles - one.particles)[~first]
    expected = (0.5 * N ** (-1.0 / 6.0)) ** 2 * before.cov
    scatter = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / len(moved))
    assert (np.abs(moved.T @ moved / len(moved) - expected) < 5.0 * scatter).all()
    assert len(np.unique(one.particles[:, 0])) < N == len(np.unique(other.particles[:, 0]))


# --- measurements that cannot be used -------------------------------------------------------------


def test_a_measurement_that_no_particle_explains_is_left_out_alone():
    system = kalman_system(0)
    record = simulate(system, 0, 3, 3)
    filter, numbers = make("pf", system.model, particles=200), _numbers(0, 1, 2)
    belief = filter.predict(
        filter.init(system.rows(3), rng=numbers), record.u[0], rng=numbers.at(1)
    )
    for absurd in (1e4, -1e300, np.finfo(float).max):
        y, mask = record.y[1].copy(), np.ones((3, 3), bool)
        y[1, 2], mask[1, 2] = absurd, False
        updated = filter.update(belief, y, rng=numbers)
        np.testing.assert_array_equal(updated.recovery, [0, Recovery.WITHOUT_CHANNEL, 0])
        np.testing.assert_array_equal(updated.available, mask)
        expected = filter.update(belief, y, rng=numbers, available=mask)
        assert_same(updated, expected, 1e-12, ignore=["recovery"])
        y[1] = absurd
        nothing = filter.update(belief, y, rng=numbers)
        assert nothing.log_likelihood[1] == 0.0
        np.testing.assert_allclose(nothing.mean[1], belief.mean[1], rtol=0, atol=1e-12)


def test_a_precise_measurement_among_too_few_particles_is_no_absurd_one():
    """Every density is 0 in double precision, but the measurement lies where it may: the nearest particle is taken."""
    model = LinearModel([[1.0]], [[1.0]], [[1.0]], [[1e-12]])
    filter, numbers = make("pf", model, particles=50), _numbers(0)[0]
    before = filter.init(Gaussian([0.0], [[4.0]]), rng=numbers)
    updated = filter.update(before, [1.5], rng=numbers)
    assert updated.healthy
    nearest = before.particles[np.abs(before.particles[:, 0] - 1.5).argmin()]
    np.testing.assert_allclose(updated.mean, nearest, rtol=1e-9)
    assert updated.effective_size == pytest.approx(1.0)
    assert updated.log_likelihood < -745.0


def test_a_noiseless_measurement_is_left_out_and_a_model_of_one_refused():
    model = LinearModel(np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    with pytest.raises(
        ValueError, match=r"^pf needs noise in every measurement, but R is singular"
    ):
        make("pf", dataclasses.replace(model, R=np.diag([1.0, 0.0])))
    filter, rng = make("pf", model, particles=50), np.random.default_rng(0)
    updated = filter.update(
        filter.init(Gaussian(np.zeros(2), np.eye(2)), rng=rng), [1.0, 1.0], rng, R=np.diag([1.0, 0])
    )
    np.testing.assert_array_equal(updated.available, [True, False])
    assert updated.recovery == Recovery.WITHOUT_CHANNEL


def test_particles_that_leave_the_domain_of_the_model_are_left_behind():
    model = NonlinearModel(lambda x, u: np.sqrt(x), lambda x, u: np.log(x - 0.5), [[1e-4]], [[1.0]])
    filter, numbers = make("pf", model, particles=100), _numbers(0, 1)
    belief = filter.init(Gaussian([[0.5], [-90.0]], [[1.0]]), rng=numbers)
    share = (belief.particles[0] < 0.0).mean()
    assert 0.1 < share < 0.9
    with np.errstate(invalid="ignore", divide="ignore"):
        predicted = filter.predict(belief, rng=numbers.at(1))
        updated = filter.update(predicted, [[0.0], [0.0]], rng=numbers.at(1))
    assert (np.exp(predicted.log_weights[0]) == 0.0).mean() == share
    assert np.isnan(
        predicted.mean[1]
    ).all()  # nothing is left of this row, which begins again from its prior
    assert updated.healthy[0]
    assert updated.recovery[1] >= Recovery.WITHOUT_CHANNEL
    for name, array in arrays(updated).items():
        assert np.isfinite(array).all(), name


# --- angles and batches ---------------------------------------------------------------------------


def test_a_heading_that_may_be_on_both_sides_of_the_cut_is_averaged_on_the_circle():
    """Particles a turn apart are one heading: measurements that do not show turns leave a narrow belief."""
    model = NonlinearModel(
        lambda x, u: x, lambda x, u: np.stack([np.cos(x[..., 0]), np.sin(x[..., 0])], -1), [[1e-4]], 1e-2 * np.eye(2),
        state_angles=(0,),
    )  # fmt: skip
    filter, numbers = ParticleFilter(model, particles=4000), _numbers(0)[0]
    belief = filter.init(Gaussian([3.0], [[25.0]]), rng=numbers)
    belief = filter.update(belief, [np.cos(3.1), np.sin(3.1)], rng=numbers)
    turns = np.rint((belief.particles[np.exp(belief.log_weights) > 1e-5] - 3.1) / (2.0 * np.pi))
    assert len(np.unique(turns)) > 1
    assert abs(np.angle(np.exp(1j * (belief.mean[0] - 3.1)))) < 0.02
    assert belief.cov[0, 0] == pytest.approx(1e-2, rel=0.3)


def test_a_record_adds_up():
    """Weights, moments and likelihood are those of the particles."""
    system = kalman_system(0)
    model, record = system.model, simulate(system, 0, 2, 2)
    filter, numbers = make("pf", model, particles=30), _numbers(0, 1)
    before = filter.init(system.rows(2), rng=numbers)
    after = filter.update(before, record.y[0], rng=numbers)
    for row in range(2):
        off = record.y[0][row] - before.particles[row] @ model.C.T
        densities = (
            multivariate_normal.logpdf(off, np.zeros(model.p), model.R) + before.log_weights[row]
        )
        assert after.log_likelihood[row] == pytest.approx(logsumexp(densities), rel=1e-12)
        np.testing.assert_allclose(
            after.log_weights[row], densities - logsumexp(densities), rtol=0, atol=1e-11
        )
        weights = np.exp(after.log_weights[row])
        np.testing.assert_allclose(
            after.mean[row], weights @ after.particles[row], rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(
            after.cov[row],
            np.cov(after.particles[row].T, aweights=weights, ddof=0),
            rtol=0,
            atol=1e-12,
        )
