"""Machine code: the same bits for every processor and width, and objects on disk that no other process can spoil."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimators.engine import compiled, machine
from estimators.engine.compiled import trace
from estimators.engine.function import Argument
from estimators.engine.matching import described, matcher
from tests.estimators.engine.random_functions import RandomFunction

ROOT = Path(__file__).parents[3]
matcher()  # an object of its own, which is no part of what is counted below
SCRIPT = """
import sys
import numpy as np
from estimators.engine import compiled, function, machine
if "--forbidden" in sys.argv:
    machine._object = function.Function.text = None
@compiled
def function(x):
    return np.stack([np.sin(x[..., 0]) * x[..., 1], np.exp(-x[..., 1] ** 2)], -1)
for rows in (1, 9):
    print(function(np.linspace(0.1, 0.9, 2 * rows).reshape(rows, 2)).tobytes().hex())
"""


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "folder", lambda: tmp_path)


def fresh() -> Callable[[Any], Any]:
    """A function that this process has not compiled yet; constants are no part of the code."""
    number = fresh.count = getattr(fresh, "count", 0) + 1  # type: ignore[attr-defined]
    return compiled(lambda x: np.sqrt(np.abs(x)) + sum(np.abs(x - i) for i in range(number)))  # type: ignore


def compilations(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The modules that are compiled from now on."""
    texts: list[str] = []
    own = machine._object
    monkeypatch.setattr(machine, "_object", lambda text: texts.append(text) or own(text))
    return texts


def forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a process that has not loaded anything."""
    monkeypatch.setattr(machine, "_loaded", {})


# --- objects on disk ------------------------------------------------------------------------------


def start(cache: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=ROOT, env=dict(os.environ, VESSEL_GYM_CACHE=str(cache), PYTHONPATH=str(ROOT)),
    )  # fmt: skip


@pytest.mark.slow
def test_objects_serve_other_processes_and_two_that_compile_at_once_agree(tmp_path: Path):
    both = [start(tmp_path) for _ in range(2)]
    one, other = (each.communicate() for each in both)
    assert one[0]
    assert one[0] == other[0]
    private = next(tmp_path.iterdir())
    said = {line for line in (one[1] + other[1]).splitlines() if line}
    assert said == {f"vessel-gym: compiling equations once, a few seconds; kept in {private}"}
    assert max(one[1].count("\n"), other[1].count("\n")) == 1  # of two programs
    third = start(tmp_path, "--forbidden").communicate()
    assert third == (one[0], "")  # nothing was emitted or compiled, and nothing said
    assert not list(tmp_path.glob("**/*.new"))


@pytest.mark.parametrize("damage", [b"", b"garbage" * 99, None, "bit"])
def test_a_damaged_object_is_compiled_anew(
    damage: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    function, x = fresh(), np.ones((1, 3))
    expected = function(x)
    (path,) = tmp_path.glob("*.o")
    whole = path.read_bytes()
    if damage == "bit":
        damage = bytearray(whole)
        damage[len(whole) // 2] ^= 1
    path.write_bytes(whole[: len(whole) // 2] if damage is None else bytes(damage))
    forget(monkeypatch)
    texts = compilations(monkeypatch)
    np.testing.assert_array_equal(compiled(function.function)(x), expected)
    assert len(texts) == 1
    assert path.read_bytes() == whole
    forget(monkeypatch)
    compiled(function.function)(x)
    assert len(texts) == 1


def test_an_object_of_another_version_of_the_engine_is_not_used(monkeypatch: pytest.MonkeyPatch):
    function, x = fresh(), np.ones((1, 3))
    function(x)
    texts = compilations(monkeypatch)
    for sources, count in ((machine._emitter(), 0), ("of another version", 1)):
        forget(monkeypatch)
        monkeypatch.setattr(machine, "_emitter", lambda sources=sources: sources)
        compiled(function.function)(x)
        assert len(texts) == count


def test_a_folder_that_cannot_be_written_costs_time_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(machine, "folder", lambda: tmp_path / "missing")
    np.testing.assert_array_equal(np.isfinite(fresh()(np.ones((1, 3)))), True)
    assert not (tmp_path / "missing").exists()


def test_a_folder_that_others_can_write_to_is_not_used(tmp_path: Path):
    found = machine._own(tmp_path)
    assert found is not None
    assert found.stat().st_mode & 0o777 == 0o700
    found.chmod(0o777)
    assert machine._own(tmp_path) is None
    found.rmdir()
    (tmp_path / "elsewhere").mkdir()
    found.symlink_to(tmp_path / "elsewhere")
    assert machine._own(tmp_path) is None
    assert machine._own(tmp_path / "elsewhere" / "deep") is not None
    (tmp_path / "file").touch()
    assert machine._own(tmp_path / "file") is None


def test_a_folder_of_somebody_else_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    stranger = os.getuid() + 1
    monkeypatch.setattr(os, "getuid", lambda: stranger)
    (tmp_path / f"vessel-gym-{stranger}").mkdir(mode=0o700)
    assert machine._own(tmp_path) is None


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], Path]]:
    """The choice of a folder, made anew, where nothing can be written beside the code, nor in a home."""
    monkeypatch.undo()
    monkeypatch.setattr(machine, "__file__", "/dev/null/engine/machine.py")
    monkeypatch.setenv("HOME", "/dev/null/nobody")
    for name in ("VESSEL_GYM_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    machine.folder.cache_clear()
    yield machine.folder
    machine.folder.cache_clear()


def test_without_a_place_to_write_objects_are_kept_among_temporary_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Callable[[], Path]
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("VESSEL_GYM_CACHE", "/dev/null/cache")
    assert folder().parent == tmp_path
    assert folder().stat().st_mode & 0o077 == 0


def test_without_a_folder_of_its_own_a_process_makes_one_for_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Callable[[], Path]
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(machine, "_own", lambda place: None)
    assert folder().parent == tmp_path
    assert folder().stat().st_mode & 0o077 == 0


def test_a_cache_of_the_user_is_enough_where_no_temporary_file_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Callable[[], Path]
):
    def nowhere() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(tempfile, "gettempdir", nowhere)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert folder().parent == tmp_path


def test_the_folder_is_the_one_that_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Callable[[], Path]
):
    monkeypatch.setenv("VESSEL_GYM_CACHE", str(tmp_path / "here"))
    assert folder().parent == tmp_path / "here"


def test_objects_that_nobody_has_used_for_long_are_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    old, new = tmp_path / "a.o", tmp_path / "b.o"
    for path in (old, new):
        path.touch()
    os.utime(old, (1.0, 1.0))
    machine._forget(tmp_path)
    assert [each.name for each in tmp_path.iterdir()] == ["b.o"]
    function, x = fresh(), np.ones((1, 2))
    function(x)
    (path,) = set(tmp_path.glob("*.o")) - {new}
    os.utime(path, (1.0, 1.0))
    forget(monkeypatch)
    compiled(function.function)(x)
    assert path.stat().st_mtime > 1e9  # using one counts


# --- memory ---------------------------------------------------------------------------------------


MEMORY = """
import gc, os
import numpy as np
from estimators.engine import compiled
from estimators.engine.program import Instruction
def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
def equation(k):
    return compiled(lambda x: sum(np.sin(x + i) for i in range(20 + k)))
functions = [equation(k) for k in range(40)]
for k, function in enumerate(functions):
    function(np.zeros((9, 1)))
    if k == 9:
        before = resident()
gc.collect()
assert not any(type(each) is Instruction for each in gc.get_objects())
print((resident() - before) / 30)
assert functions[9](np.zeros((1, 1))) == functions[9](np.zeros((9, 1)))[0]  # one row has a program of its own
"""


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="where Linux tells a process' memory"
)
def test_a_process_keeps_little_of_what_compiling_needed(tmp_path: Path):
    environment = dict(os.environ, VESSEL_GYM_CACHE=str(tmp_path), VESSEL_GYM_OPTIMISE="0")
    done = subprocess.run(
        [sys.executable, "-c", MEMORY],
        cwd=ROOT,
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    )
    assert (
        float(done.stdout) < 300_000.0
    )  # bytes a program; 860 thousand where the machine that emits is kept


# --- the same bits --------------------------------------------------------------------------------


def results(function: Callable[[Any], Any], n: int, x: np.ndarray) -> list[bytes]:
    """The bits of rows, alone and in batches."""
    traced, _ = trace(function, [Argument((n,))])
    whole = traced.compute([x])[0]
    found = [whole.tobytes()]
    for first, last in ((0, 1), (3, 4), (1, 6), (2, len(x)), (0, len(x) - 1)):
        part = traced.compute([x[first:last]])[0]
        assert part.tobytes() == np.ascontiguousarray(whole[first:last]).tobytes()
    return found


def elementary(x: np.ndarray) -> np.ndarray:
    a, b = x[..., 0], x[..., 1]
    return np.stack([
        np.sin(a), np.cos(a), np.tan(a), np.exp(b), np.expm1(b), np.log(a), np.log1p(b), np.arctan(a), np.arctan2(a, b),
        np.arcsin(np.tanh(a)), np.arccos(np.sin(b)), np.hypot(a, b), np.tanh(b), np.sqrt(a), np.floor(a), np.rint(b),
        np.fmod(a, b), a % b, a // b, np.ceil(a), np.trunc(b), a * b + b, a * a - b * b, a / b, np.copysign(a, b),
        np.maximum(a, b), np.minimum(a, b), 1.0 * (a > b), 1.0 * a.astype(np.int64), np.square(b),
        np.interp(a, [0.0, 1.0], [2.0, 5.0]),
    ], -1)  # fmt: skip


COLLECTED = """
import gc
from estimators.engine import machine, trace
from estimators.engine.function import Argument
function, _ = trace(lambda x: x + 1.0, [Argument((2,))])
cycle = [machine._function(b"", lambda: function.text(1))]
cycle.append(cycle)
del cycle
gc.collect()
"""


@pytest.mark.slow
def test_a_function_in_a_cycle_of_garbage_is_deleted_before_what_it_reads(tmp_path: Path):
    # glibc fills what is freed with ones, so that a read of it ends the process
    allocator = {
        "PYTHONMALLOC": "malloc",
        "MALLOC_PERTURB_": "255",
        "VESSEL_GYM_CACHE": str(tmp_path),
    }
    subprocess.run(
        [sys.executable, "-c", COLLECTED], cwd=ROOT, env=dict(os.environ, **allocator), check=True
    )


@pytest.mark.skipif("x86_64" not in machine._processor()[1], reason="of processors of this family")
@pytest.mark.parametrize("optimise", ["0", "1"])
@pytest.mark.parametrize("name", ["x86-64", "x86-64-v2", "x86-64-v3", machine._processor()[2]])
def test_a_processor_with_less_and_a_compiler_with_more_effort_give_the_same_bits(
    name: str, optimise: str, monkeypatch: pytest.MonkeyPatch
):
    if name == "x86-64-v3" and "+avx2" not in machine._processor()[3]:
        pytest.skip("this machine is an older one")
    rng = np.random.default_rng(0)
    x = rng.normal(size=(19, 4)) * 3.0
    x[:3, :2] = [[np.inf, 0.0], [-0.0, np.nan], [5e-324, 1e308]]
    functions: list[tuple[Any, int]] = [(elementary, 2)]
    for seed in range(2):
        random = RandomFunction(np.random.default_rng(seed), False)
        functions.append((random, random.n))
    expected = [results(f, n, np.ascontiguousarray(x[:, :n])) for f, n in functions]
    processor = machine._processor()
    monkeypatch.setenv("VESSEL_GYM_OPTIMISE", optimise)
    if name != processor[2]:
        monkeypatch.setattr(machine, "_processor", lambda: (*processor[:2], name, ""))
    forget(monkeypatch)
    texts = compilations(monkeypatch)
    assert [results(f, n, np.ascontiguousarray(x[:, :n])) for f, n in functions] == expected
    assert len(texts) >= len(functions)


def test_nothing_is_contracted_or_reordered():
    """A product and a sum are rounded twice, whatever instruction would do both at once."""
    x = np.random.default_rng(0).normal(size=(1000, 3))
    found = compiled(lambda x: x[..., 0] * x[..., 1] + x[..., 2])(x)
    np.testing.assert_array_equal(found, x[:, 0] * x[:, 1] + x[:, 2])
    small = np.array([[1e16, 1.0, -1e16]])
    assert compiled(lambda x: x[..., 0] + x[..., 1] + x[..., 2])(small) == 0.0


# --- are arrays alike? ----------------------------------------------------------------------------


class Own(np.ndarray):
    """A kind of array of somebody's own."""


OBJECTS = [
    np.zeros(()), np.zeros(0), np.zeros(3), np.zeros(3, np.float32), np.zeros(3, int), np.zeros((3, 1)),
    np.zeros((1, 3)), np.zeros((3, 4)), np.zeros((3, 4)).T, np.zeros((3, 4))[:, ::2], np.zeros((4, 3)),
    np.zeros((4, 3)).T, np.zeros((2, 3, 4)), np.zeros(3).view(Own), np.zeros(3, bool), np.float64(0.0), 0.0, 3, None,
    "3", [0.0, 0.0, 0.0],
]  # fmt: skip


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_arrays_are_alike_if_their_types_shapes_and_order_are(count: int):
    rng = np.random.default_rng(count)
    ordered = [each for each in OBJECTS if type(each) is np.ndarray and each.flags.c_contiguous]
    for _ in range(300):
        before = [ordered[i] for i in rng.integers(len(ordered), size=count)]
        now: list[Any] = list(before)
        if rng.random() < 0.7:
            now[rng.integers(max(count, 1)) : count] = [
                OBJECTS[i] for i in rng.integers(len(OBJECTS), size=rng.integers(3))
            ]
        alike = len(now) == count and all(
            type(a) is np.ndarray
            and a.shape == b.shape
            and a.dtype == b.dtype
            and a.flags.c_contiguous
            for a, b in zip(now, before, strict=True)
        )
        fresh = matcher()(described(before, ordered), *now)
        assert (fresh is not None) is alike
        for one, other in zip(fresh or (), ordered, strict=alike):
            assert (type(one), one.shape, one.dtype) == (np.ndarray, other.shape, other.dtype)
            assert all((one.flags.c_contiguous, one.flags.writeable, one.flags.owndata))


def test_arrays_for_results_are_given_back():
    """Types, shapes and arrays are counted as Python counts them: none is left behind, none is freed too early."""
    x, dtype = np.zeros((3, 2)), np.dtype(float)
    table, before = described([x], [x, x]), sys.getrefcount(dtype)
    for _ in range(1000):
        fresh = matcher()(table, x)
        assert [sys.getrefcount(each) for each in fresh] == [
            3,
            3,
        ]  # the tuple, the comprehension and the question
        fresh[0][:] = 1.0
    del fresh
    assert sys.getrefcount(dtype) == before
    assert [matcher()(table, *others) for others in ((), (x.T,), (x, x))] == [None] * 3
