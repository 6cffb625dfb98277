"""The package needs NumPy and SciPy; llvmlite is loaded when an equation is compiled."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import estimators

ROOT = Path(estimators.__file__).parents[1]
HEAVY = (
    "gymnasium", "torch", "stable_baselines3", "scipy.stats", "matplotlib", "vessel_gym", "agents", "scripts",
)  # fmt: skip

USE = """
import sys
import numpy as np
import estimators as e

f = e.make("kf", e.LinearModel(np.eye(1), np.eye(1), np.eye(1), np.eye(1)))
e.nis(np.zeros(1), np.eye(1))
f.update(f.predict(f.init(e.Gaussian([0.0], [[1.0]]))), [1.0])
print(*sys.modules)
"""


@pytest.mark.slow
def test_using_a_filter_loads_nothing_heavy():
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", USE], capture_output=True, text=True, env=environment, check=True
    )
    loaded = set(done.stdout.split())
    assert {"estimators", "llvmlite"} <= loaded
    assert loaded.isdisjoint(HEAVY)


def test_every_filter_and_every_belief_is_exported():
    classes = [estimators.Filter, estimators.Belief]
    for cls in classes:
        classes += [c for c in cls.__subclasses__() if c.__module__.startswith("estimators.")]
    assert {cls.__name__ for cls in classes} <= set(estimators.__all__)
    assert all(hasattr(estimators, name) for name in estimators.__all__)
