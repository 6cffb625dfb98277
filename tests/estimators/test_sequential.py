"""Sensors that arrive one by one: several updates of a step are one with all measurements, or are refused."""

import dataclasses
from itertools import pairwise, permutations

import numpy as np
import pytest

from estimators import (
    Belief,
    Delayed,
    EnsembleKalmanFilter,
    Filter,
    Gaussian,
    LinearModel,
    NonlinearModel,
    make,
    names,
)
from estimators.randomness import RandomKeys
from tests.estimators.cases import (
    CASES,
    INPUT_PRIOR,
    Case,
    System,
    arrays,
    kalman_system,
    simulate,
    unknown_input_system,
)

ROWS, STEPS = 3, 5
LINEAR = [case for case in CASES if "linear" in case.laws]
ESTIMATES = ("mean", "cov", "input_mean", "input_cov", "state_input_cov", "input_observed")
REFUSED = (
    "takes one update a step: pass all measurements of a step together, NaN for none, or give them"
    " to Delayed"
)


def _independent(system: System) -> System:
    """The system with measurement noises that are independent."""
    R = np.diag(np.diagonal(system.model.R))
    return dataclasses.replace(system, model=dataclasses.replace(system.model, R=R))


def _alone(y: np.ndarray, j: int) -> np.ndarray:
    """A measurement of which channel ``j`` alone has come."""
    return np.where(np.arange(y.shape[-1]) == j, y, np.nan)


def _one_by_one(
    filter: Filter, belief: Belief, y: np.ndarray, order: tuple[int, ...], rng: RandomKeys
) -> Belief:
    for j in order:
        belief = filter.update(belief, _alone(y, j), rng=rng)
    return belief


def _assert_estimates_equal(one: Belief, other: Belief, tolerance: float = 1e-11) -> None:
    mine, theirs = arrays(one), arrays(other)
    np.testing.assert_array_equal(one.recovery, other.recovery)
    for name in ESTIMATES:
        assert (name in mine) == (name in theirs)
        if name in mine:
            close = tolerance * max(1.0, float(np.abs(theirs[name]).max()))
            np.testing.assert_allclose(mine[name], theirs[name], rtol=0, atol=close, err_msg=name)


def _told_the_variance(seed: int) -> System:
    return unknown_input_system(seed, True, p=4, q=2)


class OneOfYourOwn(EnsembleKalmanFilter):
    """A filter of one's own, which predicts as ours do."""


BUILT = [
    *(
        pytest.param(case.system, case.make, id=case.id)
        for case in {case.name: case for case in LINEAR}.values()
    ),
    pytest.param(
        _told_the_variance,
        lambda m: make("kf", m, input_cov=[[2.0, 0.3], [0.3, 1.0]]),
        id="kf with input_cov",
    ),
    pytest.param(kalman_system, lambda m: OneOfYourOwn(m, members=20), id="of your own"),
]


def test_every_registered_filter_is_among_these():
    assert {case.name for case in LINEAR} == set(names()) - {"enkf-sr"}  # another name of etkf


@pytest.mark.parametrize(("system", "build"), BUILT)
def test_measurements_one_by_one_leave_what_they_leave_together_or_are_refused(system, build):
    """In every order, over several steps; what is not sequential is so within `Delayed`, which takes a step as one."""
    system = _independent(system(0))
    filter, record = build(system.model), simulate(system, 1, ROWS, STEPS)
    keys = RandomKeys.seeded(range(ROWS))
    joint = filter.init(system.rows(ROWS), rng=keys)
    orders = list(permutations(range(system.model.p)))[:: 1 if system.model.p < 4 else 5]
    late = Delayed(filter, 0)
    apart = late.init(system.rows(ROWS), rng=keys)
    for k, y in enumerate(record.y):
        now = keys.at(k)
        if k:
            apart, joint = (
                f.predict(b, record.u[k - 1], rng=now) for f, b in ((late, apart), (filter, joint))
            )
        together = filter.update(joint, y, rng=now)
        if filter.sequential:
            for order in orders:
                _assert_estimates_equal(_one_by_one(filter, joint, y, order, now), together)
        else:
            with pytest.raises(ValueError, match=REFUSED) as caught:
                _one_by_one(filter, joint, y, orders[0], now)
            assert "\n" not in str(caught.value)
        for j in orders[k % len(orders)]:
            apart = late.update(apart, _alone(y, j)[..., None, :], rng=now)
        _assert_estimates_equal(apart.now, together, 0.0)
        joint = together


@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv"])
@pytest.mark.parametrize("prior", [1e-3, 0.05, 1.0, 1e4])
def test_directions_of_the_input_that_single_measurements_hardly_show_add_up(
    name: str, prior: float
):
    """Over whole runs, with priors for which one measurement counts, or two together, or all, or none."""
    system = _independent(unknown_input_system(3, name == "kf-umv-ui", p=4, q=2))
    filter, record = make(name, system.model, input_prior=prior), simulate(system, 1, ROWS, 12)
    joint = parts = filter.init(system.rows(ROWS))
    shown = set()
    for k, y in enumerate(record.y):
        if k:
            joint, parts = (filter.predict(belief, record.u[k - 1]) for belief in (joint, parts))
        joint = filter.update(joint, y)
        for j in np.random.default_rng(k).permutation(4):
            parts = filter.update(parts, _alone(y, j))
            shown.add(round(float(np.trace(parts.input_observed[0]))))
        _assert_estimates_equal(parts, joint, 1e-10)
    assert len(shown) > 1 or prior == 1e-3


def test_each_measurement_has_its_own_known_input_covariance_and_measurement_function():
    """Rows of C and H at inputs of their own, and an R of their own: as one model that has all of them at once."""
    system = _independent(unknown_input_system(1, True))
    m = system.model
    y, R = np.array([1.0, -2.0, 0.5]), np.diag([0.3, 2.0, 0.7])
    inputs = [np.array([1.0 + 0.5 * j, 0.0]) for j in range(3)]
    following = dataclasses.replace(
        m, C=lambda u: u[..., :1, None] * m.C, H=lambda u: u[..., :1, None] * m.H
    )
    gains = np.array([u[0] for u in inputs])[:, None]
    whole = dataclasses.replace(m, C=gains * m.C, H=gains * m.H)
    for name, options in (
        ("kf", {}),
        ("kf", {"input_cov": 2.0}),
        ("kf-umv-ui", {"input_prior": INPUT_PRIOR}),
    ):
        filter, joint = make(name, following, **options), make(name, whole, **options)
        belief = filter.predict(filter.init(system.prior), inputs[0])
        expected = joint.update(joint.predict(joint.init(system.prior), inputs[0]), y, R=R)
        for j in (2, 0, 1):
            belief = filter.update(belief, _alone(y, j), R=R, u=inputs[j])
        _assert_estimates_equal(belief, expected)


@pytest.mark.parametrize("name", ["kf", "kf-umv-ui", "pf"])
def test_correlated_noises_are_refused_in_two_updates_and_taken_in_one(name: str):
    feedthrough = {"G": [[1.0], [0.0]], "H": [[0.0], [1.0], [0.0]]} if name == "kf-umv-ui" else {}
    R = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]])
    model = LinearModel(
        np.eye(2), [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], np.eye(2), R, **feedthrough
    )
    filter, rng = make(name, model), RandomKeys.seeded([0, 1])
    belief = filter.init(Gaussian(np.zeros((2, 2)), np.eye(2)), rng=rng)
    first = filter.update(belief, [1.0, np.nan, np.nan], rng=rng)
    with pytest.raises(
        ValueError,
        match="the noises of measurements 0 and 2 are correlated, but they come in two updates",
    ):
        filter.update(first, [np.nan, 1.0, 1.0], rng=rng)
    filter.update(first, [np.nan, 1.0, np.nan], rng=rng)
    filter.update(
        first, [np.nan, 1.0, 1.0], R=np.eye(3), rng=rng
    )  # a covariance of its own has its own correlations
    whole = filter.update(belief, [1.0, 1.0, 1.0], rng=rng)
    filter.update(whole, [1.0, 1.0, 1.0], rng=rng)  # read twice: each time with noises of its own


@pytest.mark.parametrize(
    "case", [case for case in LINEAR if "unknown-input" in case.laws], ids=lambda case: case.id
)
def test_an_update_without_measurements_changes_nothing_of_what_a_later_one_does_or_is_refused(
    case: Case,
):
    system = case.system(0)
    filter, record = case.make(system.model), simulate(system, 2, ROWS, 2)
    belief = filter.predict(filter.update(filter.init(system.rows(ROWS)), record.y[0]), record.u[0])
    nothing = filter.update(belief, np.full(record.y[1].shape, np.nan))
    if filter.sequential:
        _assert_estimates_equal(
            filter.update(nothing, record.y[1]), filter.update(belief, record.y[1])
        )
        return
    with pytest.raises(ValueError, match=REFUSED):
        filter.update(nothing, record.y[1])


@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf"])
def test_rows_that_have_read_and_rows_that_have_not_are_each_treated_as_what_they_are(name: str):
    system = _independent(unknown_input_system(0, name == "kf-umv-ui"))
    filter, record = make(name, system.model, input_prior=INPUT_PRIOR), simulate(system, 0, 2, 2)
    predicted = filter.predict(filter.update(filter.init(system.rows(2)), record.y[0]), record.u[0])
    y, second = record.y[1], np.array([False, True])
    read = filter.update(predicted, _alone(y, 0))
    after = filter.update(
        read.with_rows(second, predicted[second]), np.where(second[:, None], y, _alone(y, 1))
    )
    _assert_estimates_equal(after[0], filter.update(read, _alone(y, 1))[0])
    _assert_estimates_equal(after[1], filter.update(predicted, y)[1])


CHAINED = [
    ("kf", kalman_system, lambda m: make("kf", m)),
    ("kf with input_cov", _told_the_variance, lambda m: make("kf", m, input_cov=2.0)),
    ("pf", kalman_system, lambda m: make("pf", m, particles=30)),
    (
        "kf-umv-ui",
        lambda seed: unknown_input_system(seed, True),
        lambda m: make("kf-umv-ui", m, input_prior=50.0),
    ),
    (
        "wdf",
        lambda seed: unknown_input_system(seed, False),
        lambda m: make("kf-umv-ui-wdf", m, input_prior=50.0),
    ),
]


@pytest.mark.parametrize(
    ("system", "build"), [case[1:] for case in CHAINED], ids=[case[0] for case in CHAINED]
)
def test_the_likelihoods_of_measurements_one_by_one_add_up_to_that_of_all(system, build):
    system = _independent(system(0))
    filter, record, rng = (
        build(system.model),
        simulate(system, 1, ROWS, 2),
        RandomKeys.seeded(range(ROWS)),
    )
    first = filter.update(filter.init(system.rows(ROWS), rng=rng), record.y[0], rng=rng)
    beliefs = [filter.predict(first, record.u[0], rng=rng)]
    for j in range(system.model.p):
        beliefs.append(filter.update(beliefs[-1], _alone(record.y[1], j), rng=rng))
    whole = filter.log_likelihood(beliefs[0], filter.update(beliefs[0], record.y[1], rng=rng))
    np.testing.assert_allclose(
        sum(filter.log_likelihood(*pair) for pair in pairwise(beliefs)), whole, rtol=1e-9
    )


def test_of_a_nonlinear_model_each_measurement_is_linearised_where_those_before_it_left_the_estimate():
    model = NonlinearModel(
        lambda x, u: x, lambda x, u: np.stack([x[..., 0] ** 2, x[..., 0]], -1), [[0.1]], np.eye(2)
    )
    ekf = make("ekf", model)
    belief = ekf.update(ekf.init(Gaussian([2.0], [[1.0]])), [np.nan, 3.0])
    mean, variance = belief.mean[0], belief.cov[0, 0]
    assert (mean, variance) == (pytest.approx(2.5), pytest.approx(0.5))
    slope = 2.0 * mean
    gain = variance * slope / (slope**2 * variance + 1.0)
    after = ekf.update(belief, [9.0, np.nan])
    assert after.mean[0] == pytest.approx(mean + gain * (9.0 - mean**2), rel=1e-9)


def test_a_late_filter_takes_measurements_of_a_step_with_one_known_input():
    model = LinearModel(
        np.eye(2), lambda u: u[..., :1, None] * np.eye(2), np.eye(2), np.eye(2), B=np.eye(2, 1)
    )
    late = Delayed(make("kf", model), 2)
    belief = late.predict(late.init(Gaussian(np.zeros((1, 2)), np.eye(2))), [[1.0]])
    first = late.update(belief, [[[1.0, np.nan]]], u=[[2.0]])
    late.update(first, [[[np.nan, 1.0]]], u=[[2.0]])
    with pytest.raises(ValueError, match="u must be the same for all measurements of a step"):
        late.update(first, [[[np.nan, 1.0]]], u=[[3.0]])
