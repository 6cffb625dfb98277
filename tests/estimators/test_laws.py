"""The laws that every filter keeps, each stated once and tried on every case that it applies to."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.stats import chi2

from estimators import (
    Belief,
    FeedthroughBelief,
    Filter,
    Gaussian,
    LinearModel,
    make,
    names,
    nees,
    nis,
)
from estimators.kalman import with_input
from tests.estimators.cases import (
    CASES,
    INPUT_PRIOR,
    Case,
    arrays,
    assert_covariance,
    counted_directions,
    every_case,
    flat_prior_posterior,
    observable_directions,
    random_covariance,
    random_transition,
    simulate,
    some_measurements,
    textbook_kalman,
    track,
)

SEEDS = [pytest.param(seed, id=f"seed {seed}") for seed in (0, 1)]


def test_every_filter_has_a_case():
    assert {case.name for case in CASES} == set(names()) - {"enkf-sr"}  # another name of etkf


# --- linear and Gaussian -----------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
@every_case("kalman")
def test_on_a_linear_model_the_filter_is_the_kalman_filter(case: Case, seed: int):
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


# --- unknown input --------------------------------------------------------------------------------


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
def test_updates_are_least_squares_without_a_prior_of_the_input(case: Case, seed: int):
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
@every_case("unknown-input", "linear")
def test_the_error_does_not_depend_on_the_size_of_the_input(case: Case, seed: int):
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


# --- consistency ----------------------------------------------------------------------------------

RUNS, TIMES = 400, 200


def _share_inside(values: np.ndarray, degrees: int) -> float:
    """Share of the times at which the mean over the runs ``(times, runs)`` lies in its 95 % band."""
    low, high = chi2.interval(0.95, values.shape[1] * degrees)
    sums = values.sum(axis=1)
    return float(((low <= sums) & (sums <= high)).mean())


# Each mean lies in its band with probability 0.95. If the 200 times were independent, fewer than 90
# % of them would lie inside with probability 0.1 %. They are correlated, which spreads the share:
# over 300 other seeds (kf, kf-umv-ui, kf-umv-ui-wdf) it never fell below 90.5 %, so that the false
# alarm of one test is below 1 % (95 % confidence).


@pytest.mark.slow
@pytest.mark.parametrize(
    "dropouts", [False, True], ids=["every measurement arrives", "measurements drop out"]
)
@every_case("consistent")
def test_errors_are_as_large_as_the_filter_says(case: Case, dropouts: bool):
    """Errors of the state and of an unknown input are judged together."""
    system = case.system(1)
    model, rng = system.model, np.random.default_rng(21)
    available, d = None, None
    if dropouts:  # then d is not always seen, and its prior must be true
        available = some_measurements(rng, model.p, TIMES, RUNS)
        d = rng.normal(scale=np.sqrt(INPUT_PRIOR), size=(TIMES, RUNS, model.q)) if model.q else None
    record = simulate(system, 20, RUNS, TIMES, d)
    beliefs = track(case.make(model), system.rows(RUNS), record, available=available)
    values = []
    for k, b in enumerate(beliefs[1:], 1):
        truth = [record.x[k], *([_input_at(case, model, record.d, k)] if model.q else [])]
        values.append(nees(*with_input(b), np.concatenate(truth, -1)))
    assert _share_inside(np.array(values), model.n + model.q) >= 0.9


@pytest.mark.slow
@every_case("consistent")
def test_innovations_are_as_large_as_the_filter_says(case: Case):
    """``(e - F d)' S^-1 (e - F d)`` is chi-square with p - q degrees of freedom.

    ``F d`` is what unknown inputs explain of the innovation: d(k) through H, what H does not show
    of d(k-1) through C G.
    """
    system = case.system(1)
    model, filter = system.model, case.make(system.model)
    values = []
    for b in track(filter, system.rows(RUNS), simulate(system, 25, RUNS, TIMES))[1:]:
        e = b.innovation
        if model.q:
            late = model.C @ model.G @ (np.eye(model.q) - observable_directions(model.H))
            e = e - np.matvec(late if filter.input_delay else model.H, b.input_mean)
        if isinstance(b, FeedthroughBelief):
            e = e - np.matvec(model.H, b.feedthrough_mean)
        values.append(nis(e, b.innovation_cov))
    assert _share_inside(np.array(values), model.p - model.q) >= 0.9


# --- covariances ----------------------------------------------------------------------------------


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
        "Q": scaled(n) * (rng.random() < 0.8 or name == "steady-kf"), "R": scaled(p),
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
def test_beliefs_stay_valid_over_ten_thousand_steps_with_gaps(case: Case):
    steps, whole, rng = 10_000, 1000, np.random.default_rng(0)
    late = [[0.0], [1.0]]
    unknown = {"G": late} if "unknown-input" in case.laws else {}
    unknown |= {"H": late} if case.name == "kf-umv-ui" else {}
    A, Q = [[1.0, 0.1], [0.0, 1.0]], np.diag([1e-4, 1e-2])
    filter = case.make(LinearModel(A, np.eye(2), Q, np.eye(2), **unknown))
    y = rng.normal(size=(steps, 2))
    y[:-whole][rng.random((steps - whole, 2)) < 0.1] = np.nan
    start = Gaussian(np.zeros(2), np.eye(2))
    belief, settled, largest = filter.init(start, rng=rng), filter.init(start, rng=rng), 0.0
    for k in range(steps):
        belief = filter.update(filter.predict(belief, rng=rng), y[k], rng=rng)
        if k < whole:
            settled = filter.update(filter.predict(settled, rng=rng), np.zeros(2), rng=rng)
        if k % 97 == 0 or k == steps - whole - 1:
            assert_covariance(belief.cov)
            assert belief.healthy
            assert np.isfinite(belief.mean).all()
            largest = max(largest, float(belief.cov.max()))
    assert largest > 1.01 * settled.cov.max()  # the gaps were felt
    if "deterministic" in case.laws:  # members go on fluctuating
        # Rounding is forgotten as the gaps are: what is left is that of the last steps, a few units
        # of 1e-16 each.
        np.testing.assert_allclose(belief.cov, settled.cov, rtol=0, atol=1e-13)
