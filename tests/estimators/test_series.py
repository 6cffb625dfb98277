"""Whole series: the beliefs of a loop by hand, and likelihoods by other roads."""

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from estimators import (
    Belief,
    Delayed,
    Filter,
    Gaussian,
    LinearModel,
    NonlinearModel,
    RandomKeys,
    by_age,
    discretisation,
    make,
    model_checks,
    models,
    nees,
    nis,
    run,
    sampled,
    zero_order_hold,
)
from tests.estimators.batch import least_squares
from tests.estimators.cases import (
    Case,
    kalman_system,
    observable_directions,
    one_of_each,
    simulate,
    track,
    unknown_input_system,
)


def gaps(y: np.ndarray, seed: int = 0, share: float = 0.2) -> np.ndarray:
    y = y.copy()
    y[np.random.default_rng(seed).random(y.shape) < share] = np.nan
    return y


# --- a run is the loop ----------------------------------------------------------------------------


@one_of_each()
def test_a_run_is_the_loop_by_hand(case: Case):
    system = case.system(0)
    record = simulate(system, 1, runs=3, steps=8)
    record = record._replace(y=gaps(record.y))
    filter, keys = case.make(system.model), RandomKeys.seeded([1, 2, 3])
    series = run(filter, system.prior, record.y, u=record.u, rng=keys)
    by_hand = track(filter, system.rows(3), record, rng=keys)
    for name in ("mean", "cov", "input_mean", "innovation", "ensemble"):
        wanted = [getattr(belief, name) for belief in by_hand]
        if wanted[0] is not None:
            np.testing.assert_array_equal(getattr(series.updated, name), np.array(wanted))
    assert len(series) == 8
    one = run(filter, system.prior, record.y[:, 1], u=record.u[:, 1], rng=RandomKeys(keys.keys[1]))
    np.testing.assert_allclose(
        one.mean, series.mean[:, 1], rtol=0, atol=1e-12 * np.abs(series.mean).max()
    )
    np.testing.assert_allclose(
        one.log_likelihood,
        series.log_likelihood[1],
        rtol=0,
        atol=1e-9 * np.abs(series.log_likelihoods).sum(),
    )


def test_a_seed_gives_every_row_numbers_of_its_own_and_the_same_ones_again():
    system = kalman_system(0)
    filter, y = make("enkf", system.model, draws="independent"), np.zeros((4, 2, 3))
    u = np.zeros((4, 2, 2))
    first, again, other = (run(filter, system.prior, y, u=u, rng=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.mean, again.mean)
    assert np.abs(first.mean[:, 0] - first.mean[:, 1]).min() > 0.0
    assert np.abs(first.mean - other.mean).min() > 0.0


# --- the likelihood -------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(2))
def test_the_likelihood_is_the_density_of_all_measurements_together_whatever_is_missing(seed: int):
    system = kalman_system(seed)
    record = simulate(system, seed, runs=3, steps=25)
    y = gaps(record.y, seed)
    y[7] = np.nan
    series = run(make("kf", system.model), system.prior, y, u=record.u)
    expected = [least_squares(system, y[:, i], record.u[:, i]).log_likelihood for i in range(3)]
    np.testing.assert_allclose(series.log_likelihood, expected, rtol=1e-9)
    np.testing.assert_array_equal(series.log_likelihoods[7], 0.0)


@pytest.mark.parametrize("name", ["ekf", "ukf", "huber-kf", "robust-kf"])
def test_filters_that_are_the_kalman_filter_have_its_likelihood(name: str):
    system = kalman_system(0)
    record = simulate(system, 0, runs=2, steps=20)
    options = {"huber-kf": {"gamma": np.inf}, "robust-kf": {"radius": 0.0}}.get(name, {})
    series = [
        run(make(n, system.model, **o), system.prior, record.y, u=record.u)
        for n, o in (("kf", {}), (name, options))
    ]
    np.testing.assert_allclose(series[1].log_likelihood, series[0].log_likelihood, rtol=1e-9)


@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf", "ulise"])
@pytest.mark.parametrize("q", [1, 2])
def test_the_likelihood_with_an_unknown_input_is_that_of_a_prior_without_end(name: str, q: int):
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


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize(
    "name", ["kf", "ekf", "ukf", "iekf", "enkf", "kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf"]
)
def test_channels_that_follow_from_others_change_nothing_and_contradict_with_likelihood_0(
    name: str, noise: float
):
    """Twice a channel, a sum of two, and one in other units; a copy stands in for what is missing."""
    M, rng = (
        np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [1.0, 1.0], [0.0, 3.0]]),
        np.random.default_rng(0),
    )
    A, Q, prior = (
        [[1.0, 0.2, 0.0], [0.0, 0.9, 0.1], [0.1, 0.0, 0.8]],
        np.diag([0.1, 0.2, 0.3]),
        np.eye(3),
    )
    C, R, y = (
        rng.normal(size=(2, 3)),
        noise * np.array([[1.0, 0.2], [0.2, 2.0]]),
        rng.normal(size=(12, 2)),
    )
    G, H = [[1.0], [0.0], [0.5]], np.array([[1.0], [0.3]]) * (name == "kf-umv-ui")
    unknown = "u" in name.replace("ukf", "")
    few, many = (
        make(
            name, LinearModel(A, m @ C, Q, m @ R @ m.T, **({"G": G, "H": m @ H} if unknown else {}))
        )
        for m in (np.eye(2), M)
    )
    y_many = y @ M.T
    y_many[4, 1], y_many[5, [0, 4]], y_many[6], y[6] = np.nan, np.nan, np.nan, np.nan
    one, both = (
        run(few, Gaussian([0.0] * 3, prior), y, rng=0),
        run(many, Gaussian([0.0] * 3, prior), y_many, rng=0),
    )
    sizes = [nis(each.updated.innovation, each.updated.innovation_cov) for each in (one, both)]
    np.testing.assert_allclose(both.mean, one.mean, rtol=0, atol=1e-10)
    np.testing.assert_allclose(sizes[1], sizes[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(both.log_likelihoods, one.log_likelihoods, rtol=1e-9, atol=1e-9)
    y_many[9, 3] += 0.1
    wrong = run(many, Gaussian([0.0] * 3, prior), y_many, rng=0)
    assert np.flatnonzero(np.isneginf(wrong.log_likelihoods)).tolist() == [9]
    assert np.isinf(nis(wrong.updated.innovation, wrong.updated.innovation_cov)[9])


@pytest.mark.parametrize("unit", [0.7, 1e-6, 1e6])
def test_a_constant_that_is_seen_exactly_is_seen_again_or_contradicted(unit: float):
    series = run(make("kf", LinearModel([[1.0]], [[0.7]], [[0.0]], [[0.0]])), Gaussian([0.0], [[unit**2]]),
                 unit * np.array([[1.0], [1.0], [5.0]]))  # fmt: skip
    np.testing.assert_array_equal(series.log_likelihoods[1:], [0.0, -np.inf])


@pytest.mark.parametrize("turned", [np.eye(2), [[1.0, 0.3], [0.2, 1.0]], [[1.0, 1.0], [0.0, 1.0]]])
@pytest.mark.parametrize("name", ["kf", "ekf", "ukf", "iekf"])
def test_the_likelihood_of_a_state_that_is_known_exactly_follows_the_units(
    name: str, turned: list[list[float]]
):
    """Of a position without noise and a noisy speed: 42 densities, for two positions tell both states."""
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


@pytest.mark.parametrize("variance", [1.0, 1e12])
def test_a_vague_prior_beside_an_exact_measurement_does_not_pass_for_known(variance: float):
    y = np.stack([np.full(30, 0.7), np.random.default_rng(1).normal(3.0, 0.03, 30)], -1)
    model = LinearModel(np.eye(2), np.eye(2), np.zeros((2, 2)), np.diag([0.0, 1e-3]))
    series = run(make("kf", model), Gaussian([0.0, 0.0], variance * np.eye(2)), y)
    weight = 30.0 / (30.0 + 1e-3 / variance)
    np.testing.assert_allclose(series.mean[-1], [0.7, weight * y[:, 1].mean()], rtol=1e-9)
    np.testing.assert_allclose(
        series.cov[-1], np.diag([0.0, 1.0 / (3e4 + 1.0 / variance)]), rtol=1e-9
    )


@pytest.mark.parametrize("name", ["kf", "ekf", "ukf", "enkf"])
def test_a_large_state_takes_no_other_channel_out_of_the_likelihood(name: str):
    y = np.random.default_rng(1).normal([0.0, 1e-6], [1.0, 1e-7], (30, 2))
    model = LinearModel(np.eye(2), np.eye(2), np.zeros((2, 2)), np.diag([1.0, 1e-14]))
    alone, large = (
        run(
            make(name, model), Gaussian([size, 0.0], np.diag([1.0, 1e-12])), y + [size, 0.0], rng=0
        ).log_likelihood
        for size in (0.0, 1e9)
    )
    assert large == pytest.approx(alone, abs=1e-5)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e3, 1e6])
def test_what_moves_and_is_seen_exactly_has_density_and_distance_0_in_all_units(unit: float):
    time = 0.1 * np.arange(40.0)
    x = unit * np.stack([0.7 * time - 1.3, np.full(40, 0.7)], -1)
    model = LinearModel([[1.0, 0.1], [0.0, 1.0]], [[1.0, 0.0]], np.zeros((2, 2)), [[0.0]])
    series = run(make("kf", model), Gaussian([0.0, 0.0], unit**2 * np.eye(2)), x[:, :1])
    size = np.abs(series.mean).max(-1, keepdims=True)
    np.testing.assert_array_equal(
        nis(series.updated.innovation, series.updated.innovation_cov, size)[2:], 0.0
    )
    np.testing.assert_array_equal(nees(series.mean, series.cov, x)[1:], 0.0)
    np.testing.assert_array_equal(series.log_likelihoods[2:], 0.0)


def test_the_likelihood_of_a_first_exact_measurement_needs_no_input_of_a_step():
    model = LinearModel(lambda u: u[..., :1, None], [[1.0]], [[0.0]], [[0.0]])
    filter = make("kf", model)
    start = filter.init(Gaussian([2.0], [[0.0]]))
    assert filter.log_likelihood(start, filter.update(start, [2.0])) == 0.0


def test_an_exact_measurement_tells_the_unknown_input_and_leaves_the_others_their_density():
    model = LinearModel(
        [[1.0]], [[1.0], [1.0]], [[0.0]], np.diag([0.0, 0.4]), G=[[0.0]], H=[[1.0], [0.0]]
    )
    series = run(make("kf-umv-ui", model), Gaussian([0.3], [[0.0]]), [[2.0, 0.5]])
    assert series.updated.input_mean.item() == pytest.approx(1.7)
    assert series.log_likelihood == pytest.approx(norm.logpdf(0.5, 0.3, np.sqrt(0.4)))


class Plain(Filter):
    """A filter of one's own that says nothing of its innovations."""

    def _predict(self, belief, u, rng):
        return Belief.predicted(belief, belief.mean, belief.cov + self.model.Q, u)

    def _update(self, belief, measurement, rng):
        return belief.replace(
            mean=belief.mean + 0.5 * np.vecmat(measurement.innovation, measurement.C),
            recovery=belief.recovery,
        )


def test_a_filter_of_ones_own_runs_and_its_likelihood_is_refused_where_it_cannot_be_told():
    model = LinearModel(np.eye(2), np.eye(2), 0.1 * np.eye(2), np.eye(2))
    series = run(Plain(model), Gaussian(np.zeros(2), np.eye(2)), np.ones((4, 2)))
    np.testing.assert_allclose(series.mean[:, 0], 1.0 - 0.5 ** np.arange(1, 5))
    with pytest.raises(ValueError, match="Plain gives no covariance of its innovations"):
        series.log_likelihood  # noqa: B018


def test_what_a_likelihood_is_can_be_asked():
    kinds = {
        "kf": "exact",
        "ekf": "approximate",
        "enkf": "approximate",
        "kf-umv-ui": "diffuse",
        "ulise": "diffuse",
    }
    for name, kind in kinds.items():
        system = (
            unknown_input_system(0, name != "kf-umv-ui-wdf")
            if kind == "diffuse"
            else kalman_system(0)
        )
        assert make(name, system.model).likelihood == kind


# --- times ----------------------------------------------------------------------------------------


def _drifting() -> LinearModel:
    return sampled(
        [[-0.3, 1.0], [0.0, -0.1]], [[1.0, 0.0]], np.diag([0.01, 0.2]), [[0.1]], B=[[0.0], [1.0]]
    )


def test_measurements_at_irregular_times_are_regular_ones_with_gaps():
    """Times on a grid with nothing read between: the control held, the noise accumulated as on the grid."""
    rng = np.random.default_rng(0)
    whole = np.unique(np.concatenate([[0], rng.choice(60, 25, replace=False)]))
    y, control = rng.normal(size=(61, 4, 1)), rng.normal(size=(61, 1))
    times = np.arange(61.0) / 4.0
    control = control[
        whole[np.searchsorted(whole, np.arange(61), side="right") - 1]
    ]  # held from measurement to measurement
    y[np.setdiff1d(np.arange(61), whole)] = np.nan
    kf, prior = make("kf", _drifting()), Gaussian([1.0, 0.0], np.eye(2))
    grid = run(kf, prior, y, u=control, t=times)
    sparse = run(kf, prior, y[whole], u=control[whole], t=times[whole])
    np.testing.assert_allclose(sparse.mean, grid.mean[whole], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        sparse.cov, np.broadcast_to(grid.cov, (61, 4, 2, 2))[whole], rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(sparse.log_likelihood, grid.log_likelihood, rtol=1e-10)


def test_a_sampled_model_is_the_discrete_one_at_a_regular_step():
    model, u = _drifting(), np.array([0.0, 0.7])
    A, B = zero_order_hold(np.array([[-0.3, 1.0], [0.0, -0.1]]), np.array([[0.0], [1.0]]), 0.7)
    np.testing.assert_allclose(model.A(u), A, rtol=1e-13)
    np.testing.assert_allclose(
        model.B(u), np.concatenate([B, np.zeros((2, 1))], 1), rtol=0, atol=1e-14
    )
    half = model.Q(np.array([0.0, 0.35]))
    step = model.A(np.array([0.0, 0.35]))
    np.testing.assert_allclose(model.Q(u), step @ half @ step.T + half, rtol=1e-12)
    np.testing.assert_allclose(model.Q(np.zeros(2)), 0.0, atol=1e-15)


@pytest.mark.parametrize("length", [0.01, 1.0, 30.0, 1e3, 1e5])
def test_noise_over_a_long_step_is_that_of_two_halves(length: float):
    """However long against the fastest decay, which the exponential of -A would overflow at."""
    model = sampled([[-10.0, 0.0], [1.0, -0.01]], [[0.0, 1.0]], np.diag([20.0, 0.1]), [[0.1]])
    half, whole = np.array([length]), np.array([2.0 * length])
    A, Q = model.A(half), model.Q(half)
    np.testing.assert_allclose(model.Q(whole), A @ Q @ A.T + Q, rtol=1e-9)
    np.testing.assert_allclose(model.A(whole), A @ A, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(model)).Q(whole), model.Q(whole))


@pytest.mark.parametrize("T", [1, 6])
def test_what_follows_the_known_input_follows_that_of_the_first_measurement_too(T: int):
    """Measurements through an H, or a C, that is a function of u, held, are those of a constant one."""
    rng = np.random.default_rng(0)
    y, u = rng.normal(size=(T, 3)), np.full((T, 1), 2.0)
    shown = np.array([[1.0], [0.5], [0.0]])
    parts = {
        "A": 0.9 * np.eye(2),
        "Q": 0.1 * np.eye(2),
        "R": np.eye(3),
        "B": np.zeros((2, 1)),
        "G": [[1.0], [0.0]],
    }
    C = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    prior = Gaussian(np.zeros(2), np.eye(2))
    constant = LinearModel(**parts, C=2.0 * C, H=2.0 * shown)
    following = LinearModel(
        **parts, C=lambda u: u[..., :1, None] * C, H=lambda u: u[..., :1, None] * shown
    )
    for name in ("kf", "kf-umv-ui", "ulise"):
        wanted, found = (run(make(name, model), prior, y, u=u) for model in (constant, following))
        np.testing.assert_allclose(
            found.log_likelihoods, wanted.log_likelihoods, rtol=0, atol=1e-12
        )


MASKED = np.ma.masked_greater([[1.0, 99.0], [1.0, 2.0]], 50.0)


@pytest.mark.parametrize(
    "y",
    [
        MASKED, list(MASKED), tuple(MASKED), [MASKED[0], [1.0, 2.0]], [[1.0, np.ma.masked], [1, 2]],
        [[1.0, None], [1, 2]], MASKED.astype(int), np.array([[1.0, None], [1.0, 2.0]], object), "Float64", "Int64",
    ],
    ids=str,
)  # fmt: skip
def test_masked_measurements_none_and_na_are_missing_ones(y):
    if isinstance(y, str):
        y = (
            pytest.importorskip("pandas")
            .DataFrame(MASKED.filled(-1), dtype=y)
            .replace(-1, None)
            .astype(y)
        )
    kf, prior = (
        make("kf", LinearModel([[1.0]], [[1.0], [1.0]], [[0.1]], np.eye(2))),
        Gaussian([0.0], [[1.0]]),
    )
    np.testing.assert_allclose(run(kf, prior, y).mean[:, 0], [0.5, 23 / 22], rtol=1e-12)
    first = y.iloc[0] if hasattr(y, "iloc") else y[0]
    assert kf.update(kf.init(prior), first).mean == pytest.approx(0.5)
    with pytest.raises(ValueError, match="y must be an array of real numbers"):
        run(kf, prior, [["a", None], [1.0, 2.0]])


# --- continuing, and the input of a measurement ---------------------------------------------------


@pytest.mark.parametrize("wrapped", [False, True], ids=["", "delayed"])
@one_of_each()
def test_a_series_continued_from_its_last_belief_is_the_whole_series_to_the_last_bit(
    case: Case, wrapped: bool
):
    system = case.system(0)
    record = simulate(system, 1, runs=2, steps=7)
    y, K = gaps(record.y), 4
    filter = case.make(system.model)
    if wrapped:
        y, filter = by_age(y, np.array([0, 1, 2, 0, 1, 0, 0])[:, None, None]), Delayed(filter, 3)
    whole = run(filter, system.prior, y, u=record.u, rng=3)
    before = run(filter, system.prior, y[:K], u=record.u[:K], rng=3)
    starts = [before.last] if wrapped else [before.last, before.updated[-1]]
    for start in starts:
        after = run(filter, start, y[K:], u=record.u[K - 1 :], rng=3, first=K)
        for name in ("mean", "cov", "input_mean", "innovation", "ensemble", "recovery", "u"):
            if (wanted := getattr(whole.updated, name)) is not None:
                np.testing.assert_array_equal(
                    getattr(after.updated, name), wanted[K:], err_msg=name
                )
                np.testing.assert_array_equal(
                    getattr(before.updated, name), wanted[:K], err_msg=name
                )
        np.testing.assert_array_equal(after.predicted.mean, whole.predicted.mean[K:])
        if not wrapped:
            np.testing.assert_array_equal(after.log_likelihoods, whole.log_likelihoods[K:])


def test_a_series_continues_over_steps_of_any_length_and_with_measurements_that_know_theirs():
    """C, H, R and h may be functions of the input and of the step that led to the measurement."""
    rng = np.random.default_rng(2)
    t, y, u = (
        np.cumsum(rng.exponential(size=9)),
        rng.normal(size=(9, 2, 1)),
        rng.normal(size=(9, 2, 1)),
    )
    model, prior, K = _drifting(), Gaussian([1.0, 0.0], np.eye(2)), 5
    curved = NonlinearModel(
        lambda x, u: np.matvec(model.A(u), x) + np.matvec(model.B(u), u),
        lambda x, u: np.tanh(x[..., :1]) + u[..., :1] * (1.0 + u[..., 1:]), model.Q,
        lambda u: 0.1 * (1.0 + u[..., 1:, None]), states=2, measurements=1,
    )  # fmt: skip
    for filter in (make("kf", model), make("ekf", curved), make("ukf", curved)):
        whole = run(filter, prior, y, u=u, t=t)
        before = run(filter, prior, y[:K], u=u[:K], t=t[:K])
        after = run(filter, before.last, y[K:], u=u[K - 1 :], t=t[K - 1 :])
        np.testing.assert_array_equal(np.concatenate([before.mean, after.mean]), whole.mean)
        np.testing.assert_array_equal(np.concatenate([before.cov, after.cov]), whole.cov)


@pytest.mark.parametrize("name", ["kf", "ekf", "ukf", "etkf", "pf", "kf-umv-ui", "ulise"])
@pytest.mark.parametrize("delayed", [False, True], ids=["", "delayed"])
def test_a_measurement_gets_the_known_input_of_its_own_time(name: str, delayed: bool):
    """Measurements of ``C x + D u`` are those of ``C x`` once ``D u`` of the same time is taken off."""
    system = unknown_input_system(0, True) if name in ("kf-umv-ui", "ulise") else kalman_system(0)
    m, options = system.model, {"members": 10} if name == "etkf" else {}
    shown = np.array([[3.0, 0.0], [0.0, -2.0], [1.0, 1.0]])
    lifted = NonlinearModel(
        m.transition, lambda x, u: m.measurement(x, u) + np.matvec(shown, u), m.Q, m.R, G=m.G, H=m.H,
        transition_jacobian=lambda x, u: m.A, measurement_jacobian=lambda x, u: m.C,
    )  # fmt: skip
    if name in (
        "kf",
        "ulise",
    ):  # for linear models alone: C follows the input, along a state that stays 1
        lifted = _with_a_constant(m, shown)
    record = simulate(system, 1, runs=2, steps=6)
    y = record.y + np.matvec(shown, record.u)
    constant = Gaussian(np.append(system.mean, 1.0), np.pad(system.cov, (0, 1)))
    prior = constant if lifted.n > m.n else system.prior
    filters = [make(name, model, **options) for model in (lifted, m)]
    if delayed:
        filters = [Delayed(filter, 1) for filter in filters]
    ages = (lambda a: a[..., None, :]) if delayed else (lambda a: a)
    found = run(filters[0], prior, ages(y), u=record.u, rng=0)
    wanted = run(filters[1], system.prior, ages(record.y), u=record.u, rng=0)
    np.testing.assert_allclose(
        found.mean[..., : m.n], wanted.mean, rtol=0, atol=1e-9 * np.abs(wanted.mean).max()
    )


def _with_a_constant(m: LinearModel, shown: np.ndarray) -> LinearModel:
    """The model with one more state, which is 1, so that C may show the known input."""
    grown = {name: np.pad(getattr(m, name), (0, 1)) for name in "AQ"}
    grown["A"][-1, -1] = 1.0
    below = {
        name: np.pad(getattr(m, name), ((0, 1), (0, 0)))
        for name in "BG"
        if getattr(m, name) is not None
    }

    def C(u: np.ndarray) -> np.ndarray:
        told = np.matvec(shown, u)[..., None]
        return np.concatenate([np.broadcast_to(m.C, told.shape[:-2] + m.C.shape), told], -1)

    return LinearModel(C=C, R=m.R, H=m.H, **grown, **below)


# --- what does not fit ----------------------------------------------------------------------------


_KF = make("kf", sampled(-np.eye(2), [[1.0, 0.0]], np.eye(2), [[1.0]]))


_ETKF = make("etkf", LinearModel(np.eye(2), [[1.0, 0.0]], np.eye(2), [[1.0]]))
_AFTER = [
    run(filter, Gaussian(np.zeros(2), np.eye(2)), np.zeros((1, 1)), rng=0).last
    for filter in (_ETKF, make("kf", _ETKF.model))
]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"y": np.zeros(5)},
            (
                r"y has shape \(5,\), expected \(T, ..., p\), times first: one channel has y\[:,"
                r" None\]"
            ),
        ),
        ({"y": np.zeros((0, 1))}, "y has shape"),
        ({"y": np.zeros((5, 2))}, r"y has shape \(2,\), expected \(1,\)"),
        ({"u": np.zeros((4, 1))}, "u has shape .* one for each measurement"),
        ({"t": np.arange(4.0), "filter": _KF}, "t has shape .* one time for each measurement"),
        (
            {"t": np.array([0.0, 1.0, 0.5, 2.0, 3.0]), "filter": _KF},
            "times t go back: sort the measurements",
        ),
        (
            {"t": np.array([0.0, 1.0, np.nan, 2.0, 3.0]), "filter": _KF},
            "times t hold a time that is not finite",
        ),
        ({"available": np.ones((4, 1), bool)}, "available has shape"),
        ({"R": np.eye(1)}, "R has shape"),
        (
            {"t": np.arange(5.0)},
            "this model is the same however long a step takes: make it with sampled",
        ),
        (
            {"prior": Gaussian(np.zeros((3, 2)), np.eye(2))},
            r"the prior's mean has rows \(3,\), y has \(\)",
        ),
        (
            {"prior": Gaussian(np.zeros(2), np.eye(2)[None].repeat(3, 0))},
            r"the prior's cov has rows",
        ),
        ({"rng": -1}, "rng must be a whole number of at least 0"),
        ({"prior": Gaussian(np.zeros(3), np.eye(3))}, "the prior is for 3 states, the model has 2"),
        ({"filter": _KF}, "give run the times t"),
        (
            {"prior": _AFTER[1], "u": np.zeros((5, 1))},
            r"u has shape .*expected \(6, ..., m\).* before them one for that",
        ),
        (
            {"prior": _AFTER[1], "t": np.arange(5.0), "filter": _KF},
            r"t has shape .* before them one for that of the",
        ),
        ({"prior": _AFTER[1][None]}, r"the prior's mean has rows \(1,\), y has \(\)"),
        (
            {"prior": _AFTER[0], "filter": _ETKF, "rng": 0},
            "first must be how many measurements came before the belief",
        ),
        ({"first": -1}, "first must be a whole number of at least 0"),
    ],
)
def test_what_does_not_fit_gets_one_sentence(changes: dict, sentence: str):
    model = LinearModel(np.eye(2), [[1.0, 0.0]], np.eye(2), [[1.0]])
    given = {
        "filter": make("kf", model),
        "prior": Gaussian(np.zeros(2), np.eye(2)),
        "y": np.zeros((5, 1)),
    } | changes
    with pytest.raises(ValueError, match=sentence) as error:
        run(**given)
    assert "\n" not in str(error.value)


# --- what is computed once ------------------------------------------------------------------------


def test_a_step_length_is_discretised_once_and_a_function_checked_at_its_first_value(
    monkeypatch: pytest.MonkeyPatch,
):
    counts = {"van_loan": 0, "zero_order_hold": 0, "as_covariance": 0}
    for module, name in (
        (discretisation, "van_loan"), (discretisation, "zero_order_hold"), (models, "as_covariance"),
        (model_checks, "as_covariance"),
    ):  # fmt: skip
        usual = getattr(module, name)

        def counted(*given: Any, name: str = name, usual: Any = usual) -> Any:
            counts[name] += 1
            return usual(*given)

        monkeypatch.setattr(module, name, counted)
    rng, lengths = np.random.default_rng(0), np.array([0.5, 1.0, 0.25, 0.75])
    t = np.cumsum(lengths[rng.integers(0, 4, size=(60, 3))], 0)
    model = sampled(
        [[0.0, 1.0], [0.0, -0.1]], [[1.0, 0.0]], 0.1 * np.eye(2), [[0.1]], B=[[0.0], [1.0]]
    )
    filter, prior = make("kf", model), Gaussian(np.zeros(2), np.eye(2))
    begun = counts["as_covariance"]
    u, y = rng.normal(size=(60, 3, 1)), rng.normal(size=(60, 3, 1))
    together = run(filter, prior, y, u=u, t=t)
    assert counts["van_loan"] == counts["zero_order_hold"] == 4
    assert counts["as_covariance"] <= begun + 3  # of Q, and of the prior
    for row in range(3):
        alone = run(filter, prior, y[:, row], u=u[:, row], t=t[:, row])
        np.testing.assert_allclose(together.mean[:, row], alone.mean, rtol=0, atol=1e-12)
    assert counts["van_loan"] == counts["zero_order_hold"] == 4
