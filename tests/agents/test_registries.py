"""What a user brings is as good as what the package has.

A task flies, is scored, drawn and trained with nothing registered; what is registered for it is
found wherever ours is.
"""

from collections.abc import Iterator
from contextlib import closing
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from own_task import SYSTEM, DepthController, KeepDepth, KeepShallowDepth, system_with
from refusals import refused

import agents
from agents import Metric, load_agent, register_controller, register_metrics, rollout
from agents.commands import evaluate
from agents.controllers import CONTROLLERS, controller_names
from agents.metrics import TASK_METRICS, metrics, scores
from agents.source import _sources, source_digest
from agents.studies import worlds
from agents.studies.plan import plan
from agents.studies.records import Study
from agents.studies.study import StudyError, read_study
from vessel_gym.registry import Registry
from vessel_gym.rendering.renderer import Renderer
from vessel_gym.simulation.core import Core
from vessel_gym.system import System
from vessel_gym.tasks.dive import Dive
from vessel_gym.tasks.task import Workspace

ENV, OWN = "KeepDepth-v0", "own_task:DepthController"
COMMON = ["score", "return", "steps", "steering_travel", "reversals", "saturation"]
ENDS = ("input_rmse", "nees", "unhealthy")


@pytest.fixture(autouse=True)
def nothing_stays() -> Iterator[None]:
    """Registries are as they were after each test."""
    registries = (TASK_METRICS, CONTROLLERS)
    for registry in registries:
        registry.of(None)  # ours are there
    before = [deepcopy(registry._entries) for registry in registries]
    yield
    for registry, entries in zip(registries, before, strict=True):
        registry._entries = entries


# --- nothing registered ---------------------------------------------------------------------------


@pytest.mark.parametrize("agent", [OWN, "random"])
def test_a_task_of_ones_own_flies_and_is_scored_without_metrics(agent: str):
    flight = rollout(agent, ENV, [1, 2])
    figures = scores(flight)
    names = ("u", "w", "q", "x", "z", "theta", "current")
    assert list(figures) == [*COMMON, *(f"{name}_rmse" for name in names), *ENDS]
    assert [m.key for m in metrics(SYSTEM)] == list(figures)
    assert np.isnan(figures.pop("input_rmse")).all()  # which no filter assumes
    assert all(np.isfinite(values).all() and values.shape == (2,) for values in figures.values())
    h = flight.history
    depth = np.sqrt(np.mean((h["estimate"][..., 4] - h["truth"][..., 4]) ** 2, axis=0))
    np.testing.assert_allclose(figures["z_rmse"], depth)


def test_the_commands_take_a_task_and_a_controller_of_ones_own(capsys: pytest.CaptureFixture[str]):
    evaluate.main(f"own_task:{ENV}", agent=OWN, episodes=2)
    printed = capsys.readouterr().out
    for label in ("Score", "theta", "NEES"):
        assert label in printed


@pytest.mark.slow
def test_a_task_of_ones_own_is_trained(tmp_path: Path):
    from agents.training.algorithms import train

    checkpoint = train(ENV, tmp_path / "ppo.zip", steps=8192)
    assert rollout(checkpoint, ENV, [0]).length[0] == 60


@pytest.mark.parametrize(
    ("agent", "error", "sentence"),
    [
        (
            "autopilot",
            ValueError,
            "unknown agent 'autopilot' for KeepDepth: choose ppo, random, the path of a checkpoint,"
            " your own as module:object, or .* agents.register_controller$",
        ),
        ("own_task:no_agent", TypeError, "'own_task:no_agent' makes str"),
        ("own_task:SYSTEM", TypeError, "cannot be called"),
        ("own_task:Nobody", ValueError, "has no 'Nobody'"),
        ("nowhere:Controller", ValueError, "cannot import 'nowhere'"),
    ],
)
def test_what_makes_no_agent_is_refused_in_one_sentence(agent: str, error: type, sentence: str):
    with closing(gym.make(ENV)) as env, refused(error, sentence):
        load_agent(agent, env)


# --- registered -----------------------------------------------------------------------------------


def _offset(flown: agents.Rollout) -> np.ndarray:
    return np.abs(flown.history["truth"][-1, :, 4] - flown.history["reference"][0, :, 0])


def _pitch(flown: agents.Rollout) -> np.ndarray:
    return np.rad2deg(np.abs(flown.history["truth"][-1, :, 5]))


def _dock(task: KeepDepth, scenario: np.ndarray) -> Workspace:
    return Workspace("torpedo", 1.5, goal=(8.0, 0.0, scenario[0], 0.5))


OFFSET = Metric(
    "offset", "Offset", "m", "lower", 2, "Distance from the depth at the end.", of=_offset
)
PITCH = Metric("pitch", "Pitch", "°", "lower", 1, "Pitch at the end.", of=_pitch)


def test_registrations_of_task_hold_for_its_subclasses():
    register_metrics(KeepDepth, (OFFSET, PITCH))
    register_controller(KeepDepth, "autopilot")(DepthController)
    for task in (KeepDepth(), KeepShallowDepth()):
        keys = [m.key for m in metrics(system_with(task))]
        assert keys == [*COMMON, "offset", "pitch", *ENDS]
        assert controller_names(system_with(task)) == ("autopilot",)
    flight = rollout("autopilot", ENV, [3, 4])
    figures, last = scores(flight), flight.history["truth"][-1]
    off = np.abs(last[:, 4] - flight.history["reference"][-1, :, 0])
    np.testing.assert_allclose(figures["offset"], off)
    np.testing.assert_allclose(figures["pitch"], np.rad2deg(np.abs(last[:, 5])))
    np.testing.assert_array_equal(figures["score"], rollout(OWN, ENV, [3, 4]).score)


def test_registration_of_nearest_class_counts():
    """The same module may register again."""
    shallow = system_with(KeepShallowDepth())
    register_metrics(KeepDepth, (OFFSET,))
    register_metrics(KeepShallowDepth, (PITCH,))
    assert [m.key for m in metrics(shallow)] == [*COMMON, "pitch", *ENDS]
    assert [m.key for m in metrics(SYSTEM)] == [*COMMON, "offset", *ENDS]
    register_metrics(KeepDepth, (PITCH,))
    register_metrics(KeepShallowDepth, [*metrics(SYSTEM), OFFSET])
    assert [m.key for m in metrics(shallow)] == [*COMMON, "pitch", *ENDS, "offset"]
    register_metrics(
        KeepDepth, [Metric("steps", "Steps", "", "higher", 0, "Till lost.", of=_offset)]
    )
    assert [m.meaning for m in metrics(SYSTEM) if m.key == "steps"] == ["Till lost."]


def test_a_metric_that_is_not_one_value_an_episode_is_refused():
    register_metrics(KeepDepth, (replace(OFFSET, of=lambda flown: flown.history["truth"][..., 0]),))
    register_controller(KeepDepth, "autopilot")(DepthController)
    with refused(ValueError, "metric 'offset' must be one value an episode"):
        scores(rollout("autopilot", ENV, [3, 4]))


def test_the_packages_entries_are_registered_before_a_users():
    """Otherwise the package would be refused its own, when they are first looked for."""
    registry: Registry[int] = Registry("metrics", lambda: registry.register(KeepDepth, 1, "ours"))
    with refused(ValueError, "KeepDepth has its metrics from ours: subclass"):
        registry.register(KeepDepth, 2, "mine")


@pytest.mark.parametrize(
    ("attempt", "error", "sentence"),
    [
        (lambda: register_metrics("KeepDepth", ()), TypeError, "for a class of tasks"),  # type: ignore[arg-type]
        (lambda: register_metrics(KeepDepth, (OFFSET, OFFSET)), ValueError, "keys of their own"),
        (
            lambda: register_controller(Dive, "autopilot")(DepthController),
            ValueError,
            "its controller 'autopilot' from agents.controllers.dive: subclass",
        ),
        (
            lambda: register_controller(KeepDepth(), "me")(DepthController),
            TypeError,
            "class of tasks",
        ),  # type: ignore[arg-type]
        (lambda: register_controller(KeepDepth, "a:b"), ValueError, "without a colon"),
        (
            lambda: register_controller(KeepDepth, "random"),
            ValueError,
            "other than random, ppo, checkpoint",
        ),
        (lambda: Workspace("boat"), ValueError, "unknown hull 'boat'"),
    ],
)
def test_what_cannot_be_registered_is_refused_in_one_sentence(attempt, error: type, sentence: str):
    with refused(error, sentence):
        attempt()


# --- pictures -------------------------------------------------------------------------------------


def picture(system: System, steps: int = 5, **options: Any) -> np.ndarray:
    """A picture of more than 50 colours, some steps into an episode."""
    pytest.importorskip("pygame")
    core = Core(system, 1, **options)
    core.start(seed=0)
    renderer = Renderer(core, "rgb_array", 20)
    renderer.record(begin=True)
    for _ in range(steps):
        core.step(np.full((1, core.config.action_size), 0.5))
        renderer.record(begin=False)
    drawn = renderer.draw()
    assert drawn is not None
    assert len(np.unique(drawn @ [65536, 256, 1])) > 50
    return drawn


def test_workspace_of_a_task_is_drawn(monkeypatch):
    alone = picture(SYSTEM)
    assert alone.shape == (720, 1008, 3)
    monkeypatch.setattr(KeepDepth, "workspace", _dock)
    assert (picture(system_with(KeepShallowDepth())) != alone).any()  # which inherits it
    page = agents.episode(ENV, ["ekf"], OWN, seed=5).page
    assert page["scene"]["goal"][2] == rollout(OWN, ENV, [5]).history["reference"][0, 0, 0]
    assert page["scene"]["hull"] == "torpedo"


# --- studies, and what results depend on ----------------------------------------------------------

STUDY = f"""
episodes = 2
[environments]
"own_task:{ENV}" = {{}}
SigmaCorvette-v0 = {{}}
[estimators]
truth = {{}}
[agents]
mine = {{ kind = "{OWN}", environments = ["own_task:{ENV}"] }}
lqg = {{ environments = ["SigmaCorvette-v0"] }}
"""


def read(tmp_path: Path, text: str) -> Study:
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    return read_study(tmp_path / "study.toml")


def test_studies_fly_registered_controllers_of_each_task(tmp_path: Path):
    planned = plan(read(tmp_path, STUDY))
    flown = {(f.environment.partition(":")[2] or f.environment, f.policy) for f in planned.flights}
    assert flown == {(ENV, "mine"), ("SigmaCorvette-v0", "lqg"), ("SigmaCorvette-v0", "autopilot")}
    assert [(s.what, "unknown agent 'autopilot'" in s.reason) for s in planned.skipped] == [
        ("autopilot", True)
    ]


def test_user_defined_controller_replaces_missing_autopilot(tmp_path: Path):
    alone = STUDY.replace("SigmaCorvette-v0 = {}\n", "").replace(
        'lqg = { environments = ["SigmaCorvette-v0"] }\n', ""
    )
    assert [agent.name for agent in read(tmp_path, alone).agents] == ["mine"]
    without = "".join(
        line for line in alone.splitlines(keepends=True) if not line.startswith("mine")
    )
    with pytest.raises(
        StudyError, match="no environment of the study has an autopilot: name a controller"
    ):
        read(tmp_path, without)


def test_job_depends_on_metrics_and_controllers_of_all_tasks():
    imported = _sources("agents.studies.flying")
    ours = {
        f"agents.{room}.{task}"
        for room in ("controllers", "metrics")
        for task in ("dive", "flight", "turning")
    }
    assert ours | {"agents.controllers", "agents.metrics"} <= set(imported)


def test_job_depends_on_modules_that_register(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    text = (
        "import own_task\nfrom agents import register_controller,"
        " register_metrics\nregister_metrics(own_task.KeepDepth,"
        " ())\n@register_controller(own_task.KeepDepth, 'mine')\nclass"
        " Mine(own_task.DepthController):\n    gain = 1\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "registered_elsewhere.py"
    path.write_text(text, encoding="utf-8")
    worlds.import_own({"registered_elsewhere": ""})
    digests = []
    for written in (text, text.replace("gain = 1", "gain = 2")):
        path.write_text(written, encoding="utf-8")
        source_digest.cache_clear()
        digests.append(worlds.digests(f"own_task:{ENV}", "mine"))
    assert [list(each) for each in digests] == 2 * [["own_task", "registered_elsewhere"]]
    assert digests[0] != digests[1]
    assert worlds.digests("SigmaCorvette-v0", "autopilot") == {}
