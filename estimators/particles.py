"""The bootstrap particle filter: weighted particles for beliefs that are not Gaussian.

Particles are rows, ``(..., N, n)``, and have log weights ``(..., N)``. A prediction moves them by
the model and its noise; a measurement weights them by its density. So a posterior may have several
peaks, or be curved.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from estimators.angles import difference, short_way
from estimators.belief import Belief, changes_of_points
from estimators.checks import AT_LEAST_0, UP_TO_1, integer, number
from estimators.ensemble import draw, noise_root, process_root
from estimators.filter import Changes, Data, Filter, Model
from estimators.linalg import (
    cholesky,
    diagonal,
    masked,
    semidefinite_cholesky,
    shared_root,
    symmetrise,
)
from estimators.metrics import nis
from estimators.models import at_points
from estimators.randomness import RandomKeys

PARTICLES, DIFFUSION, RESAMPLING, JITTER = range(4, 8)
"""Uses of random numbers, beside those of the ensembles."""
_NOWHERE = -1e300
"""Log weight of an impossible particle: finite, with a weight of 0."""
_FARTHEST = 1e300
"""Largest squared distance of a particle from a measurement, in variances of the latter."""
_UNDERFLOW = np.log(5e-324)
"""Log density at which the density itself is 0 in double precision."""
_FAR = 6.0
"""Length of a whitened innovation, beyond that of p - 1 channels, that no particles explain."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ParticleBelief(Belief):
    """The belief of a particle filter; its mean and covariance are weighted moments.

    Attributes:
        particles: ``(..., N, n)`` as rows.
        log_weights: ``(..., N)`` logarithms of weights that sum to 1; about -1e300 marks an
            impossible particle.
        log_likelihood: ``(...)`` log density of the last measurement, given those before it; 0
            where none came.
    """

    particles: np.ndarray
    log_weights: np.ndarray
    log_likelihood: np.ndarray

    @property
    def effective_size(self) -> np.ndarray:
        """Effective number of particles ``(...)``, from 1 to N, the latter for equal weights.

        Source: Kong, Liu & Wong (1994), J. Am. Statist. Assoc. 89.
        """
        return 1.0 / np.square(np.exp(self.log_weights)).sum(-1)

    def replace(self, **changes: Any) -> Self:
        """The belief with some fields changed; another mean moves the particles.

        Raises:
            TypeError: for a field that the belief does not have.
            ValueError: if the covariance is given without particles.
        """
        return Belief.replace(self, **changes_of_points(self, changes, "particles", -2))


class ParticleFilter(Filter[ParticleBelief]):
    """Bootstrap particle filter: resamples when few particles carry most of the weight.

    ``x_i ~ p(x | x_i-)``, ``w_i ~ w_i- N(y; h(x_i), R)``. Where the effective size ``1 / sum
    w_i^2`` falls below a share of N, the next prediction begins with a systematic resampling:
    particle i is copied ``N w_i`` times in expectation, rounded up or down at random. The belief
    records the log-likelihood ``log sum w_i- N(y; h(x_i), R)``. Without jitter, the exponential of
    its sum over a series is an unbiased estimate of the likelihood.

    Weights are logarithms, so a measurement far from every particle has its tiny density, and the
    nearest particle gets all weight. ``healthy`` is False where the particles do not explain what
    is measured: relative to its peak the density underflows to 0 in double precision, and the
    innovation of p channels is longer than ``6 + sqrt(p - 1)`` standard deviations, so more
    particles would not help. It is also False where a measurement has to be left out, because no
    particle expects a finite one or its variance is 0.

    State angles are averaged on the circle.

    Sources: Gordon, Salmond & Smith (1993), IEE Proc. F 140; Kitagawa (1996), J. Comput. Graph.
    Statist. 5, for systematic resampling; Arulampalam, Maskell, Gordon & Clapp (2002), algorithm 4;
    Musso, Oudjane & Le Gland (2001), in Sequential Monte Carlo Methods in Practice, for jitter.

    Args:
        model: Any model with noise in every measurement; an unknown input in it is ignored.
        particles: N, at least 2.
        threshold: Share of N, from 0 to 1, below which the effective size brings a resampling.
        jitter: Standard deviation of the noise that moves copies of a particle apart, in bandwidths
            ``N^(-1 / (n + 4))`` of the belief's covariance. It is needed where process noise does
            not move them apart; 0 adds none.

    Raises:
        ValueError: if R is singular: no particle fits a measurement without noise.
    """

    name = "pf"
    record = ParticleBelief
    random = True

    def __init__(
        self, model: Model, particles: int = 1000, threshold: float = 0.5, jitter: float = 0.0
    ) -> None:
        super().__init__(model)
        self.particles = integer("particles", particles, 2)
        self.threshold = number("threshold", threshold, AT_LEAST_0, UP_TO_1, "a share from 0 to 1")
        self.jitter = number("jitter", jitter, AT_LEAST_0, what="a number of at least 0")
        if self._exact_channels:
            raise ValueError(
                "pf needs noise in every measurement, but R is singular: give it a little, or use"
                " etkf"
            )
        self._noise_root = noise_root(model.Q)

    def _begin(self, mean: np.ndarray, cov: np.ndarray, rng: Any) -> Changes:
        normals = draw(rng, mean.shape[:-1], self.particles, self.model.n, PARTICLES)
        particles = mean[..., None, :] + (shared_root(cov) @ normals).mT
        even = np.full(particles.shape[:-1], -np.log(self.particles))
        return self._believed(particles, even)

    def propagate(self, belief: Any, u: np.ndarray | None) -> tuple[Any, ...]:
        """Root ``(..., n, r)`` of the process noise; particles themselves move in `predict`."""
        return (process_root(self, belief, u),)

    def expect(self, belief: Any, u: np.ndarray | None, R: Any = None) -> tuple[Any, ...]:
        """Weighted mean ``(..., p)`` and deviations ``(..., p, N)`` of measurements, and R."""
        model, weights = self.model, np.exp(belief.log_weights)
        expected = at_points(model, "measurement", belief.particles, u)
        shares = weights[..., None] * np.isfinite(expected)
        shares = shares / shares.sum(-2, keepdims=True)
        mean, anomalies = _about(shares, expected, model.measurement_angles)
        return mean, anomalies.mT, self._noise(belief, u, R)

    def _predict(self, belief: Any, u: Any, *moved: Any) -> Changes:
        (root, rng), model, batch = moved, self.model, belief.mean.shape[:-1]
        before, log_weights = self._resampled(belief, rng)
        after = np.array(at_points(model, "transition", before, u))
        after += (root @ draw(rng, batch, self.particles, root.shape[-1], DIFFUSION)).mT
        gone = ~np.isfinite(after).all(-1)
        after = np.where(gone[..., None], before, after)
        return self._believed(after, _normalised(np.where(gone, _NOWHERE, log_weights))[0])

    def _update(
        self, belief: Any, u: Any, e: Any, Y: Any, R: Any, available: Any, *_: Any
    ) -> Changes:
        angles, weights = self.model.measurement_angles, np.exp(belief.log_weights)
        off = difference(e[..., None, :], Y.mT, angles)
        spread, variance = np.where(np.isfinite(Y), Y, 0.0), diagonal(R)
        S = symmetrise((spread * weights[..., None, :]) @ spread.mT) + R
        available = available & np.isfinite(off).any(-2) & (variance > 0.0)
        root = cholesky(masked(R, available))
        off = np.where(available[..., None, :], off, 0.0)
        distance = np.minimum(np.square(off @ np.linalg.inv(root).mT).sum(-1), _FARTHEST)
        nearest = np.fmin.reduce(distance, -1)
        farther = distance - nearest[..., None]
        log_weights, density = _normalised(belief.log_weights - 0.5 * farther)
        density = density - 0.5 * nearest - np.log(diagonal(root)).sum(-1)
        arrived = available.sum(-1)
        density -= 0.5 * np.log(2.0 * np.pi) * arrived
        return self._believed(belief.particles, log_weights) | {
            "innovation": np.where(available, e, 0.0),
            "innovation_cov": masked(S, available),
            "available": available,
            "log_likelihood": np.where(arrived, density, 0.0),
        }

    def log_likelihood(self, predicted: Any, updated: Any) -> np.ndarray:
        """The log density ``(...)`` of a measurement, as the belief records it."""
        return updated.log_likelihood

    def _run(self, step: str, belief: Any, data: Data) -> Any:
        """The belief after a step, not healthy where the particles do not explain a measurement."""
        after, (u, y, available, R, _) = super()._run(step, belief, data), data
        if step == "predict":
            return after
        R, used = self._noise(belief, u, R), after.available
        arrived = available & np.isfinite(y) & np.isfinite(diagonal(R))
        number, sizes = used.sum(-1), np.linalg.slogdet(masked(R, used))[1]
        peak = -0.5 * (sizes + number * np.log(2.0 * np.pi))
        with np.errstate(all="ignore"):
            length = np.sqrt(nis(after.innovation, after.innovation_cov))
        far = length > _FAR + np.sqrt(np.maximum(number - 1.0, 0.0))
        unexplained = far & (after.log_likelihood - peak < _UNDERFLOW)
        healthy = after.healthy & ~unexplained & ~(arrived & ~used).any(-1)
        return after.replaced({"healthy": healthy}).read_only()

    # --- pieces -----------------------------------------------------------------------------------

    def _believed(self, particles: np.ndarray, log_weights: np.ndarray) -> Changes:
        """Arrays of a belief from particles and their weights, before a measurement."""
        weights = np.exp(log_weights)[..., None]
        mean, away = _about(weights, particles, self.model.state_angles)
        moments = {"mean": mean, "cov": symmetrise((weights * away).mT @ away)}
        weighted = {"particles": particles, "log_weights": log_weights}
        return moments | weighted | {"log_likelihood": np.zeros(mean.shape[:-1])}

    def _resampled(self, belief: Any, rng: Any) -> tuple[np.ndarray, np.ndarray]:
        """Particles and log weights, resampled where too few particles count."""
        batch, N, n = belief.mean.shape[:-1], self.particles, self.model.n
        few = belief.effective_size < self.threshold * N
        keyed = isinstance(rng, RandomKeys)
        offset = rng.uniforms(1, RESAMPLING)[..., 0] if keyed else rng.random(batch)
        if not few.any():
            return belief.particles, belief.log_weights
        kept = systematic(np.exp(belief.log_weights), offset)
        chosen = np.where(few[..., None], kept, np.arange(N))
        particles = np.take_along_axis(belief.particles, chosen[..., None], -2)
        if self.jitter:
            copies = np.diff(chosen, axis=-1, prepend=-1) == 0
            root = self.jitter * N ** (-1.0 / (n + 4)) * semidefinite_cholesky(belief.cov)
            particles += copies[..., None] * (root @ draw(rng, batch, N, n, JITTER)).mT
        return particles, np.where(few[..., None], -np.log(N), belief.log_weights)


def systematic(weights: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Indices ``(..., N)`` of the particles that a systematic resampling keeps.

    Particle i is chosen ``N w_i`` times in expectation over the offset, rounded up or down.

    Args:
        weights: ``(..., N)``, which sum to 1 but for rounding.
        offset: ``(...)`` uniform from 0 to below 1.

    Source: Kitagawa (1996), appendix.
    """
    N = weights.shape[-1]
    reached = np.cumsum(weights, -1)
    # Number of chosen particles up to each particle
    ends = np.ceil(N * (reached / reached[..., -1:]) - offset[..., None])
    ends[..., -1] = N  # all, however near to 1 the offset is
    counts = np.diff(ends.astype(np.intp), axis=-1, prepend=0)
    chosen = np.repeat(np.broadcast_to(np.arange(N), counts.shape), counts.ravel())
    return chosen.reshape(counts.shape)


def _normalised(log_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log weights whose exponentials sum to 1, and the log ``(...)`` of their sum before.

    A weight that is not a number counts as 0; if all are 0, the results are not numbers.
    """
    log_weights = np.fmax(log_weights, _NOWHERE)
    top = log_weights.max(-1)
    total = np.log(np.exp(log_weights - top[..., None]).sum(-1)) + top
    total = np.where(top > _NOWHERE, total, np.nan)
    return np.maximum(log_weights - total[..., None], _NOWHERE), total


def _about(
    weights: np.ndarray, points: np.ndarray, angles: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """The weighted mean of points ``(..., N, k)``, on the circle for angles, and deviations.

    Weights are ``(..., N, k)``, or ``(..., N, 1)`` for all components; points of weight 0 may be
    anything.
    """
    weights, index = np.broadcast_to(weights, points.shape), (..., list(angles))
    counted = np.where(weights > 0.0, points, 0.0)
    mean = (weights * counted).sum(-2)
    share, turned = weights[index], counted[index] - mean[index][..., None, :]
    centre = np.arctan2((share * np.sin(turned)).sum(-2), (share * np.cos(turned)).sum(-2))
    mean[index] += centre + (share * short_way(turned - centre[..., None, :])).sum(-2)
    away = points - mean[..., None, :]
    away[index] = short_way(away[index])
    return mean, away
