"""`adaptive-kf`: its noises against all measurements at once, where it settles, and what it then knows."""

import dataclasses

import numpy as np
import pytest

from estimators import Belief, Gaussian, LinearModel, Recovery, chi_square_band, make, nis
from tests.estimators import test_laws as laws
from tests.estimators.cases import (
    Case,
    System,
    assert_covariance,
    assert_same,
    kalman_system,
    random_covariance,
    simulate,
    track,
    turning_vehicle,
)  # fmt: skip


def _as_belief(adaptive: Belief) -> Belief:
    return Belief(**{name: getattr(adaptive, name) for name in Belief.__dataclass_fields__})


@pytest.mark.parametrize("system", [kalman_system(0), turning_vehicle(0)], ids=["kf", "ekf on a turning vehicle"])
def test_with_rates_of_0_it_is_the_kf(system: System):
    record = simulate(system, 0, 5, 15)
    available = np.random.default_rng(0).random(record.y.shape) < 0.7
    kf = make("kf" if isinstance(system.model, LinearModel) else "ekf", system.model)
    kf._programs = None  # the same NumPy
    filters = make("adaptive-kf", system.model, q_rate=0.0, r_rate=0.0), kf
    for one, other in zip(*(track(f, system.rows(5), record, available=available) for f in filters), strict=True):
        assert_same(_as_belief(one), other)
        np.testing.assert_array_equal(one.process_noise, np.broadcast_to(system.model.Q, one.process_noise.shape))


@pytest.mark.parametrize("seed", range(3))
def test_what_it_says_of_the_noises_is_what_all_measurements_say(seed: int):
    """A dense Gaussian of the start and all noises, given the measurements; a channel is missing now and then."""
    system, steps, rng = kalman_system(seed, n=3, p=2, m=1), 6, np.random.default_rng(seed)
    model, n, p = system.model, 3, 2
    record = simulate(system, seed, 1, steps)
    y, u = record.y[:, 0], record.u[:, 0]
    seen = rng.random((steps, p)) < 0.7
    seen[:, 0] = True
    # Columns: x(0), then w(k - 1) and v(k) of each step; w of the first is none.
    width = n + steps * (n + p)
    cov = np.zeros((width, width))
    cov[:n, :n] = system.cov
    state, rows, offsets, mean = np.eye(n, width), [], [], system.mean
    for k in range(steps):
        at = n + k * (n + p)
        cov[at : at + n, at : at + n] = model.Q if k else 0.0 * model.Q
        cov[at + n : at + n + p, at + n : at + n + p] = model.R
        if k:
            state, mean = model.A @ state + np.eye(n, width, at), model.A @ mean + model.B @ u[k - 1]
        rows.append(model.C @ state + np.eye(p, width, at + n))
        offsets.append(y[k] - model.C @ mean)
    adaptive, still = (make("adaptive-kf", model, q_rate=rate, r_rate=rate) for rate in (0.5, 0.0))
    belief = still.init(system.prior)
    for k in range(steps):
        belief = still.predict(belief, u[k - 1]) if k else belief
        learnt = adaptive.update(belief, y[k], available=seen[k])
        belief = still.update(belief, y[k], available=seen[k])
        M = np.concatenate([r[s] for r, s in zip(rows[: k + 1], seen[: k + 1], strict=True)])
        e = np.concatenate([r[s] for r, s in zip(offsets[: k + 1], seen[: k + 1], strict=True)])
        gain = cov @ M.T @ np.linalg.inv(M @ cov @ M.T)
        told, left = gain @ e, cov - gain @ M @ cov
        own = slice(n + k * (n + p), n + (k + 1) * (n + p))
        first = np.zeros((n + p, n + p))
        first[:n, :n] = model.Q * (k == 0)  # of a noise that there was not, nothing is learnt
        np.testing.assert_allclose(belief.noise_mean, told[own], rtol=0, atol=1e-10)
        np.testing.assert_allclose(belief.noise_cov, left[own, own] + first, rtol=0, atol=1e-10)
        if k:
            before = slice(own.start - n - p, own.start)
            moment = left[before, before] + np.outer(told[before], told[before])
            moment[:n, :n] += model.Q * (k == 1)
            learnt_Q, learnt_R = 2.0 * learnt.process_noise - model.Q, 2.0 * learnt.measurement_noise - model.R
            np.testing.assert_allclose(learnt_Q, moment[:n, :n], rtol=0, atol=1e-10)
            np.testing.assert_allclose(learnt_R, moment[n:, n:], rtol=0, atol=1e-10)
            assert_covariance(learnt_Q, 1.0)


def _wrong(system: System, q: float, r: float) -> LinearModel:
    return dataclasses.replace(system.model, Q=q * system.model.Q, R=r * system.model.R)


WALK = LinearModel([[0.95]], [[1.0]], [[1.0]], [[4.0]])
PLANE = LinearModel([[1.0, 1.0], [0.0, 1.0]], np.eye(2), np.diag([1.0, 0.5]), np.diag([1.0, 2.0]))


def _learnt(model: LinearModel, q: float, r: float, steps: int, runs: int, **rates: float) -> list[Belief]:
    n = model.n
    system = System(dataclasses.replace(model, B=np.zeros((n, 1))), np.zeros(n), np.eye(n), 1)
    record = simulate(system, 0, runs, steps)
    return track(make("adaptive-kf", _wrong(system, q, r), **rates), system.rows(runs), record)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "steps"), [(WALK, 8000), (PLANE, 12000)], ids=["walk", "place and velocity"])
def test_it_settles_at_the_true_noises_where_those_of_the_model_are_several_times_too_large_or_small(
    model: LinearModel, steps: int
):
    """The mean of 40 runs over the last 2,000 steps: with 5 standard errors, and 10 % for a rate that is not 0."""
    beliefs = _learnt(model, 5.0, 0.25, steps, 40)[-2000::20]
    for name, true in (("process_noise", model.Q), ("measurement_noise", model.R)):
        runs = np.mean([getattr(b, name) for b in beliefs], 0)
        scale = np.sqrt(np.outer(np.diag(true), np.diag(true)))
        error = 5.0 * runs.std(0, ddof=1) / np.sqrt(40)
        assert (error < 0.25 * scale).all()
        assert (np.abs(runs.mean(0) - true) < error + 0.1 * scale).all(), runs.mean(0)
    low, high = chi_square_band(40 * 100, model.p, 0.999)
    assert low < np.mean([nis(b.innovation, b.innovation_cov).mean() for b in beliefs]) * 0.99 < high


@pytest.mark.slow
@pytest.mark.parametrize(("q", "r", "rates"), [(1.0, 0.25, {"q_rate": 0.0}), (8.0, 1.0, {"r_rate": 0.0})])
def test_with_the_other_known_one_noise_is_found_soon(q: float, r: float, rates: dict[str, float]):
    beliefs = _learnt(WALK, q, r, 5000, 40, **rates)
    last = beliefs[-1000::20]
    for name, true in (("process_noise", 1.0), ("measurement_noise", 4.0)):
        runs = np.mean([getattr(b, name)[:, 0, 0] for b in last], 0)
        assert abs(runs.mean() - true) < 5.0 * runs.std(ddof=1) / np.sqrt(40) + 0.05 * true


def test_the_right_noises_stay_but_for_chance():
    """At the truth the expected change is none: 2,000 runs, 5 standard errors for each entry of a random system."""
    system = kalman_system(0)
    record = simulate(system, 0, 2000, 60)
    belief = track(make("adaptive-kf", system.model, q_rate=1e-4, r_rate=1e-4), system.rows(2000), record)[-1]
    for estimate, true in ((belief.process_noise, system.model.Q), (belief.measurement_noise, system.model.R)):
        error = estimate.std(0, ddof=1) / np.sqrt(2000)
        assert (np.abs(estimate.mean(0) - true) < 5.0 * error).all()
        assert (error > 0.0).all()


CASES = [
    Case("adaptive-kf", "adaptive-kf", kalman_system, frozenset(), {"q_rate": 0.05, "r_rate": 0.05}),
    Case("on a turning vehicle", "adaptive-kf", turning_vehicle, frozenset(), {"q_rate": 0.05, "r_rate": 0.05}),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.id)
def test_it_keeps_the_laws_of_every_filter_while_it_learns(case: Case):
    laws.test_nothing_that_is_passed_in_is_changed(case)
    laws.test_masking_every_measurement_equals_never_updating(case)
    laws.test_a_batch_may_have_several_axes(case)
    laws.test_a_batch_equals_a_loop_over_its_rows(case, 0)
    laws.test_masking_a_channel_equals_a_model_without_it(case, 0)
    laws.test_whole_turns_of_a_measured_angle_change_nothing(case, 2)
    for value in (np.nan, -1e300):
        laws.test_the_value_of_a_masked_measurement_has_no_effect(case, value)


def test_covariances_stay_positive_definite_in_long_runs_with_gaps_and_outliers():
    rng, system = np.random.default_rng(0), kalman_system(1)
    filter = make("adaptive-kf", system.model, q_rate=0.2, r_rate=0.2)
    belief = filter.init(system.rows(4))
    for k in range(500):
        y = rng.normal(size=(4, 3)) * (1e6 if k % 97 == 0 else 1.0)
        y[rng.random((4, 3)) < 0.4] = np.nan
        belief = filter.update(filter.predict(belief, rng.normal(size=(4, 2))), y)
        for cov in (belief.process_noise, belief.measurement_noise, belief.cov):
            assert_covariance(cov)
        assert (np.linalg.eigvalsh(belief.measurement_noise) > 0.0).all()
        assert np.isfinite(belief.mean).all()


def test_two_perfect_sensors_that_repeat_each_other_teach_as_much_as_one():
    C = np.array([[1.0, 0.0], [1.0, 0.0]])
    filters = [
        make("adaptive-kf", LinearModel(np.eye(2), rows, 0.1 * np.eye(2), np.zeros((len(rows),) * 2)), q_rate=0.5)
        for rows in (C, C[:1])
    ]
    beliefs = [filter.init(Gaussian(np.zeros(2), np.eye(2))) for filter in filters]
    for y in (5.0, 5.5, 5.2, 4.8):
        measurements = [y, y], [y]
        beliefs = [f.update(f.predict(b), r) for f, b, r in zip(filters, beliefs, measurements, strict=True)]
        assert beliefs[0].recovery == Recovery.PSEUDO_INVERSE
        np.testing.assert_allclose(beliefs[0].process_noise, beliefs[1].process_noise, rtol=0, atol=1e-10)
    assert np.abs(beliefs[0].process_noise - 0.1 * np.eye(2)).max() > 0.01


def test_a_measurement_beyond_all_numbers_teaches_nothing():
    filter = make("adaptive-kf", WALK, q_rate=0.1, r_rate=0.1)
    belief = filter.update(filter.predict(filter.init(Gaussian([0.0], [[1.0]]))), [1.0])
    for y in (1e200, 1.0, 1.0):
        belief = filter.update(filter.predict(belief), [y])
        for name in ("mean", "cov", "process_noise", "measurement_noise"):
            assert np.isfinite(getattr(belief, name)).all(), name
    np.testing.assert_allclose(belief.measurement_noise, 4.0, rtol=0.5)


def test_what_cannot_be_is_refused():
    for rate in (-0.1, 1.0, np.nan, "fast"):
        for name in ("q_rate", "r_rate"):
            with pytest.raises(ValueError, match=f"{name} must be at least 0 and below 1"):
                make("adaptive-kf", WALK, **{name: rate})
    for name in "QR":
        with pytest.raises(ValueError, match=f"adaptive-kf needs {name} as an array to begin with"):
            make("adaptive-kf", dataclasses.replace(WALK, **{name: lambda u: np.eye(1)}))


def test_a_model_for_each_row_begins_with_its_own_noises():
    Q = random_covariance(np.random.default_rng(0), 4, (3,))
    system = kalman_system(0)
    model = dataclasses.replace(system.model, Q=Q)
    np.testing.assert_array_equal(make("adaptive-kf", model).init(system.rows(3)).process_noise, Q)


@pytest.mark.parametrize("measurement", np.geomspace(1e150, 1e156, 13).tolist())
def test_no_measurement_makes_the_filter_deaf(measurement: float):
    filter = make("adaptive-kf", LinearModel([[0.9]], [[1.0]], [[0.1]], [[0.1]]))
    belief = filter.update(filter.init(Gaussian([0.0], [[1.0]])), [measurement])
    for _ in range(5):
        belief = filter.update(filter.predict(belief), [1.0])
        assert np.isfinite(belief.measurement_noise).all()
        assert belief.available.all()
