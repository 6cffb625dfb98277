"""The ITSUNUSA: its equations are the Segorogeni's in the vertical plane; sensors and linear models."""

from dataclasses import replace

import numpy as np
import pytest
from sensing import UnevenWater, assumed, exogenous, sensors_of
from vehicle_cases import CASES

from vessel_gym.disturbances import Fault
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.itsunusa import Itsunusa, itsunusa_rates
from vessel_gym.vehicles.segorogeni import Segorogeni, segorogeni_rates

BODY = load("itsunusa")
C = BODY.vector()
VEHICLE = Itsunusa()
SENSORS = sensors_of(VEHICLE)
draw = CASES["itsunusa"].draw
STILL = np.zeros(1)  # no current
DEG = np.pi / 180.0
PLANE = np.array([0, 2, 4, 6, 8, 10])
"""Where the state lies in that of six degrees of freedom."""

SIX = replace(
    load("segorogeni"), length=2.0, diameter=0.30, fin_area=BODY.fin_area, fin_position=-1.0, z_g=BODY.z_g,
    buoyancy_excess=BODY.buoyancy_excess, axial_drag=BODY.axial_drag, propeller_torque=0.0,
)  # fmt: skip
"""The same body in six degrees of freedom."""


def in_space(states: np.ndarray) -> np.ndarray:
    """The same states in six degrees of freedom."""
    full = np.zeros(states.shape[:-1] + (12,))
    full[..., PLANE] = states
    return full


def northward(currents: np.ndarray) -> np.ndarray:
    """The same currents along the course, in two dimensions."""
    return np.pad(currents, ((0, 0), (0, 1)))


def rudder_centred(controls: np.ndarray) -> np.ndarray:
    """The same controls with a rudder."""
    return np.pad(controls, ((0, 0), (1, 0)))


# --- the equations --------------------------------------------------------------------------------


def test_the_vehicle_floats_up_by_its_excess_of_buoyancy():
    assert BODY.buoyancy / 9.81 == pytest.approx(96.6, abs=0.05)
    assert BODY.buoyancy - BODY.mass * 9.81 == pytest.approx(6.0)
    assert BODY.mass > 6.0 * 16.0 - 0.5  # the printed 16 kg are a sixth of what it displaces


@pytest.mark.parametrize("changes", [{}, {"z_g": 0.05, "fin_area": 0.02, "buoyancy_excess": -3.0}])
def test_planar_equations_are_six_dof_in_the_plane(changes):
    states, controls, currents = draw(np.random.default_rng(1), 200)
    c, full = replace(BODY, **changes).vector(), replace(SIX, **changes).vector()
    rates = segorogeni_rates(in_space(states), rudder_centred(controls), northward(currents), full)
    states[:, 5] = np.clip(states[:, 5], -1.5, 1.5)
    level = segorogeni_rates(in_space(states), rudder_centred(controls), northward(currents), full)
    own = itsunusa_rates(states, controls, currents, c)
    np.testing.assert_allclose(own, level[:, PLANE], rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(np.delete(rates, PLANE, axis=1), 0.0)  # it stays in the plane


def printed_equations(state: np.ndarray, control: np.ndarray) -> np.ndarray:
    """Accelerations by equations (1)-(3), misprints mended."""
    u, w, q, _, _, theta = state
    stern, thrust = control
    c, m, z_C = BODY.coefficients, BODY.mass, BODY.z_g
    W, B = m * 9.81, BODY.buoyancy
    right = np.array([
        -(W - B) * np.sin(theta) + c.X_uu * u * abs(u) + c.Z_wdot * w * q + c.Z_qdot * q * q + thrust - m * w * q,
        (W - B) * np.cos(theta) + c.Z_ww * w * abs(w) + c.Z_qq * q * abs(q) + (c.Z_uq - c.X_udot) * u * q
        + c.Z_uw * u * w + c.Z_uuds * u**2 * stern - m * (-u * q - z_C * q * q),
        -z_C * W * np.sin(theta) + c.M_ww * w * abs(w) + c.M_qq * q * abs(q) + (c.M_uq - c.Z_qdot) * u * q
        + (c.M_uw + c.X_udot - c.Z_wdot) * u * w + c.M_uuds * u**2 * stern - m * z_C * w * q,
    ])  # fmt: skip
    left = np.array([
        [m - c.X_udot, 0.0, m * z_C],
        [0.0, m - c.Z_wdot, -c.Z_qdot],
        [m * z_C, -c.M_wdot, BODY.pitch_inertia - c.M_qdot],
    ])  # fmt: skip
    return np.linalg.solve(left, right)


def test_going_ahead_the_equations_are_the_printed_ones():
    states, controls, currents = draw(np.random.default_rng(3), 200)
    states[:, 0] = np.abs(states[:, 0])
    printed = np.array([printed_equations(x, u) for x, u in zip(states, controls, strict=True)])
    rates = itsunusa_rates(states, controls, currents, C)
    np.testing.assert_allclose(rates[:, :3], printed, rtol=1e-10, atol=1e-11)


# --- the vehicle in an environment ----------------------------------------------------------------


WATER = UnevenWater(VEHICLE, (0.02, 0.015, 0.025), (0.12,))


def test_sensors_read_what_those_in_six_degrees_of_freedom_do():
    states, _, currents = draw(np.random.default_rng(8), 50)
    six = Segorogeni(SIX)
    full = sensors_of(six).exact(in_space(states), exogenous(six, northward(currents)))
    found = SENSORS.exact(states, exogenous(VEHICLE, currents))
    np.testing.assert_allclose(found, full[:, [0, 2, 3, 5, 8, 10]], rtol=0, atol=1e-13)


def test_linear_model_is_first_order_about_each_steady_dive():
    fault = Fault("stern plane", beside=WATER)
    bent, straight = (assumed(VEHICLE, kind, fault, SENSORS)[1] for kind in VEHICLE.kinds)
    trims = VEHICLE.linear("steady dives")
    x = np.hstack([trims.x, np.zeros((len(trims.x), 1))])
    angle = x[:, 5] - np.arctan2(x[:, 1], x[:, 0])
    np.testing.assert_allclose(angle, np.deg2rad(np.linspace(-45.0, 45.0, 91)), atol=1e-9)
    after = bent.transition(x, trims.u)
    np.testing.assert_allclose(after[:, [0, 1, 2, 5]], x[:, [0, 1, 2, 5]], atol=1e-9)  # steady
    for name in ("transition", "measurement"):
        (value, *slopes), (expected, *others) = (
            getattr(model, f"linearise_{name}")(x, trims.u) for model in (straight, bent)
        )
        np.testing.assert_allclose(value, expected, atol=1e-9)
        for slope, other in zip(slopes, others, strict=True):
            np.testing.assert_allclose(slope, np.broadcast_to(other, slope.shape), atol=1e-6)
    np.testing.assert_allclose(
        straight.input_matrix(x, trims.u), bent.input_matrix(x, trims.u), atol=1e-12
    )


@pytest.mark.parametrize("angle", [-0.5, -0.1, 0.004, 0.3])
def test_linear_model_follows_the_commanded_path_angle(angle: float):
    _, model = assumed(VEHICLE, "steady dives", WATER, SENSORS)
    trims, (x, u) = VEHICLE.linear("steady dives"), VEHICLE.cruise
    u = np.concatenate([u[:4], [angle, 1.0]])
    nearest = np.abs(trims.u[:, 4] - angle).argmin()
    expected = model.linearise_transition(np.zeros(7), trims.u[nearest])[1]
    np.testing.assert_array_equal(model.linearise_transition(np.append(x, 0.0), u)[1], expected)
