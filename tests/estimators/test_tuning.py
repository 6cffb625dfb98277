"""`fit` against closed forms, an independent likelihood and its own promise of intervals."""

import numpy as np
import pytest
from scipy.optimize import minimize, minimize_scalar
from scipy.stats import multivariate_normal

from estimators import Filter, Fit, Gaussian, LinearModel, fit, make, run, sampled


def level(q: float, r: float, cov: float = 1e7) -> tuple[Filter, Gaussian]:
    return make("kf", LinearModel([[1.0]], [[1.0]], [[q]], [[r]])), Gaussian([0.0], [[cov]])


def noise(r: float) -> tuple[Filter, Gaussian]:
    return level(0.0, r, 0.0)


def random_walk(seed: int, steps: int, q: float, r: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.cumsum(np.sqrt(q) * rng.normal(size=(steps, 1)), 0) + np.sqrt(r) * rng.normal(
        size=(steps, 1)
    )


# --- closed forms ---------------------------------------------------------------------------------


def test_a_variance_is_the_mean_square_and_its_error_follows():
    """Rows are independent series, and what is missing counts for nothing."""
    rng = np.random.default_rng(0)
    y = 3.0 * rng.normal(size=(40, 5, 1))
    y[rng.random(y.shape) < 0.2] = np.nan
    found, T, variance = fit(noise, {"r": 1.0}, y), np.isfinite(y).sum(), np.nanmean(y**2)
    assert found.estimates["r"] == pytest.approx(variance, rel=1e-6)
    assert found.standard_errors["r"] == pytest.approx(np.sqrt(2.0 / T) * variance, rel=1e-4)
    ends = variance * np.exp(np.array([-1, 1]) * 1.959964 * np.sqrt(2.0 / T))
    assert found.intervals["r"] == pytest.approx(tuple(ends), rel=1e-4)
    assert found.log_likelihood == pytest.approx(-0.5 * T * (np.log(2.0 * np.pi * variance) + 1.0))


@pytest.mark.slow
def test_estimates_and_errors_are_those_of_the_joint_density():
    """At uneven times, with gaps: one Gaussian vector, whose covariance is known."""
    rng = np.random.default_rng(3)
    t = np.sort(rng.uniform(0.0, 30.0, 60))
    walk = np.cumsum(np.sqrt(0.5 * np.diff(t, prepend=t[0])) * rng.normal(size=60))
    y = (walk + 0.8 * rng.normal(size=60))[:, None]
    y[[0, 7, 30]] = np.nan
    seen = np.isfinite(y[:, 0])
    since = t[seen] - t[0]

    def build(q: float, r: float) -> tuple[Filter, Gaussian]:
        return make("kf", sampled([[0.0]], [[1.0]], [[q]], [[r]])), Gaussian([0.0], [[4.0]])

    def minus_log_density(theta: np.ndarray) -> float:
        q, r = np.exp(theta)
        cov = 4.0 + q * np.minimum(since, since[:, None]) + r * np.eye(len(since))
        return -multivariate_normal(np.zeros(len(since)), cov).logpdf(y[seen, 0])

    best = minimize(minus_log_density, np.zeros(2), method="BFGS", options={"gtol": 1e-6})
    found = fit(build, {"q": 1.0, "r": 1.0}, y, t=t)
    np.testing.assert_allclose(np.log(list(found.estimates.values())), best.x, rtol=0, atol=1e-4)
    assert found.log_likelihood == pytest.approx(-best.fun, abs=1e-8)
    steps = 1e-3 * np.eye(2)
    information = [
        [
            sum(s * r * minus_log_density(best.x + s * a + r * b) for s in (1, -1) for r in (1, -1))
            for b in steps
        ]
        for a in steps
    ]
    cov = np.linalg.inv(np.array(information) / 4e-6)
    errors = np.sqrt(np.diagonal(cov))
    relative = [found.standard_errors[name] / found.estimates[name] for name in found.estimates]
    np.testing.assert_allclose(relative, errors, rtol=1e-3)


# --- what measurements cannot tell ----------------------------------------------------------------


def test_two_numbers_of_which_only_the_sum_is_seen_are_named():
    y = random_walk(0, 20, 0.0, 4.0)
    start = {"a": 1.0, "b": 1.0, "p": 1.0}
    found = fit(lambda a, b, p: (noise(a + b)[0], Gaussian([p], [[0.0]])), start, y, signed="p")
    apart = "the measurements cannot tell a and b apart: with a up and b down they are as likely"
    assert found.undetermined == (apart,)
    assert apart in str(found)
    for name in "ab":
        assert found.standard_errors[name] == np.inf
        assert found.intervals[name] == (0.0, np.inf)
    assert found.estimates["a"] + found.estimates["b"] == pytest.approx(y.var(), rel=1e-5)
    assert found.standard_errors["p"] == pytest.approx(np.sqrt(y.var() / 20), rel=1e-3)


def test_numbers_that_are_only_bounded_are_named():
    alternating = 2.0 * (-1.0) ** np.arange(20)[:, None]  # nothing walks there
    found = fit(lambda q, r: level(q, r, 0.0), {"q": 1.0, "r": 1.0}, alternating)
    small = "measurements say of q only that it is small: as likely if it is smaller still"
    assert found.undetermined == (small,)
    assert found.estimates["r"] == pytest.approx(4.0, rel=1e-3)
    assert found.standard_errors["r"] == pytest.approx(np.sqrt(2.0 / 20) * 4.0, rel=1e-3)


# --- other filters --------------------------------------------------------------------------------


def profile(found: Fit, name: str, value: float, y: np.ndarray) -> float:
    """How much less likely another variance is, whatever the other one."""
    other = {"q": "r", "r": "q"}[name]

    def cost(log: float) -> float:
        return -run(*level(**{name: value, other: np.exp(log)}, cov=1.0), y).log_likelihood

    logs = np.log(np.var(y)) + np.linspace(-30.0, 3.0, 12)
    costs = [cost(each) for each in logs]
    ends = logs[max(np.argmin(costs) - 1, 0)], logs[min(np.argmin(costs) + 1, 11)]
    best = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": 0.05}).fun
    return found.log_likelihood + min(best, *costs)


@pytest.mark.nightly
def test_what_is_said_of_a_variance_is_true_of_its_profile():
    rng, said = np.random.default_rng(0), 0
    for _ in range(69):
        q, r, steps = (rng.choice(each) for each in ([0, 1e-4, 1e-2, 1], [1e-4, 1e-2, 1], [20, 50]))
        y = random_walk(rng.integers(1000), steps, q, r)
        found = fit(lambda q, r: level(q, r, 1.0), {"q": 1.0, "r": 1.0}, y)
        assert found.converged
        for sentence in found.undetermined:
            said += 1
            name = sentence.removeprefix("measurements say of ")[0]
            far = 1e-6 * found.estimates[name], 100 * np.var(y)
            less, more = (profile(found, name, value, y) for value in far)
            assert ("only that it is small" in sentence) == (less < 1.5 < more), sentence
            assert ("only its order" in sentence) == (min(less, more) > 0.9), sentence
    assert said


def test_a_mean_may_start_far_below_its_order_of_magnitude():
    """Information is measured in standard errors, not in units of the start."""
    y = 5.0 + 2.0 * np.random.default_rng(1).normal(size=(100, 1))

    def build(m: float) -> tuple[Filter, Gaussian]:
        model = LinearModel([[1.0]], [[1.0]], [[0.0]], [[4.0]])
        return make("kf", model), Gaussian([m], [[0.0]])

    found = fit(build, {"m": 0.01}, y, signed=["m"])
    assert found.undetermined == ()
    assert found.estimates["m"] == pytest.approx(y.mean(), rel=1e-5)
    assert found.standard_errors["m"] == pytest.approx(0.2, rel=1e-3)


def test_a_maximum_that_bends_in_the_small_alone_is_none():
    """Of ripples on the likelihood each has one; the interval is that of the likelihood in the large."""

    def build(r: float) -> tuple[Filter, Gaussian]:
        return noise(r * np.exp(0.01 * np.sin(1000.0 * np.log(r))))

    y = random_walk(0, 20, 0.0, 4.0)
    smooth = np.mean(y**2) * np.exp(np.array([-1, 1]) * 1.959964 * np.sqrt(2.0 / 20))
    assert fit(build, {"r": 4.0}, y).intervals["r"] == pytest.approx(tuple(smooth), rel=0.05)


@pytest.mark.parametrize("unit", [1e-6, 1e9])
@pytest.mark.parametrize("known", [0.0, 1.0])
def test_a_start_in_other_units_finds_the_same(unit: float, known: float):
    """Measurements of this seed have two maxima, the lower one where r is small."""
    y = unit * random_walk(7, 40, 1.0, 4.0)
    start, right = {"q": 1.0, "r": 1.0}, {"q": unit**2, "r": 4.0 * unit**2}
    one, other = (fit(lambda q, r: level(q, r, known), each, y) for each in (start, right))
    assert one.log_likelihood >= other.log_likelihood - 0.02
    assert one.estimates == pytest.approx(other.estimates, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e-6, 1e9])
def test_a_start_without_likelihood_may_be_in_other_units(unit: float):
    """Two sensors of one state agree to the last digit, as seen from far away."""
    rng = np.random.default_rng(0)
    y = unit * (np.cumsum(rng.normal(size=(30, 1)), 0) + 0.5 * rng.normal(size=(30, 2)))

    def build(q: float, r: float) -> tuple[Filter, Gaussian]:
        model = LinearModel([[1.0]], [[1.0], [1.0]], [[q]], r * np.eye(2))
        return make("kf", model), Gaussian([0.0], [[10.0 * unit**2]])

    one, other = (fit(build, dict.fromkeys("qr", r), y).estimates for r in (1.0, unit**2))
    assert one == pytest.approx(other, rel=1e-2)


@pytest.mark.nightly
def test_a_search_leaves_a_plateau():
    """A variance beside a far greater one is as likely with another."""
    y = random_walk(0, 60, 0.2, 4.0)
    near, far = (fit(level, {"q": 1.0, "r": r}, y).estimates for r in (1.0, 1e-6))
    assert far == pytest.approx(near, rel=1e-3)


@pytest.mark.nightly
def test_every_evaluation_has_the_same_random_numbers():
    def build(q: float, r: float) -> tuple[Filter, Gaussian]:
        filter, prior = level(q, r)
        return make("enkf", filter.model, members=100, draws="independent"), prior

    y, start = random_walk(0, 80, 1.0, 4.0), {"q": 1.0, "r": 1.0}
    one, exact = fit(build, start, y, rng=1), fit(level, start, y)
    assert run(one.filter, one.prior, y, rng=1).log_likelihood == one.log_likelihood
    for name, (low, high) in exact.intervals.items():
        assert low < one.estimates[name] < high
    assert one.standard_errors["r"] == pytest.approx(exact.standard_errors["r"], rel=0.3)


def test_a_maximum_at_the_edge_of_what_can_be_built_is_none():
    """A variance below 1 is refused, and the measurements ask for a quarter."""

    def build(r: float) -> tuple[Filter, Gaussian]:
        if r < 1.0:
            raise ValueError("it is too precise")
        return noise(r)

    found = fit(build, {"r": 4.0}, random_walk(0, 20, 0.0, 0.25))
    assert 1.0 <= found.estimates["r"] < 1.01
    assert not found.converged
    assert found.intervals["r"] == (0.0, np.inf)
    assert "did not converge" in str(found)


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            {"start": {"q": "1", "r": 1.0}},
            "start of q must be a positive number, or be .* got '1'$",
        ),
        ({"start": {"q": np.inf, "r": 1.0}, "signed": "q"}, "must be a finite number, got inf$"),
        ({"signed": ["s"]}, "unknown signed parameter 's'.*choose from q, r"),
        ({"y": np.full((10, 1), 1e300)}, "the measurements have no likelihood at the start"),
    ],
)
def test_bad_input_gets_a_sentence(arguments: dict, sentence: str):
    with pytest.raises(ValueError, match=sentence):
        fit(**{"build": level, "start": {"q": 1.0, "r": 1.0}, "y": np.ones((5, 1))} | arguments)


def test_where_no_measurement_came_nothing_is_told():
    found = fit(level, {"q": 1.0, "r": 1.0}, np.full((5, 1), np.nan))
    nothing = "the measurements tell nothing of {}: they are as likely with another"
    assert found.undetermined == (nothing.format("q"), nothing.format("r"))
