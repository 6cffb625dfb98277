"""Faults of actuators: what they do to a vehicle, what a filter knows that knows where they are, and what that buys."""

from functools import reduce
from typing import Any

import numpy as np
import pytest

from agents import rollout
from tests.vessel_gym.contract import make_core
from vessel_gym.disturbances import Disturbance, Fault
from vessel_gym.envs import PunaUAVEnv
from vessel_gym.envs.auv import PLANE_WATERS, WATERS
from vessel_gym.simulation.core import Core

AUV, PLANE, AIRCRAFT = "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0"
ACTUATORS = {
    AUV: ("rudder", "stern plane", "thrust"),
    PLANE: ("stern plane", "thrust"),
    AIRCRAFT: ("thrust", "angle of attack", "bank"),
}
BESIDE: dict[str, Disturbance] = {
    AUV: WATERS["rough"],
    PLANE: PLANE_WATERS["rough"],
    AIRCRAFT: PunaUAVEnv.system.disturbances["rough"],
}
SEEN = {AUV: ("rudder", "stern plane"), PLANE: ("stern plane",), AIRCRAFT: ("bank",)}
DEG = np.pi / 180.0
every_vehicle = pytest.mark.parametrize("env_id", ACTUATORS)


def faulty(env_id: str, *actuators: str, **fault: Any) -> Disturbance:
    """The same fault of several actuators in rough water or air."""
    return reduce(
        lambda beside, actuator: Fault(actuator, beside=beside, **fault), actuators, BESIDE[env_id]
    )


def moved(core: Core, steps: int, seed: int = 1) -> list[dict[str, np.ndarray]]:
    """What there was before each of some random steps, and the actuators and the state after it."""
    rng, seen = np.random.default_rng(seed), []
    for _ in range(steps):
        before = {
            "state": core.now.state.copy(),
            "before": core.now.actuators.copy(),
            "exogenous": core.now.exogenous.copy(),
        }
        before |= {
            "d": core.config.unknown_input(core.now).copy(),
            "z": core.now.slow[:, : core.config.world.size].copy(),
        }
        core.step(rng.uniform(-1.0, 1.0, (core.num_envs, core.config.action_size)))
        seen.append(before | {"after": core.now.actuators.copy(), "moved": core.now.state.copy()})
    return seen


@every_vehicle
def test_fault_offsets_actuators_of_sound_vehicle(env_id: str):
    actuators = ACTUATORS[env_id]
    core = make_core(
        env_id,
        4,
        disturbance=faulty(env_id, *actuators, bias=0.04, loss=0.3),
        estimator="truth",
    )
    core.start(1)
    assert core.config.estimation.inputs == tuple(f"{name} fault" for name in actuators)
    sound = core.config.system.vehicle.increments + core.config.system.vehicle.ambient_flows
    for step in moved(core, 10):
        offset = 0.04 - 0.3 * step["before"]
        np.testing.assert_allclose(step["d"], offset, rtol=0, atol=1e-14)
        before, after = step["before"] + step["d"], step["after"] + step["d"]
        expected = core.config.system.vehicle.step(
            step["state"], before, after, step["exogenous"][:, : len(sound)], core.now.parameters
        )
        np.testing.assert_array_equal(step["moved"], expected)


@every_vehicle
def test_fault_of_size_zero_changes_nothing(env_id: str):
    flights = [
        rollout("autopilot", env_id, range(3), {"disturbance": disturbance, "estimator": "ekf"})
        for disturbance in (BESIDE[env_id], faulty(env_id, *SEEN[env_id]))
    ]
    sound, fault = (flight.history for flight in flights)
    for key in ("truth", "measurement", "estimate", "covariance", "actuators"):
        size = np.abs(sound[key]).max()  # two programs, whose sums differ in their last bits
        np.testing.assert_allclose(fault[key], sound[key], rtol=0, atol=1e-9 * size)
    np.testing.assert_array_equal(fault["unknown_input"], 0.0)


def test_oscillation_has_its_amplitude_period_and_random_phase():
    wave = faulty(PLANE, "stern plane", amplitude=0.1, period=1.7)
    core = make_core(PLANE, 400, disturbance=wave, estimator="truth")
    core.start(3)
    d = np.stack([step["d"][:, 0] for step in moved(core, 60)])
    turn = 2.0 * np.pi * 0.1 / 1.7
    quarter = (d[1:] - np.cos(turn) * d[:-1]) / np.sin(turn)
    np.testing.assert_allclose(np.hypot(d[:-1], quarter), 0.1, rtol=1e-9)
    np.testing.assert_allclose(d[2:] + d[:-2], 2.0 * np.cos(turn) * d[1:-1], atol=1e-12)
    phase = np.arctan2(d[0], quarter[0])
    assert np.abs(np.exp(1j * phase).mean()) < 3.0 / np.sqrt(
        400
    )  # of random phases above with probability exp(-9)


def test_a_walking_offset_has_its_start_and_its_pace():
    """Within four standard errors."""
    walk = faulty(PLANE, "stern plane", start=0.2, walk=0.05)
    core = make_core(PLANE, 400, disturbance=walk, estimator="truth")
    core.start(3)
    d = np.stack([step["d"][:, 0] for step in moved(core, 20)])
    assert d[0].std() == pytest.approx(0.2, rel=4.0 / np.sqrt(2 * 400))
    assert np.diff(d, axis=0).std() == pytest.approx(0.05 * np.sqrt(0.1), rel=0.03)


@every_vehicle
def test_effect_of_fault_is_G_times_it_to_first_order(env_id: str):
    told = faulty(env_id, *SEEN[env_id])
    core = make_core(env_id, 5, disturbance=told, estimator="ekf-ui-wdf")
    core.start(4)
    model, vehicle = core.config.estimation.filter.model, core.config.system.vehicle
    base = len(core.config.estimation.space.vehicle_states)
    for step in moved(core, 5):
        x, u = core.now.belief.mean, vehicle.known_input(step["before"], step["after"], None)
        G = model.input_matrix(x, u)
        assert G.shape[-1] == len(SEEN[env_id])
        np.testing.assert_array_equal(G[..., base:, :], 0.0)
        errors = []
        for size in (0.04, 0.02):
            offset = np.zeros((5, len(step["before"][0])))
            offset[:, [ACTUATORS[env_id].index(name) for name in SEEN[env_id]]] = size
            there = model.transition(x, vehicle.faulty(u, offset))  # type: ignore[attr-defined]
            did = there - model.transition(x, u)
            errors.append(np.abs(did - size * G.sum(-1)).max())
            assert errors[-1] < 0.03 * np.abs(did).max()
        assert errors[1] < 0.3 * errors[0] + 1e-9


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (
            {"actuator": "fin"},
            (
                "^Fault gives 'fin fault', but what acts on this vehicle is u increment, .*, thrust"
                " loss$"
            ),
        ),
        ({"loss": 1.5}, "^loss of a fault must be a number from 0 to 1, got 1.5"),
        ({"period": 0.1}, "^period of a fault must be .*above two steps of 0.1 s.*0.1"),
        (
            {"beside": Fault("rudder")},
            "^a fault has another fault of the rudder beside it$",
        ),
    ],
)
def test_impossible_fault_is_refused_in_one_sentence(wrong: dict[str, Any], sentence: str):
    with pytest.raises(ValueError, match=sentence):
        make_core(AUV, 1, disturbance=Fault(**({"actuator": "rudder"} | wrong)))
