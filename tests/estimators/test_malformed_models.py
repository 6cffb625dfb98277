"""Options that are no numbers, and functions that do not repeat themselves."""

import math
from functools import partial
from typing import Any

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, NonlinearModel, StateNoise, compiled, make

I2, I4 = np.eye(2), np.eye(4)


OPTIONS: dict[tuple[str, str], list[Any]] = {
    ("ukf", "alpha"): [0.0, np.nan], ("ukf", "beta"): [-0.1], ("ukf-umv", "kappa"): [-4.0],
    ("enkf", "members"): [1, 2.5], ("enkf", "inflation"): [0.0, np.inf], ("etkf", "draws"): ["some"],
    ("huber-kf", "gamma"): [0.0, np.nan], ("huber-kf", "iterations"): [0],
    ("robust-kf", "radius"): [-0.1, np.nan],
    ("iekf", "iterations"): [], ("iekf", "tolerance"): [],
    ("pf", "particles"): [], ("pf", "threshold"): [], ("pf", "jitter"): [],
}  # fmt: skip


@pytest.mark.parametrize(("name", "option"), OPTIONS)
def test_an_option_without_meaning_is_refused_by_its_name(name: str, option: str):
    unknown = {"G": I4} if name == "ukf-umv" else {}
    model = LinearModel(I4, I4, I4, I4, **unknown)
    for value in [*OPTIONS[name, option], 10**400, np.array([1.0, 2.0])]:
        with pytest.raises(ValueError, match=f"^{option} must be "):
            make(name, model, **{option: value})


# --- functions at their first use: several rows, each alone, twice --------------------------------


def _mixed(x: Any, *_: Any) -> Any:
    x = x.copy()
    x[0] += x[1]
    return x


ROWS = "must broadcast over leading axes, and give each row what it gives it alone: index"
TWICE = "gave two values for the same arguments"
VECTORS: list[tuple[Any, str]] = [
    (_mixed, ROWS),
    (lambda x, u: x - x.mean(), ROWS),
    (lambda x, u: x[:2], ROWS),
    (lambda x, u: x[..., :1], r"gave shape \(1,\) for one row, expected \(2,\)"),
    (lambda x, u: x * np.random.default_rng().normal(), f"{TWICE}: it must depend on these alone"),
    (lambda x, u: [x[..., 0], x[..., 1]], r"must return an array of real numbers, .* got \[array"),
    (lambda x, u: x * math.sin(x[0]), "fails: .*it gets arrays"),
    (lambda x: x, r"fails: .*as a function of \(x, u\) it gets arrays"),
    (lambda x, u: 1j * x, "must return an array of real numbers, .* got array"),
]
MATRICES: list[tuple[Any, str]] = [
    (lambda u: I2 * u[0] ** 2, ROWS),
    (lambda u: np.eye(3) * u[..., :1, None], r"gave shape \(3, 3\) for one row, expected"),
    (lambda u: I2 * np.random.default_rng().random(), TWICE),
    (lambda x, u: I2, r"fails: .*as a function of \(u\) it gets arrays"),
]


def _one_step(name: str, model: Any, rows: tuple[int, ...]) -> None:
    filter, rng = make(name, model), np.random.default_rng(0)
    belief = filter.init(Gaussian(np.full((*rows, 2), 0.5), I2), rng=rng)
    u, y = np.full((*rows, 2), 0.7), np.zeros((*rows, 2))
    for _ in range(2):
        belief = filter.update(filter.predict(belief, u, rng=rng), y, rng=rng)


@pytest.mark.parametrize("rows", [(), (4,)], ids=["alone", "batch"])
@pytest.mark.parametrize(("function", "sentence"), VECTORS)
@pytest.mark.parametrize("name", ["transition", "measurement"])
def test_a_function_of_vectors_that_is_none_of_each_row_is_refused_in_a_sentence(
    name: str, function: Any, sentence: str, rows: tuple[int, ...]
):
    functions = {"transition": lambda x, u: 0.9 * x, "measurement": lambda x, u: x}
    for filter in ("ekf", "ukf", "enkf", "pf"):
        model = NonlinearModel(**(functions | {name: function}), Q=I2, R=I2)
        with pytest.raises((ValueError, TypeError), match=f"{name} {sentence}") as caught:
            _one_step(filter, model, rows)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rows", [(), (4,)], ids=["alone", "batch"])
@pytest.mark.parametrize(("function", "sentence"), MATRICES)
@pytest.mark.parametrize("name", ["A", "C", "B", "G", "Q", "R", "H"])
def test_a_matrix_of_u_that_is_none_of_each_row_is_refused_in_a_sentence(
    name: str, function: Any, sentence: str, rows: tuple[int, ...]
):
    matrices = dict.fromkeys("ACQR", I2) | ({"G": I2, "H": I2} if name in "GH" else {"B": I2})
    model = LinearModel(**(matrices | {name: function}))
    with pytest.raises((ValueError, TypeError), match=f"{name} {sentence}"):
        _one_step("kf-umv-ui" if name in "GH" else "kf", model, rows)


@pytest.mark.parametrize("way", [compiled, lambda f: f], ids=["compiled", "numpy"])
def test_jacobians_noise_and_g_of_the_state_are_compared_too(way: Any):
    f, wrong = way(lambda x, u: 1.0 * x), way(lambda x, u: I2 * x[0] ** 2)
    for name in ("transition_jacobian", "measurement_jacobian", "R", "G"):
        part = {name: StateNoise(wrong, I2) if name == "R" else wrong}
        unknown = {"H": np.zeros((2, 2))} if name == "G" else {}
        model = NonlinearModel(f, f, **({"Q": I2, "R": I2} | part | unknown))
        with pytest.raises(ValueError, match=f"^{name} {ROWS}"):
            _one_step("ekf-ui-wdf" if name == "G" else "ekf", model, (4,))


def test_a_compiled_function_that_reads_what_changes_is_refused():
    gain = [0.5]
    frozen = compiled(lambda x, u: gain[0] * x)
    make_model = partial(NonlinearModel, frozen, lambda x, u: x, I2, I2)
    _one_step("ekf", make_model(), (4,))
    gain[0] = 0.6
    with pytest.raises(ValueError, match=r"^transition gives other values compiled"):
        _one_step("ekf", make_model(), (4,))


def test_a_function_is_compared_once_and_where_it_is_finite():
    calls: list[tuple[int, ...]] = []

    def move(x: Any, u: Any) -> Any:
        calls.append(x.shape)
        return 0.9 * x

    model = NonlinearModel(move, lambda x, u: x, I2, I2)
    for x in (np.full((4, 2), np.nan), np.ones((4, 2))):
        model.transition(x, None)
        assert (len(calls) > 1) == np.isfinite(x).all()
    calls.clear()
    model.transition(np.ones((4, 2)), None)
    assert calls == [(4, 2)]


def test_constant_matrices_and_few_digits_are_taken():
    for R in (I2, lambda u: np.diag([np.inf, 1.0])):
        _one_step("kf", LinearModel(lambda u: I2, I2, lambda u: I2, R), (4,))
    single = NonlinearModel(lambda x, u: np.sin(x.astype(np.float32)), lambda x, u: x, I2, I2)
    _one_step("ukf", single, (4,))
