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
    UMVFilter,
    check_filter,
    make,
)
from estimators.engine.matrices import is_traced
from tests.estimators.cases import turning_vehicle


@pytest.mark.parametrize("name", ["enkf", "kf-umv-ui"])
def test_filters_of_the_library_pass(name: str):
    """And its errors are as large as it says: a warning would be an error here."""
    check_filter(lambda model: make(name, model))


def test_a_filter_of_another_model_is_tried_on_that():
    system = turning_vehicle(0)
    tried = []

    def build(model, **options):
        tried.append(model)
        return ExtendedKalmanFilter(model)

    check_filter(build, model=system.model, prior=system.prior, u=np.zeros(2))
    assert tried == [system.model]
    small = LinearModel(
        np.eye(1), np.eye(1), np.eye(1), np.eye(1)
    )  # neither a prior nor a known input
    check_filter(KalmanFilter, model=small)


def test_options_reach_the_filter():
    check_filter(KalmanFilter, input_cov=1.0)  # which only systems with an unknown input can have
    with pytest.raises(
        ValueError, match=r"takes none.*; ValueError: input_cov must be positive semidefinite"
    ):
        check_filter(KalmanFilter, input_cov=-1.0)


# --- what is broken, and the sentence about it ----------------------------------------------------


class Plain(KalmanFilter):
    """A filter of one's own that is right."""


class Nameless(Plain):
    name = ""


class NoModelFirst(Filter):
    def __init__(self) -> None: ...


class ForgetsSuper(Plain):
    def __init__(self, model: Any) -> None:
        self.model = model


class NeedsAnother(Plain):
    def __init__(self, model: Any) -> None:
        super().__init__(model)
        raise ValueError("it takes five states")


class ReturnsNothing(Plain):
    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        return None


class FlatCovariance(Plain):
    def _update(self, belief: Any, measurement: Any, rng: Any) -> Any:
        updated = super()._update(belief, measurement, rng)
        return updated.replace(cov=np.diagonal(updated.cov, axis1=-2, axis2=-1))


class Raises(Plain):
    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        raise RuntimeError("out of\nsorts")


class OneRowOnly(Plain):
    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        moved = super()._predict(belief, u, rng)
        return moved.replace(cov=moved.cov + np.outer(belief.mean, 0.0 * belief.mean))


class NotFinite(Plain):
    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        return super()._predict(belief, u, rng).replace(mean=np.full_like(belief.mean, np.nan))


class NotFiniteAfter(Plain):
    def _update(self, belief: Any, measurement: Any, rng: Any) -> Any:
        return (
            super()
            ._update(belief, measurement, rng)
            .replace(mean=np.full_like(belief.mean, np.nan))
        )


class Negative(Plain):
    def _update(self, belief: Any, measurement: Any, rng: Any) -> Any:
        return belief.replace(cov=-belief.cov)


class Skew(Plain):
    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        moved = super()._predict(belief, u, rng)
        return moved.replace(cov=moved.cov + 0.01 * np.triu(np.ones(moved.cov.shape[-2:]), 1))


class SureOfItsInput(UMVFilter):
    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        moved = super()._predict(belief, u, rng)
        return moved.replace(input_cov=-1.0 - moved.input_cov)


class Average(Plain):
    """Rows share a gain, as if they were one system."""

    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        moved = super()._predict(belief, u, rng)
        rows = tuple(range(moved.mean.ndim - 1))
        return moved.replace(
            mean=moved.mean - 0.01 * moved.mean.mean(rows, keepdims=True) if rows else moved.mean
        )


class Remembers(Plain):
    """Keeps a number in the filter instead of the belief."""

    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        moved = super()._predict(belief, u, rng)
        self.total = getattr(self, "total", 0) + 1
        return moved.replace(cov=moved.cov * (1.0 + 0.01 * (self.total > 20)))


class DrawsItsOwn(Plain):
    def _init(self, belief: Any, rng: Any) -> Any:
        self.draw = getattr(self, "draw", None) or np.random.default_rng(0)
        self.begun = getattr(self, "begun", 0) + 1
        return belief.replace(mean=belief.mean + (self.draw.normal() if self.begun > 4 else 0.0))


class MasksOtherwise(Plain):
    """Looks for NaN before the mask is applied."""

    def update(self, belief: Any, y: Any, **others: Any) -> Any:
        known = np.isfinite(y)
        return super().update(
            belief,
            np.where(known, y, 0.0),
            **({"available": known} | others | {"available": known}),
        )


class OwnMatrices(Plain):
    """Takes C and R from the model, as if every measurement had arrived."""

    def _update(self, belief: Any, measurement: Any, rng: Any) -> Any:
        model = self.model
        return super()._update(belief, measurement._replace(C=model.C, R=model.R), rng)


class WritesIntoU(Plain):
    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        moved = super()._predict(belief, u, rng)
        u *= 0.5
        return moved.replace(u=None)


class WritesIntoItsBelief(Plain):
    def _update(self, belief: Any, measurement: Any, rng: Any) -> Any:
        updated = super()._update(belief, measurement, rng)
        belief.mean[...] = updated.mean
        return updated


class WritesIntoMeasurements(Plain):
    def update(self, belief: Any, y: Any, **others: Any) -> Any:
        updated = super().update(belief, y, **others)
        y[...] = 0.0
        return updated


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Aged(Belief):
    age: Any


class CountsForAll(Plain):
    """A number for the whole batch where each row needs one."""

    record = Aged

    def _init(self, belief: Any, rng: Any) -> Any:
        return Aged.of(belief, age=0)

    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        moved = KalmanFilter._predict(self, belief, u, rng)
        return Aged.of(moved, age=belief.age + 1)

    def _update(self, belief: Any, measurement: Any, rng: Any) -> Any:
        return Aged.of(KalmanFilter._update(self, belief, measurement, rng), age=belief.age)


class OldestCounts(CountsForAll):
    """Every row inflates as the oldest does."""

    def _init(self, belief: Any, rng: Any) -> Any:
        return Aged.of(belief, age=np.zeros(belief.mean.shape[:-1]))

    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        moved = super()._predict(belief, u, rng)
        return moved.replace(cov=(1.0 + 0.01 * belief.age.max()) * moved.cov)


class NeedsNumbers(Plain):
    random = True

    def _init(self, belief: Any, rng: Any) -> Any:
        return belief.replace(mean=belief.mean + 1e-3 * rng.normals(belief.mean.shape[-1]))


class TracedOnce(KalmanFilter):
    formulas = True
    factor = 1.0

    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        moved = super()._predict(belief, u, rng)
        inflated = moved.replace(cov=self.factor * moved.cov)
        self.factor = 1.1
        return inflated


class NoFormula(KalmanFilter):
    formulas = True

    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        moved = super()._predict(belief, u, rng)
        return moved.replace(mean=np.sort(moved.mean))


class OneForBoth(KalmanFilter):
    """A prediction that is another one where it is traced together with an update."""

    formulas = True

    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        self.moved = super()._predict(belief, u, rng)
        return self.moved

    def _update(self, belief: Any, measurement: Any, rng: Any) -> Any:
        updated = super()._update(belief, measurement, rng)
        both = is_traced(belief.mean) and belief is self.moved
        return updated.replace(cov=1.001 * updated.cov) if both else updated


class WrongWay(KalmanFilter):
    """``K' e`` for ``K e``."""

    formulas = True

    def _update(self, belief: Any, measurement: Any, rng: Any) -> Any:
        updated = super()._update(belief, measurement, rng)
        K = updated.cov @ measurement.C.mT
        return updated.replace(mean=belief.mean + np.vecmat(measurement.innovation, K))


BROKEN = [
    (Nameless, r'Nameless\.name must be what the filter is called, such as "my-filter"'),
    (
        NoModelFirst,
        (
            r"NoModelFirst cannot be built as NoModelFirst\(model\): .*take the model first, then"
            r" options"
        ),
    ),
    (ForgetsSuper, r"ForgetsSuper\.__init__ must call super\(\)\.__init__\(model\)"),
    (
        NeedsAnother,
        (
            r"NeedsAnother takes none of the models .* give it one with model= \(ValueError: it"
            r" takes five"
        ),
    ),
    (
        ReturnsNothing,
        r"ReturnsNothing\.predict of one row raised TypeError \(.*_predict must return a belief",
    ),
    (
        FlatCovariance,
        (
            r"FlatCovariance\.update of one row raised ValueError \(.*must return a mean of shape"
            r" \(3,\)"
        ),
    ),
    (Raises, r"Raises\.predict of one row raised RuntimeError \(out of sorts\)$"),
    (
        OneRowOnly,
        r"OneRowOnly\.predict of 3 rows raised ValueError .* write it for any leading axes",
    ),
    (NotFinite, r"NotFinite\._predict gave a mean that is not finite"),
    (NotFiniteAfter, r"NotFiniteAfter\._update could not be used: .* must give a finite mean"),
    (Negative, r"Negative\._update could not be used: .* symmetric and positive semidefinite"),
    (Skew, r"Skew\._predict gave a cov that is not symmetric and positive semidefinite"),
    (
        SureOfItsInput,
        (
            r"SureOfItsInput\._predict gave a input_cov that is not symmetric and positive"
            r" semidefinite"
        ),
    ),
    (Average, r"Average\.predict gives a row of a batch another mean than the same row alone"),
    (
        Remembers,
        (
            r"Remembers gives another cov when the same is done again: what changes belongs in the"
            r" belief"
        ),
    ),
    (
        DrawsItsOwn,
        (
            r"DrawsItsOwn gives another mean when the same is done again: .* random numbers come"
            r" from rng"
        ),
    ),
    (
        MasksOtherwise,
        r"MasksOtherwise gives another \w+ for a measurement that is masked than for NaN",
    ),
    (
        OwnMatrices,
        (
            r"OwnMatrices\.update without any measurement makes cov smaller: take C and R from the"
            r" measurement"
        ),
    ),
    (WritesIntoU, r"WritesIntoU\.predict of one row raised .* is given it may only read"),
    (
        WritesIntoItsBelief,
        r"WritesIntoItsBelief\.update of one row raised .* is given it may only read",
    ),
    (
        WritesIntoMeasurements,
        r"WritesIntoMeasurements\.update of one row raised .* is given it may only read",
    ),
    (CountsForAll, r"CountsForAll\._predict gave a age that is no array with a row for each"),
    (OldestCounts, r"OldestCounts gives another cov where some rows begin again"),
    (NeedsNumbers, r"NeedsNumbers with a NumPy Generator as rng raised AttributeError"),
    (TracedOnce, r"TracedOnce gives another cov compiled than in NumPy: a formula is traced once"),
    (OneForBoth, r"OneForBoth gives another cov compiled than in NumPy"),
    (
        WrongWay,
        r"WrongWay\.update of one row raised TypeError \(.* have no product in a traced formula",
    ),
    (
        NoFormula,
        r"NoFormula\.predict of one row raised TypeError \(NoFormula says that it is formulas",
    ),
]


@pytest.mark.parametrize(("broken", "sentence"), BROKEN, ids=[cls.__name__ for cls, _ in BROKEN])
def test_a_broken_filter_is_told_what_is_wrong(broken: type[Filter], sentence: str):
    with pytest.raises((ValueError, TypeError)) as caught:
        check_filter(broken)
    message = str(caught.value)
    assert re.search(sentence, message), message
    assert "\n" not in message


def test_the_same_filter_unbroken_passes():
    check_filter(Plain)


@pytest.mark.parametrize("given", [KalmanFilter(LinearModel(*4 * [np.eye(1)])), "kf", None])
def test_what_builds_no_filter_is_refused(given: Any):
    with pytest.raises(
        TypeError, match="check_filter takes a Filter class, or a function of a model"
    ):
        check_filter(given)


def test_a_function_that_returns_no_filter_is_refused():
    with pytest.raises(TypeError, match="<lambda> must return a Filter, got 3"):
        check_filter(lambda model: 3)


# --- errors ---------------------------------------------------------------------------------------


def _scaled(factor: float) -> Callable[[Any], Filter]:
    class Scaled(Plain):
        def _update(self, belief: Any, measurement: Any, rng: Any) -> Any:
            updated = super()._update(belief, measurement, rng)
            return (
                updated.replace(cov=factor * updated.cov)
                if measurement.available.any()
                else updated
            )

    return Scaled


@pytest.mark.parametrize(
    ("factor", "words"), [(0.8, "larger .*claims too much"), (1.25, "smaller .*too careful")]
)
def test_errors_that_are_not_as_large_as_the_covariance_get_a_warning(factor: float, words: str):
    with pytest.warns(
        UserWarning,
        match=f"Scaled: its errors are {words}.*the mean NEES of 3 states over 400 runs",
    ):
        check_filter(_scaled(factor))


# --- in an environment ----------------------------------------------------------------------------


@pytest.mark.parametrize("broken", [Nameless, FlatCovariance])
def test_an_environment_refuses_a_filter_that_cannot_take_a_step(broken: type[Filter]):
    sentence = next(sentence for cls, sentence in BROKEN if cls is broken)
    with pytest.raises(ValueError, match=sentence.replace(r"\(3,\)", r"\(\d+,\)")):
        gym.make("vessel_gym:ThesisCorvette-v0", estimator=broken)
