"""Options that are no numbers, and matrices for all rows."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, NonlinearModel, compiled, make, stacked
from estimators.consistency import simulate

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


def _one_step(name: str, model: Any, rows: tuple[int, ...], **options: Any) -> None:
    filter, rng = make(name, model, **options), np.random.default_rng(0)
    belief = filter.init(Gaussian(np.full((*rows, 2), 0.5), I2), rng=rng)
    u, y = np.full((*rows, 2), 0.7), np.zeros((*rows, 2))
    for _ in range(2):
        belief = filter.update(filter.predict(belief, u, rng=rng), y, rng=rng)


def test_constant_matrices_and_few_digits_are_taken():
    for R in (I2, lambda u: np.diag([np.inf, 1.0])):
        _one_step("kf", LinearModel(lambda u: I2, I2, lambda u: I2, R), (4,))
    single = NonlinearModel(lambda x, u: np.sin(x.astype(np.float32)), lambda x, u: x, I2, I2)
    _one_step("ukf", single, (4,))


def _of_other_sizes(form: Any) -> Iterator[tuple[str, NonlinearModel]]:
    """Models with a function that returns one value or three in place of two, and its name."""
    same = {"transition": lambda x, u: x, "measurement": lambda x, u: x}
    for wrong in same:
        for few in (1, 3):  # one value would broadcast
            twice = lambda x, u, few=few: np.concatenate([x, x], -1)[..., :few]  # noqa: E731
            yield wrong, NonlinearModel(*map(form, (same | {wrong: twice}).values()), I2, I2)


@pytest.mark.parametrize("name", ["ekf", "ukf", "enkf", "etkf", "pf", "huber-kf", "steady-kf"])
@pytest.mark.parametrize("form", [lambda function: function, compiled])
def test_a_function_of_another_size_is_refused_by_its_name(name: str, form: Any):
    design = {"design": LinearModel(0.9 * I2, I2, I2, I2)} if name == "steady-kf" else {}
    for wrong, model in _of_other_sizes(form):
        for rows in (), (4,):
            with pytest.raises(ValueError, match=f"^{wrong} must return arrays "):
                _one_step(name, model, rows, **design)


@pytest.mark.parametrize("form", [lambda function: function, compiled])
def test_what_is_made_of_a_model_refuses_another_size_too(form: Any):
    for wrong, model in _of_other_sizes(form):
        with pytest.raises(ValueError, match=f"^{wrong} must return arrays "):
            simulate(model, Gaussian(np.zeros(2), I2), np.random.default_rng(0), 3, 2)
        with pytest.raises(ValueError, match=f"^{wrong} must return arrays "):
            stacked(replace(model, G=I2, H=I2)).evaluated(wrong, np.zeros(4), None)


@pytest.mark.parametrize("wrong", "ABCQRGH")
def test_what_is_made_of_a_matrix_refuses_another_size_too(wrong: str):
    model = LinearModel(**dict.fromkeys("ABCQRGH", I2) | {wrong: lambda u: I2[:1, :1]})
    u, numbers = np.zeros((3, 2, 2)), np.random.default_rng(0)
    with pytest.raises(ValueError, match=f"^{wrong} must return arrays "):
        simulate(model, Gaussian(np.zeros(2), I2), numbers, 2, 3, u, u)
    with pytest.raises(ValueError, match=f"^{wrong} must return arrays "):
        stacked(model).value({"G": "A", "H": "C"}.get(wrong, wrong), u[0, 0])


@pytest.mark.parametrize("name", ["transition_jacobian", "measurement_jacobian"])
@pytest.mark.parametrize("form", [lambda function: function, compiled])
def test_a_jacobian_of_another_size_is_refused_by_its_name(name: str, form: Any):
    same = form(lambda x, u: x)
    for wrong in I2[:1], I2[0]:  # a vector must not take rows for its own
        model = NonlinearModel(same, same, I2, I2, **{name: form(lambda x, u, wrong=wrong: wrong)})
        for rows in (), (2,), (4,):
            with pytest.raises(ValueError, match=f"^{name} must return arrays "):
                _one_step("ekf", model, rows)


@pytest.mark.parametrize("form", [lambda function: function, compiled])
@pytest.mark.parametrize("wrong", "ABCQRGH")
def test_a_matrix_of_another_size_is_refused_by_its_name(wrong: str, form: Any):
    for few in (1, 1), (2, 3), (2,):
        function = form(lambda u, few=few: np.ones(few))
        model = LinearModel(**dict.fromkeys("ABCQRGH", I2) | {wrong: function})
        for rows in (), (4,):
            with pytest.raises(ValueError, match=f"^{wrong} must return arrays "):
                _one_step("kf-umv-ui", model, rows)
