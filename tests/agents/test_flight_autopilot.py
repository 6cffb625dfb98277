"""The flight's autopilot: loops that hold what they were designed for, and flights that follow the path."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from agents import rollout
from agents.controllers.flight import FlightAutopilot, FlightTolerances, lateral_gains, longitudinal_gains
from vessel_gym.envs import PunaUAVEnv
from vessel_gym.vehicles.puna import trim

SYSTEM = PunaUAVEnv.system
TASK, VEHICLE = SYSTEM.task, SYSTEM.vehicle
BODY, STATES = VEHICLE.body, VEHICLE.state_names
TOLERANCES = FlightTolerances()


def advanced(state: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The state a step later in still air."""
    return VEHICLE.drift(state, np.concatenate([before, after], -1), np.zeros(3))


def cruising() -> np.ndarray:
    """Level and northwards at cruising speed, ``(7,)``."""
    truth = np.zeros(len(STATES))
    truth[STATES.index("north")] = BODY.cruise_speed
    return truth


def spectral_radius(gains: np.ndarray, longitudinal: bool) -> tuple[float, float]:
    """Of the vehicle's own step over ground about cruising, without and with the loop."""
    speed, h = BODY.cruise_speed, 1e-5

    def after(z: np.ndarray, gains: np.ndarray) -> np.ndarray:
        truth, before, wanted = cruising(), BODY.cruise.copy(), BODY.cruise.copy()
        if longitudinal:
            truth[STATES.index("h")] = z[0]
            truth[STATES.index("north")] = (speed + z[1]) * np.cos(z[2])
            truth[STATES.index("climb")] = (speed + z[1]) * np.sin(z[2])
            before[:2] += z[3:]
            wanted[:2] -= gains @ z
        else:
            truth[STATES.index("y")], truth[STATES.index("phi")] = z[0], z[2]
            truth[STATES.index("north")], truth[STATES.index("east")] = speed * np.cos(z[1]), speed * np.sin(z[1])
            wanted[2] = before[2] = -gains @ z
        reached = VEHICLE.actuate(before, BODY.actions(wanted))
        moved = dict(zip(STATES, advanced(truth, before, reached), strict=True))
        level = np.hypot(moved["north"], moved["east"])
        if longitudinal:
            motion = [moved["h"], np.hypot(level, moved["climb"]) - speed, np.arctan2(moved["climb"], level)]
            return np.array([*motion, *(reached - BODY.cruise)[:2]])
        return np.array([moved["y"], np.arctan2(moved["east"], moved["north"]), moved["phi"]])

    radii = []
    for held in (np.zeros_like(gains), gains):
        units = np.eye(gains.shape[-1])
        jacobian = np.stack([(after(h * e, held) - after(-h * e, held)) / (2.0 * h) for e in units], -1)
        radii.append(float(np.abs(np.linalg.eigvals(jacobian)).max()))
    return radii[0], radii[1]


# --- the design -------------------------------------------------------------------------------------


def test_the_loops_make_the_linearised_aircraft_stable():
    for gains, longitudinal in (
        (lateral_gains(VEHICLE, TOLERANCES), False), (longitudinal_gains(VEHICLE, TOLERANCES), True),
    ):  # fmt: skip
        alone, held = spectral_radius(gains, longitudinal)
        assert alone > 1.0 - 1e-3  # no aircraft holds its altitude or its course by itself
        assert held < 0.99


@pytest.mark.parametrize(("gains", "command"), [(lateral_gains, "bank"), (longitudinal_gains, "alpha")])
def test_the_less_a_command_may_move_the_smaller_its_gains(gains: Callable[..., np.ndarray], command: str):
    row = (..., slice(0, 3)) if command == "bank" else (1, slice(0, 3))
    sizes = []
    for factor in (0.5, 1.0, 2.0):
        tolerances = replace(TOLERANCES, **{command: factor * getattr(TOLERANCES, command)})
        sizes.append(np.linalg.norm(gains(VEHICLE, tolerances)[row]))
    assert sizes[0] < 0.9 * sizes[1] < 0.81 * sizes[2]


def seen_with(**errors: float) -> np.ndarray:
    """An observation ``(1, 18)`` of cruising along a straight path but for some things, in SI."""
    values = {name: offset for name, (offset, _) in TASK.observed.items()}
    values |= {"course cosine": 1.0} | {name.replace("_", " "): value for name, value in errors.items()}
    cross = values.pop("cross track", values["cross-track"])
    values["cross-track"] = cross
    scaled = [(values[name] - offset) / scale for name, (offset, scale) in TASK.observed.items()]
    return np.array([scaled + [0.0, 0.0, 0.0]], np.float32)


def test_on_its_path_and_in_trim_it_changes_nothing():
    np.testing.assert_allclose(FlightAutopilot(SYSTEM).act(seen_with()), 0.0, rtol=0, atol=1e-3)


@pytest.mark.parametrize("bank", [-0.45, -0.2, 0.2, 0.45])
def test_steady_turns_of_its_tables_are_steady(bank: float):
    """In the turn that the path wants, it holds the aircraft's own trim, in which the vehicle turns level."""
    steady = trim(BODY.cruise_speed, BODY, bank=bank)
    truth, actuators = cruising(), np.array([steady.thrust, steady.alpha, bank])
    truth[STATES.index("phi")] = bank
    seen = seen_with(bank_of_the_path=bank, bank=bank)
    seen[:, -3:] = BODY.actions(actuators)
    action = FlightAutopilot(SYSTEM).act(seen)[0]
    np.testing.assert_allclose(BODY.commands(action.astype(float)), actuators, rtol=5e-3, atol=1e-4)
    moved = dict(zip(STATES, advanced(truth, actuators, actuators), strict=True))
    assert moved["climb"] == pytest.approx(0.0, abs=1e-6)
    assert moved["phi"] == pytest.approx(bank, abs=1e-9)
    assert np.hypot(moved["north"], moved["east"]) == pytest.approx(BODY.cruise_speed, abs=1e-6)
    turned = BODY.gravity * np.tan(bank) / BODY.cruise_speed * VEHICLE.dt
    assert np.arctan2(moved["east"], moved["north"]) == pytest.approx(turned, rel=1e-3)


# --- what it does with an observation ---------------------------------------------------------------


def test_it_steers_towards_the_path_and_against_its_errors():
    agent = FlightAutopilot(SYSTEM)
    thrust, alpha, bank = agent.act(seen_with())[0]
    assert agent.act(seen_with(cross_track=5.0))[0, 2] < bank - 0.05  # to starboard of the path: turn to port
    assert agent.act(seen_with(course_sine=0.1))[0, 2] > bank + 0.05
    assert agent.act(seen_with(bank=0.2))[0, 2] < bank - 0.05
    assert agent.act(seen_with(bank_of_the_path=0.2))[0, 2] > bank + 0.05
    assert agent.act(seen_with(altitude_error=1.0))[0, 1] < alpha - 0.02
    assert agent.act(seen_with(climb=1.0))[0, 1] < alpha - 0.02
    assert agent.act(seen_with(airspeed=BODY.cruise_speed - 1.0))[0, 0] > thrust + 0.02


# --- flights ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_on_truth_every_flight_arrives_and_keeps_to_the_path():
    # In rough air the mean says how well the path is kept: single flights fall to 0.74 among sixty, on any path.
    for disturbance, least, mean in (("calm", 0.95, 0.95), ("rough", 0.7, 0.9)):
        flight = rollout("autopilot", SYSTEM.name, range(12), {"estimator": "truth", "disturbance": disturbance})
        assert flight.terminated.all()
        assert (flight.end == "arrived").all()
        assert flight.score.min() > least
        assert flight.score.mean() > mean
