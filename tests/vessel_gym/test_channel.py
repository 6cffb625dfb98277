"""The channel: its geometry and that of routes, what is seen of it, and that nothing but keeping to it pays."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from agents.controllers import make_controller
from vessel_gym.core import Core
from vessel_gym.envs.sigma_channel import SIGMA_CHANNEL
from vessel_gym.guidance.path_following import pose_along
from vessel_gym.guidance.routes import LONGEST, WAYPOINTS, read_waypoints, route
from vessel_gym.seaway import Seaway
from vessel_gym.tasks.channel import ALONG, ERROR, LENGTH, OFFSET, Channel
from vessel_gym.tasks.track import BELIEVED, HEADING, OFF, RATE_AHEAD, RATE_NOW, TRACK, WANTED
from vessel_gym.waves import encounter_frequency

TASK: Any = SIGMA_CHANNEL.task
SHIP = TASK.ship
RADIUS = TASK.turn * SHIP.length
STILL = Seaway(SHIP, height=1e-6, period=8.8, wind=0.0, current=0.0, dt=TASK.dt)
DOGLEG = np.array([[0.0, 0.0], [1200.0, 0.0], [2000.0, 1100.0], [3400.0, 900.0]])
ROUTES = {
    "dogleg": DOGLEG,
    "elsewhere": DOGLEG + [4e6, -7e5],
    "nearly straight": np.array([[0.0, 0.0], [1500.0, 1.0], [3000.0, 0.0]]),
    "straight on": np.array([[0.0, 0.0], [1500.0, 0.0], [3000.0, 0.0]]),
    "hairpin": np.array([[0.0, 0.0], [1500.0, 0.0], [700.0, 1500.0]]),
    "zigzag": np.array([[600.0 * k, 450.0 * (k % 2)] for k in range(WAYPOINTS)]),
}
every_route = pytest.mark.parametrize("waypoints", ROUTES.values(), ids=ROUTES)


class Exact(Channel, verified=True):
    """Starts without scatter."""

    prior_sd = (0.0,) * 6


def scenarios(count: int, options: dict[str, Any] | None = None, seed: int = 0) -> np.ndarray:
    return TASK.scenario(np.random.default_rng(seed).random((count, 4)), options or {})


def turned(places: np.ndarray, angle: float) -> np.ndarray:
    """Places ``(..., 2)`` turned clockwise about the origin."""
    sin, cos = np.sin(angle), np.cos(angle)
    return np.stack([places[..., 0] * cos - places[..., 1] * sin, places[..., 0] * sin + places[..., 1] * cos], -1)


# --- geometry ---------------------------------------------------------------------------------------


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
    np.testing.assert_array_equal(TASK.scenario_of(reference), scenario)


def test_scenarios_lie_within_their_ranges_and_reach_them() -> None:
    scenario = scenarios(4000)
    heading = np.rad2deg(np.abs(scenario[:, HEADING]))
    assert 35.0 <= heading.min() < 35.2
    assert 54.8 < heading.max() <= 55.0
    assert abs((scenario[:, HEADING] > 0.0).mean() - 0.5) < 0.04  # 5 standard deviations
    for column, most in ((OFFSET, 0.5 * TASK.margin), (ERROR, 0.05)):
        assert 0.99 * most < np.abs(scenario[:, column]).max() <= most
    start = TASK.prior(scenario).mean
    np.testing.assert_allclose(TASK.on_track(scenario, start[None, :, :2])[1][0], scenario[:, OFFSET], atol=1e-9)
    np.testing.assert_allclose(start[:, 2] - scenario[:, HEADING], scenario[:, ERROR], atol=1e-12)
    assert TASK.margin == 2.0 * SHIP.beam


@every_route
def test_arcs_join_the_legs_without_a_jump_of_place_or_direction(waypoints: np.ndarray) -> None:
    points, path = route(waypoints, RADIUS)
    np.testing.assert_allclose(points, waypoints - waypoints[0], atol=1e-9)
    for before, after in pairwise(path.ends):
        left, right = path.pose(np.array([before - 1e-6, before + 1e-6]))
        assert np.abs(right - left).max() < 3e-6
        assert after > before
    begin, end = path.pose(np.array([0.0, path.length]))
    np.testing.assert_allclose(begin[:2], 0.0, atol=1e-9)
    np.testing.assert_allclose(end[:2], points[-1], atol=1e-6)
    last = points[-1] - points[-2]
    assert np.cos(end[2] - np.arctan2(last[1], last[0])) > 1.0 - 1e-12
    assert np.abs(path.segments[:, 3]).max() <= 1.0 / RADIUS
    # An arc begins R tan(turn / 2) before its waypoint and comes as near to it as R / cos(turn / 2) - R.
    legs = np.diff(points, axis=0)
    turns = np.diff(np.unwrap(np.arctan2(legs[:, 1], legs[:, 0])))
    straight = np.hypot(*legs.T).sum() - 2.0 * RADIUS * np.tan(0.5 * np.abs(turns)).sum()
    assert path.length == pytest.approx(straight + RADIUS * np.abs(turns).sum(), abs=1e-6)
    dense = path.sample(1.0)[:, :2]
    for point, turn in zip(points[1:-1], turns, strict=True):
        nearest, cut = np.hypot(*(dense - point).T).min(), RADIUS / np.cos(0.5 * turn) - RADIUS
        assert cut - 1e-6 <= nearest <= np.hypot(cut, 0.5) + 1e-6


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
    reference = TASK.reference(scenarios(len(along), {"waypoints": DOGLEG}), np.zeros(len(along), int), state)
    steady, rate, later = TASK.yaw_rate(np.array(RADIUS)), reference[:, RATE_NOW], reference[:, RATE_AHEAD]
    begin = path.ends[0]
    assert rate.max() == pytest.approx(steady, rel=1e-9)
    assert (rate[along < begin - 77.0] == 0.0).all()
    assert (rate[(along > begin - 76.0) & (along < begin)] > 0.0).all()
    assert (later[(along > begin - 230.0) & (along < begin)] > 0.0).all()
    assert np.abs(np.diff(rate)).max() < 0.1 * steady


@pytest.mark.parametrize("angle", [0.4, 2.0, -1.3])
def test_a_turned_route_gives_the_same_flight(angle: float) -> None:
    """In still water, where north is no direction of its own, from a start without scatter."""
    system = replace(SIGMA_CHANNEL, task=Exact(SHIP), disturbances={"moderate": STILL})
    flights = []
    for waypoints in (DOGLEG, turned(DOGLEG, angle)):
        core, controller = Core(system, 2, estimator="truth"), make_controller("autopilot", system)
        core.start([4, 5], {"waypoints": waypoints})
        controller.reset(2)
        places = []
        for _ in range(250):
            core.step(controller.act(core.observe()))
            places.append(core.state[:, :2].copy())
        flights.append((np.array(places), core.total))
    (one, first), (other, second) = flights
    np.testing.assert_allclose(turned(one, angle), other, atol=0.02)  # observations are float32
    np.testing.assert_allclose(first, second, rtol=1e-4)


# --- bad routes -------------------------------------------------------------------------------------

BAD = {
    "a word": ("abc", "waypoints must be rows"),
    "nothing": (None, "waypoints must be rows"),
    "a number": (3.0, "waypoints must be rows"),
    "three columns": ([[0, 0, 0], [1000, 0, 0]], "waypoints must be rows"),
    "ragged": ([[0, 0], [1000]], "waypoints must be rows"),
    "words": ([["a", "b"], ["c", "d"]], "waypoints must be rows"),
    "one": ([[0, 0]], "waypoints must be 2 to 8, got 1"),
    "none": (np.zeros((0, 2)), "waypoints must be 2 to 8, got 0"),
    "too many": ([[500.0 * k, 0] for k in range(9)], "waypoints must be 2 to 8, got 9"),
    "not finite": ([[0, 0], [np.nan, 0]], "waypoints must be finite"),
    "infinite": ([[0, 0], [np.inf, 0]], "waypoints must be finite"),
    "twice the same": ([[0, 0], [1000, 0], [1000, 0]], "waypoints 2 and 3 are the same place"),
    "back": ([[0, 0], [2000, 0], [0, 1]], "the course changes by 180 degrees at waypoint 2, more than 120"),
    "short": ([[0, 0], [200, 0], [200, 2000]], "leg 1 of the route is 200 m long and needs 404 m for its arcs"),
    "short in between": (
        [[0, 0], [2000, 0], [2000, 700], [4000, 700]], "leg 2 of the route is 700 m long and needs 809 m",
    ),
    "across itself": (
        [[0, 0], [3000, 0], [3000, 2000], [1500, 2000], [1500, -2000]],
        "legs 1 and 4 of the route come within 0 m of each other",
    ),
    "beside itself": (
        [[0, 0], [3000, 0], [3000, 1500], [1500, 1500], [1500, 60], [4500, 61]],
        "legs 1 and 4 of the route come within 60 m of each other, nearer than 70 m",
    ),
    "beyond": ([[0, 0], [1e6, 0]], f"the legs of a route must be {LONGEST:.0f} m together at most"),
    "overflow": ([[-1e308, 0], [1e308, 0]], f"the legs of a route must be {LONGEST:.0f} m together at most"),
}  # fmt: skip


@pytest.mark.parametrize(("waypoints", "sentence"), BAD.values(), ids=BAD)
def test_a_route_that_cannot_be_followed_is_refused_in_one_sentence(waypoints: Any, sentence: str) -> None:
    env = gym.make("SigmaChannel-v0")
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        env.reset(seed=0, options={"waypoints": waypoints})
    message = str(caught.value)
    assert message.startswith(sentence)
    assert "\n" not in message
    assert len(message) < 200


def followed(waypoints: np.ndarray) -> tuple[Any, Any]:
    """Waypoints and path of a route; None of one that is refused in a sentence."""
    try:
        return route(waypoints, RADIUS, 2.0 * TASK.margin)
    except ValueError as error:
        message = str(error)
    assert 20 < len(message) < 200
    return None, None


def test_random_routes_are_followed_or_refused() -> None:
    """Every list of numbers gives a path that keeps its promises, or one sentence."""
    rng, kept = np.random.default_rng(0), 0
    for _ in range(400):
        count = int(rng.integers(1, 11))
        waypoints = np.cumsum(rng.normal(0.0, 10.0 ** rng.uniform(1.0, 3.7), (count, 2)) + [rng.uniform(0, 2e3), 0], 0)
        points, path = followed(waypoints)
        if path is None:
            continue
        kept += 1
        np.testing.assert_allclose(path.pose(path.length)[:2], points[-1], atol=1e-5)
        assert (path.segments[:, 4] > 0.0).all()
    assert kept > 40


# --- files of waypoints -----------------------------------------------------------------------------

GOOD = {
    "route.csv": "north,east\n0,0\n1200,0\n2000,1100\n3400,900\n",
    "spaced.csv": "name, East , NORTH\r\nstart, 0, 0\r\n\r\nbuoy 1, 0, 1.2e3\r\nbuoy 2,1100,2000\r\nend,900,3400\r\n",
    "marked.csv": "\ufeffnorth,east\n0,0\n1200,0\n2000,1100\n3400,900",
    "route.toml": "waypoints = [[0, 0], [1200, 0.0],\n  [2000, 1100], [3400, 900]]\n",
}


@pytest.mark.parametrize("name", GOOD)
def test_waypoints_are_read_from_files(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(GOOD[name], encoding="utf-8", newline="")
    np.testing.assert_array_equal(read_waypoints(tmp_path / name), DOGLEG)
    assert scenarios(1, {"waypoints": read_waypoints(str(tmp_path / name))})[0, LENGTH] > 3000.0


@pytest.mark.parametrize("latitude", [-7.2, 0.0, 54.0, -70.0])
@pytest.mark.parametrize("longitude", [112.7, 179.99, -179.99])
def test_positions_are_projected_to_the_metre(tmp_path: Path, latitude: float, longitude: float) -> None:
    """Distances of 5 km against chords of the WGS 84 ellipsoid, in every direction and across the date line."""

    def cartesian(positions: np.ndarray) -> np.ndarray:
        phi, lam = np.deg2rad(positions).T
        axis, squared = 6378137.0, 6.69437999014e-3
        normal = axis / np.sqrt(1.0 - squared * np.sin(phi) ** 2)
        around = normal * np.cos(phi)
        return np.stack([around * np.cos(lam), around * np.sin(lam), normal * (1.0 - squared) * np.sin(phi)], -1)

    bearing = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    away = 5000.0 / 111e3 * np.stack([np.cos(bearing), np.sin(bearing) / np.cos(np.deg2rad(latitude))], -1)
    for each in away:
        positions = np.array([[latitude, longitude], np.array([latitude, longitude]) + each])
        name = tmp_path / "route.toml"
        name.write_text(f"positions = {positions.tolist()}")
        found = read_waypoints(name)
        (tmp_path / "route.csv").write_text(
            "latitude,longitude\n" + "\n".join(f"{a!r},{b!r}" for a, b in positions.tolist())
        )
        np.testing.assert_array_equal(read_waypoints(tmp_path / "route.csv"), found)
        chord = np.linalg.norm(np.diff(cartesian(positions), axis=0))
        assert np.hypot(*found[1]) == pytest.approx(chord, abs=1.0)
        assert (np.sign(np.round(found[1], 6)) == np.sign(np.round(each, 9))).all()


SPOILT = {
    "text": ("route.txt", "north,east\n0,0\n", "must end in .toml or .csv, got"),
    "empty": ("route.csv", "", "line 1: the header must have the columns north,east or latitude,longitude, got ''"),
    "header": ("route.csv", "x,y\n0,0\n", "line 1: the header must have the columns north,east or"),
    "both": ("route.csv", "north,east,latitude,longitude\n", "line 1: the header must have the columns north,east or"),
    "word": ("route.csv", "north,east\n0,0\n5,far\n", "line 3: east must be a finite number, got 'far'"),
    "short row": ("route.csv", "north,east\n0,0\n\n5\n", "line 4: east must be a finite number, got ''"),
    "nan": ("route.csv", "north,east\n0,nan\n", "line 2: east must be a finite number, got 'nan'"),
    "quote": ("route.csv", 'north,east\n0,"0\n', "line 1: unexpected end of data"),
    "polar": ("route.csv", "latitude,longitude\n89,0\n89,1\n", "latitudes must lie within 85 degrees"),
    "swapped": ("route.toml", "positions = [[112.7, -7.2], [112.8, -7.3]]", "latitudes must lie within 85 degrees"),
    "no TOML": ("route.toml", "waypoints = [[0, 0], [1, ", "line 1: not TOML"),
    "other key": ("route.toml", "way = 3", "line 1: a file of waypoints must have one key, waypoints or positions"),
    "two keys": ("route.toml", "waypoints = [[0, 0]]\npositions = [[0, 0]]", "line 1: a file of waypoints must"),
    "ragged": ("route.toml", "\nwaypoints = [[0, 0], [1]]", "line 2: waypoints must be rows of two finite numbers"),
    "infinite": ("route.toml", "waypoints = [[0, inf], [1, 2]]", "line 1: waypoints must be rows of two finite"),
}  # fmt: skip


@pytest.mark.parametrize(("name", "text", "sentence"), SPOILT.values(), ids=SPOILT)
def test_a_file_of_waypoints_that_is_wrong_is_refused_with_its_line(
    tmp_path: Path, name: str, text: str, sentence: str
) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=re.escape(sentence)) as caught:
        read_waypoints(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_file_of_bytes_is_refused_and_one_that_is_not_there_is_missed(tmp_path: Path) -> None:
    for name in ("route.csv", "route.toml"):
        (tmp_path / name).write_bytes(b"north,east\n\xff\xfe,0\n")
        with pytest.raises(ValueError, match=r"line \d: the file is not text in UTF-8"):
            read_waypoints(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        read_waypoints(tmp_path / "none.csv")


# --- flights ----------------------------------------------------------------------------------------


def flown(policy: Any, rows: int, disturbance: str) -> tuple[np.ndarray, np.ndarray]:
    """Scores and ends ``(rows,)``."""
    core = Core(SIGMA_CHANNEL, rows, estimator="truth", disturbance=disturbance)
    core.start(list(range(10_000, 10_000 + rows)))
    total, ends = np.zeros(rows), np.zeros(rows, int)
    for k in range(TASK.horizon):
        reward, end = core.step(policy(k, core))
        total += reward * (ends == 0)
        ends = np.where(ends == 0, end, ends)
    return total, ends


def test_in_a_calm_the_autopilot_stays_within_a_metre_of_the_axis() -> None:
    """On the truth, a minute after a start on the axis: its integral has found the current and the wind by then."""
    system = replace(SIGMA_CHANNEL, task=Exact(SHIP, offset=0.0, error=0.0))
    core, controller = Core(system, 32, estimator="truth", disturbance="calm"), make_controller("autopilot", system)
    core.start(0)
    controller.reset(32)
    for step in range(500):
        core.step(controller.act(core.observe()))
        off = np.abs(TASK.on_track(core.scenario, core.state[None, :, :2])[1]).max()
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
    ("disturbance", "least"), [("calm", 0.85), ("moderate", 0.75), ("rough", 0.55), ("moderate quartering", 0.45)]
)
def test_the_autopilot_arrives(disturbance: str, least: float) -> None:
    controller = make_controller("autopilot", SIGMA_CHANNEL)
    controller.reset(16)
    score, end = flown(lambda k, core: controller.act(core.observe()), 16, disturbance)
    assert (np.array(TASK.end_reasons)[end] == "arrived").all()
    assert score.mean() > least


def test_loitering_on_the_axis_does_not_pay() -> None:
    """A ship that is put back again and again to where she began is on the axis, and gets no further."""
    core = Core(SIGMA_CHANNEL, 8, estimator="truth", disturbance="calm")
    core.start(0)
    state = core.state.copy()
    total = np.zeros(8)
    for _ in range(200):
        reward, _ = core.step(np.zeros((8, 1)))
        total += reward
        core.now.state = state.copy()
    assert total.max() < 3.0 * TASK.dt * SHIP.speed / (TASK.leg * SHIP.length)


def scored(along: float, off: float, course: float = 0.0, turned_by: float = 0.0, farthest: float = 0.0) -> Any:
    """Reward and end of a ship at service speed in still water."""
    scenario, state = scenarios(1), np.zeros((1, 8))
    state[0, :2] = turned(np.array([along, off]), scenario[0, HEADING])
    state[0, 2], state[0, 3] = scenario[0, HEADING] + course, SHIP.speed
    reference = TASK.reference(scenario, np.zeros(1, int), state[:, :6])
    rudder, still = np.full((1, 1), turned_by * SHIP.rudder_rate * TASK.dt), np.zeros((1, 8))
    reward, end, _ = TASK.score(
        state, still, reference, np.zeros(1, bool), rudder, 0.0 * rudder, np.array([[farthest, 0.0, 0.0]])
    )  # fmt: skip
    return float(reward[0]), TASK.end_reasons[int(end[0])]


def test_a_perfect_step_is_worth_its_share_and_every_error_costs() -> None:
    length = TASK.leg * SHIP.length
    whole = 10.0 / length
    assert scored(10.0, 0.0) == (pytest.approx(whole, rel=1e-9), "")
    assert scored(10.0, 7.0)[0] == pytest.approx(0.5 * whole, rel=1e-9)
    assert scored(10.0, 0.0, course=0.05)[0] == pytest.approx(0.85 * whole, rel=1e-9)
    assert scored(10.0, 0.0, turned_by=0.5)[0] == pytest.approx(whole / (1.0 + 0.5 * (1.25 + 2.0)), rel=1e-9)
    assert scored(10.0, 0.0, farthest=10.0)[0] == 0.0
    assert scored(length + 5.0, 0.0, farthest=length - 5.0) == (pytest.approx(5.0 / length, rel=1e-9), "arrived")
    for side in (-1.0, 1.0):
        assert scored(10.0, 27.9 * side)[1] == ""
        assert scored(10.0, 28.1 * side) == (0.0, "aground")


@pytest.mark.parametrize("sea", ["moderate", "rough"])
def test_bow_seas_raise_the_frequency_of_encounter_and_quartering_seas_lower_it(sea: str) -> None:
    """Against ``w - k U cos(beta)``, and in the yaw that waves give a ship that is held on the axis."""
    for name in (sea, f"{sea} quartering"):
        seaway: Any = SIGMA_CHANNEL.disturbances[name]
        core, controller = (
            Core(SIGMA_CHANNEL, 16, estimator="truth", disturbance=name),
            make_controller("autopilot", SIGMA_CHANNEL),
        )
        core.start(0)
        controller.reset(16)
        d = []
        for _ in range(400):
            core.step(controller.act(core.observe()))
            d.append(core.unknown_input[:, 0].copy())
        beta, w = seaway.direction - core.scenario[:, HEADING], seaway.waves.frequencies[1]
        met = np.abs(encounter_frequency(np.array(w), beta, np.array(SHIP.speed))).mean()
        assert (met > 1.5 * w) if name == sea else (met < 0.4 * w)
        # The frequency below which half of the power is: measured to 0.03 rad/s in 200 s, and bands lie to both sides.
        power = (np.abs(np.fft.rfft(np.array(d) * np.hanning(400)[:, None], axis=0)) ** 2).mean(1)
        middle = 2.0 * np.pi * np.fft.rfftfreq(400, TASK.dt)[np.searchsorted(power.cumsum(), 0.5 * power.sum())]
        assert middle == pytest.approx(met, rel=0.1, abs=0.05)


def test_a_route_in_a_batch_flies_as_alone() -> None:
    batch = gym.make_vec("SigmaChannel-v0", 3, vectorization_mode="vector_entry_point")
    seen, _ = batch.reset(seed=6, options={"waypoints": DOGLEG})
    alone = [gym.make("SigmaChannel-v0") for _ in range(3)]
    for row, env in enumerate(alone):
        np.testing.assert_array_equal(env.reset(seed=6 + row, options={"waypoints": DOGLEG})[0], seen[row])
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
    np.testing.assert_allclose(mission[0, 1:].reshape(-1, 2), expected / (10.0 * SHIP.length), atol=1e-9)
    assert mission[0, 0] == 1.0
    assert scenario[0, LENGTH] == pytest.approx(route(DOGLEG, RADIUS)[1].length)
