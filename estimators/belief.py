"""What a filter believes at one time: an immutable record of arrays."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """A filter's belief and everything its next step needs; leading axes are a batch.

    Attributes:
        mean: ``(..., n)`` state estimate.
        cov: ``(..., n, n)`` its covariance.
        prior_mean: ``(..., n)`` where a lost row starts again.
        prior_cov: ``(..., n, n)`` likewise.
        healthy: ``(...)`` False where the last update had to start again from the prior.
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
    healthy: np.ndarray
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

    def __getitem__(self, rows: Any) -> "Belief":
        """The beliefs of some rows of the batch: a mask, an index or a slice over leading axes."""
        return type(self)(*(None if a is None else a[rows] for a in self._arrays()))

    def with_rows(self, rows: np.ndarray, other: "Belief") -> "Belief":
        """This belief with the rows of a mask ``(...)`` replaced, in order, by those of ``other``."""
        values: list[np.ndarray | None] = []
        for f in fields(self):
            mine, theirs = getattr(self, f.name), getattr(other, f.name)
            if mine is None or theirs is None:
                if not (mine is None and theirs is None):
                    raise ValueError(f"cannot merge two beliefs of which only one has {f.name}")
                values.append(None)
                continue
            merged = np.array(mine)
            merged[rows] = theirs
            values.append(merged)
        return type(self)(*values)

    def replace(self, **changes: Any) -> "Belief":
        """This belief with some fields changed."""
        return replace(self, **changes)

    def _arrays(self) -> list[np.ndarray | None]:
        return [getattr(self, f.name) for f in fields(self)]
