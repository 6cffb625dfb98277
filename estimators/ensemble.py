"""Ensemble filters: a belief is N members, and its moments are theirs.

Rows are members: an ensemble is ``(..., N, n)``; in memory members are last, see `estimators.members`, whose kernels
predict and update. The formulas are here once more, in NumPy, for what is rare: rows that need a milder update, random
rotations, and the filter as it was published. With the anomalies ``A`` of the members ``(N, n)`` and the anomalies
``Y`` of the readings that they expect ``(N, p)``, every update here has the same three small matrices::

    C P- = Y' A / (N - 1)        S = Y' Y / (N - 1) + R        K = (C P-)' S^-1

Everything costs O(N p (n + p)) and nothing is N x N (``variant="evensen2004"`` of `enkf-sr` excepted).
"""

from collections.abc import Callable, Iterator
from math import prod
from typing import Any

import numpy as np

from estimators.angles import difference, together
from estimators.belief import Belief, EnsembleBelief
from estimators.checks import as_array, number, shown, whole
from estimators.filter import Filter, Model, Rng
from estimators.linalg import cholesky, neutralised, product, semidefinite_cholesky, solve, symmetrise
from estimators.members import PROCESS, READINGS, forecast, members_last, perturbed, transformed
from estimators.models import LinearModel, NonlinearModel, at_points, resolve
from estimators.randomness import Numbers
from estimators.reading import Reading

Drawn = Numbers | np.random.Generator
"""`Rng` of a filter that draws from it: there is one."""
START, ROTATION = 0, 3
"""Uses of random numbers, beside those of `estimators.members`."""
_CACHE = 2**18
"""Bytes of members that are predicted and updated at a time, so that they stay in the cache meanwhile."""
_LATER: Any = None
"""A covariance that is computed when somebody asks for it."""
_Moments = tuple[np.ndarray, np.ndarray]
"""Means ``(b, n)`` and members ``(b, n, N)`` of rows."""


Analyser = Callable[[slice, tuple[np.ndarray, ...], tuple[np.ndarray, ...]], None]


class EnsembleFilter(Filter[EnsembleBelief]):
    """What the ensemble filters share: members, their prediction, the moments, inflation and localisation.

    Random numbers: the members of ``init`` and the process noise of ``predict`` are drawn and centred, so that they
    move the ensemble's mean by nothing: the mean follows the model, and the covariance is right in expectation. Process
    noise takes rank(Q) numbers a member, none where Q = 0 (n where Q is a function of ``u``).

    Args:
        model: Any model; an unknown input in it is ignored.
        members: N, at least 2.
        inflation: Factor on the anomalies of every component that an update may correct; 1: none.
        localisation: ``(n, p)``: which reading may correct which component; None: every one.
    """

    record = EnsembleBelief
    random = True

    def __init__(
        self, model: Model, members: int = 100, inflation: float = 1.0, localisation: np.ndarray | None = None
    ) -> None:
        super().__init__(model)
        self.members = whole("members", members, 2)
        self.inflation = number("inflation", inflation, 0.0, np.inf, "a positive number")
        self.localisation = None if localisation is None else self._taper(localisation)
        self._mean_weights = np.full(self.members, 1.0 / self.members)
        Q = model.Q
        self._noise_root = None if callable(Q) else noise_root(Q)
        curved = isinstance(model, NonlinearModel)
        self._wrapped = np.array(model.state_angles if curved else (), np.int64)
        self._angles = np.isin(np.arange(model.p), model.measurement_angles)
        self._seams = self._angles & curved
        matrices = (getattr(model, name, None) for name in "ABCQR")
        self._batched = any(isinstance(matrix, np.ndarray) and matrix.ndim > 2 for matrix in matrices)

    @property
    def _compiled(self) -> bool:
        """Whether kernels update; what somebody has made of this class may have formulas of its own."""
        return self._ours

    def _taper(self, localisation: np.ndarray) -> np.ndarray:
        """The localisation as numbers ``(n, p)`` from 0 to 1."""
        taper = as_array("localisation", localisation)
        if taper.shape != (self.model.n, self.model.p):
            raise ValueError(f"localisation has shape {taper.shape}, expected (n, p) = {(self.model.n, self.model.p)}")
        if not ((taper >= 0.0) & (taper <= 1.0)).all():
            raise ValueError(f"localisation must lie between 0 and 1, got {taper.min():g} to {taper.max():g}")
        return taper

    # --- the contract -----------------------------------------------------------------------------

    def _init(self, belief: Belief, rng: Rng) -> EnsembleBelief:
        batch = belief.mean.shape[:-1]
        numbers = self._numbers(rng, batch)
        ensemble = self._centred_noise(numbers, batch, semidefinite_cholesky(belief.cov), START)
        ensemble += belief.mean[..., None, :]
        return EnsembleBelief.of(belief.replace(mean=self._mean(ensemble), cov=_LATER), ensemble=ensemble)

    def _predict(self, belief: EnsembleBelief, u: np.ndarray | None, rng: Rng) -> EnsembleBelief:
        mean, members = self._room(prod(belief.mean.shape[:-1]))
        predict = self._prediction(belief, u, rng)
        for rows in self._chunks(len(mean)):
            predict(rows, (mean[rows], members[rows]))
        mean = mean.reshape(belief.mean.shape)
        return EnsembleBelief.predicted(belief, mean, _LATER, u, ensemble=_ensemble(members, mean))

    def _advance(
        self, belief: EnsembleBelief, u: np.ndarray | None, y: np.ndarray, available: np.ndarray | None, rng: Rng
    ) -> EnsembleBelief:
        if not self._compiled or not isinstance(rng, Numbers):  # which gives the same numbers again
            return super()._advance(belief, u, y, available, rng)
        predict = self._prediction(belief, u, rng)

        def predicted(rows: slice) -> _Moments:
            moments = self._room(rows.stop - rows.start)
            predict(rows, moments)
            return moments

        with np.errstate(all="ignore"):
            updated, lost = self._analysis_of(predicted, belief, u, y, rng, available, None)
            if not lost.any():
                return updated
            return self._cured(self._predict(belief, u, rng), updated, lost, y, rng, available, None)

    def _corrected(
        self, belief: EnsembleBelief, y: np.ndarray, rng: Rng, available: np.ndarray | None, R: np.ndarray | None
    ) -> EnsembleBelief:
        if not self._compiled:
            return super()._corrected(belief, y, rng, available, R)
        mean, members = _rows(belief.mean, belief.mean.shape[:-1], 1), members_last(belief.ensemble)
        updated, lost = self._analysis_of(
            lambda rows: (mean[rows], members[rows]), belief, belief.u, y, rng, available, R
        )  # fmt: skip
        return self._cured(belief, updated, lost, y, rng, available, R) if lost.any() else updated

    def _cured(
        self, belief: EnsembleBelief, updated: EnsembleBelief, lost: np.ndarray, y: np.ndarray, rng: Rng,
        available: np.ndarray | None, R: np.ndarray | None,
    ) -> EnsembleBelief:  # fmt: skip
        """The update with its lost rows ``(...)`` taken from one in NumPy, which recovers them."""
        some = np.ones_like(lost) if self._batched else lost  # matrices of a batch are for all of its rows
        cured = super()._corrected(
            belief[some], y[some], rng[some] if isinstance(rng, Numbers) else rng,
            None if available is None else available[some], None if R is None else R[some],
        )  # fmt: skip
        return updated.with_rows(lost, cured[lost[some]])

    def _reading(
        self, belief: EnsembleBelief, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None
    ) -> Reading:
        model, u = self.model, belief.u
        R, mask = self._noise(y, available, R, u)
        expected, anomalies = self._expected(belief)
        innovation = difference(y, expected, model.measurement_angles)
        none = self._no_columns
        reading = Reading(innovation, none, none, R, mask, bool(mask.all()), none, none, anomalies, R)
        return reading if reading.complete else reading.only(mask)

    def _condensed(
        self, start: EnsembleBelief, reading: Reading, S: np.ndarray, lost: np.ndarray
    ) -> tuple[Reading, np.ndarray] | None:
        # Mixed channels have no place in a localisation, which is about channels.
        return None if self.localisation is not None else super()._condensed(start, reading, S, lost)

    def _update(self, belief: EnsembleBelief, reading: Reading, rng: Rng) -> EnsembleBelief:
        numbers, Y = self._numbers(rng, belief.mean.shape[:-1]), reading.anomalies
        assert Y is not None
        S = self._covariance(Y) + reading.R
        ensemble = belief.ensemble - belief.mean[..., None, :]
        mean, ensemble = self._analysis(belief.mean, ensemble, Y, S, reading, numbers)
        if self.inflation != 1.0:
            ensemble *= self._inflation(reading.available)[..., None, :]
        ensemble += mean[..., None, :]
        return EnsembleBelief.updated(belief, mean, _LATER, reading, S, ensemble=ensemble)

    def _analysis(
        self, mean: np.ndarray, anomalies: np.ndarray, Y: np.ndarray, S: np.ndarray, reading: Reading, numbers: Drawn
    ) -> tuple[np.ndarray, np.ndarray]:
        """The mean ``(..., n)`` and the centred anomalies ``(..., N, n)`` after a reading; may write on the latter.

        ``Y (..., N, p)`` are the anomalies of the readings that the members expect.
        """
        raise NotImplementedError

    # --- chunks of rows, as the kernels take them -----------------------------------------------------

    def _room(self, rows: int) -> _Moments:
        """Moments of rows that are to be computed."""
        return np.empty((rows, self.model.n)), np.empty((rows, self.model.n, self.members))

    def _chunks(self, rows: int) -> Iterator[slice]:
        """Rows that are predicted and updated at a time; every chunk is independent of the others."""
        size = max(1, _CACHE // (8 * self.members * self.model.n))
        return (slice(first, min(first + size, rows)) for first in range(0, rows, size))

    def _words(self, rng: Rng, batch: tuple[int, ...], count: int, use: int) -> tuple[np.ndarray, ...]:
        """Keys ``(B, 2)`` and steps ``(B,)`` of all rows, and the normals ``(B, N, count)`` of a Generator."""
        numbers, rows = self._numbers(rng, batch), prod(batch)
        steps = np.zeros(batch, np.uint64)
        if isinstance(numbers, np.random.Generator):
            given = draw(numbers, batch, self.members, count, use).reshape(rows, self.members, count)
            return np.zeros((rows, 2), np.uint64), steps.reshape(rows), given
        steps[...] = numbers.step
        return _rows(numbers.keys, batch, 1), steps.reshape(rows), np.empty((0, 0, 0))

    def _at_members(self, name: str, members: np.ndarray, known: np.ndarray | None, size: int) -> np.ndarray:
        """The model's function of this name at members ``(b, n, N)``: ``(b, size, N)``."""
        values = at_points(name, getattr(self.model, name), members.mT, known, size)
        return np.ascontiguousarray(values.mT)

    def _prediction(
        self, belief: EnsembleBelief, u: np.ndarray | None, rng: Rng
    ) -> Callable[[slice, _Moments], None]:  # fmt: skip
        """What predicts rows, and writes their moments."""
        model, batch = self.model, belief.mean.shape[:-1]
        before, known = members_last(belief.ensemble), None if u is None else _rows(u, batch, 1)
        root = semidefinite_cholesky(resolve(model.Q, u)) if self._noise_root is None else self._noise_root
        roots, words = _rows(root, batch, 2), self._words(rng, batch, root.shape[-1], PROCESS)
        if isinstance(model, LinearModel):
            A, push = _rows(resolve(model.A, u), batch, 2), None
            if model.B is not None and u is not None:
                push = _rows(np.matvec(resolve(model.B, u), u), batch, 1)

        def predict(rows: slice, moments: _Moments) -> None:
            members = before[rows]
            if not isinstance(model, LinearModel):
                after = self._at_members("transition", members, None if known is None else known[rows], model.n)
            else:
                after = _of(A, rows) @ members
                if push is not None:
                    after += push[rows, :, None]
            forecast(members, after, self._wrapped, _of(roots, rows), *(a[rows] for a in words), *moments)

        return predict

    def _analysis_of(
        self, predicted: Callable[[slice], _Moments], belief: EnsembleBelief, u: np.ndarray | None, y: np.ndarray,
        rng: Rng, available: np.ndarray | None, R: np.ndarray | None,
    ) -> tuple[EnsembleBelief, np.ndarray]:  # fmt: skip
        """The belief after a reading, by kernels, and which of its rows ``(...)`` are lost.

        Args:
            predicted: Gives the moments of rows.
            belief: What else there is of them.
        """
        model, batch, p = self.model, belief.mean.shape[:-1], self.model.p
        whole, arrived = self._noise(y, available, R, u)
        known, C = None if u is None else _rows(u, batch, 1), getattr(model, "C", None)
        Cs = None if C is None else _rows(resolve(C, u), batch, 2)
        Rs = _rows(whole, batch, 2)
        mean, members = self._room(prod(batch))
        out = mean, members, np.empty((len(mean), p)), np.empty((len(mean), p, p)), np.empty(len(mean), bool)
        given = _rows(y, batch, 1), _rows(arrived, batch, 1), Rs
        analyse = self._analyser(whole, arrived, rng)
        for rows in self._chunks(len(mean)):
            before, own = predicted(rows)
            if Cs is None:
                readings = self._at_members("measurement", own, None if known is None else known[rows], p)
            else:
                readings = _of(Cs, rows) @ own
            analyse(rows, (own, readings, before, *(_of(a, rows) for a in given)), tuple(a[rows] for a in out))
        mean, innovation, S = (a.reshape(batch + a.shape[1:]) for a in (mean, out[2], out[3]))
        updated = EnsembleBelief(
            mean, _LATER, belief.prior_mean, belief.prior_cov, np.zeros(batch, np.int8), u, innovation, S, arrived,
            ensemble=_ensemble(members, mean),
        )  # fmt: skip
        return updated, out[4].reshape(batch)

    def _analyser(self, R: np.ndarray, arrived: np.ndarray, rng: Rng) -> "Analyser":
        """What a kernel makes of rows, their members and what was read of them ``(b, ...)``, written to the last.

        Args:
            R: ``(..., p, p)``.
            arrived: ``(..., p)``.
            rng: Where random numbers come from.
        """
        raise NotImplementedError

    # --- pieces -----------------------------------------------------------------------------------

    def _mean(self, ensemble: np.ndarray) -> np.ndarray:
        """The mean over the members of ``(..., N, k)``."""
        return np.vecmat(self._mean_weights, ensemble)

    def _covariance(self, anomalies: np.ndarray) -> np.ndarray:
        """``A' A / (N - 1)``."""
        return symmetrise(anomalies.mT @ anomalies) / (self.members - 1)

    def _expected(self, belief: EnsembleBelief) -> tuple[np.ndarray, np.ndarray]:
        """The mean ``(..., p)`` of the readings that the members expect, and their anomalies ``(..., N, p)``.

        A linear model's angles need no care: its readings are as unwrapped as its states. Others are taken about their
        circular mean.
        """
        model, u = self.model, belief.u
        if isinstance(model, LinearModel):
            C = resolve(model.C, u)
            expected = np.matvec(C, belief.mean)
            anomalies = product(belief.ensemble, C.mT)
            anomalies -= expected[..., None, :]
            return expected, anomalies
        readings = at_points("measurement", model.measurement, belief.ensemble, u, model.p)
        readings = np.array(readings, dtype=float)
        for i in model.measurement_angles:
            readings[..., i] = together(readings[..., i])
        expected = self._mean(readings)
        readings -= expected[..., None, :]
        return expected, readings

    def _inflation(self, available: np.ndarray) -> np.ndarray:
        """The factor on each component ``(..., n)``: none where no reading came that may correct it."""
        if self.localisation is None:
            corrected = available.any(-1, keepdims=True)
        else:
            corrected = np.matvec(self.localisation, available.astype(float)) > 0.0
        return np.where(corrected, self.inflation, 1.0)

    # --- random numbers ---------------------------------------------------------------------------

    def _numbers(self, rng: Rng, batch: tuple[int, ...]) -> Drawn:
        """``rng``, checked: a key for every row, or a Generator for all."""
        if isinstance(rng, np.random.Generator):
            return rng
        if not isinstance(rng, Numbers):
            how = "pass rng, keys (estimators.Numbers) or a numpy Generator"
            raise (ValueError if rng is None else TypeError)(
                f"{self.name} draws random numbers: {how}, got {shown(rng)}"
            )
        if rng.keys.shape[:-1] != batch:
            raise ValueError(f"rng has keys for rows {rng.keys.shape[:-1]}, expected {batch}")
        return rng

    def _centred_noise(self, numbers: Drawn, batch: tuple[int, ...], root: np.ndarray, use: int) -> np.ndarray:
        """``(..., N, k)`` draws with covariance ``root root'``, their mean over the members taken off."""
        normals = draw(numbers, batch, self.members, root.shape[-1], use)
        normals -= self._mean(normals)[..., None, :]
        return product(normals, root.mT)


class EnsembleKalmanFilter(EnsembleFilter):
    """EnKF: every member is corrected by its own perturbed reading.

    ``x_i = x_i- + K (y + v_i - h(x_i-))`` with ``v_i ~ N(0, R)`` centred to zero mean, and the gain with R exact::

        K = A' Y / (N - 1) (Y' Y / (N - 1) + R)^-1

    Sources: Burgers, van Leeuwen & Evensen (1998); Evensen (2003).

    Args:
        model: Any model; an unknown input in it is ignored.
        members: N, at least 2.
        inflation: Factor on the anomalies of every component that an update may correct; 1: none.
        localisation: ``(n, p)`` from 0 to 1, multiplies the gain: which reading may correct which component, and by
            how much of what the covariance says; None: every one, whole.
    """

    name = "enkf"

    def __init__(
        self, model: Model, members: int = 100, inflation: float = 1.0, localisation: np.ndarray | None = None
    ) -> None:
        super().__init__(model, members, inflation, localisation)
        self._reading_root = None if callable(model.R) else semidefinite_cholesky(model.R)
        taper = np.ones((model.n, model.p)) if self.localisation is None else self.localisation
        self._factors = np.ascontiguousarray(taper.T)

    def _root(self, R: np.ndarray, arrived: np.ndarray) -> np.ndarray:
        """A root ``(..., p, p)`` of R. The gain of a missing reading is zero, so that of the model's R will do."""
        if self._reading_root is not None and R is self.model.R:
            return self._reading_root
        return semidefinite_cholesky(neutralised(R, arrived))

    def _analyser(self, R: np.ndarray, arrived: np.ndarray, rng: Rng) -> Analyser:
        batch, options = arrived.shape[:-1], (self._angles, self._seams, self._factors, self.inflation)
        roots, words = _rows(self._root(R, arrived), batch, 2), self._words(rng, batch, self.model.p, READINGS)

        def analyse(rows: slice, given: tuple[np.ndarray, ...], out: tuple[np.ndarray, ...]) -> None:
            perturbed(*given, _of(roots, rows), *options, *(a[rows] for a in words), *out)

        return analyse

    def _analysis(
        self, mean: np.ndarray, anomalies: np.ndarray, Y: np.ndarray, S: np.ndarray, reading: Reading, numbers: Drawn
    ) -> tuple[np.ndarray, np.ndarray]:
        gain = solve(S, (Y.mT @ anomalies) / (self.members - 1))  # K', (..., p, n)
        if self.localisation is not None:
            gain *= self.localisation.T
        assert reading.whole_R is not None
        root = self._root(reading.whole_R, reading.available)
        departures = self._centred_noise(numbers, mean.shape[:-1], root, READINGS)
        departures -= Y
        anomalies += product(departures, gain)
        return mean + np.vecmat(reading.innovation, gain), anomalies


class EnsembleTransformFilter(EnsembleFilter):
    """ETKF: the members are transformed so that their covariance is the Kalman filter's, without random numbers.

    ``A <- T A`` with the symmetric, mean-preserving ``T = (I + Y R^-1 Y' / (N - 1))^-1/2``, computed as a reduced gain
    in p x p algebra: with ``S = L L'`` and ``L^-1 R L^-T = U diag(m) U'``, ``W = L^-T U``::

        K = (C P-)' W W'        K~ = (C P-)' W diag(1 / (1 + sqrt(m))) W'        A <- A - Y K~'

    which needs no inverse of R, loses no digits where a reading is precise, and is exact for any N.

    Sources: Bishop, Etherton & Majumdar (2001); Wang, Bishop & Julier (2004); the reduced gain of Whitaker & Hamill
    (2002) for readings taken together; rotations: Sakov & Oke (2008b); localisation: Hunt, Kostelich & Szunyogh (2007).

    Args:
        model: Any model; an unknown input in it is ignored.
        members: N, at least 2.
        inflation: Factor on the anomalies of every component that an update may correct; 1: none.
        localisation: ``(n, p)`` of 0 and 1: which reading may correct which component. Components with the same row
            form a group, and each group is transformed with its own readings; None: one group.
        rotate: Rotate the anomalies at random after each update, keeping their mean and covariance.
    """

    name = "etkf"

    def __init__(
        self,
        model: Model,
        members: int = 100,
        inflation: float = 1.0,
        localisation: np.ndarray | None = None,
        rotate: bool = False,
    ) -> None:
        super().__init__(model, members, inflation, localisation)
        if not isinstance(rotate, bool):
            raise ValueError(f"rotate must be True or False, got {shown(rotate)}")
        self.rotate = rotate
        mask = np.ones((model.n, model.p)) if self.localisation is None else self.localisation
        self._groups = _groups(mask)
        marks = (np.array([np.isin(np.arange(size), each[i]) for each in self._groups]) for i, size in enumerate(mask.shape))
        self._marks = tuple(marks)

    @property
    def _compiled(self) -> bool:
        return self._ours and not self.rotate

    def _analyser(self, R: np.ndarray, arrived: np.ndarray, rng: Rng) -> Analyser:
        self._numbers(rng, arrived.shape[:-1])
        options = self._angles, self._seams, *self._marks, self.inflation
        return lambda rows, given, out: transformed(*given, *options, *out)

    def _taper(self, localisation: np.ndarray) -> np.ndarray:
        mask = super()._taper(localisation)
        if not np.isin(mask, (0.0, 1.0)).all():
            raise ValueError(f"localisation of {self.name} must be 0 or 1 everywhere: a taper is for enkf")
        return mask

    def _analysis(
        self, mean: np.ndarray, anomalies: np.ndarray, Y: np.ndarray, S: np.ndarray, reading: Reading, numbers: Drawn
    ) -> tuple[np.ndarray, np.ndarray]:
        if self.localisation is None:
            mean, anomalies = self._transformed(mean, anomalies, Y, S, reading.R, reading.innovation)
        else:
            mean = np.array(mean)
            for states, readings in self._groups:
                block = (..., readings[:, None], readings)
                mean[..., states], anomalies[..., states] = self._transformed(
                    mean[..., states], anomalies[..., states], Y[..., readings], S[block],
                    reading.R[block], reading.innovation[..., readings],
                )  # fmt: skip
        if self.rotate:
            rank = min(self.members - 1, self.model.n)
            normals = draw(numbers, mean.shape[:-1], self.members - 1, rank, ROTATION)
            anomalies = rotated(anomalies, normals)
        return mean, anomalies

    def _transformed(
        self, mean: np.ndarray, anomalies: np.ndarray, Y: np.ndarray, S: np.ndarray, R: np.ndarray, e: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean ``(..., k)`` and anomalies ``(..., N, k)`` of some components, corrected by some readings."""
        factor = np.linalg.inv(cholesky(S))  # L^-1
        shares = product(factor, R) @ factor.mT  # of R in S, eigenvalues from 0 to 1
        lost = ~np.isfinite(shares).all((-2, -1))
        if lost.any():  # their NaN comes back with the factor
            shares[lost] = np.eye(S.shape[-1])
        m, U = np.linalg.eigh(shares)
        W = factor.mT @ U
        whitened = W.mT @ ((Y.mT @ anomalies) / (self.members - 1))  # W' C P-, (..., p, k)
        correction = np.vecmat(np.vecmat(e, W), whitened)
        whitened /= (1.0 + np.sqrt(np.maximum(m, 0.0)))[..., None]
        anomalies -= Y @ (W @ whitened)
        return mean + correction, anomalies


class EnsembleSquareRootFilter(EnsembleTransformFilter):
    """EnKF-SR: Evensen's square-root filter, by default in its symmetric, mean-preserving form.

    With ``C = Y' Y + (N - 1) R = Z L Z'`` and the singular value decomposition ``L^-1/2 Z' Y' = U s V'``, the anomalies
    (as columns) become ``A V sqrt(I - s's) V'``: the same transform as `etkf`, computed by the same code.
    ``variant="evensen2004"`` leaves out the last ``V'`` as published: the second moments are the same, but the mean of
    the members moves at random, by about a quarter of the spread at N = 10. It forms an N x N matrix, and is there to
    reproduce papers.

    Source: Evensen (2004); the mean is treated by Sakov & Oke (2008b) and Livings, Dance & Nichols (2008).

    Args:
        model: Any model; an unknown input in it is ignored.
        members: N, at least 2.
        inflation: Factor on the anomalies of every component that an update may correct; 1: none.
        localisation: ``(n, p)`` of 0 and 1, as in `EnsembleTransformFilter`.
        rotate: Rotate the anomalies at random after each update, keeping their mean and covariance.
        variant: "symmetric" or "evensen2004".
    """

    name = "enkf-sr"

    def __init__(
        self,
        model: Model,
        members: int = 100,
        inflation: float = 1.0,
        localisation: np.ndarray | None = None,
        rotate: bool = False,
        variant: str = "symmetric",
    ) -> None:
        super().__init__(model, members, inflation, localisation, rotate)
        if not isinstance(variant, str) or variant not in ("symmetric", "evensen2004"):
            raise ValueError(f"variant must be 'symmetric' or 'evensen2004', got {shown(variant)}")
        self.variant = variant

    @property
    def _compiled(self) -> bool:
        return super()._compiled and self.variant == "symmetric"

    def _transformed(
        self, mean: np.ndarray, anomalies: np.ndarray, Y: np.ndarray, S: np.ndarray, R: np.ndarray, e: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        if self.variant == "symmetric":
            return super()._transformed(mean, anomalies, Y, S, R, e)
        gain = solve(S, (Y.mT @ anomalies) / (self.members - 1))  # K'
        X = (np.linalg.inv(cholesky(S)) @ Y.mT) / np.sqrt(self.members - 1)  # (..., p, N)
        lost = ~np.isfinite(X).all((-2, -1))
        X[lost] = 0.0  # their NaN comes back with the gain
        _, s, Vt = np.linalg.svd(X)
        scale = np.ones(X.shape[:-2] + (self.members,))
        scale[..., : s.shape[-1]] = np.sqrt(np.maximum(1.0 - s**2, 0.0))
        anomalies = scale[..., None] * (Vt @ anomalies)
        shift = self._mean(anomalies)
        anomalies -= shift[..., None, :]
        return mean + np.vecmat(e, gain) + shift, anomalies


# --- shared -------------------------------------------------------------------------------------------


def draw(numbers: Drawn, batch: tuple[int, ...], members: int, count: int, use: int) -> np.ndarray:
    """Standard normals ``(*batch, members, count)``."""
    if isinstance(numbers, np.random.Generator):
        return numbers.standard_normal(batch + (members, count))
    return numbers.members(members, count, use)


def noise_root(cov: np.ndarray) -> np.ndarray:
    """``L (..., k, r)`` with ``L L' = cov`` and r the rank of ``cov (..., k, k)``: the largest one of a batch."""
    values, vectors = np.linalg.eigh(cov)
    values = np.where(values > 1e-14 * values.shape[-1] * values[..., -1:], values, 0.0)
    needed = values.any(tuple(range(values.ndim - 1)))
    return np.ascontiguousarray((vectors * np.sqrt(values)[..., None, :])[..., needed])


def rotated(anomalies: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Centred anomalies ``(..., N, n)`` turned by a uniformly random rotation of the members that keeps their mean.

    An N x N rotation moves ``A = V R`` (V orthonormal, R small) to ``V* R`` with V* uniform on the frames orthogonal to
    the vector of ones, so V* is drawn instead: O(N r^2) for rank r.

    Args:
        anomalies: With zero mean over the members.
        normals: Standard normals ``(..., N - 1, r)`` with r = min(N - 1, n).
    """
    frame, triangle = np.linalg.qr(normals)
    frame *= np.where(np.diagonal(triangle, axis1=-2, axis2=-1) < 0.0, -1.0, 1.0)[..., None, :]  # makes it uniform
    turned = np.zeros(anomalies.shape)
    turned[..., 1:, :] = frame @ np.linalg.qr(_reflected(anomalies)[..., 1:, :], mode="r")
    return _reflected(turned)


def _reflected(a: np.ndarray) -> np.ndarray:
    """``(..., N, k)`` mirrored so that the first unit vector and the normalised vector of ones change places."""
    members = a.shape[-2]
    normal = np.full(members, -1.0 / np.sqrt(members))
    normal[0] += 1.0
    return a - normal[:, None] * (np.vecmat(normal, a) * (2.0 / (normal @ normal)))[..., None, :]


def _groups(mask: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Components with the same row of ``(n, p)``, and the readings of that row; those without readings are left out."""
    rows, member_of = np.unique(mask, axis=0, return_inverse=True)
    return [(np.flatnonzero(member_of == i), np.flatnonzero(row)) for i, row in enumerate(rows) if row.any()]


def _rows(a: np.ndarray, batch: tuple[int, ...], core: int) -> np.ndarray:
    """An array ``(..., k)`` or ``(..., k, l)`` by rows of the batch ``(B, ...)``, or ``(1, ...)`` for all of them."""
    leading, own = a.shape[:-core], a.shape[-core:]
    if not leading:
        return np.ascontiguousarray(a)[None]
    if leading != batch:
        a = np.broadcast_to(a, batch + own)
    return np.ascontiguousarray(a).reshape(prod(batch), *own)


def _of(a: np.ndarray, rows: slice) -> np.ndarray:
    """That of some rows of what there is once for each of them, or for all."""
    return a if len(a) == 1 else a[rows]


def _ensemble(members: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Members ``(B, n, N)`` as a belief has them, ``(..., N, n)``."""
    return members.reshape(mean.shape + members.shape[-1:]).mT
