"""Extended and unscented Kalman filters against FilterPy, an independent implementation."""

from typing import Any

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from estimators import Gaussian, NonlinearModel, compiled, make
from tests.estimators.cases import assert_close, random_covariance

CASES: list[tuple[str, dict[str, float]]] = [
    ("ekf", {}),
    ("ukf", {}),
    ("ukf", {"alpha": 0.3, "kappa": 1.0}),  # close points
    ("ukf", {"alpha": 1.0, "beta": 0.0, "kappa": 0.0}),  # cubature points
    ("ukf", {"alpha": 0.5, "kappa": -1.5}),  # a negative weight in the middle
]


class Extended(ExtendedKalmanFilter):
    """Theirs, with functions and Jacobians of a model."""

    def __init__(self, model: NonlinearModel) -> None:
        super().__init__(model.n, model.p)
        self.model = model

    def predict_x(self, u: Any = None) -> None:
        self.x, self.F = self.model.linearise_transition(self.x, u)

    def update(self, y: Any, R: Any = None) -> None:
        value, slope = (lambda x, i=i: self.model.linearise_measurement(x, None)[i] for i in (0, 1))
        super().update(y, slope, value, R)


@pytest.mark.parametrize(("name", "options"), CASES, ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_every_step_agrees_with_filterpy(seed: int, name: str, options: dict[str, float]):
    rng = np.random.default_rng(seed)
    A, B, C = 0.6 * rng.normal(size=(3, 3)), rng.normal(size=(3, 1)), rng.normal(size=(2, 3))
    model = NonlinearModel(
        compiled(lambda x, u: np.sin(np.matvec(A, x)) + np.matvec(B, u)),
        compiled(lambda x, u: np.matvec(C, x) + 0.1 * np.matvec(C, x) ** 3),
        random_covariance(rng, 3), random_covariance(rng, 2),
    )  # fmt: skip
    points = MerweScaledSigmaPoints(3, **{"alpha": 1.0, "beta": 2.0, "kappa": 0.0} | options)
    functions = lambda x: model.measurement(x, None), lambda x, dt, u: model.transition(x, u)
    other = (
        Extended(model) if name == "ekf" else UnscentedKalmanFilter(3, 2, 1.0, *functions, points)
    )
    filter = make(name, model, **options)
    belief = filter.init(Gaussian(rng.normal(size=3), random_covariance(rng, 3)))
    other.Q, other.R = model.Q, model.R
    for k in range(30):
        y, u, R = rng.normal(size=2), rng.normal(size=1), model.R * (1.0 + k % 3)
        # One step at a time: a nonlinear filter amplifies rounding.
        other.x, other.P = belief.mean.copy(), belief.cov.copy()
        belief = filter.predict(belief, u)
        other.predict(u=u)
        assert_close(belief.mean, other.x, 1e-11)
        assert_close(belief.cov, other.P, 1e-11)
        belief = filter.update(belief, y, R=R)
        other.update(y, R=R)
        found = belief.mean, belief.cov, belief.innovation, belief.innovation_cov
        for one, expected in zip(found, (other.x, other.P, other.y, other.S), strict=True):
            assert_close(one, expected, 1e-11)
