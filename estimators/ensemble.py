"""Ensemble filters: a belief is N members, and its moments are theirs.

Members are last, as in the formulas of `estimators.analysis`: an ensemble is ``(..., n, N)``. With
the anomalies ``A`` of the members ``(N, n)`` and the anomalies ``Y`` of the measurements that they
expect ``(N, p)``, every update here has the same three small matrices::

    C P- = Y' A / (N - 1)     S = Y' Y / (N - 1) + R     K = (C P-)' S^-1

Everything costs O(N p (n + p)), and nothing is N x N.
"""

import warnings
from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np

from estimators.analysis import average, covariance, gathered, noise, sample
from estimators.belief import EnsembleBelief
from estimators.checks import integer, number, short_repr
from estimators.engine import compiled
from estimators.filter import Changes, Data, Filter, Model
from estimators.linalg import (
    cholesky,
    rescuing,
    semidefinite_cholesky,
    shared_root,
    singular,
    solve,
    solve_lower,
    solve_upper,
)
from estimators.models import NonlinearModel, at_columns
from estimators.randomness import RandomKeys
from estimators.tunable import Log

START, PROCESS, MEASUREMENTS, MOVED, EXPECTED = 0, 1, 2, 4, 5
"""Uses of random numbers."""
_REDRAWS = 16
"""Most redraws of members whose measurement is not finite, with uses from EXPECTED on."""


class EnsembleFilter(Filter[EnsembleBelief]):
    """Base of ensemble filters: members, their prediction, the moments and inflation.

    The members of ``init`` and the process noise of ``predict`` are drawn at random and centred, so
    that they do not move the ensemble's mean. With exact draws their sample covariance is exact,
    and process noise has no sample correlation with the members. With independent draws both hold
    in expectation. Process noise takes rank(Q) numbers a member, or n where Q is a function of
    ``u``.

    A member has left the model's domain if it is not finite after a step, or if its expectation of
    an available measurement is not finite. It is drawn again from the mean and covariance of the
    other members, as long as more than n remain.

    Args:
        model: Any model; an unknown input in it is ignored.
        members: N, at least 2. None: 64, or n + r + 2 rounded up to a multiple of 8 if that is
            larger, with r = max(rank Q, p).
        inflation: Factor on the anomalies after each measurement; 1: none.
        draws: "exact": noise with exact sample moments, for which N must be at least n + r + 2;
            "independent": independent draws, as in most papers.

    Raises:
        ValueError: for another kind of draws, or an option out of its range.

    Warns:
        UserWarning: if there are too few members for exact draws; draws are then independent.
    """

    record = EnsembleBelief
    random = True
    tunable: ClassVar = {"inflation": Log(1.0, 1.1)}
    _axes: ClassVar = {"predict": (2, 2), "update": (1, 2, 2)}

    def __init__(
        self,
        model: Model,
        members: int | None = None,
        inflation: float = 1.0,
        draws: str = "exact",
    ) -> None:
        super().__init__(model)
        self.inflation = number("inflation", inflation, 0.0, what="a positive number")
        self._noise_root = noise_root(model.Q)
        rank = model.n if self._noise_root is None else self._noise_root.shape[-1]
        needed = model.n + max(rank, model.p) + 2
        enough = max(64, -8 * (-needed // 8))
        self.members = enough if members is None else integer("members", members, 2)
        if not isinstance(draws, str) or draws not in ("exact", "independent"):
            raise ValueError(f"draws must be 'exact' or 'independent', got {short_repr(draws)}")
        self._exact = draws == "exact" and self.members >= needed
        if draws == "exact" and not self._exact:
            warnings.warn(
                f"an ensemble of {self.members} members has independent draws: exact ones need"
                f" {needed}, {model.n} states + {max(rank, model.p)} draws + 2 (give more members,"
                ' or draws="independent")',
                UserWarning,
                stacklevel=3,
            )
        # A linear model's measurements are as unwrapped as its states.
        curved = isinstance(model, NonlinearModel)
        self._angles = model.state_angles if curved else ()
        self._seams = model.measurement_angles if curved else ()

    def _begin(self, mean: np.ndarray, cov: np.ndarray, rng: Any) -> Changes:
        normals = draw(rng, mean.shape[:-1], self.members, self.model.n, START)
        mean, members, cov = sample(
            mean, shared_root(cov), normals, angles=self._angles, exact=self._exact
        )
        return {"mean": mean, "cov": cov, "members": members}

    def propagate(self, belief: Any, u: np.ndarray | None) -> tuple[Any, ...]:
        """Members ``(..., n, N)`` one step on, and a root ``(..., n, r)`` of the process noise."""
        after = at_columns(self.model, "transition", belief.members, u)
        return after, process_root(self, belief, u)

    def expect(self, belief: Any, u: np.ndarray | None, R: Any = None) -> tuple[Any, ...]:
        """Mean ``(..., p)`` and anomalies ``(..., p, N)`` of members' measurements, and R."""
        expected = at_columns(self.model, "measurement", belief.members, u)
        members = gathered(expected, self._seams)
        mean = average(members)
        return mean, members - mean[..., None], self._noise(belief, u, R)

    def _predict(self, belief: Any, u: Any, *moved: Any) -> Changes:
        after, root, rng = moved
        batch = belief.mean.shape[:-1]
        if rescuing():
            after = self._redrawn(after, np.isfinite(after).all(-2), rng, MOVED)
        members = gathered(after, self._angles)
        if root.shape[-1] > 0:
            normals = draw(rng, batch, self.members, root.shape[-1], PROCESS)
            mean = average(members)
            A = members - mean[..., None]
            gram = A @ A.mT
            members = members + noise(root, normals, self._exact, A, gram)
            if self._exact and not self._angles:
                cov = gram / (self.members - 1) + root @ root.mT
                return {"mean": mean, "cov": cov, "members": members}
        return _moments(gathered(members, self._angles))

    def _update(
        self, belief: Any, u: Any, e: Any, Y: Any, R: Any, available: Any, *more: Any
    ) -> Changes:
        S = Y @ Y.mT / (self.members - 1) + R
        shift, A = self._analysis(belief, e, Y, S, R, available, *more)
        arrived = (1.0 * available).sum(-1) > 0.0
        inflation = self._option("inflation", belief)
        inflation = np.where(arrived[..., None], inflation, 1.0)[..., None]
        return _moments((belief.mean + shift)[..., None] + inflation * A) | {"innovation_cov": S}

    @abstractmethod
    def _analysis(
        self, belief: Any, e: Any, Y: Any, S: Any, R: Any, available: Any, rng: Any
    ) -> tuple[Any, Any]:
        """Shift of the mean ``(..., n)``, and the anomalies, not yet inflated."""

    def _redrawn(self, members: Any, kept: Any, rng: Any, use: int) -> np.ndarray:
        """Members ``(..., n, N)``, those not ``kept (..., N)`` drawn again.

        They are drawn from the mean and covariance of the others, if these are more than n.
        """
        normals = draw(rng, kept.shape[:-1], self.members, self.model.n, use)
        kept = (kept | (kept.sum(-1)[..., None] <= self.model.n))[..., None, :]
        number = kept.sum(-1)
        members = np.where(kept, members, 0.0)
        mean = (members.sum(-1) / number)[..., None]
        A = np.where(kept, members - mean, 0.0)
        root = semidefinite_cholesky(A @ A.mT / (number[..., None] - 1.0))
        return np.where(kept, members, mean + root @ normals)

    def _repaired(self, step: str, belief: Any, data: Data) -> Any:
        """The belief, with members drawn again whose available measurements are not finite."""
        if step == "predict":
            return belief
        u, y, available, _, rng = data
        missing, members = ~(available & np.isfinite(y))[..., None], belief.members
        for use in range(EXPECTED, EXPECTED + _REDRAWS):
            expected = at_columns(self.model, "measurement", members, u)
            kept = (np.isfinite(expected) | missing).all(-2)
            kept &= np.isfinite(members).all(-2)
            if kept.all():
                break
            members = self._redrawn(members, kept, rng, use)
        return belief.replaced(_moments(members))


@compiled
class EnsembleKalmanFilter(EnsembleFilter):
    """EnKF: every member is corrected by its own perturbed measurement.

    ``x_i = x_i- + K (y + v_i - h(x_i-))`` with ``v_i ~ N(0, R)`` centred to zero mean. The gain
    uses R itself, not a sample covariance::

        K = A' Y / (N - 1) (Y' Y / (N - 1) + R)^-1

    Sources: Burgers, van Leeuwen & Evensen (1998), Mon. Wea. Rev. 126; Evensen (2003), Ocean
    Dynamics 53; Sacher & Bartello (2008), Mon. Wea. Rev. 136, for the loss of variance with
    independent draws; Hoteit, Pham, Gharamti & Luo (2015), Mon. Wea. Rev. 143, for exact draws;
    Raanes, Carrassi & Bertino (2015), Mon. Wea. Rev. 143(10), for deterministic process noise.

    Args:
        model: Any model; an unknown input in it is ignored.
        members: N, at least 2. None: 64, or n + r + 2 rounded up to a multiple of 8 if that is
            larger, with r = max(rank Q, p).
        inflation: Factor on the anomalies after each measurement; 1: none.
        draws: "exact": noise with exact sample moments, for which N must be at least n + r + 2;
            "independent": independent draws, as in most papers.
    """

    name = "enkf"

    def _analysis(
        self, belief: Any, e: Any, Y: Any, S: Any, R: Any, available: Any, rng: Any
    ) -> tuple[Any, Any]:
        N, root = self.members, semidefinite_cholesky(R)
        A = belief.members - belief.mean[..., None]
        gain = solve(S, Y @ A.mT / (N - 1))
        normals = draw(rng, belief.mean.shape[:-1], N, self.model.p, MEASUREMENTS)
        used = np.vecmat(1.0 * available, 1.0 * (np.abs(root) > 0.0)) > 0.0
        normals = np.where(used[..., None], normals, 0.0)
        perturbed = noise(root, normals, self._exact, A, belief.cov * (N - 1.0)) - Y
        return np.vecmat(e, gain), A + gain.mT @ perturbed


@compiled
class EnsembleTransformFilter(EnsembleFilter):
    """ETKF, or EnKF-SR: members are transformed to the covariance of the Kalman filter.

    The update draws no random numbers. It is ``A <- T A`` of the anomalies A, with the symmetric,
    mean-preserving ``T = (I + Y R^-1 Y' / (N - 1))^-1/2`` and Y the anomalies of the measurements.
    It is computed as a reduced gain in p x p algebra, with ``S = L L'``, the singular value
    decomposition ``L^-1 R^1/2 = U s V'`` and ``W = L^-T U``::

        K = (C P-)' W W'        K~ = (C P-)' W diag(1 / (1 + s)) W'
        A <- A - Y K~'

    This needs no inverse of R and is exact for any N. Even precise measurements lose no digits,
    unless there are more of them than directions spanned by the members. In that case the mean
    stays exact, but the covariance has a relative error of up to ``eps P / R``, with P the
    predicted variance and eps the machine precision.

    The square-root filter of Evensen (2004) in its symmetric form, which keeps the members' mean,
    is this transform.

    Sources: Bishop, Etherton & Majumdar (2001), Mon. Wea. Rev. 129; Wang, Bishop & Julier (2004),
    Mon. Wea. Rev. 132; Evensen (2004), made symmetric by Sakov & Oke (2008b), Mon. Wea. Rev. 136,
    and Livings, Dance & Nichols (2008); the reduced gain of Whitaker & Hamill (2002), Mon. Wea.
    Rev. 130, for measurements taken together.

    Args:
        model: Any model; an unknown input in it is ignored.
        members: N, at least 2. None: 64, or n + r + 2 rounded up to a multiple of 8 if that is
            larger, with r = max(rank Q, p).
        inflation: Factor on the anomalies after each measurement; 1: none.
        draws: "exact": noise with exact sample moments, for which N must be at least n + r + 2;
            "independent": independent draws, as in most papers.
    """

    name = "etkf"

    def _analysis(
        self, belief: Any, e: Any, Y: Any, S: Any, R: Any, available: Any, rng: Any
    ) -> tuple[Any, Any]:
        A, L = belief.members - belief.mean[..., None], cholesky(S)
        singular_values, V = singular(solve_lower(L, semidefinite_cholesky(R)).mT)
        CP = solve_lower(L, Y @ A.mT / (self.members - 1))
        gain = V @ ((1.0 / (1.0 + singular_values))[..., None] * (V.mT @ CP))
        shift = np.vecmat(solve_lower(L, e[..., None])[..., 0], CP)
        return shift, A - solve_upper(L.mT, gain).mT @ Y


def process_root(filter: Any, belief: Any, u: np.ndarray | None) -> np.ndarray:
    """A root ``(..., n, r)`` of the process noise."""
    kept = filter._noise_root
    if kept is None:
        return semidefinite_cholesky(filter._process_noise(belief, u))
    if belief.parameters is None:
        return kept
    return np.sqrt(belief.parameters[..., 0, None, None]) * kept


def _moments(members: np.ndarray) -> Changes:
    """Arrays of a belief from its members ``(..., n, N)``."""
    mean = average(members)
    return {"mean": mean, "cov": covariance(members, mean), "members": members}


def draw(rng: Any, batch: tuple[int, ...], members: int, count: int, use: int) -> np.ndarray:
    """Standard normals ``(*batch, count, members)``."""
    if isinstance(rng, RandomKeys):
        return rng.members(members, count, use).mT
    return np.ascontiguousarray(rng.standard_normal(batch + (members, count)).mT)


def noise_root(cov: Any) -> np.ndarray | None:
    """``L (..., k, r)`` with ``L L' = cov``, r the largest rank of a batch; None of a function."""
    if callable(cov):
        return None
    values, vectors = np.linalg.eigh(cov)
    values = np.where(values > 1e-14 * values.shape[-1] * values[..., -1:], values, 0.0)
    needed = values.any(tuple(range(values.ndim - 1)))
    return np.ascontiguousarray((vectors * np.sqrt(values)[..., None, :])[..., needed])
