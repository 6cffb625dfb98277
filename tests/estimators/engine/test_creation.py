"""Fresh arrays that can hold tracers, while a user's function is traced and not otherwise."""

import threading
from typing import Any

import numpy as np
import pytest

from estimators.engine import compiled, creation
from estimators.engine.foreign import inspect

X = np.random.default_rng(0).normal(size=(5, 2))


def test_numpys_own_functions_are_back_after_tracing_and_untouched_elsewhere():
    own = np.zeros, np.asarray, np.array
    seen: list[Any] = []

    def fresh(x: np.ndarray) -> np.ndarray:
        y = np.zeros(x.shape)
        y[..., 0] = np.asarray(x, float)[..., 1]
        return y

    with creation.traced_creation():
        thread = threading.Thread(
            target=lambda: seen.append((type(np.zeros(3)), np.zeros(3).dtype))
        )
        thread.start()
        thread.join()
        captured = np.zeros
    assert seen == [(np.ndarray, np.dtype(float))]
    assert type(captured(3)) is np.ndarray
    assert (np.zeros, np.asarray, np.array) == own
    inspection = inspect(fresh, X)
    assert inspection.traceable, inspection.reason
    with pytest.raises(ZeroDivisionError), creation.traced_creation():
        _ = 1 / 0
    assert (np.zeros, np.asarray, np.array) == own
    outer = compiled(lambda x: inspection.inline(x) + 1.0)
    np.testing.assert_array_equal(outer(X), fresh(X) + 1.0)
