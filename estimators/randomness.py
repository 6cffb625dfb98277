"""Random numbers as functions of a key, a step, a use, a component and a member alone.

There is no state, so nothing has to be restarted or drawn in order: a number is the same whatever
else is drawn, in whatever batch, and any step can be drawn again by itself. Each row has a key. The
keys of its episodes, of their parts and of its filters are derived from the row's key by numbers
and names.

The words are those of Threefry-2x64 with 13 rounds (Salmon, Moraes, Dror & Shaw 2011, Parallel
random numbers: as easy as 1, 2, 3), a counter-based generator that passes BigCrush. Normal numbers
follow by the transform of Box & Muller (1958) from sums, products and square roots alone: the same
to the last bit on every processor.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b
from typing import Any

import numpy as np

from estimators.engine import (
    as_float,
    as_word,
    bits_float,
    columnwise,
    compiled,
    float_bits,
    log_scaled,
    sincos_near_zero,
)

_PARITY = 0x1BD11BDAA9FC1A22
_ROTATIONS = (16, 42, 12, 31), (16, 32, 24, 21)
_MANTISSA, _SQRT_HALF, _TWO_TO_52 = 2**52 - 1, 0x3FE6A09E667F3BCD, 0x4330000000000000
"""Bits of a double's mantissa, and all bits of sqrt(1/2) and 2^52."""


def _mix(x: np.ndarray, y: np.ndarray, bits: int) -> tuple[np.ndarray, np.ndarray]:
    x = x + y
    return x, ((y << bits) | (y >> 64 - bits)) ^ x


@np.errstate(over="ignore")  # sums of words wrap around
def threefry(
    c0: np.ndarray | np.uint64, c1: np.ndarray, k0: np.ndarray, k1: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Two random words ``(...)`` of a counter ``(c0, c1)`` under a key ``(k0, k1)``."""
    keys = k0, k1, _PARITY ^ k0 ^ k1
    x, y = c0 + k0, c1 + k1
    for i in range(3):
        for bits in _ROTATIONS[i % 2]:
            x, y = _mix(x, y, bits)
        x, y = x + keys[(i + 1) % 3], y + keys[(i + 2) % 3] + np.uint64(i + 1)
    return _mix(x, y, 16)


@compiled(axes=(1, 0, 0))
def derived(key: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Another key ``(..., 2)``: the words of a counter ``(first, second)`` under a key."""
    return np.stack(threefry(first, second, key[..., 0], key[..., 1]), -1)


def uniform(word: np.ndarray) -> np.ndarray:
    """The number from 0 to below 1 of a random word."""
    return as_float(word >> 11) * 2.0**-53


def _float(m: np.ndarray) -> np.ndarray:
    """Whole numbers below 2^52 as floats, for processors that convert words one by one."""
    return bits_float(m | _TWO_TO_52) - 2.0**52


def _log_unit(m: np.ndarray) -> np.ndarray:
    """``ln((m + 0.5) / 2^32)`` of whole numbers below 2^32."""
    bits = float_bits(_float(m) + 0.5) + (2**62 - _SQRT_HALF)
    # within sqrt(2) of 1 by its mantissa
    f = bits_float((bits & _MANTISSA) + _SQRT_HALF) - 1.0
    return log_scaled(f, _float(bits >> 52) - 1056.0)


def _sincos_of_turn(m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sine and cosine of ``(m + 0.5) / 2^32`` turns."""
    quarter = (m + 0x20000000) >> 30
    angle = (_float(m) - _float(quarter << 30) + 0.5) * 1.4629180792671596e-09  # 2 pi / 2^32
    sine, cosine = sincos_near_zero(angle)
    odd = (quarter & 1) == 1
    s, c = np.where(odd, cosine, sine), np.where(odd, sine, cosine)
    return np.where((quarter & 2) == 2, -s, s), np.where((quarter + 1 & 2) == 2, -c, c)


def normal_pair(word: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two independent standard normal numbers ``(...)`` of a random word."""
    radius = np.sqrt(-2.0 * _log_unit(word >> 32))
    sine, cosine = _sincos_of_turn(word & 0xFFFFFFFF)
    return radius * cosine, radius * sine


@compiled(axes=(1, 0, 0))
def four_normals(key: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Standard normal numbers ``(..., 4)`` of a counter of two words under a key ``(..., 2)``."""
    words = threefry(first, second, key[..., 0], key[..., 1])
    return np.stack([number for word in words for number in normal_pair(word)], -1)


@compiled(axes=(1, 0, 0))
def two_uniforms(key: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Uniform numbers ``(..., 2)`` from 0 to below 1 of a counter under a key."""
    words = threefry(first, second, key[..., 0], key[..., 1])
    return np.stack([uniform(word) for word in words], -1)


def normals(key: np.ndarray, step: np.ndarray, count: int, use: int = 0) -> list[np.ndarray]:
    """Standard normal numbers ``(...)``, ``count`` of them, of keys ``(..., 2)`` at a step."""
    second, counters = second_word(step, use), range((count + 3) // 4)
    fours = (four_normals(key, np.uint64(counter), second) for counter in counters)
    return [four[..., i] for four in fours for i in range(4)][:count]


def second_word(step: Any, use: int) -> Any:
    """The second word of the counters of a step ``(...)`` and a use."""
    return (as_word(step) << np.uint64(16)) | np.uint64(use)


@compiled(axes=(1, 0), matrices=True)
def of_members(key: Any, second: Any, *, members: int, count: int) -> Any:
    """Standard normal numbers ``(..., count, members)``, `four_normals` for each four members.

    Args:
        key: ``(..., 2)``.
        second: ``(...)`` word of the step and the use.
        members: Number of members.
        count: Number of components of each member.
    """
    fours = (members + 3) // 4
    counters = np.indices((count, fours))[::-1].reshape(2, -1).astype(float)

    def four(counter: Any, key: Any, second: Any) -> Any:
        first = as_word(counter[0]) | (as_word(counter[1]) << 32)
        return four_normals(key, first, second[0])

    drawn = columnwise(four, counters, key, second[None])
    by_component = np.concatenate([drawn.mT], -1).reshape(count, -1)
    return by_component[..., :members]


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
        steps = np.empty((*self.keys.shape[:-1], 1), np.int64)
        steps[..., 0] = self.step
        return [self.keys, steps]

    def __getitem__(self, rows: Any) -> "RandomKeys":
        steps = np.broadcast_to(self.step, self.keys.shape[:-1])
        return RandomKeys(self.keys[rows], steps[rows])

    def of(self, first: Any, second: Any = 0) -> "RandomKeys":
        """Keys derived from these by whole numbers ``(...)``, or by a name."""
        words = (word(part) if isinstance(part, str) else part for part in (first, second))
        counter = (np.asarray(each, np.uint64) for each in words)
        return RandomKeys(derived(self.keys, *counter), self.step)

    def at(self, step: np.ndarray | int) -> "RandomKeys":
        """These keys at another step."""
        return RandomKeys(self.keys, step)

    def normals(self, count: int, use: int = 0) -> np.ndarray:
        """Standard normal numbers ``(..., count)``."""
        return self._flat(four_normals, 4, count, use)

    def uniforms(self, count: int, use: int = 0) -> np.ndarray:
        """Numbers ``(..., count)`` from 0 to below 1."""
        return self._flat(two_uniforms, 2, count, use)

    def members(self, members: int, count: int, use: int = 0) -> np.ndarray:
        """Standard normals ``(..., members, count)``; further members leave those before unchanged.

        The array is a transposed view: in memory its axes are ``(..., count, members)``.
        """
        if not count or not members:
            return np.zeros((*self.keys.shape[:-1], members, count))
        second = second_word(self.step, use)
        return of_members(self.keys, second, members=members, count=count).mT

    def _flat(self, function: Any, together: int, count: int, use: int) -> np.ndarray:
        """Numbers ``(..., count)`` of a function that gives ``together`` for each counter."""
        counters = np.arange(-(-count // together), dtype=np.uint64)
        second = second_word(self.step, use)
        numbers = function(self.keys[..., None, :], counters, second[..., None])
        return numbers.reshape(*numbers.shape[:-2], len(counters) * together)[..., :count]
