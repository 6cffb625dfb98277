"""What is not installed: whoever asks for it learns what to type, and nothing is imported that nobody brings."""

import ast
import re
import sys
import tomllib
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

from agents import save_agent
from agents.commands import ablate, reproduce, watch
from agents.commands import train as train_command
from agents.commands.console import command
from agents.jobs import run
from agents.page import write_page
from vessel_gym.extras import EXTRAS

ROOT = Path(__file__).parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def distributions(requirements: list[str]) -> set[str]:
    """Normal names of distributions, without versions; dask[distributed] is dask and distributed."""
    return {
        name.lower().replace("_", "-")
        for text in requirements
        for name in re.split(r"[^\w.-]", text)
    }


def extra(name: str) -> set[str]:
    """The distributions that an extra brings, those of the extras in it included."""
    found = distributions(PROJECT["optional-dependencies"][name])
    for inner in re.findall(
        r"vessel-gym\[([\w,]+)\]", " ".join(PROJECT["optional-dependencies"][name])
    ):
        found = found.union(*map(extra, inner.split(",")))
    return found - {"vessel-gym"}


def test_every_extra_brings_its_modules():
    homes = packages_distributions()
    for name, modules in EXTRAS.items():
        assert modules
        for module in modules:
            assert distributions(homes[module]) & extra(name), (name, module)
        assert extra(name) <= extra("all")


@pytest.mark.slow
def test_every_import_is_a_dependency_or_in_an_extra():
    homes = packages_distributions()
    known = set(sys.stdlib_module_names) | {
        "estimators",
        "vessel_gym",
        "agents",
        "scripts",
        "studies",
    }
    brought = distributions(PROJECT["dependencies"]) | extra("all")
    for package in ("estimators", "vessel_gym", "agents", "scripts"):
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and not node.level:
                    names = [node.module or ""]
                for module in {name.partition(".")[0] for name in names} - known:
                    assert distributions(homes[module]) & brought, (path, module)


def sentence(module: str, name: str) -> str:
    return re.escape(
        f"this needs {module}, which is not installed: pip install 'vessel-gym[{name}]'"
    )


def test_the_adapter_and_a_picture_say_what_to_type(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delitem(sys.modules, "agents.training.vec_env", raising=False)
    for module in ("stable_baselines3", "pygame"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ModuleNotFoundError, match=sentence("stable_baselines3", "train")) as caught:
        import_module("agents.training.vec_env")
    assert caught.value.name == "stable_baselines3"
    with pytest.raises(ModuleNotFoundError, match=sentence("stable_baselines3", "train")):
        save_agent(None, "agent.zip")
    for module, needed in {
        "jinja2": lambda: write_page(tmp_path / "a.html", "", "", [], []),
        "joblib": lambda: run([], tmp_path),
    }.items():
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(ModuleNotFoundError, match=sentence(module, "report")):
            needed()
    env = gym.make("SigmaCorvette-v0", render_mode="rgb_array")
    env.reset(seed=0)  # a learner that asks for pictures beforehand, and draws none, runs
    env.step(env.action_space.sample())
    with pytest.raises(gym.error.DependencyNotInstalled, match=sentence("pygame", "render")):
        env.render()


@pytest.mark.parametrize(
    ("main", "arguments", "module", "name"),
    [
        (train_command.main, ["--out", "agent.zip"], "torch", "train"),
        (
            ablate.main,
            ["nothing.toml"],
            "jinja2",
            "report",
        ),  # before the study is read, whose filters would be compiled
        (
            ablate.main,
            [str(ROOT / "studies" / "quick.toml"), "--scheduler", "tcp://127.0.0.1:9"],
            "dask",
            "cluster",
        ),
        (reproduce.main, ["all"], "joblib", "report"),
        (watch.main, ["--out", "turn.gif"], "imageio", "render"),
    ],
)
def test_command_without_its_extra_says_what_to_type(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    main: Callable[..., Any], arguments: list[str], module: str, name: str,
):  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(SystemExit) as stop:
        command(main, arguments)
    assert stop.value.code == 2
    assert re.search(sentence(module, name), capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == []
