"""An estimator in the loop of environments of other packages: laws of the single wrapper."""

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
from anybody import LINEAR, LINEAR_PRIOR, Linear, built, cart_pole, flown, pendulum
from gymnasium.utils.env_checker import check_env
from refusals import refused

from estimators import Filter, Gaussian, LinearModel, NonlinearModel
from vessel_gym.sensors import SUITES, Sensor
from vessel_gym.wrappers import EstimatedObservation
from vessel_gym.wrappers.watch import plain_action

SLOW = ("point_maze",)
ALL = [
    pytest.param(name, marks=pytest.mark.slow if name in SLOW else ())
    for name, made in inspect.getmembers(anybody, inspect.isfunction)
    if made.__module__ == "anybody" and name not in ("built", "flown") and name[0] != "_"
]


def same(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(
            np.array_equal(one[key], other[key]) for key in one
        )
    return one.dtype == other.dtype and np.array_equal(one, other)


@pytest.mark.parametrize("env_id", ALL)
def test_oracle_gives_bare_observations_bit_for_bit(env_id: str):
    env = built(env_id, estimator="truth")
    bare = gym.make(env.spec.id)
    bare.action_space.seed(0)
    seen, _ = env.reset(seed=3)
    expected, _ = bare.reset(seed=3)
    for _ in range(150 if env_id in SLOW else 1000):
        assert same(seen, expected)
        action = bare.action_space.sample()
        seen, *mine, _ = env.step(action)
        expected, *theirs, _ = bare.step(action)
        assert mine == theirs
        if mine[1] or mine[2]:
            assert same(seen, expected)
            seen, expected = env.reset()[0], bare.reset()[0]


EXACT = ("cart_pole", "pendulum", "mountain_car", "inverted_pendulum")


@pytest.mark.parametrize("env_id", EXACT)
@pytest.mark.parametrize("estimator", ["ekf", "ukf", "etkf"])
def test_without_noise_estimate_is_state_within_20_steps(env_id: str, estimator: str, monkeypatch):
    monkeypatch.setitem(SUITES, "perfect", {"noise": 1e-6, "lossless": True})
    env = built(env_id, estimator=estimator, sensors="perfect")
    env.action_space.seed(0)
    _, info = env.reset(seed=0)
    for k in range(60):
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        if k >= 20:
            assert np.abs(info["truth"] - info["estimate"]).max() < 1e-4
        if terminated or truncated:
            break
    assert k >= 4


def test_measurements_are_equal_under_every_estimator():
    flights = [
        flown(cart_pole(estimator=name, sensors="degraded"))
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
        flights.append(flown(env))
    for one, other in zip(*flights, strict=True):
        assert np.abs(one["truth"] - other["truth"]).min() > 0.5
        np.testing.assert_array_equal(one["measurement"], other["measurement"])
        assert np.array_equal(one["observation"], other["observation"]) is not leaks


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


# --- observations ---------------------------------------------------------------------------------


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


class Mixed(Linear):
    """One of whose observations is no array."""

    observation_space = gym.spaces.Dict(
        place=Linear.observation_space,
        goal=gym.spaces.Tuple([gym.spaces.Discrete(3), Linear.observation_space]),
    )

    def reset(self, *, seed=None, options=None):
        seen, info = super().reset(seed=seed)
        return {"place": seen, "goal": (1, seen)}, info

    def step(self, action):
        seen, *rest = super().step(action)
        return {"place": seen, "goal": (2, seen)}, *rest


def _own_state(env: gym.Env, seen: Any) -> np.ndarray:
    return env.unwrapped.x


@pytest.mark.parametrize("observe", ["mean", "mean+std", "measurement"])
def test_keys_keep_their_order_and_what_passes_its_kind(observe: str):
    """Gymnasium flattens a space in the order of its keys, and spaces of other orders are equal."""
    given = {"observe": observe, "passes": ["goal"], "observation": lambda x: {"place": x}}
    env = EstimatedObservation(Mixed(), LINEAR, LINEAR_PRIOR, _own_state, **given)
    kept = [key for key in env.observation_space if key in ("place", "goal")]
    assert kept == (["goal"] if observe == "measurement" else ["place", "goal"])
    for seen in (env.reset(seed=0)[0], env.step(np.zeros(1))[0]):
        assert env.observation_space.contains(seen)
        assert isinstance(seen["goal"], tuple)


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


# --- a prior that is sampled ---------------------------------------------------------------------


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


def test_a_sampled_prior_needs_environment_that_is_made_again():
    with refused(ValueError, r"give prior=, .* cannot be made again"):
        EstimatedObservation(Linear(), LINEAR)


# --- checkers, copies, filters --------------------------------------------------------------------

CHECKED = ["cart_pole", "pendulum", "inverted_pendulum", "lunar_lander", "reacher", "mountain_car"]
HAS_GOALS = pytest.param("point_maze", marks=pytest.mark.slow)
"""An environment with goals, that takes its time."""


@pytest.mark.filterwarnings(
    "ignore::UserWarning"
)  # of spaces without bounds, which are the environment's own
@pytest.mark.parametrize("env_id", [*CHECKED, HAS_GOALS])
@pytest.mark.parametrize("observe", ["mean", "mean+std", "measurement"])
def test_gymnasiums_and_stable_baselines_checkers_pass(env_id: str, observe: str):
    check_env(built(env_id, observe=observe), skip_render_check=True)
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    if env_id != "point_maze":
        checker.check_env(built(env_id, observe=observe), warn=False)
    elif observe != "measurement":  # which has no achieved goal: none of its measurements is one
        checker.check_env(built(env_id, observe=observe, estimator="truth"), warn=False)


@pytest.mark.parametrize("name", [HAS_GOALS])
def test_computed_reward_of_true_goal_is_reward_of_step(name: str):
    """The checker above wants the reward of the observed goal, which an estimate is not the one that was paid."""
    env = built(name, estimator="kf")
    seen, _ = env.reset(seed=0)
    _, reward, _, _, info = env.step(env.action_space.sample())
    true = info["truth"][: len(seen["achieved_goal"])]
    assert reward == pytest.approx(env.compute_reward(true, seen["desired_goal"], info), abs=1e-6)
    assert not hasattr(pendulum(), "compute_reward")


def _pickled(env: Any) -> Any:
    return pickle.loads(pickle.dumps(env))


def _cloudpickled(env: Any) -> Any:
    return cloudpickle.loads(cloudpickle.dumps(env))


@pytest.mark.parametrize(
    ("make", "copied"),
    [
        (partial(cart_pole, estimator="enkf"), copy.deepcopy),
        (partial(cart_pole, estimator="enkf"), _cloudpickled),
        (partial(pendulum, estimator="ukf"), copy.deepcopy),
        (partial(pendulum, estimator="ukf"), _pickled),
    ],
)
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


def test_a_spec_makes_the_environment_again():
    env = pendulum(estimator="ukf")
    again = gym.make(env.spec)
    np.testing.assert_array_equal(env.reset(seed=4)[0], again.reset(seed=4)[0])
    np.testing.assert_array_equal(env.step([0.5])[0], again.step([0.5])[0])


def test_a_filter_of_ones_own_is_in_the_loop_too():
    class Still(Filter):
        def _predict(self, belief, u, *_):
            return {"mean": belief.mean, "cov": belief.cov}

        def _update(self, belief, *_):
            return {"mean": belief.mean, "cov": belief.cov}

    env = EstimatedObservation(Linear(), LINEAR, LINEAR_PRIOR, estimator=Still)
    env.reset(seed=0)
    np.testing.assert_array_equal(env.step(np.ones(1))[0], 0.0)


# --- what does not fit ----------------------------------------------------------------------------

GIVEN = {
    "model": NonlinearModel(lambda x, u: x, lambda x, u: x[..., :1], 1e-6 * np.eye(2), [[0.1]]),
    "prior": Gaussian(np.zeros(2), np.eye(2)), "state": lambda env, obs: env.unwrapped.state,
    "observation": lambda x: np.zeros(3),
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "error", "sentence"),
    [
        ({"sensors": [Sensor("two", ("a", "b"), lambda x, u: x, (1.0, 1.0))]}, ValueError, "the model reads 1"),
        ({"model": None}, TypeError, "model must be a Linear- or NonlinearModel"),
        ({"prior": Gaussian(np.zeros(3), np.eye(3))}, ValueError, "the model 2 states"),
        ({"passes": ["angle"]}, ValueError, "the observation has no 'angle', which passes= names"),
        ({"known_input": lambda action: "left"}, ValueError, "known_input must give numbers"),
        ({"state": None}, ValueError, r"state must give 2 numbers, got shape \(3,\)"),
        ({"state": lambda env, obs: np.array([np.nan, 0.0])}, ValueError, "state gave what is not finite"),
        ({"observation": lambda x: np.zeros(2)}, ValueError, r"observation must give 3 numbers, got shape \(2,\)"),
        ({"model": NonlinearModel(lambda x, u: x, lambda x, u: x, np.eye(2), np.eye(2) + 0.5)}, ValueError,
         "diagonal R"),
    ],
)  # fmt: skip
def test_what_does_not_fit_gets_one_sentence(changes: dict, error: type, sentence: str):
    def stepped():
        env = EstimatedObservation(gym.make("Pendulum-v1"), **(GIVEN | changes))
        env.reset(seed=0)
        env.step(np.zeros(1, np.float32))

    with refused(error, sentence):
        stepped()


class Picture(Linear):
    observation_space = gym.spaces.Box(0, 255, (8, 8, 3), np.uint8)


def test_images_and_autoreset_within_are_refused():
    with refused(TypeError, "an estimate is of numbers, not of Box"):
        EstimatedObservation(Picture(), LINEAR, LINEAR_PRIOR)
    with refused(ValueError, "Autoreset within hides how episodes end"):
        EstimatedObservation(gym.wrappers.Autoreset(Linear()), LINEAR, LINEAR_PRIOR)
    with refused(ValueError, "observation must give a dictionary of what does not pass: place"):
        EstimatedObservation(Mixed(), LINEAR, LINEAR_PRIOR, _own_state, passes=["goal"]).reset()
