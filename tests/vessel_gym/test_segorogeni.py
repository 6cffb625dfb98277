"""The Segorogeni: compiled equations against the printed ones, energy, trim, turns, the contract of a vehicle."""

from dataclasses import replace

import numpy as np
import pytest
from energies import DRAG, LIFT, inertia
from scipy.optimize import root
from scipy.spatial.transform import Rotation
from sensing import sensors_of
from stepping import segorogeni_step
from vehicle_cases import AUVS, WITH_REMUS

from vessel_gym.vehicles.auv import UNCERTAIN
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.segorogeni import (
    COEFFICIENTS,
    Segorogeni,
    SegorogeniParameters,
    segorogeni_rates,
)

BODY = load("segorogeni")
C = BODY.vector()
VEHICLE = Segorogeni()
SENSORS = sensors_of(VEHICLE)
AUV = AUVS["segorogeni"]
STILL = np.zeros(2)  # no current
DEG = np.pi / 180.0


def random_states(rng: np.random.Generator, n: int) -> np.ndarray:
    """States ``(n, 12)`` over all that the vehicle can meet, and more, ahead and astern."""
    high = np.array([2.0, 1.0, 1.0, 2.0, 1.5, 1.5, 50.0, 50.0, 20.0, 2.0, 1.3, 4.0])
    return rng.uniform(-high, high, (n, 12))


def random_currents(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.uniform(-0.5, 0.5, (n, 2))


def random_controls(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.uniform([-0.35, -0.35, 0.0], [0.35, 0.35, 8.0], (n, 3))


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
    K_p = c.K_pp * abs(p) + body.roll_lift * u
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
    rng = np.random.default_rng(1)
    states, controls = random_states(rng, 200), random_controls(rng, 200)
    states[:, 0] = np.abs(states[:, 0])
    printed = np.array(
        [printed_equations(x, u, body) for x, u in zip(states, controls, strict=True)]
    )
    compiled = segorogeni_rates(states, controls, random_currents(rng, 200), body.vector())
    np.testing.assert_allclose(compiled[:, :6], printed, rtol=1e-10, atol=1e-11)


def test_the_printed_lift_gives_energy_to_a_vehicle_going_astern():
    rng = np.random.default_rng(2)
    states = random_states(rng, 300)
    states[:, 0] = -np.abs(states[:, 0])
    rates = segorogeni_rates(states, np.zeros(3), random_currents(rng, 300), C)
    assert AUV.power(states, rates, C).max() < 0.0
    rates[:, :6] = [printed_equations(x, np.zeros(3), BODY) for x in states]
    assert AUV.power(states, rates, C).max() > 0.1


# --- kinematics -----------------------------------------------------------------------------------


def attitude(state: np.ndarray) -> Rotation:
    """From body to earth axes."""
    return Rotation.from_euler("ZYX", state[..., [11, 10, 9]])


def test_position_rate_is_earth_velocity_plus_current():
    rng = np.random.default_rng(7)
    states, currents = random_states(rng, 100), random_currents(rng, 100)
    rates = segorogeni_rates(states, np.zeros(3), currents, C)
    moved = attitude(states).apply(states[:, :3])
    moved[:, :2] += currents
    np.testing.assert_allclose(rates[:, 6:9], moved, rtol=0, atol=1e-12)


def test_euler_angles_turn_with_the_body():
    states, h = random_states(np.random.default_rng(8), 100), 1e-5
    rates = segorogeni_rates(states, np.zeros(3), STILL, C)
    before, after = states.copy(), states.copy()
    before[:, 9:12] -= h * rates[:, 9:12]
    after[:, 9:12] += h * rates[:, 9:12]
    turned = (attitude(before).inv() * attitude(after)).as_rotvec() / (2.0 * h)
    np.testing.assert_allclose(turned, states[:, 3:6], rtol=0, atol=1e-7)


def test_the_printed_kinematics_know_yaw_alone():
    rng = np.random.default_rng(9)
    states, currents = random_states(rng, 50), random_currents(rng, 50)
    c = replace(BODY, printed_kinematics=True).vector()
    rates, full = (segorogeni_rates(states, np.zeros(3), currents, values) for values in (c, C))
    u, v, w, psi = states[:, 0], states[:, 1], states[:, 2], states[:, 11]
    north, east = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    zero = np.zeros(50)
    printed = np.stack(
        [north + currents[:, 0], east + currents[:, 1], w, zero, zero, states[:, 5]], -1
    )
    np.testing.assert_allclose(rates[:, 6:], printed, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(rates[:, :6], full[:, :6])
    level = states.copy()
    level[:, [2, 3, 4, 9, 10]] = 0.0  # upright in the horizontal plane they are right
    rates, full = (segorogeni_rates(level, np.zeros(3), currents, values) for values in (c, C))
    np.testing.assert_allclose(rates[:, 6:], full[:, 6:], rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    "theta", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, np.pi / 2 + 1e-9, 3 * np.pi / 2]
)
def test_nose_up_or_down_nothing_is_infinite(theta):
    rng = np.random.default_rng(10)
    states, currents = random_states(rng, 50), random_currents(rng, 50)
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
def test_the_vehicle_trims_level_with_fins_and_thrust_to_spare(speed):
    state, (rudder, stern, thrust) = level_flight(speed)
    assert abs(stern) < 0.5 * BODY.fin_limit
    assert abs(rudder) < 1 * DEG
    assert abs(state[10]) < 8 * DEG
    assert 0.0 < thrust < 0.85 * BODY.thrust_limit


@pytest.mark.parametrize("speed", [0.5, 1.0, 1.5])
def test_level_flight_is_stable(speed):
    state, control = level_flight(speed)
    moving = [0, 1, 2, 3, 4, 5, 9, 10]  # position and heading do not act back
    h = 1e-6
    offsets = h * np.eye(12)[moving]
    rates = [
        segorogeni_rates(state + sign * offsets, control, STILL, C)[:, moving] for sign in (1, -1)
    ]
    A = ((rates[0] - rates[1]) / (2.0 * h)).T
    assert np.linalg.eigvals(A).real.max() < -0.05


def steady_turn(rudder: float) -> np.ndarray:
    """The state after a minute of rudder from level flight at 1 m/s."""
    state, control = level_flight(1.0)
    control[0] = rudder
    return segorogeni_step(state, np.tile(control, 2), STILL, C, 60.0, 1200)


@pytest.mark.parametrize(("rudder", "radius"), [(5.0, 4.7), (20.0, 1.5)])
def test_the_vehicle_turns_as_tightly_as_the_course_asks(rudder, radius):
    turn = steady_turn(rudder * DEG)
    assert np.hypot(turn[0], turn[1]) / turn[5] == pytest.approx(radius, rel=0.06)
    assert turn[1] < 0.0  # drifting outwards


# --- the vehicle in an environment ----------------------------------------------------------------


def test_the_start_has_the_paper_s_rudder():
    _, actuators = VEHICLE.start(np.zeros((4, 12)))
    np.testing.assert_allclose(actuators, np.tile([5 * DEG, 0.0, BODY.cruise_thrust], (4, 1)))
    _, (_, _, thrust) = level_flight(1.0)
    assert BODY.cruise_thrust == pytest.approx(thrust, rel=0.1)


def test_sensors_read_velocity_over_ground_and_the_rest_as_it_is():
    rng = np.random.default_rng(14)
    states, currents = random_states(rng, 50), random_currents(rng, 50)
    over_ground = states[:, :3] + attitude(states).inv().apply(
        np.hstack([currents, np.zeros((50, 1))])
    )
    plain = np.hstack([over_ground, states[:, 8:12], states[:, 3:8]])
    incremented = np.hstack(
        [rng.normal(size=(50, 6)), currents]
    )  # increments act later and are not seen
    np.testing.assert_allclose(SENSORS.exact(states, incremented), plain, rtol=0, atol=1e-12)


# --- mismatch -------------------------------------------------------------------------------------


def test_mismatch_scales_what_is_uncertain_and_nothing_else():
    index = {name: i for i, name in enumerate(COEFFICIENTS)}
    for i, kind in enumerate(UNCERTAIN):
        normals = np.zeros((2, VEHICLE.normals))
        normals[:, i] = [1.0, 5.0]  # clipped at 2
        ratio = np.ones((2, len(COEFFICIENTS)))
        np.divide(VEHICLE.parameters(0.1, normals), C, out=ratio, where=C != 0.0)
        for name in ("mass_z_g", "net_weight", "righting_moment", "propeller_torque"):
            np.testing.assert_array_equal(ratio[:, index[name]], 1.0)
        scaled = {
            name for name, j in index.items() if not np.allclose(ratio[:, j], 1.0, rtol=1e-12)
        }
        simple = {"axial drag": {"X_uu"}, "roll drag": {"K_pp"}, "rudder": {"Y_rudder", "N_rudder"},
                  "stern planes": {"Z_uuds", "M_uuds"}, "lift": set(LIFT),
                  "cross-flow drag": set(DRAG) - {"X_uu", "K_pp"}}  # fmt: skip
        if kind in simple:
            assert scaled <= simple[kind]
            assert scaled
            for name in scaled:
                np.testing.assert_allclose(ratio[:, index[name]], [1.1, 1.2], rtol=1e-12)
        else:
            assert scaled & {
                "surge_mass",
                "sway_mass",
                "heave_mass",
                "roll_inertia",
                "pitch_inertia",
                "yaw_inertia",
            }
            assert not scaled & set(DRAG + LIFT)


def test_mismatched_vehicle_is_axisymmetric_and_dissipative():
    rng = np.random.default_rng(18)
    c = VEHICLE.parameters(0.3, rng.normal(size=(200, VEHICLE.normals)))
    M = inertia(c)
    assert np.linalg.eigvalsh(M).min() > 0.0
    np.testing.assert_allclose(c[:, 1], c[:, 2])  # sway and heave
    np.testing.assert_allclose(c[:, 4], c[:, 5])  # pitch and yaw
    np.testing.assert_allclose(c[:, 7], -c[:, 8])
    states = random_states(rng, 200)
    rates = segorogeni_rates(states, np.zeros(3), random_currents(rng, 200), c)
    assert AUV.power(states, rates, c).max() < 0.0
    columns = [
        COEFFICIENTS.index(f"inverse_{pair}") for pair in ("uu", "vv", "ww", "pp", "qq", "rr")
    ]
    np.testing.assert_allclose(np.linalg.inv(M)[:, range(6), range(6)], c[:, columns], rtol=1e-10)
