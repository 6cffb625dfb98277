"""What the pages on sensors, disturbances, tasks and vehicles of one's own show runs, is short, and stands a study."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from pages import OWN, PAGES, blocks, code, my_sensor

from agents import rollout
from agents.scores import scores
from agents.studies.plan import plan
from agents.studies.study import read_study
from estimators import EnsembleKalmanFilter
from vessel_gym.core import Core
from vessel_gym.envs import ItsunusaAUVEnv, SegorogeniAUVEnv, ShipEnv, SigmaCorvetteEnv, register_environment
from vessel_gym.estimation import estimator_names
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette import Corvette


@pytest.mark.parametrize("module", PAGES)
def test_a_part_of_ones_own_takes_thirty_lines_at_most(module: str) -> None:
    assert len([line for line in code(module).splitlines() if line.strip()]) <= 30


@pytest.mark.parametrize("page", [*PAGES.values(), "time-at-sea"])
def test_what_else_a_page_shows_runs(page: str) -> None:
    for example in blocks(page, "python"):
        exec(compile(example, page, "exec"), {"__name__": "page"})


@pytest.mark.slow
@pytest.mark.parametrize("env_id", OWN)
@pytest.mark.parametrize("estimator", estimator_names())
def test_every_estimator_that_ours_carry_carries_a_part_of_ones_own(env_id: str, estimator: str) -> None:
    ours = {"Docking-v0": ItsunusaAUVEnv, "HeavyShip-v0": ShipEnv}.get(env_id, SegorogeniAUVEnv)
    try:
        ours(estimator=estimator)
    except ValueError:
        pytest.skip("ours refuses it, too")
    few = {"pf": {"particles": 20}} | {key: {"members": 20} for key in ("enkf", "enkf-sr", "etkf", "letkf")}
    flown = rollout("random", env_id, range(2), {"estimator": estimator, "estimator_options": few.get(estimator, {})})
    for key in ("truth", "estimate", "covariance"):
        assert np.isfinite(flown.history[key]).all()
    assert np.isfinite(flown.returns).all()


@pytest.mark.slow
def test_who_is_told_of_ones_own_sensor_or_disturbance_is_as_good_as_it_says() -> None:
    """64 dives: the mean NEES of 14 components over hundreds of steps lies within a quarter of its expectation.

    Of 1,536 dives on other seeds two missed their goal: that three of 64 do happens once in ten thousand times.
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
        told = flown.env.unwrapped.core.composition.localisation
        assert told.any(0).all()  # no reading is ignored, and no state left uncorrected
        assert told.any(1).all() or name == "without"
    assert error["with"] < 0.8 * error["without"]


@pytest.mark.slow
def test_a_task_of_ones_own_has_pilot_score_and_picture() -> None:
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
[environments."Docking-v0"]
[environments."vessel_gym/Ship-v0"]

[estimators.truth]
[estimators.own]
estimator = "default"
[estimators.measurement]

[agents.autopilot]
"""


@pytest.mark.slow
def test_a_study_runs_over_parts_of_ones_own(tmp_path: Path) -> None:
    from agents.cells import run

    path = tmp_path / "own.toml"
    path.write_text(STUDY, encoding="utf-8")
    cells = {flight.cell.key: flight.cell for flight in plan(read_study(path)).flights}
    outcome = run(list(cells.values()), tmp_path / "results", jobs=1)
    assert not outcome.failures
    assert len(cells) == 4 * 4  # dead-reckoning flies in any case


def test_an_environment_of_ones_own_can_be_pickled() -> None:
    import pickle

    env = gym.make("Shear-v0", estimator="ekf").unwrapped
    env.reset(seed=0)
    copy = pickle.loads(pickle.dumps(env))
    for _ in range(5):
        action = np.full(3, 0.2, np.float32)
        np.testing.assert_array_equal(copy.step(action)[0], env.step(action)[0])


def test_the_name_of_another_environment_is_not_taken() -> None:
    for name in ("CartPole-v1", "SegorogeniAUV-v0"):
        with pytest.raises(ValueError, match="is an environment already: give yours a name of its own"):
            register_environment(replace(SegorogeniAUVEnv.system, name=name))


def test_numbers_of_ones_own_need_be_neither_doubles_nor_a_row_each() -> None:
    """What broadcasts in NumPy, or is float32, counts as its doubles for every row."""
    system = SigmaCorvetteEnv.system

    class Narrow(TurningCircle):
        def commanded(self, course: Any, step: Any) -> Any:
            return np.array([[0.005]], np.float32)

        def reference(self, course: Any, step: Any, state: Any) -> Any:
            return super().reference(course, step, state).astype(np.float32)

        def score(self, *args: Any) -> Any:
            _, end, tally = super().score(*args)
            return np.float32(0.25), end, tally

    class Light(Corvette):
        def actuate(self, before: Any, action: Any) -> Any:
            return super().actuate(before, action).astype(np.float32)

        def known_input(self, before: Any, after: Any, commanded: Any) -> Any:
            return super().known_input(before, after, commanded).astype(np.float32)

    task, vehicle = Narrow(system.vehicle.ship), Light()
    core = Core(replace(system, task=task, vehicle=vehicle), 4)
    core.start(0, None)
    for steps in range(1, 4):
        core.step(np.full((4, 1), 0.3, np.float32))
        np.testing.assert_array_equal(core.belief.u[:, 1], np.full(4, np.float32(0.005)))  # not only after a reset
        np.testing.assert_array_equal(core.total, np.full(4, 0.25 * steps))
        assert core.actuators.dtype == core.reference.dtype == float
    assert np.isfinite(core.observe()).all()
    one = Corvette().actuate(np.zeros((1, 1)), np.ones((1, 1)))
    np.testing.assert_array_equal(Corvette().actuate(np.zeros((4, 1)), np.ones((1, 1))), one.repeat(4, 0))


def test_numbers_that_a_filter_of_ones_own_keeps_stay_those_of_their_step() -> None:
    kept = []

    class Keeps(EnsembleKalmanFilter):
        def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
            kept.append((rng, rng.normals(3)))
            return super()._predict(belief, u, rng)

    env = gym.make("SigmaCorvette-v0", estimator=Keeps)
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    for rng, drawn in kept:
        np.testing.assert_array_equal(rng.normals(3), drawn)
