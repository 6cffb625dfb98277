"""Options that are no numbers, and functions that do not repeat themselves."""

from typing import Any

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, NonlinearModel, make


@pytest.mark.parametrize("value", [10**400, np.array([1.0, 2.0])], ids=["too large", "an array"])
@pytest.mark.parametrize(
    ("name", "option"),
    [("ukf", "alpha"), ("ukf", "beta"), ("ukf", "kappa"), ("enkf", "members"), ("enkf", "inflation"),
     ("etkf", "draws"), ("huber-kf", "gamma"), ("huber-kf", "iterations"), ("huber-kf", "tolerance"),
     ("robust-kf", "radius"),
     ("iekf", "iterations"), ("iekf", "tolerance"),
     ("pf", "particles"), ("pf", "threshold"), ("pf", "jitter")],
)  # fmt: skip
def test_an_option_that_is_too_large_or_no_number_is_refused_by_its_name(
    name: str, option: str, value: Any
):
    model = LinearModel(np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    with pytest.raises(ValueError, match=f"^{option} must be "):
        make(name, model, **{option: value})


@pytest.mark.parametrize("function", ["transition", "measurement"])
def test_a_function_of_a_model_that_does_not_repeat_itself_is_refused_at_its_first_step(
    function: str,
):
    """A filter calls it more than once in its first step, and a recovery or a copy would call it again."""
    rng = np.random.default_rng(0)
    functions: dict[str, Any] = {
        "transition": lambda x, u: 0.9 * x,
        "measurement": lambda x, u: x[..., :1],
    }
    sound = functions[function]

    def dice(x: Any, u: Any) -> Any:
        return sound(x, u) + rng.standard_normal()

    model = NonlinearModel(**(functions | {function: dice}), Q=np.eye(2), R=np.eye(1))
    filter = make("ekf", model)
    belief = filter.init(Gaussian(np.zeros((3, 2)), np.eye(2)))

    def fly() -> None:
        filter.update(filter.predict(belief), np.zeros((3, 1)))

    with pytest.raises(
        ValueError,
        match=r"^the model's functions gave two values for the same arguments: they must",
    ):
        fly()
