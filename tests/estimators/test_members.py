"""The kernels of the ensemble filters: the formulas in NumPy, row by row to the last bit, and nothing but arithmetic."""

import numpy as np
import pytest

from estimators import Belief, Filter, Gaussian, NonlinearModel, Numbers, ensemble, make
from estimators.angles import near
from estimators.linalg import semidefinite_cholesky
from estimators.members import PROCESS
from tests.estimators.cases import Case, arrays, assert_same, every_case, random_covariance, simulate

ROWS = 9
TAPER = np.linspace(0.0, 1.0, 20).reshape(5, 4)
MASK = np.array([[1, 1, 0, 0], [0, 1, 1, 0], [1, 1, 0, 0], [0, 0, 0, 0], [0, 0, 1, 1]])
FILTERS = [
    ("enkf", {}),
    ("enkf", {"inflation": 1.1, "localisation": TAPER}),
    ("etkf", {}),
    ("enkf-sr", {"inflation": 1.1, "localisation": MASK}),
]


def _in_numpy(filter: Filter) -> Filter:
    """The same filter without kernels for the update."""
    kind = type(filter)
    own = type(kind.__name__, (kind,), {"_compiled": False, "_ours": True})
    slow = own.__new__(own)
    slow.__dict__.update(filter.__dict__)
    return slow


def _wrapping(seed: int = 0) -> NonlinearModel:
    """Five states and four readings, all of them correlated; an angle among each, which the functions wrap."""
    rng = np.random.default_rng(seed)
    A, C = 0.5 * rng.normal(size=(5, 5)), rng.normal(size=(4, 5))

    def folded(x: np.ndarray, i: int) -> np.ndarray:
        x = np.array(x)
        x[..., i] = np.arctan2(np.sin(x[..., i]), np.cos(x[..., i]))
        return x

    return NonlinearModel(
        lambda x, u: folded(x @ A.T + 0.1 * np.sin(x), 2), lambda x, u: folded(x @ C.T + 0.1 * np.cos(x[..., :4]), 1),
        Q=random_covariance(rng, 5), R=0.1 * random_covariance(rng, 4), state_angles=(2,), measurement_angles=(1,),
    )  # fmt: skip


def _predicted(filter: Filter, spread: float, rows: slice = slice(None)) -> tuple[Belief, np.ndarray, np.ndarray]:
    """Predictions of rows about the cut of the angles, readings, and which of them arrive."""
    rng = np.random.default_rng(1)
    mean, y = rng.normal(size=(ROWS, 5)) + [0, 0, np.pi, 0, 0], rng.normal(size=(ROWS, 4))
    available = rng.random((ROWS, 4)) < 0.7
    available[0], available[1] = False, True
    numbers = Numbers.seeded(range(ROWS))[rows]
    begun = filter.init(Gaussian(mean[rows], spread**2 * np.eye(5)), rng=numbers)
    return filter.predict(begun, rng=numbers.at(1)), y[rows], available[rows]


@pytest.mark.parametrize("spread", [0.05, 2.0], ids=["members close together", "angles all round"])
@pytest.mark.parametrize("members", [2, 7, 100])
@pytest.mark.parametrize(("name", "options"), FILTERS)
def test_the_kernels_update_as_the_formulas_do(name: str, options: dict[str, object], members: int, spread: float):
    filter = make(name, _wrapping(), members=members, **options)
    before, y, available = _predicted(filter, spread)
    numbers = Numbers.seeded(range(ROWS)).at(1)
    R = random_covariance(np.random.default_rng(2), 4)
    for changed in (None, R, np.linspace(1.0, 2.0, ROWS)[:, None, None] * R):
        one, other = (
            f.update(before, y, rng=numbers, available=available, R=changed) for f in (filter, _in_numpy(filter))
        )
        assert one.healthy.all()
        assert_same(one, other, 1e-12)


@pytest.mark.parametrize("spread", [0.05, 2.0])
@pytest.mark.parametrize("members", [2, 7, 100])
def test_the_kernel_predicts_as_the_formulas_do(members: int, spread: float):
    model = _wrapping()
    filter, numbers = make("enkf", model, members=members), Numbers.seeded(range(ROWS))
    mean = np.tile([0, 0, np.pi, 0, 0], (ROWS, 1))
    begun = filter.init(Gaussian(mean, spread**2 * np.eye(5)), rng=numbers)
    x = begun.ensemble
    after = model.transition(x, None)
    step = after[..., 2] - x[..., 2]
    apart = (np.abs(step - step[:, :1]) > np.pi).any(-1)
    after[apart, :, 2] = (x[..., 2] + near(step, step[:, :1]))[apart]
    normals = numbers.at(1).members(members, filter._noise_root.shape[-1], PROCESS)
    noise = (normals - normals.mean(-2, keepdims=True)) @ filter._noise_root.T
    predicted = filter.predict(begun, rng=numbers.at(1))
    np.testing.assert_allclose(predicted.mean, after.mean(-2), rtol=0, atol=1e-13)
    np.testing.assert_allclose(predicted.ensemble, after + noise, rtol=0, atol=1e-12)
