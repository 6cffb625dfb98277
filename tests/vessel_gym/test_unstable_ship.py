"""A directionally unstable ship, the tanker KVLCC2, on circles and in channels in proportion to her."""

from typing import Any

import numpy as np
import pytest

from agents.controllers import make_controller
from vessel_gym.envs.ship import channel_system, ship_system
from vessel_gym.simulation.core import Core
from vessel_gym.vehicles.ship import pace

SYSTEMS: dict[str, Any] = {"channel": channel_system("kvlcc2"), "circle": ship_system("kvlcc2")}


def ends(system: Any, estimator: str, sea: str) -> list[str]:
    """Reasons why 20 episodes under the autopilot ended; empty for those that did not."""
    core = Core(system, 20, estimator=estimator, disturbance=sea)
    controller, reasons = make_controller("autopilot", system), np.zeros(20, int)
    core.start(0)
    controller.reset(20)
    for _ in range(system.task.horizon):
        now = core.step(controller.act(core.observe()))
        assert now.belief.healthy.all()
        reasons = np.where(reasons == 0, now.end, reasons)
    return [system.task.end_reasons[reason] for reason in reasons]


def test_a_channel_is_in_proportion_to_the_ship() -> None:
    for vessel in ("corvette", "kvlcc2"):
        system: Any = channel_system(vessel)
        task, ship = system.task, system.task.ship
        assert task.dt == system.vehicle.dt == 0.5 * pace(ship)
        assert task.dt * ship.speed / ship.length == pytest.approx(0.5 * 15.4 / 101.07, rel=0.01)
        assert task.margin == 2.0 * ship.beam
        straight = task.scenario(np.full((1, 4), 0.5), {})
        assert np.linalg.norm(np.ptp(task.workspace(straight[0]).path, 0)) == pytest.approx(
            40.0 * ship.length
        )
    assert channel_system("kvlcc2") is channel_system(SYSTEMS["channel"].task.ship)


@pytest.mark.slow
@pytest.mark.parametrize("sea", ["calm", "moderate"])
@pytest.mark.parametrize("estimator", ["truth", "ekf", "ukf", "kf-umv-ui", "enkf", "kf"])
@pytest.mark.parametrize("task", SYSTEMS)
def test_the_autopilot_keeps_an_unstable_ship_on_her_track(
    task: str, estimator: str, sea: str
) -> None:
    reasons = ends(SYSTEMS[task], estimator, sea)
    assert sum(reason in ("", "arrived") for reason in reasons) >= 18
