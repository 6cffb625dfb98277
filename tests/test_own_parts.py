"""Sensors, disturbances, tasks and vehicles of one's own, as their pages show them."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from pages import OWN, my_vehicle

from agents import rollout
from agents.metrics import scores
from estimators import EnsembleKalmanFilter, compiled
from estimators.varying import is_compiled
from vessel_gym.envs import (
    SegorogeniAUVEnv,
    register_environment,
)
from vessel_gym.simulation.core import Core


@pytest.mark.parametrize("env_id", [*OWN, "USV-v0", "Route-v0"])
def test_equations_of_pages_are_compiled_with_exact_jacobians(
    env_id: str,
) -> None:
    env: Any = gym.make(env_id, estimator="ekf")
    env.reset(seed=0)
    core = env.unwrapped.core
    model, x, u = (
        core.config.estimation.filter.model,
        core.now.belief.mean,
        core.config.system.vehicle.cruise[1][None],
    )
    for name, function in (("transition", model.transition), ("measurement", model.measurement)):
        assert is_compiled(function)
        jacobian = getattr(model, f"linearise_{name}")(x, u)[1]
        step = 1e-5 * np.eye(model.n)
        slopes = (
            function(x + step, np.tile(u, (model.n, 1)))
            - function(x - step, np.tile(u, (model.n, 1)))
        ) / 2e-5
        np.testing.assert_allclose(jacobian[0], slopes.T, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_a_task_of_ones_own_has_a_controller_and_a_score() -> None:
    flown = rollout("autopilot", "Docking-v0", range(8))
    assert scores(flown)["docked"].mean() == 100.0
    assert flown.score.min() > 0.8


def test_the_name_of_another_environment_is_not_taken() -> None:
    for name in ("CartPole-v1", "SegorogeniAUV-v0"):
        with pytest.raises(
            ValueError, match="is an environment already: give yours a name of its own"
        ):
            register_environment(replace(SegorogeniAUVEnv.system, name=name))


def test_random_keys_that_filter_keeps_stay_those_of_their_step() -> None:
    kept = []

    class Keeps(EnsembleKalmanFilter):
        def _predict(self, belief: Any, u: Any, *moved: Any) -> Any:
            kept.append((moved[-1], moved[-1].normals(3)))
            return super()._predict(belief, u, *moved)

    env = gym.make("SigmaCorvette-v0", estimator=Keeps)
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    for rng, drawn in kept:
        np.testing.assert_array_equal(rng.normals(3), drawn)


# --- a vehicle of one's own equations -------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ["Route-v0", "USV-v0"])
def test_a_vehicle_follows_the_waypoints_of_the_page_on_a_filter(env_id: str) -> None:
    shares = {}
    for estimator in ("truth", "ekf", "dead-reckoning"):
        flown = rollout("autopilot", env_id, range(8), {"estimator": estimator})
        if estimator == "dead-reckoning":  # believes that it arrives, and the truth decides
            assert (flown.end == "missed").mean() > 0.75
        else:
            assert (flown.end == "arrived").all()
        shares[estimator] = flown.score.mean()
    assert 0.9 > shares["truth"] > shares["ekf"] > 0.7 > shares["dead-reckoning"]


# --- what users' functions read -------------------------------------------------------------------


class Windy(my_vehicle.Catamaran):
    """A catamaran that a wind blows along."""

    def __init__(self) -> None:
        self.wind = 0.0

    def step(self, state: Any, before: Any, after: Any, exogenous: Any, parameters: Any) -> Any:
        moved = super().step(state, before, after, exogenous, parameters)
        return np.concatenate([moved[..., :1] + self.dt * self.wind, moved[..., 1:]], -1)


def test_what_a_numpy_method_reads_may_change() -> None:
    vehicle = Windy()
    core = Core(replace(gym.spec("Route-v0").entry_point.system, vehicle=vehicle), 2, "truth")
    core.start(5)
    for vehicle.wind in np.linspace(0.0, 2.0, 12):
        state, before, exogenous = core.now.state, core.now.actuators, core.now.exogenous
        core.step(np.full((2, 2), 0.5))
        expected = vehicle.step(state, before, core.now.actuators, exogenous, core.now.parameters)
        np.testing.assert_array_equal(core.now.state, expected)


def test_what_a_compiled_method_reads_is_frozen() -> None:
    class Frozen(Windy):
        step = compiled(Windy.step)

    vehicle = Frozen()
    core = Core(replace(gym.spec("Route-v0").entry_point.system, vehicle=vehicle), 2, "truth")
    core.start(5)
    for vehicle.wind in (0.0, 2.0):
        given = core.now.state, core.now.actuators, core.now.exogenous, core.now.parameters
        core.step(np.full((2, 2), 0.5))
        state, before, exogenous, parameters = given
        calm = Windy().step(state, before, core.now.actuators, exogenous, parameters)
        np.testing.assert_allclose(core.now.state, calm, rtol=1e-12)
