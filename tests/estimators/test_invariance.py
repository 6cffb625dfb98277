"""No estimate depends on the zero of an angle or the origin of coordinates, which are conventions.

Both are moved for every filter, with functions that wrap their angles at the cut that results, and
the estimates are moved back. What is left is rounding: a state at 5e6 m has digits of 1e-9 m.
"""

import dataclasses
import functools

import numpy as np
import pytest

from estimators import Belief, compiled, make, wrap
from tests.estimators.cases import (
    INPUT_PRIOR,
    Record,
    System,
    pushed_vehicle,
    simulate,
    track,
    turning_vehicle,
)

FAR = np.array([6e5, -5e6])
"""A place in UTM coordinates [m]."""
NONLINEAR = (
    "ekf", "ukf", "enkf", "etkf", "pf", "huber-kf", "robust-kf",
)  # fmt: skip
PUSHED = ("ekf-ui-wdf", "ukf-umv")


def _moved(system: System, origin: np.ndarray, zero: float) -> System:
    """A vehicle's system with its origin at ``-origin`` and its headings counted from ``-zero``."""
    model = system.model
    shift = np.array([*origin, zero, 0.0])

    def folded(x: np.ndarray, angles: tuple[int, ...]) -> np.ndarray:
        return np.where(np.isin(np.arange(x.shape[-1]), angles), wrap(x), x)

    moved = dataclasses.replace(
        model,
        transition=compiled(lambda x, u: folded(model.transition(x - shift, u) + shift, (2,))),
        measurement=compiled(
            lambda x, u: folded(model.measurement(x - shift, u) + [0.0, zero, zero], (1, 2))
        ),
        G=None if model.G is None else compiled(lambda x, u: model.G(x - shift, u)),
    )
    return dataclasses.replace(system, model=moved, mean=system.mean + shift)


@functools.cache
def _at_home(name: str) -> tuple[System, Record, list[Belief]]:
    """A vehicle, its flight, and what the filter says of it where nothing is moved."""
    system = (pushed_vehicle if name in PUSHED else turning_vehicle)(3)
    record = simulate(system, 4, 8, 12)
    return system, record, _flown(system, name, record, 0.0)


def _flown(system: System, name: str, record: Record, zero: float) -> list[Belief]:
    options = {"input_prior": INPUT_PRIOR} if name in PUSHED else {}
    filter, moved = make(name, system.model, **options), record.y + [0.0, zero, zero]
    prior, rng = system.rows(moved.shape[1]), np.random.default_rng(5)
    return track(filter, prior, record._replace(y=moved), rng)


def _apart(one: list[Belief], other: list[Belief], shift: np.ndarray) -> float:
    """The largest difference of two series of beliefs, less ``shift``, in standard deviations."""
    worst = 0.0
    for a, b in zip(one, other, strict=True):
        sd = np.sqrt(np.diagonal(a.cov, axis1=-2, axis2=-1))
        error = b.mean - shift - a.mean
        error[..., 2] = wrap(error[..., 2])
        spread = np.abs(b.cov - a.cov) / (sd[..., None] * sd[..., None, :])
        worst = max(worst, float(np.abs(error / sd).max()), float(spread.max()))
        if a.input_mean is not None:
            worst = max(worst, float(np.abs(b.input_mean - a.input_mean).max()))
        np.testing.assert_array_equal(b.healthy, a.healthy)
    return worst


# Values of size v have an error of eps v, in standard deviations s, which 12 steps of a filter with
# gains and covariances of condition some 100 may enlarge: 2e-16 * 50 / 0.05 * 100 = 2e-11 where
# only angles move ...
SEAM = 2e-11
# ... and at 5e6 m 1e-9 / 0.05 * 100 = 2e-6.
PLACE = 2e-6


@pytest.mark.parametrize("measurement", [1, 2], ids=["bearing", "heading"])
@pytest.mark.parametrize("name", NONLINEAR + PUSHED)
def test_the_estimate_does_not_depend_on_where_an_angle_is_cut(name: str, measurement: int):
    system, record, home = _at_home(name)
    zero = np.pi - system.model.measurement(record.x, record.u)[..., measurement].mean()
    moved = _moved(system, np.zeros(2), zero)
    across = moved.model.measurement(record.x + [0, 0, zero, 0], record.u)[..., measurement]
    assert across.min() < 0.1 - np.pi
    assert across.max() > np.pi - 0.1
    assert _apart(home, _flown(moved, name, record, zero), zero * np.eye(4)[2]) < SEAM


@pytest.mark.parametrize("name", ["ekf", "ukf", "enkf", "pf", "ekf-ui-wdf"])
def test_the_estimate_does_not_depend_on_the_origin(name: str):
    system, record, home = _at_home(name)
    moved = _moved(system, FAR, 0.0)
    assert _apart(home, _flown(moved, name, record, 0.0), np.array([*FAR, 0, 0])) < PLACE
