"""The laws that every filter keeps, each stated once and tried on every case that it applies to."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag, solve_discrete_are
from scipy.stats import chi2

from estimators import (
    Belief,
    FeedthroughBelief,
    Filter,
    Gaussian,
    LinearModel,
    RandomKeys,
    chi_square_band,
    make,
    names,
    nees,
    nis,
)
from tests.estimators.cases import (
    CASES,
    INPUT_PRIOR,
    Case,
    arrays,
    assert_covariance,
    assert_same,
    counted_directions,
    every_case,
    flat_prior_posterior,
    kalman_system,
    observable_directions,
    random_covariance,
    random_transition,
    rounding,
    simulate,
    some_measurements,
    textbook_kalman,
    track,
    without_channel,
)

SEEDS = [pytest.param(seed, id=f"seed {seed}") for seed in (0, 1)]


def test_every_filter_has_a_case():
    assert {case.name for case in CASES} == set(names()) - {"enkf-sr"}  # another name of etkf


# --- 1. linear and Gaussian -----------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
@every_case("kalman")
def test_on_a_linear_gaussian_model_the_filter_is_the_textbook_kalman_filter(case: Case, seed: int):
    system = case.system(seed)
    record = simulate(system, seed, runs=1, steps=50)
    beliefs = track(
        case.make(system.model), system.prior, record._replace(y=record.y[:, 0], u=record.u[:, 0])
    )
    for belief, (mean, cov) in zip(
        beliefs, textbook_kalman(system, record.y[:, 0], record.u[:, 0]), strict=True
    ):
        np.testing.assert_allclose(
            belief.mean, mean, rtol=0, atol=1e-11 * max(1, np.abs(mean).max())
        )
        np.testing.assert_allclose(belief.cov, cov, rtol=0, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.5, 0.95, 1.1])
@every_case("kalman")
def test_the_covariance_settles_at_the_solution_of_the_riccati_equation(case: Case, radius: float):
    system = kalman_system(5, radius=radius)
    model = system.model
    filter = case.make(model)
    belief = filter.init(system.prior)
    for _ in range(400):
        belief = filter.predict(filter.update(belief, np.zeros(model.p)), np.zeros(system.m))
    expected = solve_discrete_are(model.A.T, model.C.T, model.Q, model.R)
    np.testing.assert_allclose(belief.cov, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.slow
@every_case("unknown-input", "linear")
def test_the_covariance_forgets_the_prior(case: Case):
    system = case.system(0)
    filter = case.make(system.model)
    belief = filter.init(
        Gaussian(
            np.zeros((2, system.model.n)), np.stack([system.cov, 1e4 * np.eye(system.model.n)])
        )
    )
    for _ in range(400):
        belief = filter.update(
            filter.predict(belief, np.zeros((2, system.m))), np.zeros(system.model.p)
        )
    for cov in (belief.cov, belief.input_cov):
        np.testing.assert_allclose(cov[0], cov[1], rtol=0, atol=1e-10 * np.abs(cov[0]).max())


# --- 4. unknown input -----------------------------------------------------------------------------


def _pending(filter: Filter, predicted: Belief) -> np.ndarray:
    """The directions ``(q, q)`` of the last step's unknown input that its own measurement did not show."""
    return filter.input_delay * (np.eye(filter.model.q) - predicted.input_observed)


def _input_at(case: Case, model: LinearModel, d: np.ndarray, k: int) -> np.ndarray:
    """The true unknown input that the update at time ``k`` estimates."""
    return d[k - case.make(model).input_delay]


def _after_some_steps(case: Case, seed: int, steps: int = 6):
    """A system, its filter, and a prediction some way into a run."""
    system = case.system(seed)
    record = simulate(system, seed, runs=1, steps=steps)
    record = record._replace(y=record.y[:, 0], u=record.u[:, 0])
    filter = case.make(system.model)
    belief = track(filter, system.prior, record)[-1]
    return system, filter, filter.predict(belief, record.u[-1])


def _masks(p: int) -> list[np.ndarray]:
    """All measurements, and every choice that leaves one or none out, or keeps only one or none."""
    kept = [np.ones(p, bool), *~np.eye(p, dtype=bool), *np.eye(p, dtype=bool), np.zeros(p, bool)]
    return [np.array(mask) for mask in {tuple(mask) for mask in kept}]


@pytest.mark.parametrize("seed", SEEDS)
@every_case("unknown-input", "linear")
def test_the_update_is_least_squares_without_a_prior_of_the_input(case: Case, seed: int):
    system, filter, predicted = _after_some_steps(case, seed)
    model, n, q = system.model, system.model.n, system.model.q
    pending = _pending(filter, predicted)
    y = np.random.default_rng(seed).normal(scale=5.0, size=model.p)
    for mask in _masks(model.p):
        belief = filter.update(predicted, y, available=mask)
        C, H, R = model.C[mask], model.H[mask], model.R[mask][:, mask]
        # The unknowns beside x: what is pending of d(k-1), and d(k). A direction that these
        # measurements hardly show has the prior N(0, INPUT_PRIOR), the others none. What d(k) may
        # explain says nothing of d(k-1).
        precision = np.linalg.inv(C @ predicted.cov @ C.T + R) if mask.any() else np.zeros((0, 0))
        now = counted_directions(H, precision, INPUT_PRIOR)
        rest = (np.eye(q) - now) / INPUT_PRIOR
        weight = precision - precision @ H @ np.linalg.solve(
            H.T @ precision @ H + rest, H.T @ precision
        )
        late = counted_directions(C @ model.G @ pending, weight, INPUT_PRIOR)
        precision = block_diag(np.eye(q) - pending + (pending - late) / INPUT_PRIOR, rest)
        expected, cov = flat_prior_posterior(
            predicted.mean, predicted.cov, np.hstack([model.G @ pending, np.zeros((n, q))]),
            C, np.hstack([np.zeros(H.shape), H]), R, y[mask], precision,
        )  # fmt: skip
        close = {"rtol": 0, "atol": 1e-9 * max(1, np.abs(cov).max())}
        np.testing.assert_allclose(belief.mean, expected[:n], **close)
        np.testing.assert_allclose(belief.cov, cov[:n, :n], **close)
        # Each estimate of an input, the unknowns that it is of, and the directions in which the two
        # are the same.
        past, present, known = slice(n, n + q), slice(n + q, None), np.eye(q) - pending
        estimate = belief.input_mean, belief.input_cov, belief.state_input_cov
        estimates = [
            (*estimate, past, pending) if filter.input_delay else (*estimate, present, np.eye(q))
        ]
        observed = known + late if filter.input_delay else now
        np.testing.assert_allclose(belief.input_observed, observed, rtol=0, atol=1e-9)
        np.testing.assert_allclose(
            known @ belief.input_mean * filter.input_delay,
            known @ predicted.input_mean,
            rtol=0,
            atol=1e-12,
        )
        if isinstance(belief, FeedthroughBelief):
            estimate = belief.feedthrough_mean, belief.feedthrough_cov, belief.state_feedthrough_cov
            estimates.append((*estimate, present, now))
            np.testing.assert_allclose(belief.feedthrough_observed, now, rtol=0, atol=1e-9)
        for mean, input_cov, cross, part, of in estimates:
            np.testing.assert_allclose(of @ mean, of @ expected[part], **close)
            np.testing.assert_allclose(of @ input_cov @ of, of @ cov[part, part] @ of, **close)
            np.testing.assert_allclose(cross @ of, cov[:n, part] @ of, **close)


@pytest.mark.parametrize("seed", SEEDS)
@every_case("unknown-input", "linear")
def test_the_prediction_propagates_joint_mean_and_covariance_of_state_and_input(
    case: Case, seed: int
):
    system, filter, predicted = _after_some_steps(case, seed)
    model, rng = system.model, np.random.default_rng(seed)
    u = rng.normal(size=system.m)
    for mask in _masks(model.p):
        belief = filter.update(predicted, rng.normal(size=model.p), available=mask)
        mean, cov = model.A @ belief.mean + model.B @ u, model.A @ belief.cov @ model.A.T + model.Q
        following, waiting = filter.predict(belief, u), 0.0
        acting = None  # what is estimated now and acts on this step
        if filter.input_delay == 0:
            acting = belief.input_mean, belief.input_cov, belief.state_input_cov
        elif isinstance(
            belief, FeedthroughBelief
        ):  # what it does not know of d yet stands apart, for the next measurement
            eye, n = np.eye(model.q), model.n
            hidden = INPUT_PRIOR * (eye - belief.feedthrough_observed)
            x, d = belief.input_reach[:n], belief.input_reach[n:] + eye
            acting = (
                belief.feedthrough_mean, belief.feedthrough_cov + d @ hidden @ d.T - (d - eye) @ hidden @ (d - eye).T,
                belief.state_feedthrough_cov + x @ hidden,
            )  # fmt: skip
            waiting = following.input_reach[:n] @ hidden @ following.input_reach[:n].T
        if acting is not None:
            mean = mean + model.G @ acting[0]
            cross = model.A @ acting[2] @ model.G.T
            cov = cov + cross + cross.T + model.G @ acting[1] @ model.G.T
        np.testing.assert_allclose(
            following.mean, mean, rtol=0, atol=1e-12 * max(1, np.abs(mean).max())
        )
        np.testing.assert_allclose(
            following.cov + waiting, cov, rtol=0, atol=1e-11 * np.abs(cov).max()
        )


@pytest.mark.parametrize("seed", SEEDS)
@every_case("unknown-input", "linear")
def test_a_change_of_the_input_shows_one_for_one_in_its_estimate(case: Case, seed: int):
    """M H = I, or M C G = I: and the state moves exactly as the input drives it.

    Of d(k-1), what its own measurement showed is settled: what the next one shows is the rest.
    """
    system, filter, predicted = _after_some_steps(case, seed)
    model = system.model
    rng = np.random.default_rng(seed)
    y, change = rng.normal(size=model.p), rng.normal(scale=10.0, size=model.q)
    drive = filter.input_delay * model.G
    if filter.input_delay:
        change = _pending(filter, predicted) @ change
    before = filter.update(predicted, y)
    after = filter.update(predicted, y + (model.H + model.C @ drive) @ change)
    np.testing.assert_allclose(after.input_mean - before.input_mean, change, rtol=0, atol=1e-11)
    np.testing.assert_allclose(after.mean - before.mean, drive @ change, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(after.cov, before.cov)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
@every_case("unknown-input", "linear")
def test_the_estimation_error_does_not_depend_on_the_size_of_the_input(case: Case, seed: int):
    system = case.system(seed)
    model, filter = system.model, case.make(system.model)
    small = simulate(system, seed, runs=20, steps=100)
    large = simulate(system, seed, runs=20, steps=100, d=1000.0 * small.d)
    assert np.abs(large.x - small.x).max() > 1000.0
    tracks = [track(filter, system.rows(20), record) for record in (small, large)]
    for k, (one, other) in enumerate(zip(*tracks, strict=True)):
        np.testing.assert_allclose(
            other.mean - large.x[k], one.mean - small.x[k], rtol=0, atol=1e-9
        )
        if k >= filter.input_delay:
            errors = [
                b.input_mean - _input_at(case, model, r.d, k)
                for b, r in ((one, small), (other, large))
            ]
            np.testing.assert_allclose(errors[1], errors[0], rtol=0, atol=1e-9)


@pytest.mark.slow
@every_case("unknown-input", "linear")
def test_state_and_input_estimates_are_unbiased(case: Case):
    system, runs, steps = case.system(2), 20_000, 15
    record = simulate(system, 11, runs=runs, steps=steps)
    final = track(case.make(system.model), system.rows(runs), record)[-1]
    errors = np.concatenate(
        [
            final.mean - record.x[-1],
            final.input_mean - _input_at(case, system.model, record.d, steps - 1),
        ],
        -1,
    )
    # Three standard errors: false alarm of 0.27 % a component, 1.6 % for the six of the largest
    # case.
    assert (np.abs(errors.mean(0)) < 3.0 * errors.std(0, ddof=1) / np.sqrt(runs)).all()


# --- 5. consistency -------------------------------------------------------------------------------

RUNS, TIMES = 400, 200


def _share_inside(values: np.ndarray, degrees: int) -> float:
    """Share of the times at which the mean over the runs ``(times, runs)`` lies in its 95 % band."""
    low, high = chi_square_band(values.shape[1], degrees, 0.95)
    means = values.mean(axis=1)
    return float(((low <= means) & (means <= high)).mean())


# Each mean lies in its band with probability 0.95. If the 200 times were independent, fewer than 90
# % of them would lie inside with probability 0.1 %. They are correlated, which spreads the share:
# over 300 other seeds (kf, kf-umv-ui, kf-umv-ui-wdf) it never fell below 90.5 %, so that the false
# alarm of one test is below 1 % (95 % confidence).


@pytest.mark.slow
@pytest.mark.parametrize(
    "dropouts", [False, True], ids=["every measurement arrives", "measurements drop out"]
)
@every_case("consistent")
def test_state_errors_are_as_large_as_the_filter_says(case: Case, dropouts: bool):
    system = case.system(1)
    model, rng = system.model, np.random.default_rng(21)
    available, d = None, None
    if dropouts:  # then d is not always seen, and its prior must be true
        available = some_measurements(rng, model.p, TIMES, RUNS)
        d = rng.normal(scale=np.sqrt(INPUT_PRIOR), size=(TIMES, RUNS, model.q)) if model.q else None
    record = simulate(system, 20, RUNS, TIMES, d)
    beliefs = track(case.make(model), system.rows(RUNS), record, available=available)
    values = np.array([nees(b.mean, b.cov, x) for b, x in zip(beliefs, record.x, strict=True)])
    assert _share_inside(values, model.n) >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    "dropouts", [False, True], ids=["every measurement arrives", "measurements drop out"]
)
@every_case("consistent", "unknown-input")
def test_joint_errors_of_state_and_input_are_as_large_as_the_filter_says(
    case: Case, dropouts: bool
):
    system = case.system(1)
    model, rng = system.model, np.random.default_rng(23)
    available, d = None, None
    if dropouts:
        available = some_measurements(rng, model.p, TIMES, RUNS)
        d = rng.normal(scale=np.sqrt(INPUT_PRIOR), size=(TIMES, RUNS, model.q))
    record = simulate(system, 22, RUNS, TIMES, d)
    beliefs = track(case.make(model), system.rows(RUNS), record, available=available)
    values = []
    for k in range(1, TIMES):
        b, truth = (
            beliefs[k],
            np.concatenate([record.x[k], _input_at(case, model, record.d, k)], -1),
        )
        cross = b.state_input_cov
        cov = np.block([[b.cov, cross], [np.swapaxes(cross, -1, -2), b.input_cov]])
        values.append(nees(np.concatenate([b.mean, b.input_mean], -1), cov, truth))
    assert _share_inside(np.array(values), model.n + model.q) >= 0.9


@pytest.mark.slow
@every_case("consistent", "kalman")
def test_innovations_are_as_large_as_the_filter_says(case: Case):
    system = case.system(1)
    record = simulate(system, 24, RUNS, TIMES)
    beliefs = track(case.make(system.model), system.rows(RUNS), record)
    values = np.array([nis(b.innovation, b.innovation_cov) for b in beliefs])
    assert _share_inside(values, system.model.p) >= 0.9


@pytest.mark.slow
@every_case("consistent", "unknown-input")
def test_the_innovation_not_explained_by_the_input_is_as_large_as_the_filter_says(case: Case):
    """``(e - F d)' S^-1 (e - F d)`` is chi-square with p - q degrees of freedom, whatever the input.

    ``F d`` is what the inputs explain of the innovation: d(k) through H, what H does not show of
    d(k-1) through C G.
    """
    system = case.system(1)
    model = system.model
    record = simulate(system, 25, RUNS, TIMES)
    beliefs = track(case.make(model), system.rows(RUNS), record)[1:]
    late = model.C @ model.G @ (np.eye(model.q) - observable_directions(model.H))
    values = []
    for b in beliefs:
        if isinstance(b, FeedthroughBelief):
            explained = np.matvec(late, b.input_mean) + np.matvec(model.H, b.feedthrough_mean)
        else:
            explained = np.matvec(late if case.make(model).input_delay else model.H, b.input_mean)
        values.append(nis(b.innovation - explained, b.innovation_cov))
    assert _share_inside(np.array(values), model.p - model.q) >= 0.9


@pytest.mark.slow
@every_case("consistent", "kalman")
def test_normalised_squared_errors_follow_the_chi_square_distribution(case: Case):
    """Not the mean alone: the share of runs below each quantile at the last time."""
    system, runs = case.system(1), 20_000
    record = simulate(system, 26, runs, 10)
    final = track(case.make(system.model), system.rows(runs), record)[-1]
    values = nees(final.mean, final.cov, record.x[-1])
    for level in (0.05, 0.5, 0.95):
        share = (values < chi2.ppf(level, system.model.n)).mean()
        # Three standard errors at three levels: false alarm of 0.8 %.
        assert abs(share - level) < 3.0 * np.sqrt(level * (1.0 - level) / runs)


# --- 6. batches, arguments, missing measurements --------------------------------------------------


def _numbers(*rows: int) -> RandomKeys:
    return RandomKeys.seeded(rows).of(7)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
@every_case()
def test_a_batch_equals_a_loop_over_its_rows(case: Case, seed: int):
    system, rows, steps = case.system(seed), 5, 12
    model, filter = system.model, case.make(system.model)
    rng = np.random.default_rng(seed)
    record = simulate(system, seed, rows, steps)
    prior = Gaussian(
        system.mean + 0.1 * rng.normal(size=(rows, model.n)),
        system.cov * rng.uniform(0.5, 2.0, (rows, 1, 1)),
    )
    available = rng.random((steps, rows, model.p)) < 0.7
    available[:, 0] = True  # a row that never misses a measurement, in a batch that does
    R = model.R * rng.uniform(0.5, 2.0, (steps, rows, 1, 1))
    batch = track(filter, prior, record, _numbers(*range(rows)), available, R)
    for i in range(rows):
        single = track(
            filter, Gaussian(prior.mean[i], prior.cov[i]), record._replace(y=record.y[:, i], u=record.u[:, i]),
            _numbers(i)[0], available[:, i], R[:, i],
        )  # fmt: skip
        for one, other in zip(batch, single, strict=True):
            assert_same(one[i], other, 1e-12)


@pytest.mark.slow
@every_case()
def test_a_batch_may_have_several_axes(case: Case):
    system = case.system(0)
    filter = case.make(system.model)
    record = simulate(system, 0, runs=6, steps=8)
    available = np.random.default_rng(0).random((8, 6, system.model.p)) < 0.7
    flat = track(filter, system.rows(6), record, _numbers(*range(6)), available)
    grid = record._replace(y=record.y.reshape(8, 2, 3, -1), u=record.u.reshape(8, 2, 3, -1))
    shaped = track(
        filter,
        system.rows(2, 3),
        grid,
        RandomKeys(_numbers(*range(6)).keys.reshape(2, 3, 2)),
        available.reshape(8, 2, 3, -1),
    )
    for one, other in zip(shaped, flat, strict=True):
        for name, array in arrays(one).items():
            assert array.shape[:2] == (2, 3), name
        assert_same(one[1, 2], other[5], 1e-12)


@pytest.mark.slow
@every_case("linear")
def test_a_batch_of_models_equals_a_filter_for_each_model(case: Case):
    systems = [case.system(seed) for seed in range(3)]
    matrices = {
        name: np.stack([getattr(s.model, name) for s in systems])
        for name in "ABCGHQR"
        if getattr(systems[0].model, name) is not None
    }
    steps, p, m = 8, systems[0].model.p, systems[0].m
    rng = np.random.default_rng(0)
    record = simulate(systems[0], 0, 3, steps)._replace(
        y=rng.normal(size=(steps, 3, p)), u=rng.normal(size=(steps, 3, m))
    )
    available = rng.random((steps, 3, p)) < 0.8
    prior = Gaussian(np.stack([s.mean for s in systems]), np.stack([s.cov for s in systems]))
    batch = track(case.make(LinearModel(**matrices)), prior, record, _numbers(0, 1, 2), available)
    for i, system in enumerate(systems):
        one_row = record._replace(y=record.y[:, i], u=record.u[:, i])
        single = track(
            case.make(system.model), system.prior, one_row, _numbers(i)[0], available[:, i]
        )
        for one, other in zip(batch, single, strict=True):
            assert_same(one[i], other, 1e-12)


@every_case()
def test_arguments_and_earlier_beliefs_are_never_changed(case: Case):
    system, rows = case.system(0), 4
    model, filter = system.model, case.make(system.model)
    record = simulate(system, 0, rows, 3)
    rng = np.random.default_rng(0)
    prior = Gaussian(np.tile(system.mean, (rows, 1)), np.tile(system.cov, (rows, 1, 1)))
    y, u = record.y[-1].copy(), record.u[-1].copy()
    y[1, 0] = np.nan
    given_arrays = {
        "y": y, "u": u, "available": rng.random((rows, model.p)) < 0.5, "R": np.tile(model.R, (rows, 1, 1)),
        "prior mean": prior.mean, "prior cov": prior.cov, "Q": model.Q, "model R": model.R,
    }  # fmt: skip
    if isinstance(model, LinearModel):
        given_arrays |= {
            name: getattr(model, name) for name in "ABCGH" if getattr(model, name) is not None
        }
    kept = {name: array.copy() for name, array in given_arrays.items()}
    belief = filter.init(prior, rng=rng)
    history = []
    for _ in range(2):
        history.append((belief, {name: array.copy() for name, array in arrays(belief).items()}))
        belief = filter.update(
            belief, y, rng=rng, available=given_arrays["available"], R=given_arrays["R"]
        )
        history.append((belief, {name: array.copy() for name, array in arrays(belief).items()}))
        belief = filter.predict(belief, u, rng=rng)
    for name, array in given_arrays.items():
        np.testing.assert_array_equal(array, kept[name], err_msg=name)
    for earlier, copy in history:
        for name, array in arrays(earlier).items():
            np.testing.assert_array_equal(array, copy[name], err_msg=name)
    with pytest.raises(dataclasses.FrozenInstanceError):
        belief.mean = np.zeros(model.n)


def check_that_values_have_no_effect(case: Case, values: list[float], masked: bool) -> None:
    """Beliefs are equal where measurements that are absent have these values; the mask says so or is left out."""
    system, rows, steps = case.system(0), 6, 10
    filter = case.make(system.model)
    record = simulate(system, 0, rows, steps)
    rng = np.random.default_rng(1)
    available = rng.random(record.y.shape) < 0.6
    other = record._replace(y=np.where(available, record.y, rng.choice(values, record.y.shape)))
    pairs = zip(
        track(filter, system.rows(rows), record, _numbers(*range(rows)), available),
        track(
            filter,
            system.rows(rows),
            other,
            _numbers(*range(rows)),
            *([available] if masked else []),
        ),
        strict=True,
    )
    for one, two in pairs:
        assert_same(one, two)


@every_case()
def test_the_value_of_a_masked_measurement_has_no_effect(case: Case):
    check_that_values_have_no_effect(case, [np.nan, np.inf, -1e300, 0.0], masked=True)


@every_case()
def test_a_measurement_that_is_not_finite_counts_as_missing(case: Case):
    check_that_values_have_no_effect(case, [np.nan, np.inf, -np.inf], masked=False)


@every_case("deterministic")
def test_masking_every_measurement_equals_never_updating(case: Case):
    system, rows = case.system(0), 3
    model, filter = system.model, case.make(system.model)
    record = simulate(system, 0, rows, 9)
    nothing = np.zeros(model.p, bool)
    start = track(filter, system.rows(rows), record._replace(y=record.y[:5], u=record.u[:5]))[-1]
    masked = never = start
    for k in range(4, 8):
        masked = filter.update(
            filter.predict(masked, record.u[k]), record.y[k + 1], available=nothing
        )
        never = filter.predict(never, record.u[k])
    ends = [
        filter.update(filter.predict(belief, record.u[8]), record.y[8])
        for belief in (masked, never)
    ]
    assert_same(*ends, 1e-12)
    assert np.abs(ends[0].mean - start.mean).max() > 0.01


@every_case("deterministic", "kalman")
def test_an_update_without_measurements_leaves_the_estimate_alone(case: Case):
    system, filter, predicted = _after_some_steps(case, 0)
    belief = filter.update(predicted, np.full(system.model.p, np.nan))
    np.testing.assert_array_equal(belief.mean, predicted.mean)
    np.testing.assert_allclose(
        belief.cov, predicted.cov, rtol=0, atol=1e-13 * np.abs(predicted.cov).max()
    )
    np.testing.assert_array_equal(belief.innovation, 0.0)
    np.testing.assert_array_equal(belief.innovation_cov, np.eye(system.model.p))


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
@every_case("deterministic")
def test_masking_a_channel_equals_a_model_without_it(case: Case, seed: int):
    system, rows, steps = case.system(seed), 3, 15
    model = system.model
    record = simulate(system, seed, rows, steps)
    for j in range(model.p):
        kept = np.arange(model.p) != j
        available = np.broadcast_to(kept, (steps, rows, model.p))
        masked = track(case.make(model), system.rows(rows), record, available=available)
        reduced = track(
            case.make(without_channel(model, j)),
            system.rows(rows),
            record._replace(y=record.y[..., kept]),
        )
        tolerances = rounding(case.make(model), system.rows(rows), record, available)
        for one, other, tolerance in zip(masked, reduced, tolerances, strict=True):
            assert (one.innovation[..., j] == 0.0).all()
            assert (one.innovation_cov[..., j, j] == 1.0).all()
            one = one.replace(
                innovation=one.innovation[..., kept], innovation_cov=one.innovation_cov[..., kept, :][..., kept],
                available=one.available[..., kept],
            )  # fmt: skip
            sizes = {
                name: array.shape for name, array in arrays(other).items()
            }  # what has the size of the measurements
            ignore = [name for name, array in arrays(one).items() if array.shape != sizes[name]]
            assert_same(
                one.replace(**{name: getattr(other, name) for name in ignore}), other, tolerance
            )  # another order of the same sums, over 15 steps


@pytest.mark.slow
@every_case()
def test_a_measurement_covariance_passed_to_an_update_replaces_that_of_the_model(case: Case):
    system, rows = case.system(0), 3
    model = system.model
    record = simulate(system, 0, rows, 8)
    R = random_covariance(np.random.default_rng(5), model.p)
    passed = track(
        case.make(model),
        system.rows(rows),
        record,
        _numbers(0, 1, 2),
        R=np.broadcast_to(R, (8, *R.shape)),
    )
    built_in = track(
        case.make(dataclasses.replace(model, R=R)), system.rows(rows), record, _numbers(0, 1, 2)
    )
    for one, other in zip(passed, built_in, strict=True):
        assert_same(one, other, 1e-13)


@every_case("deterministic", "linear")
def test_a_change_of_units_changes_nothing_but_the_units(case: Case):
    """Everything a million times larger, covariances its square: with measurements missing, too."""
    system, rows, steps, unit = case.system(0), 8, 20, 2.0**20
    model = system.model
    options = {k: v * unit**2 if k == "input_prior" else v for k, v in case.options.items()}
    record = simulate(system, 0, rows, steps)
    available = some_measurements(np.random.default_rng(0), model.p, steps, rows)
    scaled = dataclasses.replace(model, Q=model.Q * unit**2, R=model.R * unit**2)
    small = track(case.make(model), system.rows(rows), record, available=available)
    large = track(
        make(case.name, scaled, **options),
        Gaussian(np.tile(unit * system.mean, (rows, 1)), system.cov * unit**2),
        record._replace(y=record.y * unit, u=record.u * unit),
        available=available,
    )
    for one, other in zip(small, large, strict=True):
        scale = max(1.0, np.abs(one.cov).max())
        np.testing.assert_allclose(other.mean / unit, one.mean, rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(other.cov / unit**2, one.cov, rtol=0, atol=1e-10 * scale)
        np.testing.assert_array_equal(other.available, one.available)
        if one.input_mean is not None:
            scale = max(1.0, np.abs(one.input_cov).max())
            np.testing.assert_allclose(
                other.input_mean / unit, one.input_mean, rtol=0, atol=1e-10 * scale
            )
            np.testing.assert_allclose(
                other.input_cov / unit**2, one.input_cov, rtol=0, atol=1e-10 * scale
            )


@pytest.mark.slow
@pytest.mark.parametrize("turns", [-3, -1, 1, 2])
@every_case()
def test_whole_turns_of_a_measured_angle_change_nothing(case: Case, turns: int):
    system = case.system(0)
    model = dataclasses.replace(system.model, measurement_angles=(1,))
    record = simulate(system, 0, runs=4, steps=10)
    y = record.y / 10.0 if isinstance(model, LinearModel) else record.y
    turned = y.copy()
    turned[..., 1] += 2.0 * np.pi * turns
    filter = case.make(model)
    one, other = (
        track(filter, system.rows(4), record._replace(y=r), _numbers(*range(4)))
        for r in (y, turned)
    )
    for left, right in zip(one, other, strict=True):
        assert (np.abs(right.innovation[..., 1]) <= np.pi).all()
        assert_same(left, right, 1e-11)


# --- 7. covariances -------------------------------------------------------------------------------


LARGEST = 1e6
"""A run ends where a covariance exceeds this: drop-outs can leave a random system undetectable, and what has grown
by 16 digits cannot be definite in double precision."""


def _random_model(
    rng: np.random.Generator, name: str, n: int, p: int, q: int, spread: float
) -> LinearModel:
    """Any model that the filter accepts, badly scaled and not always detectable."""

    def scaled(k: int) -> np.ndarray:
        scale = 10.0 ** rng.uniform(-spread, spread, size=k)
        return random_covariance(rng, k) * scale * scale[:, None]

    matrices = {
        "A": random_transition(rng, n, rng.uniform(0.3, 1.02)), "C": rng.normal(size=(p, n)),
        "Q": scaled(n) * (rng.random() < 0.8), "R": scaled(p),
    }  # fmt: skip
    if any(case.name == name and "unknown-input" in case.laws for case in CASES):
        matrices["G"] = rng.normal(size=(n, q))
    if name in ("kf-umv-ui", "ulise"):
        rank = q if name == "kf-umv-ui" else rng.integers(q + 1)
        matrices["H"] = rng.normal(size=(p, rank)) @ rng.normal(size=(rank, q))
    return LinearModel(**matrices)


@pytest.mark.slow
@pytest.mark.parametrize("name", names())
@settings(derandomize=True, max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 6),
    p=st.integers(1, 4),
    q=st.integers(1, 3),
    spread=st.floats(0.0, 1.5),
    arriving=st.sampled_from([0.3, 0.8, 1.0]),
)
def test_covariances_stay_symmetric_and_positive_semidefinite(
    name: str, seed: int, n: int, p: int, q: int, spread: float, arriving: float
):
    rng = np.random.default_rng(seed)
    model = _random_model(rng, name, n, p, min(n, p, q), spread)
    filter = make(name, model)
    belief = filter.init(Gaussian(np.zeros((8, n)), random_covariance(rng, n)), rng=rng)
    for _ in range(20):
        belief = filter.predict(belief, rng=rng)
        assert_covariance(belief.cov)
        # Rounding of an update is as large as what it starts from, which may be far larger than its
        # result.
        before = np.linalg.eigvalsh(belief.cov)[..., -1]
        available = rng.random((8, p)) < arriving
        belief = filter.update(belief, rng.normal(size=(8, p)), rng=rng, available=available)
        assert_covariance(belief.cov, before)
        S = belief.innovation_cov  # nothing is carried on from it: symmetric to rounding is enough
        np.testing.assert_allclose(S, S.mT, rtol=0, atol=1e-13 * np.abs(S).max())
        assert (np.linalg.eigvalsh(S) > 0.0).all()
        if belief.input_cov is not None:
            assert_covariance(belief.input_cov)
        assert np.isfinite(belief.mean).all()
        if np.abs(belief.cov).max() > LARGEST:
            break


@pytest.mark.slow
@every_case("unknown-input", "linear")
def test_a_diverging_filter_raises_no_error_and_stays_finite(case: Case):
    """Measurements that leave the input undetectable make an unbiased filter diverge, here past every double."""
    for seed in range(4):
        system = case.system(seed)
        model = system.model
        unstable = dataclasses.replace(model, A=3.0 * model.A)
        filter, rng = case.make(unstable), np.random.default_rng(seed)
        belief = filter.init(system.rows(20))
        with np.errstate(all="ignore"):
            for _ in range(300):
                belief = filter.predict(belief, np.zeros((20, system.m)))
                available = rng.permuted(np.arange(model.p) < model.q, axis=-1) & np.ones(
                    (20, 1), bool
                )
                belief = filter.update(belief, rng.normal(size=(20, model.p)), available=available)
                for name, array in arrays(belief).items():
                    assert np.isfinite(array).all(), name


@pytest.mark.slow
@every_case("long")
def test_mean_and_covariance_stay_valid_over_ten_thousand_steps_with_missing_data(case: Case):
    steps, whole = 10_000, 1000
    unknown = {"G": [[0.0], [1.0]]} if "unknown-input" in case.laws else {}
    if case.name == "kf-umv-ui":
        unknown["H"] = [[0.0], [1.0]]
    model = LinearModel(
        A=[[1.0, 0.1], [0.0, 1.0]], C=np.eye(2), Q=np.diag([1e-4, 1e-2]), R=np.eye(2), **unknown
    )
    filter = case.make(model)
    rng = np.random.default_rng(0)
    measurements = rng.normal(size=(steps, 2))
    gaps = rng.random((steps, 2)) < 0.1
    gaps[-whole:] = False
    measurements[gaps] = np.nan
    belief = filter.init(Gaussian(np.zeros(2), np.eye(2)), rng=rng)
    largest = 0.0
    for k, y in enumerate(measurements):
        belief = filter.update(filter.predict(belief, rng=rng), y, rng=rng)
        if k % 97 == 0 or k == steps - whole - 1:
            assert_covariance(belief.cov)
            assert belief.healthy
            assert np.isfinite(belief.mean).all()
            largest = max(largest, float(belief.cov.max()))
    settled = filter.init(Gaussian(np.zeros(2), np.eye(2)), rng=rng)
    for _ in range(whole):
        settled = filter.update(filter.predict(settled, rng=rng), np.zeros(2), rng=rng)
    assert largest > 1.01 * settled.cov.max()  # the gaps were felt
    if "deterministic" in case.laws:  # members go on fluctuating
        # Rounding is forgotten as the gaps are: what is left is that of the last steps, a few units
        # of 1e-16 each.
        np.testing.assert_allclose(belief.cov, settled.cov, rtol=0, atol=1e-13)
