"""The ITSUNUSA: its equations are the Segorogeni's in the vertical plane; trim, energy, the vehicle's contract."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from in_current import rates_of_truth, step_of_truth
from scipy.integrate import solve_ivp
from scipy.optimize import root

from vessel_gym.vehicles.auv import UNCERTAIN, VERTICAL
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.itsunusa import (
    COEFFICIENTS,
    TRUTH,
    Itsunusa,
    energy,
    inertia,
    itsunusa_rates,
    itsunusa_readings,
    itsunusa_step,
)
from vessel_gym.vehicles.segorogeni import (
    Segorogeni,
    segorogeni_rates,
    segorogeni_readings,
    segorogeni_step,
)
from vessel_gym.vehicles.segorogeni import energy as energy_in_space
from vessel_gym.vehicles.segorogeni import inertia as inertia_in_space

BODY = load("itsunusa")
C = BODY.vector()
VEHICLE = Itsunusa()
truth_rates, truth_step = rates_of_truth(itsunusa_rates, 6), step_of_truth(itsunusa_step, 6)
space_rates, space_step = rates_of_truth(segorogeni_rates, 12), step_of_truth(segorogeni_step, 12)
DEG = np.pi / 180.0
PLANE = np.array([0, 2, 4, 6, 8, 10, 12])
"""Where the state lies in that of six degrees of freedom."""
DRAG = ("X_uu", "Z_ww", "Z_qq", "M_ww", "M_qq")
LIFT = ("Z_uw", "Z_uq", "M_uw", "M_uq")

SIX = replace(
    load("segorogeni"), length=2.0, diameter=0.30, fin_area=BODY.fin_area, fin_position=-1.0, z_g=BODY.z_g,
    buoyancy_excess=BODY.buoyancy_excess, axial_drag=BODY.axial_drag, propeller_torque=0.0,
)  # fmt: skip
"""The same body in six degrees of freedom."""


def changed(c: np.ndarray, **values: float) -> np.ndarray:
    """Coefficients with some of them set, by name."""
    c = c.copy()
    for name, value in values.items():
        c[..., COEFFICIENTS.index(name)] = value
    return c


def random_states(rng: np.random.Generator, n: int) -> np.ndarray:
    """Truth states ``(n, 7)`` over all that the vehicle can meet, and more, ahead and astern."""
    high = np.array([3.0, 1.0, 1.0, 50.0, 20.0, 4.0, 0.5])
    return rng.uniform(-high, high, (n, 7))


def random_controls(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.uniform([-0.35, 0.0], [0.35, 40.0], (n, 2))


def in_space(states: np.ndarray) -> np.ndarray:
    """The same states in six degrees of freedom."""
    full = np.zeros(states.shape[:-1] + (14,))
    full[..., PLANE] = states
    return full


def rudder_centred(controls: np.ndarray) -> np.ndarray:
    """The same controls, ``(..., 2)`` or ``(..., 4)``, with a rudder."""
    pairs = controls.reshape(*controls.shape[:-1], -1, 2)
    return np.concatenate([np.zeros_like(pairs[..., :1]), pairs], -1).reshape(*controls.shape[:-1], -1)


# --- the equations ----------------------------------------------------------------------------------


def test_the_vehicle_floats_up_by_its_excess_of_buoyancy():
    assert BODY.buoyancy / 9.81 == pytest.approx(96.6, abs=0.05)
    assert BODY.buoyancy - BODY.mass * 9.81 == pytest.approx(6.0)
    assert BODY.mass > 6.0 * 16.0 - 0.5  # the printed 16 kg are a sixth of what it displaces


@pytest.mark.parametrize(("changes"), [{}, {"z_g": 0.05, "fin_area": 0.02, "buoyancy_excess": -3.0}])
def test_the_equations_are_those_of_six_degrees_of_freedom_in_the_vertical_plane(changes):
    rng = np.random.default_rng(1)
    states, controls = random_states(rng, 200), random_controls(rng, 200)
    c, full = replace(BODY, **changes).vector(), replace(SIX, **changes).vector()
    rates = space_rates(in_space(states), rudder_centred(controls), full)
    states[:, 5] = np.clip(states[:, 5], -1.5, 1.5)
    level = space_rates(in_space(states), rudder_centred(controls), full)
    np.testing.assert_allclose(truth_rates(states, controls, c), level[:, PLANE], rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(np.delete(rates, PLANE, axis=1), 0.0)  # it stays in the plane
    np.testing.assert_allclose(inertia(c), inertia_in_space(full)[np.ix_([0, 2, 4], [0, 2, 4])], rtol=1e-14)
    np.testing.assert_allclose(energy(states, c), energy_in_space(in_space(states), full), rtol=1e-12)


def test_a_step_is_that_of_six_degrees_of_freedom():
    rng = np.random.default_rng(2)
    states, controls = random_states(rng, 50), np.hstack([random_controls(rng, 50), random_controls(rng, 50)])
    states[:, 5] *= 0.2
    step = truth_step(states, controls, C, 0.1, 2)
    full = space_step(in_space(states), rudder_centred(controls), SIX.vector(), 0.1, 2)
    np.testing.assert_allclose(step, full[:, PLANE], rtol=1e-12, atol=1e-12)


def printed_equations(state: np.ndarray, control: np.ndarray) -> np.ndarray:
    """Accelerations by equations (1)-(3), misprints mended."""
    u, w, q, _, _, theta, _ = state
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
    rng = np.random.default_rng(3)
    states, controls = random_states(rng, 200), random_controls(rng, 200)
    states[:, 0] = np.abs(states[:, 0])
    printed = np.array([printed_equations(x, u) for x, u in zip(states, controls, strict=True)])
    np.testing.assert_allclose(truth_rates(states, controls, C)[:, :3], printed, rtol=1e-10, atol=1e-11)


def power(state: np.ndarray, rates: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Rate of change of `energy`, by the chain rule."""
    values = dict(zip(COEFFICIENTS, np.moveaxis(c, -1, 0), strict=True))
    kinetic = np.vecdot(state[..., :3], np.matvec(inertia(c), rates[..., :3]))
    tilt = np.sin(state[..., 5]) * rates[..., 5]
    return kinetic - values["net_weight"] * rates[..., 4] + values["righting_moment"] * tilt


@given(st.lists(st.floats(-1.0, 1.0, allow_subnormal=False), min_size=4, max_size=4))
def test_in_still_water_without_thrust_energy_never_grows(numbers):
    state = np.zeros(7)
    state[[0, 1, 2, 5]] = np.array(numbers) * [4.0, 2.0, 3.0, 2.0 * np.pi]
    gained = power(state, truth_rates(state, np.zeros(2), C), C)
    assert gained <= 1e-11 * (1.0 + np.abs(state[:3]).max()) ** 3


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_energy_never_grows_along_a_track(seed):
    state = random_states(np.random.default_rng(seed), 8)
    state[:, 6] = 0.0
    for _ in range(200):
        after = truth_step(state, np.zeros(4), C, 0.05, 4)
        assert (energy(after, C) <= energy(state, C) + 1e-7).all()
        state = after


def test_without_drag_and_lift_energy_is_conserved():
    c = changed(C, **dict.fromkeys(DRAG + LIFT, 0.0))
    state = random_states(np.random.default_rng(4), 20)
    state[:, 6] = 0.0
    after = truth_step(state, np.zeros(4), c, 10.0, 10_000)
    np.testing.assert_allclose(energy(after, c), energy(state, c), rtol=1e-10)
    assert np.abs(after - state).max() > 1.0


def test_the_inertia_is_symmetric_positive_definite_and_inverted_once():
    M = inertia(C)
    np.testing.assert_array_equal(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0.0
    values = dict(zip(COEFFICIENTS, C, strict=True))
    inverse = [[values.get(f"inverse_{a}{b}", values.get(f"inverse_{b}{a}")) for b in "uwq"] for a in "uwq"]
    np.testing.assert_allclose(M @ inverse, np.eye(3), rtol=0, atol=1e-12)


def test_a_batch_is_a_loop_and_inputs_stay():
    rng = np.random.default_rng(5)
    states, controls = random_states(rng, 12).reshape(3, 4, 7), random_controls(rng, 12).reshape(3, 4, 2)
    c = VEHICLE.parameters(0.2, rng.normal(size=(4, VEHICLE.normals)))  # one vehicle a column
    moving = np.concatenate([controls, 0.9 * controls], -1)
    copies = [a.copy() for a in (states, controls, moving, c)]
    rates, after = truth_rates(states, controls, c), truth_step(states, moving, c, 0.1, 2)
    for i, j in np.ndindex(3, 4):
        np.testing.assert_array_equal(rates[i, j], truth_rates(states[i, j], controls[i, j], c[j]))
        np.testing.assert_array_equal(after[i, j], truth_step(states[i, j], moving[i, j], c[j], 0.1, 2))
    for a, b in zip((states, controls, moving, c), copies, strict=True):
        np.testing.assert_array_equal(a, b)


# --- the step ---------------------------------------------------------------------------------------


DIVE = np.array([1.5, 0.05, -0.1, 3.0, 2.0, -0.3, 0.2])
HARD = np.array([-0.2, 10.0, -0.1, 20.0])


def test_a_step_is_the_solution_of_the_equations():
    solution = solve_ivp(
        lambda t, s: truth_rates(s, HARD[:2] + (HARD[2:] - HARD[:2]) * t / 0.1, C),
        (0.0, 0.1), DIVE, method="DOP853", rtol=1e-13, atol=1e-13,
    )  # fmt: skip
    np.testing.assert_allclose(truth_step(DIVE, HARD, C, 0.1, 2), solution.y[:, -1], rtol=0, atol=2e-6)
    np.testing.assert_allclose(truth_step(DIVE, HARD, C, 0.1, 64), solution.y[:, -1], rtol=0, atol=1e-9)


def test_two_substeps_are_converged_over_a_dive():
    coarse = fine = np.array(DIVE)
    for k in range(150):
        control = np.array([0.3, 30.0, 0.35, 30.0]) * (1.0 if k < 40 else -0.4 if k < 80 else 0.1)
        coarse, fine = truth_step(coarse, control, C, 0.1, 2), truth_step(fine, control, C, 0.1, 20)
        np.testing.assert_allclose(coarse, fine, rtol=0, atol=2e-5)


def test_a_current_shifts_the_track_and_nothing_else():
    states = random_states(np.random.default_rng(6), 20)
    still = states.copy()
    still[:, 6] = 0.0
    drifted, straight = (truth_step(x, HARD, C, 2.0, 40) for x in (states, still))
    np.testing.assert_allclose(drifted[:, 3] - straight[:, 3], 2.0 * states[:, 6], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(drifted[:, [0, 1, 2, 4, 5]], straight[:, [0, 1, 2, 4, 5]])


# --- what the vehicle does --------------------------------------------------------------------------


def level_flight(speed: float) -> tuple[np.ndarray, np.ndarray]:
    """State ``(7,)`` and control ``(2,)`` of level flight at a speed [m/s]."""

    def unpacked(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([speed, z[0], 0.0, 0.0, 0.0, z[1], 0.0]), z[2:]

    def residual(z: np.ndarray) -> np.ndarray:
        return truth_rates(*unpacked(z), C)[[0, 1, 2, 4]]

    found = root(residual, np.array([0.0, 0.0, 0.0, 7.0 * speed**2]), tol=1e-12)
    assert np.abs(found.fun).max() < 1e-10
    return unpacked(found.x)


@pytest.mark.parametrize("speed", [0.75, 1.0, 1.5, 2.0])
def test_the_vehicle_trims_level_and_stable_with_fins_and_thrust_to_spare(speed):
    state, control = level_flight(speed)
    assert abs(control[0]) < 0.25 * BODY.fin_limit
    assert abs(state[5]) < 6 * DEG
    assert 0.0 < control[1] < 0.8 * BODY.thrust_limit
    moving, h = [0, 1, 2, 5], 1e-6
    offsets = h * np.eye(7)[moving]
    rates = [truth_rates(state + sign * offsets, control, C)[:, moving] for sign in (1, -1)]
    assert np.linalg.eigvals((rates[0] - rates[1]).T / (2.0 * h)).real.max() < -0.05


def test_positive_stern_plane_dives_and_thrust_drives():
    state, control = level_flight(1.5)
    dived = truth_step(state, np.tile(control + [2 * DEG, 0.0], 2), C, 5.0, 100)
    assert dived[5] < state[5] - 2 * DEG
    assert dived[4] > 0.1
    assert truth_rates(state, control + [0.0, 1.0], C)[0] > 0.0
    assert truth_step(np.zeros(7), np.zeros(4), C, 60.0, 1200)[4] < -1.0  # it comes up by itself


def test_all_thrust_makes_two_metres_a_second():
    state, _ = level_flight(1.5)
    fast = truth_step(state, np.array([0.0, BODY.thrust_limit, 0.0, BODY.thrust_limit]), C, 60.0, 1200)
    assert fast[0] > 2.0


# --- the vehicle in an environment ------------------------------------------------------------------


SEA = SimpleNamespace(kick_sd=np.array([0.02, 0.015, 0.025, 0.004]))


def test_names_and_sizes_agree():
    channels = [channel for instrument in VEHICLE.instruments for channel in instrument.channels]
    assert channels == ["u over ground", "w over ground", "z", "theta", "q", "x"]
    truth, actuators = VEHICLE.start(np.ones((4, 7)))
    assert truth.shape == (4, len(VEHICLE.truth_names)) == (4, len(TRUTH))
    assert VEHICLE.readings(truth, np.zeros((4, 4))).shape == (4, 6)
    np.testing.assert_array_equal(actuators, np.tile([0.0, BODY.cruise_thrust], (4, 1)))
    np.testing.assert_array_equal(VEHICLE.filter_state(truth, 6), truth[:, :6])
    _, (_, thrust) = level_flight(1.5)
    assert BODY.cruise_thrust == pytest.approx(thrust, rel=0.02)


def test_actuators_keep_their_limits_rates_and_lag():
    actuators = np.array([[0.05, 2.0]])
    for k in range(1, 8):
        actuators = VEHICLE.actuate(actuators, np.array([[1.0, 1.0]]))
        decay = np.exp(-0.1 * k / BODY.thrust_lag)
        expected = [min(0.05 + 0.1 * k, 20 * DEG), BODY.thrust_limit - (BODY.thrust_limit - 2.0) * decay]
        np.testing.assert_allclose(actuators[0], expected, rtol=1e-12)
    np.testing.assert_allclose(VEHICLE.actuate(actuators, np.array([[-1.0, 0.0]]))[0, 0], 20 * DEG - 0.1, rtol=1e-12)


def test_a_step_of_the_vehicle_is_kicked_at_its_end():
    rng = np.random.default_rng(7)
    states, before, after = random_states(rng, 6), random_controls(rng, 6), random_controls(rng, 6)
    forcing, c = rng.normal(size=(6, 4)) * 0.1, VEHICLE.parameters(0.0, np.zeros((6, VEHICLE.normals)))
    stepped = VEHICLE.step(states, before, after, forcing, c)
    plain = truth_step(states, np.hstack([before, after]), C, 0.1, 2)
    np.testing.assert_allclose(stepped[:, :3], plain[:, :3] + forcing[:, :3], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(stepped[:, 3:6], plain[:, 3:6])
    np.testing.assert_allclose(stepped[:, 6], np.exp(-0.1 / 200.0) * states[:, 6] + forcing[:, 3], rtol=0, atol=1e-15)


def test_instruments_read_what_those_in_six_degrees_of_freedom_do():
    states = random_states(np.random.default_rng(8), 50)
    full = segorogeni_readings(in_space(states), np.empty(12))
    expected = full[:, [0, 2, 3, 5, 8, 10]]
    np.testing.assert_allclose(VEHICLE.readings(states, np.zeros((50, 4))), expected, rtol=0, atol=1e-13)


def test_in_still_water_exact_readings_give_back_the_state():
    states = random_states(np.random.default_rng(9), 20)
    states[:, 6] = 0.0
    x, d = VEHICLE.from_readings(VEHICLE.readings(states, np.zeros((20, 4))), np.zeros((20, 6)), np.ones((20, 6)))
    np.testing.assert_allclose(x, states, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(d, np.zeros((20, 4)))


def test_the_filter_s_model_is_the_vehicle_when_nothing_kicks():
    rng = np.random.default_rng(10)
    model = VEHICLE.model("nonlinear", 2.0, SEA)
    ensemble, before, after = random_states(rng, 30).reshape(3, 10, 7), random_controls(rng, 3), random_controls(rng, 3)
    predicted = model.transition(ensemble, np.hstack([before, after])[:, None])
    c = VEHICLE.parameters(0.0, np.zeros((10, VEHICLE.normals)))
    for i in range(3):
        rows = [np.tile(control[i], (10, 1)) for control in (before, after)]
        np.testing.assert_array_equal(predicted[i], VEHICLE.step(ensemble[i], *rows, np.zeros((10, 4)), c))
    np.testing.assert_array_equal(model.measurement(ensemble, None), itsunusa_readings(ensemble, np.empty(6)))
    np.testing.assert_allclose(model.R, np.diag((2.0 * np.array([0.01, 0.01, 0.02, 0.01, 0.005, 0.5])) ** 2))
    np.testing.assert_allclose(model.Q, np.diag(np.array([0.02, 0.015, 0.025, 0.0, 0.0, 0.0, 0.004]) ** 2))
    assert (model.state_angles, model.measurement_angles) == ((5,), (3,))
    with pytest.raises(ValueError, match="unknown filter model 'linear'"):
        VEHICLE.model("linear", 1.0, SEA)


def test_mismatch_is_that_of_six_degrees_of_freedom():
    normals = np.random.default_rng(11).normal(size=(100, len(UNCERTAIN)))
    c = VEHICLE.parameters(0.3, normals[:, :VERTICAL])
    full = Segorogeni(SIX).parameters(0.3, normals)
    rng = np.random.default_rng(12)
    states, controls = random_states(rng, 100), random_controls(rng, 100)
    states[:, 5] *= 0.3
    rates = truth_rates(states, controls, c)
    expected = space_rates(in_space(states), rudder_centred(controls), full)
    np.testing.assert_allclose(rates, expected[:, PLANE], rtol=1e-11, atol=1e-12)
    assert np.linalg.eigvalsh(inertia(c)).min() > 0.0
    assert power(states, truth_rates(states, np.zeros(2), c), c).max() < 0.0
    np.testing.assert_array_equal(VEHICLE.parameters(0.0, normals[:3, :VERTICAL]), np.tile(C, (3, 1)))
