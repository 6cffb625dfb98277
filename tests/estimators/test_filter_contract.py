"""What every filter promises its user: names, refusals, missing measurements, rows, angles."""

import copy
import dataclasses
import pickle
from functools import partial
from typing import Any

import numpy as np
import pytest

from estimators import (
    Belief,
    EnsembleFilter,
    Filter,
    Gaussian,
    LinearModel,
    NonlinearModel,
    RandomKeys,
    make,
    names,
    stacked,
)
from estimators.kalman import with_input
from tests.estimators.cases import (
    Case,
    arrays,
    assert_close,
    assert_same,
    input_as_state,
    one_of_each,
    simulate,
    some_cases,
    track,
    unknown_input_system,
)
from tests.refusals import refusal, refused

I2 = np.eye(2)


def _linear(**changes) -> LinearModel:
    return LinearModel(**{"A": I2, "C": I2, "Q": I2, "R": I2, **changes})


def _nonlinear(**changes) -> NonlinearModel:
    return NonlinearModel(
        **{"transition": lambda x, u: x, "measurement": lambda x, u: x, "Q": I2, "R": I2, **changes}
    )


# --- building a filter ----------------------------------------------------------------------------


def test_an_unknown_name_is_answered_with_the_nearest():
    message = refusal(ValueError, make, "kf-umw-ui", _linear())
    assert message.startswith("unknown filter 'kf-umw-ui' (did you mean 'kf-umv-ui'?)")
    assert all(name in message for name in names())


@some_cases("kf", "enkf", "kf-umv-ui")
def test_an_unknown_option_is_named_with_those_that_exist(case: Case):
    message = refusal(TypeError, make, case.name, case.system(0).model, colour="red")
    assert message.startswith(f"{case.name} has no option 'colour'")
    assert all(option in message for option in case.options)


@one_of_each()
def test_a_filter_says_what_it_is(case: Case):
    system = case.system(0)
    filter, q = case.make(system.model), system.model.q
    belief = filter.init(system.rows(2), rng=np.random.default_rng(0))
    assert filter.name == case.name
    assert f"n={system.model.n}" in repr(filter)
    assert type(belief) is filter.record
    assert (belief.input_mean is None) == (belief.input_cov is None) == (filter.input_delay is None)
    assert (filter.input_delay is None) == (q == 0)
    assert (belief.ensemble is None) == (not isinstance(filter, EnsembleFilter))
    for same in (pickle.loads(pickle.dumps(belief)), copy.deepcopy(belief), belief.replace()):
        assert type(same) is type(belief)
        assert_same(same, belief)


FIRST, SECOND = [[1.0], [0.0]], [[0.0], [1.0]]
UNKNOWN_INPUT = {
    name: _linear(G=FIRST, H=FIRST if name == "kf-umv-ui" else None)
    for name in ("kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise")
}
HIDDEN = _linear(C=[[1.0, 0.0]], R=[[1.0]], G=SECOND)  # no measurement shows its input
ALIKE = np.ones((2, 2))  # two inputs that no measurement tells apart
NONLINEAR_ONES = "for a nonlinear one use kf-umv-ui, without feedthrough ekf-ui-wdf or ukf-umv"
RANK = r"needs rank\({}\) = {} unknown inputs?, got {}: measure "
ADVICE = "the input, or a state that it drives directly, by a measurement that no other"
KF, ENKF, UMV = make("kf", _linear()), make("enkf", _linear()), make("kf-umv-ui", _linear(H=I2))
PRIOR, Y, KEYS = Gaussian(np.zeros((5, 2)), I2), np.zeros((5, 2)), RandomKeys.seeded(range(5))
BELIEF, MEMBERS = KF.init(PRIOR), ENKF.init(PRIOR, KEYS)
BUILT: list[tuple[str, Any, dict[str, Any], str]] = [
    ("kf", {"A": I2}, {}, "^model must be a LinearModel or a NonlinearModel, got dict"),
    ("kf", _nonlinear(), {}, "^kf needs a LinearModel: use ekf"),
    ("kf-umv-ui", _linear(G=I2, H=ALIKE), {}, RANK.format("H", 2, 1)),
    ("kf-umv-ui", _linear(G=I2, H=np.stack([I2, ALIKE, I2])), {}, RANK.format("H", 2, 1)),
    ("kf-umv-ui", HIDDEN, {}, RANK.format("H", 1, 0) + "the input or use ekf-ui-wdf, or "),
    ("kf-umv-ui-wdf", _linear(G=FIRST, H=SECOND), {}, "needs H = 0 .*use kf-umv-ui"),
    ("ukf-umv", _linear(G=FIRST, H=lambda u: np.zeros((2, 1))), {}, r"needs H = 0 \(no feed"),
    *((name, HIDDEN, {}, RANK.format("C G", 1, 0)) for name in ("kf-umv-ui-wdf", "ekf-ui-wdf")),
    ("ukf-umv", _nonlinear(G=ALIKE), {}, RANK.format("C G", 2, 1)),
    ("ukf-umv", _nonlinear(G=I2, R=[[1.0]]), {}, RANK.format("C G", 2, 1)),
    ("ulise", HIDDEN, {}, RANK.format(r"H\) \+ rank\(C2 G2", 1, 0) + ADVICE),
    # One input is fed through; in the second row the other drives just the state that this hides.
    ("ulise", _linear(G=np.stack([I2 * SECOND, I2[::-1] * FIRST]), H=I2 * FIRST), {},
     RANK.format(r"H\) \+ rank\(C2 G2", 2, 1) + ADVICE),
    *((name, _linear(), {}, "needs an unknown input") for name in UNKNOWN_INPUT),
    *((name, _nonlinear(G=FIRST, H=FIRST), {}, f"^{name} needs a LinearModel: {NONLINEAR_ONES}")
      for name in ("kf-umv-ui-wdf", "ulise")),
    *((name, UNKNOWN_INPUT[name], {"input_prior": value}, f"^input_prior .*{problem}")
      for name in UNKNOWN_INPUT for value, problem in [
          (-1.0, "positive semidefinite"), (0.0, "positive definite"), (I2, "shape"),
          ([1.0], "shape"), (np.nan, "finite")]),
    ("kf", _linear(), {"input_cov": 1.0}, "input_cov needs an unknown input"),
    ("kf", _linear(G=FIRST), {"input_cov": I2}, "input_cov has shape"),
    ("kf", _linear(G=FIRST), {"input_cov": -1.0}, "input_cov must be positive semidefinite"),
]  # fmt: skip
REFUSED: list[tuple[Any, str]] = [
    *((partial(make, name, model, **options), words) for name, model, options, words in BUILT),
    *((partial(KF.update, BELIEF, **{"y": Y} | {name: value}), f"^{name} has shape .*expected")
      for name, value in [
        ("y", np.zeros((5, 1))), ("y", np.zeros((2, 5, 2))), ("available", np.ones((5, 3), bool)),
        ("available", np.ones((4, 2), bool)), ("R", np.eye(3)), ("R", np.tile(I2, (4, 1, 1)))]),
    (partial(KF.init, Gaussian(np.zeros(3), np.eye(3))), "the prior is for 3 states, the model ha"),
    (partial(BELIEF.with_rows, np.ones(5, bool), UMV.init(PRIOR)),
     "cannot merge Belief and ObservedInputBelief: they are of different filters"),
    (partial(UMV.predict, BELIEF),
     r"^belief must be of type ObservedInputBelief, got Belief: begin with init\(prior\)"),
    *((partial(step, **rng), sentence)
      for step in (partial(ENKF.init, PRIOR), partial(ENKF.predict, MEMBERS),
                   partial(ENKF.update, MEMBERS, Y))
      for rng, sentence in [
          ({}, "^enkf draws random numbers: pass rng"),
          ({"rng": KEYS[:2]}, r"^rng has keys for rows \(2,\), expected \(5,\)")]),
    *((partial(stacked, model), "^stacked needs an unknown input")
      for model in (_linear(), _nonlinear(), _linear(G=FIRST, delayed_feedthrough=True))),
]  # fmt: skip


@pytest.mark.parametrize(("call", "sentence"), REFUSED)
def test_what_does_not_fit_is_refused_in_one_sentence(call: Any, sentence: str):
    with refused((ValueError, TypeError), sentence):
        call()


@one_of_each()
def test_one_measurement_mask_noise_or_input_serves_every_row(case: Case):
    system, rng = case.system(0), RandomKeys.seeded(range(3))
    filter, p = case.make(system.model), system.model.p
    u, y, mask, R = (
        np.full(system.m, 0.3),
        np.arange(1.0, p + 1.0),
        np.arange(p) != 1,
        2.0 * np.eye(p),
    )

    def updated(*rows: int):
        u_, y_, mask_, R_ = (np.broadcast_to(a, (*rows, *a.shape)) for a in (u, y, mask, R))
        predicted = filter.predict(filter.init(system.rows(3), rng=rng), u_, rng=rng)
        return filter.update(predicted, y_, available=mask_, R=R_, rng=rng)

    assert_same(updated(), updated(3), 1e-13, ignore=["u"])
    assert_same(updated()[1:], updated(3)[1:], 1e-13, ignore=["u"])  # rows stay rows


# --- beliefs and their rows -----------------------------------------------------------------------


def _run(
    case: Case, rows: int, steps: int = 4, seed: int = 0
) -> tuple[Filter, Belief, np.ndarray, np.ndarray]:
    """A filter, a prediction for a batch of rows, the measurement that comes next, and the last known input."""
    system = case.system(seed)
    filter = case.make(system.model)
    record = simulate(system, seed, rows, steps)
    belief = track(filter, system.rows(rows), record._replace(y=record.y[:-1], u=record.u))[-1]
    return filter, filter.predict(belief, record.u[-2]), record.y[-1], record.u[-1]


@one_of_each("deterministic")
def test_rows_of_a_belief_are_chosen_by_mask_index_or_slice(case: Case):
    filter, predicted, y, _ = _run(case, 5)
    belief = filter.update(predicted, y)
    mask = np.array([True, False, True, True, False])
    for rows in (mask, [0, 3], slice(1, 4), 2):
        part = belief[rows]
        for name, array in arrays(belief).items():
            np.testing.assert_array_equal(getattr(part, name), array[rows], err_msg=name)
    # A part goes on like the whole.
    assert_same(filter.update(predicted[mask], y[mask]), belief[mask], 1e-12)


@one_of_each("deterministic")
def test_rows_of_a_belief_are_replaced_in_order(case: Case):
    filter, predicted, y, u = _run(case, 5)
    belief, mask = filter.update(predicted, y), np.array([False, True, False, True, False])
    other = filter.update(predicted[[4, 0]], y[[4, 0]] + 1.0)
    merged = belief.with_rows(mask, other)
    assert_same(merged[~mask], belief[~mask])
    assert_same(merged[mask], other)
    assert_same(belief, filter.update(predicted, y))
    assert_same(filter.predict(merged, u)[mask], filter.predict(other, u[mask]), 1e-12)


def test_a_fresh_row_joins_others_as_one_without_a_measurement():
    fresh = KF.init(PRIOR)[:2]
    updated = KF.update(fresh, np.ones(2))
    mixed = updated.with_rows(np.array([True, False]), fresh[:1])
    np.testing.assert_array_equal(mixed.mean, [fresh.mean[0], updated.mean[1]])
    np.testing.assert_array_equal(mixed.innovation, [[0.0, 0.0], [1.0, 1.0]])
    np.testing.assert_array_equal(mixed.innovation_cov, [I2, 2.0 * I2])
    np.testing.assert_array_equal(mixed.available, [[False, False], [True, True]])
    assert_same(fresh.with_rows(np.array([False, True]), updated[1:]), mixed)


# --- angles ---------------------------------------------------------------------------------------


def test_a_measurement_that_is_no_angle_is_not_wrapped():
    filter = make("kf", _linear(measurement_angles=(1,)))
    innovation = filter.update(filter.init(Gaussian([10.0, 10.0], I2)), [0.0, 0.0]).innovation
    np.testing.assert_allclose(innovation, [-10.0, 4.0 * np.pi - 10.0], rtol=0, atol=1e-14)


# --- an unknown input that the measurements leave unseen ------------------------------------------


@pytest.mark.parametrize("noise", [1.0, 1e6, 1e12])
@pytest.mark.parametrize("name", UNKNOWN_INPUT)
def test_the_observable_direction_is_unbiased_for_any_noise(name: str, noise: float):
    shown = np.array([[1.0, 1.0], [1.0, -1.0], [0.0, 0.5]])
    unknown = {"G": np.eye(3, 2), "H": shown} if name == "kf-umv-ui" else {"G": shown}
    model = LinearModel(A=0.8 * np.eye(3), C=np.eye(3), Q=np.eye(3), R=noise * np.eye(3), **unknown)
    filter = make(name, model, input_prior=noise)
    predicted = filter.predict(filter.init(Gaussian(np.zeros(3), noise * np.eye(3))))
    mask, change = [True, False, False], np.array([3.0, -7.0])
    before, after = (
        filter.update(predicted, y, available=mask) for y in (np.zeros(3), shown @ change)
    )
    np.testing.assert_allclose(after.input_mean - before.input_mean, [-2.0, -2.0], rtol=1e-10)
    np.testing.assert_allclose(after.input_observed, 0.5, rtol=1e-12)


@pytest.mark.parametrize("q", [1, 2])
def test_an_input_that_shows_by_rounding_alone_counts_as_unseen(q: int):
    """A sensor turned by exactly 90 degrees: its row of C G is cos(pi / 2) = 6e-17, and means 0."""
    I3, turned = np.eye(3), np.cos(np.pi / 2)
    C = np.vstack([I3, [turned, 1.0, turned]])
    model = LinearModel(0.5 * I3, C, I3, np.eye(4), G=I3[:, [0, 2][:q]])
    filter = make("kf-umv-ui-wdf", model)
    predicted = filter.predict(filter.init(Gaussian(np.zeros(3), I3)))
    after = filter.update(predicted, np.ones(4), available=[False, False, False, True])
    np.testing.assert_allclose(after.input_observed, 0.0, atol=1e-14)
    np.testing.assert_allclose(after.input_mean, 0.0, atol=1e-14)
    assert max(np.abs(after.mean).max(), np.abs(after.cov).max()) < 10.0


# --- kf with the variance of its unknown input ----------------------------------------------------


def test_kf_told_the_variance_of_its_input_has_it_as_a_state():
    system, D = (
        unknown_input_system(0, feedthrough=True, p=4, q=2),
        np.array([[2.0, 0.3], [0.3, 1.0]]),
    )
    record = simulate(system, 0, 3, 12)
    available = np.random.default_rng(0).random((12, 3, 4)) < 0.7
    augmented = input_as_state(system, D)
    assumed, plain = (
        track(make("kf", each.model, **options), each.rows(3), record, available=available)
        for each, options in ((system, {"input_cov": D}), (augmented, {}))
    )
    for one, other in zip(assumed, plain, strict=True):
        mine, theirs = (
            (*with_input(each), each.innovation, each.innovation_cov) for each in (one, other)
        )
        for found, expected in zip(mine, theirs, strict=True):
            assert_close(found, expected, 1e-12)


def test_input_cov_is_one_for_all_inputs_a_matrix_or_ignored():
    system = unknown_input_system(1, feedthrough=True, p=4, q=2)
    record = simulate(system, 1, 2, 5)
    number, matrix, zero, none = (
        track(make("kf", system.model, input_cov=cov), system.rows(2), record)[-1]
        for cov in (3.0, 3.0 * I2, 0.0, None)
    )
    absent = make("kf", dataclasses.replace(system.model, G=None, H=None))
    assert_same(number, matrix)
    assert_same(none, track(absent, system.rows(2), record)[-1])
    np.testing.assert_allclose(zero.mean, none.mean, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(zero.input_mean, 0.0)
    assert none.input_mean is None
    assert np.abs(number.cov - none.cov).max() > 0.1
