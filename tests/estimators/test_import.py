"""The package is NumPy and SciPy, and quick to import; only random numbers of keys need Numba."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import estimators

ROOT = Path(estimators.__file__).parents[1]
HEAVY = (
    "gymnasium", "torch", "numba", "stable_baselines3", "scipy.stats", "matplotlib", "vessel_gym", "agents", "scripts",
)  # fmt: skip

PROGRAM = """
import sys
import numpy as np
import estimators as e

f = e.make("kf", e.LinearModel(np.eye(1), np.eye(1), np.eye(1), np.eye(1)))
b = f.update(f.predict(f.init(e.Gaussian([0.0], [[1.0]]))), [1.0])
e.nis(b.innovation, b.innovation_cov), e.chi_square_band(10, 1)
print(*sys.modules)
"""


def _run(code: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    return result.stdout


@pytest.fixture(scope="module")
def loaded() -> set[str]:
    """Every module that ``import estimators`` and one filter step leave behind."""
    return set(_run(PROGRAM).split())


@pytest.mark.slow
@pytest.mark.parametrize("module", HEAVY)
def test_importing_and_using_a_filter_does_not_load(loaded: set[str], module: str):
    assert "estimators" in loaded
    assert module not in loaded


@pytest.mark.slow
def test_only_numpy_and_scipy_are_needed(loaded: set[str]):
    bare = set(_run("import sys, numpy, scipy.linalg, scipy.special; print(*sys.modules)").split())
    extra = {name.partition(".")[0] for name in loaded - bare} - {"estimators", "numpy", "scipy"}
    assert extra <= set(sys.stdlib_module_names)


def test_everything_that_is_exported_exists():
    for name in estimators.__all__:
        assert getattr(estimators, name) is not None


def test_every_filter_and_every_belief_is_exported():
    classes = [estimators.Filter, estimators.Belief]
    for cls in classes:
        classes += [below for below in cls.__subclasses__() if below.__module__.startswith("estimators.")]
    assert {cls.__name__ for cls in classes} <= set(estimators.__all__)


def test_a_linear_filter_is_no_extended_one():
    assert not issubclass(estimators.KalmanFilter, estimators.ExtendedKalmanFilter)
    assert not issubclass(estimators.DelayedUMVFilter, estimators.ExtendedUMVFilter)
