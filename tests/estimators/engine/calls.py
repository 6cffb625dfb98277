"""Calls of a compiled function with this Python and this NumPy: in machine code, and right."""

import sys

import numpy as np

from estimators.engine import compiled, matching
from estimators.engine.function import Function


def formula(x: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, ...]:
    """Results of every kind."""
    return np.sqrt(x * x) * n[..., None], x.sum(-1) > 0.0, n + 1


x, n = np.random.default_rng(0).normal(size=(9, 3)), np.arange(9)
function = compiled(formula, axes=(1, 0))
function(x, n)
before = Function.computed
references = np.array([sys.getrefcount(x), sys.getrefcount(x.dtype)])
for _ in range(10_000):
    found = function(x, n)
lost = np.array([sys.getrefcount(x), sys.getrefcount(x.dtype)]) - references
assert np.abs(lost).max() < 10  # results still hold some; a call that forgets one loses thousands
for one, other in zip(found, formula(x, n), strict=True):
    np.testing.assert_array_equal(one, other)
assert matching.invoker() is not None
assert Function.computed == before
print(sys.version.split()[0], np.__version__)
