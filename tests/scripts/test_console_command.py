"""The console command: what it knows, how little it loads to say so, and whose module `agents` it wants."""

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import vessel_gym
from scripts import __main__ as console_command
from scripts import console

ROOT = Path(vessel_gym.__file__).parents[1]
COMMANDS = console_command.COMMANDS
HEAVY = {"numpy", "scipy", "llvmlite", "gymnasium", "rich", "torch", "agents", "estimators", "vessel_gym"}


def called(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int | None:
    monkeypatch.setattr(sys, "argv", ["vessel-gym", *arguments])
    return console_command.main()


@pytest.mark.parametrize("arguments", [(), ("-h",), ("--help",)])
def test_alone_it_lists_every_command_with_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]
):
    assert called(monkeypatch, *arguments) == 0
    lines = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines() if line.startswith("  ")]
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


@pytest.mark.parametrize(
    "name",
    [
        "scripts.__main__",
        *(f"scripts.{each}" for each in COMMANDS),
        *(f"studies.{each}.__main__" for each in ("critic", "lorenz", "speed")),
    ],
)
def test_help_loads_nothing_that_takes_long_to_load(name: str):
    module = import_module(name)
    program = f"""
import sys
from contextlib import suppress
from {module.__name__} import main
from scripts.console import command
with suppress(SystemExit):
    sys.argv = ["vessel-gym"]
    main() if {name == "scripts.__main__"} else command(main, ["--help"])
print(*sorted({HEAVY!r} & set(sys.modules)), file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)
    assert "usage" in done.stdout
    assert done.stderr.split() == []


def test_a_closed_pipe_ends_a_command_without_a_message():
    program = "import sys; from scripts.console import command; command(lambda: print('x' * 1_000_000))"
    call = [sys.executable, "-c", program]
    with subprocess.Popen(call, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1


def test_an_agents_of_somebody_else_is_named_with_what_to_do(tmp_path: Path):
    (tmp_path / "agents").mkdir()
    (tmp_path / "agents" / "__init__.py").touch()
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    call = [sys.executable, "-P", "-m", "scripts", "evaluate"]
    done = subprocess.run(call, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == 2
    assert re.fullmatch("error: .*module agents.*python -m venv.*\n", done.stderr)
    assert str(tmp_path) in done.stderr


def test_who_wrote_over_our_agents_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    def main() -> None:
        raise ImportError("cannot import name 'load_agent' from 'agents'")

    owners = {"agents": ["vessel-gym", "openai-agents"]}
    monkeypatch.setattr("importlib.metadata.packages_distributions", lambda: owners)
    with pytest.raises(SystemExit) as stop:
        console.command(main, [])
    assert stop.value.code == 2
    assert capsys.readouterr().err.startswith("error: openai-agents has written over vessel-gym's module agents: ")
    del owners["agents"]
    with pytest.raises(ImportError):
        console.command(main, [])
