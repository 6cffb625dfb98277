"""Laws of every vehicle: equations and steps of a batch, the order of the step, increments, mismatch."""

import re
from typing import Any

import numpy as np
import pytest
from sensing import exogenous, sensors_of
from vehicle_cases import CASES, Case

from vessel_gym.vehicles.corvette_thesis import ThesisCorvette
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.puna import Puna
from vessel_gym.vehicles.rov import ROV
from vessel_gym.vehicles.segorogeni import Segorogeni

each_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


@each_case
def test_a_batch_is_a_loop_and_inputs_stay(case: Case):
    rng, vehicle = np.random.default_rng(6), case.vehicle
    states, actuators, flows = case.draw(rng, 3, 4)
    c = vehicle.parameters(0.2, rng.normal(size=(4, vehicle.normals)))  # one vehicle a column
    moving, sensors = np.concatenate([actuators, 0.9 * actuators], -1), sensors_of(vehicle)
    biases = rng.normal(size=(3, 4, len(sensors.bias.start_cov)))
    given = states, actuators, moving, flows, c, biases
    copies = [a.copy() for a in given]
    rates, after = (
        vehicle.equations(states, actuators, flows, c),
        case.step(states, moving, flows, c, vehicle.dt, 2),
    )
    measured = sensors.exact(states, exogenous(vehicle, flows), biases)
    for i, j in np.ndindex(3, 4):
        alone = states[i, j], flows[i, j], c[j]
        np.testing.assert_array_equal(
            rates[i, j], vehicle.equations(alone[0], actuators[i, j], *alone[1:])
        )
        np.testing.assert_array_equal(
            after[i, j], case.step(alone[0], moving[i, j], *alone[1:], vehicle.dt, 2)
        )
        own = sensors.exact(alone[0], exogenous(vehicle, alone[1]), biases[i, j])
        np.testing.assert_array_equal(measured[i, j], own)
    for a, b in zip(given, copies, strict=True):
        np.testing.assert_array_equal(a, b)


@each_case
def test_a_step_is_the_solution_of_the_equations(case: Case):
    dt, parts = case.vehicle.dt, case.vehicle.substeps
    exact = case.exact(case.nominal, dt)
    for factor, error in zip((1, 32), case.errors, strict=True):
        np.testing.assert_allclose(
            case.hard_step(case.nominal, dt, factor * parts), exact, rtol=0, atol=error
        )


@each_case
def test_a_step_of_the_vehicle_gets_its_increments_at_its_end(case: Case):
    rng, vehicle = np.random.default_rng(13), case.vehicle
    states, before, flows = case.draw(rng, 6)
    after, increments = case.draw(rng, 6)[1], rng.normal(size=(6, len(vehicle.increments))) * 0.01
    stepped = vehicle.step(
        states, before, after, np.hstack([increments, flows]), np.tile(case.nominal, (6, 1))
    )
    plain = case.step(
        states, np.hstack([before, after]), flows, case.nominal, vehicle.dt, vehicle.substeps
    )
    incremented = [vehicle.state_names.index(name) for name in vehicle.incremented]
    others = np.delete(np.arange(len(vehicle.state_names)), incremented)
    np.testing.assert_allclose(
        stepped[:, incremented], plain[:, incremented] + increments, rtol=0, atol=1e-14
    )
    np.testing.assert_array_equal(stepped[:, others], plain[:, others])


AUV_BODY = {"mass_z_g", "net_weight", "righting_moment", "propeller_torque"}
GEOMETRY = {
    "segorogeni": AUV_BODY, "itsunusa": AUV_BODY,
    "puna": {"area", "gravity", "density_2", "density_1", "density_0"},
}  # fmt: skip
SHIP = {
    "Yv", "Yr", "Nv", "Nr", "cross_flow", "resistance", "rudder", "straightening", "sway_inertia", "yaw_inertia",
}  # fmt: skip
"""All that mismatch leaves alone, and all that it scales of a ship."""
NONLINEAR = re.compile("mass|inertia|inverse|sway_yaw|heave_pitch")
"""Coefficients in which a body's inertia is added to that of the water."""


@pytest.mark.parametrize("name", CASES)
def test_mismatch_scales_hydrodynamics_by_its_clipped_normals(name: str):
    case = CASES[name]
    vehicle, names = case.vehicle, np.array(case.vehicle.parameter_names)
    scaled: set[str] = set()
    for normal in np.eye(vehicle.normals):
        drawn = vehicle.parameters(0.1, normal * [[0.0], [1.0], [2.0], [9.0], [-9.0]])
        np.testing.assert_array_equal(drawn[0], case.nominal)
        np.testing.assert_array_equal(drawn[2], drawn[3])
        changed = drawn[1] != case.nominal
        assert changed.any()
        scaled |= set(names[changed])
        linear = changed & [not NONLINEAR.search(name) for name in names]
        ratio = drawn[:, linear] / case.nominal[linear]
        expected = np.array([[1.0], [1.1], [1.2], [1.2], [0.8]])
        np.testing.assert_allclose(ratio, np.broadcast_to(expected, ratio.shape), rtol=1e-12)
    known = GEOMETRY.get(name)
    assert scaled == (SHIP if known is None else {*names} - known)


AUV, WING, DEG = CASES["segorogeni"].vehicle.body, CASES["puna"].vehicle.body, np.pi / 180.0
RUDDER, FIN = (
    (35 * DEG, -35 * DEG, 5 * DEG, 0.0),
    (AUV.fin_limit, -AUV.fin_limit, AUV.fin_rate, 0.0),
)
ACTUATORS: list[tuple[Any, list[tuple[float, float, float, float]]]] = [
    (CASES["corvette"].vehicle, [RUDDER]), (ThesisCorvette(load("corvette-thesis"), 0.5), [RUDDER]),
    (Segorogeni(), [FIN, FIN, (AUV.thrust_limit, 0.0, np.inf, AUV.thrust_lag)]),
    (Puna(), [(16.0, 0.0, np.inf, WING.thrust_lag), (12 * DEG, -4 * DEG, 0.5, 0.0), (35 * DEG, -35 * DEG, np.inf, 0.0)
    ]),
    (ROV(), [(30.4, -30.4, np.inf, 0.1)] * 8),
]  # fmt: skip
"""Where the actions 1 and -1 lead, the rate [1/s] and the lag [s]."""


@pytest.mark.parametrize(("vehicle", "expected"), ACTUATORS, ids=lambda x: type(x).__name__)
@pytest.mark.parametrize("side", [0, 1], ids=["up", "down"])
def test_actuators_keep_their_rates_lags_and_limits(vehicle: Any, expected: Any, side: int):
    goal, rate, lag = np.array(expected)[:, [side, 2, 3]].T
    start = 0.1 * np.array(expected)[:, 0]
    actuators = start[None]
    for k in range(1, 200):
        actuators = vehicle.actuate(actuators, np.full_like(actuators, 1.0 - 2.0 * side))
        time = k * vehicle.dt
        turned = np.clip(goal - start, -rate * time, rate * time)
        left = (start - goal) * np.exp(-time / np.where(lag > 0.0, lag, 1e-9))
        moved = np.where(lag > 0.0, goal + left, start + turned)
        np.testing.assert_allclose(actuators[0], moved, rtol=1e-12, atol=1e-12)


ODD = {
    "y", "psi", "v", "r", "phi", "p", "east", "rudder", "rudder rate", "bank", "wind east", "current east",
    "sway force", "yaw moment", "roll moment", "wave sway",
}  # fmt: skip
"""What changes its sign in the mirror."""


@each_case
def test_port_mirrors_starboard(case: Case):
    """But for the torque of a propeller."""
    vehicle = case.vehicle
    names = vehicle.state_names, vehicle.action_names, vehicle.ambient_flows
    signs = [np.where(np.isin(each, list(ODD)), -1.0, 1.0) for each in names]
    given = case.draw(np.random.default_rng(3), 200)
    c = np.where(np.isin(vehicle.parameter_names, "propeller_torque"), 0.0, case.nominal)
    mirrored = vehicle.equations(*(x * sign for x, sign in zip(given, signs, strict=True)), c)
    expected = vehicle.equations(*given, c) * signs[0]
    np.testing.assert_allclose(mirrored, expected, rtol=1e-12, atol=1e-13)


LEVEL = [
    ("x", "y"),
    ("north", "east"),
    ("wind north", "wind east"),
    ("current north", "current east"),
]


def turned(values: np.ndarray, names: tuple[str, ...], angle: float) -> np.ndarray:
    """Values ``(..., k)`` with their horizontal vectors turned clockwise."""
    turned, (cos, sin) = values.copy(), (np.cos(angle), np.sin(angle))
    for pair in LEVEL:
        if pair[1] in names:
            i, j = map(names.index, pair)
            turned[..., i] = cos * values[..., i] - sin * values[..., j]
            turned[..., j] = sin * values[..., i] + cos * values[..., j]
    return turned


@pytest.mark.parametrize("name", sorted(CASES.keys() - {"itsunusa"}))
@pytest.mark.parametrize("angle", [0.7, np.pi, -9.0])
def test_in_turned_axes_the_rates_are_turned(name: str, angle: float):
    """So nothing depends on where headings are cut."""
    case = CASES[name]
    names, flows = case.vehicle.state_names, case.vehicle.ambient_flows
    states, actuators, flow = case.draw(np.random.default_rng(5), 50)
    rates = case.vehicle.equations(states, actuators, flow, case.nominal)
    there = turned(states, names, angle) + angle * np.isin(names, ["psi"])
    found = case.vehicle.equations(there, actuators, turned(flow, flows, angle), case.nominal)
    np.testing.assert_allclose(found, turned(rates, names, angle), rtol=1e-9, atol=1e-11)


@each_case
def test_the_start_is_a_copy_of_the_estimated_components(case: Case):
    given = np.random.default_rng(9).normal(size=(4, len(case.vehicle.estimated("nonlinear"))))
    state, x = case.vehicle.start(given)[0], given.copy()
    np.testing.assert_array_equal(state, np.pad(x, ((0, 0), (0, state.shape[1] - x.shape[1]))))
    state += 1.0
    np.testing.assert_array_equal(given, x)
