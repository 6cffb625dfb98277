"""Calls that make no sense: one sentence that names the argument, from every constructor, trial and formula."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vessel_gym.core import Core
from vessel_gym.disturbances import Air, Fault, Sea, SurfaceWater, Water
from vessel_gym.envs import SigmaCorvetteEnv
from vessel_gym.envs.own import register_environment
from vessel_gym.guidance import dubins
from vessel_gym.processes import Process
from vessel_gym.seaway import Seaway
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Bias, Sensor, plain
from vessel_gym.surroundings import Surroundings
from vessel_gym.system import System
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.tasks.dive import SpatialDive
from vessel_gym.tasks.flight import Flight
from vessel_gym.tasks.task import Task
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.rov import ROV
from vessel_gym.vehicles.ship import Ship

SHIP, MARINER, AUV, PUNA = (load(name) for name in ("corvette", "mariner", "segorogeni", "puna"))
SENSOR: dict[str, Any] = {"name": "fix", "channels": ("x [m]",), "reads": plain((0,)), "sd": (1.0,)}
POSE, GOAL = np.zeros(3), np.array([300.0, 50.0, 1.0])
NOT_POSITIVE, NEGATIVE, NO_WHOLE, NO_VECTOR = 0, -5.0, 2.5, np.zeros((2, 2))


def given(task: Task, name: str, value: Any) -> Task:
    """A task with an attribute of its own."""
    made: Task = type("Given", (type(task),), {name: value})()
    return made


SEAWAY = {"ship": SHIP, "height": 2.0, "period": 8.0, "wind": 5.0, "current": 0.3, "dt": 0.5}
WATER = {"turbulence": 0.01, "spin": 0.01, "current": 0.1}
DIVE = {
    "auv": AUV,
    "goal": (10.0, 18.0, 6.0),
    "goal_spread": (1.0, 1.0, 0.5),
    "ahead": 2.5,
    "horizon": 500,
}
SYSTEM = {name: getattr(SigmaCorvetteEnv.system, name) for name in System.__dataclass_fields__}
CALLS: list[tuple[Callable[..., Any], dict[str, Any], dict[str, Any]]] = [
    (
        Sea,
        {"wave": 0.01, "peak": 0.8, "gust": 0.01, "current": 0.1},
        {"wave": NEGATIVE, "peak": NOT_POSITIVE, "gust_time": NOT_POSITIVE, "dt": NOT_POSITIVE},
    ),
    (
        Water,
        WATER,
        {
            "turbulence": NEGATIVE,
            "spin": NEGATIVE,
            "current": NEGATIVE,
            "dt": NOT_POSITIVE,
            "current_time": NOT_POSITIVE,
            "velocities": None,
        },
    ),
    (
        SurfaceWater,
        {"height": 1.0, "period": 7.0, "beside": Water(**WATER), "north": 6, "down": 8},
        {"height": NEGATIVE, "period": NOT_POSITIVE, "beside": None, "north": "x"},
    ),
    (
        Air,
        {"wind": 1.0, "gust": 1.0, "vertical_gust": 0.5},
        {"wind": NEGATIVE, "airspeed": NOT_POSITIVE, "length": NOT_POSITIVE},
    ),
    (
        Fault,
        {"actuator": "rudder"},
        {"actuator": None, "bias": np.nan, "beside": None, "dt": NOT_POSITIVE, "walk": -1.0},
    ),
    (
        Seaway,
        SEAWAY,
        {
            "ship": None,
            "height": NOT_POSITIVE,
            "period": NOT_POSITIVE,
            "wind": NEGATIVE,
            "direction": 90.0,
            "current_time": NOT_POSITIVE,
        },
    ),
    (
        Process,
        {"transition": np.eye(2), "root": np.eye(2), "start_cov": np.eye(2)},
        {"transition": None, "root": None, "start_cov": np.zeros(2)},
    ),
    (
        Process.stationary,
        {"A": -np.eye(2), "W": np.eye(2), "dt": 0.1},
        {"A": None, "W": np.eye(3), "dt": NOT_POSITIVE},
    ),
    (
        Bias,
        {"names": ("b",), "start": (1.0,)},
        {"names": "b", "start": (-1.0,), "scale": NOT_POSITIVE},
    ),
    (
        Sensor,
        SENSOR,
        {
            "name": None,
            "channels": None,
            "reads": None,
            "sd": None,
            "rate": 0.0,
            "dropout": 1.5,
            "bias": "b",
            "angles": None,
            "latency": -1.0,
            "inverse": 3,
        },
    ),
    (SensorFault, {"sensor": "fix", "kind": "off"}, {"sensor": None, "kind": None, "begin": "x"}),
    (Ship, {"ship": SHIP}, {"ship": None, "dt": NOT_POSITIVE}),
    (ROV, {}, {"body": None, "dt": NOT_POSITIVE, "substeps": NO_WHOLE}),
    (
        CircleTrack,
        {"ship": SHIP},
        {"ship": None, "pace": NOT_POSITIVE, "horizon": NO_WHOLE, "radius": None},
    ),
    (
        SpatialDive,
        DIVE,
        {
            "auv": None,
            "goal": NO_VECTOR,
            "goal_spread": NO_VECTOR,
            "ahead": NOT_POSITIVE,
            "horizon": NO_WHOLE,
            "steepest": 35.0,
        },
    ),
    (
        Flight,
        {"body": PUNA},
        {
            "body": None,
            "radius": NOT_POSITIVE,
            "margin": NEGATIVE,
            "altitudes": None,
            "horizon": NO_WHOLE,
        },
    ),
    (
        System,
        SYSTEM,
        {
            "name": None,
            "vehicle": None,
            "task": None,
            "disturbances": None,
            "filter_model": None,
            "estimator": None,
            "tuning": None,
            "sensors": "nominal",
        },
    ),
    (
        register_environment,
        {"system": replace(SigmaCorvetteEnv.system, name="Malformed-v0")},
        {"system": None, "max_episode_steps": 0},
    ),
    (Surroundings, {}, {"hull": None, "size": NOT_POSITIVE, "path": NO_VECTOR, "goal": (1.0, 2.0)}),
    (
        dubins.shortest,
        {"start": POSE, "goal": GOAL, "radius": 30.0},
        {"start": None, "goal": "home", "radius": None},
    ),
]
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


def refused(call: Callable[[], Any]) -> str:
    """The one sentence with which a call is refused, without a warning on the way."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises((ValueError, TypeError)) as caught:
            call()
    message = str(caught.value)
    assert "\n" not in message
    assert 10 < len(message) < 350
    return message


@pytest.mark.parametrize(("function", "arguments", "name"), CASES)
def test_a_malformed_argument_is_named_in_a_sentence(
    function: Callable[..., Any], arguments: dict[str, Any], name: str
):
    message = refused(lambda: function(**arguments))
    assert name in message or name.replace("_", " ") in message or name.rstrip("s") in message


def test_right_calls_pass():
    for function, right, _ in CALLS:
        if right and isinstance(function, type):
            function(**right)


def test_a_seaway_of_another_ship_than_the_one_that_sails_is_refused():
    other = Seaway(MARINER, 2.0, 8.0, 5.0, 0.3, SigmaCorvetteEnv.system.vehicle.dt)
    with pytest.raises(
        ValueError,
        match=r"^Seaway was made for another ship than the vehicle's: give it ship=vehicle",
    ):
        Core(SigmaCorvetteEnv.system, disturbance=other)


@pytest.mark.parametrize(
    ("name", "value"),
    [("prior_sd", (-1.0,)), ("prior_sd", "x"), ("uniforms", -1), ("uniforms", 1.5), ("horizon", 0),
     ("end_reasons", "arrived"),
     ("end_reasons", ()), ("end_reasons", ("", "over", "over")), ("perfect", np.nan), ("perfect", 0.0), ("perfect",
     -1.0), ("success", "arived"), ("state_scale", [np.nan])],
)  # fmt: skip
def test_a_task_whose_figures_make_no_sense_is_refused_by_its_system(name: str, value: Any):
    assert name in refused(lambda: System(**SYSTEM | {"task": given(Task(), name, value)}))


def test_a_process_keeps_copies_that_nobody_can_write_into():
    arrays = {"transition": 0.5 * np.eye(2), "root": np.eye(2), "start_cov": np.eye(2)}
    process = Process(**arrays)
    for name, array in arrays.items():
        array[:] = 7.0
        kept = getattr(process, name)
        assert not kept.flags.writeable
        assert kept[0, 1] == 0.0
