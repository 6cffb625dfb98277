"""The dives: their courses, what the agent may see, and how they are scored."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contract import sizes_by_mode
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from estimators import Gaussian
from vessel_gym.envs import ItsunusaAUVEnv, SegorogeniAUVEnv
from vessel_gym.guidance.dive_path import arc_to, path_point
from vessel_gym.models.state_space import StateSpace
from vessel_gym.sensors import SUITES, Sensors
from vessel_gym.simulation.core import Core
from vessel_gym.system import Estimate, System
from vessel_gym.tasks.dive import Dive, SpatialDive, VerticalDive
from vessel_gym.tasks.task import observation_sizes

SPATIAL, VERTICAL = SegorogeniAUVEnv.system, ItsunusaAUVEnv.system
DIVES = pytest.mark.parametrize("system", [SPATIAL, VERTICAL], ids=lambda system: system.name)


def state(task: Dive, position: Any, pitch: Any = 0.0, heading: Any = 0.0) -> np.ndarray:
    """States ``(B, n)`` of a vehicle at positions ``(B, 3)``, at cruising speed."""
    position = np.atleast_2d(np.asarray(position, float))
    x = np.zeros((len(position), states(task)))
    x[:, 0] = task.auv.cruise_speed
    if isinstance(task, VerticalDive):
        x[:, 3:5], x[:, 5] = position[:, ::2], pitch
    else:
        x[:, 6:9], x[:, 10], x[:, 11] = position, pitch, heading
    return x


def states(task: Dive) -> int:
    """How many components the vehicle's state has."""
    return len(task.prior_sd)


def ambient_flows(task: Dive) -> int:
    """How many components the current has."""
    return 1 if isinstance(task, VerticalDive) else 2


def belief(mean: np.ndarray, flow: np.ndarray | None = None) -> Estimate:
    """What is believed of the state, in a current or none."""
    mean = np.asarray(mean, float)
    return Estimate(mean, np.zeros((len(mean), 2)) if flow is None else flow)


def score(
    task: Dive, truth: np.ndarray, scenario: np.ndarray, *given: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `Dive.score` says where nothing acts."""
    reference, *others = given
    scenario = np.atleast_2d(scenario)
    still, over = np.zeros((len(truth), 8)), task.over(scenario, reference)
    return task.score(truth, still, scenario, reference, over, *others)


def sensors_of(system: System) -> Sensors:
    vehicle = system.vehicle
    return Sensors(
        SUITES["nominal"].of(vehicle.sensors),
        vehicle.state_names,
        vehicle.increments + vehicle.ambient_flows,
        0.1,
    )


def sizes(system: System) -> dict[str, int]:
    """The lengths of observations beside the nominal sensors and a filter that is told of the current."""
    task, sensors = system.task, sensors_of(system)
    return sizes_by_mode(
        observation_sizes(task, system.vehicle, sensors.size, states(task) + ambient_flows(task))
    )


def scenarios(task: Dive, n: int, seed: int = 0) -> np.ndarray:
    return task.scenario(np.random.default_rng(seed).random((n, 3)), {})


def believed(task: Dive, mean: np.ndarray, scenario: np.ndarray) -> np.ndarray:
    return task.reference(scenario, np.zeros(len(mean)), np.asarray(mean, float))


def trim(task: Dive, rows: int = 1) -> np.ndarray:
    """Actuators ``(rows, a)`` of cruising straight on."""
    actuators = np.zeros(
        (rows, task.scaled(np.zeros((1, 2 + isinstance(task, SpatialDive)))).shape[1])
    )
    actuators[:, -1] = task.auv.cruise_thrust
    return actuators


def remembered(task: Dive, progress_and_energy: Any) -> np.ndarray:
    """Score states ``(B, k)`` with fins amidships and at rest."""
    first = np.asarray(progress_and_energy, float)
    return np.concatenate([first, np.zeros((len(first), 2 * (task.actuators - 1)))], -1)


# --- courses --------------------------------------------------------------------------------------


@DIVES
def test_goals_are_drawn_evenly_from_their_box(system: System):
    task = system.task
    scenario = scenarios(task, 4000)
    goals = path_point(scenario[:, 1], scenario)[:, :3]
    low, high = np.array(task.goal) - task.goal_spread, np.array(task.goal) + task.goal_spread
    assert (goals >= low - 1e-5).all()  # a straight path bends a little, see the path
    assert (goals <= high + 1e-5).all()
    for axis in np.flatnonzero(task.goal_spread):
        share = np.sort((goals[:, axis] - low[axis]) / (high - low)[axis])
        # Kolmogorov and Smirnov's distance of 4000 draws: false-alarm rate 1e-6
        assert np.abs(share - (np.arange(4000) + 0.5) / 4000).max() < 0.043


@DIVES
def test_every_goal_of_the_box_may_be_requested(system: System):
    task = system.task
    for corner in np.ndindex(3, 3, 3):
        goal = np.array(task.goal) + np.array(task.goal_spread) * (np.array(corner) - 1.0)
        scenario = task.scenario(np.zeros((2, 3)), {"goal": goal})
        np.testing.assert_allclose(
            path_point(scenario[:, 1], scenario)[:, :3], [goal, goal], atol=1e-5
        )


@pytest.mark.parametrize("goal", ["deep", (1.0, 2.0), (10.0, np.nan, 3.0), [{}]], ids=repr)
def test_goal_must_be_three_finite_numbers(goal: Any):
    with pytest.raises(ValueError, match=r"^goal must be") as why:
        SPATIAL.task.scenario(np.zeros((1, 3)), {"goal": goal})
    assert (
        str(why.value)
        == f"goal must be three numbers within +-100000, metres north, east and down of the start, got {goal!r}"
    )


BAD_GOALS = [
    (SPATIAL, (3.0, 0.0, 0.5), r"the length of the path to the goal must be 3\.9 to 40\.0 m, got 3\.0 m"),
    (SPATIAL, (-10.0, 1e-9, 3.0), r"the turn of the path to the goal must be 0\.0 to 270\.0 deg, got 360\.0 deg"),
    (SPATIAL, (0.0, 7.0, 1.0), r"the radius of the path to the goal must be 3\.9 to inf m, got 3\.5 m"),
    (SPATIAL, (20.0, 0.0, 9.4), r"the depth of the path to the goal must be 0\.0 to 9\.3 m, got 9\.4 m"),
    (VERTICAL, (73.0, 0.0, 1.0), r"the length of the path to the goal must be 8\.0 to 72\.0 m, got 73\.0 m"),
    (VERTICAL, (60.0, 1.0, 20.0), r"the goal must lie ahead, \(x, 0, z\) with x > 0: .* does not turn, got \(60.*\)"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("system", "goal", "sentence"), BAD_GOALS, ids=lambda value: str(value)[:30]
)
def test_goal_beyond_a_limit_is_refused_with_the_limit(
    system: System, goal: tuple[float, float, float], sentence: str
):
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        system.task.scenario(np.zeros((1, 3)), {"goal": goal})


# --- the start ------------------------------------------------------------------------------------


@DIVES
def test_prior_is_level_at_path_start_at_cruising_speed(system: System):
    task, scenario = system.task, scenarios(system.task, 3)
    prior, n = task.prior(scenario), states(task)
    np.testing.assert_array_equal(prior.mean, state(task, np.zeros((3, 3))))
    assert prior.cov.shape == (n, n)
    for water in system.disturbances.values():
        space = StateSpace.of_world(system.vehicle, water, sensors_of(system))
        cov = space.joint_prior(prior.cov)
        assert (
            np.linalg.eigvalsh(cov[: n + ambient_flows(task), : n + ambient_flows(task)]).min()
            > 0.0
        )
        assert not cov[:n, n:].any()  # velocities are through the water: no current carries them
        np.testing.assert_array_equal(cov[:n, :n], prior.cov)
        m, beside = n + ambient_flows(task), getattr(water, "beside", water)
        np.testing.assert_allclose(np.diag(cov)[n:m], beside.current**2 / ambient_flows(task))
        assert not cov[m:, m:].any()  # the current has not carried the water yet
    np.testing.assert_allclose(believed(task, prior.mean, scenario)[:, :3], 0.0, atol=1e-12)


@DIVES
def test_known_input_holds_actuators_before_and_after_a_step(system: System):
    before, after = np.arange(4.0).reshape(2, 2), 10.0 + np.arange(4.0).reshape(2, 2)
    told = system.vehicle.known_input(
        before, after, system.task.commanded(scenarios(system.task, 2), np.zeros(2))
    )
    np.testing.assert_array_equal(told[:, :4], [[0, 1, 10, 11], [2, 3, 12, 13]])


def test_known_input_holds_the_path_angle_at_cruising_speed():
    system = VERTICAL
    scenario, step = scenarios(system.task, 2), np.array([0, 200])
    told = system.vehicle.known_input(
        np.zeros((2, 2)), np.zeros((2, 2)), system.task.commanded(scenario, step)
    )
    there = path_point(np.array([0.0, 30.0]), scenario)  # 20 s at 1.5 m/s
    np.testing.assert_allclose(np.tan(told[:, 4]), -there[:, 4], rtol=1e-12)
    np.testing.assert_array_equal(told[:, 5], 1.0)
    late = system.task.commanded(scenario, np.array([2000, 3000]))
    np.testing.assert_allclose(late, 0.0, atol=1e-12)  # level beyond the path's end
    assert system.vehicle.known_input(np.zeros((1, 2)), np.zeros((1, 2)), None)[0, 4] == 0.0


# --- what the agent sees --------------------------------------------------------------------------


def body_axes(task: Dive, x: np.ndarray) -> Rotation:
    """From body to earth, by Fossen's yaw, then pitch, then roll."""
    if isinstance(task, VerticalDive):
        return Rotation.from_euler("Y", x[:, 5:6])
    return Rotation.from_euler("ZYX", x[:, [11, 10, 9]])


def random_states(task: Dive, rng: np.random.Generator, rows: int = 300) -> np.ndarray:
    """States anywhere about the path, with any attitude, at the poles of the Euler angles, too."""
    x = rng.normal(0.0, 1.0, (rows, states(task)))
    x[:, 0] += task.auv.cruise_speed
    poles = np.array([1.55, -1.55, np.pi / 2, -np.pi / 2, 1.6])
    if isinstance(task, VerticalDive):
        x[:, 3] += rng.uniform(-10.0, 80.0, rows)
        x[:, 4] += rng.uniform(-3.0, 25.0, rows)
        x[:, 5] = rng.uniform(-1.5, 1.5, rows)
        x[:5, 5] = poles
    else:
        x[:, 6:9] += rng.uniform([-5.0, -5.0, -2.0], [15.0, 25.0, 8.0], (rows, 3))
        x[:, 9:12] = rng.uniform([-3.0, -1.5, -9.0], [3.0, 1.5, 9.0], (rows, 3))
        x[:5, 10] = poles
    return x


@DIVES
def test_observed_vectors_are_rotated_into_body_axes(system: System):
    task, rng = system.task, np.random.default_rng(3)
    x, scenario = random_states(task, rng), scenarios(task, 300, 3)
    reference = believed(task, x, scenario)
    current = np.zeros((300, 3))
    current[:, : ambient_flows(task)] = rng.normal(size=(300, ambient_flows(task)))
    seen = task.named(
        task.observe(
            belief(x, current[:, : ambient_flows(task)]), scenario, reference, trim(task, 300)
        )
    )
    position, inverse = task.position(x), body_axes(task, x).inv()
    closest = path_point(reference[:, 0], scenario)
    vectors = {
        "path": closest[:, :3] - position,
        "look": path_point(reference[:, 0] + task.ahead, scenario)[:, :3] - position,
        "current": current,
    }
    for name, vector in vectors.items():
        if name == "path" and isinstance(task, VerticalDive):
            vector[:, 0] = 0.0  # right above or below
        expected = inverse.apply(vector)
        # beyond the ends of the path, "path" is still abreast of the vehicle: perpendicular in plan
        for axis, words in enumerate(("ahead", "to starboard", "below")):
            if f"{name} {words}" in task.observed:
                np.testing.assert_allclose(
                    seen[f"{name} {words}"], expected[:, axis], rtol=0, atol=1e-8, err_msg=name
                )


@DIVES
def test_observed_errors_and_estimates_are_as_named(system: System):
    task, rng, names = system.task, np.random.default_rng(4), system.vehicle.state_names
    x, scenario = random_states(task, rng), scenarios(task, 300, 4)
    reference = believed(task, x, scenario)
    observation = task.observe(belief(x), scenario, reference, trim(task, 300))
    seen, column = task.named(observation), dict(zip(names, x.T, strict=True))
    _, _, _, heading, slope = path_point(reference[:, 0], scenario).T
    expected = {
        "pitch error": -np.arctan(slope) - column["theta"],
        "remaining": scenario[:, 1] - reference[:, 0],
        "surge error": column["u"] - task.auv.cruise_speed,
        "heave": column["w"], "pitch rate": column["q"], "pitch": column["theta"],
    }  # fmt: skip
    if isinstance(task, SpatialDive):
        turn = heading - column["psi"]
        expected |= {
            "heading error": np.arctan2(np.sin(turn), np.cos(turn)), "curvature": scenario[:, 0] / scenario[:, 1],
            "sway": column["v"], "roll rate": column["p"], "yaw rate": column["r"], "roll": column["phi"],
        }  # fmt: skip
    for name, values in expected.items():
        np.testing.assert_allclose(seen[name], values, rtol=0, atol=1e-9, err_msg=name)
    vectors = {name for name in task.observed if name.split()[0] in ("path", "look", "current")}
    assert set(expected) | vectors == set(task.observed)
    assert (
        len(task.observed) + len(system.vehicle.action_names)
        == sizes(system)["mean"]
        == observation.shape[1]
    )


@DIVES
def test_observed_standard_deviations_are_one_at_the_start(system: System):
    task = system.task
    core = Core(system, 2, "ekf", observe="mean+std")
    core.seed(0)
    seen = []
    for factor in (1.0, 4.0, -1.0):
        core.reset()
        known = Gaussian(
            core.now.belief.mean,
            core.config.world.space.joint_prior(task.prior(core.now.scenario).cov),
        )
        core.now.belief = core.config.estimation.filter.init(known)
        core.now.belief = core.now.belief.replace(cov=factor * core.now.belief.cov)
        seen.append(core.observe()[:, -states(task) - ambient_flows(task) :])
    assert core.observe().shape == (2, sizes(system)["mean"] + states(task) + ambient_flows(task))
    assert (seen[0] > 0.3).all()
    assert (seen[0] < 1.5).all()
    np.testing.assert_allclose(seen[1], 2.0 * seen[0], rtol=1e-6)  # float32
    assert (seen[2] == 0.0).all()  # whatever a filter may do


@DIVES
def test_actuators_are_seen_relative_to_their_limits(system: System):
    body, task = system.vehicle.body, system.task
    actuators = trim(task, 3)
    actuators[:, :-1] = body.fin_limit * np.array([[1.0], [-0.5], [0.0]])
    actuators[:, -1] = body.thrust_limit * np.array([0.0, 0.5, 1.0])
    scaled = task.scaled(actuators)
    np.testing.assert_allclose(scaled[:, :-1], np.tile([[1.0], [-0.5], [0.0]], scaled.shape[1] - 1))
    np.testing.assert_allclose(scaled[:, -1], [-1.0, 0.0, 1.0])


@DIVES
def test_raw_observation_is_measurements_mask_and_course(system: System):
    task, sensors = system.task, sensors_of(system)
    p = sensors.size
    scenario, rng = scenarios(task, 3, 9), np.random.default_rng(9)
    measurements, available = rng.normal(size=(3, p)), rng.random((3, p)) < 0.5
    measurements = np.where(available, measurements, 0.0)
    raw = task.observe_measurements(sensors, measurements, available, scenario, np.zeros(3))
    seen = np.hstack([raw, task.observe_mission(scenario, np.zeros(3), trim(task, 3))])
    assert seen.shape == (3, sizes(system)["measurement"])
    np.testing.assert_array_equal(seen[:, p : 2 * p], available)
    assert ((seen[:, :p] == 0.0) == ~available).all()
    np.testing.assert_allclose(seen[:, :p], measurements / sensors.scale)
    assert sensors.scale.shape == (p,)
    assert (sensors.scale >= sensors.sd).all()  # what counts as 1 is no noise
    shown = seen[:, 2 * p : -len(system.vehicle.action_names)]
    for row in range(3):  # the course can be told from what is shown
        assert len(np.unique(np.round(shown[:, -2], 12))) == 3
        assert (shown[row, -2:] != 0.0).all()


# --- score ----------------------------------------------------------------------------------------


def fly(
    task: Dive, scenario: np.ndarray, positions: np.ndarray, pitch: Any = 0.0, thrust: Any = None, error: Any = 0.0,
    fin: Any = 0.0,
) -> tuple[np.ndarray, str, np.ndarray]:  # fmt: skip
    """Rewards ``(k,)``, end and last score state of a flight through positions ``(k + 1, 3)``, to its end or the last.

    Args:
        task: The task.
        scenario: ``(3,)``.
        positions: Where the vehicle truly is.
        pitch: rad.
        thrust: N; None: that of cruising.
        error: ``(3,)`` where it believes to be less where it is.
        fin: rad, of every fin after each step ``(k + 1,)``, or of all.
    """
    scenario, actuators = scenario[None], trim(task)
    if thrust is not None:
        actuators[:, -1] = thrust
    score_state, rewards, end = task.initial_score_state(state(task, positions[0]), scenario), [], 0
    for position, angle in zip(positions[1:], np.broadcast_to(fin, len(positions)), strict=False):
        truth, actuators[:, :-1] = state(task, position, pitch), angle
        reference = believed(task, state(task, np.asarray(position) + error), scenario)
        reward, number, score_state = score(
            task, truth, scenario, reference, actuators, np.zeros_like(actuators), score_state
        )
        rewards.append(float(reward[0]))
        end = int(number[0])
        if end:
            break
    return np.array(rewards), task.end_reasons[end], score_state[0]


def along(scenario: np.ndarray, s: np.ndarray, cross: Any = 0.0, below: Any = 0.0) -> np.ndarray:
    """Positions ``(k, 3)`` at progress s, off the path to starboard and below."""
    x, y, z, heading, _ = path_point(s, scenario).T
    return np.stack([x - cross * np.sin(heading), y + cross * np.cos(heading), z + below], -1)


def cruise(task: Dive, scenario: np.ndarray, slower: float = 1.0) -> np.ndarray:
    """Progress ``(k,)`` at cruising speed along the path, from its beginning to just beyond its end."""
    s = np.linspace(0.0, scenario[1], 4000)
    metres = np.sqrt(1.0 + path_point(s, scenario)[:, 4] ** 2)
    track = np.concatenate([[0.0], np.cumsum(0.5 * (metres[1:] + metres[:-1]) * np.diff(s))])
    steps = np.arange(0.0, track[-1], task.auv.cruise_speed * task.dt / slower)
    return np.append(np.interp(steps, track, s), scenario[1] + 1e-9)


@DIVES
def test_perfect_dive_scores_one_and_a_faster_one_no_more(system: System):
    task = system.task
    for scenario in scenarios(task, 5, 10):
        rewards, end, score_state = fly(task, scenario, along(scenario, cruise(task, scenario)))
        assert end == "arrived"
        assert rewards.min() >= 0.0
        assert 0.98 < rewards.sum() <= 1.0
        assert rewards[:-1].sum() == pytest.approx(task.TRACKING, rel=2e-2)
        assert score_state[0] == pytest.approx(scenario[1])
        for faster in (0.2, 0.4):  # five times as fast: not every metre counts then
            assert (
                fly(task, scenario, along(scenario, cruise(task, scenario, faster)))[0].sum() <= 1.0
            )


@DIVES
def test_distance_from_the_path_costs_what_is_documented(system: System):
    task, scenario = system.task, scenarios(system.task, 1, 12)[0]
    s = cruise(task, scenario)[:-10]
    on = fly(task, scenario, along(scenario, s))[0]
    for below, share in ((0.25, 0.5), (-0.25, 0.5), (0.5, 0.2), (-1.0, 1 / 17)):
        slope = path_point(s, scenario)[:, 4]
        off = fly(task, scenario, along(scenario, s, below=below * np.sqrt(1.0 + slope**2)))[
            0
        ]  # as far at right angles
        np.testing.assert_allclose(off, share * on, rtol=1e-6, atol=1e-12)
    if isinstance(task, SpatialDive):
        for cross, share in ((0.25, 0.5), (-0.25, 0.5), (0.75, 0.1)):
            off = fly(task, scenario, along(scenario, s, cross))[0]
            np.testing.assert_allclose(off, share * on, rtol=1e-6, atol=1e-12)
            both = fly(task, scenario, along(scenario, s[:2], cross, 0.0))[0]
            np.testing.assert_allclose(both, off[:1])


@pytest.mark.slow
@DIVES
def test_every_metre_pays_the_same(system: System):
    task, scenario = system.task, scenarios(system.task, 1, 13)[0]
    length = scenario[1]
    for step in (0.02, 0.1, 0.2):
        s = np.arange(0.0, 0.9 * length, step)
        rewards, _, score_state = fly(task, scenario, along(scenario, s))
        np.testing.assert_allclose(rewards, task.TRACKING * step / length, rtol=1e-6)
        assert score_state[0] == pytest.approx(s[-1])


@DIVES
def test_a_leap_pays_for_the_fastest_step_only(system: System):
    task, scenario = system.task, scenarios(system.task, 1, 14)[0]
    most = task.FASTEST * task.auv.cruise_speed * task.dt
    rewards, _, score_state = fly(
        task, scenario, along(scenario, np.array([0.0, 0.8 * scenario[1]]))
    )
    assert rewards[0] == pytest.approx(task.TRACKING * most / scenario[1])
    assert score_state[0] == pytest.approx(most)


@DIVES
def test_path_behind_the_start_does_not_pay(system: System):
    """A vehicle that begins ahead of the path's beginning has those metres behind it; one behind gets nothing more."""
    task, scenario = system.task, scenarios(system.task, 1, 15)[0]
    for first in (-2.0, -0.5, 0.0, 0.7):
        s = np.arange(first, 0.5 * scenario[1], 0.1)
        rewards, _, _ = fly(task, scenario, along(scenario, s))
        assert rewards.sum() == pytest.approx(
            task.TRACKING * (s[-1] - max(first, 0.0)) / scenario[1]
        )


waypoints = st.lists(
    st.tuples(st.floats(-0.28, 0.28), st.floats(-1.5, 1.5), st.floats(-1.0, 1.0)),
    min_size=3,
    max_size=40,
)
"""Steps along the path, all of which count, and where beside it."""


@pytest.mark.slow
@DIVES
@settings(derandomize=True, max_examples=40, deadline=None)
@given(
    steps=waypoints, detour=waypoints, when=st.floats(0.0, 1.0), arrive=st.booleans(), throttle=st.floats(0.0, 1.0)
)  # fmt: skip
def test_no_detour_ever_raises_the_score(
    system: System, steps: list, detour: list, when: float, arrive: bool, throttle: float
):
    """Loitering, circling, waiting and going back, put into a flight: out from a place that it meets, and back to it.

    The detour stays behind the farthest place so far: one that goes on covers new metres, and may
    cover them better.
    """
    task, scenario = system.task, np.array([0.4, 24.0, 3.0])
    if isinstance(task, VerticalDive):
        scenario[0] = 0.0
    turning = float(isinstance(task, SpatialDive))

    def places(moves: list, s: float, farthest: float = np.inf) -> np.ndarray:
        listed = []
        for step, cross, below in moves:
            s = min(s + step, farthest)
            listed.append((s, turning * cross, below))
        return np.array(listed)

    out = places(steps, 0.0)
    if arrive:
        rest = np.arange(max(out[-1, 0], 0.0), scenario[1] + 0.1, 0.14)
        out = np.concatenate([out, np.stack([rest, 0.0 * rest, 0.0 * rest], -1)])
    i = round(when * (len(out) - 1))
    away = places(detour, out[i, 0], max(out[: i + 1, 0].max(), 0.0))
    with_detour = np.concatenate([out[: i + 1], away, out[i:]])
    thrust = throttle * task.auv.thrust_limit
    direct = fly(task, scenario, along(scenario, *out.T), thrust=thrust)[0].sum()
    longer = fly(task, scenario, along(scenario, *with_detour.T), thrust=thrust)[0].sum()
    assert longer <= direct + 1e-12


@DIVES
def test_ending_early_forgoes_the_rest(system: System):
    """Who believes to have arrived half way is paid for half the way, and next to nothing for arriving."""
    task, scenario = system.task, scenarios(system.task, 1, 16)[0]
    positions = along(scenario, cruise(task, scenario))
    rewards, _, _ = fly(task, scenario, positions)
    beyond = believed(
        task, state(task, path_point(scenario[1] + 1e-6, scenario)[:3]), scenario[None]
    )
    for share in (0.2, 0.5, 0.8, 0.95):
        flown = int(share * len(rewards))
        early, end, score_state = fly(task, scenario, positions[: flown + 1])
        assert end == ""
        np.testing.assert_array_equal(early, rewards[:flown])
        truth = state(task, positions[flown + 1])
        last, number, _ = score(
            task, truth, scenario, beyond, trim(task), 0.0 * trim(task), score_state[None]
        )
        miss = np.linalg.norm(positions[flown + 1] - positions[-1])
        assert task.end_reasons[number[0]] == "missed the goal"
        arriving = (1.0 - task.TRACKING) / (1.0 + (miss / task.GOAL_TOLERANCE) ** 2)
        assert last[0] <= (rewards[flown] + arriving) * (1.0 + 1e-6)
        assert early.sum() + last[0] < rewards.sum() - 0.9 * task.TRACKING * (1.0 - share)


@DIVES
def test_arrival_is_by_estimate_and_paid_by_truth(system: System):
    """The dive goes on while the vehicle believes to have some way to go, and ends when it believes to be there."""
    task, scenario = system.task, scenarios(system.task, 1, 17)[0]
    goal = path_point(scenario[1], scenario)
    onward = np.array([np.cos(goal[3]), np.sin(goal[3]), 0.0])
    energy = (
        0.5 * scenario[1] / task.auv.cruise_speed
    )  # less than cruising takes: economy is at most 1
    for miss, end in (
        (0.0, "arrived"),
        (0.3, "arrived"),
        (0.49, "arrived"),
        (0.51, "missed the goal"),
        (3.0, "missed the goal"),
    ):
        for direction in (-onward, onward, np.array([0.0, 0.0, 1.0 if miss < 2.5 else -1.0])):
            truth = state(task, goal[:3] + miss * direction)
            arrived = believed(task, state(task, goal[:3] + 1e-6 * onward), scenario[None])
            near = believed(task, state(task, goal[:3] - 1e-3 * onward), scenario[None])
            score_state = remembered(task, [[scenario[1], energy]])
            reward, number, _ = score(
                task, truth, scenario, arrived, trim(task), 0.0 * trim(task), score_state
            )
            assert task.end_reasons[number[0]] == end
            assert reward[0] == pytest.approx(
                (1 - task.TRACKING) / (1 + (miss / task.GOAL_TOLERANCE) ** 2)
            )
            reward, number, _ = score(
                task, truth, scenario, near, trim(task), 0.0 * trim(task), score_state
            )
            assert (reward[0], number[0]) == (0.0, 0)


def final_reward(task: Dive, scenario: np.ndarray, thrust: float, seconds: float) -> float:
    """What arriving at the goal pays after so long at one thrust."""
    goal = state(task, path_point(scenario[1], scenario)[:3])
    steps, actuators = round(seconds / task.dt), trim(task)
    actuators[:, -1] = thrust
    score_state = remembered(task, [[scenario[1], 0.0]])
    beyond = believed(
        task, state(task, path_point(scenario[1] + 1e-6, scenario)[:3]), scenario[None]
    )
    before = believed(
        task, state(task, path_point(scenario[1] - 0.1, scenario)[:3]), scenario[None]
    )
    for _ in range(steps - 1):
        reward, _, score_state = score(
            task, goal, scenario, before, actuators, 0.0 * actuators, score_state
        )
        assert reward[0] == 0.0
    return float(score(task, goal, scenario, beyond, actuators, 0.0 * actuators, score_state)[0][0])


@DIVES
def test_arriving_pays_by_the_energy_of_a_cruise_over_that_used(system: System):
    task, scenario = system.task, scenarios(system.task, 1, 18)[0]
    cruising, most = task.auv.cruise_thrust, 1.0 - task.TRACKING
    straight = np.hypot(scenario[1], scenario[2]) / task.auv.cruise_speed
    assert final_reward(task, scenario, cruising, straight) == pytest.approx(most, rel=1e-2)
    assert final_reward(task, scenario, cruising, 2.0 * straight) == pytest.approx(
        0.5 * most, rel=1e-2
    )
    assert final_reward(task, scenario, 0.0, 1.5 * straight) == pytest.approx(
        most, rel=1e-2
    )  # hotel load: two thirds
    assert final_reward(task, scenario, 0.0, 3.0 * straight) == pytest.approx(0.5 * most, rel=1e-2)
    assert final_reward(task, scenario, 4.0 ** (2 / 3) * cruising, straight) == pytest.approx(
        0.5 * most, rel=1e-2
    )
    assert final_reward(task, scenario, 0.1 * cruising, 0.5 * straight) == pytest.approx(
        most
    )  # never more than all of it


@DIVES
def test_cruising_speed_is_the_cheapest_within_three_percent(system: System):
    """Slower takes hotel load for longer, faster takes power: drag is quadratic, the speed goes as its root."""
    task = system.task
    assert task.power(trim(task))[0] == pytest.approx(1.0)
    speed = np.linspace(0.3, 1.4, 200)
    actuators = trim(task, 200)
    actuators[:, -1] *= speed**2
    cost = task.power(actuators) / speed
    assert cost.min() > 0.97
    assert speed[cost.argmin()] == pytest.approx(1.0, abs=0.03)


# --- ends -----------------------------------------------------------------------------------------


def ended(task: Dive, position: Any, scenario: np.ndarray, pitch: float = 0.0) -> str:
    """The end of a vehicle that believes to be at the path's beginning."""
    truth, reference = (
        state(task, position, pitch),
        believed(task, state(task, [0.0, 0.0, 0.0]), scenario[None]),
    )
    score_state = task.initial_score_state(state(task, [0.0, 0.0, 0.0]), scenario[None])
    return task.end_reasons[
        score(task, truth, scenario, reference, trim(task), 0.0 * trim(task), score_state)[1][0]
    ]


@DIVES
def test_each_failure_ends_the_dive_at_its_limit(system: System):
    task, scenario = system.task, scenarios(system.task, 1, 19)[0]
    middle, length, depth = 0.5 * scenario[1], scenario[1], scenario[2]
    slope = path_point(middle, scenario)[4]
    steep = np.sqrt(1.0 + slope**2)
    assert ended(task, along(scenario, np.array([middle])), scenario) == ""
    assert ended(task, along(scenario, np.array([middle]), below=-4.99 * steep), scenario) in (
        "",
        "surfaced",
    )
    surface = -task.launch_depth
    assert ended(task, [0.0, 0.0, surface + 0.01], scenario) == ""
    assert ended(task, [0.0, 0.0, surface - 0.01], scenario) == "surfaced"
    bottom = depth + task.margin
    assert ended(task, [*path_point(length, scenario)[:2], bottom - 0.01], scenario) == ""
    assert ended(task, [*path_point(length, scenario)[:2], bottom + 0.01], scenario) == "too deep"
    for side in (1.0, -1.0):
        assert ended(task, [0.0, 0.0, 0.0], scenario, side * (task.PITCH_LIMIT - 0.01)) == ""
        assert (
            ended(task, [0.0, 0.0, 0.0], scenario, side * (task.PITCH_LIMIT + 0.01))
            == "pitched over"
        )
    below = along(scenario, np.array([0.9 * middle]), below=0.0)[0]
    distance = task.LOST * np.sqrt(1.0 + path_point(0.9 * middle, scenario)[4] ** 2)
    if below[2] + distance < bottom:
        assert ended(task, below + [0.0, 0.0, distance + 0.01], scenario) == "off the path"
        assert ended(task, below + [0.0, 0.0, distance - 0.01], scenario) == ""
    if isinstance(task, SpatialDive):
        for cross in (4.99, -4.99):
            assert ended(task, along(scenario, np.array([middle]), cross), scenario) == ""
            assert (
                ended(task, along(scenario, np.array([middle]), cross * 1.01), scenario)
                == "off the path"
            )


@DIVES
def test_estimated_arrival_overrides_every_other_end(system: System):
    """The mission is over then; where the vehicle truly is says whether it was a success."""
    task, scenario = system.task, scenarios(system.task, 1, 20)[0]
    there = believed(
        task, state(task, path_point(scenario[1] + 1e-6, scenario)[:3]), scenario[None]
    )
    score_state = remembered(task, [[scenario[1], 20.0]])
    surfaced = state(task, [0.0, 0.0, -5.0], 1.5)
    assert (
        task.end_reasons[
            score(task, surfaced, scenario, there, trim(task), 0.0 * trim(task), score_state)[1][0]
        ]
        == "missed the goal"
    )


@DIVES
def test_dithering_fins_cost_and_resting_fins_do_not(system: System):
    """A third of a rudder's price: all fins that turn by a share of the full rate and back at each step."""
    task, scenario = system.task, scenarios(system.task, 1, 25)[0]
    s = cruise(task, scenario)[:60]
    best = fly(task, scenario, along(scenario, s))[0]
    resting = fly(task, scenario, along(scenario, s), fin=0.3)[0]
    np.testing.assert_allclose(resting[2:], best[2:], rtol=1e-12)  # once they are there
    for share in (0.02, 0.3, 1.0):
        angle = 0.5 * share * task.auv.fin_rate * task.dt * (-1.0) ** np.arange(len(s))
        dithering = fly(task, scenario, along(scenario, s), fin=angle)[0]
        np.testing.assert_allclose(
            dithering[2:], best[2:] / (1.0 + share * (1.25 + 4.0) / 3.0), rtol=1e-9
        )


def test_a_dive_can_be_made_to_another_goal_by_data_alone():
    task = replace(SPATIAL.task, goal=(20.0, -5.0, 2.0), goal_spread=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(
        scenarios(task, 2), np.tile(arc_to(np.array([20.0, -5.0, 2.0])), (2, 1))
    )
