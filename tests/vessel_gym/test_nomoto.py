"""Nomoto's model of our ships."""

import numpy as np
import pytest
from nomoto_models import nomoto_linear

from vessel_gym.vehicles.corvette import sway_yaw_jacobian
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.files import load

SHIPS = {"thesis": load("corvette-thesis"), "corvette": load("corvette")}
each_ship = pytest.mark.parametrize("ship", SHIPS.values(), ids=SHIPS)


@each_ship
def test_nomoto_figures_are_those_of_the_transfer_function(
    ship: CorvetteParameters,
):
    A, B = sway_yaw_jacobian(np.array([ship.speed, 0.0, 0.0]), np.array(0.0), ship)
    unit = ship.length / ship.speed

    def gain(s: complex) -> complex:
        return np.linalg.solve(s * np.eye(2) - A, B)[1, 0]

    n = nomoto_linear(ship)
    assert pytest.approx(gain(0.0) * unit) == n.K
    assert n.K > 0.0  # positive rudder turns to starboard
    rises = [np.log(gain(s)) - np.log(gain(-s)) for s in (1e-4, 2e-4)]
    slope = (8.0 * rises[0] - rises[1]) / 12e-4
    assert pytest.approx(-slope / unit, rel=1e-6) == n.T
    s = 0.3j  # any other point of the complex plane
    model = n.K * (1.0 + n.T3 * s) / ((1.0 + n.T1 * s) * (1.0 + n.T2 * s))
    assert abs(model / (gain(s / unit) * unit) - 1.0) < 1e-9
