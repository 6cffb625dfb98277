"""The unknown input of filters: increments, or flows that no sensor shows."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pytest
from sensing import assumed

from estimators.engine import compiled
from tests.vessel_gym.contract import make_core
from vessel_gym.disturbances import Fault, Water
from vessel_gym.envs.auv import PLANE_WATERS, WATERS
from vessel_gym.sensors import Sensors
from vessel_gym.vehicles.itsunusa import Itsunusa
from vessel_gym.vehicles.segorogeni import Segorogeni

AUV = "SegorogeniAUV-v0"


@compiled
@dataclass(frozen=True)
class Asked(Water):
    """Water of which some is the unknown input."""

    assumed_as = "unknown-input"
    inputs: tuple[str, ...] | None = None


def asked(*inputs: str, water: Water = WATERS["rough"]) -> Asked:
    return Asked(
        **{each.name: getattr(water, each.name) for each in fields(water)}, inputs=inputs or None
    )


def without_log(vehicle: Any) -> Sensors:
    """Its sensors but for the Doppler log, which reads the current."""
    each = [sensor for sensor in vehicle.sensors if sensor.name != "Doppler log"]
    return Sensors(
        each, vehicle.state_names, vehicle.increments + vehicle.ambient_flows, vehicle.dt
    )


@pytest.mark.parametrize(
    "inputs",
    [
        ("q increment", "u increment"),
        ("current east", "v increment"),
    ],
)
def test_the_world_moves_by_what_the_model_says_of_d(inputs: tuple[str, ...]):
    """All else that is new is taken away: what is left of a step is f(x, u) + G d, in which flows are nearly linear."""
    vehicle, water = Segorogeni(), asked(*inputs)
    sensors = without_log(vehicle).each
    core = make_core(AUV, 6, estimator="dead-reckoning", sensors=sensors, disturbance=water)
    core.start(3)
    config, rng = core.config, np.random.default_rng(3)
    model, known = config.estimation.filter.model, np.isin(config.world.space.noise_names, inputs)
    assert config.estimation.inputs == config.estimation.space.inputs == inputs
    flows = np.isin(inputs, vehicle.ambient_flows)  # others are recorded when they have acted
    for _ in range(10):
        core.now.noise = np.where(known, core.now.noise, 0.0)
        acting = np.isin(vehicle.increments + vehicle.ambient_flows, inputs)
        acting[len(vehicle.increments) :] = True
        core.now.exogenous = np.where(acting, core.now.exogenous, 0.0)
        d, before = (
            config.unknown_input(core.now),
            config.true_state.in_filter_order(core.truth),
        )
        action, actuators = rng.uniform(-1.0, 1.0, (6, 3)), core.now.actuators
        u = vehicle.known_input(actuators, vehicle.actuate(actuators, action), None)
        core.step(action)
        d = np.where(flows, d, config.unknown_input(core.now))
        expected = model.transition(before, u) + np.matvec(model.input_matrix(before, u), d)
        assert np.abs(d).max(0).min() > 1e-4
        after = config.true_state.in_filter_order(core.truth)
        np.testing.assert_allclose(after, expected, rtol=0, atol=1e-12)


def test_what_is_not_unknown_input_is_modelled_as_states():
    vehicle = Segorogeni()
    sensors = Sensors(
        vehicle.sensors, vehicle.state_names, vehicle.increments + vehicle.ambient_flows, vehicle.dt
    )
    (whole, without), (part, model) = (
        assumed(vehicle, "nonlinear", asked("q increment", "u increment"), sensors, how)
        for how in ("states", "unknown-input")
    )
    assert part.names == whole.names
    assert whole.inputs == ()
    G, d = model.G, part.input_cov
    np.testing.assert_allclose(model.Q + G @ d @ G.T, without.Q, rtol=0, atol=1e-18)
    np.testing.assert_array_equal(model.R, without.R)
    assert not model.H.any()
    rng = np.random.default_rng(4)
    x, u = rng.normal(size=(5, model.n)), np.tile(vehicle.cruise[1], (5, 1))
    np.testing.assert_array_equal(model.transition(x, u), without.transition(x, u))
    np.testing.assert_array_equal(model.measurement(x, u), without.measurement(x, u))
    np.testing.assert_array_equal(part.flow(x), whole.flow(x))


def test_flow_as_unknown_input_is_no_state():
    vehicle = Segorogeni()
    space, model = assumed(vehicle, "nonlinear", asked("current east"), without_log(vehicle))
    assert space.names == (*vehicle.state_names, "current north")
    mean = np.arange(26.0).reshape(2, 13)
    np.testing.assert_array_equal(
        space.flow(mean, np.array([[7.0], [8.0]])), [[12.0, 7.0], [25.0, 8.0]]
    )
    np.testing.assert_array_equal(space.flow(mean), [[12.0, 0.0], [25.0, 0.0]])
    x = np.zeros((1, 13))
    x[:, 0] = 1.0
    np.testing.assert_allclose(
        model.input_matrix(x, vehicle.cruise[1][None])[0, :, 0], 0.1 * np.eye(13)[7]
    )


def test_linear_model_refuses_faults_of_actuators():
    class Straight(Itsunusa):
        """ITSUNUSA with a linear model, of any matrices."""

        kinds = linear_kinds = ("linear",)

        def linear(self, kind: str) -> tuple[Any, ...]:
            return np.eye(6), np.zeros((6, 6)), np.zeros((6, 1))

    vehicle, fault = Straight(), Fault("stern plane", beside=PLANE_WATERS["rough"])
    with pytest.raises(ValueError, match="a linear model does not say what a fault does"):
        assumed(vehicle, "linear", fault, without_log(vehicle))


def test_flow_that_sensors_show_cannot_be_unknown_input():
    sentence = "^sensors show current north, which a nonlinear model cannot have .* sensor out$"
    with pytest.raises(ValueError, match=sentence):
        make_core(AUV, 1, disturbance=asked("current north"), estimator="ekf")


def test_what_is_recorded_is_what_d_is():
    water = WATERS["rough"]
    core = make_core(AUV, 1, disturbance=water, estimator="ekf")
    assert core.config.estimation.inputs == core.config.world.space.noise_names
    other = {"assume": {"disturbance": asked("u increment"), "as": "unknown-input"}}
    core = make_core(AUV, 2, disturbance=water, estimator="ekf-ui-wdf", estimator_options=other)
    core.start(0)
    assert core.config.estimation.inputs == ("u increment",)
    core.step(np.zeros((2, 3)))
    np.testing.assert_array_equal(
        core.config.unknown_input(core.now), core.now.exogenous_before[:, :1]
    )


def test_input_that_only_the_filter_assumes_has_no_true_value():
    core = make_core("ItsunusaAUV-v0", 2, disturbance="surface", estimator="ekf")
    core.start(0)
    core.step(np.zeros((2, 2)))
    only_assumed = ["wave" in name for name in core.config.estimation.inputs]
    missing = np.isnan(core.config.unknown_input(core.now))
    np.testing.assert_array_equal(missing, [only_assumed] * 2)
