"""When a function that is not ours may run traced, and when what it reads has changed since."""

import enum
import functools
import re
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.interpolate

from estimators.engine import along, compiled, repeat
from estimators.engine.creation import traced_creation
from estimators.engine.foreign import inspect
from estimators.engine.interpret import interpret
from tests.estimators.engine.random_functions import RandomFunction

GAIN = 2.0
TABLE = np.array([1.0, 2.0])
SETTINGS: dict[str, Any] = {"gain": 1.5, "arrays": [np.ones(2), np.ones(2)]}
X = np.random.default_rng(0).normal(size=(5, 2))


def helper(x: np.ndarray) -> np.ndarray:
    return GAIN * x


@dataclass
class Vehicle:
    mass: float = 2.0
    drag: np.ndarray = field(default_factory=lambda: np.array([0.1, 0.2]))
    unread: float = 0.0
    parts: tuple[np.ndarray, ...] = (np.ones(2),)
    factor = 3.0

    @property
    def inverse(self) -> float:
        return 1.0 / self.mass

    def force(self, x: np.ndarray) -> np.ndarray:
        return -self.drag * x * np.abs(x)

    def rate(self, x: np.ndarray) -> np.ndarray:
        return self.force(x) * self.inverse + self.parts[0] * self.factor * GAIN


class Slotted:
    __slots__ = ("gain", "other")

    def __init__(self) -> None:
        self.gain = 1.0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        return self.gain * x


class RandomKeys(NamedTuple):
    a: float
    b: np.ndarray


class Mode(enum.Enum):
    FAST = 2.0


class Hull:
    def drag(self, x: np.ndarray) -> np.ndarray:
        return 0.5 * x


class Catamaran(Hull):
    """Reads a file where it is built, and not where it moves."""

    def __init__(self) -> None:
        self.path = sys.path

    def drag(self, x: np.ndarray) -> np.ndarray:
        return 2.0 * super().drag(x)


def closure() -> tuple[Callable[..., Any], Callable[[float], None], np.ndarray]:
    gain, array = 2.0, np.ones(2)

    def change(value: float) -> None:
        nonlocal gain
        gain = value

    return lambda x: gain * array * x, change, array


@pytest.fixture
def globals_() -> Iterator[dict[str, Any]]:
    """This module's, as they were afterwards."""
    kept = dict(globals())
    yield globals()
    globals().update(kept)


def traced(function: Callable[..., Any]) -> Any:
    inspection = inspect(function, X)
    assert inspection.traceable, inspection.reason
    assert inspection.unchanged()
    np.testing.assert_allclose(inspection(X), function(X), rtol=1e-14)
    return inspection


def test_a_global_that_changes_is_noticed_through_other_functions(globals_: dict[str, Any]):
    inspection = traced(lambda x: helper(x) + TABLE)
    globals_["GAIN"] = 3.0
    assert not inspection.unchanged()
    globals_["GAIN"] = 1.0 + 1.0  # another object of the same value
    assert inspection.unchanged()
    TABLE[0] = 7.0
    assert not inspection.unchanged()
    TABLE[0] = 1.0
    assert inspection.unchanged()
    globals_["helper"] = lambda x: x
    assert not inspection.unchanged()


def test_a_variable_that_is_new_is_noticed(globals_: dict[str, Any]):
    def optional(x: np.ndarray) -> np.ndarray:
        try:
            return LATER * x  # type: ignore[name-defined, no-any-return]
        except NameError:
            return x

    inspection = traced(optional)
    globals_["LATER"] = 4.0
    try:
        assert not inspection.unchanged()
    finally:
        del globals_["LATER"]


def test_a_closure_that_changes_is_noticed():
    function, change, array = closure()
    inspection = traced(function)
    change(3.0)
    assert not inspection.unchanged()
    change(2.0)
    assert inspection.unchanged()
    array[1] = 0.0
    assert not inspection.unchanged()


def test_attributes_are_read_as_far_as_they_are_named():
    vehicle = Vehicle()
    inspection = traced(vehicle.rate)
    vehicle.unread = 5.0
    vehicle.something = np.random.default_rng()  # type: ignore[attr-defined]
    assert inspection.unchanged()
    for change in (
        lambda: setattr(vehicle, "mass", 4.0),
        lambda: vehicle.drag.__setitem__(0, 9.0),
        lambda: setattr(vehicle, "drag", np.zeros(2)),
        lambda: vehicle.parts[0].__setitem__(1, 5.0),
        lambda: setattr(vehicle, "factor", 8.0),
        lambda: setattr(vehicle, "force", lambda x: x),
        lambda: setattr(vehicle, "__dict__", dict(vars(vehicle), mass=1.0)),
    ):
        inspection = traced(vehicle.rate)
        change()
        assert not inspection.unchanged()


def test_a_class_that_changes_is_noticed(monkeypatch: pytest.MonkeyPatch):
    vehicle = Vehicle()
    for name, value in (
        ("factor", 4.0),
        ("force", lambda self, x: x),
        ("inverse", property(lambda self: 2.0)),
    ):
        inspection = traced(vehicle.rate)
        monkeypatch.setattr(Vehicle, name, value)
        assert not inspection.unchanged()


class Place(enum.IntEnum):
    MASS, LENGTH = range(2)


@dataclass(frozen=True)
class Ship:
    values: np.ndarray

    def __post_init__(self) -> None:
        if not re.match("m", self.units()):
            raise ValueError("metres")

    def units(self) -> str:
        return "m"

    def weight(self, x: np.ndarray) -> np.ndarray:
        return x * self.values[Place.MASS]


def test_how_a_frozen_object_was_built_does_not_matter_and_names_of_indices_are_constants():
    ship = Ship(np.array([2.0, 3.0]))
    inspection = traced(ship.weight)
    assert inspection.unchanged()
    ship.values[Place.MASS] = 4.0
    assert not inspection.unchanged()


def test_slots_defaults_and_partial_arguments_are_read():
    slotted = Slotted()
    inspection = traced(slotted)
    slotted.gain = 2.0
    assert not inspection.unchanged()

    def scaled(x: np.ndarray, gain: float = 2.0, *, offset: float = 1.0) -> np.ndarray:
        return gain * x + offset

    inspection = traced(scaled)
    scaled.__defaults__ = (3.0,)
    assert not inspection.unchanged()
    inspection = traced(scaled)
    scaled.__kwdefaults__["offset"] = 5.0
    assert not inspection.unchanged()
    part = functools.partial(scaled, gain=np.ones(2))
    inspection = traced(part)
    part.keywords["gain"][0] = 3.0
    assert not inspection.unchanged()
    inspection = traced(scaled)
    scaled.__code__ = (lambda x, gain, *, offset: x).__code__
    assert not inspection.unchanged()


def test_containers_are_read(monkeypatch: pytest.MonkeyPatch):
    numbers = RandomKeys(1.0, np.ones(2))

    def function(x: np.ndarray) -> np.ndarray:
        total = SETTINGS["gain"] * x + numbers.a * numbers.b + Mode.FAST.value
        for each in SETTINGS["arrays"]:
            total = total + each
        return total  # type: ignore[no-any-return]

    for change in (
        lambda: SETTINGS["arrays"].append(np.ones(2)),
        lambda: SETTINGS["arrays"].pop(),
        lambda: SETTINGS["arrays"][0].__setitem__(0, 2.0),
        lambda: SETTINGS.update(gain=9.0),
        lambda: numbers.b.__setitem__(0, 4.0),
    ):
        inspection = traced(function)
        change()
        assert not inspection.unchanged()


def test_names_that_are_made_up_while_it_runs_count():
    settings = types.SimpleNamespace(gain_0=1.0, gain_1=2.0)

    def function(x: np.ndarray) -> np.ndarray:
        return sum(getattr(settings, f"gain_{i}") * x for i in range(2))  # type: ignore[return-value]

    inspection = traced(function)
    settings.gain_1 = 3.0
    assert not inspection.unchanged()


def test_attributes_of_a_function_are_read():
    def function(x: np.ndarray) -> np.ndarray:
        return function.gain * x  # type: ignore[attr-defined, no-any-return]

    function.gain = 2.0  # type: ignore[attr-defined]
    inspection = traced(function)
    function.gain = 3.0  # type: ignore[attr-defined]
    assert not inspection.unchanged()


def test_a_small_array_that_is_read_only_may_change_by_a_view():
    array = np.ones(2)
    view = array[:]
    array.flags.writeable = False
    inspection = traced(lambda x: x * array)
    view[0] = 5.0
    assert not inspection.unchanged()


@pytest.mark.parametrize("layout", [np.asarray, np.transpose, np.flip, lambda array: array[:, ::2]])
def test_an_entry_of_an_array_of_any_layout_is_compared(layout: Callable[..., Any]):
    array = np.arange(6.0).reshape(2, 3)
    view = layout(array)
    inspection = traced(lambda x: x * view[0, 1])
    array[1, 1] = 9.0
    assert inspection.unchanged() == (9.0 not in view)
    view[-1, -1] = 7.0
    assert not inspection.unchanged()


@pytest.mark.parametrize(("name", "value"), [("shape", (4, 1)), ("dtype", np.dtype(int))])
def test_an_array_that_is_looked_at_otherwise_is_noticed(name: str, value: Any):
    array = np.ones((2, 2))
    inspection = traced(lambda x: x * array[0])
    setattr(array, name, value)
    assert not inspection.unchanged()


def test_a_module_of_the_users_is_read(monkeypatch: pytest.MonkeyPatch):
    module: Any = types.ModuleType("users_own_settings")
    module.GAIN, module.unread = 3.0, open  # what is not named does not matter
    monkeypatch.setitem(sys.modules, "users_own_settings", module)
    inspection = traced(lambda x: module.GAIN * x)
    module.unread = 5
    assert inspection.unchanged()
    module.GAIN = 4.0
    assert not inspection.unchanged()


def test_what_is_computed_once_and_kept_may_be():
    class Lazy:
        mass = 2.0

        @functools.cached_property
        def inverse(self) -> float:
            return 1.0 / self.mass

        def rate(self, x: np.ndarray) -> np.ndarray:
            return x * self.inverse

    lazy = Lazy()
    inspection = traced(lazy.rate)
    lazy.__dict__["inverse"] = 9.0
    assert not inspection.unchanged()


def test_large_arrays_are_read_only_or_refused():
    large = np.ones((1 << 16, 2))
    inspection = inspect(lambda x: x + large[0], X)
    assert not inspection.traceable
    assert "too large" in inspection.reason
    large.flags.writeable = False
    traced(lambda x: x + large[0])


def counter() -> Callable[..., Any]:
    calls = [0]

    def count(x: np.ndarray) -> np.ndarray:
        calls[0] += 1
        return x * calls[0]

    return count


class Remembering:
    last: Any = None

    def __call__(self, x: np.ndarray) -> np.ndarray:
        self.last = x
        return x


def generator() -> Callable[..., Any]:
    numbers = iter([1.0] * 100)
    return lambda x: x * next(numbers)


def drawn() -> Callable[..., Any]:
    rng = np.random.default_rng()
    return lambda x: x + rng.normal(size=x.shape)


@pytest.mark.parametrize(
    ("function", "phrase"),
    [
        (counter(), "changes something that it reads"),
        (Remembering(), r"changes the attribute \.last"),
        (generator(), "list_iterator, whose changes cannot be seen"),
        (drawn(), "Generator, whose changes cannot be seen"),
        (lambda x: sys.stdout.write("") * x, "uses the module sys"),
        ((lambda masked: lambda x: x * masked)(np.ma.array([1.0, 2.0])), "a kind of its own"),
        (
            (lambda numbers: lambda x: x * len(numbers))({1, 2}),
            "a builtins.set, whose changes cannot be seen",
        ),
        (functools.lru_cache(lambda x: x), "raises TypeError"),
        (
            scipy.interpolate.CubicSpline([0.0, 1.0, 2.0], [0.0, 1.0, 0.0]),
            "Python's numbers|cannot have",
        ),
        (5, "raises TypeError"),
    ],
)
def test_what_cannot_be_compared_is_refused(function: Any, phrase: str):
    inspection = inspect(function, X)
    assert not inspection.traceable
    assert __import__("re").search(phrase, inspection.reason), inspection.reason


def test_a_refused_function_leaves_no_tracers_behind():
    remembering = Remembering()
    inspect(remembering, X)
    assert remembering.last is None


def test_a_function_that_writes_into_its_arguments_is_refused_and_they_stay():
    """The program would leave them, and would write into what other equations read where it is inlined."""

    def careless(x: np.ndarray) -> np.ndarray:
        x[..., 0] = 0.0
        return x

    given = X.copy()
    reason = inspect(careless, given).reason
    assert reason.startswith(
        "it writes into an array that it is given: work on a copy, as of np.array(x) (line "
    )
    assert reason.endswith("x[..., 0] = 0.0)")
    np.testing.assert_array_equal(given, X)
    traced(lambda x: careless(np.array(x)))


def test_the_line_is_named():
    def function(x: np.ndarray) -> np.ndarray:
        y = 2.0 * x
        return float(y[0, 0]) * x

    reason = inspect(function, X).reason
    line = function.__code__.co_firstlineno + 2
    assert f"(line {line} of test_foreign.py: return float(y[0, 0]) * x)" in reason


@pytest.mark.parametrize(
    "function",
    [
        lambda x: x - x[0],
        lambda x: x - x[..., :1, :].mean(-2),
        lambda x: np.maximum.accumulate(x, 0),
        lambda x: x * (len(x) > 1),
        lambda x: x + np.arange(len(x))[:, None],
        lambda x: np.where(x.max() > 1e300, 0.0, x),
        lambda x: x if x.ndim == 2 else 2.0 * x,
        lambda x: x[::-1],
    ],
)
def test_rows_that_depend_on_others_are_found_out(function: Callable[..., Any]):
    for given in (X, X[0]):
        assert not inspect(function, given).traceable


@pytest.mark.parametrize("seed", range(8))
def test_random_functions_are_traceable(seed: int):
    rng = np.random.default_rng(20_000 + seed)
    function = RandomFunction(rng, False)
    inspection = inspect(function, rng.normal(size=(4, function.n) if seed % 2 else function.n))
    assert inspection.traceable, inspection.reason
    assert inspection.unchanged()


def test_loops_of_arrays_are_loops_of_each_row():
    def function(x: np.ndarray) -> np.ndarray:
        total, _ = repeat(5, lambda a, b: (a + 0.1 * np.sin(b), b * 0.5 + a), x, np.zeros_like(x))
        return total  # type: ignore[no-any-return]

    traced(function)
    assert not inspect(lambda x: repeat(3, lambda a: (a + a[::-1],), x)[0], X).traceable


def test_a_function_along_rows_is_that_of_each_row():
    assert inspect(lambda x: along(lambda a: [a * x[..., 0]], x)[0], X).traceable
    assert not inspect(lambda x: along(lambda a: [a * x[..., 0].sum()], x)[0], X).traceable


def test_an_argument_without_a_batch_is_shared():
    inspection = inspect(lambda x, dt: x + dt * x * x, X, 0.1)
    assert inspection.traceable, inspection.reason
    assert [row.shape for row in inspection.function.arguments] == [X.shape[-1:], ()]
    np.testing.assert_array_equal(inspection(X, 0.3), X + 0.3 * X * X)
    inspection = inspect(lambda P, x: P @ x, np.eye(2), X[0], axes=(2, 1))
    assert not inspection.traceable  # of a batch it is something else
    inspection = inspect(lambda P, x: (P @ x[..., None])[..., 0], np.eye(2), X[0], axes=(2, 1))
    assert inspection.traceable, inspection.reason


def test_functions_that_lose_digits_are_traced_nevertheless():
    def cancelling(x: np.ndarray) -> np.ndarray:
        return 1e8 * (np.exp(1e-9 * x) - 1.0) + (np.sin(x) - np.sin(x * (1.0 + 1e-12))) * 1e6

    assert inspect(cancelling, X).traceable


def test_a_compiled_function_may_be_part_of_it():
    @compiled
    def ours(x: np.ndarray) -> np.ndarray:
        return np.sin(x) * GAIN

    traced(lambda x: ours(x) + 1.0)


class Equipped:
    def __init__(self) -> None:
        self.gain = 2.0

    @compiled
    @np.errstate(all="ignore")  # a context variable of NumPy's, which cannot be compared
    def moved(self, x: np.ndarray) -> np.ndarray:
        return x


def test_compiled_methods_that_are_not_called_are_not_read():
    equipped = Equipped()
    equipped.moved(X)
    traced(lambda x: getattr(equipped, "gain") * x)  # noqa: B009 : all attributes count


def test_a_program_in_numpy_has_the_bits_of_its_compiled_self():
    def function(x: np.ndarray, n: np.ndarray) -> np.ndarray:
        angle = (x[..., 0] + np.pi) % (2.0 * np.pi) - np.pi
        power = np.where(n > 2, np.exp(x[..., 1]), np.arctan2(x[..., 1], x[..., 0]))
        return np.stack(
            [angle, power, 1.0 * (n % 3), np.interp(x[..., 0], [-1.0, 0.0, 2.0], [3.0, 1.0, 5.0])],
            -1,
        )

    x, n = np.random.default_rng(1).normal(size=(99, 2)) * 5.0, np.arange(99)
    inspection = inspect(function, x, n, axes=(1, 0))
    assert inspection.traceable, inspection.reason
    (found,) = interpret(inspection.function, [x, n], 0.0, np.random.default_rng())
    np.testing.assert_array_equal(found.view(np.int64), inspection(x, n).view(np.int64))


def test_a_class_that_super_names_builds_nothing():
    hull = Catamaran()
    inspection = traced(hull.drag)
    np.testing.assert_array_equal(inspection(X), X)
    Hull.drag, before = (lambda self, x: x), Hull.drag  # type: ignore[assignment, method-assign]
    try:
        assert not inspection.unchanged()
    finally:
        Hull.drag = before  # type: ignore[method-assign]


def test_what_a_cached_function_reads_is_compared():
    drag = functools.cache(lambda power: DRAGS[power])
    inspection = traced(lambda x: x * drag(1))
    DRAGS[1] = 3.0
    assert not inspection.unchanged()


DRAGS = {1: 2.0}


def test_compiled_extensions_make_plain_arrays_while_a_function_is_traced() -> None:
    """A generator writes into a fresh array as into plain memory: of objects, it would be pointers."""

    def fresh() -> np.ndarray:
        return np.empty(3)

    with traced_creation():
        assert np.random.default_rng(0).normal(size=3).dtype == float
        assert fresh().dtype == object
