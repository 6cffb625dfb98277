"""The dives' autopilot: regulators that hold what they were designed for, and flights that follow the path."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from agents import rollout
from agents.controllers.dive import DiveAutopilot, DiveTolerances, Loop, lateral_loop, vertical_loop
from vessel_gym.core import Core
from vessel_gym.envs import ItsunusaAUVEnv, SegorogeniAUVEnv
from vessel_gym.guidance.dive_path import follow
from vessel_gym.system import System

SPATIAL, VERTICAL = SegorogeniAUVEnv.system, ItsunusaAUVEnv.system
DIVES = pytest.mark.parametrize("system", [SPATIAL, VERTICAL], ids=lambda system: system.name)
TOLERANCES = DiveTolerances()


def names_of(system: System) -> tuple[str, ...]:
    return system.vehicle.state_names


def steady_motion(system: System, loop: Loop, i: int, turning: bool) -> tuple[np.ndarray, np.ndarray]:
    """State ``(n,)`` and actuators ``(a,)`` of entry i of a table, roll left at zero."""
    vehicle, names = system.vehicle, names_of(system)
    x, actuators = np.zeros(len(names)), np.zeros(len(vehicle.action_names))
    x[0], actuators[-1] = vehicle.body.cruise_speed, loop.thrust[i]
    if turning:
        x[names.index("v")], x[names.index("r")], actuators[0] = loop.drift[i], loop.command[i], loop.fin[i]
    else:
        x[names.index("w")], actuators[-2] = loop.drift[i], loop.fin[i]
        x[names.index("theta")] = loop.command[i] + np.arctan2(loop.drift[i], x[0])
    return x, actuators


def advanced(system: System, x: np.ndarray, actuators: np.ndarray, steps: int = 1) -> np.ndarray:
    """States after steps in still water with the actuators held."""
    vehicle = system.vehicle
    held, still = np.concatenate([actuators, actuators], -1), np.zeros(len(vehicle.ambient_flows))
    for _ in range(steps):
        x = vehicle.drift(x, held, still)
    return x


def loops(system: System) -> list[tuple[Loop, bool]]:
    """Every loop of a vehicle, and whether it is the one that turns."""
    listed = [(vertical_loop(system.vehicle, TOLERANCES), False)]
    if system is SPATIAL:
        listed.append((lateral_loop(system.vehicle, TOLERANCES), True))
    return listed


# --- the design -------------------------------------------------------------------------------------


@DIVES
def test_steady_dives_climbs_and_turns_stay_as_they_are(system: System):
    names = names_of(system)
    for loop, turning in loops(system):
        kept = [names.index(name) for name in (("u", "v", "p", "r") if turning else ("u", "w", "q", "theta"))]
        for i in range(0, len(loop.command), 5):
            x, actuators = steady_motion(system, loop, i, turning)
            if turning:  # it heels by as much as gives no roll
                upright = x.copy()

                def rolling(heel: float, upright: np.ndarray = upright, held: np.ndarray = actuators) -> float:
                    return advanced(system, _heeled(names, upright, heel), held)[names.index("p")]

                x = _heeled(names, x, brentq(rolling, -0.5, 0.5, xtol=1e-14))
            # Within a step, the propeller's torque begins to roll a dive that is flown upright.
            np.testing.assert_allclose(advanced(system, x, actuators)[kept], x[kept], rtol=0, atol=1e-7)


def _heeled(names: tuple[str, ...], x: np.ndarray, heel: float) -> np.ndarray:
    return np.where(np.array(names) == "phi", heel, x)


@DIVES
def test_a_steady_dive_descends_at_the_angle_that_is_commanded(system: System):
    loop, names = vertical_loop(system.vehicle, TOLERANCES), names_of(system)
    speed, dt = system.vehicle.body.cruise_speed, system.vehicle.dt
    for i in range(0, len(loop.command), 9):
        x, actuators = steady_motion(system, loop, i, False)
        ahead, down = (advanced(system, x, actuators)[names.index(name)] / dt for name in ("x", "z"))
        assert np.arctan2(-down, ahead) == pytest.approx(loop.command[i], abs=1e-7)
        assert np.hypot(ahead, down) == pytest.approx(np.hypot(speed, loop.drift[i]), rel=1e-7)


def test_the_tables_of_turns_are_antisymmetric_and_rise_with_the_command():
    loop = lateral_loop(SPATIAL.vehicle, TOLERANCES)
    np.testing.assert_allclose(loop.command, -loop.command[::-1], atol=1e-15)
    for table in (loop.drift, loop.fin):  # but for the heel that the propeller's torque gives
        np.testing.assert_allclose(table, -table[::-1], rtol=0, atol=0.01 * np.abs(table).max())
    np.testing.assert_allclose(loop.thrust, loop.thrust[::-1], rtol=0.02)
    assert (np.diff(loop.fin) > 0.0).all()  # positive rudder turns to starboard
    assert (np.diff(loop.drift) < 0.0).all()  # and the stern slides out
    assert np.abs(loop.fin).max() < SPATIAL.vehicle.body.fin_limit


@DIVES
def test_the_tables_of_dives_are_smooth_and_within_the_limits(system: System):
    loop, body = vertical_loop(system.vehicle, TOLERANCES), system.vehicle.body
    assert (np.diff(loop.command) > 0.0).all()
    assert np.abs(loop.fin).max() < body.fin_limit
    assert loop.thrust.min() > 0.0
    assert loop.thrust.max() < body.thrust_limit
    for table in (loop.drift, loop.fin, loop.thrust):
        steps = np.abs(np.diff(table, 2))
        assert steps.max() < 0.01 * np.ptp(table)
    middle = len(loop.command) // 2
    drift, fin, thrust = loop.steady(np.array([loop.command[3], 0.0, 9.0, -9.0]))
    np.testing.assert_allclose(drift, loop.drift[[3, middle, -1, 0]], atol=1e-12)
    np.testing.assert_allclose(fin, loop.fin[[3, middle, -1, 0]], atol=1e-12)
    np.testing.assert_allclose(thrust, loop.thrust[[3, middle, -1, 0]], atol=1e-12)  # beyond the table: its end


def plane(system: System, turning: bool) -> tuple[np.ndarray, np.ndarray]:
    """``A (k, k)`` and ``B (k, 1)`` of one plane about straight and level cruising, by differences to one side."""
    names = names_of(system)
    listed = ("v", "p", "r", "phi", "psi") if turning else ("w", "q", "theta")
    index, step = [names.index(name) for name in listed], 1e-6
    loop = lateral_loop(system.vehicle, TOLERANCES) if turning else vertical_loop(system.vehicle, TOLERANCES)
    x, actuators = steady_motion(system, loop, len(loop.command) // 2, turning)
    nominal = advanced(system, x, actuators)
    A = np.stack(
        [(advanced(system, x + step * e, actuators) - nominal)[index] / step for e in np.eye(len(x))[index]], -1
    )
    fin = step * np.eye(len(actuators))[0 if turning else -2]
    B = ((advanced(system, x, actuators + fin) - nominal)[index] / step)[:, None]
    return A, B


@DIVES
def test_the_regulators_make_every_plane_stable_and_well_damped(system: System):
    for loop, turning in loops(system):
        A, B = plane(system, turning)
        alone, held = np.linalg.eigvals(A), np.linalg.eigvals(A - B @ loop.gains[None])
        assert np.abs(alone).max() >= 1.0 - 1e-3 or not turning  # no vehicle holds a course by itself
        assert np.abs(held).max() < 0.99
        slow = np.log(held[np.abs(held) > 0.8] + 0j) / system.vehicle.dt
        damping = -slow.real / np.abs(slow)
        # What the fins cannot reach, the roll, keeps the damping of the hull.
        assert (damping > 0.25).all()


@DIVES
def test_the_gains_are_those_of_an_independent_riccati_iteration(system: System):
    speed = system.vehicle.body.cruise_speed
    for loop, turning in loops(system):
        A, B = plane(system, turning)
        direction = np.zeros(len(A))
        direction[0], direction[-1] = (1.0 if turning else -1.0) / speed, 1.0
        Q = np.outer(direction, direction) / TOLERANCES.direction**2
        rate = 2 if turning else 1
        Q[rate, rate] += TOLERANCES.rate**-2
        R, P = np.array([[TOLERANCES.fin**-2]]), Q
        for _ in range(3000):  # value iteration: the cost of ever more steps to go
            K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
            P = Q + A.T @ P @ (A - B @ K)
        np.testing.assert_allclose(loop.gains, K[0], rtol=2e-4, atol=2e-4 * np.abs(K).max())


@pytest.mark.slow
@DIVES
def test_other_tolerances_give_other_gains_of_the_expected_size(system: System):
    gentle = vertical_loop(system.vehicle, replace(TOLERANCES, fin=0.05))
    assert np.linalg.norm(gentle.gains) < np.linalg.norm(vertical_loop(system.vehicle, TOLERANCES).gains)


# --- what it does with an observation ---------------------------------------------------------------


def seen_with(system: System, **values: float) -> np.ndarray:
    """An observation of a vehicle on its path with some errors [SI], by name with _ for spaces."""
    observation = np.zeros((1, Core(system).observation_size))
    for i, (name, scale) in enumerate(system.task.observed.items()):
        observation[0, i] = values.pop(name.replace(" ", "_"), 0.0) / scale
    assert not values
    return observation


@DIVES
def test_it_steers_towards_the_path_and_against_its_errors(system: System):
    agent = DiveAutopilot(system)
    trim = agent.act(seen_with(system))[0]
    assert agent.act(seen_with(system, path_below=0.3))[0, -2] > trim[-2] + 0.05  # positive stern plane dives
    assert agent.act(seen_with(system, path_below=-0.3))[0, -2] < trim[-2] - 0.05
    assert agent.act(seen_with(system, pitch_error=0.1))[0, -2] < trim[-2] - 0.05  # the path climbs more
    assert agent.act(seen_with(system, pitch_rate=0.2))[0, -2] > trim[-2] + 0.05
    assert agent.act(seen_with(system, surge_error=-0.2))[0, -1] > trim[-1] + 0.02
    assert agent.act(seen_with(system, surge_error=0.2))[0, -1] < trim[-1] - 0.02
    sinking = agent.act(seen_with(system, heave=0.1))[0, -2]
    carried = agent.act(seen_with(system, heave=0.1, current_ahead=1.0))[0, -2]
    assert carried > sinking + 0.01  # over ground it sinks at a flatter angle
    if system is SPATIAL:
        assert agent.act(seen_with(system, path_to_starboard=0.3))[0, 0] > trim[0] + 0.05
        assert agent.act(seen_with(system, heading_error=0.1))[0, 0] > trim[0] + 0.05
        assert agent.act(seen_with(system, yaw_rate=0.2))[0, 0] < trim[0] - 0.05
        assert agent.act(seen_with(system, current_to_starboard=0.2))[0, 0] < trim[0] - 0.05


# --- flights ----------------------------------------------------------------------------------------


def off_the_path(system: System, flight: Any) -> tuple[np.ndarray, np.ndarray]:
    """Cross-track and depth errors [m] of all true positions of a flight but those of its first two seconds."""
    position, off = system.task.position, ([], [])
    for row, length in enumerate(flight.length):
        truth, reference = (flight.history[key][20:length, row] for key in ("truth", "reference"))
        true = follow(position(truth), reference[:, 8:], 0.0)
        off[0].append(true[:, 1])
        off[1].append(true[:, 2])
    return np.concatenate(off[0]), np.concatenate(off[1])


@DIVES
def test_on_truth_in_calm_water_every_dive_arrives_and_keeps_to_the_path(system: System):
    flight = rollout("autopilot", system.name, range(12), {"estimator": "truth", "disturbance": "calm"})
    assert flight.terminated.all()
    assert (flight.end == "arrived").all()
    cross, depth = off_the_path(system, flight)
    assert np.sqrt(np.mean(cross**2)) < 0.03  # m; the task's tolerance is 0.25
    assert np.sqrt(np.mean(depth**2)) < 0.05
    assert flight.score.min() > 0.85  # the start, up to half a metre off, costs some
    assert flight.score.mean() > 0.92


@pytest.mark.slow
@DIVES
def test_on_truth_currents_do_not_carry_it_off(system: System):
    flight = rollout("autopilot", system.name, range(12), {"estimator": "truth", "disturbance": "rough"})
    assert (flight.end == "arrived").all()
    cross, depth = off_the_path(system, flight)
    assert np.sqrt(np.mean(cross**2)) < 0.05
    assert np.sqrt(np.mean(depth**2)) < 0.05
    assert flight.score.mean() > 0.9


@pytest.mark.slow
@DIVES
def test_a_vehicle_that_differs_from_its_model_is_flown_all_the_same(system: System):
    options = {"estimator": "truth", "disturbance": "calm", "mismatch": 0.1}
    flight = rollout("autopilot", system.name, range(20), options)
    assert (flight.end == "arrived").mean() > 0.9
    assert flight.score.mean() > 0.85
