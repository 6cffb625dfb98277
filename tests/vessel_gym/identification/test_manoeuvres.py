"""Numbers of manoeuvres, against circles and triangles whose numbers are known."""

from dataclasses import replace

import numpy as np

from tests.vessel_gym.identification.voyages import SHIP, coefficients
from vessel_gym.identification.manoeuvres import compare, execution, manoeuvre
from vessel_gym.identification.prediction import simulate
from vessel_gym.identification.score import predictors
from vessel_gym.identification.trial import Trial
from vessel_gym.vehicles.measured_ship import MeasuredShip


def circle(side: float, course: float, radius: float = 5.0) -> np.ndarray:
    """States on a circle, at a speed that falls by a third in half a turn."""
    psi = np.linspace(0.0, 1.2 * np.pi, 2001)
    north, east = radius * np.sin(psi), side * radius * (1.0 - np.cos(psi))
    cos, sin = np.cos(course), np.sin(course)
    speed = 1.5 - 0.5 * psi / np.pi
    zero = np.zeros_like(psi)
    return np.stack([cos * north - sin * east, sin * north + cos * east, course + side * psi, speed, zero, zero], -1)


def test_a_circle_has_its_radius_as_advance_and_its_diameter() -> None:
    for side in (1.0, -1.0):
        for course in (0.0, 2.5):
            found = manoeuvre(circle(side, course), np.full(2000, 0.6 * side))
            np.testing.assert_allclose(found.advance, 5.0, rtol=1e-5)
            np.testing.assert_allclose(found.tactical_diameter, 10.0, rtol=1e-5)
            np.testing.assert_allclose(found.speed_loss, 1.0 / 3.0, rtol=1e-5)
            assert found.overshoots == ()


def test_overshoots_are_what_the_heading_goes_on_after_a_reversal() -> None:
    psi = np.concatenate([np.linspace(0, 13, 131), np.linspace(13, -14, 271)[1:], np.linspace(-14, 0, 141)[1:]])
    states = np.zeros((len(psi), 6))
    states[:, 2], states[:, 3] = np.deg2rad(psi), 1.0
    rudder = np.full(len(psi) - 1, 0.2)
    rudder[100:360] = -0.2  # at 10 degrees, and at -10 on the way down
    rudder[98:100] = 0.0
    found = manoeuvre(states, rudder)
    np.testing.assert_allclose(np.rad2deg(found.overshoots), [3.0, 4.0], atol=0.1)
    assert np.isnan(found.advance)


def test_a_trial_of_the_model_itself_has_no_gap() -> None:
    rng = np.random.default_rng(0)
    c, dt = coefficients(rng, 0.2), 0.2
    control = np.stack(
        [np.r_[np.zeros(20), np.full(20, -0.5), np.zeros(10), np.full(600, 0.5)], np.full(650, 10.0)], -1
    )
    air, start = np.zeros((650, 4)), np.array([0.0, 0.0, 1.0, 0.4, 0.0, 0.0])
    states = simulate(start, control, air, c, SHIP.vector(), dt)
    assert execution(control[:, 0], states[:, 2]) == 50
    assert execution(np.zeros(10), np.zeros(11)) is None
    ship = MeasuredShip.assumed(SHIP)
    predict = predictors(replace(ship, coefficients=c), dt, {})["identified model"]
    found = compare(predict, Trial("turn", dt, 0.0, states, control, air))
    assert found is not None
    assert np.isfinite([found[0].advance, found[0].tactical_diameter, found[0].speed_loss]).all()
    assert found[0] == found[1]
