"""Whatever a filter is given, it answers in one sentence or with a belief that is one.

`pytest --hypothesis-profile thorough` tries 10,000 examples of each.
"""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators import Belief, Filter, Gaussian, LinearModel, NonlinearModel, Recovery, make, names

NUMBERS = st.one_of(
    st.floats(-3.0, 3.0),
    st.sampled_from([0.0, 1.0, -1.0, 1e-8, 1e8, 1e-160, 1e160, -1e308, 5e-324, np.nan, np.inf, -np.inf]),
)
SIZES = st.integers(1, 3)
JUNK = st.sampled_from(
    [
        None,
        "a",
        "",
        [],
        {},
        object(),
        True,
        2,
        -1,
        0.5,
        1e400,
        np.nan,
        [1, "a"],
        [[1.0], [1.0, 2.0]],
        1j,
        (),
        lambda u: u,
    ]
)


def _arrays(*shape: int) -> st.SearchStrategy[Any]:
    """An array of a shape, mostly; sometimes of another, sometimes none."""
    size = int(np.prod(shape))
    right = st.lists(NUMBERS, min_size=size, max_size=size).map(lambda values: np.reshape(values, shape))
    tame = st.lists(st.floats(-2.0, 2.0), min_size=size, max_size=size).map(lambda values: np.reshape(values, shape))
    wrong = st.lists(NUMBERS, max_size=6).map(np.array)
    return st.one_of(tame, tame, right, right, wrong, JUNK)


def _covariances(n: int) -> st.SearchStrategy[Any]:
    tame = st.lists(st.floats(-2.0, 2.0), min_size=n * n, max_size=n * n)
    square = tame.map(lambda values: np.reshape(values, (n, n)) @ np.reshape(values, (n, n)).T)
    scaled = st.tuples(square, st.sampled_from([0.0, 1e-300, 1e-12, 1.0, 1e12, 1e150, 1e300])).map(
        lambda p: p[0] * p[1]
    )
    return st.one_of(square, square, scaled, scaled, _arrays(n, n))


def _sentence(error: Exception) -> None:
    text = str(error)
    assert isinstance(error, ValueError | TypeError), repr(error)
    assert text, repr(error)
    assert "\n" not in text, text


def _check(belief: Belief) -> None:
    for name in ("mean", "cov", "input_mean", "input_cov", "ensemble", "feedthrough_mean"):
        array = getattr(belief, name, None)
        assert array is None or np.isfinite(array).all(), name
    np.testing.assert_array_equal(belief.cov, belief.cov.mT)
    with np.errstate(over="ignore"):
        size = np.abs(belief.cov).max()
    values = np.linalg.eigvalsh(belief.cov / (size if size > 0.0 else 1.0))
    assert values.min() >= -1e-10 * np.abs(values).sum()


def _options(name: str) -> st.SearchStrategy[dict[str, Any]]:
    known = {
        "kf": ["input_cov"], "iekf": ["iterations", "tolerance"],
        "ukf": ["alpha", "beta", "kappa"], "huber-kf": ["gamma", "iterations", "tolerance"],
        "robust-kf": ["radius"], "enkf": ["inflation", "draws"], "etkf": ["inflation", "draws"],
        "enkf-sr": ["inflation", "draws"], "pf": ["threshold", "jitter"], "ukf-umv": ["input_prior", "alpha"],
    }.get(name, ["input_prior"] if name != "ekf" else [])  # fmt: skip
    value = st.one_of(JUNK, NUMBERS, _arrays(2, 2))
    some = st.dictionaries(st.sampled_from([*known, "colour"]), value, max_size=1)
    return st.one_of(st.just({}), st.just({}), some)


@st.composite
def _models(draw: st.DrawFn, nonlinear: bool) -> tuple[Any, int, int]:
    n, p, q, m = draw(SIZES), draw(SIZES), draw(st.integers(0, 2)), draw(st.integers(0, 1))
    Q, R = draw(_covariances(n)), draw(_covariances(p))
    unknown = {"G": draw(_arrays(n, q)), "H": draw(st.one_of(st.none(), _arrays(p, q)))} if q else {}
    A, C = draw(_arrays(n, n)), draw(_arrays(p, n))
    angles = {"measurement_angles": draw(st.sampled_from([(), (), (0,), (7,), "a", None]))}
    if not nonlinear:
        return LinearModel(A, C, Q, R, B=draw(_arrays(n, m)) if m else None, **unknown, **angles), p, m
    bend = draw(st.sampled_from([np.sin, np.square, np.sqrt, np.exp, np.log, lambda x: 1.0 / x, lambda x: x]))
    model = NonlinearModel(
        lambda x, u: bend(np.matvec(A, x)), lambda x, u: bend(np.matvec(C, x)), Q, R, **unknown, **angles
    )
    return model, p, m


@pytest.mark.parametrize("value", [10**400, np.array([1.0, 2.0])], ids=["too large", "an array"])
@pytest.mark.parametrize(
    ("name", "option"),
    [("ukf", "alpha"), ("ukf", "beta"), ("ukf", "kappa"), ("enkf", "members"), ("enkf", "inflation"),
     ("etkf", "draws"), ("huber-kf", "gamma"), ("huber-kf", "iterations"), ("huber-kf", "tolerance"),
     ("robust-kf", "radius"),
     ("iekf", "iterations"), ("iekf", "tolerance"),
     ("pf", "particles"), ("pf", "threshold"), ("pf", "jitter")],
)  # fmt: skip
def test_an_option_that_is_too_large_or_no_number_is_refused_by_its_name(name: str, option: str, value: Any):
    model = LinearModel(np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    with pytest.raises(ValueError, match=f"^{option} must be "):
        make(name, model, **{option: value})


@pytest.mark.slow
@given(st.data(), st.sampled_from(names()))
def test_whatever_a_filter_is_given_it_answers_with_a_sentence_or_a_belief(data: st.DataObject, name: str):
    try:
        nonlinear = data.draw(st.booleans())
        model, p, m = data.draw(_models(nonlinear))
        options = data.draw(_options(name))
        few = {"members": 5, "draws": "independent"}
        members = {"pf": {"particles": 5}} | dict.fromkeys(("enkf", "enkf-sr", "etkf"), few)
        filter = make(name, model, **{**members.get(name, {}), **options})
        prior = Gaussian(data.draw(_arrays(model.n)), data.draw(_covariances(model.n)))
        rng = np.random.default_rng(0)
        belief = filter.init(prior, rng=rng)
    except (ValueError, TypeError) as error:
        _sentence(error)
        return
    _check(belief)
    for _ in range(data.draw(st.integers(1, 3))):
        measurement = {
            "available": data.draw(st.one_of(st.none(), st.lists(st.booleans(), min_size=p, max_size=p), JUNK)),
            "R": data.draw(st.one_of(st.none(), st.none(), _covariances(p))),
        }
        u = data.draw(st.one_of(st.just(np.ones(m)), _arrays(m))) if m else data.draw(st.one_of(st.none(), JUNK))
        try:
            predicted = filter.predict(belief, u, rng=rng)
            belief = filter.update(predicted, data.draw(_arrays(p)), rng=rng, **measurement)
        except (ValueError, TypeError) as error:
            _sentence(error)
            continue
        _check(belief)
        if not (np.isfinite(predicted.mean).all() and np.isfinite(predicted.cov).all()):
            assert belief.recovery == Recovery.PRIOR


class _Own(Filter):
    """A filter of one's own with whatever its methods return."""

    def __init__(self, model: LinearModel, returned: Any, method: str) -> None:
        super().__init__(model)
        self.returned, self.method = returned, method

    def _given(self, method: str, belief: Belief) -> Belief:
        if method != self.method:
            return belief
        return self.returned(belief) if callable(self.returned) else self.returned

    def _init(self, belief: Belief, rng: Any) -> Belief:
        return self._given("_init", belief)

    def _predict(self, belief: Belief, u: Any, rng: Any) -> Belief:
        return self._given("_predict", belief)

    def _update(self, belief: Belief, measurement: Any, rng: Any) -> Belief:
        return self._given("_update", belief)


@given(
    st.sampled_from(["_init", "_predict", "_update"]),
    st.one_of(
        JUNK.filter(lambda junk: not callable(junk)),
        st.tuples(st.sampled_from(["mean", "cov"]), _arrays(2), _arrays(2, 2)).map(
            lambda t: lambda belief: belief.replace(**{t[0]: t[1] if t[0] == "mean" else t[2]})
        ),
    ),
)
def test_whatever_a_filter_of_ones_own_returns_its_user_is_told_or_gets_a_belief(method: str, returned: Any):
    filter = _Own(LinearModel(np.eye(2), np.eye(2), np.eye(2), np.eye(2)), returned, method)
    try:
        belief = filter.update(filter.predict(filter.init(Gaussian(np.zeros(2), np.eye(2)))), np.ones(2))
    except (ValueError, TypeError) as error:
        _sentence(error)
        return
    assert np.isfinite(belief.mean).all()
    assert np.isfinite(belief.cov).all()
    assert (np.linalg.eigvalsh(belief.cov) >= -1e-10 * np.trace(belief.cov)).all()


@pytest.mark.parametrize("function", ["transition", "measurement"])
def test_a_function_of_a_model_that_does_not_repeat_itself_is_refused_at_its_first_step(function: str):
    """A filter calls it more than once in its first step, and a recovery or a copy would call it again."""
    rng = np.random.default_rng(0)
    functions: dict[str, Any] = {"transition": lambda x, u: 0.9 * x, "measurement": lambda x, u: x[..., :1]}
    sound = functions[function]

    def dice(x: Any, u: Any) -> Any:
        return sound(x, u) + rng.standard_normal()

    model = NonlinearModel(**(functions | {function: dice}), Q=np.eye(2), R=np.eye(1))
    filter = make("ekf", model)
    belief = filter.init(Gaussian(np.zeros((3, 2)), np.eye(2)))

    def fly() -> None:
        filter.update(filter.predict(belief), np.zeros((3, 1)))

    with pytest.raises(ValueError, match=r"^the model's functions gave two values for the same arguments: they must"):
        fly()
