"""The console command: what it knows, how little it loads to say so, and whose module `agents` it wants."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import vessel_gym
from agents import commands
from agents.commands import train
from agents.commands.options import parsed
from vessel_gym.__main__ import main as vessel_gym_main

ROOT = Path(vessel_gym.__file__).parents[1]
COMMANDS = commands.COMMANDS
HEAVY = {"scipy", "llvmlite", "rich", "torch", "estimators.engine"}


def called(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int | None:
    monkeypatch.setattr(sys, "argv", ["vessel-gym", *arguments])
    return commands.main()


@pytest.mark.parametrize("arguments", [(), ("-h",), ("--help",)])
def test_alone_it_lists_every_command_with_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]
):
    assert called(monkeypatch, *arguments) == 0
    lines = [
        line.split(maxsplit=1)
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("  ")
    ]
    assert [name for name, _ in lines] == list(COMMANDS)
    assert all(sentence.endswith(".") and len(sentence) > 20 for _, sentence in lines)


def test_it_says_its_version(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    assert called(monkeypatch, "--version") == 0
    assert capsys.readouterr().out == f"vessel-gym {vessel_gym.__version__}\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_names_it_as_it_was_called(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
):
    with pytest.raises(SystemExit) as stop:
        called(monkeypatch, name, "--help")
    assert stop.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: vessel-gym {name} ")


def test_settings_of_several_options_count_together():
    words = ["--set", "gamma=0.9", "n_steps=2", "--set", "policy=MlpPolicy", "--seed", "3"]
    given = parsed(train.main, words, None).keywords
    assert given["set_"] == {"gamma": 0.9, "n_steps": 2, "policy": "MlpPolicy"}


def test_help_runs_in_a_checkout_and_loads_nothing_slow():
    names = ["vessel_gym.__main__", *(f"scripts.{each}" for each in COMMANDS)]
    program = f"""
import runpy, sys
sys.argv = ["vessel-gym", "--help"]
for name in {names}:
    try:
        runpy.run_module(name, run_name="__main__", alter_sys=True)
    except SystemExit as stop:
        print("ended", stop.code)
    if loaded := {HEAVY!r} & set(sys.modules):
        sys.exit(f"{{name}} loads {{loaded}}")
"""
    done = shell(ROOT, "-c", program)
    assert done.stderr == ""
    assert re.findall("^usage: |^ended .*", done.stdout, re.M) == ["usage: ", "ended 0"] * len(
        names
    )


def test_a_closed_pipe_ends_a_command_without_a_message():
    program = (
        "import sys; from agents.commands.console import command; command(lambda: print('x' *"
        " 1_000_000))"
    )
    call = [sys.executable, "-c", program]
    with subprocess.Popen(
        call, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A user's folder whose names are ours: packages agents and scripts."""
    for name in ("agents", "scripts"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    return tmp_path


def shell(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Python in a folder that is first on the path, ours second."""
    path = os.pathsep.join([str(folder), str(ROOT)])
    call = [sys.executable, *arguments]
    return subprocess.run(
        call, cwd=folder, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True
    )


@pytest.mark.parametrize("file", ["estimators.py", "estimators/__init__.py"])
def test_estimators_module_of_user_is_named(own: Path, file: str):
    (own / file).parent.mkdir(exist_ok=True)
    (own / file).touch()
    for arguments in (["-c", "import vessel_gym"], ["-m", "vessel_gym", "--version"]):
        done = shell(own, *arguments)
        assert done.returncode == 1
        last = done.stderr.splitlines()[-1]
        assert (
            f"vessel_gym needs its own package estimators, but {own / file} is found first: rename"
            in last
        )
    assert done.stderr.count("\n") == 1


def test_a_folder_of_files_that_is_called_like_a_package_is_none(own: Path):
    (own / "estimators").mkdir()
    assert shell(own, "-c", "import vessel_gym").returncode == 0


def test_who_wrote_over_our_agents_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def broken() -> None:
        raise ImportError("cannot import name 'load_agent' from 'agents'")

    owners = {"agents": ["vessel-gym", "openai-agents"]}
    monkeypatch.setattr("importlib.metadata.packages_distributions", lambda: owners)
    monkeypatch.setattr(commands, "main", broken)
    assert vessel_gym_main() == 2
    assert capsys.readouterr().err.startswith(
        "error: openai-agents has written over vessel-gym's package agents: "
    )
    del owners["agents"]
    with pytest.raises(ImportError):
        vessel_gym_main()
