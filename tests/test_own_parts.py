"""What the pages on sensors, disturbances, tasks and vehicles of one's own show runs, is short, and stands a study."""

import importlib
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from agents import rollout
from agents.scores import scores
from agents.studies.plan import plan
from agents.studies.study import read_study
from vessel_gym.envs import ItsunusaAUVEnv, SegorogeniAUVEnv, register_environment
from vessel_gym.estimation import estimator_names

DOCS = Path(__file__).parents[1] / "docs"
PAGES = {"my_sensor": "own-sensor", "my_disturbance": "own-disturbance", "my_task": "own-task"}
OWN = ("Usbl-v0", "Shear-v0", "Docking-v0")


def code(module: str) -> str:
    page = (DOCS / f"{PAGES[module]}.md").read_text(encoding="utf-8")
    return re.search(rf"^```python {module}\n(.*?)^```", page, re.M | re.S)[1]  # type: ignore[index]


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimpleNamespace]:
    """The modules of the pages, imported, and environments of a sensor and a disturbance of one's own."""
    folder = tmp_path_factory.mktemp("own")
    for module in PAGES:
        (folder / f"{module}.py").write_text(code(module), encoding="utf-8")
    sys.path.insert(0, str(folder))
    try:
        own = SimpleNamespace(**{module: importlib.import_module(module) for module in PAGES})
        system = SegorogeniAUVEnv.system
        register_environment(replace(system, name="Usbl-v0", sensors=tuple(own.my_sensor.SENSORS)))
        shear = dict.fromkeys(("calm", "moderate", "rough"), own.my_disturbance.SHEAR)
        register_environment(replace(system, name="Shear-v0", disturbances=shear))
        yield own
    finally:
        sys.path.remove(str(folder))
        for module in PAGES:
            sys.modules.pop(module, None)
        for name in OWN:
            gym.registry.pop(name, None)


@pytest.mark.parametrize("module", PAGES)
def test_a_part_of_ones_own_takes_thirty_lines_at_most(module: str) -> None:
    assert len([line for line in code(module).splitlines() if line.strip()]) <= 30


@pytest.mark.parametrize("page", PAGES.values())
def test_what_else_a_page_shows_runs(page: str, parts: SimpleNamespace) -> None:
    for example in re.findall(r"^```python\n(.*?)^```", (DOCS / f"{page}.md").read_text(encoding="utf-8"), re.M | re.S):
        exec(compile(example, page, "exec"), {"__name__": "page"})


@pytest.mark.slow
@pytest.mark.parametrize("env_id", OWN)
@pytest.mark.parametrize("estimator", estimator_names())
def test_every_estimator_that_ours_carry_carries_a_part_of_ones_own(
    env_id: str, estimator: str, parts: SimpleNamespace
) -> None:
    ours = ItsunusaAUVEnv if env_id == "Docking-v0" else SegorogeniAUVEnv
    try:
        ours(estimator=estimator)
    except ValueError:
        pytest.skip("ours refuses it, too")
    members = {"members": 20} if estimator in ("enkf", "enkf-sr", "etkf") else {}
    flown = rollout("random", env_id, range(2), {"estimator": estimator, "estimator_options": members})
    for key in ("truth", "estimate", "covariance"):
        assert np.isfinite(flown.history[key]).all()
    assert np.isfinite(flown.returns).all()


@pytest.mark.slow
def test_who_is_told_of_ones_own_sensor_or_disturbance_is_as_good_as_it_says(parts: SimpleNamespace) -> None:
    """64 dives: the mean NEES of 14 components over hundreds of steps lies within a quarter of its expectation."""
    for env_id in ("Usbl-v0", "Shear-v0"):
        figures = scores(rollout("autopilot", env_id, range(64), {"estimator": "ekf"}))
        assert figures["arrived"].mean() == 100.0
        assert 0.75 < figures["nees"].mean() < 1.25


@pytest.mark.slow
def test_a_sensor_of_ones_own_is_not_ignored_by_the_default_filter(parts: SimpleNamespace) -> None:
    without = [s for s in parts.my_sensor.SENSORS if s.name != "USBL"]
    error = {}
    for name, sensors in (("with", parts.my_sensor.SENSORS), ("without", without)):
        flown = rollout("autopilot", "SegorogeniAUV-v0", range(16), {"sensors": sensors})
        error[name] = scores(flown)["position_rmse"].mean()
        told = flown.env.unwrapped.core.composition.localisation
        assert told.any(0).all()  # no reading is ignored, and no state left uncorrected
        assert told.any(1).all() or name == "without"
    assert error["with"] < 0.5 * error["without"]


@pytest.mark.slow
def test_a_task_of_ones_own_has_pilot_score_and_picture(parts: SimpleNamespace) -> None:
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
def test_a_study_runs_over_parts_of_ones_own(parts: SimpleNamespace, tmp_path: Path) -> None:
    from agents.cells import run

    path = tmp_path / "own.toml"
    path.write_text(STUDY, encoding="utf-8")
    cells = {flight.cell.key: flight.cell for flight in plan(read_study(path)).flights}
    outcome = run(list(cells.values()), tmp_path / "results", jobs=1)
    assert not outcome.failures
    assert len(cells) == 4 * 4  # dead-reckoning flies in any case


def test_an_environment_of_ones_own_can_be_pickled(parts: SimpleNamespace) -> None:
    import pickle

    env = gym.make("Shear-v0", estimator="ekf").unwrapped
    env.reset(seed=0)
    copy = pickle.loads(pickle.dumps(env))
    for _ in range(5):
        action = np.full(3, 0.2, np.float32)
        np.testing.assert_array_equal(copy.step(action)[0], env.step(action)[0])


def test_the_name_of_another_environment_is_not_taken(parts: SimpleNamespace) -> None:
    for name in ("CartPole-v1", "SegorogeniAUV-v0"):
        with pytest.raises(ValueError, match="is an environment already: give yours a name of its own"):
            register_environment(replace(SegorogeniAUVEnv.system, name=name))
