"""A measurement prepared for a filter's update."""

from typing import NamedTuple

import numpy as np

from estimators.linalg import congruence, masked


class Measurement(NamedTuple):
    """A measurement prepared for an update: missing channels carry no information.

    A missing channel has innovation 0, a zero row in ``C`` and ``H`` and a unit, uncorrelated
    variance in ``R``, so that the formulas need no special case.
    """

    innovation: np.ndarray  # (..., p)
    C: np.ndarray  # (..., p, n); (p, 0) where members stand for it (ensemble filters)
    H: np.ndarray  # (..., p, q)
    R: np.ndarray  # (..., p, p)
    available: np.ndarray  # (..., p)
    complete: bool
    anomalies: np.ndarray | None = (
        None  # (..., N, p) spread of what the members expect (ensemble filters)
    )
    whole_R: np.ndarray | None = (
        None  # (..., p, p) R with that of missing measurements, too (ensemble filters)
    )
    spread: np.ndarray | None = (
        None  # (..., 1, 1) share of the unknown input's prior in S, where S alone is singular
    )

    def only(self, kept: np.ndarray) -> "Measurement":
        """The measurement without the channels where the mask ``kept (..., p)`` is False."""
        rows = kept[..., None]
        return self._replace(
            innovation=np.where(kept, self.innovation, 0.0),
            C=np.where(rows, self.C, 0.0) if self.C.size else self.C,
            H=np.where(rows, self.H, 0.0) if self.H.size else self.H,
            R=masked(self.R, kept),
            available=kept,
            complete=False,
            anomalies=(
                None
                if self.anomalies is None
                else np.where(kept[..., None, :], self.anomalies, 0.0)
            ),
        )

    def of_rows(self, rows: np.ndarray) -> "Measurement":
        """The measurement of the rows where the mask ``rows (...)`` of the batch is True."""
        axes = {name: 1 if name in ("innovation", "available") else 2 for name in self._fields}
        arrays = {name: a for name, a in self._asdict().items() if isinstance(a, np.ndarray)}
        return self._replace(
            **{
                name: np.broadcast_to(a, rows.shape + a.shape[-axes[name] :])[rows]
                for name, a in arrays.items()
            }
        )

    def mixed(self, T: np.ndarray, spread: np.ndarray | None = None) -> "Measurement":
        """The measurement ``T y``, ``T (..., p, p)``; where T has a row of zeros a channel is missing."""
        kept = np.asarray(T.any(-1))
        R = masked(congruence(T, self.R), kept)
        return self._replace(
            innovation=np.matvec(T, self.innovation),
            C=T @ self.C,
            H=T @ self.H,
            R=R,
            complete=False,
            anomalies=None if self.anomalies is None else self.anomalies @ T.mT,
            whole_R=R,
            spread=spread,
        )
