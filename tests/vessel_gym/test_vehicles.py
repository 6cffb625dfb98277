"""Laws of every vehicle: equations and steps of a batch, the order of the step, increments, mismatch."""

import numpy as np
import pytest
from sensing import exogenous, sensors_of
from vehicle_cases import CASES, Case

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
def test_step_of_smooth_equations_is_of_fourth_order(case: Case):
    smooth, (dt, parts) = case.nominal.copy(), case.order
    smooth[[name in case.kinks for name in case.vehicle.parameter_names]] = 0.0
    exact = case.exact(smooth, dt)
    errors = [np.abs(case.hard_step(smooth, dt, n) - exact).max() for n in parts]
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ((ratios > 13.0) & (ratios < 20.0)).all()


@each_case
def test_parts_of_a_step_are_steps(case: Case):
    state, before, after, flow = map(np.array, case.hard)
    dt, middle, c = case.vehicle.dt, 0.5 * (before + after), case.nominal
    half = case.step(state, np.concatenate([before, middle]), flow, c, 0.5 * dt, 1)
    two = case.step(half, np.concatenate([middle, after]), flow, c, 0.5 * dt, 1)
    np.testing.assert_allclose(case.hard_step(c, dt, 2), two, rtol=1e-13)


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


@each_case
def test_without_mismatch_every_truth_is_the_filter_s(case: Case):
    normals = np.random.default_rng(17).normal(size=(5, case.vehicle.normals))
    np.testing.assert_array_equal(
        case.vehicle.parameters(0.0, normals), np.tile(case.nominal, (5, 1))
    )


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


@each_case
def test_the_start_is_a_copy_of_the_estimated_components(case: Case):
    given = np.random.default_rng(9).normal(size=(4, len(case.vehicle.estimated("nonlinear"))))
    state, x = case.vehicle.start(given)[0], given.copy()
    np.testing.assert_array_equal(state, np.pad(x, ((0, 0), (0, state.shape[1] - x.shape[1]))))
    state += 1.0
    np.testing.assert_array_equal(given, x)
