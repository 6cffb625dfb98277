"""Vehicles with thrusters: allocation, energy, equilibrium, drag balance, Fossen's equations; their recipe."""

import sys
from importlib import import_module

import numpy as np
import pytest
from pages import blocks
from scipy.spatial.transform import Rotation

from agents import rollout
from agents.metrics import scores
from agents.studies.study import read_study
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.rov import (
    ROV,
    UNCERTAIN,
    ROVParameters,
    rov_rates,
    with_euler_angles,
    with_quaternion,
)

BODY = load("bluerov2-heavy", ROVParameters)
C = BODY.vector()
INERTIA = np.array(
    [13.5 + 6.36, 13.5 + 7.12, 13.5 + 18.68, 0.26 + 0.189, 0.23 + 0.135, 0.37 + 0.222]
)
RNG = np.random.default_rng(1)
STATES = RNG.uniform(-1.0, 1.0, (200, 12)) * [1.5, 1, 1, 1.5, 1.5, 1.5, 50, 50, 20, 2.5, 1.3, 4]
THRUSTS = RNG.uniform(-30.0, 30.0, (200, 8))
CURRENTS = RNG.uniform(-0.5, 0.5, (200, 2))


def skew(x: np.ndarray) -> np.ndarray:
    """The matrix of the cross product with a vector."""
    return np.cross(np.eye(3), x)


def attitude(state: np.ndarray) -> Rotation:
    """The rotation from body axes to North-East-Down, of Euler angles."""
    return Rotation.from_euler("ZYX", state[..., [11, 10, 9]])


def fossen(
    nu: np.ndarray, to_earth: Rotation, thrusts: np.ndarray, current: np.ndarray
) -> np.ndarray:
    """Rates ``(9,)`` of the velocities through the water and of the position.

    M dv/dt + C(v) v + D(v) v + g(eta) = tau of Fossen (2011), eqs. 6.44, 8.24 and 4.6.
    """
    p1, p2 = np.split(INERTIA * nu, 2)
    coriolis = np.block([[np.zeros((3, 3)), -skew(p1)], [-skew(p1), -skew(p2)]])
    linear, quadratic = np.diag([13.7, 0, 33, 0, 0.8, 0]), np.diag([141, 217, 190, 1.19, 0.47, 1.5])
    to_body = to_earth.inv()
    weight = to_body.apply([0.0, 0.0, 13.5 * 9.82])
    lift = to_body.apply([0.0, 0.0, -(13.5 * 9.82 - 0.98)])
    restoring = np.concatenate([weight + lift, np.cross([0.0, 0.0, -0.01], lift)])
    tau = restoring - (coriolis + linear + quadratic * np.abs(nu)) @ nu
    for position, direction, thrust in zip(BODY.positions, BODY.directions, thrusts, strict=True):
        force = thrust * np.array(direction) / np.linalg.norm(direction)
        tau = tau + np.concatenate([force, np.cross(position, force)])
    return np.concatenate([tau / INERTIA, to_earth.apply(nu[:3]) + [*current, 0.0]])


def test_the_equations_are_those_of_fossen_in_matrices():
    states = with_quaternion(STATES)
    rates = rov_rates(states, THRUSTS @ BODY.allocation.T, CURRENTS, C)
    moving = [
        fossen(s[:6], attitude(s), *acting)
        for s, *acting in zip(STATES, THRUSTS, CURRENTS, strict=True)
    ]
    turning = [  # eqs. 2.57 and 2.58
        0.5 * np.vstack([-e[1:], e[0] * np.eye(3) + skew(e[1:])]) @ omega
        for e, omega in zip(states[:, 9:], STATES[:, 3:6], strict=True)
    ]
    np.testing.assert_allclose(rates, np.hstack([moving, turning]), rtol=1e-11, atol=1e-11)


def test_euler_angles_are_nearest_to_the_previous_ones():
    """At the pole, too, where roll and yaw are not determined alone."""
    states, near = STATES.copy(), STATES + RNG.normal(scale=0.3, size=STATES.shape)
    states[:20, 10] = np.pi / 2.0 * np.sign(states[:20, 10])
    states[20:40, 10] = np.nextafter(np.pi / 2.0, 0.0)
    near[:, [9, 11]] += 20.0
    found = with_euler_angles(with_quaternion(states), near)
    assert (attitude(found).inv() * attitude(states)).magnitude().max() < 1e-14
    assert np.abs(found[:, 10]).max() <= np.pi / 2.0 + 1e-15
    assert np.abs(found[:, [9, 11]] - near[:, [9, 11]]).max() <= np.pi + 1e-13
    np.testing.assert_array_equal(found[:, :9], states[:, :9])
    shown = with_euler_angles(
        with_quaternion(STATES), STATES
    )  # which turn by no more than a right angle in pitch
    np.testing.assert_allclose(shown, STATES, rtol=0, atol=1e-13)


def test_rov_energy_decreases_and_is_constant_undamped():
    def power(c: np.ndarray) -> np.ndarray:
        states = with_quaternion(STATES)
        rates = rov_rates(states, np.zeros(6), CURRENTS, c)
        righting = (
            4.0 * (states[:, 10:12] * rates[:, 10:12]).sum(-1) * C[19]
        )  # 2 (e1^2 + e2^2) is 1 - cos(heel)
        return (c[..., :6] * STATES[:, :6] * rates[:, :6]).sum(-1) - C[18] * rates[:, 8] + righting

    assert power(C).max() < 0.0
    c = ROV().parameters(0.3, RNG.normal(size=(200, len(UNCERTAIN))))
    assert (c[:, :6] > 0.0).all()
    assert power(c).max() < 0.0
    undamped = C.copy()
    undamped[6:18] = 0.0
    np.testing.assert_allclose(power(undamped), 0.0, atol=1e-10)


@pytest.fixture(scope="module")
def recipe(tmp_path_factory) -> str:
    """The environment of the recipe, whose module and study are imported and read as they stand."""
    folder = tmp_path_factory.mktemp("recipe")
    for name, kind in (("docking.py", "python docking"), ("study.toml", "toml")):
        (folder / name).write_text(blocks("recipes/rov", kind)[0], encoding="utf-8")
    sys.path.append(str(folder))  # to the end: a study looks for the module's file
    import_module("docking")
    read_study(folder / "study.toml")
    return "ROVDocking-v0"


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["truth", "ekf"])
def test_the_recipe_docks_on_a_consistent_filter(recipe: str, estimator: str):
    """On 60 other seeds all docked; the mean NEES of 20 was 1.02 ± 0.05, so the bounds lie six standard errors off."""
    flown = rollout("autopilot", recipe, range(16), {"estimator": estimator})
    figures = scores(flown)
    assert figures["docked"].mean() == 100.0
    assert estimator == "truth" or 0.85 < figures["nees"].mean() < 1.2
