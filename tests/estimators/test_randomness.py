"""Random numbers as functions of their keys: published words and the laws of their distribution.

Statistical tests have fixed seeds and a false-alarm rate of 1e-6 each.
"""

import functools
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, kstest, norm

from estimators import RandomKeys
from estimators.randomness import derived, key, word

ONES = 2**64 - 1
PI = (0x243F6A8885A308D3, 0x13198A2E03707344, 0xA4093822299F31D0, 0x082EFA98EC4E6C89)
SIGMA = norm.isf(0.5e-6)  # standard errors that pass by chance once in a million


@pytest.mark.parametrize(
    ("counter", "own", "words"),
    [
        ((0, 0), (0, 0), (0xF167B032C3B480BD, 0xE91F9FEE4B7A6FB5)),
        ((ONES, ONES), (ONES, ONES), (0xCCDEC5C917A874B1, 0x4DF53ABCA26CEB01)),
        (PI[:2], PI[2:], (0xC3AAC71561042993, 0x3FE7AE8801AFF316)),
    ],
)
def test_words_are_the_published_ones(
    counter: tuple[int, int], own: tuple[int, int], words: tuple[int, int]
):
    """Known answers of Random123 (Salmon et al.) for Threefry-2x64 with 13 rounds."""
    found = derived(np.array(own, np.uint64), *(np.uint64(c) for c in counter))
    assert tuple(found.tolist()) == words


# --- what a number depends on ---------------------------------------------------------------------


def test_a_number_is_the_same_in_every_batch_and_count():
    rows = RandomKeys.seeded(range(5)).of("sensor").at(np.array([3, 1, 4, 1, 5]))
    whole, members = rows.normals(23), rows.members(101, 7)
    for count in range(8):
        np.testing.assert_array_equal(rows.normals(count), whole[:, :count])
        np.testing.assert_array_equal(rows.uniforms(count), rows.uniforms(9)[:, :count])
        np.testing.assert_array_equal(rows.members(count, 7), members[:, :count])
        np.testing.assert_array_equal(rows.members(101, count), members[..., :count])
    for i in range(5):
        alone = RandomKeys.seeded([i]).of("sensor").at(int(rows.step[i]))[0]
        np.testing.assert_array_equal(alone.normals(23), whole[i])
        np.testing.assert_array_equal(alone.members(101, 7), members[i])
    some = pickle.loads(pickle.dumps(rows))[[4, 0]]
    np.testing.assert_array_equal(some.normals(23), whole[[4, 0]])


def test_every_key_step_use_and_member_has_its_own_number():
    found = [
        RandomKeys.seeded(seeds).of(episode).of(name).at(step).normals(5, use)
        for seeds in ([0], [1], [2**32], [2**64 - 1], [2**64], [2**64 + 1], [2**200])
        for episode in (0, 1)
        for name in ("a", "b", "")
        for step in (0, 1, 2**32)
        for use in (0, 1)
    ]
    values = np.concatenate([*found, RandomKeys.seeded([0]).members(50, 50)], None)
    assert len(np.unique(values)) == len(values)


@given(st.lists(st.integers(0, 2**130), min_size=2, max_size=2, unique=True))
def test_no_two_seeds_have_one_key(seeds: list[int]):
    assert not np.array_equal(*(key(seed) for seed in seeds))


def test_a_name_has_the_same_word_in_every_process():
    assert word("sensor GNSS") == 12917006548878277632


# --- how they are distributed ---------------------------------------------------------------------


@functools.cache
def drawn(kind: str) -> np.ndarray:
    """A million normal numbers ``(rows, steps, components)``."""
    rows = RandomKeys.seeded(range(100)).of("a")
    if kind == "members":
        return rows.members(100, 100)
    steps = RandomKeys(np.repeat(rows.keys[:, None], 100, 1)).at(np.arange(100))
    return steps.normals(100)


@pytest.mark.parametrize("kind", ["normals", "members"])
def test_normal_numbers_are_normally_distributed(kind: str):
    z = drawn(kind).ravel()
    moments = np.array([np.mean(z**k) for k in range(1, 9)])
    exact = np.array([0.0, 1.0, 0.0, 3.0, 0.0, 15.0, 0.0, 105.0])
    variance = np.array([1.0, 2.0, 15.0, 96.0, 945.0, 10170.0, 135135.0, 2016000.0])  # of z^k
    assert (np.abs(moments - exact) < SIGMA * np.sqrt(variance / z.size)).all()
    assert kstest(z, "norm").pvalue > 1e-6
    counts = np.histogram(norm.cdf(z), np.linspace(0.0, 1.0, 1001))[0]
    assert np.sum((counts - z.size / 1000) ** 2 / (z.size / 1000)) < chi2.isf(1e-6, 999)


@pytest.mark.parametrize("kind", ["normals", "members"])
def test_neighbours_are_independent(kind: str):
    """Of rows, steps or members, and components, a little apart; numbers and their squares."""
    z = drawn(kind)
    for values, sd in ((z, 1.0), (z**2 - 1.0, 2.0)):
        for axis in range(3):
            for lag in range(1, 9):
                ahead, behind = (
                    np.moveaxis(values, axis, 0)[part] for part in (slice(lag, None), slice(-lag))
                )
                assert abs(np.mean(ahead * behind)) < SIGMA * sd / np.sqrt(ahead.size)


def test_uniform_numbers_are_uniform():
    u = RandomKeys.seeded(range(1000)).of("a").uniforms(1000)
    assert u.min() >= 0.0
    assert u.max() < 1.0
    assert kstest(u.ravel(), "uniform").pvalue > 1e-6
    assert abs(np.mean((u[:, 1:] - 0.5) * (u[:, :-1] - 0.5))) < SIGMA / 12.0 / np.sqrt(
        u[:, 1:].size
    )
