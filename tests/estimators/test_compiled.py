"""Compiled kernels: when they are made and anew, where they are kept, and what is said meanwhile."""

import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from numba.core import config

from estimators import compiled
from vessel_gym.vehicles.corvette_equations import corvette_rates
from vessel_gym.vehicles.files import load

ROOT = Path(__file__).parents[2]
COMPILING = "vessel-gym: compiling once"
WAITING = "vessel-gym: waiting for another process"


KERNELS = """
from estimators.compiled import gufunc
from estimators.functions import doubled

@gufunc("void(float64, float64[:])", "()->()")
def kernel(number, out):
    out[0] = doubled(number)
"""
FUNCTIONS = """
from estimators.compiled import inlined

@inlined
def doubled(number):
    return 2.0 * number
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy with a kernel of one file and a function of another."""
    own = tmp_path / "estimators"
    own.mkdir()
    (own / "__init__.py").touch()
    shutil.copy(ROOT / "estimators" / "compiled.py", own)
    (own / "kernels.py").write_text(KERNELS)
    (own / "functions.py").write_text(FUNCTIONS)
    (tmp_path / "temporary").mkdir()
    return tmp_path


FIRST = "from estimators import compiled, kernels; print(compiled.__file__, kernels.kernel(0.5))"


def calling(folder: Path, program: str = FIRST, **environment: str) -> subprocess.Popen[str]:
    """A process without a home that calls the kernel; stdout is its own."""
    clean = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    nowhere = {"HOME": "/dev/null/nobody", "TMPDIR": str(folder / "temporary"), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=folder, env=clean | nowhere | {"PYTHONPATH": str(folder)} | environment,
    )  # fmt: skip


def called(folder: Path, *processes: subprocess.Popen[str]) -> tuple[set[float], str]:
    """What processes found, and all that they said to whoever waits."""
    found, said = set(), ""
    for process in processes:
        out, err = process.communicate()
        assert process.returncode == 0, err
        source, number = out.split()
        assert source == str(folder / "estimators" / "compiled.py")
        found.add(float(number))
        said += err
    return found, said


@pytest.mark.slow
def test_without_a_place_to_write_kernels_are_kept_in_a_private_folder_and_compiled_once(package: Path):
    (package / "estimators" / "__pycache__").touch()  # a file where a folder would lie keeps out even root
    first = called(package, calling(package))
    second = called(package, calling(package, NUMBA_CACHE_DIR="/dev/null/cache"))
    assert first[0] == second[0] == {1.0}
    private = next((package / "temporary").iterdir())
    assert private.stat().st_mode & 0o077 == 0
    assert list(private.rglob("*.nbc"))
    assert first[1].count(COMPILING) == first[1].count("\n") == 1
    assert first[1].endswith(f"; kept in {private}\n")
    assert second[1] == ""


@pytest.mark.slow
def test_processes_that_start_at_once_compile_once_and_a_change_in_another_file_is_seen(package: Path):
    found, said = called(package, *(calling(package) for _ in range(3)))
    assert found == {1.0}
    assert said.count(COMPILING) == 1
    assert not list((package / "temporary").iterdir())  # all lies beside the code

    other = package / "estimators" / "functions.py"
    for factor, result in (("3.0", 1.5), ("2.0", 1.0)):
        other.write_text(FUNCTIONS.replace("2.0", factor))
        found, said = called(package, calling(package))
        assert found == {result}
        assert said.count(COMPILING) == (result != 1.0)  # what was compiled before the change is still there


def test_a_command_says_once_that_it_compiles_whichever_of_its_processes_does_and_then_how_far_it_is(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    (package / "estimators" / "more.py").write_text(KERNELS)
    program = "from estimators import compiled, more; print(compiled.__file__, more.kernel(0.5))"
    said = [called(package, calling(package, what)) for what in (FIRST, program)]
    assert [text.count(COMPILING) for _, text in said] == [1, 0]

    now = [1e9]
    monkeypatch.setattr(compiled, "time", lambda: now[0])
    compiled._say.cache_clear()
    for later in (0.0, 4.0, 7.0, 1.0, 700.0):
        now[0] += later
        compiled._tell(tmp_path / "told")
    lines = [line.split(":")[1].split(";")[0] for line in capsys.readouterr().err.splitlines()]
    assert lines == [" compiling once, about half a minute for each environment", " compiling, 2 kernels in 11 s"]
    compiled._say.cache_clear()


def test_kernels_are_kept_where_numba_s_are_if_somebody_chose_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    assert compiled._folder.__wrapped__().parent == tmp_path


def test_a_function_is_compiled_when_it_is_first_called_and_other_people_s_are_cached_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(compiled, "_folder", lambda: tmp_path)
    before, during = config.CACHE_DIR, []

    def compiler(function: Callable[..., float]) -> Callable[..., float]:
        during.append(config.CACHE_DIR)
        return function

    @compiled.lazy(compiler)
    def halved(number: float, by: float = 2.0) -> float:
        """Less."""
        return number / by

    assert (during, halved.__doc__) == ([], "Less.")
    assert [halved(3.0), halved(3.0, by=4.0), halved(3.0)] == [1.5, 0.75, 1.5]
    assert len(during) == 1
    assert Path(during[0]).parent == tmp_path
    assert before == config.CACHE_DIR


def test_kernels_can_be_pickled_before_and_after_they_are_called():
    for _ in range(2):
        assert pickle.loads(pickle.dumps(corvette_rates)) is corvette_rates
        corvette_rates(np.zeros(8), np.zeros(1), np.zeros(7), load("corvette").vector())


def test_of_old_sources_kernels_only_the_last_are_kept(tmp_path: Path):
    for age in range(6):
        (tmp_path / f"old{age}" / "vehicles").mkdir(parents=True)
        os.utime(tmp_path / f"old{age}", (1e9 - age, 1e9 - age))
    (tmp_path / "lock").touch()
    current = compiled._current.__wrapped__(tmp_path)
    assert {each.name for each in tmp_path.iterdir()} == {"lock", "old0", "old1", "old2", current.name}
    assert compiled._current.__wrapped__(tmp_path) == current


def test_a_folder_that_others_could_write_to_is_not_trusted_with_code(tmp_path: Path):
    own = compiled._own(tmp_path)
    assert own is not None
    assert own.parent == tmp_path
    assert own.stat().st_mode & 0o077 == 0
    assert compiled._own(tmp_path) == own

    own.chmod(0o777)
    assert compiled._own(tmp_path) is None
    own.rmdir()
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    own.symlink_to(tmp_path / "elsewhere")
    assert compiled._own(tmp_path) is None
    own.unlink()
    own.touch()
    assert compiled._own(tmp_path) is None


def test_a_folder_of_somebody_else_is_not_trusted_with_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    stranger = os.getuid() + 1
    monkeypatch.setattr(os, "getuid", lambda: stranger)
    (tmp_path / f"vessel-gym-{stranger}").mkdir(mode=0o700)
    assert compiled._own(tmp_path) is None


def test_without_a_folder_of_its_own_a_process_makes_one_for_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(compiled, "_own", lambda place: None)
    folder = compiled._folder.__wrapped__()
    assert folder.parent == tmp_path
    assert folder.stat().st_mode & 0o077 == 0


def test_who_waits_long_for_a_process_that_compiles_says_so_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
):
    monkeypatch.setattr(compiled, "_folder", lambda: tmp_path)
    monkeypatch.setattr(compiled, "_PATIENCE", 0.0)
    compiled._say.cache_clear()
    released = []
    other = FileLock(tmp_path / "lock")

    def acquire(lock: FileLock, timeout: float | None = None) -> None:
        if timeout is None:  # whoever waits without an end is let in at once
            other.release(force=True)
            released.append(lock)
        return original(lock, timeout)

    original = FileLock.acquire
    other.acquire()
    monkeypatch.setattr(type(other), "acquire", acquire)
    with compiled._alone():
        pass
    assert len(released) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count(WAITING) == printed.err.count("\n") == 1
    compiled._say.cache_clear()


def test_a_place_that_can_be_written_is_enough_where_no_temporary_file_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def nowhere() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(tempfile, "gettempdir", nowhere)
    monkeypatch.setattr(compiled, "__file__", "/dev/null/compiled.py")
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiled._folder.__wrapped__().parent == tmp_path
