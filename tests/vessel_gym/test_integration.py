"""The step that all vehicles share: the solution of their rates, and the same for many states as for each."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vessel_gym.envs.ship import ship_system
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.simulated import resolving_substeps, runge_kutta

# --- modes ----------------------------------------------------------------------------------------


def of_size(length: float, speed: float, **changes: Any) -> CorvetteParameters:
    """A ship of the Mariner's form, of a length [m] and service speed [m/s]."""
    ship = load("mariner", CorvetteParameters)
    by, speeds = length / ship.length, speed / ship.speed
    return replace(
        ship, length=length, beam=by * ship.beam, draught=by * ship.draught, mass=by**3 * ship.mass,
        x_g=by * ship.x_g, speed=speed, resistance=(by * speeds) ** 2 * ship.resistance, **changes,
    )  # fmt: skip


SHIPS = {
    "corvette": load("corvette", CorvetteParameters),
    "mariner": load("mariner", CorvetteParameters),
    "320 m at 7.5 m/s": of_size(320.0, 7.5),
    "60 m at 6 m/s, roll of 6 s": of_size(60.0, 6.0, roll_period=6.0),
    "60 m at 1.6 m/s, roll of 6 s": of_size(60.0, 1.6, roll_period=6.0),
}


@pytest.mark.parametrize("phase", [0.5 * np.pi, 0.6 * np.pi, 0.9 * np.pi, np.pi])
@pytest.mark.parametrize("fastest", [0.01, 0.999, 1.001, 7.3])
def test_a_mode_is_resolved_to_a_tenth_of_a_percent(fastest: float, phase: float):
    """From an oscillation without damping to a decay without oscillation."""
    value = fastest * np.exp(1j * phase)
    matrix = np.array(
        [[value.real, -value.imag], [value.imag, value.real]]
    )  # it has this eigenvalue
    state, still = np.array([1.0, 0.0]), np.zeros(1)
    substeps = resolving_substeps(1.0, fastest)
    x, y = runge_kutta(lambda s, *_: matrix @ s, state, still, still, still, still, 1.0, substeps)
    growth = np.exp(-value) * (x + 1j * y)  # of the numerical solution in relation to the exact one
    assert abs(np.log(growth)) < 8e-4 * fastest


@pytest.mark.parametrize("name", SHIPS)
def test_a_ship_rolls_as_with_many_substeps(name: str):
    """In a moment at her natural frequency, where the amplitude hangs on damping the most."""
    ship, vehicle = SHIPS[name], ship_system(SHIPS[name]).vehicle
    c, dt, period = ship.vector()[None], vehicle.dt, ship.period_of_roll
    exogenous, amidships = np.zeros((1, 8)), np.zeros((1, 1))
    state, *_ = vehicle.start(vehicle.cruise[0][None])
    fine, rolls = state, []
    for k in range(round(30.0 * period / dt)):
        moment = (
            0.01
            * vehicle.ship.mass
            * 9.81
            * ship.stiffness
            * np.sin(2.0 * np.pi * (k + 0.5) * dt / period)
        )
        exogenous[:, 1 + vehicle.ambient_flows.index("roll moment")] = moment
        state = vehicle.step(state, amidships, amidships, exogenous, c)
        fine = runge_kutta(
            vehicle.equations, fine, amidships, amidships, exogenous[:, 1:], c, dt, 16
        )
        rolls.append([state[0, 6], fine[0, 6]])
    rms, converged = np.std(rolls[len(rolls) // 2 :], axis=0)
    assert rms == pytest.approx(converged, rel=0.005)
