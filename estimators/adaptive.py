"""The adaptive Kalman filter: one that learns how large its noises are."""

from dataclasses import dataclass

import numpy as np

from estimators.belief import Belief
from estimators.checks import AT_LEAST_0, number
from estimators.filter import Filter, Model, Rng
from estimators.kalman import joseph_update
from estimators.linalg import congruence, joined, rows_like, solve, symmetric_blocks, symmetrise
from estimators.measurement import Measurement
from estimators.varying import resolve


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AdaptiveBelief(Belief):
    """The belief of a filter that estimates the covariances of its noises.

    Attributes:
        process_noise: ``(..., n, n)`` estimate of Q.
        measurement_noise: ``(..., p, p)`` estimate of R.
        noise_mean: ``(..., n + p)`` estimate of the last step's own noises, those of process and measurement.
        noise_cov: ``(..., n + p, n + p)`` its covariance.
        state_noise_cov: ``(..., n, n + p)`` covariance of their errors and that of the state.
        pending: ``(...)`` True where a prediction waits for its measurement.
    """

    process_noise: np.ndarray
    measurement_noise: np.ndarray
    noise_mean: np.ndarray
    noise_cov: np.ndarray
    state_noise_cov: np.ndarray
    pending: np.ndarray


class AdaptiveKalmanFilter(Filter[AdaptiveBelief], verified=True):
    """A `kf`, or on a nonlinear model an `ekf`, that estimates Q and R on the way, beginning with the model's.

    Each step's noises w and v are estimated from its own measurement and the next one, as a part of the state that is
    dropped after that. Their second moments, ``E[w w' | measurements] = w^ w^' + cov(w)``, are what Q and R are
    averages of, so that they are averaged with forgetting::

        Q <- Q + q_rate (w^ w^' + cov(w) - Q)      R <- R + r_rate (v^ v^' + cov(v) - R)

    This is the EM algorithm (Shumway & Stoffer 1982) done on the way, with a smoother of one step. Where Q and R are
    the true ones they stay so, but for chance, and what is added is a covariance always. The next measurement is
    needed: one tells of ``S = C P- C' + R`` alone, whatever share of it is whose, and rules that look at one alone
    (innovation or residual matching, as Mohamed & Schwarz 1999 and Akhlaghi et al. 2017 have them) settle anywhere on a
    whole family of Q and R with the right S.

    No more than n p numbers of Q can be told from measurements (Mehra 1970): of what they do not show the model's Q is
    kept in part. A noise of zero stays zero, and one that is small beside the others is found slowly. A covariance that
    is passed with a measurement is that of its noise, which joins the average. An unknown input in the model is
    ignored.

    Args:
        model: A `LinearModel` or a `NonlinearModel` whose Q and R are arrays.
        q_rate: Share of Q that each step replaces, at least 0 and below 1; 0 keeps the model's. It remembers some
            ``1 / q_rate`` steps, and takes many times that to converge.
        r_rate: Likewise, of R.

    Raises:
        ValueError: if a rate is not in [0, 1), or Q or R is a function.
    """

    name = "adaptive-kf"
    record = AdaptiveBelief
    channelled = "measurement_noise"

    def __init__(self, model: Model, q_rate: float = 0.01, r_rate: float = 0.01) -> None:
        super().__init__(model)
        for name, noise in (("Q", model.Q), ("R", model.R)):
            if callable(noise):
                raise ValueError(f"adaptive-kf needs {name} as an array to begin with: it estimates what follows")
        self.q_rate = number("q_rate", q_rate, AT_LEAST_0, 1.0, "at least 0 and below 1")
        self.r_rate = number("r_rate", r_rate, AT_LEAST_0, 1.0, "at least 0 and below 1")
        self.sequential = self.q_rate == self.r_rate == 0.0

    def _init(self, belief: Belief, rng: Rng) -> AdaptiveBelief:
        n, p, batch = self.model.n, self.model.p, belief.mean.shape[:-1]
        Q = np.zeros(batch + (n, n)) + resolve(self.model.Q, None)
        R = np.zeros(batch + (p, p)) + resolve(self.model.R, None)
        return AdaptiveBelief.of(
            belief, process_noise=Q, measurement_noise=R, noise_mean=np.zeros(batch + (n + p,)),
            noise_cov=_apart(Q, R), state_noise_cov=np.zeros(batch + (n, n + p)), pending=np.zeros(batch, bool),
        )  # fmt: skip

    def _predict(self, belief: AdaptiveBelief, u: np.ndarray | None, rng: Rng) -> AdaptiveBelief:
        mean, A = self.model.linearise_transition(belief.mean, u, belief.cov)
        cov = symmetrise(congruence(A, belief.cov) + belief.process_noise)
        return AdaptiveBelief.predicted(
            belief, mean, cov, u, process_noise=belief.process_noise, measurement_noise=belief.measurement_noise,
            noise_mean=belief.noise_mean, noise_cov=belief.noise_cov, state_noise_cov=A @ belief.state_noise_cov,
            pending=np.ones(belief.pending.shape, bool),
        )  # fmt: skip

    def _measurement(
        self, belief: AdaptiveBelief, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None
    ) -> Measurement:
        return super()._measurement(belief, y, available, self._own_R(belief) if R is None else R)

    def _own_R(self, belief: AdaptiveBelief) -> np.ndarray:
        return belief.measurement_noise

    def _update(self, belief: AdaptiveBelief, measurement: Measurement, rng: Rng) -> AdaptiveBelief:
        n, C, e = self.model.n, measurement.C, measurement.innovation
        Q, R = belief.process_noise, belief.measurement_noise
        mean, cov, S = joseph_update(belief.mean, belief.cov, e, C, measurement.R)
        # What this measurement says of the noises of the step before, which are then done with.
        gain = solve(S, C @ belief.state_noise_cov).mT
        late = belief.noise_mean + np.matvec(gain, e)
        moment = belief.noise_cov - congruence(gain, S) + late[..., :, None] * late[..., None, :]
        # What it says of this step's own: nothing of w where no prediction came before it, nor of v where it is mixed.
        both = measurement.available[..., None] & measurement.available[..., None, :]
        V = np.where(both, measurement.R, R) if measurement.whole_R is None else R
        w = np.where(belief.pending[..., None, None], Q, 0.0)
        v = np.where(measurement.available[..., None, :], V, 0.0) if measurement.whole_R is None else np.zeros(R.shape)
        gain = solve(S, joined([w @ C.mT, v], -2).mT).mT
        own = {
            "process_noise": _towards(Q, moment[..., :n, :n], self.q_rate),
            "measurement_noise": _towards(R, moment[..., n:, n:], self.r_rate),
            "noise_mean": np.matvec(gain, e),
            "noise_cov": symmetrise(_apart(Q, V) - congruence(gain, S)),
            "state_noise_cov": joined([w, np.zeros(C.mT.shape)], -1) - belief.cov @ C.mT @ gain.mT,
            "pending": np.zeros(e.shape[:-1], bool),
        }
        came = np.asarray(measurement.available.any(-1))  # else the noises wait for the next measurement
        return AdaptiveBelief.updated(
            belief, mean, cov, measurement, S,
            **{name: np.where(rows_like(came, new), new, getattr(belief, name)) for name, new in own.items()},
        )  # fmt: skip


def _apart(Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """The covariance ``(..., n + p, n + p)`` of noises of process and measurement that know nothing of each other."""
    return symmetric_blocks(Q, np.zeros((Q.shape[-1], R.shape[-1])), R)


def _towards(old: np.ndarray, moment: np.ndarray, rate: float) -> np.ndarray:
    """An average that forgets, where it is finite."""
    new = old + rate * symmetrise(moment - old)
    known = np.asarray(np.isfinite(new).all((-2, -1)))
    return np.where(known[..., None, None], new, old)
