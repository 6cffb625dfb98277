"""What the unknown input is where filters are told of one: increments, flows, and changes of what acts."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pytest

from agents import rollout
from agents.metrics import scores
from estimators import LinearModel, NonlinearModel
from estimators.engine import compiled, jacobian
from tests.vessel_gym.contract import make_core
from vessel_gym.disturbances import Disturbance, Water
from vessel_gym.envs.auv import PLANE_WATERS, WATERS
from vessel_gym.filter_models.build import compose
from vessel_gym.sensors import Sensors
from vessel_gym.vehicles.itsunusa import Itsunusa
from vessel_gym.vehicles.segorogeni import Segorogeni

AUV = "SegorogeniAUV-v0"
CHANGES = "change of current north", "change of current east"


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


every_kind_of_input = pytest.mark.parametrize(
    "inputs",
    [
        ("q increment", "u increment"),
        CHANGES,
        ("r increment", *CHANGES[1:]),
        ("current east", "v increment"),
    ],
)


@every_kind_of_input
def test_the_world_moves_by_what_the_model_says_of_d(inputs: tuple[str, ...]):
    """All else that is new is taken away: what is left of a step is f(x, u) + G d, in which flows are nearly linear."""
    sensors = [s for s in Segorogeni().sensors if s.name != "Doppler log"]
    water = asked(*inputs)
    core = make_core(AUV, 6, seed=3, estimator="dead-reckoning", sensors=sensors, disturbance=water)
    core.reset()
    model, rng = core.config.composition.model, np.random.default_rng(3)
    assert isinstance(model, NonlinearModel)
    assert core.config.estimation.inputs == core.config.composition.inputs == inputs
    new = [*water.white_increments, *CHANGES]
    for _ in range(10):
        core.now.noise = np.where([name in inputs for name in new], core.now.noise, 0.0)
        core.now.exogenous = core.now.exogenous.copy()
        core.now.exogenous[
            :,
            [
                i
                for i, name in enumerate(core.config.system.vehicle.increments)
                if name not in inputs
            ],
        ] = 0.0
        if "current east" not in inputs:
            assert set(water.names) <= set(core.config.composition.names)  # what is not d is held
        d, before, where = (
            core.config.unknown_input.values(core.now),
            core.config.true_state.in_filter_order(core.truth),
            core.now.actuators,
        )
        action = rng.uniform(-1.0, 1.0, (6, 3))
        u = core.config.system.vehicle.known_input(
            where, core.config.system.vehicle.actuate(where, action), None
        )
        core.step(action)
        ended = [name not in core.config.system.vehicle.ambient_flows for name in inputs]
        d = np.where(
            ended, core.config.unknown_input.values(core.now), d
        )  # increments and changes are recorded when they have acted
        expected = model.transition(before, u) + np.matvec(model.input_matrix(before, u), d)
        assert np.abs(d).max(0).min() > 1e-4
        np.testing.assert_allclose(
            core.config.true_state.in_filter_order(core.truth), expected, rtol=0, atol=1e-12
        )


@pytest.mark.parametrize(
    "inputs", [("q increment", "u increment"), CHANGES, ("r increment", *CHANGES[1:])]
)
def test_what_is_not_unknown_input_is_modelled_as_states(inputs: tuple[str, ...]):
    vehicle = Segorogeni()
    sensors = Sensors(
        vehicle.sensors, vehicle.state_names, vehicle.increments + vehicle.ambient_flows, vehicle.dt
    )
    whole, part = (
        compose(vehicle, "nonlinear", asked(*inputs), sensors, how)
        for how in ("states", "unknown-input")
    )
    assert part.names == whole.names
    assert whole.inputs == ()
    G, d = part.model.G, part.forces.input_cov
    np.testing.assert_allclose(part.model.Q + G @ d @ G.T, whole.model.Q, rtol=0, atol=1e-18)
    np.testing.assert_array_equal(part.model.R, whole.model.R)
    assert not part.model.H.any()
    rng = np.random.default_rng(4)
    x, u = rng.normal(size=(5, part.model.n)), np.tile(vehicle.cruise[1], (5, 1))
    np.testing.assert_array_equal(part.model.transition(x, u), whole.model.transition(x, u))
    np.testing.assert_array_equal(part.model.measurement(x, u), whole.model.measurement(x, u))
    np.testing.assert_array_equal(part.flow(x), whole.flow(x))


def test_flow_as_unknown_input_is_no_state():
    vehicle = Segorogeni()
    told = compose(vehicle, "nonlinear", asked("current east"), without_log(vehicle))
    assert told.names == (*vehicle.state_names, "current north")
    mean = np.arange(26.0).reshape(2, 13)
    np.testing.assert_array_equal(
        told.flow(mean, np.array([[7.0], [8.0]])), [[12.0, 7.0], [25.0, 8.0]]
    )
    np.testing.assert_array_equal(told.flow(mean), [[12.0, 0.0], [25.0, 0.0]])
    x = np.zeros((1, 13))
    x[:, 0] = 1.0
    np.testing.assert_allclose(
        told.model.input_matrix(x, vehicle.cruise[1][None])[0, :, 0], 0.1 * np.eye(13)[7]
    )


@compiled
class Straight(Itsunusa):
    """ITSUNUSA with a linear model about cruising, and what the current does to it."""

    kinds = ("nonlinear", "linear")
    linear_kinds = ("linear",)
    flow_told = True

    def linear(self, kind: str) -> tuple[Any, ...]:
        def slopes(*at: np.ndarray) -> tuple[np.ndarray, ...]:
            after = self.drift(*at)
            return tuple(jacobian(after, each) for each in at)

        A, B, F = compiled(slopes)(*self.cruise, np.zeros(1))
        return (A, B, F) if self.flow_told else (A, B)


@pytest.mark.parametrize(
    "inputs", [(), ("q increment",), ("current",), ("change of current", "w increment")]
)
def test_composed_linear_model_is_linearised_nonlinear_one(
    inputs: tuple[str, ...],
):
    vehicle = Straight()
    water = asked(*inputs, water=PLANE_WATERS["rough"])
    sensors = without_log(vehicle)
    bent, straight = (
        compose(vehicle, kind, water, sensors, "unknown-input") for kind in vehicle.kinds
    )
    assert straight.names == bent.names
    assert isinstance(straight.model, LinearModel)
    x, u = np.zeros(len(bent.names)), vehicle.cruise[1]
    x[:6] = vehicle.cruise[0]
    A = straight.model.linearise_transition(x, u)[1]
    np.testing.assert_allclose(A, bent.model.linearise_transition(x, u)[1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        straight.model.input_matrix(x, u), bent.model.input_matrix(x, u), rtol=0, atol=1e-9
    )
    for name in "QRH":
        np.testing.assert_array_equal(getattr(straight.model, name), getattr(bent.model, name))
    assert ("current" in straight.names) == (inputs != ("current",))


def test_linear_model_without_effect_of_flow_is_refused():
    vehicle = Straight()
    object.__setattr__(vehicle, "flow_told", False)
    sentence = "^the linear model does not say what current does to it: choose a nonlinear one$"
    water = PLANE_WATERS["rough"]
    with pytest.raises(ValueError, match=sentence):
        compose(vehicle, "linear", water, without_log(vehicle))


def test_flow_that_sensors_show_cannot_be_unknown_input():
    sentence = (
        "how measurements show current north depends on where the vehicle is, .* the sensor out$"
    )
    with pytest.raises(ValueError, match=sentence):
        make_core(AUV, 1, disturbance=asked("current north"), estimator="ekf")


def test_what_is_recorded_is_what_d_is():
    core = make_core(AUV, 1, disturbance=asked(*CHANGES), estimator="ekf-ui-wdf")
    assert core.config.estimation.inputs == CHANGES
    water = WATERS["rough"]
    everything = *water.white_increments, *CHANGES
    assert (
        make_core(AUV, 1, disturbance=water, estimator="ekf").config.estimation.inputs == everything
    )
    other = {"assume": {"disturbance": asked("u increment"), "as": "unknown-input"}}
    core = make_core(AUV, 2, disturbance=water, estimator="ekf-ui-wdf", estimator_options=other)
    core.reset()
    assert core.config.estimation.inputs == ("u increment",)
    core.step(np.zeros((2, 3)))
    np.testing.assert_array_equal(
        core.config.unknown_input.values(core.now), core.now.exogenous_before[:, :1]
    )


class Unheard(Disturbance):
    """An unknown input that there is not: a current that only the filter thinks there is."""

    names = forces = ("current north",)
    process = WATERS["calm"].process.wandering((0.1,), 100.0, 0.1)
    assumed_as = "unknown-input"
    inputs = ("change of current north",)


def test_input_that_only_filter_assumes_has_no_true_value():
    class Silent(Disturbance):
        """Nothing acts."""

    options = {"assume": {"disturbance": Unheard()}}
    core = make_core(
        AUV, 2, disturbance=Silent(), estimator="ekf-ui-wdf", estimator_options=options
    )
    core.reset()
    core.step(np.zeros((2, 3)))
    assert np.isnan(core.config.unknown_input.values(core.now)).all()
    assert np.isfinite(core.now.belief.mean).all()


def test_input_rmse_is_of_ended_step_in_units_of_input_size():
    options: dict[str, Any] = {"disturbance": asked(*CHANGES), "estimator": "ekf-ui-wdf"}
    options |= {"estimator_options": {"input_prior": 0.01**2}}
    flight = rollout("autopilot", AUV, range(3), options)
    h, found = flight.history, scores(flight)["input_rmse"]
    size = 0.2 / np.sqrt(2.0) * np.sqrt(-np.expm1(-2.0 * 0.1 / 200.0))
    for i, last in enumerate(flight.length):
        error = h["input_estimate"][: last + 1, i] - h["unknown_input"][: last + 1, i]
        assert found[i] == pytest.approx(np.sqrt((error**2).mean()) / size, rel=1e-6)
    assert np.isnan(
        scores(rollout("autopilot", AUV, range(2), {"estimator": "ekf"}))["input_rmse"]
    ).all()
    oracle = rollout(
        "autopilot", AUV, range(2), {"disturbance": asked(*CHANGES), "estimator": "truth"}
    )
    np.testing.assert_array_equal(scores(oracle)["input_rmse"], 0.0)
