"""A vehicle, task, disturbance, sensor or filter of ours does the same in a user's file: no module's name decides."""

import functools
import inspect
import linecache
import re
import sys
import types
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

import estimators
from estimators import factory
from estimators.engine import Compiled
from vessel_gym.checks import is_compiled
from vessel_gym.disturbances import Fault
from vessel_gym.envs import (
    ItsunusaAUVEnv,
    PunaUAVEnv,
    SegorogeniAUVEnv,
    SigmaCorvetteEnv,
    ThesisCorvetteEnv,
)
from vessel_gym.sensors import Sensor
from vessel_gym.simulation.core import Core
from vessel_gym.system import System
from vessel_gym.tasks import circle_track, track
from vessel_gym.vehicles import corvette, ship

ENVS = SigmaCorvetteEnv, ThesisCorvetteEnv, SegorogeniAUVEnv, ItsunusaAUVEnv, PunaUAVEnv
ITSUNUSA = ItsunusaAUVEnv.system
FAULT = Fault(
    "stern plane", bias=0.1, loss=0.2, amplitude=0.1, beside=ITSUNUSA.disturbances["rough"]
)
SYSTEMS: dict[str, System] = {env.system.name: env.system for env in ENVS} | {
    "a fault": replace(ITSUNUSA, disturbances={"moderate": FAULT}, estimator="ekf-ui-wdf")
}


def copied(made: Any) -> Any:
    """A class or function with the text of one of ours, in a user's file that imports the rest."""
    if isinstance(made, functools.partial):
        other = functools.partial(copied(made.func), *made.args, **made.keywords)
        vars(other).update(vars(made))
        return other
    own = dict(vars(sys.modules[made.__module__])) | {"__name__": "a_file_of_ones_own"}
    exec(compile(inspect.getsource(made), "a_file_of_ones_own", "exec"), own)
    return own[made.__name__]


def copied_part(part: Any) -> Any:
    """A frozen part of ours, of a class that is copied."""
    each = fields(part) if hasattr(part, "__dataclass_fields__") else ()
    return copied(type(part))(**{own.name: getattr(part, own.name) for own in each if own.init})


def copied_sensor(sensor: Sensor) -> Sensor:
    return replace(
        sensor, reads=copied(sensor.reads), inverse=sensor.inverse and copied(sensor.inverse)
    )


def flights(
    system: System,
    rows: int = 3,
    estimator: Any = None,
    steps: int = 12,
    seed: int = 3,
    **options: Any,
) -> Any:
    """A core after some steps, and all that it gave."""
    core = Core(system, rows, estimator, options)
    core.start(seed)
    seen, actions = (
        [core.observe()],
        np.random.default_rng(0).uniform(-1.0, 1.0, (steps, core.action_shape[1])),
    )
    for action in actions:
        reward = core.step(np.tile(action, (rows, 1))).reward
        seen.append(core.observe())
    return core, core.info() | {"reward": reward, "seen": np.stack(seen, 1)}


COPIES: dict[str, Any] = {
    "vehicle": lambda system: {"vehicle": copied_part(system.vehicle)},
    "task": lambda system: {"task": copied_part(system.task)},
    "sensors": lambda system: {"sensors": tuple(map(copied_sensor, system.vehicle.sensors))},
    "disturbance": lambda system: {
        "disturbances": {"moderate": copied_part(system.disturbances["moderate"])}
    },
    "tuning": lambda system: {"tuning": copied(system.tuning)},
}


@pytest.mark.parametrize("part", COPIES)
@pytest.mark.parametrize("name", SYSTEMS)
def test_a_compiled_copy_gives_the_bits_of_ours(name: str, part: str) -> None:
    """One program a step, a filter's model compiled, and all of it shared by environments."""
    system = SYSTEMS[name]
    own = replace(system, **COPIES[part](system))
    (_, ours), (core, theirs) = flights(system), flights(own)
    for key, values in ours.items():
        np.testing.assert_array_equal(theirs[key], values, key)
    assert core.config.world.step.compiled
    assert core.config.mission.step.compiled
    for function in ("transition", "measurement"):
        assert isinstance(
            getattr(core.config.estimation.filter.model, function, None),
            Compiled | types.MethodType,
        )
    again = Core(own, 1)
    assert again.config.world is core.config.world
    assert again.config.estimation is core.config.estimation


def test_a_subclass_is_not_compiled_unless_decorated() -> None:
    class Rougher(type(FAULT.beside)):  # type: ignore[misc]
        pass

    beside = copied_part(FAULT.beside)
    worlds = [
        Core(
            replace(ITSUNUSA, disturbances={"moderate": replace(FAULT, beside=each)}),
            estimator="truth",
        ).config.world
        for each in (
            beside,
            Rougher(**{each.name: getattr(beside, each.name) for each in fields(beside)}),
        )
    ]
    assert [world.step.compiled for world in worlds] == [True, False]


def test_a_proxy_of_a_compiled_part_is_not_compiled() -> None:
    class Passing:
        def __init__(self, part: Any) -> None:
            self.part = part

        def __getattr__(self, name: str) -> Any:
            return getattr(self.part, name)

    for part in (ITSUNUSA.vehicle, ITSUNUSA.task, ITSUNUSA.vehicle.sensors[0].reads):
        assert is_compiled(part)
        assert not is_compiled(Passing(part))


def test_a_class_of_the_same_name_is_another_one() -> None:
    """As in a notebook whose cell is executed again."""
    one, two = (copied_part(SigmaCorvetteEnv.system.vehicle) for _ in range(2))
    systems = [replace(SigmaCorvetteEnv.system, vehicle=each) for each in (one, two)]
    worlds = [Core(systems[i]).config.world for i in (0, 1, 0)]
    assert worlds[0] is worlds[2]
    assert worlds[0] is not worlds[1]


FILTERED = dict.fromkeys(("kf", "kf-umv-ui", "ulise"), "ThesisCorvette-v0")


@pytest.mark.parametrize("name", factory.names())
def test_a_filter_runs_as_ours_in_a_file_of_ones_own(name: str) -> None:
    """Of the classes that are handed over, neither of which is tuned for the environment."""
    kind = getattr(estimators, factory._FILTERS[name])
    linear = {"model": "steady dives"} if name == "kf-umv-ui-wdf" else {}
    env = "a fault" if name.endswith(("wdf", "ukf-umv")) else FILTERED.get(name, "SigmaCorvette-v0")
    (core, ours), (other, theirs) = (
        flights(SYSTEMS[env], estimator=each, steps=4, **linear) for each in (kind, copied(kind))
    )
    for key, values in ours.items():
        np.testing.assert_array_equal(theirs[key], values, key)
    own, copy = (each.config.estimation.filter for each in (core, other))
    assert own._programs.keys() <= copy._programs.keys()
    assert type(copy) is not type(own)
    assert copy.compiled == own.compiled


# --- copies that are not decorated run in NumPy ----------------------------------------------------


def copied_module(module: Any, *others: tuple[str, str]) -> Any:
    """A user's module with the text of one of ours, whose classes are not decorated."""
    text, made = (
        inspect.getsource(module),
        types.ModuleType(f"own_{module.__name__.rpartition('.')[2]}"),
    )
    for name, own in others:
        text = text.replace(f"from {name} import", f"from {own} import")
    text = re.sub(r"^@compiled\n(?=@dataclass|class )", "", text, flags=re.M)
    sys.modules[made.__name__] = made
    linecache.cache[made.__name__] = len(text), None, text.splitlines(True), made.__name__
    exec(compile(text, made.__name__, "exec"), vars(made))
    return made


@pytest.fixture(scope="module")
def in_numpy() -> dict[str, System]:
    """Systems of ours, of which vehicle or task are of classes with the same text in a user's file."""
    copied_module(corvette)
    ships = copied_module(ship, ("vessel_gym.vehicles.corvette", "own_corvette"))
    copied_module(track)
    tracks = copied_module(circle_track, ("vessel_gym.tasks.track", "own_track"))
    system = SigmaCorvetteEnv.system
    vehicle, task = ships.Ship(system.vehicle.ship), tracks.CircleTrack(system.vehicle.ship)
    return {
        "ours": system,
        "vehicle": replace(system, vehicle=vehicle),
        "task": replace(system, task=task),
    }


@pytest.mark.parametrize("part", ["vehicle", "task"])
def test_a_copy_in_numpy_gives_what_ours_gives(in_numpy: dict[str, System], part: str) -> None:
    (_, ours), (core, many) = (flights(in_numpy[name], 9, "ukf", 40) for name in ("ours", part))
    stage = {"vehicle": core.config.world.step, "task": core.config.mission.step}[part]
    assert not stage.compiled
    for name in ("truth", "measurement", "estimate", "reference", "reward"):
        np.testing.assert_allclose(many[name], ours[name], rtol=1e-12, atol=1e-12, err_msg=name)
    for row in (0, 4, 8):
        for name, values in flights(in_numpy[part], 1, "ukf", 40, 3 + row)[1].items():
            np.testing.assert_array_equal(values[0], many[name][row], name)
