"""A hundred million random numbers of neighbouring keys, steps, components and members, against the laws of the normal.

``make nightly``; some minutes. Seeds are fixed. All tests together have a false-alarm rate of 1e-3 (Bonferroni).
"""

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.stats import chi2, kstwo, norm

from estimators import RandomKeys

pytestmark = pytest.mark.nightly

KEYS, STEPS, SIZE, CHUNKS = 100, 100, 100, 100
"""Numbers of a chunk along each axis; the third is components, or members of one component."""
COUNT, LAGS, BINS = KEYS * STEPS * SIZE * CHUNKS, range(1, 9), 4096
KINDS = "normals", "members"
TESTS = len(KINDS) * (8 + 1 + 1 + 3 * len(LAGS) * 2)
"""Moments, Kolmogorov and Smirnov's, chi-square, and correlations along three axes of numbers and of their squares."""
RATE = 1e-3 / TESTS

MOMENTS = np.array([0.0, 1.0, 0.0, 3.0, 0.0, 15.0, 0.0, 105.0])
VARIANCES = np.array([1.0, 2.0, 15.0, 96.0, 945.0, 10170.0, 135135.0, 2016000.0])  # of z, z^2, ... z^8


def chunks(kind: str) -> Iterator[np.ndarray]:
    """Normal numbers ``(keys, steps, components or members)``, a hundred further keys a chunk."""
    for chunk in range(CHUNKS):
        keys = RandomKeys.seeded(range(chunk * KEYS, (chunk + 1) * KEYS)).keys
        rows = RandomKeys(np.repeat(keys[:, None], STEPS, 1)).at(np.arange(STEPS))
        yield rows.normals(SIZE) if kind == "normals" else rows.members(SIZE, 1)[..., 0]


@pytest.mark.parametrize("kind", KINDS)
def test_a_hundred_million_numbers_are_normal_and_independent(kind: str):
    powers, bins = np.zeros(8), np.zeros(BINS, int)
    products, pairs = np.zeros((2, 3, len(LAGS))), np.zeros((3, len(LAGS)))
    for z in chunks(kind):
        power = np.ones(z.shape)
        for k in range(8):
            power *= z
            powers[k] += power.sum()
        bins += np.bincount((norm.cdf(z.ravel()) * BINS).astype(int), minlength=BINS)
        for kind_of, values in enumerate((z, (z**2 - 1.0) / np.sqrt(2.0))):
            for axis in range(3):
                along = np.ascontiguousarray(np.moveaxis(values, axis, 0))
                for i, lag in enumerate(LAGS):
                    products[kind_of, axis, i] += np.vdot(along[lag:], along[:-lag])
                    pairs[axis, i] += along[lag:].size / 2
    limit = norm.isf(RATE / 2.0)
    assert (np.abs(powers / COUNT - MOMENTS) <= limit * np.sqrt(VARIANCES / COUNT)).all()
    assert np.sum((bins - COUNT / BINS) ** 2) / (COUNT / BINS) <= chi2.isf(RATE, BINS - 1)
    distance = np.abs(np.cumsum(bins) / COUNT - np.arange(1, BINS + 1) / BINS).max()  # at the edges of the bins
    assert distance <= kstwo.isf(RATE, COUNT)
    assert (np.abs(products) <= limit * np.sqrt(pairs)).all()
