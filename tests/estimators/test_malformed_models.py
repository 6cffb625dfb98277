"""Options that are no numbers, and matrices for all rows."""

from typing import Any

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, NonlinearModel, make

I2, I4 = np.eye(2), np.eye(4)


OPTIONS: dict[tuple[str, str], list[Any]] = {
    ("ukf", "alpha"): [0.0, np.nan], ("ukf", "beta"): [-0.1], ("ukf-umv", "kappa"): [-4.0],
    ("enkf", "members"): [1, 2.5], ("enkf", "inflation"): [0.0, np.inf], ("etkf", "draws"): ["some"],
    ("huber-kf", "gamma"): [0.0, np.nan], ("huber-kf", "iterations"): [0],
    ("robust-kf", "radius"): [-0.1, np.nan],
    ("pf", "particles"): [], ("pf", "threshold"): [], ("pf", "jitter"): [],
}  # fmt: skip


@pytest.mark.parametrize(("name", "option"), OPTIONS)
def test_an_option_without_meaning_is_refused_by_its_name(name: str, option: str):
    unknown = {"G": I4} if name == "ukf-umv" else {}
    model = LinearModel(I4, I4, I4, I4, **unknown)
    for value in [*OPTIONS[name, option], 10**400, np.array([1.0, 2.0])]:
        with pytest.raises(ValueError, match=f"^{option} must be "):
            make(name, model, **{option: value})


def _one_step(name: str, model: Any, rows: tuple[int, ...]) -> None:
    filter, rng = make(name, model), np.random.default_rng(0)
    belief = filter.init(Gaussian(np.full((*rows, 2), 0.5), I2), rng=rng)
    u, y = np.full((*rows, 2), 0.7), np.zeros((*rows, 2))
    for _ in range(2):
        belief = filter.update(filter.predict(belief, u, rng=rng), y, rng=rng)


def test_constant_matrices_and_few_digits_are_taken():
    for R in (I2, lambda u: np.diag([np.inf, 1.0])):
        _one_step("kf", LinearModel(lambda u: I2, I2, lambda u: I2, R), (4,))
    single = NonlinearModel(lambda x, u: np.sin(x.astype(np.float32)), lambda x, u: x, I2, I2)
    _one_step("ukf", single, (4,))
