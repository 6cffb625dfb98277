"""An estimator in the loop of environments that nobody here wrote."""

import copy
import inspect
import pickle
from collections.abc import Callable
from functools import partial
from typing import Any

import anybody
import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
from anybody import cart_pole, pendulum
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from refusals import refused

from estimators import Filter, Gaussian, LinearModel, Model, NonlinearModel, make, names
from estimators.metrics import chi_square_band, nees
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import SUITES, Sensor, SensorSuite
from vessel_gym.wrappers import EstimatedObservation, simulator
from vessel_gym.wrappers.vector import EstimatedObservation as EstimatedObservations
from vessel_gym.wrappers.watch import plain_action

NEEDS = dict.fromkeys(("inverted_pendulum", "hopper", "reacher"), "mujoco") | {
    "lunar_lander": "Box2D",
    "point_maze": "gymnasium_robotics",
}
SLOW = ("point_maze", "acrobot")
ALL = [
    pytest.param(name, marks=pytest.mark.slow if name in SLOW else ())
    for name, made in inspect.getmembers(anybody, inspect.isfunction)
    if made.__module__ == "anybody" and not name.startswith("_")
]


def built(name: str, **options: Any) -> gym.Env:
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    return getattr(anybody, name)(**options)


def same(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(
            np.array_equal(one[key], other[key]) for key in one
        )
    return one.dtype == other.dtype and np.array_equal(one, other)


@pytest.mark.parametrize("name", ALL)
def test_oracle_gives_bare_observations_bit_for_bit(name: str):
    env = built(name, estimator="truth")
    bare = gym.make(env.spec.id)
    bare.action_space.seed(0)
    seen, _ = env.reset(seed=3)
    expected, _ = bare.reset(seed=3)
    for _ in range(150 if name in SLOW else 1000):
        assert same(seen, expected)
        action = bare.action_space.sample()
        seen, *mine, _ = env.step(action)
        expected, *theirs, _ = bare.step(action)
        assert mine == theirs
        if mine[1] or mine[2]:
            assert same(seen, expected)
            seen, expected = env.reset()[0], bare.reset()[0]


EXACT = ("cart_pole", "pendulum", "mountain_car", "acrobot", "inverted_pendulum")


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("estimator", ["ekf", "ukf", "etkf"])
def test_without_noise_estimate_is_state_within_20_steps(name: str, estimator: str, monkeypatch):
    monkeypatch.setitem(SUITES, "perfect", SensorSuite(noise=1e-6, lossless=True))
    env = built(name, estimator=estimator, sensors="perfect")
    env.action_space.seed(0)
    _, info = env.reset(seed=0)
    for k in range(60):
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        if k >= 20:
            assert np.abs(info["truth"] - info["estimate"]).max() < 1e-4
        if terminated or truncated:
            break
    assert k >= 4


class Linear(gym.Env):
    """``x+ = A x + B u + w``: a linear environment whose noise is the model's."""

    A, B, Q = np.array([[1.0, 0.1], [-0.1, 0.95]]), np.array([[0.0], [0.1]]), np.diag([1e-4, 4e-4])
    observation_space = gym.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gym.spaces.Box(-10.0, 10.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.np_random.normal(size=2) * 0.3
        return self.x.copy(), {}

    def step(self, action):
        noise = np.sqrt(np.diag(self.Q)) * self.np_random.normal(size=2)
        reward = -float(self.x @ self.x + 0.1 * action @ action)
        self.x = self.A @ self.x + self.B @ action + noise
        return self.x.copy(), reward, False, False, {}


LINEAR = LinearModel(Linear.A, [[1.0, 0.0]], Linear.Q, [[0.01]], B=Linear.B)
LINEAR_PRIOR = Gaussian([0.0, 0.0], 0.09 * np.eye(2))


def _linear(rows: int, estimator: str, **options: Any) -> EstimatedObservations:
    """As many linear environments: rows are as single ones, see `test_rows_of_a_vector_are_as_single_ones`."""
    return EstimatedObservations(
        SyncVectorEnv([Linear] * rows), LINEAR, LINEAR_PRIOR, estimator=estimator, **options
    )


@pytest.mark.parametrize("estimator", ["kf", "ekf", "ukf", "etkf"])
def test_filter_is_consistent_under_noise_of_its_model(estimator: str):
    """One late time of 300 independent episodes: false alarm 1e-4."""
    options = {"members": 200} if estimator == "etkf" else {}
    env = _linear(300, estimator, estimator_options=options)
    env.reset(seed=0)
    for _ in range(15):
        *_, info = env.step(np.zeros((300, 1)))
    low, high = chi_square_band(300, 2, 1.0 - 1e-4)
    assert low < nees(info["estimate"], info["covariance"], info["truth"]).mean() < high


def _flown(env: gym.Env, steps: int = 40, seed: int = 5) -> list[dict[str, Any]]:
    seen, info = env.reset(seed=seed)
    flown = [info | {"observation": seen}]
    rng = np.random.default_rng(0)
    for _ in range(steps):
        action = (
            rng.integers(2)
            if isinstance(env.action_space, gym.spaces.Discrete)
            else rng.uniform(-1, 1, env.action_space.shape)
        )
        seen, _, terminated, truncated, info = env.step(action)
        flown.append(info | {"observation": seen})
        if terminated or truncated:
            seen, info = env.reset()
            flown.append(info | {"observation": seen})
    return flown


def test_measurements_are_equal_under_every_estimator():
    flights = [
        _flown(cart_pole(estimator=name, sensors="degraded"))
        for name in ("truth", "ekf", "enkf", "dead-reckoning")
    ]
    for flight in flights[1:]:
        assert len(flight) == len(flights[0])
        for mine, first in zip(flight, flights[0], strict=True):
            for key in ("measurement", "available", "truth"):
                np.testing.assert_array_equal(mine[key], first[key])


class Elsewhere(Linear):
    """The same, observed and truly somewhere else."""

    def reset(self, *, seed=None, options=None):
        return super().reset(seed=seed)[0] + 0.7, {}

    def step(self, action):
        seen, *rest = super().step(action)
        return seen + 0.7, *rest


@pytest.mark.parametrize("observe", ["mean", "mean+std", "measurement"])
@pytest.mark.parametrize("estimator", ["ekf", "enkf", "dead-reckoning"])
@pytest.mark.parametrize("leaks", [False, True])
def test_truth_reaches_observation_by_measurements_alone(observe: str, estimator: str, leaks: bool):
    """The environment and its state are elsewhere; measurements stay. A leak would change the observation."""

    class Leaky(EstimatedObservation):
        def _observed(self, seen):
            return np.asarray(seen)

    flights = []
    for world in (Linear(), Elsewhere()):
        measurements = np.random.default_rng(1).normal(size=41)
        replayed = Sensor(
            "replayed",
            ("y",),
            lambda x, u, r=measurements: np.full((*x.shape[:-1], 1), r[0]),
            (0.1,),
        )
        kind = Leaky if leaks else EstimatedObservation
        env = kind(
            world, LINEAR, LINEAR_PRIOR, estimator=estimator, sensors=[replayed], observe=observe
        )
        flights.append(_flown(env))
    for one, other in zip(*flights, strict=True):
        assert np.abs(one["truth"] - other["truth"]).min() > 0.5
        np.testing.assert_array_equal(one["measurement"], other["measurement"])
        assert np.array_equal(one["observation"], other["observation"]) is not leaks


# --- many at once ---------------------------------------------------------------------------------


def _known(action: Any) -> np.ndarray:
    """Of CartPole's action, 0 or 1, a push to either side."""
    return np.asarray(action, float)[..., None] - 0.5


def _balanced(estimator: str) -> Model:
    """CartPole as a filter takes it: its equations, or these near the upright, with what it needs to be unknown."""
    own: Any = cart_pole().watch.filter.model
    if estimator in ANY:
        return NonlinearModel(
            lambda x, u: own.transition(x, u + 0.5), own.measurement, own.Q, own.R
        )
    R, offset = np.diag([4e-4, 1e-4, 1e-4, 1e-4]), np.eye(4)[:, :1]
    A = own.linearise_transition(np.zeros(4), np.array([0.5]))[1]
    push = np.diff(own.transition(np.zeros((2, 4)), np.array([[0.0], [1.0]])), axis=0).T
    if estimator in ("ekf-ui-wdf", "ukf-umv"):
        return NonlinearModel(
            lambda x, u: own.transition(x, u + 0.5), lambda x, u: x, own.Q, R, G=push
        )
    unknown = {
        "kf": {}, "kf-umv-ui": {"G": 0.0 * push, "H": offset}, "kf-umv-ui-wdf": {"G": push},
        "ulise": {"G": push, "H": offset},
    }  # fmt: skip
    return LinearModel(A, np.eye(4), own.Q, R, B=push, **unknown[estimator])


def _many(rows: int, estimator: str, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **options: Any):
    envs = SyncVectorEnv(
        [partial(gym.make, "CartPole-v1", max_episode_steps=30)] * rows, autoreset_mode=mode
    )
    return EstimatedObservations(
        envs, _balanced(estimator), cart_pole().watch.prior,
        lambda env, obs: np.array([e.unwrapped.state for e in env.envs]), known_input=_known, estimator=estimator,
        **options,
    )  # fmt: skip


LINEAR_OR_UNKNOWN = ("kf", "kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ulise", "ukf-umv")
ANY = [name for name in names() if name not in LINEAR_OR_UNKNOWN]
"""Filters of any model."""


@pytest.mark.parametrize("estimator", names())
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_rows_of_a_vector_are_as_single_ones(estimator: str, mode: AutoresetMode):
    options = (
        {"members": 20}
        if make(estimator, _balanced(estimator)).random and estimator != "pf"
        else {}
    )
    many = _many(3, estimator, mode, sensors="degraded", estimator_options=options)
    ones = [
        EstimatedObservation(
            gym.make("CartPole-v1", max_episode_steps=30), many.watch.filter.model, many.watch.prior,
            lambda env, obs: env.unwrapped.state, known_input=_known, estimator=estimator, sensors="degraded",
            estimator_options=options,
        )
        for _ in range(3)
    ]  # fmt: skip
    seen, _ = many.reset(seed=7)
    for i, one in enumerate(ones):
        np.testing.assert_array_equal(one.reset(seed=7 + i)[0], seen[i])
    rng, over = np.random.default_rng(0), np.zeros(3, bool)
    for _ in range(60):
        actions = rng.integers(0, 2, 3)
        if mode is AutoresetMode.DISABLED and over.any():
            seen, info = many.reset(options={"reset_mask": over})
            for i in np.flatnonzero(over):
                np.testing.assert_array_equal(ones[i].reset()[0], seen[i])
            over[:] = False
        seen, _, terminated, truncated, info = many.step(actions)
        for i, one in enumerate(ones):
            alone, *_, single_info = one.reset() if over[i] else one.step(actions[i])
            np.testing.assert_array_equal(alone, seen[i])
            np.testing.assert_array_equal(single_info["measurement"], info["measurement"][i])
        over = terminated | truncated
    assert many.watch.now.episode.min() >= 1


def test_a_native_batch_is_wrapped_as_others_are():
    env = gym.make_vec("CartPole-v1", num_envs=64, vectorization_mode="vector_entry_point")
    single = cart_pole().watch
    wrapped = EstimatedObservations(
        env,
        single.filter.model,
        single.prior,
        lambda env, obs: env.unwrapped.state.T,
        estimator="ukf",
    )
    wrapped.reset(seed=0)
    for _ in range(50):
        *_, info = wrapped.step(wrapped.action_space.sample())
    assert np.abs(info["truth"] - info["estimate"]).max() < 0.5
    assert wrapped.watch.now.episode.max() > 0


def test_functions_of_a_batch_must_keep_its_rows():
    single = pendulum().watch
    envs = SyncVectorEnv([partial(gym.make, "Pendulum-v1")] * 4)
    states = lambda env, obs: np.array([e.unwrapped.state for e in env.envs])  # noqa: E731
    given = {"model": single.filter.model, "prior": single.prior, "state": states}
    flat = lambda x: [np.cos(x[..., 0]), np.sin(x[..., 0]), x[..., 1]]  # noqa: E731
    with refused(ValueError, r"wants \(3,\) numbers, the estimate gives shape \(3, 4\)"):
        EstimatedObservations(envs, **given, observation=flat).reset(seed=0)
    mixed = EstimatedObservations(
        envs,
        **given,
        observation=lambda x: np.stack(flat(x), -1),
        known_input=lambda a: np.moveaxis(a, -1, 0),
    )
    mixed.reset(seed=0)
    with pytest.raises(ValueError, match=r"known_input must give an array \(4, 1\)"):
        mixed.step(np.zeros((4, 1), np.float32))
    three = SyncVectorEnv(
        [partial(gym.make, "Pendulum-v1")] * 3
    )  # as many as an observation has components
    with pytest.raises(
        ValueError, match="observation must give a row for each environment, and mixes them"
    ):
        EstimatedObservations(three, **given, observation=flat)


def test_seed_concerns_reset_rows_alone():
    many = _many(2, "ekf", AutoresetMode.DISABLED)
    ones = [_many(1, "ekf", AutoresetMode.DISABLED) for _ in range(2)]
    for seeds, mask in (
        ([7, 9], [True, True]),
        ([50, 51], [True, False]),
        ([None, 61], [True, True]),
        (None, None),
    ):
        reset = np.ones(2, bool) if mask is None else np.array(mask)
        _, info = many.reset(seed=seeds, options={"reset_mask": reset})
        for i in np.flatnonzero(reset):
            _, alone = ones[i].reset(seed=None if seeds is None else [seeds[i]])
            np.testing.assert_array_equal(alone["truth"][0], info["truth"][i])
            np.testing.assert_array_equal(alone["measurement"][0], info["measurement"][i])


class Hanging(Linear):
    """It begins with an angle near half a turn, which it shows to either side of the seam."""

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = np.array([np.pi + 0.05 * self.np_random.normal(), 0.0])
        return np.array([np.arctan2(np.sin(self.x[0]), np.cos(self.x[0])), 0.0]), {}


gym.register("Hanging-v0", Hanging)


def test_a_prior_that_is_sampled_knows_angles():
    model = NonlinearModel(
        lambda x, u: x, lambda x, u: x[..., :1], np.eye(2), [[0.01]], state_angles=(0,)
    )
    prior = EstimatedObservation(gym.make("Hanging-v0"), model).watch.prior
    assert np.cos(prior.mean[0]) < -0.99
    assert np.sqrt(prior.cov[0, 0]) == pytest.approx(0.05, rel=0.2)


def test_measurement_function_may_branch_or_change():
    gain = {"now": 1.0}

    def branching(x, u):
        return -x[..., :1] if (x > 1e3).any() else x[..., :1]

    def changing(x, u):
        return gain["now"] * x[..., :1]

    for read in (branching, changing, lambda x, u: x[..., :1]):
        model = NonlinearModel(lambda x, u: x, read, np.eye(2), [[1e-20]])
        env = EstimatedObservation(Linear(), model, LINEAR_PRIOR, estimator="ukf")
        for factor in (1.0, 2.0):
            gain["now"] = factor
            for _, info in (env.reset(seed=2), env.step(np.ones(1))[::4]):
                expected = factor if read is changing else 1.0
                np.testing.assert_allclose(
                    info["measurement"], expected * info["truth"][:1], atol=1e-8
                )


class Loose(Linear):
    """It shows what is beyond the bounds that it names."""

    observation_space = gym.spaces.Box(-0.01, 0.01, (2,), np.float64)


@pytest.mark.parametrize("passes", [(), (1,)])
def test_bounds_clip_estimates_but_not_truth_nor_what_passes(
    passes: tuple[int, ...],
):
    given = {
        "model": LINEAR,
        "prior": LINEAR_PRIOR,
        "state": lambda env, obs: env.unwrapped.x,
        "passes": passes,
    }
    given["observation"] = (lambda x: x[..., :1]) if passes else None
    bare, oracle, ekf = (
        Loose(),
        *(EstimatedObservation(Loose(), **given, estimator=name) for name in ("truth", "ekf")),
    )
    seen = [env.reset(seed=0)[0] for env in (bare, oracle, ekf)]
    for _ in range(20):
        np.testing.assert_array_equal(seen[1], seen[0])
        assert abs(seen[2][0]) <= 0.01
        assert seen[2][1] == seen[0][1] or not passes
        seen = [env.step(np.ones(1, np.float32))[0] for env in (bare, oracle, ekf)]
    assert np.abs(seen[0]).max() > 0.02


def test_episodes_that_are_reset_within_are_refused():
    with pytest.raises(ValueError, match="Autoreset within hides how episodes end"):
        EstimatedObservation(gym.wrappers.Autoreset(Linear()), LINEAR, LINEAR_PRIOR)


def test_observed_angles_are_wrapped():
    class Turning(Linear):
        def reset(self, *, seed=None, options=None):
            self.x = np.array([3.0, 1.0])
            return self.x.copy(), {}

        def step(self, action):
            self.x = self.x + [0.1 * self.x[1], 0.0]
            observed = self.x.copy()
            observed[0] = (observed[0] + np.pi) % (2.0 * np.pi) - np.pi
            return observed, 0.0, False, False, {}

    model = LinearModel(
        [[1.0, 0.1], [0.0, 1.0]], [[1.0, 0.0]], 1e-9 * np.eye(2), [[1e-6]], B=np.zeros((2, 1)), state_angles=(0,),
        measurement_angles=(0,),
    )  # fmt: skip
    env = EstimatedObservation(
        Turning(), model, Gaussian([3.0, 1.0], 1e-4 * np.eye(2)), estimator="kf"
    )
    env.reset(seed=0)
    for _ in range(40):
        seen, *_, info = env.step(np.zeros(1))
        np.testing.assert_allclose(seen, info["truth"], rtol=0, atol=0.05)


def test_batches_that_hide_how_episodes_end_are_refused():
    with pytest.raises(
        ValueError, match="resets in the same step hides the state in which an episode ended"
    ):
        _many(2, "ekf", AutoresetMode.SAME_STEP)


# --- time, and faults -----------------------------------------------------------------------------


def _positions(latency: float) -> list[Sensor]:
    read = [("cart", 0, 0.02), ("pole", 2, 0.01)]
    return [
        Sensor(name, (name,), lambda x, u, i=i: x[..., i : i + 1], (sd,), latency=latency)
        for name, i, sd in read
    ]


@pytest.mark.parametrize("estimator", ["ekf", "enkf", "huber-kf"])
def test_measurements_that_come_late_are_fused_where_they_belong(estimator: str):
    """When the last has come, the belief is that of the measurements in time; rows of a batch are as single ones."""
    options = {"members": 20} if estimator == "enkf" else {}
    given = {"estimator": estimator, "estimator_options": options}
    late, timely = (cart_pole(sensors=_positions(delay), **given) for delay in (5.0, 0.0))
    for env in (late, timely):
        env.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(12):
        action = int(rng.integers(2))
        infos = [env.step(action)[-1] for env in (late, timely)]
        np.testing.assert_array_equal(infos[0]["truth"], infos[1]["truth"])
    assert np.abs(infos[0]["estimate"] - infos[1]["estimate"]).max() > 0.0
    # all that was taken then has come: the same before it
    assert late.watch.now.belief.steps[-1 - 5].available.all()


def test_what_is_done_with_late_measurements_is_said():
    errors = []
    for how in ("fused", "as new", "discarded"):
        env = pendulum(
            estimator="ukf", estimator_options={"late": how},
            sensors=[Sensor("angle", ("angle",), lambda x, u: x[..., :1], (0.05,), latency=0.25, angles=(0,))],
        )  # fmt: skip
        env.reset(seed=1)
        env.action_space.seed(1)
        for _ in range(150):
            *_, info = env.step(env.action_space.sample())
        errors.append(abs(np.sin(info["truth"][0] - info["estimate"][0])))
    assert errors[0] < min(0.2, *errors[1:])


@pytest.mark.parametrize("many", ["", "sync", "async"])
def test_rates_are_in_hz_where_the_environment_has_a_time_step(many: str):
    """Pendulum's steps take 0.05 s: at 4 Hz every fifth has a measurement, as late as 0.1 s is in steps."""
    own = [
        Sensor(
            "angle",
            ("angle",),
            lambda x, u: x[..., :1],
            (0.05,),
            rate=4.0,
            latency=0.1,
            angles=(0,),
        )
    ]
    env: Any = pendulum(sensors=own)
    if many:
        model, prior = env.watch.model, env.watch.prior
        batch = gym.make_vec("Pendulum-v1", 2, vectorization_mode=many)
        env = EstimatedObservations(
            batch, model, prior, state=lambda env, seen: np.stack([np.arctan2(seen[:, 1], seen[:, 0]), seen[:, 2]], -1),
            observation=lambda x: np.stack([np.cos(x[..., 0]), np.sin(x[..., 0]), x[..., 1]], -1), sensors=own,
        )  # fmt: skip
    infos = [env.reset(seed=0)[1], *(env.step(env.action_space.sample())[-1] for _ in range(12))]
    assert [k for k, info in enumerate(infos) if info["available"].all()] == [2, 7, 12]
    env.close()


def test_state_must_be_given_where_observation_is_not_state():
    env = gym.make("InvertedPendulum-v5")
    model = simulator(env, lambda x, u: x[..., :2], Q=1e-7, R=1e-4)
    short = gym.wrappers.TransformObservation(
        env, lambda seen: seen[:3], gym.spaces.Box(-9, 9, (3,), np.float64)
    )
    with pytest.raises(
        ValueError,
        match=r"the model has 4 states, and the observation.* has 3 numbers: give state=",
    ):
        EstimatedObservation(short, model)


def test_faults_of_sensors_act_and_stand_in_info():
    fault = SensorFault("y1", "bias", size=0.5, begin=5.0, end=9.0)
    flights = [_flown(cart_pole(sensor_faults=faults), steps=12) for faults in ((), [fault])]
    for k, (one, other) in enumerate(zip(*flights, strict=True)):
        on = 5 <= k < 9
        np.testing.assert_allclose(
            other["measurement"] - one["measurement"], [0.0, 0.5 * on], rtol=0, atol=1e-12
        )
        assert bool(other["sensor_faults"][0]) is on
    with pytest.raises(ValueError, match="unknown sensor of sensor_faults 'y3'"):
        cart_pole(sensor_faults=[SensorFault("y3", "off")])


# --- checkers, copies, modes ----------------------------------------------------------------------


CHECKED = ["cart_pole", "pendulum", "inverted_pendulum", "lunar_lander", "reacher", "mountain_car"]
HAS_GOALS = pytest.param("point_maze", marks=pytest.mark.slow)
"""An environment with goals, that takes its time."""


@pytest.mark.filterwarnings(
    "ignore::UserWarning"
)  # of spaces without bounds, which are the environment's own
@pytest.mark.parametrize("name", [*CHECKED, HAS_GOALS])
@pytest.mark.parametrize("observe", ["mean", "mean+std", "measurement"])
def test_gymnasiums_and_stable_baselines_checkers_pass(name: str, observe: str):
    check_env(built(name, observe=observe), skip_render_check=True)
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    if name != "point_maze":
        checker.check_env(built(name, observe=observe), warn=False)
    elif observe != "measurement":  # which has no achieved goal: none of its measurements is one
        checker.check_env(built(name, observe=observe, estimator="truth"), warn=False)


@pytest.mark.parametrize("name", [HAS_GOALS])
def test_computed_reward_of_true_goal_is_reward_of_step(name: str):
    """The checker above wants the reward of the observed goal, which an estimate is not the one that was paid."""
    env = built(name, estimator="kf")
    seen, _ = env.reset(seed=0)
    _, reward, _, _, info = env.step(env.action_space.sample())
    true = info["truth"][: len(seen["achieved_goal"])]
    assert reward == pytest.approx(env.compute_reward(true, seen["desired_goal"], info), abs=1e-6)
    assert not hasattr(pendulum(), "compute_reward")


def _pendulum_states(env, seen):
    return np.array([each.unwrapped.state for each in env.unwrapped.envs])


def _pendulums() -> EstimatedObservations:
    """Two, of functions that have names, which alone can be pickled."""
    one, many = pendulum().watch, SyncVectorEnv([lambda: gym.make("Pendulum-v1")] * 2)
    many.env_fns = ()  # which are of no use any more
    given: dict[str, Any] = {"observation": anybody._seen, "estimator": "ukf"}
    return EstimatedObservations(many, one.model, one.prior, _pendulum_states, **given)


def _pickled(env: Any) -> Any:
    return pickle.loads(pickle.dumps(env))


def _cloudpickled(env: Any) -> Any:
    return cloudpickle.loads(cloudpickle.dumps(env))


COPIES = [
    (partial(cart_pole, estimator="enkf"), copied) for copied in (copy.deepcopy, _cloudpickled)
]
COPIES += [
    (made, copied)
    for made in (partial(pendulum, estimator="ukf"), _pendulums)
    for copied in (copy.deepcopy, _pickled)
]


@pytest.mark.parametrize(("make", "copied"), COPIES)
def test_a_copy_goes_on_as_the_original_does(make: Callable[[], Any], copied: Callable[[Any], Any]):
    env = make()
    env.reset(seed=3)
    env.action_space.seed(3)
    env.step(env.action_space.sample())
    again = copied(env)
    for _ in range(4):
        action = env.action_space.sample()
        ours, theirs = env.step(action), again.step(action)
        for one, other in zip(
            (*ours[:4], *ours[4].values()), (*theirs[:4], *theirs[4].values()), strict=True
        ):
            np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(env.reset()[0], again.reset()[0])


@pytest.mark.parametrize("space", [
    gym.spaces.Box(-1.0, 2.0, (2, 3)), gym.spaces.Box(-1.0, 2.0, ()), gym.spaces.Discrete(4),
    gym.spaces.MultiDiscrete([3, 4]), gym.spaces.MultiBinary(3),
], ids=str)  # fmt: skip
def test_plain_action_of_a_row_equals_row_of_a_batch_and_clips(
    space: gym.Space,
):
    plain = plain_action(space)
    actions = [space.sample() for _ in range(3)]
    batch = plain(np.array(actions))
    assert batch.ndim == 2
    for action, row in zip(actions, batch, strict=True):
        np.testing.assert_array_equal(plain(action), row)
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(plain))(action), row)
    if isinstance(space, gym.spaces.Box):
        assert plain(np.full(space.shape, 9.0)).max() == 2.0


ANEW = [
    (partial(anybody.inverted_pendulum, estimator="ukf"), copied)
    for copied in (copy.deepcopy, _cloudpickled)
]
ANEW += [(partial(pendulum, estimator="ukf"), lambda env: gym.make(env.spec))]


@pytest.mark.parametrize(("make", "copied"), ANEW)
def test_copied_simulator_and_spec_give_same_episodes(make: Callable, copied: Callable):
    """MuJoCo's environments are copied as new ones, which have not begun."""
    env = make()
    again = copied(env)
    np.testing.assert_array_equal(env.reset(seed=4)[0], again.reset(seed=4)[0])
    for _ in range(3):
        action = env.action_space.sample()
        np.testing.assert_array_equal(env.step(action)[0], again.step(action)[0])


def test_resets_without_seed_differ_and_seed_repeats_series():
    env = cart_pole(sensors="degraded")
    first = [env.reset(seed=1)[1]["measurement"], env.reset()[1]["measurement"]]
    again = [env.reset(seed=1)[1]["measurement"], env.reset()[1]["measurement"]]
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    chance = [cart_pole().reset()[1]["truth"] for _ in range(2)]
    assert not np.array_equal(
        *chance
    )  # a prior that is sampled on copies leaves the environment's own numbers alone


# --- LQG ------------------------------------------------------------------------------------------


def test_a_linear_regulator_on_estimates_costs_what_riccati_says():
    """The mean cost of a step, 20 seeds, within 3 standard errors of LQG's."""
    from scipy.linalg import solve_discrete_are

    A, B, Q, C, R = Linear.A, Linear.B, Linear.Q, LINEAR.C, LINEAR.R
    effort = 0.1 * np.eye(1)
    S = solve_discrete_are(A, B, np.eye(2), effort)
    K = np.linalg.solve(B.T @ S @ B + effort, B.T @ S @ A)
    P = solve_discrete_are(A.T, C.T, Q, R)
    after = P - P @ C.T @ np.linalg.solve(C @ P @ C.T + R, C @ P)
    expected = np.trace(S @ Q) + np.trace(after @ K.T @ (B.T @ S @ B + effort) @ K)
    env, costs = _linear(20, "kf"), np.zeros(20)
    seen, _ = env.reset(seed=0)
    for k in range(1500):
        seen, reward, *_ = env.step(-seen @ K.T)
        costs -= reward / 1400 if k >= 100 else 0.0
    error = np.std(costs, ddof=1) / np.sqrt(20)
    assert abs(np.mean(costs) - expected) < 3.0 * error


# --- models from simulators -----------------------------------------------------------------------


def test_a_simulator_steps_as_the_equations_do():
    by_hand = pendulum().watch.filter.model
    sim = simulator(gym.make("Pendulum-v1"), lambda x, u: x[..., :1], 1e-9, 1e-4)
    rng = np.random.default_rng(0)
    x, u = rng.normal(size=(4, 3, 2)), rng.uniform(-2, 2, (4, 1, 1))
    after = sim.transition(x, u)
    np.testing.assert_allclose(
        after, by_hand.transition(x, u), rtol=0, atol=1e-6
    )  # its actions are float32


@pytest.mark.parametrize("name", ["InvertedPendulum-v5", "Hopper-v5"])
def test_a_native_rollout_steps_as_the_environment_does(name: str):
    pytest.importorskip("mujoco")
    env = gym.make(name)
    model = simulator(env, lambda x, u: x[..., :2], 1e-9, 1e-4)
    assert type(model.transition).__name__ == "_Rollout"
    env.reset(seed=0)
    env.action_space.seed(0)
    base = env.unwrapped
    for _ in range(10):
        x, action = np.concatenate([base.data.qpos, base.data.qvel]), env.action_space.sample()
        env.step(action)
        expected = np.concatenate([base.data.qpos, base.data.qvel])
        np.testing.assert_allclose(
            model.transition(x, action.astype(float)), expected, rtol=0, atol=1e-4
        )


class Dice(Linear):
    """Its steps draw random numbers, and its state can be set."""

    @property
    def state(self):
        return self.x

    @state.setter
    def state(self, x):
        self.x = np.asarray(x)


gym.register("Dice-v0", Dice)
gym.register("Linear-v0", Linear)


# --- what does not fit ----------------------------------------------------------------------------


def _identity(x, u):
    return x


def _first(x, u):
    return x[..., :1]


GIVEN = {
    "model": NonlinearModel(_identity, _first, 1e-6 * np.eye(2), [[0.1]]),
    "prior": Gaussian(np.zeros(2), np.eye(2)), "state": lambda env, obs: env.unwrapped.state,
    "observation": lambda x: np.zeros(3),
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "error", "sentence"),
    [
        ({"estimator": "ufk"}, ValueError, "unknown estimator 'ufk'.*did you mean 'ukf'"),
        ({"estimator": "measurement"}, ValueError, 'raw measurements are observe="measurement"$'),
        ({"estimator": "kf"}, ValueError, "kf needs a LinearModel"),
        ({"sensors": []}, TypeError, "sensors must be Sensor objects"),
        ({"sensors": [Sensor("two", ("a", "b"), lambda x, u: x, (1.0, 1.0))]}, ValueError, "the model reads 1"),
        ({"model": None}, TypeError, "model must be a LinearModel or a NonlinearModel"),
        ({"prior": Gaussian(np.zeros(3), np.eye(3))}, ValueError, "the model has 2 states"),
        ({"prior": 3.0}, TypeError, "prior must be a Gaussian"),
        ({"passes": ["angle"]}, ValueError, "passes must be indices of components below 3"),
        ({"known_input": lambda action: "left"}, ValueError, "known_input must give numbers"),
        ({"state": None}, ValueError, r"state must give the model's states, \(2,\) numbers, got shape \(3,\)"),
        ({"state": lambda env, obs: np.array([np.nan, 0.0])}, ValueError, "state gave what is not finite"),
        ({"known_input": 3}, TypeError, "known_input must be a function of the action, got 3"),
        ({"observation": lambda x: [np.nan, 0.0, 0.0]}, ValueError, "observation gave NaN of the state"),
        ({"observation": None}, ValueError, "give observation=, a function of the state"),
        ({"observation": lambda x: np.zeros(2)}, ValueError, r"wants \(3,\) numbers, the estimate gives shape \(2,\)"),
        ({"model": NonlinearModel(_identity, lambda x, u: x, np.eye(2), np.eye(2) + 0.5)}, ValueError, "diagonal R"),
    ],
)  # fmt: skip
def test_what_does_not_fit_gets_one_sentence(changes: dict, error: type, sentence: str):
    def flown():
        env = EstimatedObservation(gym.make("Pendulum-v1"), **(GIVEN | changes))
        env.reset(seed=0)
        env.step(np.zeros(1, np.float32))

    with refused(error, sentence):
        flown()


class Lettered(Linear):
    """Its observations are a dictionary."""

    observation_space = gym.spaces.Dict(dict.fromkeys(("place", "goal"), Linear.observation_space))

    def reset(self, *, seed=None, options=None):
        return dict.fromkeys(("place", "goal"), super().reset(seed=seed)[0]), {}

    def step(self, action):
        seen, *rest = super().step(action)
        return {"place": seen, "goal": seen}, *rest


class Mixed(Lettered):
    """What passes may be of any kind."""

    observation_space = gym.spaces.Dict(
        place=Linear.observation_space,
        goal=gym.spaces.Tuple([gym.spaces.Discrete(3), Linear.observation_space]),
    )

    def reset(self, *, seed=None, options=None):
        seen, info = super().reset(seed=seed)
        return seen | {"goal": (1, seen["goal"])}, info

    def step(self, action):
        seen, *rest = super().step(action)
        return seen | {"goal": (2, seen["goal"])}, *rest


@pytest.mark.parametrize("observe", ["mean", "mean+std", "measurement"])
def test_keys_keep_their_order_and_what_passes_its_kind(observe: str):
    """Gymnasium flattens a space in the order of its keys, and spaces of other orders are equal."""
    given = {"state": lambda env, obs: env.unwrapped.x, "observation": lambda x: {"place": x}}
    env = EstimatedObservation(
        Mixed(), LINEAR, LINEAR_PRIOR, observe=observe, passes=["goal"], **given
    )
    kept = [key for key in env.observation_space if key in ("place", "goal")]
    assert kept == (["goal"] if observe == "measurement" else ["place", "goal"])
    for seen in (env.reset(seed=0)[0], env.step(np.zeros(1))[0]):
        assert env.observation_space.contains(seen)
        assert isinstance(seen["goal"], tuple)


@pytest.mark.parametrize(
    ("changes", "error", "sentence"),
    [
        ({}, ValueError, "observation must give a dictionary of all that does not pass, goal, place too"),
        ({"observation": lambda x: {"place": x}}, ValueError, "goal too: give it, or name it in passes"),
        ({"observation": lambda x: {"place": x[:1], "goal": x}}, ValueError, r"wants \(2,\) numbers"),
        ({"state": None}, ValueError, "state must give the model's states"),
    ],
)  # fmt: skip
def test_misfit_of_dictionary_gets_one_sentence(changes: dict, error: type, sentence: str):
    given = {"model": LINEAR, "prior": LINEAR_PRIOR, "state": lambda env, obs: env.unwrapped.x}
    with refused(error, sentence):
        EstimatedObservation(Lettered(), **(given | changes)).reset(seed=0)


def test_step_before_reset_and_too_few_seeds_get_one_sentence():
    careless = Linear()
    careless.x = np.zeros(2)
    with pytest.raises(gym.error.ResetNeeded, match=r"call reset\(\) before step\(\)"):
        EstimatedObservation(careless, LINEAR, LINEAR_PRIOR).step(np.zeros(1))
    many = _many(3, "ekf")
    with pytest.raises(ValueError, match="seed must be one number, or one for each of 3, got"):
        many.reset(seed=[1, 2])


class Picture(Linear):
    observation_space = gym.spaces.Box(0, 255, (8, 8, 3), np.uint8)


def test_images_are_refused():
    with pytest.raises(
        TypeError, match="the environment shows images, and an estimate is of numbers"
    ):
        EstimatedObservation(Picture(), LINEAR, LINEAR_PRIOR)


@pytest.mark.parametrize(
    ("env", "given", "error", "sentence"),
    [
        ("Dice-v0", {}, ValueError, "the simulator draws random numbers"),
        ("Linear-v0", {}, TypeError, "nobody knows how to set the state of Linear-v0: give get and put"),
        ("Pendulum-v1", {"measurement": None}, TypeError, "measurement must be a function"),
        ("Pendulum-v1", {"measurement": lambda x, u: x[..., 0]}, ValueError, r"it gives shape \(8,\), not \(8, p\)"),
        ("Pendulum-v1", {"Q": np.eye(3)}, ValueError, r"Q must be \(2, 2\) or a number, got shape \(3, 3\)"),
        ("Linear-v0", {"get": lambda env: env.unwrapped.x}, TypeError, "give both get and put"),
        ("Linear-v0", {"get": lambda env: env.unwrapped.x, "put": lambda env, x: None}, ValueError,
         "a state that put sets is not the one that get finds"),
    ],
)  # fmt: skip
def test_simulator_that_is_none_is_refused(env: str, given: dict, error: type, sentence: str):
    with refused(error, sentence):
        simulator(gym.make(env), **({"measurement": _first, "Q": 1e-6, "R": 1e-4} | given))


def test_simulator_and_prior_need_environment_that_is_made_again():
    with refused(TypeError, "this one has no spec"):
        simulator(Linear(), _first, 1e-6, 1e-4)
    with refused(ValueError, r"give prior=, .* cannot be made again"):
        EstimatedObservation(Linear(), LINEAR)


def test_a_filter_of_ones_own_is_in_the_loop_too():
    class Still(Filter):
        def _predict(self, belief, u, *_):
            return {"mean": belief.mean, "cov": belief.cov}

        def _update(self, belief, *_):
            return {"mean": belief.mean, "cov": belief.cov}

    env = EstimatedObservation(Linear(), LINEAR, LINEAR_PRIOR, estimator=Still)
    env.reset(seed=0)
    np.testing.assert_array_equal(env.step(np.ones(1))[0], 0.0)
