"""What a filter believes at one time: an immutable record of arrays."""

from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np


class Recovery(IntEnum):
    """What an update had to do to a row: the first of these that gave a finite belief."""

    USUAL = 0
    PSEUDO_INVERSE = 1
    WITHOUT_CHANNEL = 2
    PREDICTION = 3
    PRIOR = 4

    @property
    def reason(self) -> str:
        """Why it had to, in one sentence."""
        return _REASONS[self]


_REASONS = {
    Recovery.USUAL: "the usual gain was used",
    Recovery.PSEUDO_INVERSE: "some readings repeat others without noise of their own (the innovation covariance is "
    "singular), so the gain was taken with its pseudo-inverse",
    Recovery.WITHOUT_CHANNEL: "a reading could not be used (what the filter expected of it was not finite, or it "
    "repeats others without noise), so it was left out: `available` says which",
    Recovery.PREDICTION: "no reading could be used, so the prediction stands alone",
    Recovery.PRIOR: "the prediction was no longer finite, so the filter began again from its prior and this reading",
}


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """A filter's belief and everything its next step needs; leading axes are a batch.

    Attributes:
        mean: ``(..., n)`` state estimate.
        cov: ``(..., n, n)`` its covariance.
        prior_mean: ``(..., n)`` where a lost row starts again.
        prior_cov: ``(..., n, n)`` likewise.
        recovery: ``(...)`` what the last update had to do, as the numbers of `Recovery`; 0: the usual.
        u: ``(..., m)`` the known input of the last prediction.
        innovation: ``(..., p)`` reading minus expectation, 0 where no reading came.
        innovation_cov: ``(..., p, p)`` its covariance, unit where no reading came.
        available: ``(..., p)`` which readings the last update used.
        input_mean: ``(..., q)`` estimate of the unknown input (unknown-input filters).
        input_cov: ``(..., q, q)`` its covariance.
        state_input_cov: ``(..., n, q)`` covariance between the two errors.
        input_observed: ``(..., q, q)`` projector on the directions of the unknown input that the
            readings determined; in the others the estimate is its prior.
        pending: ``(...)`` True where a prediction waits for the reading that shows its unknown
            input (filters without feedthrough).
        ensemble: ``(..., N, n)`` members as rows (ensemble filters).
        input_matrix: ``(..., n, q)`` G of the last prediction, for a model whose G is a function.
        feedthrough_mean: ``(..., q)`` what the readings of this very step show of the unknown input that acts
            now, 0 in the other directions (filters that know the whole input one step later).
        feedthrough_cov: ``(..., q, q)`` its covariance, 0 in the other directions.
        state_feedthrough_cov: ``(..., n, q)`` covariance of its error and the state's.
        feedthrough_observed: ``(..., q, q)`` projector on the directions that they show.
    """

    mean: np.ndarray
    cov: np.ndarray
    prior_mean: np.ndarray
    prior_cov: np.ndarray
    recovery: np.ndarray
    u: np.ndarray | None = None
    innovation: np.ndarray | None = None
    innovation_cov: np.ndarray | None = None
    available: np.ndarray | None = None
    input_mean: np.ndarray | None = None
    input_cov: np.ndarray | None = None
    state_input_cov: np.ndarray | None = None
    input_observed: np.ndarray | None = None
    pending: np.ndarray | None = None
    ensemble: np.ndarray | None = None
    input_matrix: np.ndarray | None = None
    feedthrough_mean: np.ndarray | None = None
    feedthrough_cov: np.ndarray | None = None
    state_feedthrough_cov: np.ndarray | None = None
    feedthrough_observed: np.ndarray | None = None

    @property
    def healthy(self) -> np.ndarray:
        """``(...)`` True where the last update was the usual one."""
        return self.recovery == 0

    @property
    def reasons(self) -> np.ndarray:
        """``(...)`` sentences that say what the last update did to each row, and why."""
        sentences = np.array([rung.reason for rung in Recovery], dtype=object)
        return np.asarray(sentences[self.recovery], dtype=object)

    def __getitem__(self, rows: Any) -> "Belief":
        """The beliefs of some rows of the batch: a mask, an index or a slice over leading axes."""
        return type(self)(*(None if a is None else a[rows] for a in self._arrays()))

    def with_rows(self, rows: np.ndarray, other: "Belief") -> "Belief":
        """This belief with the rows of a mask ``(...)`` replaced, in order, by those of ``other``.

        One of the two may have seen no reading or no known input yet: its rows then have none (an innovation of 0).

        Raises:
            ValueError: if the two are beliefs of different filters.
        """
        values: list[np.ndarray | None] = []
        for f in fields(self):
            mine, theirs = getattr(self, f.name), getattr(other, f.name)
            if mine is None and theirs is None:
                values.append(None)
                continue
            if mine is None:
                mine = _unseen(f.name, theirs, self.mean.shape[:-1])
            elif theirs is None:
                theirs = _unseen(f.name, mine, other.mean.shape[:-1])
            merged = np.array(mine)
            merged[rows] = theirs
            values.append(merged)
        return type(self)(*values)

    def replace(self, **changes: Any) -> "Belief":
        """This belief with some fields changed."""
        names = self.__match_args__
        return type(self)(**(dict(zip(names, self._arrays(), strict=True)) | changes))

    def _arrays(self) -> list[np.ndarray | None]:
        return [getattr(self, name) for name in self.__match_args__]


def _unseen(name: str, like: np.ndarray, batch: tuple[int, ...]) -> np.ndarray:
    """What a field says in rows ``batch`` that have seen no reading, or were told no known input, yet."""
    if name not in ("u", "innovation", "innovation_cov", "available"):
        raise ValueError(f"cannot merge two beliefs of which only one has {name}: they are of different filters")
    if name == "innovation_cov":
        return np.broadcast_to(np.eye(like.shape[-1]), batch + like.shape[-2:])
    return np.zeros(batch + like.shape[-1:], like.dtype)
