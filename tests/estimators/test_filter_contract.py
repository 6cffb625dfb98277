"""What every filter promises its user: names, refusals, missing measurements, rows, angles."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from scipy.linalg import block_diag

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
from tests.estimators.cases import (
    INPUT_PRIOR,
    Case,
    System,
    arrays,
    assert_same,
    one_of_each,
    simulate,
    some_cases,
    track,
    unknown_input_system,
)

I2 = np.eye(2)
UNKNOWN_INPUT = ["kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"]


def _linear(**changes) -> LinearModel:
    return LinearModel(**{"A": I2, "C": I2, "Q": I2, "R": I2, **changes})


def _nonlinear(**changes) -> NonlinearModel:
    return NonlinearModel(
        **{"transition": lambda x, u: x, "measurement": lambda x, u: x, "Q": I2, "R": I2, **changes}
    )


def _message(caught: pytest.ExceptionInfo) -> str:
    message = str(caught.value)
    assert "\n" not in message
    return message


# --- building a filter ----------------------------------------------------------------------------


def test_an_unknown_name_is_answered_with_those_that_exist_and_the_nearest():
    with pytest.raises(ValueError, match="unknown filter 'kf-umw-ui'") as caught:
        make("kf-umw-ui", _linear())
    message = _message(caught)
    assert "did you mean 'kf-umv-ui'" in message
    assert all(name in message for name in names())


@some_cases("kf", "enkf", "kf-umv-ui")
def test_an_unknown_option_is_named_with_those_that_exist(case: Case):
    with pytest.raises(TypeError, match=f"{case.name} has no option 'colour'") as caught:
        make(case.name, case.system(0).model, colour="red", **case.options)
    assert all(option in _message(caught) for option in case.options)


def test_a_model_that_is_none_is_refused():
    with pytest.raises(
        TypeError, match="model must be a LinearModel or a NonlinearModel, got dict"
    ):
        make("kf", {"A": I2})


@one_of_each()
def test_a_filter_says_what_it_is(case: Case):
    model = case.system(0).model
    filter = case.make(model)
    assert isinstance(filter, Filter)
    assert filter.name == case.name
    assert f"n={model.n}" in repr(filter)
    assert (filter.input_delay is not None) == (model.q > 0)


FIRST, SECOND = [[1.0], [0.0]], [[0.0], [1.0]]
ONE_BAD_ROW = np.stack([I2, np.ones((2, 2)), I2])
SINGLE = {"C": [[1.0, 0.0]], "R": [[1.0]]}
NONLINEAR_ONES = "for a nonlinear one use kf-umv-ui, without feedthrough ekf-ui-wdf or ukf-umv"
PRIORS = {
    "kf-umv-ui": {"G": FIRST, "H": FIRST}, "kf-umv-ui-wdf": {"G": FIRST}, "ekf-ui-wdf": {"G": FIRST},
    "ukf-umv": {"G": FIRST}, "ulise": {"G": FIRST},
}  # fmt: skip
REFUSED = [
    ("kf", _nonlinear(), {}, "^kf needs a LinearModel: use ekf"),
    (
        "kf-umv-ui", _linear(G=SECOND), {},
        r"^kf-umv-ui needs rank\(H\) = 1 unknown input, got 0: measure the input or use ekf-ui-wdf, or ",
    ),
    ("kf-umv-ui", _linear(G=I2, H=np.ones((2, 2))), {}, r"rank\(H\) = 2 unknown inputs, got 1"),
    ("kf-umv-ui", _linear(G=I2, H=ONE_BAD_ROW), {}, r"rank\(H\) = 2 unknown inputs, got 1"),
    ("kf-umv-ui-wdf", _linear(G=FIRST, H=SECOND), {}, r"^kf-umv-ui-wdf needs H = 0 .*use kf-umv-ui"),
    ("kf-umv-ui-wdf", _linear(**SINGLE, G=SECOND), {}, r"needs rank\(C G\) = 1 unknown input, got 0: measure"),
    ("kf-umv-ui-wdf", _linear(**SINGLE, G=I2), {}, r"rank\(C G\) = 2 unknown inputs, got 1"),
    *((name, _linear(), {}, "needs an unknown input") for name in PRIORS),
    *((name, _nonlinear(G=FIRST, H=FIRST), {}, f"^{name} needs a LinearModel: {NONLINEAR_ONES}")
      for name in ("kf-umv-ui-wdf", "ulise")),
    *((name, _linear(**PRIORS[name]), {"input_prior": value}, f"^input_prior .*{problem}")
      for name in PRIORS for value, problem in ((-1.0, "positive semidefinite"), (0.0, "positive definite"),
                                                (I2, "shape"), ([1.0], "shape"), (np.nan, "finite"))),
    ("kf", _linear(), {"input_cov": 1.0}, "input_cov needs an unknown input"),
    ("kf", _linear(G=FIRST), {"input_cov": I2}, "input_cov has shape"),
    ("kf", _linear(G=FIRST), {"input_cov": -1.0}, "input_cov must be positive semidefinite"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "model", "options", "sentence"), REFUSED)
def test_what_a_filter_cannot_be_built_of_is_refused_in_one_sentence(
    name: str, model, options: dict, sentence: str
):
    with pytest.raises(ValueError, match=sentence) as caught:
        make(name, model, **options)
    _message(caught)


# --- input that is refused where it enters --------------------------------------------------------


@some_cases("kf")
def test_a_prior_for_another_number_of_states_is_refused(case: Case):
    model = case.system(0).model
    with pytest.raises(
        ValueError, match=f"the prior is for {model.n + 1} states, the model has {model.n}"
    ):
        case.make(model).init(Gaussian(np.zeros(model.n + 1), np.eye(model.n + 1)))


@some_cases("kf")
def test_measurements_masks_and_covariances_of_the_wrong_shape_are_named(case: Case):
    system = case.system(0)
    p, filter = system.model.p, case.make(system.model)
    rng = np.random.default_rng(0)
    belief = filter.predict(filter.init(system.rows(5), rng=rng), np.zeros((5, system.m)), rng=rng)
    good = np.zeros((5, p))
    wrong = [
        ("y", {"y": np.zeros((5, p + 1))}),
        ("y", {"y": np.zeros((2, 5, p))}),
        ("available", {"y": good, "available": np.ones((5, p + 1), bool)}),
        ("available", {"y": good, "available": np.ones((4, p), bool)}),
        ("R", {"y": good, "R": np.eye(p + 1)}),
        ("R", {"y": good, "R": np.tile(np.eye(p), (4, 1, 1))}),
    ]
    for name, arguments in wrong:
        with pytest.raises(ValueError, match=f"^{name} has shape") as caught:
            filter.update(belief, **arguments)
        assert "expected" in _message(caught)


@one_of_each()
def test_one_measurement_mask_covariance_or_known_input_may_serve_every_row(case: Case):
    system = case.system(0)
    model, filter = system.model, case.make(system.model)
    p = model.p
    rng = RandomKeys.seeded(range(3))
    begun, u = filter.init(system.rows(3), rng=rng), np.full(system.m, 0.3)
    y, mask, R = np.arange(1.0, p + 1.0), np.arange(p) != 1, 2.0 * model.R
    one = filter.update(filter.predict(begun, u, rng=rng), y, available=mask, R=R, rng=rng)
    each = filter.update(
        filter.predict(begun, np.tile(u, (3, 1)), rng=rng),
        np.tile(y, (3, 1)),
        available=np.tile(mask, (3, 1)),
        R=np.tile(R, (3, 1, 1)),
        rng=rng,
    )
    assert_same(one, each, 1e-13, ignore=["u"])
    assert_same(one[1:], each[1:], 1e-13, ignore=["u"])  # rows stay rows


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
def test_rows_of_a_belief_are_replaced_by_those_of_another_in_order(case: Case):
    filter, predicted, y, u = _run(case, 5)
    belief = filter.update(predicted, y)
    mask = np.array([False, True, False, True, False])
    other = filter.update(predicted[[4, 0]], y[[4, 0]] + 1.0)
    before = {name: array.copy() for name, array in arrays(belief).items()}
    merged = belief.with_rows(mask, other)
    assert_same(merged[~mask], belief[~mask])
    assert_same(merged[mask], other)
    for name, array in arrays(belief).items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)
    assert_same(filter.predict(merged, u)[mask], filter.predict(other, u[mask]), 1e-12)


def test_a_fresh_row_joins_others_as_one_that_has_seen_no_measurement():
    filter = make("kf", _linear())
    fresh = filter.init(Gaussian(np.zeros((2, 2)), I2))
    updated = filter.update(fresh, np.ones(2))
    mixed = updated.with_rows(np.array([True, False]), fresh[:1])
    np.testing.assert_array_equal(mixed.mean, [fresh.mean[0], updated.mean[1]])
    np.testing.assert_array_equal(mixed.innovation, [[0.0, 0.0], [1.0, 1.0]])
    np.testing.assert_array_equal(mixed.innovation_cov, [I2, 2.0 * I2])
    np.testing.assert_array_equal(mixed.available, [[False, False], [True, True]])
    assert_same(fresh.with_rows(np.array([False, True]), updated[1:]), mixed)


def test_beliefs_of_different_filters_do_not_merge():
    prior = Gaussian(np.zeros((2, 2)), I2)
    one, other = (
        make("kf", _linear()),
        make("kf-umv-ui", _linear(G=[[1.0], [0.0]], H=[[1.0], [0.0]])),
    )
    with pytest.raises(
        ValueError,
        match="cannot merge Belief and ObservedInputBelief: they are of different filters",
    ):
        one.init(prior).with_rows(np.array([True, False]), other.init(prior)[:1])


def test_a_belief_of_another_family_is_refused_in_one_sentence():
    prior, model = Gaussian(np.zeros((2, 2)), I2), _linear(G=[[1.0], [0.0]], H=[[1.0], [0.0]])
    with pytest.raises(
        TypeError,
        match=r"belief must be of type ObservedInputBelief, got Belief: begin with init\(prior\)",
    ):
        make("kf-umv-ui", model).predict(make("kf", model).init(prior))


@one_of_each()
def test_a_belief_can_be_asked_for_its_input_and_its_members_pickled_and_copied(case: Case):
    system = case.system(0)
    filter = case.make(system.model)
    belief = filter.init(system.rows(2), rng=np.random.default_rng(0))
    assert type(belief) is filter.record
    assert (belief.input_mean is None) == (belief.input_cov is None) == (filter.input_delay is None)
    assert (belief.ensemble is None) == (not isinstance(filter, EnsembleFilter))
    for same in (pickle.loads(pickle.dumps(belief)), copy.deepcopy(belief), belief.replace()):
        assert type(same) is type(belief)
        assert_same(same, belief)


# --- angles ---------------------------------------------------------------------------------------


def test_a_measurement_that_is_no_angle_is_not_wrapped():
    filter = make("kf", _linear(measurement_angles=(1,)))
    innovation = filter.update(filter.init(Gaussian([10.0, 10.0], I2)), [0.0, 0.0]).innovation
    np.testing.assert_allclose(innovation, [-10.0, 4.0 * np.pi - 10.0], rtol=0, atol=1e-14)


# --- an unknown input that the measurements leave unseen ------------------------------------------


@pytest.mark.parametrize("noise", [1.0, 1e6, 1e12])
@pytest.mark.parametrize("name", UNKNOWN_INPUT)
def test_the_direction_that_is_seen_stays_unbiased_however_large_noise_and_prior_are(
    name: str, noise: float
):
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
    C = np.vstack([np.eye(3), [np.cos(np.pi / 2), 1.0, np.cos(np.pi / 2)]])
    G = np.eye(3)[:, [0, 2]][:, :q]
    filter = make(
        "kf-umv-ui-wdf", LinearModel(A=0.5 * np.eye(3), C=C, G=G, Q=np.eye(3), R=np.eye(4))
    )
    predicted = filter.predict(filter.init(Gaussian(np.zeros(3), np.eye(3))))
    after = filter.update(predicted, np.ones(4), available=[False, False, False, True])
    np.testing.assert_allclose(after.input_observed, 0.0, atol=1e-14)
    np.testing.assert_allclose(after.input_mean, 0.0, atol=1e-14)
    assert np.abs(after.mean).max() < 10.0
    assert np.abs(after.cov).max() < 10.0


def test_without_feedthrough_the_first_measurement_after_the_prior_shows_no_input():
    system = unknown_input_system(0, feedthrough=False)
    filter = make("kf-umv-ui-wdf", system.model, input_prior=INPUT_PRIOR)
    kalman = make("kf", dataclasses.replace(system.model, G=None, H=None))
    y = np.arange(1.0, 4.0)
    first, plain = (f.update(f.init(system.prior), y) for f in (filter, kalman))
    np.testing.assert_allclose(first.mean, plain.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(first.cov, plain.cov, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(first.input_observed, 0.0)
    np.testing.assert_array_equal(first.input_mean, 0.0)
    np.testing.assert_allclose(first.input_cov, [[INPUT_PRIOR]], rtol=1e-14)


# --- kf with the variance of its unknown input ----------------------------------------------------


def _with_the_input_as_a_state(system: System, D: np.ndarray) -> System:
    """The same system with its unknown input, white with covariance D, as states."""
    model, n, q = stacked(system.model), system.model.n, system.model.q
    Q, cov = np.array(model.Q), block_diag(system.cov, D)
    Q[n:, n:] = D
    model = LinearModel(model.A, model.C, Q, model.R, B=model.B)
    return System(model, np.concatenate([system.mean, np.zeros(q)]), cov, system.m)


def test_kf_told_the_variance_of_its_input_is_a_kf_with_the_input_as_a_state():
    system = unknown_input_system(0, feedthrough=True, p=4, q=2)
    D = np.array([[2.0, 0.3], [0.3, 1.0]])
    record = simulate(system, 0, 3, 12)
    available = np.random.default_rng(0).random((12, 3, 4)) < 0.7
    told = track(make("kf", system.model, input_cov=D), system.rows(3), record, available=available)
    augmented = _with_the_input_as_a_state(system, D)
    plain = track(make("kf", augmented.model), augmented.rows(3), record, available=available)
    n = system.model.n
    for one, other in zip(told, plain, strict=True):
        pairs = (
            (one.mean, other.mean[..., :n]), (one.input_mean, other.mean[..., n:]), (one.cov, other.cov[..., :n, :n]),
            (one.input_cov, other.cov[..., n:, n:]), (one.state_input_cov, other.cov[..., :n, n:]),
            (one.innovation, other.innovation), (one.innovation_cov, other.innovation_cov),
        )  # fmt: skip
        for mine, theirs in pairs:
            np.testing.assert_allclose(
                mine, theirs, rtol=0, atol=1e-12 * max(1.0, np.abs(theirs).max())
            )


def test_kf_takes_a_number_for_the_same_variance_of_every_input_and_none_for_ignoring_them():
    system = unknown_input_system(1, feedthrough=True, p=4, q=2)
    model, record = system.model, simulate(system, 1, 2, 5)
    number, matrix, zero, none, absent = (
        track(filter, system.rows(2), record)[-1]
        for filter in (
            make("kf", model, input_cov=3.0), make("kf", model, input_cov=3.0 * I2), make("kf", model, input_cov=0.0),
            make("kf", model), make("kf", dataclasses.replace(model, G=None, H=None)),
        )
    )  # fmt: skip
    assert_same(number, matrix)
    assert_same(none, absent)
    np.testing.assert_allclose(zero.mean, none.mean, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(zero.input_mean, 0.0)
    assert none.input_mean is None
    assert np.abs(number.cov - none.cov).max() > 0.1
