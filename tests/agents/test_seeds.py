"""No agent is ever scored on what it was trained or tuned on."""

from itertools import pairwise
from typing import Any

import pytest

from agents.seeds import evaluation_seeds, training_seed, tuning_seeds
from agents.training.algorithms import hyperparameters

MILLION = 1_000_000
EVALUATION, TUNING = (
    range(seeds(1)[0], seeds(1)[0] + MILLION) for seeds in (evaluation_seeds, tuning_seeds)
)


def test_the_ranges_share_no_seed():
    assert (evaluation_seeds(MILLION), tuning_seeds(MILLION)) == (list(EVALUATION), list(TUNING))
    assert evaluation_seeds(2, first=500) == list(EVALUATION[500:502])
    assert EVALUATION[-1] < TUNING[0] < TUNING[-1] < training_seed(0)


def test_training_meets_no_evaluation_and_no_tuning_seed():
    """Rows of `train --seed` start at `training_seed`; those of `PPO(..., seed=...)` at the seed itself."""
    for seed in range(1001):
        for first in (training_seed(seed), seed):
            rows = range(first, first + 100_000)
            assert rows[-1] < EVALUATION[0] or rows[0] > TUNING[-1]


def test_batches_of_training_seeds_share_no_environment():
    largest = 100_000
    batches = [range(training_seed(k), training_seed(k) + largest) for k in range(50)]
    for one, other in pairwise(batches):
        assert one[-1] < other[0]
    assert hyperparameters("SigmaCorvette-v0")["n_envs"] <= largest


@pytest.mark.parametrize(
    ("seeds", "arguments", "sentence"),
    [
        (
            evaluation_seeds,
            (0,),
            "^there are 1000000 evaluation seeds, .*: ask for one or more of these, got 0",
        ),
        (evaluation_seeds, (100, -1), "got 100 from -1$"),
        (evaluation_seeds, (2, 999_999), "got 2 from 999999$"),
        (tuning_seeds, (1_000_001,), "^there are 1000000 tuning seeds, .*, got 1000001 from 0$"),
        (training_seed, (-1,), "a training seed must be from 0 to 2.*, got -1"),
        (training_seed, (2**32,), "got 4294967296"),
    ],
)
def test_no_seed_is_outside_of_its_range(seeds: Any, arguments: tuple[int, ...], sentence: str):
    with pytest.raises(ValueError, match=sentence):
        seeds(*arguments)
