"""The decorator alone decides whether a part is compiled, and in NumPy it gives what it gives compiled."""

import inspect
import linecache
import re
import sys
import types
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from vessel_gym.checks import is_compiled
from vessel_gym.disturbances import Fault
from vessel_gym.envs import ItsunusaAUVEnv, SigmaCorvetteEnv
from vessel_gym.simulation.core import Core
from vessel_gym.system import System
from vessel_gym.tasks import circle_track, track
from vessel_gym.vehicles import corvette, ship

ITSUNUSA = ItsunusaAUVEnv.system
FAULT = Fault(
    "stern plane", bias=0.1, loss=0.2, amplitude=0.1, beside=ITSUNUSA.disturbances["rough"]
)


def flights(system: System, rows: int, seed: int = 3, steps: int = 40) -> Any:
    """A core on `ukf` after some steps, and all that it gave."""
    core = Core(system, rows, "ukf")
    core.start(seed)
    seen, actions = (
        [core.observe()],
        np.random.default_rng(0).uniform(-1.0, 1.0, (steps, core.action_shape[1])),
    )
    for action in actions:
        reward = core.step(np.tile(action, (rows, 1))).reward
        seen.append(core.observe())
    return core, core.info() | {"reward": reward, "seen": np.stack(seen, 1)}


def test_a_subclass_is_not_compiled_unless_decorated() -> None:
    class Rougher(type(FAULT.beside)):  # type: ignore[misc]
        pass

    beside = FAULT.beside
    rougher = Rougher(**{each.name: getattr(beside, each.name) for each in fields(beside)})
    assert is_compiled(FAULT)
    assert not is_compiled(replace(FAULT, beside=rougher))


def test_a_proxy_of_a_compiled_part_is_not_compiled() -> None:
    class Passing:
        def __init__(self, part: Any) -> None:
            self.part = part

        def __getattr__(self, name: str) -> Any:
            return getattr(self.part, name)

    for part in (ITSUNUSA.vehicle, ITSUNUSA.task, ITSUNUSA.vehicle.sensors[0].reads):
        assert is_compiled(part)
        assert not is_compiled(Passing(part))


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
    (_, ours), (core, many) = (flights(in_numpy[name], 9) for name in ("ours", part))
    stage = {"vehicle": core.config.world.step, "task": core.config.mission.step}[part]
    assert not stage.compiled
    for name in ("truth", "measurement", "estimate", "reference", "reward"):
        np.testing.assert_allclose(many[name], ours[name], rtol=1e-12, atol=1e-12, err_msg=name)
    for row in (0, 4, 8):
        for name, values in flights(in_numpy[part], 1, 3 + row)[1].items():
            np.testing.assert_array_equal(values[0], many[name][row], name)
