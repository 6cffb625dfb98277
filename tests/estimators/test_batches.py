"""Laws of batches, arguments, units and missing measurements, tried on every filter."""

import copy
import dataclasses
from functools import partial

import numpy as np
import pytest

from estimators import (
    Gaussian,
    LinearModel,
    RandomKeys,
    make,
)
from tests.estimators.cases import (
    Case,
    arrays,
    assert_same,
    every_case,
    random_covariance,
    simulate,
    some_measurements,
    track,
    without_channel,
)

SEEDS = [pytest.param(seed, id=f"seed {seed}") for seed in (0, 1)]


def _numbers(*rows: int) -> RandomKeys:
    return RandomKeys.seeded(rows).of(7)


@every_case()
def test_a_row_of_a_batch_has_the_bits_of_a_row_alone(case: Case):
    """A batch of two axes, whose rows have priors, gaps and noises of their own."""
    system, batch, steps = case.system(0), (2, 35), 5
    model, filter, rng = system.model, case.make(system.model), np.random.default_rng(0)
    record = simulate(system, 0, 70, steps)
    y, u = (values.reshape(steps, *batch, -1) for values in (record.y, record.u))
    prior = Gaussian(
        system.mean + 0.1 * rng.normal(size=(*batch, model.n)),
        system.cov * rng.uniform(0.5, 2.0, (*batch, 1, 1)),
    )
    available = rng.random(y.shape) < 0.7
    available[:, 0, 0] = True  # a row that never misses a measurement, in a batch that does
    R = model.R * rng.uniform(0.5, 2.0, (steps, *batch, 1, 1))
    keys = RandomKeys(_numbers(*range(70)).keys.reshape(*batch, 2))
    together = track(filter, prior, record._replace(y=y, u=u), keys, available, R)
    for row in (0, 0), (1, 28), (1, 34):  # numbers 0, 63 and 69
        of = slice(None), *row
        alone = track(
            filter, Gaussian(prior.mean[row], prior.cov[row]),
            record._replace(y=y[of], u=u[of]), keys[row], available[of], R[of],
        )  # fmt: skip
        for one, other in zip(together, alone, strict=True):
            assert_same(one[row], other)


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
    system, rng = case.system(0), np.random.default_rng(0)
    filter, record, p = case.make(system.model), simulate(system, 0, 4, 1), system.model.p
    given = {"y": record.y[0], "available": rng.random((4, p)) < 0.5, "R": 1.0 * system.model.R}
    given["y"][1, 0] = np.nan
    kept, history = (
        copy.deepcopy(given | {"u": record.u[0]}),
        [filter.init(system.rows(4), rng=rng)],
    )
    before = copy.deepcopy(history)
    for _ in range(2):
        for step in (partial(filter.update, **given), partial(filter.predict, u=record.u[0])):
            history.append(step(history[-1], rng=rng))
            before.append(copy.deepcopy(history[-1]))
    for name, array in (given | {"u": record.u[0]}).items():
        np.testing.assert_array_equal(array, kept[name], err_msg=name)
    for one, other in zip(history, before, strict=True):
        assert_same(one, other)
    with pytest.raises(dataclasses.FrozenInstanceError):
        history[0].mean = np.zeros(system.model.n)


@pytest.mark.parametrize("masked", [True, False])
@every_case()
def test_the_value_of_a_missing_measurement_has_no_effect(case: Case, masked: bool):
    """A mask says that it is missing, or a value that is not finite."""
    system, rng = case.system(0), np.random.default_rng(1)
    filter, record, keys = case.make(system.model), simulate(system, 0, 6, 10), _numbers(*range(6))
    available = rng.random(record.y.shape) < 0.6
    values = rng.choice([np.nan, np.inf, -np.inf, *([-1e300, 0.0] * masked)], record.y.shape)
    other = record._replace(y=np.where(available, record.y, values))
    tracks = (
        track(filter, system.rows(6), record, keys, available),
        track(filter, system.rows(6), other, keys, available if masked else None),
    )
    for one, two in zip(*tracks, strict=True):
        assert_same(one, two)


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


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
@every_case("deterministic")
def test_masking_a_channel_equals_a_model_without_it(case: Case, seed: int):
    """Step by step from one belief, with another order of the same sums."""
    system, rows = case.system(seed), 3
    model, prior = system.model, system.rows(rows)
    record = simulate(system, seed, rows, 15)
    for j in range(model.p):
        kept = np.arange(model.p) != j
        whole, reduced = case.make(model), case.make(without_channel(model, j))
        one, other = whole.init(prior), reduced.init(prior)
        for k, y in enumerate(record.y):
            if k:
                one, other = (
                    f.predict(b, record.u[k - 1]) for f, b in ((whole, one), (reduced, other))
                )
            one, other = whole.update(one, y, available=kept), reduced.update(other, y[:, kept])
            np.testing.assert_array_equal(one.innovation[:, j], 0.0)
            np.testing.assert_array_equal(one.innovation_cov[:, j, j], 1.0)
            measured = {
                "innovation": one.innovation[:, kept], "available": one.available[:, kept],
                "innovation_cov": one.innovation_cov[:, kept][..., kept],
            }  # fmt: skip
            condition = max(10.0, float(np.linalg.cond(one.innovation_cov).max()))
            same = arrays(other).keys() - measured.keys()
            same = {name for name in same if getattr(other, name).shape == getattr(one, name).shape}
            small = other.replace(**{name: getattr(one, name) for name in same} | measured)
            assert_same(small, other, 1e-12 * condition)
            other = small


@pytest.mark.slow
@every_case("own-noise")
def test_a_covariance_of_a_measurement_replaces_the_models(case: Case):
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
        for part in ("", "input_"):
            cov = getattr(one, f"{part}cov")
            for name, size in ((f"{part}mean", unit), (f"{part}cov", unit**2)) * (cov is not None):
                expected, atol = getattr(one, name), 1e-10 * max(1.0, np.abs(cov).max())
                found = getattr(other, name) / size
                np.testing.assert_allclose(found, expected, rtol=0, atol=atol, err_msg=name)


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
