"""The Segorogeni: compiled equations against the printed ones, energy, trim, turns, the contract of a vehicle."""

from dataclasses import replace

import numpy as np
import pytest
from energies import DRAG, LIFT, energy, inertia, power
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import root
from scipy.spatial.transform import Rotation
from sensing import UnevenWater, assumed, exogenous, sensors_of, without_a_filter
from stepping import segorogeni_step
from vehicle_cases import CASES, WITH_REMUS

from estimators import wrap
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.segorogeni import (
    COEFFICIENTS,
    Segorogeni,
    SegorogeniParameters,
    printed_rates,
    segorogeni_rates,
)

BODY = load("segorogeni")
C = BODY.vector()
VEHICLE = Segorogeni()
SENSORS = sensors_of(VEHICLE)
STILL = np.zeros(2)  # no current
DEG = np.pi / 180.0
draw = CASES["segorogeni"].draw


# --- parameters -----------------------------------------------------------------------------------


def test_the_vehicle_floats_up_by_its_excess_of_buoyancy():
    assert BODY.mass == pytest.approx(18.49, abs=0.005)
    assert BODY.buoyancy - BODY.mass * 9.81 == pytest.approx(1.0)
    assert BODY.buoyancy - 15.0 * 9.81 == pytest.approx(35.0, abs=0.5)  # the printed mass


# --- the compiled equations -----------------------------------------------------------------------


def printed_equations(
    state: np.ndarray, control: np.ndarray, body: SegorogeniParameters
) -> np.ndarray:
    """Accelerations by equations (5)-(10) as they are printed: ``uv`` for lift, ``u^2`` for fins.

    But for the fins' lift in roll, which they leave out, and the rudder's angle, which is ours:
    positive to starboard.
    """
    u, v, w, p, q, r, _, _, _, phi, theta, _ = state
    rudder, stern, thrust = control
    c, m, z_G = body.coefficients, body.mass, body.z_g
    I_x, I_y = body.roll_inertia, body.pitch_inertia
    I_z = I_y
    W, B = m * 9.81, body.buoyancy
    X_wq, X_qq, X_vr, X_rr = c.Z_wdot, c.Z_qdot, -c.Y_vdot, -c.Y_rdot
    Y_ur, Y_wp, Y_pq, Y_uv = c.Y_ur + c.X_udot, -c.Z_wdot, -c.Z_qdot, c.Y_uv
    Z_uq, Z_vp, Z_rp, Z_uw = c.Z_uq - c.X_udot, c.Y_vdot, c.Y_rdot, c.Z_uw
    M_uq, M_vp, M_rp, M_uw = (
        c.M_uq - c.Z_qdot,
        -c.Y_rdot,
        c.K_pdot - c.N_rdot,
        c.M_uw + c.X_udot - c.Z_wdot,
    )
    N_ur, N_wp, N_pq, N_uv = (
        c.N_ur + c.Y_rdot,
        c.Z_qdot,
        c.M_qdot - c.K_pdot,
        c.N_uv + c.Y_vdot - c.X_udot,
    )
    X_res = -(W - B) * np.sin(theta)
    Y_res = (W - B) * np.cos(theta) * np.sin(phi)
    Z_res = (W - B) * np.cos(theta) * np.cos(phi)
    K_p = c.K_pp * abs(p) + c.K_up * u
    K_res, M_res = -z_G * W * np.cos(theta) * np.sin(phi), -z_G * W * np.sin(theta)
    K_prop = -body.propeller_torque * thrust
    right = np.array([
        X_res + c.X_uu * u * abs(u) + X_wq * w * q + X_qq * q * q + X_vr * v * r + X_rr * r * r + thrust
        - m * (-v * r + w * q + z_G * p * r),
        Y_res + c.Y_vv * v * abs(v) + c.Y_rr * r * abs(r) + Y_ur * u * r + Y_wp * w * p + Y_pq * p * q + Y_uv * u * v
        - c.Y_uudr * u**2 * rudder - m * (-w * p + u * r + z_G * q * r),
        Z_res + c.Z_ww * w * abs(w) + c.Z_qq * q * abs(q) + Z_uq * u * q + Z_vp * v * p + Z_rp * r * p + Z_uw * u * w
        + c.Z_uuds * u**2 * stern - m * (-u * q + v * p - z_G * (p * p + q * q)),
        K_res + K_p * p + K_prop - (I_z - I_y) * q * r + m * z_G * (-w * p + u * r),
        M_res + c.M_ww * w * abs(w) + c.M_qq * q * abs(q) + M_uq * u * q + M_vp * v * p + M_rp * r * p + M_uw * u * w
        + c.M_uuds * u**2 * stern - (I_x - I_z) * r * p - m * z_G * (-v * r + w * q),
        c.N_vv * v * abs(v) + c.N_rr * r * abs(r) + N_ur * u * r + N_wp * w * p + N_pq * p * q + N_uv * u * v
        - c.N_uudr * u**2 * rudder - (I_y - I_x) * p * q,
    ])  # fmt: skip
    S = m * z_G
    left = np.array([
        [m - c.X_udot, 0, 0, 0, S, 0],
        [0, m - c.Y_vdot, 0, -S, 0, -c.Y_rdot],
        [0, 0, m - c.Z_wdot, 0, -c.Z_qdot, 0],
        [0, -S, 0, I_x - c.K_pdot, 0, 0],
        [S, 0, -c.M_wdot, 0, I_y - c.M_qdot, 0],
        [0, -c.N_vdot, 0, 0, 0, I_z - c.N_rdot],
    ])  # fmt: skip
    return np.linalg.solve(left, right)


@pytest.mark.parametrize("body", [BODY, replace(BODY, z_g=0.05, propeller_torque=0.02), WITH_REMUS])
def test_going_ahead_the_compiled_equations_are_the_printed_ones(body):
    states, controls, currents = draw(np.random.default_rng(1), 200)
    states[:, 0] = np.abs(states[:, 0])
    printed = np.array(
        [printed_equations(x, u, body) for x, u in zip(states, controls, strict=True)]
    )
    compiled = segorogeni_rates(states, controls, currents, body.vector())
    np.testing.assert_allclose(compiled[:, :6], printed, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("c", [C, WITH_REMUS.vector()], ids=["own", "REMUS"])
def test_inertia_is_symmetric_positive_definite_and_inverted(c):
    M, values = inertia(c), dict(zip(COEFFICIENTS, c, strict=True))
    np.testing.assert_array_equal(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0.0
    pairs = [[(f"inverse_{a}{b}", f"inverse_{b}{a}") for b in "uvwpqr"] for a in "uvwpqr"]
    inverse = [[values.get(one, values.get(other, 0.0)) for one, other in row] for row in pairs]
    np.testing.assert_allclose(M @ inverse, np.eye(6), rtol=0, atol=1e-12)


# --- energy and currents --------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), size=st.floats(0.0, 1.5))
def test_in_still_water_without_thrust_energy_never_grows(seed, size):
    states = size * draw(np.random.default_rng(seed), 20)[0]
    gained = power(states, segorogeni_rates(states, np.zeros(3), STILL, C), C)
    assert (gained <= 1e-12 * (1.0 + np.abs(states[:, :6]).max(-1)) ** 3).all()


def test_without_drag_and_lift_energy_is_conserved():
    c = np.where(np.isin(COEFFICIENTS, DRAG + LIFT), 0.0, C)
    states, _, currents = draw(np.random.default_rng(3), 20)
    states[:, 9:11] *= 0.3  # clear of the pole
    states[:, :6] *= 0.2
    gained = power(states, segorogeni_rates(states, np.zeros(3), currents, c), c)
    np.testing.assert_allclose(gained, 0.0, atol=1e-12)
    after = segorogeni_step(states, np.zeros(6), currents, c, 10.0, 10_000)
    np.testing.assert_allclose(energy(after, c), energy(states, c), rtol=0, atol=1e-8)
    assert np.abs(after - states).max() > 1.0


def test_a_current_shifts_the_track_and_nothing_else():
    states, controls, currents = draw(np.random.default_rng(11), 20)
    drifted, straight = (
        segorogeni_step(states, np.tile(controls, 2), flow, C, 2.0, 40)
        for flow in (currents, 0.0 * currents)
    )
    shift = drifted[:, 6:8] - straight[:, 6:8]
    np.testing.assert_allclose(shift, 2.0 * currents, rtol=0, atol=1e-12)
    drifted[:, 6:8] = straight[:, 6:8]
    np.testing.assert_array_equal(drifted, straight)


# --- kinematics -----------------------------------------------------------------------------------


def attitude(state: np.ndarray) -> Rotation:
    """From body to earth axes."""
    return Rotation.from_euler("ZYX", state[..., [11, 10, 9]])


def test_position_rate_is_earth_velocity_plus_current():
    states, _, currents = draw(np.random.default_rng(7), 100)
    rates = segorogeni_rates(states, np.zeros(3), currents, C)
    moved = attitude(states).apply(states[:, :3]) + np.pad(currents, ((0, 0), (0, 1)))
    np.testing.assert_allclose(rates[:, 6:9], moved, rtol=0, atol=1e-12)


def test_euler_angles_turn_with_the_body():
    (states, *_), h = draw(np.random.default_rng(8), 100), 1e-5
    step = h * segorogeni_rates(states, np.zeros(3), STILL, C)
    before, after = (attitude(states + sign * step) for sign in (-1, 1))
    turned = (before.inv() * after).as_rotvec() / (2.0 * h)
    np.testing.assert_allclose(turned, states[:, 3:6], rtol=0, atol=1e-7)


def test_the_printed_kinematics_know_yaw_alone():
    states, _, currents = draw(np.random.default_rng(9), 50)
    rates, full = (of(states, np.zeros(3), currents, C) for of in (printed_rates, segorogeni_rates))
    level = states * ~np.isin(np.arange(12), [3, 4, 9, 10])  # no roll, no pitch
    printed = segorogeni_rates(level, np.zeros(3), currents, C)[:, 6:]
    np.testing.assert_allclose(rates[:, 6:], printed, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(rates[:, :6], full[:, :6])


@pytest.mark.parametrize(
    "theta", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, np.pi / 2 + 1e-9, 3 * np.pi / 2]
)
def test_nose_up_or_down_nothing_is_infinite(theta):
    states, _, currents = draw(np.random.default_rng(10), 50)
    states[:, 10] = theta
    rates = segorogeni_rates(states, np.zeros(3), currents, C)
    assert (np.abs(rates[:, 9:12]) < 500.0).all()
    for _ in range(100):
        states = VEHICLE.moved(states, *np.zeros((2, 3)), currents, C)
        assert np.isfinite(states).all()


# --- what the vehicle does ------------------------------------------------------------------------


def level_flight(speed: float) -> tuple[np.ndarray, np.ndarray]:
    """State ``(12,)`` and control ``(3,)`` of level flight straight ahead at a speed [m/s]."""

    def residual(z: np.ndarray) -> np.ndarray:
        return segorogeni_rates(*unpacked(z), STILL, C)[[0, 1, 2, 3, 4, 5, 8]]

    def unpacked(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        state = np.zeros(12)
        state[0], state[[1, 2, 9, 10]] = speed, z[:4]
        return state, z[4:]

    guess = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0 * speed**2])
    found = root(residual, guess, tol=1e-12)
    assert np.abs(found.fun).max() < 1e-10
    return unpacked(found.x)


@pytest.mark.parametrize("speed", [0.5, 1.0, 1.5])
def test_level_trim_is_stable_with_actuators_to_spare(speed):
    state, control = level_flight(speed)
    rudder, stern, thrust = control
    assert abs(stern) < 0.5 * BODY.fin_limit
    assert abs(rudder) < 1 * DEG
    assert abs(state[10]) < 8 * DEG
    assert 0.0 < thrust < 0.85 * BODY.thrust_limit
    moving, h = [0, 1, 2, 3, 4, 5, 9, 10], 1e-6  # position and heading do not act back
    offsets = h * np.eye(12)[moving]
    rates = [
        segorogeni_rates(state + sign * offsets, control, STILL, C)[:, moving] for sign in (1, -1)
    ]
    assert np.linalg.eigvals((rates[0] - rates[1]).T / (2.0 * h)).real.max() < -0.05


# --- the vehicle in an environment ----------------------------------------------------------------


def test_the_start_has_the_paper_s_rudder():
    _, actuators = VEHICLE.start(np.zeros((4, 12)))
    np.testing.assert_allclose(actuators, np.tile([5 * DEG, 0.0, BODY.cruise_thrust], (4, 1)))
    _, (_, _, thrust) = level_flight(1.0)
    assert BODY.cruise_thrust == pytest.approx(thrust, rel=0.1)


def test_sensors_read_velocity_over_ground_and_the_rest_as_it_is():
    states, _, currents = draw(np.random.default_rng(14), 50)
    drifting = attitude(states).inv().apply(np.pad(currents, ((0, 0), (0, 1))))
    plain = np.hstack([states[:, :3] + drifting, states[:, 8:12], states[:, 3:8]])
    incremented = np.hstack([np.ones((50, 6)), currents])  # increments act later and are not seen
    np.testing.assert_allclose(SENSORS.exact(states, incremented), plain, rtol=0, atol=1e-12)


def test_in_still_water_exact_measurements_give_back_the_state():
    states, *_ = draw(np.random.default_rng(15), 20)
    measurements = SENSORS.exact(states, exogenous(VEHICLE, np.zeros((20, 2))))
    known = SENSORS.states_from(measurements)
    found = np.stack([known[name] for name in VEHICLE.state_names], -1)
    np.testing.assert_array_equal(found, states)
    water = UnevenWater(VEHICLE, (0.02, 0.01, 0.015, 0.03, 0.025, 0.035), (0.10, 0.15))
    told = assumed(VEHICLE, "nonlinear", water, SENSORS)
    x, d = without_a_filter(told, VEHICLE.increments, measurements)
    off = x - np.pad(states, ((0, 0), (0, 2)))
    np.testing.assert_allclose(np.where(np.arange(14) < 9, off, wrap(off)), 0.0, atol=1e-14)
    np.testing.assert_array_equal(d, np.zeros((20, 6)))


# --- mismatch -------------------------------------------------------------------------------------


def test_mismatched_vehicle_is_axisymmetric_and_dissipative():
    rng = np.random.default_rng(18)
    c = VEHICLE.parameters(0.3, rng.normal(size=(200, VEHICLE.normals)))
    M = inertia(c)
    assert np.linalg.eigvalsh(M).min() > 0.0
    np.testing.assert_allclose(c[:, 1], c[:, 2])  # sway and heave
    np.testing.assert_allclose(c[:, 4], c[:, 5])  # pitch and yaw
    np.testing.assert_allclose(c[:, 7], -c[:, 8])
    states, _, currents = draw(rng, 200)
    rates = segorogeni_rates(states, np.zeros(3), currents, c)
    assert power(states, rates, c).max() < 0.0
    columns = [
        COEFFICIENTS.index(f"inverse_{pair}") for pair in ("uu", "vv", "ww", "pp", "qq", "rr")
    ]
    np.testing.assert_allclose(np.linalg.inv(M)[:, range(6), range(6)], c[:, columns], rtol=1e-10)
