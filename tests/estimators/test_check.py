"""`check_filter`: the library's filters pass, and each broken one trips over what is broken in it."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from estimators import (
    Belief,
    ExtendedKalmanFilter,
    Filter,
    KalmanFilter,
    LinearModel,
    NonlinearModel,
    UMVFilter,
    check_filter,
    compiled,
    make,
)
from estimators.engine import is_traced
from tests.estimators.cases import turning_vehicle


@pytest.mark.parametrize("name", ["enkf", "kf-umv-ui"])
def test_filters_of_the_library_pass(name: str):
    check_filter(lambda model: make(name, model))


def test_a_filter_of_another_model_is_tried_on_that():
    system, tried = turning_vehicle(0), []

    def build(model, **options):
        tried.append(model)
        return ExtendedKalmanFilter(model)

    check_filter(build, model=system.model, prior=system.prior, u=np.zeros(2))
    assert tried == [system.model]
    # neither a prior nor a known input
    check_filter(KalmanFilter, model=LinearModel(*4 * [np.eye(1)]))


def test_options_reach_the_filter():
    check_filter(KalmanFilter, input_cov=1.0)  # which only systems with an unknown input can have
    with pytest.raises(
        ValueError, match=r"takes none.*; ValueError: input_cov must be positive semidefinite"
    ):
        check_filter(KalmanFilter, input_cov=-1.0)


# --- what is broken, and the sentence about it ----------------------------------------------------


class Plain(KalmanFilter):
    """A filter of one's own that is right."""


class ForgetsSuper(Plain):
    def __init__(self, model: Any) -> None:
        self.model = model


class NeedsAnother(Plain):
    def __init__(self, model: Any) -> None:
        super().__init__(model)
        raise ValueError("it takes five states")


class Raises(Plain):
    def _predict(self, *arguments: Any) -> Any:
        raise RuntimeError("out of\nsorts")


class OwnMatrices(Plain):
    """Takes C and R from the model, as if every measurement had arrived."""

    def _update(self, belief: Any, u: Any, e: Any, *others: Any) -> Any:
        return super()._update(belief, u, e, self.model.C, self.model.R, None)


class WritesIntoMeasurements(Plain):
    def update(self, belief: Any, y: Any, **others: Any) -> Any:
        updated = super().update(belief, y, **others)
        y[...] = 0.0
        return updated


class DrawsItsOwn(Plain):
    def _begin(self, mean: Any, cov: Any, rng: Any) -> Any:
        self.begun = getattr(self, "begun", 0) + 1
        return {"mean": mean + (self.begun > 4)}


@dataclass(frozen=True, eq=False, kw_only=True)
class Aged(Belief):
    age: Any


class CountsForAll(Plain):
    """A number for the whole batch where each row needs one."""

    record = Aged

    def _begin(self, mean: Any, cov: Any, rng: Any) -> Any:
        return {"age": np.zeros(())}


class OldestCounts(Plain):
    """Every row inflates as the oldest does."""

    record = Aged

    def _begin(self, mean: Any, cov: Any, rng: Any) -> Any:
        return {"age": np.zeros(mean.shape[:-1])}

    def _predict(self, belief: Any, *others: Any) -> Any:
        moved = super()._predict(belief, *others)
        older = belief.age + 1.0
        return moved | {"age": older, "cov": (1.0 + 0.01 * older.max()) * moved["cov"]}


@compiled
class Traced(KalmanFilter):
    """A prediction that knows whether it is traced."""

    def _predict(self, belief: Any, *others: Any) -> Any:
        moved = super()._predict(belief, *others)
        return moved | {"cov": (1.001 if is_traced(belief.mean) else 1.0) * moved["cov"]}


@compiled
class NoFormula(KalmanFilter):
    def _predict(self, *arguments: Any) -> Any:
        moved = super()._predict(*arguments)
        return moved | {"mean": np.sort(moved["mean"])}


@compiled
class WrongWay(KalmanFilter):
    """``K' e`` for ``K e``."""

    def _update(self, belief: Any, u: Any, e: Any, C: Any, *others: Any) -> Any:
        updated = super()._update(belief, u, e, C, *others)
        return updated | {"mean": belief.mean + np.vecmat(e, updated["cov"] @ C.mT)}


def after(step: str, change: Callable[..., Any], base: type = Plain) -> type[Filter]:
    """A filter of which a step returns what ``change (filter, belief, changes, u)`` makes of it."""

    def changed(self: Any, belief: Any, u: Any, *others: Any) -> Any:
        return change(self, belief, getattr(base, step)(self, belief, u, *others), u)

    return type("Own", (base,), {step: changed})


def _remembers(self: Any, belief: Any, changes: Any, u: Any) -> Any:
    self.total = getattr(self, "total", 0) + 1
    return changes | {"cov": changes["cov"] * (1.0 + 0.01 * (self.total > 16))}


def _average(self: Any, belief: Any, changes: Any, u: Any) -> Any:
    mean = changes["mean"]
    return changes | {"mean": mean - 0.01 * mean.mean(tuple(range(mean.ndim - 1)))}


def _writes_into_u(self: Any, belief: Any, changes: Any, u: Any) -> Any:
    u *= 0.5


def _writes_into_the_belief(self: Any, belief: Any, changes: Any, u: Any) -> Any:
    belief.mean[...] = changes["mean"]


PREDICT, UPDATE = "_predict", "_update"
BROKEN = {
    "no super": (ForgetsSuper, r"ForgetsSuper\.__init__ must call super\(\)\.__init__\(model\)"),
    "needs another": (NeedsAnother, r"NeedsAnother takes none of the models .* \(ValueError: it takes five"),
    "nothing": (after(PREDICT, lambda *_: None), r"Own raised TypeError in steps of one row \(.*not NoneType"),
    "flat": (
        after(UPDATE, lambda s, b, c, u: c | {"cov": c["cov"].diagonal(0, -2, -1)}),
        r"Own raised \w+ in steps of one row \(",
    ),
    "raises": (Raises, r"Raises raised RuntimeError in steps of one row \(out of sorts\)$"),
    "one row": (
        after(PREDICT, lambda s, b, c, u: c | {"cov": c["cov"] + 0.0 * np.outer(b.mean, b.mean)}),
        r"Own raised ValueError in steps of 3 rows .* write it for any leading axes",
    ),
    "not finite": (
        after(PREDICT, lambda s, b, c, u: c | {"mean": np.nan * b.mean}),
        r"Own\._predict could not be used: .* must give a finite mean",
    ),
    "not finite after": (
        after(UPDATE, lambda s, b, c, u: c | {"mean": np.nan * b.mean}),
        r"Own\._update could not be used: .* must give a finite mean",
    ),
    "negative": (
        after(UPDATE, lambda s, b, c, u: c | {"cov": -b.cov}),
        r"Own\._update could not be used: .* symmetric and positive semidefinite",
    ),
    "skew": (
        after(PREDICT, lambda s, b, c, u: c | {"cov": c["cov"] + 0.01 * np.triu(np.ones(b.cov.shape), 1)}),
        r"Own\._predict gave a cov that is not symmetric and positive semidefinite",
    ),
    "sure of its input": (
        after(PREDICT, lambda s, b, c, u: c | {"input_cov": -1.0 - c["input_cov"]}, UMVFilter),
        r"Own\._predict gave a input_cov that is not symmetric and positive semidefinite",
    ),
    "average": (after(PREDICT, _average), r"Own\.predict gives a row of a batch another mean than the same row alone"),
    "remembers": (after(PREDICT, _remembers), r"Own gives another \w+ when the same is done again: what changes"),
    "draws": (DrawsItsOwn, r"DrawsItsOwn gives another mean when the same is done again: .* numbers come from rng"),
    "matrices": (OwnMatrices, r"OwnMatrices\.update without any measurement makes cov smaller: use the C and R that"),
    "writes u": (after(PREDICT, _writes_into_u), r"Own raised \w+ in steps of one row .* is given it may only read"),
    "writes belief": (after(UPDATE, _writes_into_the_belief), r"Own raised \w+ in steps of one row .* may only read"),
    "writes y": (WritesIntoMeasurements, r"WritesIntoMeasurements raised \w+ in steps of one row .* it may only read"),
    "counts": (CountsForAll, r"CountsForAll\._predict gave a age that is no array with a row for each"),
    "oldest": (OldestCounts, r"OldestCounts gives another cov where some rows begin again"),
    "traced": (Traced, r"Traced gives another mean compiled than in NumPy: a formula is traced once"),
    "wrong way": (
        WrongWay,
        r"WrongWay raised ValueError in steps of one row \(",
    ),
    "no formula": (NoFormula, r"NoFormula raised NotTraceable in steps of one row \(a traced function cannot"),
}  # fmt: skip


@pytest.mark.parametrize(("broken", "sentence"), BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_filter_is_told_what_is_wrong(broken: type[Filter], sentence: str):
    with pytest.raises((ValueError, TypeError)) as caught:
        check_filter(broken)
    message = str(caught.value)
    assert re.search(sentence, message), message
    assert "\n" not in message


def test_the_same_filter_unbroken_passes():
    check_filter(Plain)


@pytest.mark.parametrize("index", [np.s_[:, :1], np.s_[:1], np.s_[..., :]])
@pytest.mark.parametrize("name", ["ekf", "enkf"])
def test_a_measurement_is_of_any_leading_axes(name: str, index: Any):
    I2 = np.eye(2)
    model = NonlinearModel(lambda x, u: x, lambda x, u: x[index], I2, I2[:1, :1])
    with pytest.raises(ValueError, match=r"^the model's measurement of .* as by x\[\.\.\., :1\]$"):
        check_filter(lambda model: make(name, model), model=model)


@pytest.mark.parametrize("given", [KalmanFilter(LinearModel(*4 * [np.eye(1)])), "kf", None])
def test_what_builds_no_filter_is_refused(given: Any):
    with pytest.raises(
        TypeError, match="check_filter takes a Filter class, or a function of a model"
    ):
        check_filter(given)


def test_a_function_that_returns_no_filter_is_refused():
    with pytest.raises(TypeError, match="<lambda> must return a Filter, got 3"):
        check_filter(lambda model: 3)


def test_an_environment_refuses_a_filter_that_cannot_take_a_step():
    filter, sentence = BROKEN["flat"]
    with pytest.raises(ValueError, match=sentence):
        gym.make("vessel_gym:ThesisCorvette-v0", estimator=filter)
