"""A simulator as a filter's model, and priors sampled on copies of an environment."""

import copy
from collections.abc import Callable
from functools import partial

import anybody
import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
from anybody import LINEAR, Linear, pendulum
from refusals import refused

from estimators import NonlinearModel
from vessel_gym.wrappers import EstimatedObservation, simulator


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


def _cloudpickled(env: gym.Env) -> gym.Env:
    return cloudpickle.loads(cloudpickle.dumps(env))


@pytest.mark.parametrize(
    ("make", "copied"),
    [
        (partial(anybody.built, "inverted_pendulum", estimator="ukf"), copy.deepcopy),
        (partial(anybody.built, "inverted_pendulum", estimator="ukf"), _cloudpickled),
        (partial(pendulum, estimator="ukf"), lambda env: gym.make(env.spec)),
    ],
)
def test_copied_simulator_and_spec_give_same_episodes(make: Callable, copied: Callable):
    """MuJoCo's environments are copied as new ones, which have not begun."""
    env = make()
    again = copied(env)
    np.testing.assert_array_equal(env.reset(seed=4)[0], again.reset(seed=4)[0])
    for _ in range(3):
        action = env.action_space.sample()
        np.testing.assert_array_equal(env.step(action)[0], again.step(action)[0])


class Hanging(Linear):
    """It begins with an angle near half a turn, which it shows to either side of the seam."""

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = np.array([np.pi + 0.05 * self.np_random.normal(), 0.0])
        return np.array([np.arctan2(np.sin(self.x[0]), np.cos(self.x[0])), 0.0]), {}


class Dice(Linear):
    """Its steps draw random numbers, and its state can be set."""

    @property
    def state(self):
        return self.x

    @state.setter
    def state(self, x):
        self.x = np.asarray(x)


for _made in (Hanging, Dice, Linear):
    gym.register(f"{_made.__name__}-v0", _made)


def test_a_prior_that_is_sampled_knows_angles():
    model = NonlinearModel(
        lambda x, u: x, lambda x, u: x[..., :1], np.eye(2), [[0.01]], state_angles=(0,)
    )
    prior = EstimatedObservation(gym.make("Hanging-v0"), model).watch.prior
    assert np.cos(prior.mean[0]) < -0.99
    assert np.sqrt(prior.cov[0, 0]) == pytest.approx(0.05, rel=0.2)


def _first(x, u):
    return x[..., :1]


@pytest.mark.parametrize(
    ("env", "given", "error", "sentence"),
    [
        ("Dice-v0", {}, ValueError, "the simulator draws random numbers"),
        ("Linear-v0", {}, TypeError, "nobody knows how to set the state of Linear-v0: give get and put"),
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
