"""Random numbers as functions of a key, a step, a use, a component and a member alone.

There is no state, so nothing has to be restarted or drawn in order: a number is the same whatever
else is drawn, in whatever batch, and any step can be drawn again by itself. Each row has a key. The
keys of its episodes, of their parts and of its filters are derived from the row's key by numbers
and names.

The generator is in `estimators.threefry`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b
from typing import Any

import numpy as np

from estimators import threefry

# --- keys -----------------------------------------------------------------------------------------


@cache
def word(name: str) -> int:
    """A word of 64 bits for a name, the same in every process."""
    return int.from_bytes(blake2b(name.encode(), digest_size=8).digest(), "little")


def key(seed: int) -> np.ndarray:
    """The key ``(2,)`` of a seed, a whole number of any size that is not negative."""
    if seed < 2**64:
        return np.array([seed, 0], np.uint64)
    digest = blake2b(seed.to_bytes((seed.bit_length() + 7) // 8, "little"), digest_size=16).digest()
    return np.frombuffer(digest, np.uint64).copy()


@dataclass(frozen=True, slots=True, eq=False)
class RandomKeys:
    """Random numbers of a batch of systems at one step, from a key for each system.

    Under one key, numbers of different kinds or purposes need different values of ``use``, from 0
    to below 2^16. With the same ``use`` they come from the same random words and are not
    independent.

    Attributes:
        keys: ``(..., 2)`` words, a key a row.
        step: ``(...)`` number of the step.
    """

    keys: np.ndarray
    step: np.ndarray | int = 0

    @classmethod
    def seeded(cls, seeds: Sequence[int]) -> "RandomKeys":
        """Keys from a seed for each row; a seed is a whole number of any size, not negative."""
        return cls(np.array([key(seed) for seed in seeds], np.uint64).reshape(-1, 2))

    @property
    def words(self) -> list[np.ndarray]:
        """Keys ``(..., 2)`` and steps ``(..., 1)``, as compiled filters take them."""
        batch = self.keys.shape[:-1]
        if isinstance(self.step, np.ndarray) and self.step.shape == batch:
            return [self.keys, self.step[..., None]]
        return [self.keys, np.full((*batch, 1), self.step, np.int64)]

    def __getitem__(self, rows: Any) -> "RandomKeys":
        steps = np.broadcast_to(self.step, self.keys.shape[:-1])
        return RandomKeys(self.keys[rows], steps[rows])

    def of(self, first: Any, second: Any = 0) -> "RandomKeys":
        """Keys derived from these by whole numbers ``(...)``, or by a name."""
        words = (word(part) if isinstance(part, str) else part for part in (first, second))
        first, second = (np.asarray(each).astype(np.uint64, copy=False) for each in words)
        return RandomKeys(threefry.derived(self.keys, first, second), self.step)

    def at(self, step: np.ndarray | int) -> "RandomKeys":
        """These keys at another step."""
        return RandomKeys(self.keys, step)

    def normals(self, count: int, use: int = 0) -> np.ndarray:
        """Standard normal numbers ``(..., count)``."""
        return self._flat(threefry.four_normals, 4, count, use)

    def uniforms(self, count: int, use: int = 0) -> np.ndarray:
        """Numbers ``(..., count)`` from 0 to below 1."""
        return self._flat(threefry.two_uniforms, 2, count, use)

    def members(self, members: int, count: int, use: int = 0) -> np.ndarray:
        """Standard normals ``(..., members, count)``; further members leave those before unchanged.

        The array is a transposed view: in memory its axes are ``(..., count, members)``.
        """
        if not count or not members:
            return np.zeros((*self.keys.shape[:-1], members, count))
        second = threefry.second_word(self.step, use)
        return threefry.of_members(self.keys, second, members=members, count=count).mT

    def _flat(self, function: Any, together: int, count: int, use: int) -> np.ndarray:
        """Numbers ``(..., count)`` of a function that gives ``together`` for each counter."""
        counters = np.arange(-(-count // together), dtype=np.uint64)
        second = threefry.second_word(self.step, use)
        numbers = function(self.keys[..., None, :], counters, second[..., None])
        return numbers.reshape(*numbers.shape[:-2], len(counters) * together)[..., :count]
