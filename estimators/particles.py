"""The bootstrap particle filter: weighted particles for beliefs that no mean and covariance describe.

Particles are rows, ``(..., N, n)``, and have log weights ``(..., N)``. A prediction moves them by
the model and its noise, a measurement weighs them by its density: so posteriors may have several
peaks, or be bent.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from estimators.angles import difference, short_way
from estimators.belief import Belief
from estimators.checks import AT_LEAST_0, UP_TO_1, integer, number, with_points
from estimators.ensemble import DrawingFilter, draw, noise_root
from estimators.filter import Model, Rng
from estimators.linalg import cholesky, semidefinite_cholesky, shared_root, symmetrise
from estimators.measurement import Measurement
from estimators.models import LinearModel, at_points
from estimators.randomness import RandomKeys
from estimators.varying import resolve

PARTICLES, DIFFUSION, RESAMPLING, JITTER = range(4, 8)
"""Uses of random numbers, beside those of the ensembles."""
_NOWHERE = -1e300
"""Log weight of a particle that cannot be: finite, and 0 as a weight."""
_ABSURD = 38.6**2
"""Squared standard deviations at which a normal density is 0 in double precision."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ParticleBelief(Belief):
    """The belief of a filter that carries weighted particles; mean and covariance are theirs, weighted.

    Attributes:
        particles: ``(..., N, n)`` as rows.
        log_weights: ``(..., N)`` whose exponentials sum to 1; about -1e300: such a particle cannot
            be.
        log_likelihood: ``(...)`` log density of the last measurement, given those before it; 0
            where none came.
    """

    particles: np.ndarray
    log_weights: np.ndarray
    log_likelihood: np.ndarray
    __new__ = with_points("particles")

    def replace(self, **changes: Any) -> Self:
        """This belief with some fields changed; another mean moves the particles."""
        return Belief.replace(self, **(self._moved("particles", changes) | changes))

    @property
    def effective_size(self) -> np.ndarray:
        """``(...)`` from 1 to N: how many particles of equal weight would be worth as much (Kong, Liu & Wong 1994)."""
        return 1.0 / np.square(np.exp(self.log_weights)).sum(-1)


class ParticleFilter(DrawingFilter[ParticleBelief], verified=True):
    """The bootstrap filter: predicted by sampling, weighed by the density of the measurement, resampled when few count.

    ``x_i ~ p(x | x_i-)``, ``w_i ~ w_i- N(y; h(x_i), R)``, and where ``1 / sum w_i^2`` falls below a
    share of N, the next prediction begins with a systematic resampling: particle i is copied ``N
    w_i`` times, rounded to either side so that it is so in expectation. The log-likelihood that the
    belief records is ``log sum w_i- N(y; h(x_i), R)``; the exponential of its sum over a series is
    unbiased without jitter.

    A channel that no particle explains (its density is 0 to all digits for each of them, and it
    lies as far outside of what they expect together) is left out: it would leave one particle of
    them all.

    State angles are averaged on the circle.

    Sources: Gordon, Salmond & Smith (1993); Kitagawa (1996), systematic resampling; Arulampalam,
    Maskell, Gordon & Clapp (2002), algorithm 4; jitter: Musso, Oudjane & Le Gland (2001).

    Args:
        model: Any model with noise in every measurement; an unknown input in it is ignored.
        particles: N, at least 2.
        threshold: Share of N, from 0 to 1, below which the effective size brings a resampling.
        jitter: How far copies beyond the first of a particle are moved apart, in bandwidths ``N^(-1
            / (n + 4))`` of the belief's covariance: where process noise would leave them together.
            0: not at all.

    Raises:
        ValueError: if R is singular: no particle meets a measurement without noise.
    """

    name = "pf"
    record = ParticleBelief
    # particles are weighed by the channels as they are: where R is singular the measurement is left out
    mixes = False

    def __init__(
        self, model: Model, particles: int = 1000, threshold: float = 0.5, jitter: float = 0.0
    ) -> None:
        super().__init__(model)
        self.particles = integer("particles", particles, 2)
        self.threshold = number("threshold", threshold, AT_LEAST_0, UP_TO_1, "a share from 0 to 1")
        self.jitter = number("jitter", jitter, AT_LEAST_0, np.inf, "a number of at least 0")
        if self._regular is False:
            raise ValueError(
                "pf needs noise in every measurement, but R is singular: give it a little, or use"
                " etkf"
            )
        self._noise_root = None if callable(model.Q) else noise_root(model.Q)

    def _init(self, belief: Belief, rng: Rng) -> ParticleBelief:
        batch = belief.mean.shape[:-1]
        normals = draw(self._numbers(rng, batch), batch, self.particles, self.model.n, PARTICLES)
        particles = belief.mean[..., None, :] + normals @ shared_root(belief.cov).mT
        return self._believed(belief, particles, self._even(batch), belief.u)

    def _predict(self, belief: ParticleBelief, u: np.ndarray | None, rng: Rng) -> ParticleBelief:
        model, batch = self.model, belief.mean.shape[:-1]
        numbers = self._numbers(rng, batch)
        before, log_weights = self._resampled(belief, numbers)
        if isinstance(model, LinearModel):
            after = before @ resolve(model.A, u).mT
            if model.B is not None and u is not None:
                after += np.matvec(resolve(model.B, u), u)[..., None, :]
        else:
            after = np.array(at_points("transition", model.transition, before, u, model.n))
            for i in (
                model.state_angles
            ):  # which it may wrap: over one step all turn by nearly as much as the first
                turn = after[..., i] - before[..., i]
                after[..., i] = before[..., i] + turn[..., :1] + short_way(turn - turn[..., :1])
        root = (
            semidefinite_cholesky(resolve(model.Q, u))
            if self._noise_root is None
            else self._noise_root
        )
        after += draw(numbers, batch, self.particles, root.shape[-1], DIFFUSION) @ root.mT
        gone = ~np.isfinite(after).all(-1)
        gone &= ~gone.all(-1, keepdims=True)  # a prediction of which nothing is left is lost
        after = np.where(gone[..., None], before, after)
        log_weights = _normalised(np.where(gone, _NOWHERE, log_weights))[0]
        return self._believed(belief, after, log_weights, u)

    def _update(self, belief: ParticleBelief, measurement: Measurement, rng: Rng) -> ParticleBelief:
        self._numbers(rng, belief.mean.shape[:-1])
        assert measurement.anomalies is not None
        off = difference(
            measurement.innovation[..., None, :],
            measurement.anomalies,
            self.model.measurement_angles,
        )
        root = cholesky(measurement.R)
        distance = np.square(off @ np.linalg.inv(root).mT).sum(-1)
        log_weights, log_density = _normalised(belief.log_weights - 0.5 * distance)
        size = np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(-1)
        arrived = measurement.available.sum(-1)
        log_likelihood = np.where(
            arrived, log_density - size - 0.5 * np.log(2.0 * np.pi) * arrived, 0.0
        )
        mean, cov = _moments(np.exp(log_weights), belief.particles, self.model.state_angles)
        spread = np.where(np.isfinite(measurement.anomalies), measurement.anomalies, 0.0)
        S = symmetrise((spread * np.exp(belief.log_weights)[..., None]).mT @ spread) + measurement.R
        return ParticleBelief.updated(
            belief, mean, cov, measurement, S,
            particles=belief.particles, log_weights=log_weights, log_likelihood=log_likelihood,
        )  # fmt: skip

    def _measurement(
        self,
        belief: ParticleBelief,
        y: np.ndarray,
        available: np.ndarray | None,
        R: np.ndarray | None,
    ) -> Measurement:
        """A channel that cannot be used has no finite innovation: the ladder of recoveries leaves it out."""
        model, u, weights = self.model, belief.u, np.exp(belief.log_weights)
        if isinstance(model, LinearModel):
            expected = belief.particles @ resolve(model.C, u).mT
        else:
            expected = at_points("measurement", model.measurement, belief.particles, u, model.p)
        finite = np.isfinite(expected)
        shares = weights[..., None] * finite
        mean, anomalies = _about(
            shares / shares.sum(-2, keepdims=True), expected, model.measurement_angles
        )
        R, mask = self._noise(y, available, R, u)
        innovation, variance = (
            difference(y, mean, model.measurement_angles),
            np.diagonal(R, axis1=-2, axis2=-1),
        )
        off = np.square(difference(innovation[..., None, :], anomalies, model.measurement_angles))
        nearest = np.where(finite, off, np.inf).min(-2) / variance
        outside = np.square(innovation) / (
            (shares * np.square(np.where(finite, anomalies, 0.0))).sum(-2) + variance
        )
        usable = (variance > 0.0) & ((nearest < _ABSURD) | (outside < _ABSURD))
        innovation = np.where(usable, innovation, np.nan)
        none, anomalies = self._no_columns, np.where(finite, anomalies, np.nan)
        measurement = Measurement(innovation, none, none, R, mask, bool(mask.all()), anomalies)
        return measurement if measurement.complete else measurement.only(mask)

    # --- pieces -----------------------------------------------------------------------------------

    def _even(self, batch: tuple[int, ...]) -> np.ndarray:
        return np.full(batch + (self.particles,), -np.log(self.particles))

    def _believed(
        self, before: Belief, particles: np.ndarray, log_weights: np.ndarray, u: np.ndarray | None
    ) -> ParticleBelief:
        """Particles before a measurement."""
        mean, cov = _moments(np.exp(log_weights), particles, self.model.state_angles)
        return ParticleBelief.predicted(
            before, mean, cov, u,
            particles=particles, log_weights=log_weights, log_likelihood=np.zeros(mean.shape[:-1]),
        )  # fmt: skip

    def _resampled(
        self, belief: ParticleBelief, numbers: RandomKeys | np.random.Generator
    ) -> tuple[np.ndarray, ...]:
        """Particles, and log weights, of which enough count."""
        batch, N, n = belief.mean.shape[:-1], self.particles, self.model.n
        few = belief.effective_size < self.threshold * N
        offset = (
            numbers.uniforms(1, RESAMPLING)[..., 0]
            if isinstance(numbers, RandomKeys)
            else numbers.random(batch)
        )
        if not few.any():
            return belief.particles, belief.log_weights
        chosen = np.where(
            few[..., None], systematic(np.exp(belief.log_weights), offset), np.arange(N)
        )
        particles = np.take_along_axis(belief.particles, chosen[..., None], -2)
        if self.jitter:
            copies = np.diff(chosen, axis=-1, prepend=-1) == 0
            root = self.jitter * N ** (-1.0 / (n + 4)) * semidefinite_cholesky(belief.cov)
            particles += copies[..., None] * (draw(numbers, batch, N, n, JITTER) @ root.mT)
        return particles, np.where(few[..., None], self._even(batch), belief.log_weights)


def systematic(weights: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Indices ``(..., N)`` of the particles that a systematic resampling keeps: one for each ``(j + offset) / N``.

    Particle i is chosen ``N w_i`` times, rounded to either side, and so in expectation over the
    offset.

    Args:
        weights: ``(..., N)``, which sum to 1 but for rounding.
        offset: ``(...)`` uniform from 0 to below 1.

    Source: Kitagawa (1996), appendix.
    """
    N = weights.shape[-1]
    reached = np.cumsum(weights, -1)
    ends = np.ceil(
        N * (reached / reached[..., -1:]) - offset[..., None]
    )  # how many lie below each one's end
    ends[..., -1] = N  # all, however near to 1 the offset is
    counts = np.diff(ends.astype(np.intp), axis=-1, prepend=0)
    return np.repeat(np.broadcast_to(np.arange(N), counts.shape).ravel(), counts.ravel()).reshape(
        counts.shape
    )


def _normalised(log_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log weights ``(..., N)`` whose exponentials sum to 1, and the log ``(...)`` of what these summed to.

    One that is not a number cannot be; where none can, nothing is one.
    """
    log_weights = np.fmax(log_weights, _NOWHERE)
    top = log_weights.max(-1)
    total = np.log(np.exp(log_weights - top[..., None]).sum(-1)) + top
    total = np.where(top > _NOWHERE, total, np.nan)
    return np.maximum(log_weights - total[..., None], _NOWHERE), total


def _about(
    weights: np.ndarray, points: np.ndarray, angles: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """The weighted mean ``(..., k)`` of points ``(..., N, k)``, on the circle for ``angles``, and the points about it.

    Weights are ``(..., N, k)``, or ``(..., N, 1)`` for all components; points of weight 0 may be
    anything.
    """
    weights = np.broadcast_to(weights, points.shape)
    counted = np.where(weights > 0.0, points, 0.0)
    mean = (weights * counted).sum(-2)
    for i in angles:
        share, turned = weights[..., i], counted[..., i] - mean[..., i, None]
        centre = np.arctan2((share * np.sin(turned)).sum(-1), (share * np.cos(turned)).sum(-1))
        mean[..., i] += centre + (share * short_way(turned - centre[..., None])).sum(-1)
    away = points - mean[..., None, :]
    for i in angles:
        away[..., i] = short_way(away[..., i])
    return mean, away


def _moments(
    weights: np.ndarray, particles: np.ndarray, angles: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """The weighted mean ``(..., n)`` and covariance ``(..., n, n)`` of particles ``(..., N, n)``."""
    mean, away = _about(weights[..., None], particles, angles)
    return mean, symmetrise((weights[..., None] * away).mT @ away)
