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
        wide, numbers = stacked(replace(model, G=I2, H=I2)), np.random.default_rng(0)
        for use in (
            lambda: simulate(model, Gaussian(np.zeros(2), I2), numbers, 3, 2),  # noqa: B023
            lambda: getattr(wide, f"linearise_{wrong}")(np.zeros(4), None),  # noqa: B023
        ):
            with pytest.raises(ValueError, match=f"^{wrong} must return arrays "):
                use()


def test_what_is_made_of_a_matrix_refuses_another_size_too():
    u, start, numbers = np.zeros((3, 2, 2)), Gaussian(np.zeros(2), I2), np.random.default_rng(0)
    for wrong in "ABCQRGH":
        matrices = {name: I2 for name in "ABCQRGH"} | {wrong: lambda u: I2[:1, :1]}
        wide = stacked(LinearModel(**matrices))
        if wrong in "QR":
            uses = [lambda: wide.value(wrong, u)]  # noqa: B023
        else:
            step = wide.linearise_transition if wrong in "ABG" else wide.linearise_measurement
            uses = [lambda: step(np.zeros(4), u[0, 0])]  # noqa: B023
        if wrong != "C":
            uses.append(lambda: simulate(LinearModel(**matrices), start, numbers, 2, 3, u, u))  # noqa: B023
        for use in uses:
            with pytest.raises(ValueError, match=f"^{wrong} must return arrays "):
                use()


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
    matrices, sizes = {name: I2 for name in "ABCQR"}, [(1, 1), (2, 3), (2,)]
    if wrong in "GH":
        matrices |= {"G": I2, "H": I2}
    for few in sizes:
        function = form(lambda u, few=few: np.ones(few))
        model = LinearModel(**matrices | {wrong: function})
        for rows in (), (4,):
            with pytest.raises(ValueError, match=f"^{wrong} must return arrays "):
                _one_step("kf-umv-ui" if wrong in "GH" else "kf", model, rows)
