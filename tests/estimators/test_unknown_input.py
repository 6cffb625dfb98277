"""Laws of filters with unknown input, against each other, the papers and least squares."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from estimators import (
    Belief,
    Gaussian,
    LinearModel,
    NonlinearModel,
    Schedule,
    compiled,
    make,
    stacked,
)
from estimators.kalman import with_input
from estimators.varying import resolve
from tests.estimators.cases import (
    INPUT_PRIOR,
    Record,
    System,
    assert_close,
    assert_same,
    flat_prior_posterior,
    pushed_vehicle,
    shaken_vehicle,
    simulate,
    some_measurements,
    track,
    unknown_input_system,
)

I2 = np.eye(2)


def _one_run(system: System, seed: int, steps: int) -> Record:
    record = simulate(system, seed, runs=1, steps=steps)
    return record._replace(y=record.y[:, 0], u=record.u[:, 0])


def _as_functions(model: LinearModel) -> NonlinearModel:
    """The linear model as functions that tell nothing of their being linear."""
    f, h = compiled(model.transition), compiled(model.measurement)
    return NonlinearModel(f, h, model.Q, model.R, G=model.G, H=model.H)


@pytest.mark.parametrize("name", ["ekf-ui-wdf", "ukf-umv"])
def test_input_matrix_is_taken_at_the_estimate_before_the_step(
    name: str,
):
    system = pushed_vehicle(0)
    filter, record = make(name, system.model), _one_run(system, 0, 6)
    belief = track(filter, system.prior, record)[-1]
    predicted = filter.predict(belief, record.u[-1])
    before, after = (system.model.G(each.mean, record.u[-1]) for each in (belief, predicted))
    np.testing.assert_array_equal(predicted.input_matrix, before)
    assert np.abs(after - before).max() > 1e-4


# --- what hardly shows ----------------------------------------------------------------------------


CORRELATED = np.array([[1.0, 0.3], [0.3, 0.2]])
"""A covariance of two inputs, of which some directions show well and others hardly."""


@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"])
def test_a_hardly_observable_input_is_estimated_with_its_prior(name: str):
    """Any measurements missing: d is white and has its prior, but for what shows well."""
    system, steps = unknown_input_system(0, name == "kf-umv-ui", p=4, q=2), 40
    model, root = system.model, np.linalg.cholesky(CORRELATED)
    record = _one_run(system, 0, steps)
    available = np.random.default_rng(0).random((steps, model.p)) < 0.5
    filter = make(name, model, input_prior=CORRELATED)
    beliefs = track(filter, system.prior, record, available=available)
    mean, cov, late, kinds = system.mean, system.cov, 0.0 * model.G, set()
    for belief, mask, y, u in zip(beliefs, available, record.y, record.u, strict=True):
        C, H, R = model.C[mask], model.H[mask], model.R[mask][:, mask]
        F = (C @ late + H) @ root
        values, directions = np.linalg.eigh(F.T @ np.linalg.inv(C @ cov @ C.T + R) @ F)
        kinds |= set(np.digitize(values, [1e-6, 0.1]).tolist())
        hidden = np.linalg.inv(root).T @ directions[:, values <= 0.1]
        posterior, joint = flat_prior_posterior(
            mean, cov, late, C, H, R, y[mask], hidden @ hidden.T
        )
        for one, other in zip(with_input(belief), (posterior, joint), strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(joint).max())
        drive = np.hstack([model.A, model.G * (not filter.input_delay)])
        late = model.G * filter.input_delay
        mean, cov = drive @ posterior + model.B @ u, drive @ joint @ drive.T + model.Q
    assert kinds == {0, 1, 2}  # not, hardly, well


def test_ulise_is_unbiased_one_step_after_a_weak_feedthrough():
    system = unknown_input_system(2, True, p=4, q=2)
    system = replace(system, model=replace(system.model, H=system.model.H * [1.0, 1e-3]))
    d = np.zeros((9, 1, 2))
    d[4] = 0.0, 1e3
    record = simulate(system, 2, runs=1, steps=9, d=d, noise=0.0)
    beliefs = track(make("ulise", system.model, input_prior=INPUT_PRIOR), system.rows(1), record)
    assert np.trace(beliefs[4].feedthrough_observed[0]) == pytest.approx(1.0)
    errors = [np.abs(b.mean - x).max() for b, x in zip(beliefs, record.x, strict=True)]
    assert errors[4] > 0.1
    assert max(errors[:4] + errors[5:]) < 1e-9
    np.testing.assert_allclose(beliefs[5].input_mean[0], d[4, 0], rtol=0, atol=1e-9)


def test_feedthrough_may_have_another_rank_in_every_row():
    system, rows = unknown_input_system(0, True, 4, 4, 2, rank=1), 3
    record = simulate(system, 0, rows, 12)
    record.u[..., 0] = np.arange(rows)
    H = np.stack([np.zeros((4, 2)), system.model.H, np.eye(4, 2)])

    def last(feedthrough: object, row: object = slice(None)) -> Belief:
        filter = make("ulise", replace(system.model, H=feedthrough), input_prior=1e3)
        belief = filter.init(system.rows(*record.y[0, row].shape[:-1]))
        for y, u in zip(record.y[:, row], record.u[:, row], strict=True):
            belief = filter.update(filter.predict(belief, u), y, u=u)
        return belief

    batched = last(H)
    assert_same(last(lambda u: H[u[..., 0].astype(int)]), batched, 1e-12)
    for i in range(rows):
        assert_same(batched[i], last(H[i], i), 1e-12)
    ranks = np.trace(batched.feedthrough_observed, axis1=-2, axis2=-1)
    np.testing.assert_allclose(ranks, [0.0, 1.0, 2.0], rtol=0, atol=1e-12)


# --- an input that is a state, or comes a step later ----------------------------------------------


def _shaken() -> System:
    """`shaken_vehicle` with a push that is fixed in space."""
    system = shaken_vehicle(0)
    return replace(system, model=replace(system.model, G=[[0.05], [0.1], [0.05], [0.02]]))


LINEAR, VEHICLE = unknown_input_system(1, True, p=4, q=2), _shaken()


@pytest.mark.parametrize(
    ("name", "system", "model", "tolerance"),
    [
        ("kf-umv-ui-wdf", LINEAR, LINEAR.model, 1e-9), ("ulise", LINEAR, LINEAR.model, 1e-9),
        ("ekf-ui-wdf", LINEAR, _as_functions(LINEAR.model), 1e-9),
        ("ukf-umv", LINEAR, _as_functions(LINEAR.model), 1e-9),
        ("ekf-ui-wdf", VEHICLE, VEHICLE.model, 1e-7),
    ],
)  # fmt: skip
def test_stacked_filters_without_feedthrough_are_those_with_it(
    name: str, system: System, model: LinearModel | NonlinearModel, tolerance: float
):
    """They say of the state what `kf-umv-ui` says of (x, d), and again of d as the past input."""
    record, n, p = simulate(system, 1, runs=6, steps=30), system.model.n, system.model.p
    available = some_measurements(np.random.default_rng(1), p, 30, 6)
    direct = make("kf-umv-ui", system.model, input_prior=INPUT_PRIOR)
    direct = track(direct, system.rows(6), record, None, available)
    late = make(name, stacked(model), input_prior=INPUT_PRIOR)
    belief = late.init(Gaussian(*with_input(direct[0])))
    for k in range(1, 30):
        belief = late.predict(belief, record.u[k - 1])
        belief, expected = late.update(belief, record.y[k], available=available[k]), direct[k]
        mean, cov = with_input(expected)
        for one, other in (
            (belief.mean, mean), (belief.cov, cov), (belief.input_mean, mean[..., n:]),
            (belief.input_cov, cov[..., n:, n:]), (belief.input_observed, expected.input_observed),
        ):  # fmt: skip
            assert_close(one, other, tolerance)


@pytest.mark.parametrize(
    "way",
    [
        lambda table: table,
        lambda table: Schedule(table, 0, 1.0, 0.5),
        lambda table: lambda u: table[u[..., 0].astype(int)],
    ],
)
def test_stacked_matrices_follow_rows_and_known_input(
    way: Callable,
):
    models = [unknown_input_system(seed, True, p=4, q=2).model for seed in range(3)]
    tables = {name: np.stack([getattr(model, name) for model in models]) for name in "ABG"}
    given = stacked(replace(models[0], **{name: way(table) for name, table in tables.items()}))
    for i, model in enumerate(models):
        expected = stacked(replace(models[0], A=model.A, B=model.B, G=model.G))
        for name in "ABG":
            matrix = resolve(getattr(given, name), np.array([i, 0.0]))
            matrix = matrix[i] if matrix.ndim > 2 else matrix
            np.testing.assert_array_equal(matrix, getattr(expected, name))
