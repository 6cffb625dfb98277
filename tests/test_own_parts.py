"""Sensors, disturbances, tasks and vehicles of one's own, as their pages show them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from pages import OWN, PAGES, code, my_sensor, my_vehicle

from agents import rollout
from agents.metrics import scores
from agents.studies.plan import plan
from agents.studies.study import read_study
from estimators import EnsembleKalmanFilter, compiled
from estimators.metrics import chi_square_band, nees
from estimators.varying import is_compiled
from vessel_gym.core import Core
from vessel_gym.envs import (
    ItsunusaAUVEnv,
    SegorogeniAUVEnv,
    ShipEnv,
    ThesisCorvetteEnv,
    register_environment,
)
from vessel_gym.estimation import estimator_names


@pytest.mark.parametrize("module", PAGES)
def test_a_part_of_ones_own_takes_few_formatted_lines(module: str) -> None:
    assert len([line for line in code(module).splitlines() if line.strip()]) <= (
        {"my_vehicle": 55, "usv": 120}.get(module, 45)
    )


@pytest.mark.parametrize("env_id", [*OWN, "USV-v0", "Route-v0"])
def test_filters_run_the_equations_of_a_page_compiled_with_their_exact_derivatives(
    env_id: str,
) -> None:
    env: Any = gym.make(env_id, estimator="ekf")
    env.reset(seed=0)
    core = env.unwrapped.core
    model, x, u = (
        core.config.composition.model,
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
@pytest.mark.parametrize("env_id", OWN)
@pytest.mark.parametrize("estimator", estimator_names())
def test_every_estimator_that_ours_carry_carries_a_part_of_ones_own(
    env_id: str, estimator: str
) -> None:
    ours = {"Docking-v0": ItsunusaAUVEnv, "HeavyShip-v0": ShipEnv}.get(env_id, SegorogeniAUVEnv)
    try:
        ours(estimator=estimator)
    except ValueError:
        pytest.skip("ours refuses it, too")
    few = {"pf": {"particles": 20}}
    flown = rollout(
        "random",
        env_id,
        range(2),
        {"estimator": estimator, "estimator_options": few.get(estimator, {})},
    )
    for key in ("truth", "estimate", "covariance"):
        assert np.isfinite(flown.history[key]).all()
    assert np.isfinite(flown.returns).all()


@pytest.mark.slow
def test_filters_that_assume_ones_own_sensor_or_disturbance_are_consistent() -> None:
    """64 dives: the mean NEES of 14 components over hundreds of steps lies within a quarter of its expectation.

    Of 1,536 dives on other seeds two missed their goal: that three of 64 do happens once in ten
    thousand times.
    """
    for env_id in ("Usbl-v0", "Shear-v0"):
        figures = scores(rollout("autopilot", env_id, range(64), {"estimator": "ekf"}))
        assert (figures["arrived"] < 100.0).sum() <= 2
        assert 0.75 < figures["nees"].mean() < 1.25


@pytest.mark.slow
def test_a_sensor_of_ones_own_is_not_ignored_by_the_default_filter() -> None:
    """It halves the error: 0.51 ± 0.07 times in twelve times 16 dives on other seeds, and once where it is ignored."""
    without = [s for s in my_sensor.SENSORS if s.name != "USBL"]
    error = {}
    for name, sensors in (("with", my_sensor.SENSORS), ("without", without)):
        flown = rollout("autopilot", "SegorogeniAUV-v0", range(16), {"sensors": sensors})
        error[name] = scores(flown)["position_rmse"].mean()
    assert error["with"] < 0.8 * error["without"]


@pytest.mark.slow
def test_a_task_of_ones_own_has_controller_score_and_picture() -> None:
    pytest.importorskip("pygame")
    flown = rollout("autopilot", "Docking-v0", range(8))
    assert scores(flown)["docked"].mean() == 100.0
    assert flown.score.min() > 0.8
    env = gym.make("Docking-v0", render_mode="rgb_array")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


STUDY = """
title = "Parts of one's own"
episodes = 2

[environments."Usbl-v0"]
[environments."Shear-v0"]

[estimators.truth]
[estimators.own]
estimator = "default"

[agents.autopilot]
"""


@pytest.mark.slow
def test_a_study_runs_over_parts_of_ones_own(tmp_path: Path) -> None:
    from agents.jobs import run

    path = tmp_path / "own.toml"
    path.write_text(STUDY, encoding="utf-8")
    jobs = {flight.job.key: flight.job for flight in plan(read_study(path)).flights}
    outcome = run(list(jobs.values()), tmp_path / "results", processes=1)
    assert not outcome.failures
    assert len(jobs) == 2 * 3  # dead-reckoning flies in any case


def test_the_name_of_another_environment_is_not_taken() -> None:
    for name in ("CartPole-v1", "SegorogeniAUV-v0"):
        with pytest.raises(
            ValueError, match="is an environment already: give yours a name of its own"
        ):
            register_environment(replace(SegorogeniAUVEnv.system, name=name))


def test_numbers_that_a_filter_of_ones_own_keeps_stay_those_of_their_step() -> None:
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


@pytest.mark.parametrize("env_id", ["USV-v0", "Route-v0"])
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


def test_filters_of_ones_own_equations_are_as_good_as_they_say_and_rows_alike() -> None:
    """The mean NEES of 200 rows within its band, left by chance once in 10,000 times; a row is a single environment."""
    made = {"num_envs": 200, "sensors": "nominal", "disturbance": "moderate"}
    many, one = gym.make_vec("Route-v0", **made), gym.make("Route-v0")
    many.reset(seed=7)
    one.reset(seed=7 + 3)
    for _ in range(40):
        info = many.step(np.tile(np.float32([0.5, 0.45]), (200, 1)))[4]
        alone = one.step(np.float32([0.5, 0.45]))[4]
    core = many.unwrapped.core
    truth, angles = (
        core.config.true_state.in_filter_order(core.truth),
        core.config.estimation.filter.model.state_angles,
    )
    low, high = chi_square_band(200, truth.shape[1], 1.0 - 1e-4)
    assert low < nees(core.now.belief.mean, core.now.belief.cov, truth, angles).mean() < high
    for name in ("truth", "measurement", "available"):
        np.testing.assert_array_equal(info[name][3], alone[name])
    np.testing.assert_allclose(info["estimate"][3], alone["estimate"], rtol=1e-9, atol=1e-12)


THESIS = ThesisCorvetteEnv.system


def own(part: str, **members: Any) -> Any:
    """The thesis's system with a subclass of its vehicle or task."""
    of = getattr(THESIS, part)
    mine = object.__new__(type("Mine", (type(of),), members))
    vars(mine).update(vars(of))
    return replace(THESIS, **{part: mine})


@pytest.mark.parametrize("part", ["vehicle", "task"])
def test_a_subclass_in_numpy_flies_to_the_bit_as_its_base(part: str) -> None:
    flights = []
    for system in (THESIS, own(part)):
        core = Core(system, 3, "ekf")
        core.start(0)
        core.step(np.full(core.action_shape, 0.5))
        flights.append(core.info() | {"seen": core.observe()})
    for name, values in flights[0].items():
        np.testing.assert_array_equal(values, flights[1][name], name)


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
