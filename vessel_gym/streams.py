"""Random numbers: one independent stream for each environment, episode and purpose.

Keying streams by purpose is what makes comparisons paired: whatever the estimator draws, and however
early an episode ends, waves and sensor noise of every later episode stay as they were.
"""

from collections.abc import Sequence
from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What a stream is for."""

    RESET = 0
    DISTURBANCE = 1
    SENSORS = 2
    FILTER = 3


def stream(seed: int, episode: int, purpose: Purpose) -> np.random.Generator:
    """The stream of one environment's episode for one purpose."""
    return np.random.default_rng(np.random.SeedSequence(entropy(seed, episode, purpose)))


def entropy(seed: int, episode: int, purpose: Purpose) -> tuple[int, ...]:
    """The 32-bit words that a stream grows from, other ones for every key.

    NumPy would split a larger number into words as well, but without saying where it ends, and takes words beyond the
    last for 0. Here the counts of words come first, and make more than four of them, NumPy's least.
    """
    if max(seed, episode) < 2**32:
        return seed, episode, purpose
    words = [_words(seed), _words(episode)]
    return *(len(number) for number in words), *words[0], *words[1], purpose


def _words(number: int) -> list[int]:
    """The 32-bit words of a number, the lowest first."""
    return [(number >> shift) & 0xFFFFFFFF for shift in range(0, max(number.bit_length(), 1), 32)]


class Draws:
    """Standard normal and uniform numbers a step for many environments, each from its own stream.

    Rows are drawn in blocks of steps: a thousand generators asked once every 64 steps cost next to
    nothing, and a row sees the same numbers whatever batch it is in. The size of a block is part of
    what a seed means: changing it changes every stream.
    """

    def __init__(self, num_envs: int, normals: int, uniforms: int = 0, block: int = 64) -> None:
        self._generators: dict[int, np.random.Generator] = {}
        self._normal = np.zeros((num_envs, block, normals))
        self._uniform = np.zeros((num_envs, block, uniforms))
        self._cursor = np.full(num_envs, block)
        self._rows = np.arange(num_envs)
        self._block = block
        self._common: int | None = block  # the cursor of all rows while they agree, which is the usual case

    def restart(self, rows: np.ndarray, generators: Sequence[np.random.Generator]) -> None:
        """Begin some rows again, each with its new stream."""
        self._spread()
        self._generators.update(zip(rows.tolist(), generators, strict=True))
        self._cursor[rows] = self._block
        if len(rows) == len(self._rows):
            self._common = self._block

    def next(self, rows: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The next step's ``(B, normals)`` and ``(B, uniforms)`` of all rows, or of those listed.

        What comes back may be a view of the block: it holds until the next call.
        """
        if rows is None and self._common is not None:
            if self._common == self._block:
                self._refill(self._rows)
                self._common = 0
            cursor = self._common
            self._common = cursor + 1
            return self._normal[:, cursor], self._uniform[:, cursor]
        self._spread()
        rows = self._rows if rows is None else rows
        self._refill(rows[self._cursor[rows] == self._block])
        cursors = self._cursor[rows]
        self._cursor[rows] = cursors + 1
        return self._normal[rows, cursors], self._uniform[rows, cursors]

    def _spread(self) -> None:
        if self._common is not None:
            self._cursor[:] = self._common
            self._common = None

    def _refill(self, rows: np.ndarray) -> None:
        for row in rows.tolist():
            generator = self._generators[row]
            generator.standard_normal(out=self._normal[row])
            generator.random(out=self._uniform[row])
        self._cursor[rows] = 0
