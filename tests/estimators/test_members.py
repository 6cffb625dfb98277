"""Ensemble filters against textbook formulas of one row."""

import numpy as np
import pytest
from scipy.linalg import sqrtm

from estimators import (
    Belief,
    Filter,
    Gaussian,
    NonlinearModel,
    RandomKeys,
    compiled,
    make,
)
from estimators.angles import difference
from estimators.ensemble import MEASUREMENTS, PROCESS
from estimators.linalg import masked, semidefinite_cholesky
from tests.estimators.cases import assert_close, random_covariance

ROWS = 9
FILTERS = [("enkf", {}), ("enkf", {"inflation": 1.1}), ("etkf", {}), ("etkf", {"inflation": 1.1})]
SIZES = pytest.mark.parametrize(
    ("members", "draws"),
    [(2, "independent"), (7, "independent"), (16, "exact"), (100, "exact")],
)
SPREADS = pytest.mark.parametrize(
    "spread", [0.05, 2.0], ids=["members close together", "angles all round"]
)


def _wrapping(seed: int = 0) -> NonlinearModel:
    """Five states and four measurements, all correlated; the functions wrap an angle of each."""
    rng = np.random.default_rng(seed)
    A, C = 0.5 * rng.normal(size=(5, 5)), rng.normal(size=(4, 5))

    def folded(x: np.ndarray, i: int) -> np.ndarray:
        return np.where(np.arange(x.shape[-1]) == i, np.arctan2(np.sin(x), np.cos(x)), x)

    return NonlinearModel(
        compiled(lambda x, u: folded(np.matvec(A, x) + 0.1 * np.sin(x), 2)),
        compiled(lambda x, u: folded(np.matvec(C, x) + 0.1 * np.cos(x[..., :4]), 1)),
        Q=random_covariance(rng, 5), R=0.1 * random_covariance(rng, 4), state_angles=(2,), measurement_angles=(1,),
    )  # fmt: skip


def _begun(filter: Filter, spread: float) -> tuple[Belief, RandomKeys, np.ndarray, np.ndarray]:
    """Beliefs of rows about the cut of the angles, random numbers, measurements and their mask."""
    rng = np.random.default_rng(1)
    mean, y = rng.normal(size=(ROWS, 5)) + [0, 0, np.pi, 0, 0], rng.normal(size=(ROWS, 4))
    available = rng.random((ROWS, 4)) < 0.7
    available[0], available[1] = False, True
    numbers = RandomKeys.seeded(range(ROWS))
    belief = filter.init(Gaussian(mean, spread**2 * np.eye(5)), rng=numbers)
    return belief, numbers.at(1), y, available


def _near(angle: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """The angles, whole turns taken off so that they lie within half a turn of ``centre``."""
    return angle - 2.0 * np.pi * np.rint((angle - centre) / (2.0 * np.pi))


def _together(angle: np.ndarray) -> np.ndarray:
    """Angles ``(..., N)`` of members, whole turns taken off so that they lie about their mean.

    Their mean is the circular one, and lies within half a turn of the first.
    """
    middle = np.arctan2(np.sin(angle).mean(-1), np.cos(angle).mean(-1))[..., None]
    return _near(angle, _near(middle, angle[..., :1]))


def _centred(numbers: RandomKeys, members: int, count: int, use: int) -> np.ndarray:
    normals = numbers.members(members, count, use)
    return normals - normals.mean(-2, keepdims=True)


def _exact(normals: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Centred normals ``(N, r)`` of one row, uncorrelated with anomalies ``(N, n)``, made white."""
    rest = normals - A @ np.linalg.lstsq(A, normals)[0]
    return rest @ np.linalg.inv(np.linalg.cholesky(rest.T @ rest / (len(A) - 1))).T


def _analysis(
    filter: Filter,
    belief: Belief,
    y: np.ndarray,
    arrived: np.ndarray,
    R: np.ndarray,
    numbers: RandomKeys,
    draws: str,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Members after a measurement of one row, mean, innovation and its covariance, by formulas."""
    model, N, p = filter.model, filter.members, filter.model.p
    Y = model.measurement(belief.ensemble, None)
    Y[:, 1] = _together(Y[:, 1])
    e = np.where(arrived, difference(y, Y.mean(0), model.measurement_angles), 0.0)
    A, Y = belief.ensemble - belief.mean, np.where(arrived, Y - Y.mean(0), 0.0)
    R = masked(R, arrived)
    root = semidefinite_cholesky(R)
    S, mean = Y.T @ Y / (N - 1) + R, np.array(belief.mean)
    gain = A.T @ Y / (N - 1) @ np.linalg.inv(S)
    mean += gain @ e
    if filter.name == "enkf":
        normals = _centred(numbers, N, p, MEASUREMENTS)
        if draws == "exact":
            used = (np.abs(root[arrived]) > 0.0).any(0)
            normals = np.where(used, normals, 0.0)
            normals[:, used] = _exact(normals[:, used], A)
        A = A + (normals @ root.T - Y) @ gain.T
    else:  # the symmetric root of an N x N matrix
        whole = np.eye(N) + Y @ np.linalg.inv(R) @ Y.T / (N - 1)
        A = np.linalg.inv(sqrtm(whole).real) @ A
    A *= filter.inflation if arrived.any() else 1.0
    return mean + A, mean, e, S


@SPREADS
@SIZES
@pytest.mark.parametrize(("name", "options"), FILTERS)
def test_updates_are_those_of_the_textbook_formulas(
    name: str, options: dict[str, object], members: int, draws: str, spread: float
):
    filter = make(name, _wrapping(), members=members, draws=draws, **options)
    begun, numbers, y, available = _begun(filter, spread)
    before = filter.predict(begun, rng=numbers)
    own = np.linspace(1.0, 2.0, ROWS)[:, None, None] * random_covariance(
        np.random.default_rng(2), 4
    )
    for R in (None, own):
        after = filter.update(before, y, rng=numbers, available=available, R=R)
        assert after.healthy.all()
        for row in range(ROWS):
            noise = filter.model.R if R is None else R[row]
            ensemble, mean, e, S = _analysis(
                filter, before[row], y[row], available[row], noise, numbers[row], draws
            )
            found = (
                after[row].ensemble,
                after[row].mean,
                after[row].innovation,
                after[row].innovation_cov,
            )
            for one, other in zip(found, (ensemble, mean, e, S), strict=True):
                assert_close(one, other, 1e-12)


@SPREADS
@SIZES
def test_predictions_are_those_of_the_textbook_formulas(members: int, draws: str, spread: float):
    filter = make("enkf", _wrapping(), members=members, draws=draws)
    begun, numbers, *_ = _begun(filter, spread)
    after = filter.model.transition(begun.ensemble, None)
    after[..., 2] = _together(after[..., 2])
    normals = _centred(numbers, members, filter._noise_root.shape[-1], PROCESS)
    if draws == "exact":
        moved = after - after.mean(-2, keepdims=True)
        normals = np.stack(
            [_exact(own, anomalies) for own, anomalies in zip(normals, moved, strict=True)]
        )
    noise = normals @ filter._noise_root.T
    predicted, mean, ensemble = filter.predict(begun, rng=numbers), after.mean(-2), after + noise
    ensemble[..., 2] = _together(ensemble[..., 2])
    mean[:, 2] = ensemble[..., 2].mean(-1)
    np.testing.assert_allclose(predicted.mean, mean, rtol=0, atol=1e-13)
    np.testing.assert_allclose(predicted.ensemble, ensemble, rtol=0, atol=1e-12)
