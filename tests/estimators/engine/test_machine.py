"""Machine code: equal bits on every processor, and objects on disk that nobody can spoil."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimators import Gaussian, make
from estimators.engine import compiled, machine
from tests.estimators.cases import unknown_input_system
from tests.estimators.engine.random_functions import RandomFunction

ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "folder", lambda: str(tmp_path))
    compiled(lambda x: x)(np.ones((1, 2)))  # what every call needs beside its own program
    for path in tmp_path.glob("*.o"):
        path.unlink()


def fresh() -> Callable[[Any], Any]:
    """A function that this process has not compiled yet; constants are no part of the code."""
    number = fresh.count = getattr(fresh, "count", 0) + 1
    return compiled(lambda x: np.sqrt(np.abs(x)) + sum(np.abs(x - i) for i in range(number)))


def compilations(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The modules that are compiled from now on, as by a process that has loaded nothing."""
    texts: list[str] = []
    own = machine._object
    monkeypatch.setattr(machine, "_object", lambda text: texts.append(text) or own(text))
    monkeypatch.setattr(machine, "_loaded", {})
    return texts


# --- objects on disk ------------------------------------------------------------------------------

SCRIPT = """
import sys
import numpy as np
from estimators.engine import compiled, machine
if "--forbidden" in sys.argv:
    machine._object = None
@compiled
def function(x):
    return np.stack([np.sin(x[..., 0]) * x[..., 1], np.exp(-x[..., 1] ** 2)], -1)
for rows in (1, 9):
    print(function(np.linspace(0.1, 0.9, 2 * rows).reshape(rows, 2)).tobytes().hex())
"""


def start(
    cache: Path, *arguments: str, environment: dict[str, str] | None = None
) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=ROOT, env={**os.environ, "VESSEL_GYM_CACHE": str(cache), "PYTHONPATH": str(ROOT),
             **(environment or {})},
    )  # fmt: skip


@pytest.mark.slow
def test_objects_serve_other_processes_that_compile_at_once(tmp_path: Path):
    both = [start(tmp_path) for _ in range(2)]
    one, other = (each.communicate() for each in both)
    assert one[0]
    assert one[0] == other[0]
    private = next(tmp_path.iterdir())
    said = {line for line in (one[1] + other[1]).splitlines() if line}
    assert said == {f"vessel-gym: compiling equations once, a few seconds; kept in {private}"}
    assert max(one[1].count("\n"), other[1].count("\n")) == 1  # of two programs
    slow = start(tmp_path, environment={"VESSEL_GYM_FAST_CALLS": "0"}).communicate()
    assert slow[0] == one[0]
    third = start(tmp_path, "--forbidden").communicate()
    assert third == (one[0], "")  # nothing was compiled, and nothing said
    assert not list(tmp_path.glob("**/*.new"))


@pytest.mark.parametrize("damage", ["none", "half", "bit", "version"])
def test_a_damaged_or_foreign_object_is_compiled_anew(
    damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    function, x = fresh(), np.ones((1, 3))
    expected = function(x)
    (path,) = tmp_path.glob("*.o")
    whole = path.read_bytes()
    half = len(whole) // 2
    flipped = whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :]
    path.write_bytes({"half": whole[:half], "bit": flipped}.get(damage, whole))
    if damage == "version":
        monkeypatch.setattr(machine, "_emitter", lambda: "of another version")
    os.utime(path, (1.0, 1.0))
    texts = compilations(monkeypatch)
    np.testing.assert_array_equal(compiled(function.function)(x), expected)
    assert len(texts) == (damage != "none")
    assert path.read_bytes() == whole
    assert (path.stat().st_mtime > 1.0) == (damage != "version")  # when it was last used


def test_a_folder_that_others_can_write_to_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    found = machine._own(tmp_path)
    assert found is not None
    assert found.stat().st_mode & 0o777 == 0o700
    for mode in (0o720, 0o702):
        found.chmod(mode)
        assert machine._own(tmp_path) is None
    found.rmdir()
    (tmp_path / "elsewhere").mkdir()
    found.symlink_to(tmp_path / "elsewhere")
    assert machine._own(tmp_path) is None
    assert machine._own(tmp_path / "elsewhere" / "deep") is not None
    (tmp_path / "file").touch()
    assert machine._own(tmp_path / "file") is None
    stranger = os.getuid() + 1
    monkeypatch.setattr(os, "getuid", lambda: stranger)
    (tmp_path / f"vessel-gym-{stranger}").mkdir(mode=0o700)
    assert machine._own(tmp_path) is None


def test_a_read_only_cache_folder_costs_only_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(machine, "folder", lambda: str(tmp_path / "missing"))
    assert np.isfinite(fresh()(np.ones((1, 3)))).all()
    assert not (tmp_path / "missing").exists()


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], Path]]:
    """The choice of a folder, made anew, where only what a test says can be written to."""
    monkeypatch.undo()
    monkeypatch.setattr(machine, "__file__", "/dev/null/engine/machine.py")
    for name in ("HOME", "VESSEL_GYM_CACHE"):
        monkeypatch.setenv(name, "/dev/null/nobody")
    machine.folder.cache_clear()
    yield lambda: Path(machine.folder())
    machine.folder.cache_clear()


@pytest.mark.parametrize("place", ["VESSEL_GYM_CACHE", "HOME"])
def test_objects_are_kept_in_the_first_place_that_can_be_written(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Callable[[], Path]
):
    monkeypatch.setenv(place, str(tmp_path))
    assert folder().parent == (tmp_path / ".cache" if place == "HOME" else tmp_path)
    assert folder().stat().st_mode & 0o077 == 0


def test_without_a_place_that_can_be_written_nothing_is_kept(folder: Callable[[], Path]):
    assert not any(folder().glob("*"))
    np.testing.assert_array_equal(fresh()(np.ones((1, 3))) >= 0.0, True)
    assert not folder().is_dir()


def test_objects_that_nobody_has_used_for_long_are_removed(tmp_path: Path):
    for name in ("a.o", "b.o"):
        (tmp_path / name).touch()
    os.utime(tmp_path / "a.o", (1.0, 1.0))
    machine._forget(tmp_path)
    assert [each.name for each in tmp_path.iterdir()] == ["b.o"]


# --- the same bits --------------------------------------------------------------------------------


@pytest.mark.skipif("x86_64" not in machine._processor()[1], reason="of processors of this family")
@pytest.mark.parametrize("optimised", [False, True])
@pytest.mark.parametrize("name", ["x86-64", "x86-64-v3", machine._processor()[2]])
def test_processors_and_compiler_effort_do_not_change_the_bits(
    name: str, optimised: bool, monkeypatch: pytest.MonkeyPatch
):
    if name == "x86-64-v3" and "+avx2" not in machine._processor()[3]:
        pytest.skip("this machine is an older one")
    x = np.random.default_rng(0).normal(size=(19, 4)) * 3.0
    x[:3, :2] = [[np.inf, 0.0], [-0.0, np.nan], [5e-324, 1e308]]
    functions = [RandomFunction(np.random.default_rng(seed), False) for seed in range(8)]

    def results() -> list[bytes]:
        filter = make("ulise", unknown_input_system(0, True, p=4, q=2, rank=1).model)
        belief = filter.init(Gaussian(x[4:], np.eye(4)))  # programs of matrices, too
        belief = filter.step(belief, x[4:], x[4:, :2])
        found = [compiled(lambda x, f=each: f(x))(x[:, : each.n]) for each in functions]
        return [each.tobytes() for each in (*found, belief.mean, belief.cov)]

    expected = results()
    processor = machine._processor()
    monkeypatch.setattr(machine, "OPTIMISED", optimised)
    if name != processor[2]:
        monkeypatch.setattr(machine, "_processor", lambda: (*processor[:2], name, ""))
    texts = compilations(monkeypatch)
    assert results() == expected
    assert texts


def test_nothing_is_contracted_or_reordered():
    """A product and a sum are rounded twice, whatever instruction would do both at once."""
    x = np.random.default_rng(0).normal(size=(1000, 3))
    found = compiled(lambda x: x[..., 0] * x[..., 1] + x[..., 2])(x)
    np.testing.assert_array_equal(found, x[:, 0] * x[:, 1] + x[:, 2])
    assert compiled(lambda x: x[..., 0] + x[..., 1] + x[..., 2])([[1e16, 1.0, -1e16]]) == 0.0


# --- calls ----------------------------------------------------------------------------------------

UNLIKE: list[Any] = [
    np.ones(()), np.ones(3), np.ones(2, np.float32), np.ones(2, int), np.ones((2, 1)), np.ones((0, 2)),
    np.arange(6.0).reshape(2, 3).T, np.arange(9.0).reshape(3, 3)[:, ::2], np.ones(2, bool), 3, [1.0, 2.0],
]  # fmt: skip


def test_arguments_unlike_the_last_ones_are_computed_as_they_are():
    sums = compiled(lambda x, y: (2.0 * x + 0.0, x + y), axes=(0, 0))
    for last in UNLIKE:
        for each in UNLIKE:
            sums(last, 1.0)
            double, total = sums(each, np.ones(()))
            np.testing.assert_array_equal(double, 2.0 * np.asarray(each))
            np.testing.assert_array_equal(total, 1.0 + np.asarray(each))
    with pytest.raises(ValueError, match="zip"):
        sums(1.0)


def test_arrays_for_results_belong_to_the_caller():
    """Types, shapes and arrays are counted as Python counts them: none is left behind, none is freed too early."""
    both, x, dtype = compiled(lambda x: (x, 2.0 * x)), np.zeros((3, 2)), np.dtype(float)
    both(x)
    before = sys.getrefcount(dtype)
    for _ in range(1000):
        fresh = both(x)
        assert [sys.getrefcount(each) for each in fresh] == [3, 3]
        fresh[0][:] = 1.0
        assert not x.any()
    del fresh
    assert sys.getrefcount(dtype) == before
