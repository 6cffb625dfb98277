"""Calls that make no sense: one sentence that names the argument, from every constructor, trial and formula."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from refusals import refusal

from vessel_gym.disturbances import Fault, Seaway, SurfaceWater
from vessel_gym.disturbances.spectrum import WaveSpectrum, WaveSystem
from vessel_gym.envs import SigmaCorvetteEnv
from vessel_gym.envs.auv import WATERS
from vessel_gym.envs.own import register_environment
from vessel_gym.processes import Process
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Bias, Sensor, plain
from vessel_gym.system import System
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.tasks.dive import SpatialDive
from vessel_gym.tasks.flight import Flight
from vessel_gym.tasks.task import Task, Workspace
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.rov import ROV
from vessel_gym.vehicles.ship import Ship

SHIP, AUV, PUNA = (load(name) for name in ("corvette", "segorogeni", "puna"))
SENSOR: dict[str, Any] = {"name": "fix", "channels": ("x [m]",), "reads": plain((0,)), "sd": (1.0,)}
NOT_POSITIVE, NEGATIVE, NO_WHOLE, NO_VECTOR = 0, -5.0, 2.5, np.zeros((2, 2))
SPECTRUM = WaveSpectrum.of_systems(WaveSystem(height=2.0, period=8.0))

DIVE = {
    "auv": AUV,
    "goal": (10.0, 18.0, 6.0),
    "goal_spread": (1.0, 1.0, 0.5),
    "ahead": 2.5,
    "horizon": 500,
}
SYSTEM = {name: getattr(SigmaCorvetteEnv.system, name) for name in System.__dataclass_fields__}
CALLS: list[tuple[Callable[..., Any], dict[str, Any], dict[str, Any]]] = [
    (WaveSystem, {"height": 1.0, "period": 7.0}, {"direction": 90.0, "spreading": "cos4"}),
    (SurfaceWater, {"spectrum": SPECTRUM, "beside": WATERS["calm"], "place": (6, 7), "down": 8},
     {"spectrum": None, "place": (6,)}),
    (Seaway, {"ship": SHIP, "spectrum": SPECTRUM, "wind": 5.0, "current": 0.3, "dt": 0.5},
     {"spectrum": None, "wind_direction": 90.0}),
    (Fault, {"actuator": "rudder"}, {"actuator": None, "bias": np.nan, "beside": None}),
    (Process, {"transition": np.eye(2), "root": np.eye(2), "start_cov": np.eye(2)},
     {"transition": None, "root": None, "start_cov": np.zeros(2)}),
    (Process.stationary, {"A": -np.eye(2), "W": np.eye(2), "dt": 0.1},
     {"A": None, "W": np.eye(3), "dt": NOT_POSITIVE}),
    (Bias, {"names": ("b",), "start": (1.0,)}, {"scale": NOT_POSITIVE}),
    (Sensor, SENSOR, {"name": None, "channels": None, "bias": "b", "inverse": 3}),
    (SensorFault, {"sensor": "fix", "kind": "off"}, {"sensor": None, "begin": "x", "end": [1.0, [2.0, 3.0]]}),
    (type(SHIP), {name: getattr(SHIP, name) for name in SHIP.__dataclass_fields__}, {"given": (("Yv",),)}),
    (Ship, {"ship": SHIP}, {"ship": None}),
    (ROV, {}, {"dt": NOT_POSITIVE, "substeps": NO_WHOLE}),
    (CircleTrack, {"ship": SHIP}, {"pace": NOT_POSITIVE, "horizon": NO_WHOLE}),
    (SpatialDive, DIVE, {"goal": NO_VECTOR, "ahead": NOT_POSITIVE}),
    (Flight, {"body": PUNA},
     {"body": None, "radius": NOT_POSITIVE, "distance": None}),
    (System, SYSTEM, dict.fromkeys(("name", "vehicle", "task", "disturbances", "filter_model", "estimator", "tuning"))
     | {"sensors": "nominal"}),
    (register_environment, {"system": replace(SigmaCorvetteEnv.system, name="Malformed-v0")},
     {"system": None, "max_episode_steps": 0}),
    (Workspace, {}, {"hull": None, "size": NOT_POSITIVE, "path": NO_VECTOR, "goal": (1.0, 2.0)}),
]  # fmt: skip
CASES = [
    pytest.param(
        function,
        right | {name: value},
        name,
        id=f"{getattr(function, '__qualname__', function)}-{name}",
    )
    for function, right, wrong in CALLS
    for name, value in wrong.items()
]


@pytest.mark.parametrize(("function", "arguments", "name"), CASES)
def test_a_malformed_argument_is_named_in_a_sentence(
    function: Callable[..., Any], arguments: dict[str, Any], name: str
):
    message = refusal((ValueError, TypeError), function, **arguments)
    assert name in message or name.replace("_", " ") in message or name.rstrip("s") in message


@pytest.mark.parametrize(
    ("name", "value"),
    [("prior_sd", (-1.0,)), ("uniforms", 1.5), ("horizon", 0), ("end_reasons", "arrived"),
     ("end_reasons", ("", "over", "over")), ("perfect", 0.0), ("success", "arived"), ("state_scale", [np.nan])],
)  # fmt: skip
def test_system_refuses_task_with_bad_figures(name: str, value: Any):
    task = type("Given", (Task,), {name: value})()
    assert name in refusal((ValueError, TypeError), System, **SYSTEM | {"task": task})


def test_a_process_keeps_copies_that_nobody_can_write_into():
    arrays = {"transition": 0.5 * np.eye(2), "root": np.eye(2), "start_cov": np.eye(2)}
    process = Process(**arrays)
    for name, array in arrays.items():
        array[:] = 7.0
        kept = getattr(process, name)
        assert not kept.flags.writeable
        assert kept[0, 1] == 0.0
