"""The channel: its geometry and that of routes, what is seen of it, and that nothing but keeping to it pays."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from test_routes import DOGLEG, every_route

from agents.controllers import make_controller
from estimators.engine import compiled
from vessel_gym.core import Core
from vessel_gym.envs import SigmaChannelEnv, SigmaCorvetteEnv
from vessel_gym.guidance.path_following import pose_along
from vessel_gym.guidance.routes import WAYPOINTS, route
from vessel_gym.seaway import Seaway
from vessel_gym.tasks.channel import ALONG, ERROR, LENGTH, OFFSET, Channel
from vessel_gym.tasks.track import BELIEVED, HEADING, OFF, RATE_AHEAD, RATE_NOW, TRACK, WANTED
from vessel_gym.vehicles.seakeeping import wave_response
from vessel_gym.waves import encounter_frequency

TASK: Any = SigmaChannelEnv.system.task
SHIP = TASK.ship
RADIUS = TASK.turn * SHIP.length
STILL = Seaway(SHIP, height=1e-6, period=8.8, wind=0.0, current=0.0, dt=TASK.dt)


@compiled
class Exact(Channel):
    """Starts without scatter."""

    prior_sd = (0.0,) * 6


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
        TASK.on_track(scenario, start[None, :, :2])[1][0], scenario[:, OFFSET], atol=1e-9
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
        TASK.yaw_rate(np.array(RADIUS)),
        reference[:, RATE_NOW],
        reference[:, RATE_AHEAD],
    )
    begin = path.ends[0]
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


def flown(policy: Any, rows: int, disturbance: str) -> tuple[np.ndarray, np.ndarray]:
    """Scores and ends ``(rows,)``."""
    core = Core(SigmaChannelEnv.system, rows, estimator="truth", disturbance=disturbance)
    core.start(list(range(10_000, 10_000 + rows)))
    total, ends = np.zeros(rows), np.zeros(rows, int)
    for k in range(TASK.horizon):
        now = core.step(policy(k, core))
        total += now.reward * (ends == 0)
        ends = np.where(ends == 0, now.end, ends)
    return total, ends


@pytest.mark.slow
def test_in_a_calm_the_autopilot_stays_within_a_metre_of_the_axis() -> None:
    """On the truth, a minute after a start on the axis: its integral has found the current and the wind by then."""
    system = replace(SigmaChannelEnv.system, task=Exact(SHIP, offset=0.0, error=0.0))
    core, controller = (
        Core(system, 32, estimator="truth", disturbance="calm"),
        make_controller("autopilot", system),
    )
    core.start(0)
    controller.reset(32)
    for step in range(500):
        core.step(controller.act(core.observe()))
        off = np.abs(TASK.on_track(core.now.scenario, core.now.state[None, :, :2])[1]).max()
        assert off < (1.0 if step > 120 else 2.0)


IDLE = {
    "hands off": lambda k, core: np.zeros((core.num_envs, 1)),
    "hard over": lambda k, core: np.ones((core.num_envs, 1)),
    "weaving": lambda k, core: np.full((core.num_envs, 1), 1.0 if k // 14 % 2 == 0 else -1.0),
}


@pytest.mark.parametrize("disturbance", ["moderate", "rough quartering"])
@pytest.mark.parametrize("policy", sorted(IDLE))
def test_nothing_but_keeping_to_the_channel_pays(policy: str, disturbance: str) -> None:
    score, end = flown(IDLE[policy], 16, disturbance)
    assert score.mean() <= 0.1
    assert (np.array(TASK.end_reasons)[end] == "aground").all()


@pytest.mark.parametrize(
    ("disturbance", "least"),
    [("calm", 0.85), ("moderate", 0.75), ("rough", 0.55), ("moderate quartering", 0.45)],
)
def test_the_autopilot_arrives(disturbance: str, least: float) -> None:
    controller = make_controller("autopilot", SigmaChannelEnv.system)
    controller.reset(16)
    score, end = flown(lambda k, core: controller.act(core.observe()), 16, disturbance)
    assert (np.array(TASK.end_reasons)[end] == "arrived").all()
    assert score.mean() > least


@pytest.mark.parametrize(
    ("system", "most"),
    [
        (SigmaChannelEnv.system, 3.0 * TASK.dt * SHIP.speed / (TASK.leg * SHIP.length)),
        (SigmaCorvetteEnv.system, 200 * 0.06),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_loitering_does_not_pay(system, most: float) -> None:
    """A ship that is put back again and again to where she began is on the track, and gets no further."""
    core = Core(system, 8, estimator="truth", disturbance="calm")
    core.start(0)
    state = core.now.state.copy()
    total = np.zeros(8)
    for _ in range(200):
        reward = core.step(np.zeros((8, 1))).reward
        total += reward
        core.now.state = state.copy()
    assert total.max() < most


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
def test_bow_seas_raise_the_frequency_of_encounter_and_quartering_seas_lower_it(sea: str) -> None:
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
        beta, w = seaway.direction - core.now.scenario[:, HEADING], 2.0 * np.pi / seaway.period
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
        assert middle == pytest.approx(_middle(seaway, beta), rel=0.1, abs=0.05)


def _middle(seaway: Any, beta: np.ndarray) -> float:
    """Frequency of encounter [rad/s] below which half of the yaw increments' power is, by the spectral integral."""
    w, spectrum = (each[:, None] for each in seaway.waves.spectrum)
    met = np.abs(encounter_frequency(w, beta, np.array(SHIP.speed)))
    yaw = np.sinc(0.5 * TASK.dt * met / np.pi) * np.abs(
        wave_response(SHIP, w, beta, SHIP.speed)[..., 1]
    )
    order = met.ravel().argsort()
    power = (yaw**2 * spectrum).ravel()[order].cumsum()
    return float(met.ravel()[order][np.searchsorted(power, 0.5 * power[-1])])


def test_a_route_in_a_batch_flies_as_alone() -> None:
    batch = gym.make_vec("SigmaChannel-v0", 3, vectorization_mode="vector_entry_point")
    seen, _ = batch.reset(seed=6, options={"waypoints": DOGLEG})
    alone = [gym.make("SigmaChannel-v0") for _ in range(3)]
    for row, env in enumerate(alone):
        np.testing.assert_array_equal(
            env.reset(seed=6 + row, options={"waypoints": DOGLEG})[0], seen[row]
        )
    for action in np.random.default_rng(0).uniform(-0.2, 0.2, (60, 3, 1)).astype(np.float32):
        seen, rewards, *_ = batch.step(action)
        for row, env in enumerate(alone):
            one, reward, *_ = env.step(action[row])
            np.testing.assert_array_equal(one, seen[row])
            assert reward == rewards[row]


def test_the_mission_is_the_waypoints_in_the_frame_of_the_first_leg() -> None:
    scenario = scenarios(2, {"waypoints": turned(DOGLEG, 0.7)})
    mission = TASK.observe_mission(scenario, np.zeros(2, int), np.full((2, 1), SHIP.rudder_limit))
    assert mission.shape == (2, TASK.MISSION)
    expected = np.concatenate([DOGLEG[1:], DOGLEG[-1:].repeat(WAYPOINTS - len(DOGLEG), 0)])
    np.testing.assert_allclose(
        mission[0, 1:].reshape(-1, 2), expected / (10.0 * SHIP.length), atol=1e-9
    )
    assert mission[0, 0] == 1.0
    assert scenario[0, LENGTH] == pytest.approx(route(DOGLEG, RADIUS)[1].length)
