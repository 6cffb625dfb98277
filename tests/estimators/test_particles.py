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
    RandomKeys,
    consistency,
    make,
    run,
    wrap,
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


def _repeated(seed: int, steps: int, runs: int) -> tuple[System, Record, Record, RandomKeys]:
    """A system, a record, the same in many rows, and random numbers of each."""
    system = kalman_system(0 if steps > 4 else 2, n=2, p=1)
    record = simulate(system, seed, 1, steps)
    same = record._replace(y=np.repeat(record.y, runs, 1), u=np.repeat(record.u, runs, 1))
    return system, record, same, _numbers(*range(runs))


def test_errors_of_moments_and_likelihood_have_mean_zero():
    """The mean error over filters with numbers of their own is 0.

    The average of the filters has a standard error that their scatter tells. Five of these are a
    false alarm once in 5e4 tests, if a bias of order 1 / N is left room: 10 / N of the spread.
    """
    runs, N = 60, 2000
    (system, record, same, numbers), available = _repeated(3, 12, runs), np.arange(12) != 3
    available = available[:, None, None]
    filter, masks = make("pf", system.model, particles=N), np.repeat(available, runs, 1)
    beliefs = track(filter, system.rows(runs), same, numbers, masks)
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
    runs, steps = 4000, 4
    system, record, same, numbers = _repeated(5, steps, runs)
    exact = sum(density for *_, density in _exact(system, record, np.ones((steps, 1, 1), bool)))
    filter = make("pf", system.model, particles=20, threshold=threshold)
    error = sum(b.log_likelihood for b in track(filter, system.rows(runs), same, numbers)) - exact
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
def test_systematic_resampling_copies_by_weight_within_one(seed: int, N: int, offset: float):
    weights = np.random.default_rng(seed).dirichlet(np.full(N, 0.2), 3)
    chosen = systematic(weights, np.full(3, offset))
    assert chosen.shape == (3, N)
    assert (np.diff(chosen) >= 0).all()
    counts = (chosen[..., None] == np.arange(N)).sum(1)
    assert (np.abs(counts - N * weights) < 1.0 + 1e-9).all()


def test_systematic_resampling_is_unbiased():
    weights = np.array([0.05, 0.4, 0.0, 0.31, 0.24])
    offsets = (np.arange(10_000) + 0.5) / 10_000
    chosen = systematic(np.tile(weights, (10_000, 1)), offsets)
    counts = np.bincount(chosen.ravel()) / 10_000
    np.testing.assert_allclose(counts, 5.0 * weights, rtol=0, atol=2e-4)


def test_particles_are_resampled_where_few_count():
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
        expected = np.where(few[:, None], -np.log(100.0), updated.log_weights)
        np.testing.assert_allclose(weights, expected, rtol=0, atol=1e-12)
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


def test_a_precise_measurement_takes_the_nearest_particle():
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


def test_a_measurement_without_noise_is_left_out_or_refused():
    model, R = LinearModel(*4 * [np.eye(2)]), np.diag([1.0, 0.0])
    with pytest.raises(ValueError, match=r"^pf needs noise in every measurement, but R is singul"):
        make("pf", dataclasses.replace(model, R=R))
    filter, numbers = make("pf", model, particles=50), _numbers(0)[0]
    belief = filter.init(Gaussian(np.zeros(2), np.eye(2)), rng=numbers)
    updated = filter.update(belief, [1.0, 1.0], numbers, R=R)
    masked = filter.update(belief, [1.0, 1.0], numbers, available=[True, False])
    assert_same(updated, masked, ignore=["healthy"])
    assert masked.healthy != updated.healthy


@pytest.mark.filterwarnings("ignore:invalid value", "ignore:divide by zero")
def test_particles_outside_the_models_domain_are_left_behind():
    """Nothing is left of the second row, which keeps what it had."""
    model = NonlinearModel(lambda x, u: np.sqrt(x), lambda x, u: np.log(x - 0.5), [[1e-4]], [[1.0]])
    filter, numbers = make("pf", model, particles=100), _numbers(0, 1)
    belief = filter.init(Gaussian([[0.5], [-90.0]], [[1.0]]), rng=numbers)
    share = (belief.particles[0] < 0.0).mean()
    assert 0.1 < share < 0.9
    predicted = filter.predict(belief, rng=numbers.at(1))
    updated = filter.update(predicted, [[0.0], [0.0]], rng=numbers.at(1))
    assert (np.exp(predicted.log_weights[0]) == 0.0).mean() == share
    np.testing.assert_array_equal(predicted.mean[1], belief.mean[1])
    for found in (predicted.healthy, updated.healthy, updated.available[:, 0]):
        np.testing.assert_array_equal(found, [True, False])
    for name, array in arrays(updated).items():
        assert np.isfinite(array).all(), name


# --- angles and moments ---------------------------------------------------------------------------


def test_headings_across_the_cut_are_averaged_on_a_circle():
    """Particles a turn apart are one heading: the belief is narrow though turns do not show."""

    def direction(x: np.ndarray, u: None) -> np.ndarray:
        return np.concatenate([np.cos(x), np.sin(x)], -1)

    model = NonlinearModel(lambda x, u: x, direction, [[1e-4]], 1e-2 * np.eye(2), state_angles=(0,))
    filter, numbers = make("pf", model, particles=4000), _numbers(0)[0]
    belief = filter.init(Gaussian([3.0], [[25.0]]), rng=numbers)
    belief = filter.update(belief, [np.cos(3.1), np.sin(3.1)], rng=numbers)
    turns = np.rint((belief.particles[np.exp(belief.log_weights) > 1e-5] - 3.1) / (2.0 * np.pi))
    assert len(np.unique(turns)) > 1
    assert abs(wrap(belief.mean[0] - 3.1)) < 0.02
    assert belief.cov[0, 0] == pytest.approx(1e-2, rel=0.3)


def test_moments_and_likelihood_are_those_of_the_particles():
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
