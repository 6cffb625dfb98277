"""The local ensemble filter: tapers, and inflation that adapts."""

import dataclasses

import numpy as np
import pytest
from scipy.linalg import sqrtm
from scipy.optimize import minimize_scalar

from estimators import Belief, Gaussian, LinearModel, RandomKeys, gaspari_cohn, make
from studies.lorenz.benchmarks import LORENZ96, rk4
from tests.estimators.cases import assert_same, kalman_system, random_covariance, simulate, track

SIZES = [(5, 4, 12), (12, 6, 5), (6, 6, 6), (3, 8, 4)]  # members, states, measurements


def _begun(members: int, n: int, p: int, spread: float = 1.0):
    """A linear model with correlated measurements, and beliefs of three rows before one."""
    rng = np.random.default_rng(members)
    model = LinearModel(np.eye(n), rng.normal(size=(p, n)), np.eye(n), random_covariance(rng, p))
    numbers = RandomKeys.seeded(range(3))
    prior = Gaussian(rng.normal(size=(3, n)), spread**2 * random_covariance(rng, n))
    before = make("letkf", model, members=members, draws="independent").init(prior, rng=numbers)
    return model, before, rng.normal(size=(3, p)), numbers


def _textbook(before: Belief, model: LinearModel, R: np.ndarray, y: np.ndarray, factor: float = 1.0) -> np.ndarray:
    """Members of a row after a measurement, by the N x N formulas of Hunt et al. (2007), of scaled anomalies."""
    N = len(before.ensemble)
    A = factor * (before.ensemble - before.ensemble.mean(0))
    Y = A @ model.C.T
    P = np.linalg.inv((N - 1) * np.eye(N) + Y @ np.linalg.inv(R) @ Y.T)
    w = P @ Y @ np.linalg.inv(R) @ (y - before.mean @ model.C.T)
    return before.mean + (w + sqrtm((N - 1) * P).real.T) @ A


# --- localisation -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("members", "n", "p"), SIZES)
def test_each_component_is_updated_with_r_divided_by_its_taper(members: int, n: int, p: int):
    model, before, y, numbers = _begun(members, n, p)
    taper = np.random.default_rng(1).choice([0.0, 0.05, 0.4, 0.9, 1.0], (n, p))
    taper[0], taper[1] = 1.0, 0.0
    after = make("letkf", model, members=members, draws="independent", localisation=taper).update(
        before, y, rng=numbers
    )
    for row in range(3):
        for i in range(n):
            near = taper[i] > 0.0
            root = np.sqrt(taper[i, near])
            own = LinearModel(np.eye(n), model.C[near], np.eye(n), np.eye(near.sum())) if near.any() else None
            expected = before.ensemble[row]
            if own is not None:
                R = model.R[near][:, near] / root / root[:, None]
                expected = _textbook(before[row], own, R, y[row, near])
            np.testing.assert_allclose(after.ensemble[row, :, i], expected[:, i], rtol=0, atol=1e-10)


@pytest.mark.parametrize("members", [5, 40])
def test_without_a_taper_it_is_the_etkf_and_with_a_mask_the_etkf_with_its_groups(members: int):
    system = kalman_system(0, n=6, p=9)
    record = simulate(system, 0, 3, 10)
    available = np.random.default_rng(0).random(record.y.shape) < 0.8
    mask = np.random.default_rng(1).integers(0, 2, (6, 9)).astype(float)
    for localisation in (None, np.ones((6, 9)), mask):
        one, other = (
            track(
                make(
                    name, system.model, members=members, draws="independent", inflation=1.1, rotate=True,
                    localisation=localisation,
                ),
                system.rows(3), record, RandomKeys.seeded(range(3)), available,
            )
            for name in ("etkf", "letkf")
        )  # fmt: skip
        for left, right in zip(one, other, strict=True):
            assert_same(left, right)


def test_the_taper_is_that_of_gaspari_and_cohn():
    """Eq. 4.10: the convolution of a triangle with itself over a sphere; here its printed polynomials, at points."""
    radius = 3.0
    inside, outside = np.linspace(0.0, 1.0, 11), np.linspace(1.0, 2.0, 11)
    near = -(inside**5) / 4 + inside**4 / 2 + 5 * inside**3 / 8 - 5 * inside**2 / 3 + 1
    far = outside**5 / 12 - outside**4 / 2 + 5 * outside**3 / 8 + 5 * outside**2 / 3 - 5 * outside + 4 - 2 / outside / 3
    np.testing.assert_allclose(gaspari_cohn(radius * inside, radius), near, rtol=0, atol=1e-14)
    np.testing.assert_allclose(gaspari_cohn(-radius * outside, radius), far, rtol=0, atol=1e-14)
    taper = gaspari_cohn(np.linspace(0.0, 10.0, 10_001), radius)
    assert taper[0] == 1.0
    assert (np.diff(taper) <= 0.0).all()
    assert (taper[6001:] == 0.0).all()
    like = np.exp(-0.5 * (np.linspace(0.0, 10.0, 10_001) / radius) ** 2 / 0.3)
    assert np.abs(taper - like).max() < 0.05
    distance = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    assert np.linalg.eigvalsh(gaspari_cohn(distance, 7.0))[0] > -1e-12  # a correlation: positive semidefinite
    for wrong in (0.0, -1.0, np.nan, "far"):
        with pytest.raises(ValueError, match=r"^radius must be a positive number"):
            gaspari_cohn(1.0, wrong)
    with pytest.raises(ValueError, match="distance must be numbers, got NaN"):
        gaspari_cohn([0.0, np.nan], 1.0)
    assert gaspari_cohn(np.inf, 1.0) == 0.0


# --- inflation that adapts --------------------------------------------------------------------------


def _asked_for(before: Belief, model: LinearModel, y: np.ndarray, certainty: float) -> float:
    """The inflation of a row: the least of the dual cost of Bocquet et al. (2015), by a general minimiser."""
    N = len(before.ensemble)
    A = before.ensemble - before.ensemble.mean(0)
    Y, e = A @ model.C.T, y - before.mean @ model.C.T
    R = np.linalg.inv(model.R)
    told = np.trace(np.linalg.inv(np.eye(N) + Y @ R @ Y.T / (N - 1))) / N
    a, b = (N + 1) / N, N / (N - 1)
    mode = (a / b) ** (0.5 * told)

    def cost(log_l: float) -> float:
        square = np.exp(2.0 * log_l)
        S = square * Y.T @ Y + (N - 1) * model.R
        return e @ np.linalg.solve(S, e) + certainty * (a / mode / square + b * mode * np.log(square))

    return float(
        np.exp(minimize_scalar(cost, bounds=(-np.log(10.0), np.log(10.0)), method="bounded", options={"xatol": 1e-9}).x)
    )


@pytest.mark.parametrize("certainty", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("members", "n", "p"), SIZES)
def test_the_inflation_is_the_least_of_the_finite_size_filters_cost(members: int, n: int, p: int, certainty: float):
    model, before, y, numbers = _begun(members, n, p, spread=0.5)
    filter = make("letkf", model, members=members, draws="independent", adaptive=certainty)
    after, factors = filter.update(before, y, rng=numbers), []
    for row in range(3):
        factor = _asked_for(before[row], model, y[row], certainty)
        factors.append(factor)
        expected = _textbook(before[row], model, model.R, y[row], factor)
        np.testing.assert_allclose(after.ensemble[row], expected, rtol=0, atol=1e-6)
    assert max(factors) > 1.05


def test_it_inflates_where_measurements_ask_for_it_and_not_without_a_measurement():
    model, before, y, numbers = _begun(8, 4, 6)
    plain, adaptive = (make("letkf", model, members=8, draws="independent", adaptive=c) for c in (None, 1.0))
    mean = before.mean @ model.C.T
    spread = [np.trace(adaptive.update(before, mean + far * (y - mean), rng=numbers).cov[0]) for far in (0, 3, 9, 1e6)]
    assert (np.diff(spread) > 0.0).all()
    usual = np.trace(plain.update(before, y, rng=numbers).cov[0])
    assert spread[0] < usual < spread[1]
    assert spread[-1] < 100.0 * usual  # an absurd measurement does not inflate without bounds
    nothing = adaptive.update(before, np.full((3, 6), np.nan), rng=numbers)
    np.testing.assert_allclose(nothing.ensemble, before.ensemble, rtol=0, atol=1e-13)


def _errors(steps: int, runs: int = 6, burn_in: int = 100, cycles: int = 150, **options: object) -> float:
    """Median over runs of the analysis RMSE on Lorenz-96, with so many steps between measurements."""
    world, chance = np.random.default_rng([3, 0]), np.random.default_rng([3, 1])
    setting = dataclasses.replace(LORENZ96, steps=steps)
    model, total = setting.model(), np.zeros(runs)
    filter = make("letkf", model, draws="independent", rotate=True, **options)
    truth = rk4(setting.derivative, 8.0 + world.standard_normal((runs, 40)), 0.05, 200)
    belief = filter.init(Gaussian(truth, 0.001 * np.eye(40)), rng=chance)
    for k in range(burn_in + cycles):
        truth = model.transition(truth, None)
        y = truth + world.standard_normal(truth.shape)
        belief = filter.update(filter.predict(belief, rng=chance), y, rng=chance)
        if k >= burn_in:
            total += np.sqrt(((belief.mean - truth) ** 2).mean(-1)) / cycles
    return float(np.median(total))


@pytest.mark.nightly
def test_it_finds_the_inflation_that_the_truth_needs():
    """The longer the time between measurements, the more: the best of a range of factors are 1.02, 1.08 and 1.5.

    What adapts is within 1.4 times the error of the best each time (1.3, 1.05 and 0.84 on other seeds), which none of
    the factors is within 1.8 times.
    """
    factors, worst = (1.02, 1.04, 1.08, 1.15, 1.3, 1.5), np.zeros(7)
    for steps in (1, 3, 5):
        errors = [_errors(steps, members=20, inflation=factor) for factor in factors]
        errors.append(_errors(steps, members=20, adaptive=1.0))
        worst = np.maximum(worst, np.array(errors) / min(errors[:-1]))
    assert worst[-1] < 1.4
    assert (worst[:-1] > 1.8).all()


@pytest.mark.slow
def test_a_few_members_follow_forty_states_by_measurements_near_each():
    ring = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    taper = gaspari_cohn(np.minimum(ring, 40 - ring), 7.3)
    local = _errors(1, members=7, inflation=1.04, localisation=taper)
    assert local < 0.25
    assert _errors(1, members=7, inflation=1.04) > 2.0  # without it the truth is lost: knowing nothing, it is 3.6
    assert _errors(1, members=7, localisation=taper, adaptive=2.0) < 0.3  # with no factor to be told
