"""No agent is ever scored on what it was trained or tuned on."""

from itertools import pairwise

import pytest

from agents.ppo import hyperparameters
from agents.seeds import evaluation_seeds, training_seed, tuning_seeds


def test_the_ranges_share_no_seed():
    evaluation = evaluation_seeds(1_000_000)
    tuning = tuning_seeds(1_000_000)
    assert (evaluation[0], evaluation[-1]) == (0, 999_999)
    assert evaluation[-1] < tuning[0]
    assert tuning[-1] < training_seed(0)


def test_batches_of_different_training_seeds_share_no_environment():
    largest = 100_000
    batches = [range(training_seed(k), training_seed(k) + largest) for k in range(50)]
    for one, other in pairwise(batches):
        assert one[-1] < other[0]
    assert hyperparameters("SigmaCorvette-v0")["num_envs"] <= largest


def test_evaluation_seeds_are_consecutive_from_the_first():
    assert evaluation_seeds(3) == [0, 1, 2]
    assert evaluation_seeds(2, first=500) == [500, 501]
    assert evaluation_seeds(1, first=999_999) == [999_999]


def test_tuning_seeds_are_consecutive():
    seeds = tuning_seeds(3)
    assert seeds == [1_000_000, 1_000_001, 1_000_002]


@pytest.mark.parametrize(("count", "first"), [(0, 0), (-1, 0), (1, -1), (1_000_001, 0), (2, 999_999), (1, 1_000_000)])
def test_evaluation_seeds_do_not_leave_their_range(count: int, first: int):
    with pytest.raises(ValueError, match=r"evaluation seeds lie in 0\.\.999999, got .* from "):
        evaluation_seeds(count, first)


@pytest.mark.parametrize("count", [0, -1, 1_000_001])
def test_tuning_seeds_do_not_leave_their_range(count: int):
    with pytest.raises(ValueError, match="tuning seeds"):
        tuning_seeds(count)


@pytest.mark.parametrize("wrong", [-1, -100])
def test_a_negative_training_seed_is_refused(wrong: int):
    with pytest.raises(ValueError, match=f"a training seed must be >= 0, got {wrong}"):
        training_seed(wrong)
