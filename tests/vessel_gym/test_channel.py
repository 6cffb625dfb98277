"""The channel: its geometry and that of routes, what is seen of it, and that nothing but keeping to it pays."""

from typing import Any

import numpy as np
import pytest
from test_routes import DOGLEG, every_route

from vessel_gym.envs import SigmaChannelEnv
from vessel_gym.guidance.dubins import pose_along
from vessel_gym.guidance.routes import route
from vessel_gym.tasks.channel import ALONG, ERROR, LENGTH, OFFSET, Channel
from vessel_gym.tasks.track import HEADING, OFF, RATE_AHEAD, RATE_NOW

TASK: Any = SigmaChannelEnv.system.task
SHIP = TASK.ship
RADIUS = TASK.turn * SHIP.length


def scenarios(count: int, options: dict[str, Any] | None = None, seed: int = 0) -> np.ndarray:
    return TASK.scenario(np.random.default_rng(seed).random((count, 4)), options or {})


def turned(places: np.ndarray, angle: float) -> np.ndarray:
    """Places ``(..., 2)`` turned clockwise about the origin."""
    sin, cos = np.sin(angle), np.cos(angle)
    return np.stack(
        [places[..., 0] * cos - places[..., 1] * sin, places[..., 0] * sin + places[..., 1] * cos],
        -1,
    )


# --- geometry -------------------------------------------------------------------------------------


def test_scenarios_lie_within_their_ranges_and_reach_them() -> None:
    scenario = scenarios(4000)
    heading = np.rad2deg(np.abs(scenario[:, HEADING]))
    assert 35.0 <= heading.min() < 35.2
    assert 54.8 < heading.max() <= 55.0
    assert abs((scenario[:, HEADING] > 0.0).mean() - 0.5) < 0.04  # 5 standard deviations
    for column, most in ((OFFSET, 0.5 * TASK.margin), (ERROR, 0.05)):
        assert 0.99 * most < np.abs(scenario[:, column]).max() <= most
    start = TASK.prior(scenario).mean
    np.testing.assert_allclose(
        TASK.on_track(scenario, start[None])[1][0], scenario[:, OFFSET], atol=1e-9
    )
    np.testing.assert_allclose(start[:, 2] - scenario[:, HEADING], scenario[:, ERROR], atol=1e-12)
    assert TASK.margin == 2.0 * SHIP.beam


@every_route
def test_on_a_route_the_nearest_point_is_nearest(waypoints: np.ndarray) -> None:
    scenario = scenarios(60, {"waypoints": waypoints})
    _, path = route(waypoints, RADIUS)
    rng = np.random.default_rng(3)
    along, off = rng.uniform(1.0, path.length - 1.0, 60), rng.uniform(-60.0, 60.0, 60)
    x, y, direction = path.pose(along).T
    state = np.zeros((60, 6))
    state[:, :2] = np.stack([x - off * np.sin(direction), y + off * np.cos(direction)], -1)
    reference = TASK.reference(scenario, np.zeros(60, int), state)
    dense = path.sample(0.5)[:, :2]
    nearest, least = np.hypot(*(dense[:, None] - state[:, :2]).T).min(1), np.abs(reference[:, OFF])
    assert (least - 1e-6 <= nearest).all()
    assert (nearest <= np.hypot(least, 0.25) + 1e-6).all()
    near = np.abs(reference[:, ALONG] - along) < 1e-6  # elsewhere another point is nearer
    assert near.mean() > 0.8
    np.testing.assert_allclose(reference[near, OFF], off[near], atol=1e-6)
    sampled = np.stack(pose_along(along, np.tile(path.segments.ravel(), (60, 1))), -1)
    np.testing.assert_allclose(sampled, path.pose(along), atol=1e-8)


def test_a_turn_is_commanded_before_it_begins_and_ends() -> None:
    _, path = route(DOGLEG, RADIUS)
    along = np.arange(0.0, path.length, 5.0)
    state = np.zeros((len(along), 6))
    state[:, :2] = path.pose(along)[:, :2]
    reference = TASK.reference(
        scenarios(len(along), {"waypoints": DOGLEG}), np.zeros(len(along), int), state
    )
    steady, rate, later = (
        TASK.turning(np.array(1.0 / RADIUS)),
        reference[:, RATE_NOW],
        reference[:, RATE_AHEAD],
    )
    begin = path.segments[0, 4]
    assert rate.max() == pytest.approx(steady, rel=1e-9)
    assert (rate[along < begin - 77.0] == 0.0).all()
    assert (rate[(along > begin - 76.0) & (along < begin)] > 0.0).all()
    assert (later[(along > begin - 230.0) & (along < begin)] > 0.0).all()
    assert np.abs(np.diff(rate)).max() < 0.1 * steady


# --- flights --------------------------------------------------------------------------------------


def test_room_for_more_waypoints_leaves_a_route_as_it_is() -> None:
    roomy, rng = Channel(SHIP, waypoints=11), np.random.default_rng(0)
    uniforms, state = rng.random((20, 4)), 300.0 * rng.normal(size=(20, 6))
    for options in ({}, {"waypoints": DOGLEG}):
        one, other = (
            task.reference(task.scenario(uniforms, options), np.zeros(20, int), state)
            for task in (TASK, roomy)
        )
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_observed_mission_is_waypoints_in_the_first_leg_frame() -> None:
    scenario = scenarios(2, {"waypoints": turned(DOGLEG, 0.7)})
    mission = TASK.observe_mission(scenario, np.zeros(2, int), np.full((2, 1), SHIP.rudder_limit))
    assert mission.shape == (2, 1 + 2 * (TASK.waypoints - 1))
    expected = np.concatenate([DOGLEG[1:], DOGLEG[-1:].repeat(TASK.waypoints - len(DOGLEG), 0)])
    np.testing.assert_allclose(
        mission[0, 1:].reshape(-1, 2), expected / (10.0 * SHIP.length), atol=1e-9
    )
    assert mission[0, 0] == 1.0
    assert scenario[0, LENGTH] == pytest.approx(route(DOGLEG, RADIUS)[1].length)
