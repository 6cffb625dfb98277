"""Models, settings and beliefs that nobody can change in place, and changes of a belief that are not lost."""

import pickle
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from estimators import (
    Gaussian,
    LinearModel,
    NonlinearModel,
    RandomKeys,
    make,
    run,
)
from estimators.varying import Schedule
from tests.estimators.cases import Case, arrays, kalman_system, one_of_each, simulate

I2 = np.eye(2)
MATRICES = {"A": I2, "C": I2, "Q": I2, "R": I2, "B": I2, "G": I2, "H": I2}


@pytest.mark.parametrize("copied", [lambda x: x, lambda x: pickle.loads(pickle.dumps(x))])
def test_models_and_priors_have_read_only_copies(copied: Callable):
    given = {name: np.array(matrix) for name, matrix in MATRICES.items()}
    mean = np.zeros(2)
    nonlinear = NonlinearModel(_same, _same, given["Q"], given["R"], G=given["G"], H=given["H"])
    records = copied(
        (
            LinearModel(**given),
            nonlinear,
            Gaussian(mean, given["Q"]),
            Schedule(given["A"][None], 0, 1, 0),
        )
    )
    for array in (mean, *given.values()):
        array[...] = 7.0
    seen = 0
    for record in records:
        for name, array in vars(record).items():
            if isinstance(array, np.ndarray):
                seen += 1
                assert not (array == 7.0).any(), name
                with pytest.raises(ValueError, match="read-only"):
                    array[...] = 7.0
    assert seen == 7 + 4 + 2 + 1
    assert replace(records[0], A=2.0 * I2).A[0, 0] == 2.0


@one_of_each()
def test_nobody_can_write_to_a_belief(case: Case):
    system = case.system(0)
    filter, rng = case.make(system.model), RandomKeys.seeded(range(2))
    record = simulate(system, 0, 2, 3)
    begun = filter.init(system.rows(2), rng=rng)
    updated = filter.update(begun, record.y[0], rng=rng)
    series = run(filter, system.prior, record.y, u=record.u, rng=rng)
    for belief in (
        begun,
        updated,
        filter.predict(updated, record.u[0], rng=rng),
        series.predicted,
        series.updated,
    ):
        for name, array in arrays(belief).items():
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
            assert not array.flags.writeable, name


def test_a_known_input_changed_later_leaves_the_belief():
    system = kalman_system(0)
    filter, u = make("kf", system.model), np.ones((1, 2))
    predicted = filter.predict(filter.init(system.rows(1)), u)
    u[...] = 7.0
    np.testing.assert_array_equal(predicted.u, np.ones((1, 2)))


@pytest.mark.parametrize(
    ("name", "setting"),
    [("ukf", "alpha"), ("enkf", "inflation"), ("kf", "model")],
)
def test_a_setting_of_a_filter_is_read_only(name: str, setting: str):
    filter = make(name, LinearModel(I2, I2, I2, I2))
    kept = getattr(filter, setting)
    with pytest.raises(
        AttributeError,
        match=f"{setting} of a filter is read-only: build another filter, such as make",
    ):
        setattr(filter, setting, 2)
    assert getattr(filter, setting) is kept


# --- functions that work in place -----------------------------------------------------------------


def _same(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    return x


def _in_place(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    x[..., 0] += 0.1 * x[..., 1]
    return x


@pytest.mark.parametrize("part", ["transition", "measurement"])
@pytest.mark.parametrize("name", ["ekf", "enkf"])
def test_a_function_that_works_in_place_leaves_the_belief(name: str, part: str):
    model = NonlinearModel(
        **{"transition": _same, "measurement": _same, "Q": I2, "R": I2} | {part: _in_place}
    )
    filter, rng = make(name, model), RandomKeys.seeded(range(2))
    begun = filter.init(Gaussian(np.ones((2, 2)), I2), rng=rng)
    kept = {field: np.array(array) for field, array in arrays(begun).items()}
    with suppress(ValueError):  # a belief's own array is read-only
        filter.update(filter.predict(begun, rng=rng), np.zeros(2), rng=rng)
    for field, array in arrays(begun).items():
        np.testing.assert_array_equal(array, kept[field], field)


# --- another mean in a belief ---------------------------------------------------------------------


@pytest.mark.parametrize("name", ["enkf", "pf"])
def test_another_mean_moves_members_and_particles(name: str):
    system, rng = kalman_system(0), RandomKeys.seeded(range(2))
    filter, target = make(name, system.model), np.arange(8.0).reshape(2, 4)
    begun = filter.init(system.rows(2), rng=rng)
    moved = begun.replace(mean=target)
    points = "particles" if name == "pf" else "ensemble"
    for belief in (begun, moved):
        rows = None if name == "pf" else belief.ensemble.shape[:-1]
        weights = np.exp(belief.log_weights) if rows is None else np.full(rows, 1.0 / rows[-1])
        np.testing.assert_allclose(
            np.vecmat(weights, getattr(belief, points)), belief.mean, rtol=0, atol=1e-12
        )
    np.testing.assert_allclose(moved.cov, begun.cov, rtol=0, atol=1e-13)
    ahead, before = (filter.predict(belief, np.zeros(2), rng=rng).mean for belief in (moved, begun))
    np.testing.assert_allclose(
        ahead - before, np.matvec(system.model.A, target - begun.mean), rtol=0, atol=1e-12
    )
    with pytest.raises(
        ValueError,
        match=r"^cov of this belief is that of its \w+: replace .*, or begin anew",
    ):
        begun.replace(cov=begun.cov)


def test_a_mean_that_is_no_array_is_made_one_or_refused():
    system = kalman_system(0)
    filter = make("kf", system.model)
    belief = filter.init(system.rows(2))
    moved = belief.replace(mean=[[0, 1, 2, 3]] * 2)
    A, x = system.model.A, np.arange(4.0)
    rounding = 4.0 * np.finfo(float).eps * (np.abs(A) @ x)  # BLAS adds in an order of its own
    assert (np.abs(filter.predict(moved, np.zeros(2)).mean[0] - A @ x) <= rounding).all()
    with pytest.raises(ValueError, match=r"^mean must be an array of real numbers, got"):
        belief.replace(mean=["a", "b"])
