"""What is handed out: the wheel and the source archive hold every file of the packages, and nothing else."""

import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("agents", "estimators", "vessel_gym")
STUDIES = {f"studies/{path.name}" for path in ROOT.glob("studies/*.toml")}
FILES = ("CHANGELOG.md", "CITATION.cff", "LICENSE", "MANIFEST.in", "README.md", "pyproject.toml")
BUILD = (
    "from setuptools import build_meta; build_meta.build_sdist('dist');"
    " build_meta.build_wheel('dist')"
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both, built from a copy by the backend itself: nothing is downloaded."""
    copy = tmp_path_factory.mktemp("repository")
    for folder in (*PACKAGES, "scripts", "studies", "tests", "docs"):
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for file in FILES:
        shutil.copy(ROOT / file, copy)
    done = subprocess.run([sys.executable, "-c", BUILD], cwd=copy, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return copy / "dist"


def kept() -> set[str]:
    """Every file of the packages."""
    paths = (path for package in PACKAGES for path in (ROOT / package).rglob("*"))
    return {
        path.relative_to(ROOT).as_posix()
        for path in paths
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_wheel_holds_every_file_of_packages_and_nothing_else(dist: Path):
    with zipfile.ZipFile(next(dist.glob("*.whl"))) as wheel:
        names = set(wheel.namelist())
        entry = next(name for name in names if name.endswith(".dist-info/entry_points.txt"))
        assert "vessel-gym = vessel_gym.__main__:main" in wheel.read(entry).decode()
    assert {
        name.partition(".data/data/")[2] or name for name in names if ".dist-info/" not in name
    } == kept() | {f"share/vessel-gym/{study}" for study in STUDIES}
    assert {name for name in names if name.endswith("py.typed")} == {
        f"{package}/py.typed" for package in PACKAGES
    }


def test_source_archive_holds_packages_and_no_tests(dist: Path):
    with tarfile.open(next(dist.glob("*.tar.gz"))) as archive:
        names = {
            member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()
        }
    assert kept() | STUDIES | set(FILES) <= names
    assert {name for name in names if name.startswith("studies/")} == STUDIES
    assert {name.partition("/")[0] for name in names} <= {
        *PACKAGES, "studies", *FILES, "PKG-INFO", "setup.cfg", "vessel_gym.egg-info"
    }  # fmt: skip


def test_a_study_is_found_by_its_name_where_the_wheel_lies(dist: Path, tmp_path: Path):
    with zipfile.ZipFile(next(dist.glob("*.whl"))) as wheel:
        wheel.extractall(tmp_path)
    program = "from agents.commands.ablate import STUDIES; print(*STUDIES.values())"
    call = [sys.executable, "-c", program]
    done = subprocess.run(
        call, cwd=tmp_path, env={"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True
    )
    assert {f"studies/{Path(path).name}" for path in done.stdout.split()} == STUDIES
    assert all((tmp_path / path).is_file() for path in done.stdout.split())
