"""Seeds of evaluation, tuning and training.

They are disjoint: no agent is scored on what it was trained or tuned on.

Row i of a batch seeded s has the seed s + i, so these ranges must not overlap:

- below 1,000,000,000: free, for seeds that are typed, as in ``reset(seed=7)`` or ``PPO(...,
  seed=0)``
- evaluation: the first million from 1,000,000,000
- tuning (weights of controllers, hyperparameters, choice of a policy): the next million
- training: from 1,002,000,000, 100,000 apart for each training seed
"""

_EVALUATION = 1_000_000_000
_RANGE = 1_000_000
_TUNING = _EVALUATION + _RANGE
_TRAINING = _TUNING + _RANGE
_SPACING = 100_000


def evaluation_seeds(count: int, first: int = 0) -> list[int]:
    """``count`` evaluation seeds, numbers ``first`` and following; no training or tuning uses them.

    Raises:
        ValueError: if there are none, or they would leave the evaluation range.
    """
    return _seeds("evaluation", _EVALUATION, count, first)


def tuning_seeds(count: int, first: int = 0) -> list[int]:
    """``count`` seeds for choosing weights, hyperparameters and policies, from number ``first`` on.

    Raises:
        ValueError: if there are none, or they would leave the tuning range.
    """
    return _seeds("tuning", _TUNING, count, first)


def _seeds(kind: str, begin: int, count: int, first: int) -> list[int]:
    if count < 1 or not 0 <= first <= _RANGE - count:
        raise ValueError(
            f"there are {_RANGE} {kind} seeds, numbered from 0: ask for one or more of these, got"
            f" {count!r} from {first!r}"
        )
    return list(range(begin + first, begin + first + count))


def training_seed(seed: int) -> int:
    """First seed of training batch number ``seed``; batches of up to 100,000 rows share no seed.

    Raises:
        ValueError: for a negative seed, or one too great for the libraries that learn.
    """
    if not 0 <= seed < 2**32:
        raise ValueError(f"a training seed must be from 0 to 2^32 - 1, got {seed!r}")
    return _TRAINING + _SPACING * seed
