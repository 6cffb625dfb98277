"""Which seeds are for what, so that no agent is ever scored on what it was trained or tuned on.

Environment i of a batch seeded s is the single environment seeded s + i, so ranges must not overlap:

- evaluation: 0 to 999,999
- tuning (controllers' weights, PPO's hyperparameters): 1,000,000 to 1,999,999
- training: from 2,000,000, 100,000 apart for each training seed
"""

from vessel_gym.core import whole

_TUNING = 1_000_000
_TRAINING = 2_000_000
_SPACING = 100_000


def evaluation_seeds(count: int, first: int = 0) -> list[int]:
    """``count`` seeds that training and tuning never use.

    Raises:
        ValueError: for what is not whole numbers, or if they would leave the evaluation range.
    """
    if not (whole(count) and whole(first) and count >= 1 and first >= 0 and first + count <= _TUNING):
        few = ": ask for at least 1" if not (whole(count) and count >= 1) else ""
        raise ValueError(f"evaluation seeds lie in 0..{_TUNING - 1}, got {count!r} from {first!r}{few}")
    return list(range(first, first + count))


def tuning_seeds(count: int) -> list[int]:
    """``count`` seeds for choosing weights and hyperparameters.

    Raises:
        ValueError: for what is not a whole number, or if they would leave the tuning range.
    """
    if not (whole(count) and 1 <= count <= _TRAINING - _TUNING):
        raise ValueError(f"tuning seeds lie in {_TUNING}..{_TRAINING - 1}, got {count!r} of them: ask for at least 1")
    return list(range(_TUNING, _TUNING + count))


def training_seed(seed: int) -> int:
    """The seed of the training batch number ``seed``: batches of up to 100,000 share no environment.

    Raises:
        ValueError: for a seed that is not a whole number, negative, or too great for the libraries that learn.
    """
    if not (whole(seed) and seed >= 0):
        raise ValueError(f"a training seed must be >= 0, got {seed!r}")
    if seed >= 2**32:
        raise ValueError(f"a training seed must be below 2^32, got {seed!r}")
    return _TRAINING + _SPACING * seed
