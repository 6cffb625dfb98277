"""Sensors that arrive one by one: several updates of a step are one with all measurements, or are refused."""

import dataclasses
from itertools import pairwise, permutations

import numpy as np
import pytest

from estimators import Delayed, Gaussian, LinearModel, make
from estimators.randomness import RandomKeys
from tests.estimators.cases import (
    Case,
    System,
    assert_same,
    kalman_system,
    one_of_each,
    simulate,
    unknown_input_system,
)

ROWS, KEYS = 3, RandomKeys.seeded(range(3))


def _independent(system: System) -> System:
    """The system with measurement noises that are independent."""
    R = np.diag(np.diagonal(system.model.R))
    return dataclasses.replace(system, model=dataclasses.replace(system.model, R=R))


def _alone(y: np.ndarray, j: int) -> np.ndarray:
    """A measurement of which channel ``j`` alone has come."""
    return np.where(np.arange(y.shape[-1]) == j, y, np.nan)


@pytest.mark.parametrize("name", ["kf", "ekf", "ukf", "robust-kf", "etkf", "pf"])
def test_updates_one_by_one_equal_one_update_in_every_order(name: str):
    system = _independent(kalman_system(0))
    options = {"pf": {"particles": 30}, "etkf": {"members": 20}}.get(name, {})
    filter, record = make(name, system.model, **options), simulate(system, 1, ROWS, 4)
    belief = filter.init(system.rows(ROWS), rng=KEYS)
    for k, y in enumerate(record.y):
        belief = filter.predict(belief, record.u[k], rng=KEYS.at(k))
        together = filter.update(belief, y, rng=KEYS.at(k))
        likelihood = filter.log_likelihood(belief, together)
        for order in permutations(range(system.model.p)):
            parts = [belief]
            for j in order:
                parts.append(filter.update(parts[-1], _alone(y, j), rng=KEYS.at(k)))
            for moment in ("mean", "cov"):
                one, other = (getattr(b, moment) for b in (parts[-1], together))
                np.testing.assert_allclose(one, other, rtol=0, atol=1e-11)
            apart = sum(filter.log_likelihood(*pair) for pair in pairwise(parts))
            np.testing.assert_allclose(apart, likelihood, rtol=1e-9)
        belief = together


@one_of_each()
def test_a_second_update_of_a_step_needs_delayed(
    case: Case,
):
    system = case.system(0)
    filter, record = case.make(system.model), simulate(system, 1, ROWS, 4)
    late, y = Delayed(filter, 0), record.y[0]
    apart, joint = (each.init(system.rows(ROWS), rng=KEYS) for each in (late, filter))
    for k, y in enumerate(record.y):
        now = KEYS.at(k)
        apart, joint = (
            f.predict(b, record.u[k], rng=now) for f, b in ((late, apart), (filter, joint))
        )
        joint = filter.update(joint, y, rng=now)
        for j in np.random.default_rng(k).permutation(system.model.p):
            apart = late.update(apart, _alone(y, j)[..., None, :], rng=now)
        assert_same(apart.now, joint)
    if filter.input_delay is not None:
        with pytest.raises(
            ValueError, match=f"^{case.name} takes one update a step: join the measurements, NaN or"
        ):
            filter.update(joint, y)


def test_rows_that_begin_and_rows_that_run_stay_apart():
    system = unknown_input_system(0, feedthrough=False)
    filter, record = make("kf-umv-ui-wdf", system.model), simulate(system, 0, 2, 2)
    begun = filter.init(system.rows(2)).replace(u=record.u[0])
    predicted = filter.predict(filter.update(begun, record.y[0]), record.u[0])
    second = np.array([False, True])
    mixed = filter.update(predicted.with_rows(second, begun[second]), record.y[1])
    assert_same(mixed[0], filter.update(predicted, record.y[1])[0])
    assert_same(mixed[1], filter.update(begun, record.y[1])[1])


def test_late_measurements_of_a_step_have_one_known_input():
    model = LinearModel(
        np.eye(2), lambda u: u[..., :1, None] * np.eye(2), np.eye(2), np.eye(2), B=np.eye(2, 1)
    )
    late = Delayed(make("kf", model), 2)
    belief = late.predict(late.init(Gaussian(np.zeros((1, 2)), np.eye(2))), [[1.0]])
    first = late.update(belief, [[[1.0, np.nan]]], u=[[2.0]])
    late.update(first, [[[np.nan, 1.0]]], u=[[2.0]])
    with pytest.raises(ValueError, match="u must be the same for all measurements of a step"):
        late.update(first, [[[np.nan, 1.0]]], u=[[3.0]])
