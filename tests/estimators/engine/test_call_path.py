"""The call path in machine code: fenced by a test of itself, and never needed for a result."""

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_environment import ROOT, interpreter

from estimators.engine import compiled, function, matching

SCRIPT = Path(__file__).with_name("calls.py")
PYTHONS = "3.11", "3.12", "3.13", "3.14"
NUMPYS = "2.2.*", "2.3.*", "2.4.*", ">=2.4"


def test_calls_are_in_machine_code_here():
    assert matching.is_layout_known()
    assert matching.is_right(matching._created())


@pytest.mark.parametrize("head", [-8, 8])
def test_arrays_laid_out_otherwise_turn_the_fast_path_off(
    head: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(matching, "_HEAD", matching._HEAD + head)
    assert not matching.is_layout_known()
    assert matching.invoker.__wrapped__() is None


WRONG: dict[str, Callable[..., Any]] = {
    "another number": lambda found: (found[0] + 1.0,) if type(found) is tuple else found,
    "another shape": lambda found: (found[0][0],) if type(found) is tuple else found,
    "no tuple": lambda found: found[0] if type(found) is tuple else found,
    "a tuple": lambda found: found if type(found) in (tuple, int) else (found,),
    "any arguments": lambda found: 0 if type(found) is int else found,
}


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_call_is_found_out(kind: str, monkeypatch: pytest.MonkeyPatch):
    right = matching._created()
    wrong = lambda *arguments: WRONG[kind](right(*arguments))  # noqa: E731
    assert not matching.is_right(wrong)
    monkeypatch.setattr(matching, "_created", lambda: wrong)
    assert matching.invoker.__wrapped__() is None


@pytest.mark.parametrize("rows", [1, 9])
def test_results_without_it_have_the_same_bits(rows: int, monkeypatch: pytest.MonkeyPatch):
    def formula(x: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, ...]:
        return np.sin(x) * n[..., None], x.sum(-1) > 0.0, n + 1

    x, n = np.random.default_rng(0).normal(size=(rows, 3)), np.arange(rows)
    fast, slow = (compiled(formula, axes=(1, 0)) for _ in range(2))
    expected = fast(x, n)
    monkeypatch.setattr(function, "invoker", lambda: None)
    before = function.Function.computed
    for _ in range(2):
        for one, other in zip(slow(x, n), expected, strict=True):
            assert (one.dtype, one.shape) == (other.dtype, other.shape)
            assert one.tobytes() == other.tobytes()
            assert one.flags.writeable
    assert function.Function.computed == before + 2


@pytest.mark.nightly
@pytest.mark.parametrize("numpy", NUMPYS)
@pytest.mark.parametrize("python", PYTHONS)
def test_every_python_and_numpy_calls_in_machine_code(python: str, numpy: str):
    """In environments of their own, on the Pythons that are found."""
    found = next(iter(pythons(python)), None)
    if found is None:
        pytest.skip(f"Python {python} is not found here")
    pin = f"numpy{numpy}" if numpy.startswith(">") else f"numpy=={numpy}"
    own = interpreter([pin, "scipy", "llvmlite"], found)
    command = [own, "-W", "error", SCRIPT]
    done = subprocess.run(command, cwd=ROOT, env={"PYTHONPATH": str(ROOT)}, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()


def pythons(version: str) -> list[str]:
    """Commands that are this Python: of the path, and of pyenv."""
    places = (
        f"python{version}",
        *map(str, Path.home().glob(f".pyenv/versions/{version}.*/bin/python")),
    )
    return [each for each in places if _runs(each)]


def _runs(command: str) -> bool:
    try:
        return subprocess.run([command, "-c", ""], capture_output=True).returncode == 0
    except FileNotFoundError:
        return False
