"""Ensemble filters: a belief is N members, and its moments are theirs.

Rows are members: an ensemble is ``(..., N, n)``; in memory members are last, as in the formulas of
`estimators.analysis`, which predict and update. With the anomalies ``A`` of the members ``(N, n)``
and the anomalies ``Y`` of the measurements that they expect ``(N, p)``, every update here has the
same three small matrices::

    C P- = Y' A / (N - 1)        S = Y' Y / (N - 1) + R        K = (C P-)' S^-1

Everything costs O(N p (n + p)), and nothing is N x N unless that is less than p x p.
"""

import warnings
from typing import Any, ClassVar

import numpy as np

from estimators.analysis import (
    Moments,
    covariance,
    expect,
    forecast,
    perturbed_analysis,
    redraw,
    sample,
    transform_analysis,
)
from estimators.angles import difference
from estimators.belief import Belief, EnsembleBelief, Record, members_last, prior_belief
from estimators.checks import integer, number, short_repr
from estimators.engine.matrices import is_traced
from estimators.filter import Filter, Model, Rng, inlinable
from estimators.linalg import masked, semidefinite_cholesky, shared_root
from estimators.measurement import Measurement
from estimators.models import Gaussian, LinearModel, NonlinearModel, at_columns
from estimators.randomness import RandomKeys
from estimators.recovery import attempt
from estimators.varying import resolve

Drawn = RandomKeys | np.random.Generator
"""`Rng` of a filter that draws from it: there is one."""
START, PROCESS, MEASUREMENTS, MOVED, EXPECTED = 0, 1, 2, 4, 5
"""Uses of random numbers."""
_REDRAWS = 16
"""Times that members outside the domain of a measurement are drawn again: of uses from EXPECTED on."""
DRAWS = "exact", "independent"
"""Kinds of draws: with exact sample moments, or one independent of the other."""
_BEGIN = "_init", "_update"


class DrawingFilter(Filter[Record], verified=True):
    """Base of filters that draw random numbers."""

    random = True

    def _numbers(self, rng: Rng, batch: tuple[int, ...]) -> Drawn:
        """``rng``, checked: a key for every row, or a Generator for all."""
        if isinstance(rng, np.random.Generator):
            return rng
        if not isinstance(rng, RandomKeys):
            how = "pass rng, keys (estimators.RandomKeys) or a numpy Generator"
            raise (ValueError if rng is None else TypeError)(
                f"{self.name} draws random numbers: {how}, got {short_repr(rng)}"
            )
        if rng.keys.shape[:-1] != batch:
            raise ValueError(f"rng has keys for rows {rng.keys.shape[:-1]}, expected {batch}")
        return rng

    def _words(self, rng: Rng, batch: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        numbers: Any = self._numbers(rng, batch)
        step = numbers.step
        if not isinstance(step, np.ndarray) or step.shape != batch or step.dtype != np.int64:
            step = np.full(batch, step, np.int64)
        return numbers.keys, step[..., None]


class EnsembleFilter(DrawingFilter[EnsembleBelief], verified=True):
    """Base of ensemble filters: members, their prediction, the moments and inflation.

    Random numbers: the members of ``init`` and the process noise of ``predict`` are drawn and
    centred, so that they move the ensemble's mean by nothing. With exact draws their sample
    covariance is the one asked for, and process noise has no sample correlation with the members;
    with independent draws that holds in expectation. Process noise takes rank(Q) numbers a member,
    none where Q = 0 (n where Q is a function of ``u``).

    A member that is not finite after a step, or of which an available measurement has no value, has
    left the model's domain. It is drawn again from the mean and covariance of the others, as long
    as these are more than n.

    Args:
        model: Any model; an unknown input in it is ignored.
        members: N, at least 2; None: 64, or the next multiple of 8 from n + r + 2 on, r = max(rank
            Q, p).
        inflation: Factor on the anomalies after each measurement; 1: none.
        draws: "exact": noise has exact sample moments (`exact_noise`), for which N must be at least
            n + r + 2; "independent": as in most papers.

    Raises:
        ValueError: for another kind of draws, or an option out of its range.

    Warns:
        UserWarning: for exact draws with too few members, which are then independent ones.
    """

    record = EnsembleBelief
    formulas = True
    _questions: ClassVar = {"_moved_members": "_moved_members", "_expected": "_expected"}

    def __init__(
        self,
        model: Model,
        members: int | None = None,
        inflation: float = 1.0,
        draws: str = "exact",
    ) -> None:
        super().__init__(model)
        self.inflation = number("inflation", inflation, 0.0, np.inf, "a positive number")
        Q = model.Q
        self._noise_root = None if callable(Q) else noise_root(Q)
        rank = model.n if self._noise_root is None else self._noise_root.shape[-1]
        needed = model.n + max(rank, model.p) + 2
        self.members = (
            max(64, -8 * (-needed // 8)) if members is None else integer("members", members, 2)
        )
        if not isinstance(draws, str) or draws not in DRAWS:
            raise ValueError(f"draws must be 'exact' or 'independent', got {short_repr(draws)}")
        self._exact = draws == "exact" and self.members >= needed
        if draws == "exact" and not self._exact:
            warnings.warn(
                f"an ensemble of {self.members} members has independent draws: exact ones need"
                f" {needed}, "
                f"{model.n} states + {max(rank, model.p)} draws + 2 (give more members, or"
                ' draws="independent")',
                UserWarning,
                stacklevel=3,
            )
        curved = isinstance(
            model, NonlinearModel
        )  # a linear model's measurements are as unwrapped as its states
        self._angles = tuple(sorted(model.state_angles)) if curved else ()
        self._seams = tuple(sorted(model.measurement_angles)) if curved else ()
        self._prior_cov: np.ndarray | None = None
        self._prior_root = np.zeros((model.n, 0))

    # --- the contract -----------------------------------------------------------------------------

    def _init(self, belief: Belief, rng: Rng) -> EnsembleBelief:
        batch = belief.mean.shape[:-1]
        root = self._prior_root if is_traced(belief.mean) else shared_root(belief.cov)
        normals = members_last(
            draw(self._numbers(rng, batch), batch, self.members, self.model.n, START)
        )
        mean, members, cov = sample(
            belief.mean, root, normals, angles=self._angles, exact=self._exact
        )
        return EnsembleBelief.predicted(belief, mean, cov, belief.u, ensemble=members.mT)

    def begin(
        self,
        prior: Gaussian,
        u: np.ndarray | None,
        y: np.ndarray,
        available: np.ndarray | None,
        rng: Rng,
    ) -> EnsembleBelief:
        """The belief after the first measurement, in one program for priors with the covariance of the first one."""
        if self._compiles(rng) and self._regular and prior.cov.ndim == 2:
            if self._prior_cov is None:  # a constant of the program: other priors take two programs
                self._prior_cov, self._prior_root = prior.cov, shared_root(prior.cov)
            if prior.cov is self._prior_cov or np.array_equal(prior.cov, self._prior_cov):
                belief = prior_belief(prior.mean, prior.cov, u)
                packed, layout = belief.pack()
                if (program := self._program(_BEGIN, belief, layout, u)) is not None:
                    initial, doubtful = self._executed(
                        program, belief, packed, u, y, available, rng=rng
                    )
                    if not np.count_nonzero(doubtful):
                        return initial
        return super().begin(prior, u, y, available, rng)

    def forecast(self, belief: EnsembleBelief, u: np.ndarray | None, rng: Rng) -> EnsembleBelief:
        """The belief one step ahead; members that leave the model's domain are drawn again."""
        predicted = super().forecast(belief, u, rng)
        if np.isfinite(predicted.mean.sum()):
            return predicted
        rows = ~np.isfinite(predicted.mean.sum(-1))
        some, u = belief[rows], None if u is None else u[rows]
        rng = rng[rows] if isinstance(rng, RandomKeys) else rng
        with np.errstate(all="ignore"):
            after = members_last(self._moved_members(some, u).mT)
            after = self._redrawn(after, np.isfinite(after).all(-2), rng, MOVED)
            return predicted.with_rows(rows, self._noisy(some, after, u, rng))

    def _predict(self, belief: EnsembleBelief, u: np.ndarray | None, rng: Rng) -> EnsembleBelief:
        return self._noisy(belief, self._asked("_moved_members", belief, u), u, rng)

    def _noisy(
        self, belief: EnsembleBelief, after: np.ndarray, u: np.ndarray | None, rng: Rng
    ) -> EnsembleBelief:
        """The prediction of a belief whose members have moved to ``after (..., n, N)``."""
        batch = belief.mean.shape[:-1]
        root = (
            semidefinite_cholesky(resolve(self.model.Q, u))
            if self._noise_root is None
            else self._noise_root
        )
        normals = members_last(
            draw(self._numbers(rng, batch), batch, self.members, root.shape[-1], PROCESS)
        )
        mean, members, cov = forecast(
            members_last(belief.ensemble),
            after,
            root,
            normals,
            angles=self._angles,
            exact=self._exact,
        )
        return EnsembleBelief.predicted(belief, mean, cov, u, ensemble=members.mT)

    def _redrawn(self, members: np.ndarray, kept: np.ndarray, rng: Rng, use: int) -> np.ndarray:
        """Members ``(..., n, N)`` with those not ``kept (..., N)`` drawn again, in rows that keep more than n."""
        batch = kept.shape[:-1]
        normals = members_last(
            draw(self._numbers(rng, batch), batch, self.members, self.model.n, use)
        )
        return redraw(members, kept | (kept.sum(-1)[..., None] <= self.model.n), normals)

    @inlinable("transition")
    def _moved_members(self, belief: EnsembleBelief, u: np.ndarray | None) -> np.ndarray:
        """Members ``(..., n, N)`` one step on, without process noise."""
        model, members = self.model, members_last(belief.ensemble)
        if not isinstance(model, LinearModel):
            return at_columns(model, "transition", members, u, model.n)
        after = resolve(model.A, u) @ members
        return (
            after
            if model.B is None or u is None
            else after + np.matvec(resolve(model.B, u), u)[..., None]
        )

    @inlinable("measurement")
    def _expected(self, belief: EnsembleBelief, u: np.ndarray | None) -> np.ndarray:
        """Measurements ``(..., p, N)`` that the members expect."""
        model, members = self.model, members_last(belief.ensemble)
        if not isinstance(model, LinearModel):
            return at_columns(model, "measurement", members, u, model.p)
        return resolve(model.C, u) @ members

    def _measurement(
        self,
        belief: EnsembleBelief,
        y: np.ndarray,
        available: np.ndarray | None,
        R: np.ndarray | None,
    ) -> Measurement:
        mean, anomalies = expect(self._asked("_expected", belief, belief.u), angles=self._seams)
        whole, mask = self._noise(y, available, R, belief.u)
        complete, none = not is_traced(mask) and bool(mask.all()), self._no_columns
        innovation, R = difference(y, mean, self.model.measurement_angles), whole
        if not complete:
            innovation, R = np.where(mask, innovation, 0.0), masked(whole, mask)
        return Measurement(innovation, none, none, R, mask, complete, anomalies.mT, whole)

    def _condensed(
        self, start: EnsembleBelief, measurement: Measurement, S: np.ndarray, lost: np.ndarray
    ) -> tuple[Measurement, np.ndarray] | None:
        alone = measurement.only(measurement.available)
        return super()._condensed(
            start, alone._replace(available=np.ones_like(alone.available)), S, lost
        )

    def _recovered(
        self, belief: EnsembleBelief, updated: EnsembleBelief, measurement: Measurement, y: np.ndarray, rng: Rng,
        available: np.ndarray | None, R: np.ndarray | None,
    ) -> EnsembleBelief:  # fmt: skip
        """The recovered update, after members that an available measurement has no value for are drawn again."""
        assert measurement.anomalies is not None
        if (np.isfinite(measurement.anomalies) | ~measurement.available[..., None, :]).all():
            return super()._recovered(belief, updated, measurement, y, rng, available, R)
        members = members_last(belief.ensemble)
        redrawn = self._redrawn_until_expected(belief, measurement.available, rng)
        rows = (redrawn != members).any((-2, -1)) & np.isfinite(redrawn).all((-2, -1))
        if rows.any():
            belief = belief.with_rows(rows, belief[rows].replace(ensemble=redrawn[rows].mT))
            measurement = self._measurement(belief, y, available, R)
            updated = updated.with_rows(rows, attempt(self, belief, measurement, rng)[rows])
        return super()._recovered(belief, updated, measurement, y, rng, available, R)

    def _redrawn_until_expected(
        self, belief: EnsembleBelief, available: np.ndarray, rng: Rng
    ) -> np.ndarray:
        """Members ``(..., n, N)``, drawn again a few times where an available measurement has no value for them."""
        members = members_last(belief.ensemble)
        finite = np.isfinite(members).all(-2)
        for attempt_number in range(_REDRAWS):
            expected = self._expected(belief, belief.u)
            kept = (np.isfinite(expected) | ~available[..., None]).all(-2) | ~finite
            if kept.all():
                break
            members = self._redrawn(members, kept, rng, EXPECTED + attempt_number)
            belief = belief.replace(ensemble=members.mT)
        return members

    # --- pieces -----------------------------------------------------------------------------------

    def _moments(self, belief: EnsembleBelief, measurement: Measurement) -> Moments:
        """Arguments that every analysis has."""
        assert measurement.anomalies is not None
        members, Y = members_last(belief.ensemble), members_last(measurement.anomalies)
        return members, belief.mean, Y, measurement.innovation, measurement.available, measurement.R


class EnsembleKalmanFilter(EnsembleFilter, verified=True):
    """EnKF: every member is corrected by its own perturbed measurement.

    ``x_i = x_i- + K (y + v_i - h(x_i-))`` with ``v_i ~ N(0, R)`` centred to zero mean, and the gain
    with R exact::

        K = A' Y / (N - 1) (Y' Y / (N - 1) + R)^-1

    Sources: Burgers, van Leeuwen & Evensen (1998); Evensen (2003).

    Args:
        model: Any model; an unknown input in it is ignored.
        members: N, at least 2; None: 64, or the next multiple of 8 from n + r + 2 on, r = max(rank
            Q, p).
        inflation: Factor on the anomalies after each measurement; 1: none.
        draws: "exact": noise has exact sample moments (`exact_noise`), for which N must be at least
            n + r + 2; "independent": as in most papers.
    """

    name = "enkf"
    sequential = False

    def __init__(
        self,
        model: Model,
        members: int | None = None,
        inflation: float = 1.0,
        draws: str = "exact",
    ) -> None:
        super().__init__(model, members, inflation, draws)
        self._measurement_root = None if callable(model.R) else semidefinite_cholesky(model.R)

    def _update(self, belief: EnsembleBelief, measurement: Measurement, rng: Rng) -> EnsembleBelief:
        batch, arrived = belief.mean.shape[:-1], measurement.available
        numbers = self._numbers(rng, batch)
        # The gain of a missing measurement is zero, so that the root of the whole R does: it is
        # known beforehand.
        root = self._measurement_root
        if root is None or measurement.whole_R is not self.model.R:
            root = semidefinite_cholesky(measurement.R)
        # the numbers of which a measurement that arrived has a share
        wanted = np.vecmat(1.0 * arrived, 1.0 * (np.abs(root) > 0.0)) > 0.0
        normals = members_last(
            draw(numbers, batch, self.members, self.model.p, MEASUREMENTS, wanted)
        )
        mean, members, S = perturbed_analysis(
            *self._moments(belief, measurement), root, normals, belief.cov,
            inflation=self.inflation, exact=self._exact,
        )  # fmt: skip
        return EnsembleBelief.updated(
            belief, mean, covariance(members, mean), measurement, S, ensemble=members.mT
        )


class EnsembleTransformFilter(EnsembleFilter, verified=True):
    """ETKF, or EnKF-SR: the members are transformed so that their covariance is the Kalman filter's.

    The update draws no random numbers. ``A <- T A`` with the symmetric, mean-preserving ``T = (I +
    Y R^-1 Y' / (N - 1))^-1/2``, computed as a reduced gain in p x p algebra: with ``S = L L'``, the
    singular value decomposition ``L^-1 R^1/2 = U s V'`` and ``W = L^-T U``::

        K = (C P-)' W W'        K~ = (C P-)' W diag(1 / (1 + s)) W'        A <- A - Y K~'

    which needs no inverse of R and is exact for any N. Where there are more measurements than
    members, T is formed, N x N, if the model's R is one matrix that is not singular. However
    precise they are, measurements cost no digits unless they outnumber the directions of the
    members; then the covariance, not the mean, is off by up to ``eps P / R`` of itself, P the
    variance that is predicted and eps the machine's precision, and by some ``eps sqrt(P / R)``
    where T is formed.

    Evensen's square-root filter is the same transform in its symmetric form, which keeps the
    members' mean.

    Sources: Bishop, Etherton & Majumdar (2001); Wang, Bishop & Julier (2004); Evensen (2004), made
    symmetric by Sakov & Oke (2008b) and Livings, Dance & Nichols (2008); the reduced gain of
    Whitaker & Hamill (2002) for measurements taken together.

    Args:
        model: Any model; an unknown input in it is ignored.
        members: N, at least 2; None: 64, or the next multiple of 8 from n + r + 2 on, r = max(rank
            Q, p).
        inflation: Factor on the anomalies after each measurement; 1: none.
        draws: "exact": noise has exact sample moments (`exact_noise`), for which N must be at least
            n + r + 2; "independent": as in most papers.
    """

    name = "etkf"

    def __init__(
        self,
        model: Model,
        members: int | None = None,
        inflation: float = 1.0,
        draws: str = "exact",
    ) -> None:
        super().__init__(model, members, inflation, draws)
        self.sequential = self.inflation == 1.0

    def _update(self, belief: EnsembleBelief, measurement: Measurement, rng: Rng) -> EnsembleBelief:
        self._numbers(rng, belief.mean.shape[:-1])
        regular = bool(self._regular) and measurement.whole_R is self.model.R
        mean, members, S = transform_analysis(
            *self._moments(belief, measurement), inflation=self.inflation, regular=regular
        )
        return EnsembleBelief.updated(
            belief, mean, covariance(members, mean), measurement, S, ensemble=members.mT
        )


# --- shared ---------------------------------------------------------------------------------------


def draw(
    numbers: Drawn,
    batch: tuple[int, ...],
    members: int,
    count: int,
    use: int,
    wanted: np.ndarray | None = None,
) -> np.ndarray:
    """Standard normals ``(*batch, members, count)``; components not ``wanted (*batch, count)`` hold anything."""
    if isinstance(numbers, np.random.Generator):
        return numbers.standard_normal(batch + (members, count))
    return numbers.members(members, count, use, wanted)


def noise_root(cov: np.ndarray) -> np.ndarray:
    """``L (..., k, r)`` with ``L L' = cov`` and r the rank of ``cov (..., k, k)``: the largest one of a batch."""
    values, vectors = np.linalg.eigh(cov)
    values = np.where(values > 1e-14 * values.shape[-1] * values[..., -1:], values, 0.0)
    needed = values.any(tuple(range(values.ndim - 1)))
    return np.ascontiguousarray((vectors * np.sqrt(values)[..., None, :])[..., needed])
