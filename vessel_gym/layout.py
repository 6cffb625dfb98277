"""Numbers of the record side by side in one array, as a program makes fewer arrays in less time."""

from collections.abc import Mapping, Sequence
from itertools import accumulate
from math import prod
from typing import Any

import numpy as np


class Layout:
    """Places of arrays ``(B, ...)`` in one array ``(B, k)``.

    Args:
        shapes: Shape of a row of each array, by name.

    Attributes:
        first: Column of the first number of each array, by name.
        size: Number of columns k.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self._shapes = shapes
        *starts, self.size = accumulate(map(prod, shapes.values()), initial=0)
        self.first = dict(zip(shapes, starts, strict=True))

    def joined(self, arrays: Sequence[np.ndarray]) -> np.ndarray:
        """Arrays in one."""
        return np.concatenate([each.reshape(len(each), -1) for each in arrays], 1)

    def parts(self, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """The arrays, read-only and in C order."""
        parts = {}
        for name, shape in self._shapes.items():
            start = self.first[name]
            part = numbers[:, start : start + prod(shape)].copy()  # for the strides of one row, too
            parts[name] = part.reshape(len(numbers), *shape)
            parts[name].setflags(write=False)
        return parts

    def traced(self, numbers: Any) -> dict[str, Any]:
        """The arrays of a row as vectors, matrices and numbers, from a traced vector ``(k,)``."""
        parts = {}
        for name, shape in self._shapes.items():
            start = self.first[name]
            parts[name] = numbers[start : start + prod(shape)].reshape(shape)[()]
        return parts
