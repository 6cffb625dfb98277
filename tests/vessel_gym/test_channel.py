"""The channel: its geometry and that of routes, what is seen of it, and that nothing but keeping to it pays."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_routes import DOGLEG, every_route

from agents.controllers import make_controller
from estimators.engine import compiled
from vessel_gym.disturbances.seaway import Seaway
from vessel_gym.disturbances.spectrum import WaveSpectrum, WaveSystem
from vessel_gym.envs import SigmaChannelEnv
from vessel_gym.envs.ship import channel_system
from vessel_gym.guidance.dubins import pose_along
from vessel_gym.guidance.geodesy import local
from vessel_gym.guidance.routes import route
from vessel_gym.simulation.core import Core
from vessel_gym.tasks.channel import ALONG, ERROR, LENGTH, OFFSET, Channel
from vessel_gym.tasks.track import BELIEVED, HEADING, OFF, RATE_AHEAD, RATE_NOW, TRACK, WANTED
from vessel_gym.vehicles.seakeeping import encounter_frequency, wave_response

TASK: Any = SigmaChannelEnv.system.task
SHIP = TASK.ship
RADIUS = TASK.turn * SHIP.length
CALM = WaveSpectrum.of_systems(WaveSystem(height=1e-6, period=8.8))
STILL = Seaway(SHIP, CALM, wind=0.0, current=0.0, dt=TASK.dt)


@compiled
class Exact(Channel):
    """Starts without scatter."""

    prior_sd = (0.0,) * 6


@compiled
class Centred(Exact):
    """Starts on the axis, along it."""

    offset = error = 0.0


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


def test_on_a_straight_leg_distances_are_those_of_a_line() -> None:
    rng, scenario = np.random.default_rng(1), scenarios(200)
    along, off = rng.uniform(0.0, TASK.leg * SHIP.length, 200), rng.uniform(-500.0, 500.0, 200)
    state = rng.normal(size=(200, 6))
    for row, heading in enumerate(scenario[:, HEADING]):
        state[row, :2] = turned(np.array([along[row], off[row]]), heading)
    reference = TASK.reference(scenario, np.zeros(200, int), state)
    np.testing.assert_allclose(reference[:, OFF], off, atol=1e-9)
    np.testing.assert_allclose(reference[:, ALONG], along, atol=1e-9)
    np.testing.assert_array_equal(reference[:, TRACK], scenario[:, HEADING])
    np.testing.assert_array_equal(reference[:, WANTED], scenario[:, HEADING])
    np.testing.assert_array_equal(reference[:, BELIEVED], state[:, 2])
    assert (reference[:, [RATE_NOW, RATE_AHEAD]] == 0.0).all()


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


@pytest.mark.parametrize("angle", [0.4, 2.0, -1.3])
def test_a_turned_route_gives_the_same_flight(angle: float) -> None:
    """In still water, where north is no direction of its own, from a start without scatter."""
    system = replace(SigmaChannelEnv.system, task=Exact(SHIP), disturbances={"moderate": STILL})
    flights = []
    for waypoints in (DOGLEG, turned(DOGLEG, angle)):
        core, controller = Core(system, 2, estimator="truth"), make_controller("autopilot", system)
        core.start([4, 5], {"waypoints": waypoints})
        controller.reset(2)
        places = []
        for _ in range(250):
            core.step(controller.act(core.observe()))
            places.append(core.now.state[:, :2].copy())
        flights.append((np.array(places), core.now.total))
    (one, first), (other, second) = flights
    np.testing.assert_allclose(turned(one, angle), other, atol=0.02)  # observations are float32
    np.testing.assert_allclose(first, second, rtol=1e-4)


# --- flights --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_autopilot_in_calm_stays_within_a_twentieth_of_margin() -> None:
    """On the truth, a minute after a start on the axis: its integral has found the current and the wind by then."""
    system = replace(SigmaChannelEnv.system, task=Centred(SHIP))
    core, controller = (
        Core(system, 32, estimator="truth", disturbance="calm"),
        make_controller("autopilot", system),
    )
    core.start(0)
    controller.reset(32)
    for step in range(500):
        core.step(controller.act(core.observe()))
        off = np.abs(TASK.on_track(core.now.scenario, core.now.state[None])[1]).max()
        assert off < (TASK.margin / 20.0 if step > 120 else 2.0)


def scored(
    along: float, off: float, course: float = 0.0, turned_by: float = 0.0, farthest: float = 0.0
) -> Any:
    """Reward and end of a ship at service speed in still water."""
    scenario, state = scenarios(1), np.zeros((1, 8))
    state[0, :2] = turned(np.array([along, off]), scenario[0, HEADING])
    state[0, 2], state[0, 3] = scenario[0, HEADING] + course, SHIP.speed
    reference = TASK.reference(scenario, np.zeros(1, int), state[:, :6])
    rudder, still = np.full((1, 1), turned_by * SHIP.rudder_rate * TASK.dt), np.zeros((1, 8))
    reward, end, _ = TASK.score(
        state, still, scenario, reference, np.zeros(1, bool), rudder, 0.0 * rudder,
        np.array([[farthest, 0.0, 0.0]]),
    )  # fmt: skip
    return float(reward[0]), TASK.end_reasons[int(end[0])]


def test_a_perfect_step_is_worth_its_share_and_every_error_costs() -> None:
    length = TASK.leg * SHIP.length
    whole = 10.0 / length
    assert scored(10.0, 0.0) == (pytest.approx(whole, rel=1e-9), "")
    assert scored(10.0, 7.0)[0] == pytest.approx(0.5 * whole, rel=1e-9)
    assert scored(10.0, 0.0, course=0.05)[0] == pytest.approx(0.85 * whole, rel=1e-9)
    assert scored(10.0, 0.0, turned_by=0.5)[0] == pytest.approx(
        whole / (1.0 + 0.5 * (1.25 + 2.0)), rel=1e-9
    )
    assert scored(10.0, 0.0, farthest=10.0)[0] == 0.0
    assert scored(length + 5.0, 0.0, farthest=length - 5.0) == (
        pytest.approx(5.0 / length, rel=1e-9),
        "arrived",
    )
    for side in (-1.0, 1.0):
        assert scored(10.0, 27.9 * side)[1] == ""
        assert scored(10.0, 28.1 * side) == (0.0, "aground")


@pytest.mark.parametrize("sea", ["moderate", "rough"])
def test_encounter_frequency_in_bow_and_quartering_seas(sea: str) -> None:
    """Against ``w - k U cos(beta)``, and in the yaw that waves give a ship that is held on the axis."""
    for name in (sea, f"{sea} quartering"):
        seaway: Any = SigmaChannelEnv.system.disturbances[name]
        core, controller = (
            Core(SigmaChannelEnv.system, 16, estimator="truth", disturbance=name),
            make_controller("autopilot", SigmaChannelEnv.system),
        )
        core.start(0)
        controller.reset(16)
        d = []
        for _ in range(400):
            core.step(controller.act(core.observe()))
            d.append(core.config.unknown_input.values(core.now)[:, 0].copy())
        psi, w = core.now.scenario[:, HEADING], 2.0 * np.pi / seaway.spectrum.period
        beta = seaway.spectrum.direction - psi
        met = np.abs(encounter_frequency(np.array(w), beta, np.array(SHIP.speed))).mean()
        assert (met > 1.5 * w) if name == sea else (met < 0.4 * w)
        # The frequency below which half of the power is: to 0.03 rad/s in 200 s, and to a tenth
        # with 16 seas drawn.
        power = (np.abs(np.fft.rfft(np.array(d) * np.hanning(400)[:, None], axis=0)) ** 2).mean(1)
        middle = (
            2.0
            * np.pi
            * np.fft.rfftfreq(400, TASK.dt)[np.searchsorted(power.cumsum(), 0.5 * power.sum())]
        )
        assert middle == pytest.approx(_middle(seaway, psi), rel=0.1, abs=0.05)


def _middle(seaway: Any, psi: np.ndarray) -> float:
    """Frequency of encounter [rad/s] below which half of the yaw increments' power is, by the spectral integral."""
    w, directions, energy = seaway.spectrum.cells
    met, power = [], []
    for heading in psi:
        beta = directions - heading
        each = np.abs(encounter_frequency(w, beta, np.array(SHIP.speed)))
        yaw = np.sinc(0.5 * TASK.dt * each / np.pi) * np.abs(
            wave_response(SHIP, w, beta, SHIP.speed)[..., 1]
        )
        met.append(each.ravel())
        power.append((yaw**2 * energy).ravel())
    met, power = np.concatenate(met), np.concatenate(power)
    below = power[met.argsort()].cumsum()
    return float(np.sort(met)[np.searchsorted(below, 0.5 * below[-1])])


def test_a_route_in_a_batch_is_followed_as_alone() -> None:
    rng, options, step = np.random.default_rng(0), {"waypoints": DOGLEG}, np.zeros(20, int)
    uniforms, state = rng.random((20, 4)), 300.0 * rng.normal(size=(20, 6))
    scenario = TASK.scenario(uniforms, options)
    reference = TASK.reference(scenario, step, state)
    for i in range(20):
        alone = TASK.scenario(uniforms[i : i + 1], options)
        np.testing.assert_array_equal(alone[0], scenario[i])
        one = TASK.reference(alone, step[:1], state[i : i + 1])
        np.testing.assert_array_equal(one[0], reference[i])


def test_room_for_more_waypoints_leaves_a_route_as_it_is() -> None:
    roomy, rng = Channel(SHIP, waypoints=11), np.random.default_rng(0)
    uniforms, state = rng.random((20, 4)), 300.0 * rng.normal(size=(20, 6))
    for options in ({}, {"waypoints": DOGLEG}):
        one, other = (
            task.reference(task.scenario(uniforms, options), np.zeros(20, int), state)
            for task in (TASK, roomy)
        )
        np.testing.assert_allclose(one, other, rtol=1e-12)


@pytest.mark.nightly
def test_a_route_of_thirty_waypoints_in_degrees_is_followed() -> None:
    k, system = np.arange(30), channel_system(SHIP, "Fairway-v0", waypoints=30)
    degrees = np.stack([54.0 + 0.003 * (k % 2), 8.0 + 0.011 * k], -1)
    core = Core(system, estimator="truth", disturbance="calm")
    controller, steps = make_controller("autopilot", system), 0
    core.start(0, {"waypoints": local(degrees, degrees[0])})
    while core.now.end[0] == 0 and steps < 4000:
        core.step(controller.act(core.observe()))
        steps += 1
    assert system.task.end_reasons[core.now.end[0]] == "arrived"
    assert core.now.scenario[0, LENGTH] > 20e3


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
