"""Several models of one system, of which now one holds, now another."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from estimators.angles import difference
from estimators.belief import Belief
from estimators.checks import as_array, frozen, short_repr, with_points
from estimators.filter import Filter, Rng
from estimators.linalg import identity, lacks_rank, log_density, masked
from estimators.measurement import Measurement


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MixtureBelief(Belief):
    """The belief of a filter with several modes; ``mean`` and ``cov`` are those of the mixture.

    Attributes:
        means: ``(..., M, n)`` estimate of each mode.
        covs: ``(..., M, n, n)`` its covariance.
        probabilities: ``(..., M)`` how probable it is that the mode holds, which sum to 1.
        log_likelihood: ``(...)`` log density of the last measurement, given those before it; 0 where none came.
    """

    means: np.ndarray
    covs: np.ndarray
    probabilities: np.ndarray
    log_likelihood: np.ndarray
    __new__ = with_points("means")

    def replace(self, **changes: Any) -> Self:
        """This belief with some fields changed; another mean moves those of all modes."""
        return Belief.replace(self, **(self._moved("means", changes) | changes))


class InteractingMultipleModels(Filter[MixtureBelief], verified=True):
    """IMM: a filter for each mode of a system that switches between them as a Markov chain.

    Before each prediction every filter begins from the mixture of all, as the chain could have come to its mode. With
    ``T`` the chain's transition, ``p`` the probabilities and ``L_j`` the density of the measurement in mode j::

        c_j = sum_i T_ij p_i            mixture for j: weights T_ij p_i / c_j
        p_j = c_j L_j / sum_i c_i L_i   mean and cov: those of the mixture with weights p_j

    A mixture is replaced by the Gaussian of its mean and covariance; means of angles are taken the short way round the
    likeliest mode. A mode climbs down the ladder of recovery by itself, and its probability is 0 at a measurement of
    which it could use less than others; if no mode can tell anything of the measurement, or one is sure of a
    combination of measurements (S is singular, so that densities do not compare), probabilities stay.

    Sources: Blom & Bar-Shalom (1988), The interacting multiple model algorithm for systems with Markovian switching
    coefficients; Bar-Shalom, Li & Kirubarajan (2001), Estimation with Applications to Tracking and Navigation, sec.
    11.6.

    Args:
        filters: One for each mode, of the same numbers of states and measurements and with the same angles, whose
            belief is a mean and a covariance: `kf`, `ekf`, `iekf`, `ukf`, `huber-kf`, `robust-kf`, or your own.
        transition: ``(M, M)`` probability that mode i (row) is followed by mode j.
        probabilities: ``(M,)`` those of the modes at the start; None: equal.

    Raises:
        TypeError: for a filter that is none, or that has another kind of belief.
        ValueError: if the filters do not fit each other, or the probabilities are none.
    """

    name = "imm"
    record = MixtureBelief

    def __init__(
        self, filters: Sequence[Filter], transition: np.ndarray, probabilities: np.ndarray | None = None
    ) -> None:
        self.filters = tuple(filters) if isinstance(filters, Iterable) else (filters,)
        for filter in self.filters:
            if not isinstance(filter, Filter) or filter.record is not Belief:
                raise TypeError(
                    f"every mode needs a filter whose belief is a mean and a covariance, got {short_repr(filter)}"
                )
        if not self.filters:
            raise ValueError("filters must be one for each mode, got none")
        super().__init__(self.filters[0].model)
        sizes = [(f.model.n, f.model.p, f.model.state_angles, f.model.measurement_angles) for f in self.filters]
        for j, size in enumerate(sizes):
            if size != sizes[0]:
                raise ValueError(
                    f"filters must have the same states, measurements and angles: mode 0 has (n, p, state_angles, "
                    f"measurement_angles) = {sizes[0]}, mode {j} {size}"
                )
        self._alike = all(filter._alike for filter in self.filters)
        self.random = any(filter.random for filter in self.filters)  # type: ignore[misc]
        self.sequential = all(filter.sequential for filter in self.filters)
        M = len(self.filters)
        self.transition = _probabilities("transition", transition, (M, M))
        start = np.full(M, 1.0 / M) if probabilities is None else probabilities
        self.probabilities = _probabilities("probabilities", start, (M,))

    def _check_known_input(self, u: np.ndarray | None) -> None:
        for filter in self.filters:
            filter._check_known_input(u)

    def _init(self, belief: Belief, rng: Rng) -> MixtureBelief:
        batch = belief.mean.shape[:-1]
        probabilities = np.broadcast_to(self.probabilities, batch + self.probabilities.shape)
        return self._together(belief, [filter._init(belief, rng) for filter in self.filters], probabilities)

    def _predict(self, belief: MixtureBelief, u: np.ndarray | None, rng: Rng) -> MixtureBelief:
        alive = np.isfinite(belief.means).all(-1) & np.isfinite(belief.covs).all((-2, -1))
        came = np.where(alive, belief.probabilities, 0.0)[..., None] * self.transition  # (..., i, j)
        ahead = came.sum(-2)
        possible = ahead[..., None, :] > 0.0
        shares = np.where(possible, came / np.where(possible, ahead[..., None, :], 1.0), identity(len(self.filters)))
        modes = []
        for j, filter in enumerate(self.filters):
            mean, cov = matched(shares[..., j], belief.means, belief.covs, self.model.state_angles)
            modes.append(filter.forecast(self._mode(belief, mean, cov), u, rng))
        total = ahead.sum(-1, keepdims=True)
        ahead = np.where(total > 0.0, ahead / np.where(total > 0.0, total, 1.0), belief.probabilities)
        return self._together(belief.replace(u=u), modes, ahead)

    def correct(
        self, belief: MixtureBelief, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None, rng: Rng
    ) -> MixtureBelief:
        """The belief after a measurement, of which every mode has its own innovation."""
        modes = []
        for j, filter in enumerate(self.filters):
            mode = self._mode(belief, belief.means[..., j, :], belief.covs[..., j, :, :])
            modes.append(filter.correct(mode, y, available, R, rng))
        used = np.stack([mode.available for mode in modes], -2)  # (..., M, p)
        innovations = np.stack([mode.innovation for mode in modes], -2)
        spreads = np.stack([mode.innovation_cov for mode in modes], -3)
        with np.errstate(all="ignore"):
            density = log_density(innovations, spreads, used)
            counts = used.sum(-1)
            fair = np.isfinite(density) & (counts == counts.max(-1, keepdims=True))
            compared = ~(lacks_rank(spreads) & fair).any(-1, keepdims=True)  # of fewer directions it is another density
            weights = np.where(fair, np.log(belief.probabilities) + density, -np.inf)
            top = weights.max(-1, keepdims=True)
            comparable = np.isfinite(top) & compared
            shares = np.exp(weights - np.where(comparable, top, 0.0))
            total = shares.sum(-1, keepdims=True)
            probabilities = np.where(comparable, shares / total, belief.probabilities)
            seen = np.asarray(used.any(-2))
            likelihood = np.where(comparable[..., 0] & seen.any(-1), (top + np.log(total))[..., 0], 0.0)
            before = np.where(comparable & ~fair, 0.0, belief.probabilities)
            before = before / before.sum(-1, keepdims=True)
            innovation, S = matched(before, innovations, spreads, self.model.measurement_angles)
            return self._together(
                belief, modes, probabilities, recovery=np.min([mode.recovery for mode in modes], 0),
                innovation=innovation, innovation_cov=masked(S, seen), available=seen, log_likelihood=likelihood,
            )  # fmt: skip

    def _update(self, belief: MixtureBelief, measurement: Measurement, rng: Rng) -> MixtureBelief:
        raise TypeError("each mode makes a measurement of its own: call update")

    def _mode(self, belief: MixtureBelief, mean: np.ndarray, cov: np.ndarray) -> Belief:
        return Belief(mean, cov, belief.prior_mean, belief.prior_cov, belief.recovery, belief.u)

    def _together(
        self, belief: Belief, modes: list[Belief], probabilities: np.ndarray, **others: np.ndarray
    ) -> MixtureBelief:
        """The mixture of what the modes believe, and what else the belief says."""
        means, covs = np.stack([mode.mean for mode in modes], -2), np.stack([mode.cov for mode in modes], -3)
        mean, cov = matched(probabilities, means, covs, self.model.state_angles)
        own = {"recovery": belief.recovery, "log_likelihood": np.zeros(mean.shape[:-1])} | others
        return MixtureBelief(
            mean, cov, belief.prior_mean, belief.prior_cov, u=belief.u, means=means, covs=covs,
            probabilities=probabilities, **own,
        )  # fmt: skip


def matched(
    weights: np.ndarray, means: np.ndarray, covs: np.ndarray, angles: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean ``(..., k)`` and covariance ``(..., k, k)`` of a mixture of Gaussians.

    Args:
        weights: ``(..., M)`` that sum to 1; what has none does not matter.
        means: ``(..., M, k)``.
        covs: ``(..., M, k, k)``.
        angles: Components that are averaged the short way round the mean with the greatest weight.

    Those of the greatest weight alone, where others are too far for the moments to be numbers.
    """
    some = (weights > 0.0)[..., None]
    centre = np.take_along_axis(means, weights.argmax(-1)[..., None, None], -2)
    away = np.where(some, difference(means, centre, angles), 0.0)
    shift = np.vecmat(weights, away)
    spread = away - shift[..., None, :]
    each = np.where(some[..., None], covs + spread[..., :, None] * spread[..., None, :], 0.0)
    mean, cov = centre[..., 0, :] + shift, (weights[..., None, None] * each).sum(-3)
    apart = ~(np.isfinite(mean).all(-1) & np.isfinite(cov).all((-2, -1)))  # beyond all numbers
    own = np.take_along_axis(covs, weights.argmax(-1)[..., None, None, None], -3)[..., 0, :, :]
    return np.where(apart[..., None], centre[..., 0, :], mean), np.where(apart[..., None, None], own, cov)


def _probabilities(name: str, value: object, shape: tuple[int, ...]) -> np.ndarray:
    """``value`` as an array of this shape whose last axis sums to 1."""
    array = as_array(name, value)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}: one for each mode")
    if not ((array >= 0.0).all() and np.allclose(array.sum(-1), 1.0, rtol=0, atol=1e-9)):
        raise ValueError(f"{name} must be probabilities, not negative and with a sum of 1 in each row")
    return frozen(array / array.sum(-1, keepdims=True))
