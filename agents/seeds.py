"""Seeds of evaluation, tuning and training.

They are disjoint: no agent is scored on what it was trained or tuned on.

Row i of a batch seeded s has the seed s + i, so these ranges must not overlap:

- below 1,000,000,000: free, for seeds that are typed, as in ``reset(seed=7)`` or ``PPO(...,
  seed=0)``
- evaluation: the first million from 1,000,000,000
- tuning (weights of controllers, hyperparameters, choice of a policy): the next million
- training: from 1,002,000,000, 100,000 apart for each training seed
"""

from vessel_gym.checks import is_integer

_EVALUATION = 1_000_000_000
_TUNING = _EVALUATION + 1_000_000
_TRAINING = _TUNING + 1_000_000
_SPACING = 100_000


def evaluation_seeds(count: int, first: int = 0) -> list[int]:
    """``count`` seeds that training and tuning never use, from number ``first`` of their range on.

    Raises:
        ValueError: for what is not whole numbers, or if they would leave the evaluation range.
    """
    most = _TUNING - _EVALUATION
    if not (
        is_integer(count)
        and is_integer(first)
        and count >= 1
        and first >= 0
        and first + count <= most
    ):
        few = ": ask for at least 1" if not (is_integer(count) and count >= 1) else ""
        raise ValueError(
            f"there are {most} evaluation seeds, numbered from 0, got {count!r} from {first!r}{few}"
        )
    return list(range(_EVALUATION + first, _EVALUATION + first + count))


def tuning_seeds(count: int) -> list[int]:
    """``count`` seeds for choosing weights, hyperparameters and policies.

    Raises:
        ValueError: for what is not a whole number, or if they would leave the tuning range.
    """
    most = _TRAINING - _TUNING
    if not (is_integer(count) and 1 <= count <= most):
        raise ValueError(
            f"there are {most} tuning seeds, got {count!r} of them: ask for at least 1"
        )
    return list(range(_TUNING, _TUNING + count))


def training_seed(seed: int) -> int:
    """The seed of a training batch by number: batches of up to 100,000 share no environment.

    Raises:
        ValueError: for a seed that is not a whole number, negative, or too great for the libraries
            that learn.
    """
    if not (is_integer(seed) and seed >= 0):
        raise ValueError(f"a training seed must be >= 0, got {seed!r}")
    if seed >= 2**32:
        raise ValueError(f"a training seed must be below 2^32, got {seed!r}")
    return _TRAINING + _SPACING * seed
