"""Compiled kernels: where they are kept when nothing can be written, and what is said while they are made."""

import math
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from filelock import FileLock

from vessel_gym import compiled

ROOT = Path(__file__).parents[2]
COMPILING = "vessel_gym: compiling its equations"
WAITING = "vessel_gym: waiting for another process"


KERNELS = """
from vessel_gym.compiled import gufunc, sincos

@gufunc("void(float64, float64[:])", "()->()")
def sine(angle, out):
    out[0] = sincos(angle)[0]
"""


@pytest.fixture
def sealed(tmp_path: Path) -> Path:
    """A copy beside which nothing can be cached, not even by root: files lie where folders would."""
    (tmp_path / "vessel_gym").mkdir()
    for name in ("__init__.py", "compiled.py"):
        shutil.copy(ROOT / "vessel_gym" / name, tmp_path / "vessel_gym")
    (tmp_path / "kernels.py").write_text(KERNELS)
    for folder in (tmp_path, tmp_path / "vessel_gym"):
        (folder / "__pycache__").touch()
    (tmp_path / "temporary").mkdir()
    return tmp_path


def loading_kernels(folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A process without a home that imports a kernel and calls it; stdout is its own."""
    program = "import kernels; from vessel_gym import compiled; print(compiled.__file__, kernels.sine(0.5))"
    clean = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    nowhere = {"HOME": "/dev/null/nobody", "TMPDIR": str(folder / "temporary"), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        cwd=folder, env=clean | nowhere | {"PYTHONPATH": str(folder)} | environment, capture_output=True, text=True,
    )  # fmt: skip


@pytest.mark.slow
def test_without_a_place_to_write_kernels_are_kept_in_a_private_folder_and_compiled_once(sealed: Path):
    first, second = loading_kernels(sealed), loading_kernels(sealed, NUMBA_CACHE_DIR="/dev/null/cache")
    for run in (first, second):
        assert run.returncode == 0, run.stderr
        source, sine = run.stdout.split()
        assert source == str(sealed / "vessel_gym" / "compiled.py")
        assert abs(float(sine) - math.sin(0.5)) < 1e-15
    private = next((sealed / "temporary").iterdir())
    assert private.stat().st_mode & 0o077 == 0
    assert list(private.rglob("*.nbc"))
    assert first.stderr.count(COMPILING) == first.stderr.count("\n") == 1
    assert second.stderr == ""


def test_a_folder_that_others_could_write_to_is_not_trusted_with_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    own = compiled._private_folder()
    assert own.parent == tmp_path
    assert own.stat().st_mode & 0o077 == 0
    assert compiled._private_folder() == own

    own.chmod(0o777)
    assert compiled._private_folder() != own
    own.rmdir()
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    own.symlink_to(tmp_path / "elsewhere")
    assert compiled._private_folder() not in (own, tmp_path / "elsewhere")
    own.unlink()
    own.touch()
    other = compiled._private_folder()
    assert other.is_dir()
    assert other.stat().st_mode & 0o077 == 0


def test_a_folder_of_somebody_else_is_not_trusted_with_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    stranger = os.getuid() + 1
    monkeypatch.setattr(os, "getuid", lambda: stranger)
    taken = tmp_path / f"vessel-gym-{stranger}"
    taken.mkdir(mode=0o700)
    assert compiled._private_folder() != taken


def test_who_waits_long_for_a_process_that_compiles_says_so_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
):
    monkeypatch.setattr(compiled, "_FOLDER", tmp_path)
    monkeypatch.setattr(compiled, "_PATIENCE", 0.0)
    compiled._say.cache_clear()
    released = []
    other = FileLock(tmp_path / "vessel-gym-compiling.lock")

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
