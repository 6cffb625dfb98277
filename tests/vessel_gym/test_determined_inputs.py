"""Which filters of an unknown input an environment accepts, and what it says of the others."""

from typing import Any

import pytest

from estimators import make
from tests.vessel_gym.contract import make_core
from vessel_gym.disturbances import Fault
from vessel_gym.envs import PunaUAVEnv, SegorogeniAUVEnv
from vessel_gym.envs.auv import PLANE_WATERS, WATERS
from vessel_gym.models.input_conditions import VAGUEST, nominal_flight

AUV, PLANE, AIRCRAFT, SHIP = "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0", "SigmaCorvette-v0"
AIR = PunaUAVEnv.system.disturbances["moderate"]


def only(*names: str) -> list[Any]:
    """Some of the aircraft's sensors."""
    return [sensor for sensor in PunaUAVEnv.system.vehicle.sensors if sensor.name in names]


REFUSED: dict[str, tuple[str, str, dict[str, Any], str]] = {
    "too many inputs": (
        AIRCRAFT, "ekf-ui-wdf",
        {"disturbance": Fault("bank", beside=Fault("thrust", beside=AIR)), "sensors": only("barometer", "GNSS")},
        "the measurements of every step determine 1 of its 2 directions",
    ),
    "seen weakly": (
        PLANE, "ukf-umv", {"disturbance": Fault("thrust", size=2.0, beside=PLANE_WATERS["moderate"])},
        r"one step determines thrust fault to a standard deviation of 5.0 times its assumed size \(3 at most\)",
    ),
    "a zero": (
        AIRCRAFT, "ekf-ui-wdf", {"disturbance": Fault("thrust", size=1e6, beside=AIR), "sensors": only("barometer")},
        r"it adds a zero of modulus \d+\.\d+, outside the unit circle, so that errors grow",
    ),
    "fixes alone": (
        AIRCRAFT, "ekf-ui-wdf", {"disturbance": Fault("bank", beside=AIR), "sensors": only("GNSS")},
        "no sensor reads in every step",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("env_id", "estimator", "world", "why"), REFUSED.values(), ids=REFUSED)
def test_an_input_that_measurements_do_not_show_is_refused(
    env_id: str, estimator: str, world: dict[str, Any], why: str
):
    kind, names = type(world["disturbance"]).__name__, ", ".join(world["disturbance"].inputs)
    sentence = (
        f'{estimator} cannot assume {kind} as "unknown-input", with the unknown input {names}:'
        f" {why}; assume it with "
    )
    with pytest.raises(ValueError, match=f'^{sentence}{{"as": "states"}}, or add a sensor$'):
        make_core(env_id, 1, estimator=estimator, **world)
    own = {"estimator": lambda model: make(estimator, model)}
    with pytest.raises(ValueError, match=why):
        make_core(env_id, 1, **own, **world)
    make_core(env_id, 1, estimator="ekf", **world)  # who takes no heed of it


@pytest.mark.parametrize("size", [0.5, 2.0])
def test_a_step_tells_what_is_unknown_relative_to_its_size(size: float):
    """The thrust of Segorogeni shows to within 0.75 N, as a sweep of priors along an autopilot's runs has shown."""
    world = {"disturbance": Fault("thrust", size=0.75 / VAGUEST * size, beside=WATERS["moderate"])}
    if size > 1.0:
        make_core(AUV, 1, estimator="ekf-ui-wdf", **world)
        return
    with pytest.raises(
        ValueError,
        match=(
            r"determines thrust fault to a standard deviation of (5.9|6.0|6.1) times its assumed"
            r" size"
        ),
    ):
        make_core(AUV, 1, estimator="ekf-ui-wdf", **world)


def test_the_nominal_flight_turns_about_cruising():
    vehicle = SegorogeniAUVEnv.system.vehicle
    x, _ = nominal_flight(vehicle, vehicle.state_names)
    assert abs(x[1:, 3:6] - x[:1, 3:6]).max() > 0.05  # the others turn
    assert (x[:, 0] > 0.5 * vehicle.cruise[0][0]).all()
    part, _ = nominal_flight(vehicle, ("q", "u"))
    assert (part == x[:, [4, 0]]).all()
