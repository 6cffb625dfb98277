"""The particle filter against exact filters: Kalman's where the model is linear, else a grid."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from estimators import (
    Belief,
    Gaussian,
    LinearModel,
    NonlinearModel,
    ParticleFilter,
    RandomKeys,
    consistency,
    fit,
    make,
    run,
)
from estimators.faults import ChiSquareMonitor, CusumMonitor
from estimators.particles import systematic
from tests.estimators.cases import (
    Record,
    System,
    arrays,
    assert_same,
    kalman_system,
    simulate,
    track,
)


def _numbers(*rows: int) -> RandomKeys:
    return RandomKeys.seeded(rows).of(7)


# --- the exact posterior --------------------------------------------------------------------------


def _exact(system: System, record: Record, available: np.ndarray) -> list[tuple[np.ndarray, ...]]:
    """Mean, covariance and log density of each measurement, by a Kalman filter."""
    found = []
    for b in track(make("kf", system.model), system.rows(1), record, available=available):
        seen = b.available[0]
        e, S = b.innovation[0][seen], b.innovation_cov[0][seen][:, seen]
        density = multivariate_normal.logpdf(e, np.zeros(len(e)), S) if seen.any() else 0.0
        found.append((b.mean[0], b.cov[0], density))
    return found


def test_moments_and_likelihood_are_the_exact_ones_as_far_as_the_particles_allow():
    """The mean error over filters with numbers of their own is 0.

    The average of the filters has a standard error that their scatter tells. Five of these are a
    false alarm once in 5e4 tests, if a bias of order 1 / N is left room: 10 / N of the spread.
    """
    system, runs, N = kalman_system(0, n=2, p=1), 60, 2000
    record, available = simulate(system, 3, 1, 12), np.arange(12)[:, None, None] != 3
    same = record._replace(y=np.repeat(record.y, runs, 1), u=np.repeat(record.u, runs, 1))
    filter, masks = make("pf", system.model, particles=N), np.repeat(available, runs, 1)
    beliefs = track(filter, system.rows(runs), same, _numbers(*range(runs)), masks)
    for belief, (mean, cov, density) in zip(
        beliefs, _exact(system, record, available), strict=True
    ):
        sd = np.sqrt(np.diagonal(cov))
        off = (belief.mean - mean) / sd, (belief.cov - cov) / np.outer(sd, sd)
        for error in (*off, belief.log_likelihood - density):
            half = 5.0 * error.std(0, ddof=1) / np.sqrt(runs)
            assert (np.abs(error.mean(0)) <= half + 10.0 / N).all()
        assert (off[0].std(0) < 0.3).all()  # a filter that knows nothing would scatter by 1


@pytest.mark.parametrize("threshold", [0.0, 0.5, 1.0])
def test_the_likelihood_is_unbiased(threshold: float):
    """The mean of its exponential is the exact one (Del Moral 2004), here with few particles."""
    system, runs, steps = kalman_system(2, n=2, p=1), 4000, 4
    record = simulate(system, 5, 1, steps)
    same = record._replace(y=np.repeat(record.y, runs, 1), u=np.repeat(record.u, runs, 1))
    exact = sum(density for *_, density in _exact(system, record, np.ones((steps, 1, 1), bool)))
    filter = make("pf", system.model, particles=20, threshold=threshold)
    beliefs = track(filter, system.rows(runs), same, _numbers(*range(runs)))
    error = sum(b.log_likelihood for b in beliefs) - exact
    ratio = np.exp(error)
    assert abs(ratio.mean() - 1.0) < 4.0 * ratio.std() / np.sqrt(runs)  # false alarm 6e-5 each
    assert abs(error.mean()) > 4.0 * error.std() / np.sqrt(runs)  # its logarithm is not unbiased


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
    counts = np.bincount(chosen.ravel()) / 10_000
    np.testing.assert_allclose(counts, 5.0 * weights, rtol=0, atol=2e-4)


def test_particles_are_resampled_where_few_count_and_have_equal_weights_then():
    system = kalman_system(0)
    record, numbers = simulate(system, 0, 20, 8), _numbers(*range(20))
    filter = make("pf", system.model, particles=100, threshold=0.3)
    share = []
    for k, updated in enumerate(track(filter, system.rows(20), record, numbers)):
        size = 1.0 / np.exp(2.0 * updated.log_weights).sum(-1)
        np.testing.assert_allclose(updated.effective_size, size, rtol=1e-12)
        few = size < 30.0
        share.append(few.mean())
        weights = filter.predict(updated, record.u[k], rng=numbers.at(k + 1)).log_weights
        np.testing.assert_allclose(weights[few], -np.log(100.0), rtol=1e-14)
        np.testing.assert_allclose(weights[~few], updated.log_weights[~few], rtol=0, atol=1e-12)
    assert 0.0 < np.mean(share) < 1.0


def test_jitter_moves_copies_apart_and_nothing_else():
    """Without process noise particles run out; with jitter copies spread as its bandwidth says."""
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


_LEVEL = LinearModel([[1.0]], [[1.0]], [[1e-4]], [[0.01]])
_UNIT = Gaussian([0.0], [[1.0]])


@pytest.mark.parametrize("y", [5.0, 40.0, 50.0, 1e3, 1e8, -1e300, np.finfo(float).max])
def test_an_absurd_measurement_has_its_tiny_density(y: float):
    filter, numbers = make("pf", _LEVEL), _numbers(0)[0]
    before = filter.init(_UNIT, rng=numbers)
    after = filter.update(before, [y], rng=numbers)
    with np.errstate(over="ignore"):
        off = np.minimum(np.square((y - before.particles[:, 0]) / 0.1), 1e300)
    expected = logsumexp(before.log_weights - 0.5 * off) - 0.5 * np.log(2.0 * np.pi * 0.01)
    assert after.log_likelihood == pytest.approx(expected, rel=1e-12)
    assert after.innovation[0] == pytest.approx(y - before.mean[0], rel=1e-12)
    assert after.available.all()
    assert after.healthy == (y == 5.0)
    assert np.isfinite(after.mean).all()
    assert filter.predict(after, rng=numbers.at(1)).healthy


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_channels_that_contradict_each_other_are_not_explained(unit: float):
    """Each innovation is two standard deviations long, both together a hundred."""
    C, R = np.ones((2, 1)), 0.01 * unit**2 * np.eye(2)
    filter, numbers = make("pf", LinearModel([[1.0]], C, [[1e-4 * unit**2]], R)), _numbers(0)[0]
    before = filter.init(Gaussian([0.0], [[100.0 * unit**2]]), rng=numbers)
    for y, explained in (([9.9 * unit, 10.1 * unit], True), ([0.0, 20.0 * unit], False)):
        assert filter.update(before, y, rng=numbers).healthy == explained


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("name", ["pf", "ukf", "ekf", "enkf", "huber-kf"])
def test_a_measurement_without_expectation_is_not_healthy(name: str):
    """Where h has no value, what came is left out, and nobody is told that all is well."""
    model = NonlinearModel(lambda x, u: x, lambda x, u: np.sqrt(x), [[0.01]], [[0.01]])
    series = run(make(name, model), Gaussian([-5.0], [[0.1]]), [[1.0]], rng=0)
    assert not series.updated.available.any()
    assert not series.updated.healthy.any()


def test_an_absurd_measurement_of_one_row_leaves_the_others():
    system, numbers = kalman_system(0), _numbers(0, 1, 2)
    record, filter = simulate(system, 0, 3, 3), make("pf", system.model, particles=200)
    belief, y = filter.init(system.rows(3), rng=numbers), record.y[0].copy()
    ordinary = filter.update(belief, y, rng=numbers)
    y[1, 2] = 1e4
    absurd = filter.update(belief, y, rng=numbers)
    assert_same(absurd[[0, 2]], ordinary[[0, 2]])
    np.testing.assert_array_equal(absurd.healthy, [True, False, True])


@pytest.mark.parametrize("jump", [60.0, 200.0, 1000.0])
def test_monitors_see_a_jump_when_it_comes(jump: float):
    """As they do behind a Kalman filter; a chance alarm before it: once in a thousand runs."""
    model = LinearModel([[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0]], 0.01 * np.eye(2), [[1.0]])
    prior, rng = Gaussian(np.zeros(2), np.eye(2)), np.random.default_rng(0)
    y = consistency.simulate(model, prior, rng, runs=1, steps=60).y[:, 0]
    y[30:] += jump
    for name in ("pf", "kf"):
        beliefs = run(make(name, model), prior, y, rng=0).updated
        assert beliefs.available.all()
        assert beliefs.healthy[:30].all()
        assert beliefs.healthy[30] == (name == "kf")
        for monitor in (ChiSquareMonitor(1, 3e-5), CusumMonitor(1, 3e-5)):
            assert monitor.run(beliefs).alarm.argmax() == 30


@pytest.mark.slow
def test_fit_finds_the_variance_that_a_glitch_asks_for():
    rng = np.random.default_rng(1)
    y = np.cumsum(0.3 * rng.normal(size=(40, 1)), 0) + 0.5 * rng.normal(size=(40, 1))
    y[20] += 500.0
    exact, found = (
        fit(
            lambda r, name=name: (
                make(name, LinearModel([[1.0]], [[1.0]], [[0.09]], [[r]])),
                _UNIT,
            ),
            {"r": 0.25},
            y,
        )
        for name in ("kf", "pf")
    )
    assert found.estimates["r"] == pytest.approx(exact.estimates["r"], rel=0.02)
    assert exact.estimates["r"] == pytest.approx(500.0**2 / 40.0, rel=0.02)


def test_a_precise_measurement_among_too_few_particles_is_no_absurd_one():
    """Every density is 0 in double precision: the nearest particle is taken."""
    model = LinearModel([[1.0]], [[1.0]], [[1.0]], [[1e-12]])
    filter, numbers = make("pf", model, particles=50), _numbers(0)[0]
    before = filter.init(Gaussian([0.0], [[4.0]]), rng=numbers)
    updated = filter.update(before, [1.5], rng=numbers)
    assert updated.healthy
    nearest = before.particles[np.abs(before.particles[:, 0] - 1.5).argmin()]
    np.testing.assert_allclose(updated.mean, nearest, rtol=1e-9)
    assert updated.effective_size == pytest.approx(1.0)
    assert updated.log_likelihood < -745.0


def test_a_measurement_without_noise_is_left_out_and_a_model_of_one_refused():
    model, R = LinearModel(np.eye(2), np.eye(2), np.eye(2), np.eye(2)), np.diag([1.0, 0.0])
    with pytest.raises(ValueError, match=r"^pf needs noise in every measurement, but R is singul"):
        make("pf", dataclasses.replace(model, R=R))
    filter, numbers = make("pf", model, particles=50), _numbers(0)[0]
    belief = filter.init(Gaussian(np.zeros(2), np.eye(2)), rng=numbers)
    updated = filter.update(belief, [1.0, 1.0], numbers, R=R)
    masked = filter.update(belief, [1.0, 1.0], numbers, available=[True, False])
    assert_same(updated, masked, ignore=["healthy"])
    assert masked.healthy
    assert not updated.healthy


@pytest.mark.filterwarnings("ignore:invalid value", "ignore:divide by zero")
def test_particles_that_leave_the_domain_of_the_model_are_left_behind():
    model = NonlinearModel(lambda x, u: np.sqrt(x), lambda x, u: np.log(x - 0.5), [[1e-4]], [[1.0]])
    filter, numbers = make("pf", model, particles=100), _numbers(0, 1)
    belief = filter.init(Gaussian([[0.5], [-90.0]], [[1.0]]), rng=numbers)
    share = (belief.particles[0] < 0.0).mean()
    assert 0.1 < share < 0.9
    predicted = filter.predict(belief, rng=numbers.at(1))
    updated = filter.update(predicted, [[0.0], [0.0]], rng=numbers.at(1))
    assert (np.exp(predicted.log_weights[0]) == 0.0).mean() == share
    # Nothing is left of the second row, which keeps what it had.
    np.testing.assert_array_equal(predicted.healthy, [True, False])
    np.testing.assert_array_equal(predicted.mean[1], belief.mean[1])
    assert updated.healthy[0]
    np.testing.assert_array_equal(updated.available, [[True], [False]])
    assert not updated.healthy[1]
    for name, array in arrays(updated).items():
        assert np.isfinite(array).all(), name


# --- angles and moments ---------------------------------------------------------------------------


def test_a_heading_that_may_be_on_both_sides_of_the_cut_is_averaged_on_the_circle():
    """Particles a turn apart are one heading: the belief is narrow though turns do not show."""
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


def test_weights_moments_and_likelihood_are_those_of_the_particles():
    system = kalman_system(0)
    model, record = system.model, simulate(system, 0, 2, 2)
    filter, numbers = make("pf", model, particles=30), _numbers(0, 1)
    before = filter.init(system.rows(2), rng=numbers)
    after = filter.update(before, record.y[0], rng=numbers)
    close = {"rtol": 0, "atol": 1e-11}
    for row in range(2):
        one: Belief = after[row]
        off = record.y[0][row] - before.particles[row] @ model.C.T
        logs = multivariate_normal.logpdf(off, np.zeros(model.p), model.R) + before.log_weights[row]
        assert one.log_likelihood == pytest.approx(logsumexp(logs), rel=1e-12)
        np.testing.assert_allclose(one.log_weights, logs - logsumexp(logs), **close)
        weights = np.exp(one.log_weights)
        np.testing.assert_allclose(one.mean, weights @ one.particles, **close)
        cov = np.cov(one.particles.T, aweights=weights, ddof=0)
        np.testing.assert_allclose(one.cov, cov, **close)
