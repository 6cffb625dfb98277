"""The packages as packages: who imports whom, what an import costs, what is registered and documented."""

import ast
import importlib
import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import gymnasium as gym
import pytest
from contract import MANUALS, OURS, single_class, vector_class

import vessel_gym
from vessel_gym.models.estimation import estimator_names
from vessel_gym.sensors import SUITE_NAMES
from vessel_gym.simulation.configuration import OBSERVE
from vessel_gym.simulation.core import Core

ROOT = Path(__file__).parents[2]
HEAVY = {
    "torch",
    "stable_baselines3",
    "pygame",
    "matplotlib",
    "jinja2",
    "imageio",
    "rich",
    "joblib",
}
"""What only a command, a picture or a training needs."""


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imported(path: Path) -> set[str]:
    """The top-level packages that a module imports."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    names = {alias.name for n in nodes if isinstance(n, ast.Import) for alias in n.names}
    names |= {n.module or "" for n in nodes if isinstance(n, ast.ImportFrom) and not n.level}
    return {name.split(".")[0] for name in names}


def test_estimators_know_numpy_and_scipy_only():
    for path in modules("estimators"):
        known = {"estimators", "numpy", "scipy"}
        if path.stem == "consistency":
            known.add(
                "matplotlib"
            )  # inside its one figure function: importing the package does not load it
        if path.parent.name == "engine":
            known.add("llvmlite")  # inside functions: loaded when an equation is compiled
        foreign = imported(path) - set(sys.stdlib_module_names) - known
        assert not foreign, path


def test_torch_and_stable_baselines3_are_for_agents_alone():
    for package in ("estimators", "vessel_gym", "scripts"):
        for path in modules(package):
            assert not imported(path) & {"torch", "stable_baselines3"}, path


def loaded(program: str) -> set[str]:
    """Modules that a program has loaded when it ends."""
    run = [sys.executable, "-W", "error", "-c", f"{program}\nimport sys; print(*sys.modules)"]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize("package", ["estimators", "vessel_gym", "agents"])
def test_importing_a_package_loads_nothing_heavy(package: str):
    """Registration needs no equations of motion: they are imported by the first ``make``."""
    compiling = {"llvmlite", "scipy"} if package == "vessel_gym" else set()
    assert not loaded(f"import {package}") & (HEAVY | compiling)


FAMILIES = {
    "SigmaCorvette-v0": "ship", "SigmaChannel-v0": "ship", "ThesisCorvette-v0": "thesis_corvette",
    "SegorogeniAUV-v0": "auv", "ItsunusaAUV-v0": "auv", "PunaUAV-v0": "fixed_wing",
}  # fmt: skip
MOST = {"vessel_gym": 55, "estimators": 28}
"""Modules that a first use may import; a channel's route takes five of them."""


@pytest.mark.parametrize("env_id", [
    pytest.param(env_id, marks=pytest.mark.nightly if family != "ship" else ())
    for env_id, family in FAMILIES.items()
])  # fmt: skip
def test_a_first_make_imports_its_own_family_alone(env_id: str):
    made = f"gymnasium.make('vessel_gym:{env_id}', estimator='ekf')"
    if "estimators.engine.driver" in (found := loaded(f"import gymnasium; {made}")):
        found = loaded(f"import gymnasium; {made}")  # the first one has compiled
    assert not found & HEAVY
    families = {f"vessel_gym.envs.{family}" for family in FAMILIES.values()}
    assert families & found == {f"vessel_gym.envs.{FAMILIES[env_id]}"}
    for package, most in MOST.items():
        assert sum(name.partition(".")[0] == package for name in found) <= most, package
    assert "scipy.optimize" not in found


def test_the_version_is_said_once():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert vessel_gym.__version__ == project["version"]
    changelog = (ROOT / "CHANGELOG.md").read_text()
    assert project["version"] in changelog
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.search(
        rf"^version: [\"']?{re.escape(project['version'])}[\"']?$", citation, re.MULTILINE
    )


@pytest.mark.parametrize("package", ["estimators", "agents", "vessel_gym", "vessel_gym.envs"])
def test_every_public_name_exists_and_is_documented(package: str):
    module = importlib.import_module(package)
    assert module.__doc__
    assert len(set(module.__all__)) == len(module.__all__)
    for name in module.__all__:
        assert getattr(module, name).__doc__, name


@pytest.mark.parametrize("env_id", OURS)
def test_environment_is_registered_with_both_faces_and_horizon(env_id: str):
    spec = gym.spec(env_id)
    single, vector = single_class(env_id), vector_class(env_id)
    assert issubclass(single, gym.Env)
    assert issubclass(vector, gym.vector.VectorEnv)
    assert single.system is vector.system
    assert spec.max_episode_steps == single.system.task.horizon
    assert spec.order_enforce


@pytest.mark.parametrize("env_id", MANUALS)
def test_the_docstring_of_an_environment_is_its_manual(env_id: str):
    cls = single_class(env_id)
    manual = cls.__doc__ or ""
    for heading in ("Action", "Observation", "Reward", "Start", "End", "Version"):
        assert re.search(rf"\b{heading}", manual), heading
    assert not re.search(r"^\s*%", manual, re.MULTILINE)  # in Markdown a comment
    system, bound = cls.system, cls.system.task.BOUND
    sizes = {mode: Core(system, observe=mode).config.observation_size for mode in OBSERVE}
    names = [
        *system.disturbances,
        *SUITE_NAMES,
        *OBSERVE,
        *estimator_names(),
        *cls.metadata["render_modes"],
    ]
    for name in names:
        assert re.search(rf"[`\"]{re.escape(name)}[`\"]", manual), name
    assert f"Box({-bound:g}, {bound:g}, ({sizes['mean']},), float32)" in manual
    assert f"Box(-1, 1, ({len(system.vehicle.action_names)},), float32)" in manual
    assert f"({sizes['mean+std']},)" in manual
    assert f"after {system.task.horizon} steps" in manual


@pytest.mark.parametrize("env_id", OURS)
def test_make_vec_chooses_the_native_batch_without_being_asked(env_id: str):
    env = gym.make_vec(env_id, num_envs=2)
    assert isinstance(env, vector_class(env_id))
    assert env.unwrapped.max_episode_steps == gym.spec(env_id).max_episode_steps
