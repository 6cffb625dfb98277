"""`InteractingMultipleModels`: against FilterPy, its limits, its likelihood, and a target that manoeuvres."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator
from filterpy.kalman import KalmanFilter as FilterPy
from scipy.linalg import expm
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from estimators import (
    Belief,
    Delayed,
    Filter,
    Gaussian,
    InteractingMultipleModels,
    LinearModel,
    NonlinearModel,
    Recovery,
    by_age,
    chi_square_band,
    make,
    nees,
    run,
    wrap,
)
from tests.estimators import test_laws as laws
from tests.estimators.cases import (
    Case,
    System,
    assert_covariance,
    assert_same,
    kalman_system,
    random_covariance,
    simulate,
    some_measurements,
    track,
    turning_vehicle,
)  # fmt: skip

CHAIN = np.array([[0.9, 0.07, 0.03], [0.1, 0.8, 0.1], [0.05, 0.05, 0.9]])


def _modes(system: System, seed: int, name: str = "kf") -> list[Filter]:
    """The system's own filter, one that expects more of nature, and one of another kind of motion."""
    rng, model = np.random.default_rng(seed), system.model
    others = [{"Q": 10.0 * model.Q}]
    if isinstance(model, LinearModel):
        others.append({"A": model.A + 0.1 * rng.normal(size=model.A.shape), "R": random_covariance(rng, model.p)})
    return [make(name, dataclasses.replace(model, **changes)) for changes in ({}, *others)]


@pytest.mark.parametrize("seed", range(4))
def test_it_agrees_with_filterpy_on_random_systems(seed: int):
    system = kalman_system(seed, n=3 + seed % 2, p=2, m=1)
    filters, start = _modes(system, seed), np.array([0.5, 0.3, 0.2])
    record, others = simulate(system, seed, runs=1, steps=40), []
    for filter in filters:
        other, model = FilterPy(dim_x=system.model.n, dim_z=system.model.p, dim_u=1), filter.model
        other.F, other.B, other.H, other.Q, other.R = model.A, model.B, model.C, model.Q, model.R
        other.x, other.P = system.mean[:, None].copy(), system.cov.copy()
        others.append(other)
    theirs, imm = IMMEstimator(others, start, CHAIN), InteractingMultipleModels(filters, CHAIN, start)
    belief = imm.init(system.prior)
    for k in range(40):
        # FilterPy weighs the first measurement as if the chain had moved once before it: predict first.
        belief = imm.predict(belief, record.u[k, 0])
        theirs.predict(record.u[k, 0][:, None])
        # (Its mixture of predictions has the weights from before the chain moved: modes are compared.)
        np.testing.assert_allclose(belief.means, [other.x[:, 0] for other in others], rtol=0, atol=1e-9)
        belief = imm.update(belief, record.y[k, 0])
        theirs.update(record.y[k, 0][:, None])
        np.testing.assert_allclose(belief.mean, theirs.x[:, 0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(belief.cov, theirs.P, rtol=0, atol=1e-9)
        np.testing.assert_allclose(belief.probabilities, theirs.mu, rtol=0, atol=1e-9)
        np.testing.assert_allclose(belief.covs, [other.P for other in others], rtol=0, atol=1e-9)


def _as_belief(mixture: Belief) -> Belief:
    return Belief(**{name: getattr(mixture, name) for name in Belief.__dataclass_fields__})


@pytest.mark.parametrize("name", ["kf", "huber-kf", "robust-kf", "ekf", "iekf", "ukf"])
def test_of_one_model_it_is_that_filter_exactly(name: str):
    system = kalman_system(0) if name == "kf" else turning_vehicle(0)
    record = simulate(system, 0, 5, 15)
    available = some_measurements(np.random.default_rng(0), system.model.p, 15, 5)
    filter = make(name, system.model)
    one = track(InteractingMultipleModels([filter], [[1.0]]), system.rows(5), record, available=available)
    for mixture, belief in zip(one, track(filter, system.rows(5), record, available=available), strict=True):
        assert_same(_as_belief(mixture), belief)
        np.testing.assert_array_equal(mixture.probabilities, 1.0)


def test_of_equal_models_it_is_that_filter_and_the_chain_runs_as_it_does():
    system = kalman_system(1)
    record, filter = simulate(system, 1, 4, 12), make("kf", system.model)
    imm = InteractingMultipleModels([filter] * 3, CHAIN, [1.0, 0.0, 0.0])
    probabilities = np.array([1.0, 0.0, 0.0])
    pairs = zip(track(imm, system.rows(4), record), track(filter, system.rows(4), record), strict=True)
    for k, (mixture, belief) in enumerate(pairs):
        probabilities = probabilities @ CHAIN if k else probabilities
        assert_same(_as_belief(mixture), belief, 1e-12)
        np.testing.assert_allclose(mixture.probabilities, np.tile(probabilities, (4, 1)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("missing", [False, True], ids=["every measurement arrives", "measurements are missing"])
def test_modes_that_never_change_are_weighed_by_all_that_they_said(missing: bool):
    """With a chain that stays nothing is mixed: the evidence of a mixture is the mixture of the evidence."""
    system = kalman_system(2)
    filters, start = _modes(system, 2), np.array([0.2, 0.5, 0.3])
    record = simulate(system, 2, 1, 25)
    record = record._replace(y=record.y[:, 0], u=record.u[:, 0])
    available = some_measurements(np.random.default_rng(2), 3, 25) if missing else np.ones((25, 3), bool)
    mixture = track(InteractingMultipleModels(filters, np.eye(3), start), system.prior, record, available=available)
    evidence = np.log(start)
    alone = [track(f, system.prior, record, available=available) for f in filters]
    for k, beliefs in enumerate(zip(*alone, strict=True)):
        seen = available[k]
        if seen.any():
            evidence = evidence + [
                multivariate_normal(cov=b.innovation_cov[seen][:, seen]).logpdf(b.innovation[seen]) for b in beliefs
            ]
        np.testing.assert_allclose(
            sum(b.log_likelihood for b in mixture[: k + 1]), logsumexp(evidence), rtol=1e-12, atol=1e-12
        )
        np.testing.assert_allclose(mixture[k].probabilities, np.exp(evidence - logsumexp(evidence)), rtol=0, atol=1e-11)
        if not seen.any():
            assert mixture[k].log_likelihood == 0.0


def test_mean_and_covariance_are_those_of_draws_from_the_modes():
    """Of 200,000 draws, with 5 standard errors: false alarm below 1e-5."""
    system = kalman_system(3)
    imm = InteractingMultipleModels(_modes(system, 3), CHAIN)
    belief = track(imm, system.rows(1), simulate(system, 3, 1, 6))[-1][0]
    rng, count = np.random.default_rng(3), 200_000
    mode = rng.choice(3, count, p=belief.probabilities)
    roots = np.linalg.cholesky(belief.covs)
    draws = belief.means[mode] + np.matvec(roots[mode], rng.normal(size=(count, 4)))
    scale = np.sqrt(np.diagonal(belief.cov))
    assert (np.abs(draws.mean(0) - belief.mean) < 5.0 * scale / np.sqrt(count)).all()
    assert (np.abs(np.cov(draws.T) - belief.cov) < 5.0 * 2.0 * np.outer(scale, scale) / np.sqrt(count)).all()


def test_angles_of_modes_are_averaged_the_short_way_round():
    """Two modes that turn to either side of the cut: their mean lies there, not on the other side."""

    def turned(by: float) -> Filter:
        model = NonlinearModel(
            lambda x, u: wrap(x + by), lambda x, u: x, [[1e-4]], [[0.01]], state_angles=(0,), measurement_angles=(0,)
        )
        return make("ekf", model)

    imm = InteractingMultipleModels([turned(0.1), turned(-0.1)], [[0.5, 0.5], [0.5, 0.5]])
    belief = imm.predict(imm.init(Gaussian([np.pi], [[1e-4]])))
    np.testing.assert_allclose(np.abs(belief.means), np.pi - 0.1, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.abs(wrap(belief.mean)), np.pi, rtol=0, atol=1e-12)
    assert belief.cov[0, 0] == pytest.approx(0.01 + 2e-4, rel=1e-9)
    belief = imm.update(belief, [-np.pi])
    assert np.abs(belief.innovation[0]) < 1e-9
    np.testing.assert_allclose(belief.probabilities, 0.5, rtol=0, atol=1e-9)
    again = imm.update(imm.predict(belief), [np.pi - 1e-3])
    assert np.abs(wrap(again.mean - np.pi)).max() < 0.1


# --- the contract -----------------------------------------------------------------------------------


class _Several(Case):
    """A case whose filter has several models: the system's own and its variants."""

    def make(self, model: Any) -> Filter:
        changes = ({}, {"Q": 9.0 * model.Q})
        filters = [make(self.name, dataclasses.replace(model, **change)) for change in changes]
        return InteractingMultipleModels(filters, [[0.95, 0.05], [0.1, 0.9]])


CASES = [
    _Several("imm", "kf", kalman_system, frozenset(), {}),
    _Several("imm on a turning vehicle", "ekf", turning_vehicle, frozenset(), {}),
]
LAWS = [
    laws.test_nothing_that_is_passed_in_is_changed, laws.test_masking_every_measurement_equals_never_updating,
    laws.test_a_batch_may_have_several_axes,
]  # fmt: skip
SEEDED = [laws.test_a_batch_equals_a_loop_over_its_rows, laws.test_masking_a_channel_equals_a_model_without_it]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.id)
def test_it_keeps_the_laws_of_every_filter(case: Case, law: Any):
    law(case)


@pytest.mark.parametrize("law", SEEDED)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.id)
def test_it_keeps_the_laws_that_take_a_seed(case: Case, law: Any):
    law(case, 0)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.id)
def test_what_is_missing_has_no_effect(case: Case):
    for value in (np.nan, np.inf, -1e300, 0.0):
        laws.test_the_value_of_a_masked_measurement_has_no_effect(case, value)
    laws.test_a_measurement_that_is_not_finite_counts_as_missing(case, np.nan)
    laws.test_whole_turns_of_a_measured_angle_change_nothing(case, -3)
    laws.test_a_measurement_covariance_that_is_passed_replaces_that_of_the_model(case)


def test_a_model_for_each_row_and_other_units():
    laws.test_a_model_for_each_row_equals_a_filter_for_each_model(CASES[0])


def test_rows_are_chosen_and_replaced():
    system = kalman_system(0)
    imm, record = CASES[0].make(system.model), simulate(system, 0, 4, 3)
    belief, mask = track(imm, system.rows(4), record)[-1], np.array([False, True, True, False])
    merged = belief.with_rows(mask, imm.init(system.rows(4))[mask])
    assert_same(merged[~mask], belief[~mask])
    np.testing.assert_array_equal(merged.probabilities[mask], 0.5)
    np.testing.assert_array_equal(merged.means[mask], np.broadcast_to(system.mean, (2, 2, 4)))


def test_no_measurement_makes_probabilities_that_are_none():
    """Measurements far beyond what any mode expects, modes that cannot be, and a measurement beyond all numbers."""
    system = kalman_system(1)
    imm = InteractingMultipleModels(_modes(system, 1), np.eye(3), [0.0, 1.0, 0.0])
    belief = imm.init(system.rows(3))
    for y in (1e3, 1e9, -1e160, 1e308, 0.0):
        belief = imm.predict(belief, np.zeros((3, 2)))
        measurement = np.full((3, 3), y)
        measurement[2] = np.nan
        belief = imm.update(belief, measurement)
        np.testing.assert_allclose(belief.probabilities, [[0.0, 1.0, 0.0]] * 3, rtol=0, atol=1e-15)
        for name in ("mean", "cov", "means", "covs", "log_likelihood", "innovation", "innovation_cov"):
            assert np.isfinite(getattr(belief, name)).all(), name
        assert_covariance(belief.cov, np.abs(belief.cov).max())


def test_a_mode_that_fails_loses_its_probability_and_no_other_row_or_mode_its_own():
    good = NonlinearModel(lambda x, u: x, lambda x, u: x, [[0.01]], [[0.1]])
    bad = dataclasses.replace(good, measurement=lambda x, u: np.sqrt(x))  # of a negative number in the second row
    imm = InteractingMultipleModels([make("ekf", good), make("ekf", bad)], [[0.9, 0.1], [0.1, 0.9]])
    belief = imm.update(imm.init(Gaussian([[1.0], [-1.0]], [[0.01]])), [[1.0], [-1.0]])
    np.testing.assert_allclose(belief.probabilities[1], [1.0, 0.0])
    assert 0.1 < belief.probabilities[0, 0] < 0.9
    np.testing.assert_array_equal(belief.recovery, Recovery.USUAL)
    np.testing.assert_allclose(belief.mean[1], [-1.0], rtol=0, atol=1e-12)
    back = imm.update(imm.predict(belief), [[1.0], [-1.0]])
    assert np.isfinite(back.mean).all()
    lost = imm.predict(belief, None)
    lost = imm.predict(lost.replace(means=np.where(np.arange(2)[:, None] == 0, np.nan, lost.means)), None)
    assert np.isfinite(lost.mean).all()  # the other mode speaks for it
    assert imm.update(lost, [[1.0], [-1.0]]).healthy.all()
    nothing = imm.update(lost.replace(means=np.full_like(lost.means, np.nan)), [[1.0], [1.0]])
    np.testing.assert_array_equal(nothing.recovery, Recovery.PRIOR)
    assert np.isfinite(nothing.mean).all()


def test_what_does_not_fit_is_refused_in_a_sentence():
    one, two = make("kf", kalman_system(0).model), make("kf", kalman_system(0, n=3).model)
    chain = [[0.9, 0.1], [0.1, 0.9]]
    for arguments, error, sentence in (
        (([], [[1.0]]), ValueError, "filters must be one for each mode, got none"),
        ((None, None), TypeError, "needs a filter whose belief is a mean and a covariance, got None"),
        (([one.model], [[1.0]]), TypeError, r"needs a filter whose belief is a mean and a covariance, got [^\n]*$"),
        (([one, "kf"], chain), TypeError, "needs a filter whose belief is a mean and a covariance, got 'kf'"),
        (([one, make("etkf", one.model)], chain), TypeError, "mean and a covariance, got EnsembleTransformFilter"),
        (([one, two], chain), ValueError, r"filters must have the same states, measurements and angles: mode 0 has"),
        (([one, one], [[1.0]]), ValueError, r"transition has shape \(1, 1\), expected \(2, 2\)"),
        (([one, one], [[0.9, 0.2], [0.1, 0.9]]), ValueError, "transition must be probabilities"),
        (([one, one], [[1.1, -0.1], [0.1, 0.9]]), ValueError, "transition must be probabilities"),
        (([one, one], chain, [0.5, 0.6]), ValueError, "probabilities must be probabilities"),
        (([one, one], chain, [1.0]), ValueError, r"probabilities has shape \(1,\), expected \(2,\)"),
        (([one, one], chain, [np.nan, 1.0]), ValueError, "probabilities must be probabilities"),
    ):
        with pytest.raises(error, match=sentence):
            InteractingMultipleModels(*arguments)
    imm = InteractingMultipleModels([one, one], chain)
    belief = imm.init(kalman_system(0).prior)
    with pytest.raises(ValueError, match="the model has B: give the known input u"):
        imm.predict(belief)


# --- systems that switch ----------------------------------------------------------------------------


def test_on_a_system_that_switches_as_it_is_told_errors_are_as_large_as_it_says():
    """Noise of two sizes, a Markov chain between them: 2,000 runs, each of 60 steps.

    The IMM merges histories of modes, so its law is not exact: the mean NEES, whose band has a half-width of 4 %,
    lies within 6 % of n. A filter that is told the average noise is off by more than that at once.
    """
    rng, runs, chain = np.random.default_rng(4), 2000, np.array([[0.95, 0.05], [0.1, 0.9]])
    A, C, R = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.array([[1.0]])
    noises = np.stack([np.diag([0.0, 1e-4]), np.diag([0.0, 9.0])])
    filters = [make("kf", LinearModel(A, C, Q, R)) for Q in noises]
    imm, mode, x = InteractingMultipleModels(filters, chain), rng.integers(0, 2, runs), rng.normal(size=(runs, 2))
    belief = imm.init(Gaussian(np.zeros((runs, 2)), np.eye(2)))
    values, right = [], []
    for _ in range(60):
        mode = (rng.random(runs) > chain[mode, 0]).astype(int)
        x = x @ A.T + rng.normal(size=(runs, 2)) * np.sqrt(noises[mode].diagonal(0, -2, -1))
        belief = imm.update(imm.predict(belief), x[:, :1] + rng.normal(size=(runs, 1)))
        values.append(nees(belief.mean, belief.cov, x).mean())
        right.append(np.take_along_axis(belief.probabilities, mode[:, None], -1).mean())
    low, high = chi_square_band(runs, 2)
    assert 0.98 * low < np.mean(values[10:]) < 1.02 * high
    assert np.mean(right[10:]) > 0.7


def _flight() -> tuple[np.ndarray, np.ndarray]:
    """Place and velocity ``(100, 4)`` every 5 s, and where it turns: 90 s at 1 deg/s, later 30 s at -3 deg/s."""
    x, states, turning = np.array([25e3, 10e3, -120.0, 0.0]), [], []
    for seconds, rate in ((125, 0.0), (90, 1.0), (125, 0.0), (30, -3.0), (125, 0.0)):
        for _ in range(seconds // 5):
            angle, w = np.deg2rad(5.0 * rate), np.deg2rad(rate)
            c, s = np.cos(angle), np.sin(angle)
            moves = np.array([[s, c - 1.0], [1.0 - c, s]]) / w if rate else 5.0 * np.eye(2)
            x = np.concatenate([x[:2] + moves @ x[2:], np.array([[c, -s], [s, c]]) @ x[2:]])
            states.append(x)
            turning.append(rate != 0.0)
    return np.array(states), np.array(turning)


def test_an_aircraft_that_turns():
    """Bar-Shalom, Li & Kirubarajan (2001), sec. 11.7.4: air traffic control, places to 100 m every 5 s.

    Two models of constant velocity, pushed by accelerations of 0.1 and of 2 m/s^2. What is published of it: the second
    takes over in turns and the first on straight legs, where the IMM errs far less than a Kalman filter that can follow
    turns; in turns it errs far less than one that cannot, and altogether less than either, or one between them.
    """
    states, turning = _flight()
    A, push = np.eye(4) + 5.0 * np.eye(4, k=2), np.concatenate([12.5 * np.eye(2), 5.0 * np.eye(2)])
    sizes = (0.1, 2.0, 1.0)
    filters = [make("kf", LinearModel(A, np.eye(2, 4), a**2 * push @ push.T, 1e4 * np.eye(2))) for a in sizes]
    imm = InteractingMultipleModels(filters[:2], expm(5.0 * np.array([[-0.005, 0.005], [0.04, -0.04]])))
    rng, runs = np.random.default_rng(0), 200
    measurements = states[:, None, :2] + 100.0 * rng.normal(size=(len(states), runs, 2))
    start = Gaussian(np.concatenate([measurements[0], np.zeros((runs, 2))], -1), np.diag([1e4, 1e4, 9e4, 9e4]))
    beliefs = [filter.init(start) for filter in (imm, *filters)]
    errors, turns = [], []
    for x, y in zip(states[1:], measurements[1:], strict=True):
        beliefs = [f.update(f.predict(b), y) for f, b in zip((imm, *filters), beliefs, strict=True)]
        errors.append([np.square((b.mean - x)[:, :2]).sum(-1) for b in beliefs])
        turns.append(beliefs[0].probabilities[:, 1].mean())
    squares, turns, turning = np.array(errors)[10:], np.array(turns)[10:], turning[11:]  # (times, 4, runs)
    for other in range(1, 4):  # altogether: paired, beyond 5 standard errors
        gain = (squares[:, other] - squares[:, 0]).mean(0)
        assert gain.mean() > 5.0 * gain.std(ddof=1) / np.sqrt(runs)
    turn, straight = (np.sqrt(squares[m].mean((0, 2))) for m in (turning, ~turning))
    assert straight[0] < 0.9 * straight[2]
    assert turn[0] < 0.5 * turn[1]
    for k in range(len(turns)):  # twenty seconds into a turn, and fifty after it
        assert turns[k] > 0.5 or not turning[max(k - 4, 0) : k + 1].all()
        assert turns[k] < 0.25 or turning[max(k - 9, 0) : k + 1].any()


def test_a_mode_for_which_a_measurement_is_impossible_does_not_win():
    """Two sensors without noise that disagree: densities of one and of two directions do not compare."""
    perfect, noisy = (LinearModel([[1.0]], [[1.0], [1.0]], [[1.0]], R) for R in (np.zeros((2, 2)), 0.01 * np.eye(2)))
    imm = InteractingMultipleModels([make("kf", perfect), make("kf", noisy)], [[0.9, 0.1], [0.1, 0.9]])
    predicted = imm.predict(imm.init(Gaussian([0.0], [[1.0]])))
    belief = imm.update(predicted, [0.5, 0.9])
    np.testing.assert_allclose(belief.probabilities, 0.5, rtol=0, atol=1e-15)
    assert np.isfinite(belief.mean).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("measurement", [1e160, 1e200, -1e306])
def test_an_absurd_measurement_leaves_numbers_and_the_next_ones_what_they_are(measurement: float):
    slow, fast = (LinearModel([[1.0]], [[1.0]], [[q]], [[1.0]]) for q in (1.0, 9.0))
    imm = InteractingMultipleModels([make("kf", slow), make("kf", fast)], [[0.9, 0.1], [0.1, 0.9]])
    belief = imm.update(imm.predict(imm.init(Gaussian([0.0], [[1.0]]))), [measurement])
    for _ in range(30):
        assert np.isfinite(belief.mean).all()
        assert np.isfinite(belief.cov).all()
        np.testing.assert_allclose(belief.probabilities.sum(-1), 1.0, rtol=1e-12)
        belief = imm.update(imm.predict(belief), [1.0])


def test_late_rows_are_repeated_by_modes_of_which_one_has_a_model_for_each_row():
    one = LinearModel(np.eye(1), np.eye(1), np.eye(1), np.eye(1))
    each = LinearModel(np.eye(1), np.eye(1), np.array([[[1.0]], [[4.0]]]), np.eye(1))
    imm = InteractingMultipleModels([make("kf", one), make("kf", each)], [[0.9, 0.1], [0.1, 0.9]])
    y = np.random.default_rng(0).normal(size=(4, 2, 1))
    delay = np.zeros((4, 2, 1), int)
    delay[1, 0] = delay[2, 0] = 1
    prior = Gaussian(np.zeros((2, 1)), np.eye(1))
    in_time, late = run(imm, prior, y), run(Delayed(imm, 1), prior, by_age(y, delay))
    np.testing.assert_allclose(late.mean[-1], in_time.mean[-1], rtol=0, atol=1e-13)
