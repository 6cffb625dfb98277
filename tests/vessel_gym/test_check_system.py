"""Each thing that `check_system` finds, in each method of a toy system's parts."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import ENVIRONMENTS, single_class
from toy_system import POD, SYSTEM, Breeze, Cart, Post

from estimators import compiled
from vessel_gym import check_system
from vessel_gym.envs import register_environment
from vessel_gym.processes import Process
from vessel_gym.simulation.core import Core
from vessel_gym.system import System, Task

PARTS: dict[str, tuple[type, tuple[str, ...]]] = {
    "vehicle": (Cart, ("start", "actuate", "known_input", "parameters", "step", "drift")),
    "disturbance": (Breeze, ("effect", "met", "draw", "effect_at")),
    "task": (Post, ("scenario", "reference", "commanded", "exogenous", "initial_score_state", "over",
                    "score", "observe", "observe_state", "observe_mission")),
    "sensor": (type(POD), ("reads", "sd")),
}  # fmt: skip
METHODS = [(part, name) for part, (_, names) in PARTS.items() for name in names]


def with_part(part: str, made: Any) -> System:
    """The toy system with another part."""
    if part == "disturbance":
        return replace(SYSTEM, disturbances={"moderate": made})
    return replace(SYSTEM, **{part: made})


def broken(part: str, name: str, wrap: Callable[..., Any]) -> System:
    """The toy system with one method wrapped: a function of the method and its arguments."""
    if part == "sensor":
        method = getattr(POD, name)
        pod = replace(POD, **{name: lambda *arguments: wrap(method, *arguments)})
        return replace(SYSTEM, sensors=(*Cart.sensors, pod))
    base = PARTS[part][0]
    method = getattr(base, name)

    def wrapped(self: Any, *arguments: Any) -> Any:
        return wrap(lambda *given: method(self, *given), *arguments)

    members = {"effect_at": Breeze.effect_at} if part == "disturbance" else {}
    return with_part(part, type("Broken", (base,), members | {name: wrapped})())


def each(change: Callable[[Any], Any]) -> Callable[..., Any]:
    """A wrapper that changes all arrays of a result."""

    def wrap(method: Any, *arguments: Any) -> Any:
        given = method(*arguments)
        return tuple(map(change, given)) if isinstance(given, tuple) else change(given)

    return wrap


def writing(method: Any, *arguments: Any) -> Any:
    """A method that writes into its first argument."""
    arguments[0][...] = 0.0
    return method(*arguments)


def branching(method: Any, *arguments: Any) -> Any:
    """A method that decides for one vehicle."""
    return method(*arguments) * (1.0 if arguments[0][:, 0] > 0.0 else 2.0)


def refilling() -> Callable[..., Any]:
    """A wrapper that puts all results into one array, which it gives again and again."""
    kept: dict[Any, np.ndarray] = {}

    def refill(x: np.ndarray) -> np.ndarray:
        buffer = kept.setdefault(x.shape, np.empty(x.shape))
        buffer[...] = x
        return buffer

    return each(refill)


def of_one_axis(method: Any, *arguments: Any) -> Any:
    """A method that counts the axes from the front."""
    return method(*arguments) if arguments[0].ndim == 2 else arguments[0][:, :1]


RNG = np.random.default_rng(0)
FAULTS: dict[str, tuple[Callable[..., Any], str]] = {
    "not finite": (each(lambda x: x * np.nan), r" gave .*nan.* it must give finite numbers$"),
    "no array": (each(lambda x: x.tolist()), " must give arrays of real numbers, got "),
    "complex": (each(lambda x: x * 1j), " must give arrays of real numbers, got "),
    "one row": (each(lambda x: x[:1]), " must give .* for each vehicle: for 3 it gave "),
    "random": (each(lambda x: x + RNG.random()), " gave two values for the same arguments: "),
    "mixed": (each(lambda x: x + len(x)), " gives a vehicle alone other numbers than in a batch: "),
}  # fmt: skip


@pytest.mark.parametrize("name", [*ENVIRONMENTS, "USV-v0", "Route-v0"])  # each, by day too
def test_systems_of_the_package_and_its_pages_pass(name: str) -> None:
    check_system(single_class(name).system)


def test_the_toy_system_passes_and_runs() -> None:
    check_system(SYSTEM)
    core = Core(SYSTEM, 3)
    core.start(0)
    for _ in range(5):
        core.step(np.zeros((3, 1)))
    assert np.isfinite(core.observe()).all()


@pytest.mark.parametrize(("part", "name"), METHODS)
def test_a_fault_of_any_method_names_it(part: str, name: str) -> None:
    wrap, sentence = FAULTS["not finite"]
    who = "pod" if part == "sensor" else "Broken"
    with pytest.raises(ValueError, match=f"^{name} of {who}{sentence}"):
        check_system(broken(part, name, wrap))


@pytest.mark.parametrize(("wrap", "sentence"), FAULTS.values(), ids=FAULTS)
@pytest.mark.parametrize(("part", "name"), [("vehicle", "drift"), ("task", "score")])
def test_each_fault_is_answered_in_one_sentence(
    part: str, name: str, wrap: Callable[..., Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match=f"^{name} of Broken{sentence}") as caught:
        check_system(broken(part, name, wrap))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_a_result_that_is_written_again_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^actuate of Broken writes into an array that it has"):
        check_system(broken("vehicle", "actuate", refilling()))


@pytest.mark.parametrize(
    ("part", "name"), [("vehicle", "drift"), ("disturbance", "effect"), ("sensor", "reads")]
)
def test_what_filters_call_takes_any_leading_axes(part: str, name: str) -> None:
    with pytest.raises(ValueError, match=f"^{name} of .* must take any leading axes"):
        check_system(broken(part, name, of_one_axis))


@pytest.mark.parametrize("wrap", [FAULTS["random"][0], FAULTS["mixed"][0]])
def test_a_prior_must_repeat_itself_row_by_row(wrap: Callable[..., Any]) -> None:
    def prior(self: Any, scenario: Any) -> Any:
        given = Post.prior(self, scenario)
        return replace(given, mean=wrap(lambda mean: mean, given.mean))

    with pytest.raises(ValueError, match=r"^the mean of prior of Broken g[ai]ve"):
        check_system(with_part("task", type("Broken", (Post,), {"prior": prior})()))


@pytest.mark.parametrize("name", ["reference", "observe", "observe_state"])
def test_mixed_estimates_are_found_without_a_scenario(name: str) -> None:
    def mixed(self: Any, *given: Any) -> Any:
        state = given[-1] if name == "reference" else given[0].state
        return state - state.mean(0)

    def score(self: Any, state: Any, *others: Any) -> Any:
        return state[..., 0], 0.0 * state[..., 0], others[-1]

    members = {"vehicle": Cart(), "prior_sd": (0.1, 0.1), "score": score, name: mixed}
    with pytest.raises(ValueError, match=f"^{name} of Broken gives a vehicle alone other numbers"):
        check_system(with_part("task", type("Broken", (Task,), members)()))


@pytest.mark.parametrize(
    ("wrap", "advice"),
    [(writing, "read-only"), (branching, "with np.where for if")],
)
def test_an_error_within_a_method_comes_with_advice(wrap: Any, advice: str) -> None:
    with pytest.raises(ValueError, match=f"^step of Broken fails for 3 vehicles .*{advice}"):
        check_system(broken("vehicle", "step", wrap))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [(lambda x: x + (type(x) is np.ndarray), "gives other numbers compiled than in NumPy"),
     (lambda x: x + 0.0 * np.array(x, float), "fails .* leave out @compiled")],
)  # fmt: skip
@pytest.mark.parametrize("whole", [True, False])
def test_compiled_and_numpy_must_agree(change: Any, sentence: str, whole: bool) -> None:
    def drift(self: Any, x: Any, u: Any, flow: Any) -> Any:
        return change(Cart.drift(self, x, u, flow))

    cart = type("Broken", (Cart,), {"drift": drift if whole else compiled(drift)})
    with pytest.raises(ValueError, match=f"^drift of Broken.* {sentence}"):
        check_system(with_part("vehicle", compiled(cart)() if whole else cart()))


@pytest.mark.parametrize(
    ("attribute", "value"),
    [("forces", ("gust",)), ("averaged", ("gust",)), ("white_increments", ("breeze",)),
     ("inputs", ("u increment",)), ("inputs", ("breeze", "breeze")), ("names", ("x",)),
     ("names", ("a", "b")), ("scale", (1.0, 1.0)), ("white", np.eye(1)),
     ("process", Process(1.1 * np.eye(1), np.eye(1), np.eye(1)))],
)  # fmt: skip
def test_a_disturbance_that_contradicts_itself_is_refused(attribute: str, value: Any) -> None:
    made = type("Broken", (Breeze,), {attribute: value})()
    with pytest.raises(ValueError, match=f"^{attribute} of Broken "):
        check_system(with_part("disturbance", made))


@pytest.mark.parametrize(
    ("attribute", "value", "sentence"),
    [("angles", ("phi",), "angles of Broken have the unknown state 'phi': choose from x, u"),
     ("angles", "x", "angles of Broken must be a tuple of names, got 'x'"),
     ("rates", {"u": "z"}, "rates of Broken have the unknown state 'z': choose from x, u"),
     ("rates", "ux", "rates of Broken must be a dictionary of values by name, or None, got 'ux'")],
)  # fmt: skip
def test_angles_and_rates_name_states(attribute: str, value: Any, sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{sentence}$"):
        check_system(with_part("vehicle", type("Broken", (Cart,), {attribute: value})()))


def test_a_prior_has_a_covariance_of_its_mean() -> None:
    made = type("Broken", (Post,), {"prior_sd": (0.1,)})()
    with pytest.raises(ValueError, match=r"^prior of Broken must have a covariance of 2 rows, got"):
        check_system(with_part("task", made))


@pytest.mark.parametrize("given", [3, "SigmaCorvette-v0"])
def test_what_is_no_system_is_refused(given: Any) -> None:
    with pytest.raises(TypeError, match=r"^system must be of class System, got "):
        check_system(given)


def test_a_prior_that_is_no_gaussian_is_refused() -> None:
    task = type("Broken", (Post,), {"prior": lambda self, scenario: None})()
    with pytest.raises(TypeError, match=r"^prior of Broken must give "):
        check_system(with_part("task", task))


def test_a_negative_deviation_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^sd of pod must give numbers of at least 0$"):
        check_system(broken("sensor", "sd", each(np.negative)))


def test_an_end_without_a_reason_is_refused() -> None:
    ends = broken(
        "task", "score", lambda method, *given: (lambda r, e, s: (r, e + 7, s))(*method(*given))
    )
    with pytest.raises(ValueError, match=r"^score of Broken must give numbers of end_reasons"):
        check_system(ends)


def test_registration_checks_the_system() -> None:
    with pytest.raises(ValueError, match=r"^step of Broken gave"):
        register_environment(broken("vehicle", "step", FAULTS["not finite"][0]))
    assert SYSTEM.name not in gym.registry


# --- at run time ----------------------------------------------------------------------------------


def flown(system: System, **options: Any) -> Core:
    """Three environments after six steps."""
    core = Core(system, 3, **options)
    core.start(0)
    for _ in range(6):
        core.step(np.full((3, 1), 0.5))
        core.observe()
    return core


def from_step_two(method: Any, *arguments: Any) -> Any:
    """A method that breaks in the second row once the cart has moved."""
    given = method(*arguments)
    first = given[0] if isinstance(given, tuple) else given
    first = np.where(
        (np.arange(len(first)) == 1) & (np.abs(arguments[0][..., 0]) > 0.3), np.nan, first.T
    ).T
    return (first, *given[1:]) if isinstance(given, tuple) else first


@pytest.mark.parametrize(("part", "name"), [("vehicle", "step"), ("task", "score")])
def test_what_is_not_finite_is_refused_at_its_step(part: str, name: str) -> None:
    sentence = rf"^{name} of Broken gave .*nan.* at step \d in row 1: it must give finite numbers$"
    with pytest.raises(ValueError, match=sentence):
        flown(broken(part, name, from_step_two), estimator="truth")


def test_a_diverged_vehicle_is_no_error_of_its_methods() -> None:
    fleeing = broken(
        "vehicle", "step", lambda method, *given: 1e100 * (1.0 + np.abs(method(*given)))
    )
    with np.errstate(all="ignore"):
        core = flown(fleeing, estimator="dead-reckoning")
    assert not np.isfinite(core.now.state).all()
    assert np.isfinite(core.now.belief.mean).all()
