"""Whole series: the beliefs of a loop by hand, and likelihoods by other roads."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from estimators import (
    Delayed,
    Gaussian,
    LinearModel,
    NonlinearModel,
    RandomKeys,
    make,
    names,
    nis,
    run,
    sampled,
    zero_order_hold,
)
from tests.estimators.batch import least_squares
from tests.estimators.cases import (
    Case,
    assert_close,
    assert_same,
    by_age,
    every_case,
    gaps,
    kalman_system,
    observable_directions,
    one_of_each,
    simulate,
    track,
    unknown_input_system,
)

# --- a run is the loop ----------------------------------------------------------------------------


@one_of_each()
def test_a_run_is_the_loop_by_hand(case: Case):
    """With gaps, masks, and noises of its own measurements."""
    system, keys = case.system(0), RandomKeys.seeded([1, 2, 3])
    record, filter = simulate(system, 1, runs=3, steps=8), case.make(system.model)
    record = record._replace(y=gaps(record.y))
    available = np.random.default_rng(1).random(record.y.shape) < 0.9
    R = np.linspace(1.0, 2.0, 8)[:, None, None, None] * np.eye(system.model.p)
    given = {"u": record.u, "available": available, "R": R}
    series = run(filter, system.prior, record.y, rng=keys, **given)
    for k, belief in enumerate(track(filter, system.rows(3), record, keys, available, R)):
        assert_same(series.updated[k].replace(u=None), belief.replace(u=None))
    given = {name: values[:, min(1, values.shape[1] - 1)] for name, values in given.items()}
    one = run(filter, system.prior, record.y[:, 1], rng=keys[1], **given)
    assert_close(one.mean, series.mean[:, 1], 1e-12)
    size = np.abs(series.log_likelihoods).sum()
    assert one.log_likelihood == pytest.approx(series.log_likelihood[1], abs=1e-9 * size)


def test_a_seed_gives_each_row_numbers_of_its_own():
    filter = make("enkf", LinearModel(*4 * [[[1.0]]]), draws="independent")
    first, again, other = (
        run(filter, Gaussian([0.0], [[1.0]]), np.ones((4, 2, 1)), rng=seed).mean
        for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert (np.abs([first[:, 0] - first[:, 1], (first - other)[:, 0]]) > 1e-9).all()


# --- the likelihood -------------------------------------------------------------------------------


@every_case("kalman")
def test_the_likelihood_is_the_density_of_all_measurements(case: Case):
    system = case.system(0)
    record = simulate(system, 0, runs=3, steps=25)
    y = gaps(record.y)
    y[7] = np.nan
    series = run(case.make(system.model), system.prior, y, u=record.u)
    expected = [least_squares(system, y[:, i], record.u[:, i]).log_likelihood for i in range(3)]
    np.testing.assert_allclose(series.log_likelihood, expected, rtol=1e-9)
    np.testing.assert_array_equal(series.log_likelihoods[7], 0.0)


@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf", "ulise"])
@pytest.mark.parametrize("q", [1, 2])
def test_the_likelihood_with_an_unknown_input_is_diffuse(name: str, q: int):
    """Diffuse: the density of all measurements, integrated over all inputs alike."""
    feedthrough = name != "kf-umv-ui-wdf"
    rank = 1 if name == "ulise" else None
    system = unknown_input_system(2, feedthrough, p=4, q=q, rank=rank)
    record = simulate(system, 1, runs=2, steps=20)
    y = record.y.copy()
    y[5, :, 0] = np.nan  # the others show the input, too
    series = run(make(name, system.model, input_prior=50.0), system.prior, y, u=record.u)
    unseen = np.eye(q) - observable_directions(
        system.model.H
    )  # of the last input nothing shows there; told, it counts for 1
    values, directions = np.linalg.eigh(unseen)
    told = {19: directions[:, values > 0.5].T}
    expected = [
        least_squares(system, y[:, i], record.u[:, i], told).log_likelihood for i in range(2)
    ]
    np.testing.assert_allclose(series.log_likelihood, expected, rtol=1e-9)


REDUNDANT = [(name, 0.0) for name in names() if name != "pf"]


@pytest.mark.parametrize(
    ("name", "noise"), [*REDUNDANT, ("kf", 1.0), ("ukf", 1.0), ("enkf", 1.0), ("kf-umv-ui", 1.0)]
)
def test_channels_that_follow_from_others_change_nothing(name: str, noise: float):
    """Twice a channel, a sum of two, and one in other units; a contradiction has likelihood 0."""
    M = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [1.0, 1.0], [0.0, 3.0]])
    unknown = name.startswith(("kf-umv", "ekf-ui", "ukf-umv", "ulise"))
    system = unknown_input_system(0, name == "kf-umv-ui", p=2) if unknown else kalman_system(0, p=2)
    m, u, y = system.model, np.zeros((12, 2)), np.random.default_rng(0).normal(size=(12, 2))
    H, R = None if m.H is None else M @ m.H, noise * m.R
    few = make(name, replace(m, R=R))
    many = make(name, replace(m, C=M @ m.C, R=M @ R @ M.T, H=H))
    y_many = y @ M.T
    y_many[4, 1], y_many[5, [0, 4]], y_many[6], y[6] = np.nan, np.nan, np.nan, np.nan
    one, both = run(few, system.prior, y, u=u, rng=0), run(many, system.prior, y_many, u=u, rng=0)
    sizes = [nis(each.updated.innovation, each.updated.innovation_cov) for each in (one, both)]
    np.testing.assert_allclose(both.mean, one.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(both.cov, one.cov, rtol=0, atol=1e-9)
    np.testing.assert_allclose(sizes[1], sizes[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(both.log_likelihoods, one.log_likelihoods, rtol=1e-9, atol=1e-9)
    y_many[9, 3] += 0.1
    wrong = run(many, system.prior, y_many, u=u, rng=0)
    assert np.flatnonzero(np.isneginf(wrong.log_likelihoods)).tolist() == [9]
    assert np.isinf(nis(wrong.updated.innovation, wrong.updated.innovation_cov)[9])


@pytest.mark.parametrize("turned", [[[1.0, 0.3], [0.2, 1.0]], [[1.0, 1.0], [0.0, 1.0]]])
@pytest.mark.parametrize("name", ["kf", "ukf"])
def test_the_likelihood_of_an_exact_state_follows_the_units(name: str, turned: list[list[float]]):
    """A position without noise and a noisy speed: 42 densities, as two positions tell both."""
    T, y = (
        np.array(turned),
        np.stack([3.0 + 0.07 * np.arange(40), np.random.default_rng(0).normal(0.7, 0.1, 40)], -1),
    )
    back = np.linalg.inv(T)
    share = 100.0 / 100.01  # of the first speed in its estimate
    expected = norm.logpdf(3.0, 0.0, 10.0) + norm.logpdf(y[0, 1], 0.0, np.sqrt(100.01))
    expected += (
        norm.logpdf(0.07, 0.1 * share * y[0, 1], 0.01 * np.sqrt(share))
        + norm.logpdf(y[1:, 1], 0.7, 0.1).sum()
    )
    for s in (1e-6, 1.0, 1e3, 1e6):
        model = LinearModel(
            T @ [[1.0, 0.1], [0.0, 1.0]] @ back, back, np.zeros((2, 2)), np.diag([0.0, 0.01 * s**2])
        )
        series = run(make(name, model), Gaussian([0.0, 0.0], 100.0 * s**2 * T @ T.T), s * y, rng=0)
        assert series.log_likelihood == pytest.approx(expected - 42.0 * np.log(s), abs=1e-6)
        assert nis(series.updated.innovation, series.updated.innovation_cov, s).max() < 9.0


def test_a_large_state_leaves_the_likelihood_of_other_channels():
    y = np.random.default_rng(1).normal([0.0, 1e-6], [1.0, 1e-7], (30, 2))
    kf = make("kf", LinearModel(np.eye(2), np.eye(2), np.zeros((2, 2)), np.diag([1.0, 1e-14])))
    alone, large = (
        run(kf, Gaussian([size, 0.0], np.diag([1.0, 1e-12])), y + [size, 0.0]).log_likelihood
        for size in (0.0, 1e9)
    )
    assert large == pytest.approx(alone, abs=1e-5)


@pytest.mark.parametrize("name", ["kf-umv-ui-wdf", "ukf-umv", "ulise"])
def test_exact_measurements_have_the_limit_of_the_likelihood(name: str):
    """Where the input is the only thing that can explain a measurement."""
    A, G = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.0], [1.0]])
    rng, x = np.random.default_rng(0), np.zeros((20, 2))
    for k in range(1, 20):
        x[k] = A @ x[k - 1] + G[:, 0] * rng.normal() + [0.1 * rng.normal(), 0.0]
    found = []
    for R in (0.0, 1e-9):
        model = LinearModel(A, np.eye(2), np.diag([0.01, 0.0]), R * np.eye(2), G=G)
        found.append(run(make(name, model), Gaussian([0.0, 0.0], np.eye(2)), x).log_likelihood)
    assert found[0] == pytest.approx(found[1], abs=1e-3)


# --- times ----------------------------------------------------------------------------------------


def _drifting() -> LinearModel:
    return sampled(
        [[-0.3, 1.0], [0.0, -0.1]], [[1.0, 0.0]], np.diag([0.01, 0.2]), [[0.1]], B=[[0.0], [1.0]]
    )


def test_irregular_times_are_regular_ones_with_gaps():
    """Times on a grid with nothing read between: control held, noise gathered."""
    rng, times = np.random.default_rng(0), np.arange(61.0) / 4.0
    some = np.append(0, np.sort(rng.choice(np.arange(1, 60), 25, replace=False)))
    y, u = np.full((61, 4, 1), np.nan), np.zeros((61, 1))
    y[some] = rng.normal(size=(26, 4, 1))
    for k in some:
        u[k:] = rng.normal()  # held from measurement to measurement
    kf, prior = make("kf", _drifting()), Gaussian([1.0, 0.0], np.eye(2))
    grid = run(kf, prior, y, u=u, t=times)
    sparse = run(kf, prior, y[some], u=u[some], t=times[some])
    assert_close(sparse.mean, grid.mean[some], 1e-12)
    assert_close(sparse.cov, grid.cov[some], 1e-12)
    np.testing.assert_allclose(sparse.log_likelihood, grid.log_likelihood, rtol=1e-10)


def test_a_sampled_model_has_the_step_of_each_row():
    model, lengths = _drifting(), np.array([0.7, 0.2, 0.7, 0.0])
    u = np.stack([np.ones(4), lengths], -1)
    for i, dt in enumerate(lengths):
        A, B = zero_order_hold([[-0.3, 1.0], [0.0, -0.1]], [[0.0], [1.0]], dt)
        for found in (model.A(u)[i], model.A(u[i])):
            np.testing.assert_allclose(found, A, rtol=1e-13)
        np.testing.assert_allclose(model.B(u)[i], np.pad(B, ((0, 0), (0, 1))), rtol=0, atol=1e-14)
    np.testing.assert_allclose(model.Q(u)[3], 0.0, atol=1e-15)


@pytest.mark.parametrize("length", [0.01, 30.0, 1e5])
def test_noise_over_a_long_step_is_that_of_two_halves(length: float):
    """However long against the fastest decay, which the exponential of -A would overflow at."""
    model = sampled([[-10.0, 0.0], [1.0, -0.01]], [[0.0, 1.0]], np.diag([20.0, 0.1]), [[0.1]])
    half, whole = np.array([length]), np.array([2.0 * length])
    A, Q = model.A(half), model.Q(half)
    np.testing.assert_allclose(model.Q(whole), A @ Q @ A.T + Q, rtol=1e-9)
    np.testing.assert_allclose(model.A(whole), A @ A, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(model)).Q(whole), model.Q(whole))


def test_masked_measurements_and_none_are_missing_ones():
    masked = np.ma.masked_greater([[1.0, 99.0], [1.0, 2.0]], 50.0)
    kf = make("kf", LinearModel([[1.0]], [[1.0], [1.0]], [[0.1]], np.eye(2)))
    for y in (masked, list(masked), [[1.0, None], [1, 2]]):
        series = run(kf, Gaussian([0.0], [[1.0]]), y)
        np.testing.assert_allclose(series.mean[:, 0], [0.5, 23 / 22], rtol=1e-12)


# --- continuing, and the input of a measurement ---------------------------------------------------


@pytest.mark.parametrize("wrapped", [False, True], ids=["", "delayed"])
@one_of_each()
def test_a_continued_series_is_the_whole_series(case: Case, wrapped: bool):
    system, K = case.system(0), 4
    record, filter = simulate(system, 1, runs=2, steps=7), case.make(system.model)
    y, u = gaps(record.y), record.u
    if wrapped:
        y, filter = by_age(y, np.array([0, 1, 2, 0, 1, 0, 0])[:, None, None]), Delayed(filter, 3)
    whole = run(filter, system.prior, y, u=u, rng=3)
    before = run(filter, system.prior, y[:K], u=u[:K], rng=3)
    for start in [before.last] if wrapped else [before.last, before.updated[-1]]:
        after = run(filter, start, y[K:], u=u[K - 1 :], rng=3, first=K)
        assert_same(after.updated, whole.updated[K:])
        assert_same(before.updated, whole.updated[:K])
        np.testing.assert_array_equal(after.predicted.mean, whole.predicted.mean[K:])
        if not wrapped:
            np.testing.assert_array_equal(after.log_likelihoods, whole.log_likelihoods[K:])


def test_a_series_continues_over_steps_of_any_length():
    """Measurement and R may be functions of the input and of the step that led there."""
    rng, K = np.random.default_rng(2), 5
    t, (y, u) = np.cumsum(rng.exponential(size=9)), rng.normal(size=(2, 9, 2, 1))
    curved = NonlinearModel(
        lambda x, u: x * np.exp(-u[..., 1:]), lambda x, u: np.tanh(x) + u[..., :1] * u[..., 1:],
        [[0.1]], lambda u: 0.1 * (1.0 + u[..., 1:, None]), measurements=1,
    )  # fmt: skip
    ekf, prior = make("ekf", curved), Gaussian([1.0], [[1.0]])
    whole, before = (run(ekf, prior, y[:k], u=u[:k], t=t[:k]) for k in (9, K))
    after = run(ekf, before.last, y[K:], u=u[K - 1 :], t=t[K - 1 :])
    np.testing.assert_array_equal(np.concatenate([before.mean, after.mean]), whole.mean)
    first = ekf.update(ekf.init(prior), y[0, 0], u=[u[0, 0, 0], 0.0])
    np.testing.assert_allclose(whole.mean[0, 0], first.mean, rtol=1e-12)


@pytest.mark.parametrize("name", ["ekf", "etkf", "pf", "kf-umv-ui"])
@pytest.mark.parametrize("delayed", [False, True], ids=["", "delayed"])
def test_a_measurement_gets_the_known_input_of_its_own_time(name: str, delayed: bool):
    """Measurements of ``C x + D u`` are those of ``C x`` with the ``D u`` of the same time off."""
    system = unknown_input_system(0, True) if name == "kf-umv-ui" else kalman_system(0)
    m, options = system.model, {"members": 10} if name == "etkf" else {}
    shown = np.array([[3.0, 0.0], [0.0, -2.0], [1.0, 1.0]])
    lifted = NonlinearModel(
        m.transition, lambda x, u: m.measurement(x, u) + np.matvec(shown, u), m.Q, m.R, G=m.G, H=m.H,
        transition_jacobian=lambda x, u: m.A, measurement_jacobian=lambda x, u: m.C,
    )  # fmt: skip
    record = simulate(system, 1, runs=2, steps=6)
    means = []
    for model, y in ((lifted, record.y + np.matvec(shown, record.u)), (m, record.y)):
        filter = make(name, model, **options)
        if delayed:
            filter, y = Delayed(filter, 1), y[..., None, :]
        means.append(run(filter, system.prior, y, u=record.u, rng=0).mean)
    np.testing.assert_allclose(means[0], means[1], rtol=0, atol=1e-9 * np.abs(means[1]).max())


# --- what does not fit ----------------------------------------------------------------------------

_MODEL = LinearModel(np.eye(2), [[1.0, 0.0]], np.eye(2), [[1.0]])
_PRIOR = Gaussian(np.zeros(2), np.eye(2))
_KF = make("kf", sampled(-np.eye(2), [[1.0, 0.0]], np.eye(2), [[1.0]]))
_ETKF = make("etkf", _MODEL)
_AFTER = run(_ETKF, _PRIOR, np.zeros((1, 1)), rng=0).last


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"y": np.zeros(5)}, r"y has shape \(5,\).* one channel has y\[:, None\]"),
        ({"y": np.zeros((0, 1))}, r"y has no measurements \(shape \(0, 1\)\): a series needs at"),
        ({"y": []}, r"y has no measurements \(shape \(0,\)\): a series needs at least one$"),
        ({"u": np.zeros((4, 1))}, r"u has shape .*expected \(5, ...\): one for each measurement"),
        ({"t": [0.0, 1.0, 0.5, 2.0, 3.0], "filter": _KF}, "t must be finite and not go back: sort"),
        ({"t": np.arange(5.0)}, "this model is the same however long a step takes"),
        ({"filter": _KF}, "give run the times t"),
        ({"prior": Gaussian(np.zeros((3, 2)), np.eye(2))}, r"prior's mean has shape \(3, 2\), expected \(2,\)"),
        ({"prior": make("kf", _MODEL).init(Gaussian(np.zeros((2, 2)), np.eye(2)))},
         r"the belief has rows \(2,\), y has \(\)"),
        ({"prior": _AFTER, "filter": _ETKF, "rng": 0}, "first must be how many measurements came"),
    ],
)  # fmt: skip
def test_what_does_not_fit_gets_one_sentence(changes: dict, sentence: str):
    given = {"filter": make("kf", _MODEL), "prior": _PRIOR, "y": np.zeros((5, 1))} | changes
    with pytest.raises(ValueError, match=sentence):
        run(**given)
