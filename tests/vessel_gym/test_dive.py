"""The dives: their courses, what the agent may see, and how they are scored."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import kstest
from sensing import sensors_of

from estimators import Gaussian
from vessel_gym.envs import ItsunusaAUVEnv, SegorogeniAUVEnv
from vessel_gym.guidance.dive_path import path_point
from vessel_gym.models.state_space import StateSpace
from vessel_gym.simulation.core import Core
from vessel_gym.system import Estimate, System
from vessel_gym.tasks.dive import Dive

SPATIAL, VERTICAL = SegorogeniAUVEnv.system, ItsunusaAUVEnv.system
DIVES = pytest.mark.parametrize("system", [SPATIAL, VERTICAL], ids=lambda system: system.name)


def places(task: Dive) -> list[int]:
    """Indices of north, east and down in a state; -1, the last, for what a plane has not."""
    return [-1 if i is None else i for i in task.components[6:9]]


def state(task: Dive, position: Any) -> np.ndarray:
    """States ``(B, n)`` of a vehicle at positions ``(B, 3)``, at cruising speed."""
    position = np.atleast_2d(position)
    x = np.zeros((len(position), len(task.prior_sd) + 1))  # what a plane has not goes into the last
    x[:, 0], x[:, places(task)] = task.auv.cruise_speed, position
    return x[:, :-1]


def belief(mean: np.ndarray, flow: np.ndarray | None = None) -> Estimate:
    """What is believed of the state, in a current or none."""
    return Estimate(mean, np.zeros((len(mean), 2)) if flow is None else flow)


def scenarios(task: Dive, n: int, seed: int = 0) -> np.ndarray:
    return task.scenario(np.random.default_rng(seed).random((n, 3)), {})


def believed(task: Dive, mean: np.ndarray, scenario: np.ndarray) -> np.ndarray:
    return task.reference(scenario, np.zeros(len(mean)), mean)


def trim(task: Dive, rows: int = 1) -> np.ndarray:
    """Actuators ``(rows, a)`` of cruising straight on."""
    return np.tile([*[0.0] * (task.actuators - 1), task.auv.cruise_thrust], (rows, 1))


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
        share = (goals[:, axis] - low[axis]) / (high - low)[axis]
        assert kstest(share, "uniform").pvalue > 1e-6
    for corner in (low, high):
        requested = task.scenario(np.zeros((2, 3)), {"goal": corner})
        reached = path_point(requested[:, 1], requested)[:, :3]
        np.testing.assert_allclose(reached, [corner, corner], atol=1e-5)


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
def test_at_rest_a_dive_begins_without_speed_on_the_same_path(system: System):
    task, uniforms = system.task, np.random.default_rng(3).random((4, 3))
    resting, cruising = (task.scenario(uniforms, {"at_rest": of}) for of in (True, False))
    np.testing.assert_array_equal(task.prior(resting).mean, 0.0)
    np.testing.assert_array_equal(cruising, task.scenario(uniforms, {}))
    np.testing.assert_array_equal(resting[:, :3], cruising[:, :3])
    with pytest.raises(ValueError, match="at_rest must be True or False, got 1"):
        task.scenario(uniforms, {"at_rest": 1})


@DIVES
def test_prior_is_level_at_path_start_at_cruising_speed(system: System):
    task, scenario = system.task, scenarios(system.task, 3)
    prior, n = task.prior(scenario), len(task.prior_sd)
    flows = len(system.vehicle.ambient_flows)
    m = n + flows
    np.testing.assert_array_equal(prior.mean, state(task, np.zeros((3, 3))))
    np.testing.assert_allclose(believed(task, prior.mean, scenario)[:, :3], 0.0, atol=1e-12)
    for water in system.disturbances.values():
        space = StateSpace.of_world(system.vehicle, water, sensors_of(system.vehicle))
        cov = space.joint_prior(prior.cov)
        assert np.linalg.eigvalsh(cov[:m, :m]).min() > 0.0
        np.testing.assert_array_equal(cov[:n, :n], prior.cov)
        current = getattr(water, "beside", water).current ** 2 / flows
        np.testing.assert_allclose(np.diag(cov)[n:m], current)
        assert not cov[:n, n:].any()  # velocities are through the water: no current carries them
        assert not cov[m:, m:].any()  # the current has not carried the water yet


def test_known_input_holds_the_path_angle_at_cruising_speed():
    system = VERTICAL
    scenario, step = scenarios(system.task, 2), np.array([0, 200])
    commanded = system.task.commanded(scenario, step, scenario)
    told = system.vehicle.known_input(np.zeros((2, 2)), np.zeros((2, 2)), commanded)
    there = path_point(np.array([0.0, 30.0]), scenario)  # 20 s at 1.5 m/s
    np.testing.assert_allclose(np.tan(told[:, 4]), -there[:, 4], rtol=1e-12)
    np.testing.assert_array_equal(told[:, 5], 1.0)
    late = system.task.commanded(scenario, np.array([2000, 3000]), scenario)
    np.testing.assert_allclose(late, 0.0, atol=1e-12)  # level beyond the path's end
    assert system.vehicle.known_input(np.zeros((1, 2)), np.zeros((1, 2)), None)[0, 4] == 0.0


# --- what the agent sees --------------------------------------------------------------------------


def random_states(system: System, seed: int, rows: int = 300) -> np.ndarray:
    """States anywhere about the path, with any attitude, at the poles of the Euler angles, too."""
    task, rng, names = system.task, np.random.default_rng(seed), system.vehicle.state_names
    x = rng.normal(size=(rows, len(names) + 1))
    x[:, 0] += task.auv.cruise_speed
    x[:, places(task)] += rng.uniform([-10.0, -5.0, -3.0], [50.0, 25.0, 20.0], (rows, 3))
    x[:, [i for i, name in enumerate(names) if name in ("phi", "psi")]] *= 3.0
    x[:5, names.index("theta")] = [1.55, -1.55, np.pi / 2, -np.pi / 2, 1.6]
    return x[:, :-1]


@DIVES
def test_observed_vectors_are_rotated_into_body_axes(system: System):
    task, x, scenario = system.task, random_states(system, 3), scenarios(system.task, 300, 3)
    reference = believed(task, x, scenario)
    current, flows = np.zeros((300, 3)), len(system.vehicle.ambient_flows)
    current[:, :flows] = np.random.default_rng(3).normal(size=(300, flows))
    known = belief(x, current[:, :flows])
    seen = task.named(task.observe(known, scenario, reference, trim(task, 300)))
    column = dict(zip(system.vehicle.state_names, x.T, strict=True))
    attitude = [column.get(name, np.zeros(300)) for name in ("psi", "theta", "phi")]
    to_body, position = Rotation.from_euler("ZYX", np.stack(attitude, -1)).inv(), task.position(x)
    path, look = (path_point(reference[:, 0] + s, scenario)[:, :3] for s in (0.0, task.ahead))
    path = path - position
    if system is VERTICAL:
        path[:, 0] = 0.0  # right above or below
    for name, vector in (("path", path), ("look", look - position), ("current", current)):
        expected = to_body.apply(vector)
        for axis, words in enumerate(("ahead", "to starboard", "below")):
            if (key := f"{name} {words}") in task.observed:
                np.testing.assert_allclose(seen[key], expected[:, axis], atol=1e-8, err_msg=key)


@DIVES
def test_observed_errors_and_estimates_are_as_named(system: System):
    task, names = system.task, system.vehicle.state_names
    x, scenario = random_states(system, 4), scenarios(task, 300, 4)
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
    if system is SPATIAL:
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
        == Core(system).config.observation_size
        == observation.shape[1]
    )


@DIVES
def test_observed_standard_deviations_are_one_at_the_start(system: System):
    task = system.task
    told = len(task.prior_sd) + len(system.vehicle.ambient_flows)
    core = Core(system, 2, "ekf", observe="mean+std")
    seen = []
    for factor in (1.0, 4.0, -1.0):
        core.start(0)
        known = Gaussian(
            core.now.belief.mean,
            core.config.world.space.joint_prior(task.prior(core.now.scenario).cov),
        )
        core.now.belief = core.config.estimation.filter.init(known)
        core.now.belief = core.now.belief.replace(cov=factor * core.now.belief.cov)
        core.now.observation = None  # that of the start
        seen.append(core.observe()[:, -told:])
    assert core.observe().shape == (2, Core(system).config.observation_size + told)
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
def test_raw_observation_tells_the_courses_apart(system: System):
    task, sensors = system.task, sensors_of(system.vehicle)
    assert (sensors.scale >= sensors.sd).all()  # what counts as 1 is no noise
    mission = task.observe_mission(scenarios(task, 3, 9), np.zeros(3), trim(task, 3))
    shown = mission[:, : -len(system.vehicle.action_names)]
    assert len(np.unique(np.round(shown[:, -2:], 12))) == 6


# --- score ----------------------------------------------------------------------------------------


@DIVES
@pytest.mark.parametrize(("thrust", "power"), [(1.0, 1.0), (0.0, 2 / 3), (4.0 ** (2 / 3), 2.0)])
def test_arriving_pays_by_the_energy_of_a_cruise(system: System, thrust: float, power: float):
    """Power relative to cruising: two thirds are hotel load, a third goes with thrust^1.5."""
    task, scenario = system.task, scenarios(system.task, 1, 18)
    goal = state(task, path_point(scenario[0, 1], scenario[0])[:3])
    there = believed(
        task, state(task, path_point(scenario[0, 1] + 1e-6, scenario[0])[:3]), scenario
    )
    actuators, cruising = trim(task), np.hypot(*scenario[0, 1:3]) / task.auv.cruise_speed
    actuators[:, -1] *= thrust
    for seconds in (0.5 * cruising, cruising, 3.0 * cruising):
        kept = task.initial_score_state(goal, scenario)
        kept[:, 1] = seconds * power - task.dt * power
        reward, _, after = task.score(
            goal, np.zeros((1, 8)), scenario, there, np.ones(1, bool), actuators, actuators, kept
        )
        assert after[0, 1] == pytest.approx(seconds * power)
        economy = min(cruising / seconds / power, 1.0)
        assert reward[0] == pytest.approx((1.0 - task.TRACKING) * economy, rel=1e-9)
