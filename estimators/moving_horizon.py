"""Moving-horizon estimation: the states of the last times are fitted anew at each measurement."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from estimators.angles import difference
from estimators.belief import Belief, Recovery
from estimators.checks import as_array, integer, number, with_points
from estimators.filter import Filter, Model, Rng
from estimators.kalman import joseph_update
from estimators.linalg import congruence, rows_like, solve, symmetrise
from estimators.measurement import Measurement
from estimators.varying import resolve


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HorizonBelief(Belief):
    """The belief of a filter that keeps its last N times, read or not, the newest last.

    Attributes:
        start_mean: ``(..., n)`` what all earlier measurements say of the state at the first of these times,
        start_cov: ``(..., n, n)`` and its covariance.
        states: ``(..., N, n)`` the states about which the model is linearised: the last estimates of them.
        moved: ``(..., N)`` whether a prediction led to this time; else it is the same as the one before.
        measurements: ``(..., N, p)`` 0 where none came.
        seen: ``(..., N, p)`` which came.
        noises: ``(..., N, p, p)`` their covariance, unit where none came.
        pending: ``(...)`` True where the newest time has had no measurement yet.
        inputs: ``(..., 2 N m)`` for each time the known input of the prediction that led to it and that of its
            measurement.
            None: it was told none.
    """

    start_mean: np.ndarray
    start_cov: np.ndarray
    states: np.ndarray
    moved: np.ndarray
    measurements: np.ndarray
    seen: np.ndarray
    noises: np.ndarray
    pending: np.ndarray
    inputs: np.ndarray | None = None
    __new__ = with_points("states")

    def replace(self, **changes: Any) -> Self:
        """This belief with some fields changed; another mean or covariance begins a new window."""
        if changes.keys() & {"mean", "cov"}:
            mean, cov = (as_array(name, changes.get(name, getattr(self, name))) for name in ("mean", "cov"))
            changes = _window_of(mean, cov, *self.measurements.shape[-2:]) | changes
        return Belief.replace(self, **changes)

    def known(self, i: int, which: int) -> np.ndarray | None:
        """The known input of the prediction that led to time i (0) or of its measurement (1)."""
        if self.inputs is None:
            return None
        return self.inputs.reshape(*self.moved.shape, 2, -1)[..., i, which, :]


class _Seen(NamedTuple):
    """A time on the way forward: what was predicted, and the step to it and its measurement, linearised."""

    mean: np.ndarray
    cov: np.ndarray
    A: np.ndarray
    measurement: Measurement
    S: np.ndarray


class MovingHorizonEstimator(Filter[HorizonBelief], verified=True):
    """MHE: at each measurement, the most probable course of the states over the last ``horizon`` times.

    It minimises, over the states of the window, which starts at time s::

        |x_s - x_bar|^2 in P_bar^-1  +  sum |x_i+1 - f(x_i)|^2 in Q^-1  +  sum |y_i - h(x_i)|^2 in R^-1

    by Gauss and Newton's method. Each of its steps is a Kalman filter forward through the window and a smoother back,
    of the model linearised about the last course (Bell 1994), so that P, Q and R may be singular. The arrival cost,
    ``x_bar`` and ``P_bar``, is what the filter says of what has left the window, linearised where it was estimated
    last (Rao, Rawlings & Lee 2001). On a linear model it is the `kf` for every horizon; with a horizon of 1 it is the
    `iekf` as long as that makes no step shorter: here all are whole, and a row whose steps did not settle within
    ``iterations`` keeps the last, and nothing says so. There are no bounds on states. An unknown input in the model is
    ignored.

    A row that has to recover begins a new window from what it then believes.

    Sources: Rao, Rawlings & Lee (2001), Constrained linear state estimation, a moving horizon approach; Bell (1994),
    The iterated Kalman smoother as a Gauss-Newton method; Durbin & Koopman (2012), Time Series Analysis by State Space
    Methods, sec. 4.4, for a smoother that inverts S alone.

    Args:
        model: A `LinearModel` or a `NonlinearModel`.
        horizon: Times in the window. Every prediction makes one, whether or not a measurement comes, and so does every
            further measurement at a time: where one comes every k-th step, ten measurements take ``10 k``.
        iterations: Largest number of times that the model is linearised at a measurement.
        tolerance: A row stops when no state of the window moves by more than this many standard deviations.

    Raises:
        ValueError: if ``horizon`` or ``iterations`` is below 1 or ``tolerance`` is not positive.
    """

    name = "mhe"
    record = HorizonBelief
    channelled = "measurements"

    def __init__(self, model: Model, horizon: int = 10, iterations: int = 5, tolerance: float = 1e-6) -> None:
        super().__init__(model)
        self.horizon = integer("horizon", horizon, 1)
        self.iterations = integer("iterations", iterations, 1)
        self.tolerance = number("tolerance", tolerance, 0.0, what="positive")

    def _init(self, belief: Belief, rng: Rng) -> HorizonBelief:
        window = _window_of(belief.mean, belief.cov, self.horizon, self.model.p)
        return HorizonBelief.of(belief, **window, pending=np.ones(belief.mean.shape[:-1], bool))

    def _predict(self, belief: HorizonBelief, u: np.ndarray | None, rng: Rng) -> HorizonBelief:
        mean, A = self.model.linearise_transition(belief.mean, u, belief.cov)
        cov = symmetrise(congruence(A, belief.cov) + resolve(self.model.Q, u))
        window = self._grown(belief, mean, True, u)
        return HorizonBelief.predicted(belief, mean, cov, u, **window)

    def correct(
        self, belief: HorizonBelief, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None, rng: Rng
    ) -> HorizonBelief:
        """The belief after a measurement, fitted to the whole window."""
        with np.errstate(all="ignore"):
            belief = self._fitted(self._read(belief, y, available, R))
        return super().correct(belief, y, available, R, rng)

    def _measurement(
        self, belief: HorizonBelief, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None
    ) -> Measurement:
        """The measurement linearised about the course of the states, seen from the prediction."""
        x = belief.states[..., -1, :]
        return _seen_from(
            super()._measurement(Belief.replace(belief, mean=x), y, available, R), self._away(x, belief.mean)
        )

    def _update(self, belief: HorizonBelief, measurement: Measurement, rng: Rng) -> HorizonBelief:
        mean, cov, S = joseph_update(belief.mean, belief.cov, measurement.innovation, measurement.C, measurement.R)
        window = _window(belief) | {"states": np.concatenate([belief.states[..., :-1, :], mean[..., None, :]], -2)}
        return HorizonBelief.updated(belief, mean, cov, measurement, S, **window)

    def _recovered(
        self, belief: HorizonBelief, updated: HorizonBelief, measurement: Measurement, y: np.ndarray, rng: Rng,
        available: np.ndarray | None, R: np.ndarray | None,
    ) -> HorizonBelief:  # fmt: skip
        result = super()._recovered(belief, updated, measurement, y, rng, available, R)
        lost, mended = result.recovery == Recovery.PRIOR, result.recovery > Recovery.USUAL
        initial = _window(self._init(result, rng).replace(pending=np.zeros(lost.shape, bool)))
        result = result.replace(**{name: _where(mended, a, getattr(result, name)) for name, a in initial.items()})
        if not lost.any():
            return result
        u, prior = None if belief.u is None else np.nan_to_num(belief.u[lost]), (belief.prior_mean, belief.prior_cov)
        prior = prior[0][lost], prior[1][lost]
        available, R = (None if a is None else a[lost] for a in (available, R))
        fresh = self._init(Belief(*prior, *prior, np.zeros(prior[0].shape[:-1], np.int8), u), rng)
        fresh = self.correct(fresh, y[lost], available, R, rng)
        return result.with_rows(lost, fresh.replace(recovery=np.full(fresh.recovery.shape, Recovery.PRIOR, np.int8)))

    # --- the window -------------------------------------------------------------------------------

    def _grown(self, belief: HorizonBelief, mean: np.ndarray, moved: bool, u: np.ndarray | None) -> dict[str, Any]:
        """The window with one more time, and what leaves it in the arrival cost."""
        batch, p = belief.mean.shape[:-1], self.model.p
        inputs = belief.inputs
        if u is not None:
            known_inputs = np.zeros(batch + (2 * self.horizon * u.shape[-1],)) if inputs is None else inputs
            inputs = np.concatenate([known_inputs, u, u], -1)
        elif inputs is not None:
            inputs = np.concatenate([inputs, np.zeros(batch + (inputs.shape[-1] // self.horizon,))], -1)
        added = {
            "states": mean, "moved": np.full(batch, moved), "measurements": np.zeros(batch + (p,)),
            "seen": np.zeros(batch + (p,), bool), "noises": np.zeros(batch + (p, p)) + np.eye(p),
        }  # fmt: skip
        axis = len(batch)
        longer = {
            name: np.concatenate([getattr(belief, name), np.expand_dims(a, axis)], axis) for name, a in added.items()
        }
        grown = belief.replace(inputs=inputs, pending=np.ones(batch, bool), **longer)
        first = self._passed(grown, 0, belief.start_mean, belief.start_cov)
        start_mean, start_cov, _ = self._moved_on(grown, 1, *_estimate(first))
        start = (slice(None),) * axis + (slice(1, None),)
        if inputs is not None:
            inputs = inputs[..., inputs.shape[-1] // (self.horizon + 1) :]
        kept = {name: getattr(grown, name)[start] for name in added}
        return kept | {"start_mean": start_mean, "start_cov": start_cov, "inputs": inputs, "pending": grown.pending}

    def _read(
        self, belief: HorizonBelief, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None
    ) -> HorizonBelief:
        """The belief with a measurement at its newest time, which is another one where that has had one."""
        again = ~belief.pending
        if again.any():
            window = self._grown(belief, belief.mean, False, belief.u)
            belief = belief.replace(**{name: _where(again, a, getattr(belief, name)) for name, a in window.items()})
        R, mask = self._noise(y, available, R, belief.u)
        none = np.zeros(belief.mean.shape[:-1] + (self.model.p, 1))
        y = difference(np.where(mask, y, 0.0), np.zeros(self.model.p), self.model.measurement_angles)
        measurement = Measurement(y, none, none, R + none * none.mT, mask, False).only(mask)
        measurements, seen, noises = (a.copy() for a in (belief.measurements, belief.seen, belief.noises))
        measurements[..., -1, :], seen[..., -1, :], noises[..., -1, :, :] = measurement.innovation, mask, measurement.R
        inputs = belief.inputs
        if belief.u is not None:
            m = belief.u.shape[-1]
            known_inputs = np.zeros(belief.mean.shape[:-1] + (2 * self.horizon * m,)) if inputs is None else inputs
            inputs = np.concatenate([known_inputs[..., :-m], belief.u], -1)
        return belief.replace(
            measurements=measurements, seen=seen, noises=noises, inputs=inputs, pending=np.zeros(again.shape, bool)
        )

    def _fitted(self, belief: HorizonBelief) -> HorizonBelief:
        """The belief with its prediction made anew about the most probable course, where a measurement has come."""
        running = (
            np.isfinite(belief.mean).all(-1) & np.isfinite(belief.cov).all((-2, -1)) & belief.seen[..., -1, :].any(-1)
        )
        fitted = belief
        for iteration in range(self.iterations):
            times = self._forward(fitted)
            mean, cov = times[-1].mean, times[-1].cov
            running = running & np.isfinite(mean).all(-1) & np.isfinite(cov).all((-2, -1))
            both = {"mean": _where(running, mean, fitted.mean), "cov": _where(running, cov, fitted.cov)}
            fitted = Belief.replace(fitted, **both)
            if iteration == self.iterations - 1:
                break
            states, sd = _backward(times), np.sqrt(np.stack([t.cov.diagonal(0, -2, -1) for t in times], -2))
            step = np.abs(self._away(states, fitted.states)) / np.where(sd > 0.0, sd, np.inf)
            running = running & np.isfinite(states).all((-2, -1)) & (step > self.tolerance).any((-2, -1))
            if not running.any():
                break
            fitted = fitted.replace(states=_where(running, states, fitted.states))
        return fitted

    def _forward(self, belief: HorizonBelief) -> list[_Seen]:
        """The Kalman filter through the window, of the model linearised about its states."""
        times = [self._passed(belief, 0, belief.start_mean, belief.start_cov)]
        for i in range(1, self.horizon):
            mean, cov, A = self._moved_on(belief, i, *_estimate(times[-1]))
            times.append(self._passed(belief, i, mean, cov)._replace(A=A))
        return times

    def _moved_on(
        self, belief: HorizonBelief, i: int, mean: np.ndarray, cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """An estimate at time i - 1 as one at time i, and the matrix of that step."""
        x, u, moved = belief.states[..., i - 1, :], belief.known(i, 0), belief.moved[..., i]
        if not moved.any():
            return mean, cov, self._identity
        after, A = self.model.linearise_transition(x, u, belief.cov)
        after = after + np.matvec(A, self._away(mean, x))
        A = np.where(moved[..., None, None], A, self._identity)
        moved_cov = symmetrise(congruence(A, cov) + resolve(self.model.Q, u))
        return _where(moved, after, mean), _where(moved, moved_cov, cov), A

    def _passed(self, belief: HorizonBelief, i: int, mean: np.ndarray, cov: np.ndarray) -> _Seen:
        """A time and its measurement, which is not taken in yet."""
        x, mask, R = belief.states[..., i, :], belief.seen[..., i, :], belief.noises[..., i, :, :]
        expected, C = self.model.linearise_measurement(x, belief.known(i, 1), belief.cov)
        e = difference(belief.measurements[..., i, :], expected, self.model.measurement_angles)
        measurement = Measurement(e, C, np.zeros((self.model.p, 0)), R, mask, False).only(mask)
        measurement = _seen_from(measurement, self._away(x, mean))
        return _Seen(mean, cov, self._identity, measurement, congruence(measurement.C, cov) + R)

    def _away(self, x: np.ndarray, mean: np.ndarray) -> np.ndarray:
        return difference(x, mean, self.model.state_angles)


def _window_of(mean: np.ndarray, cov: np.ndarray, N: int, p: int) -> dict[str, np.ndarray]:
    """A window of N times in which nothing has been read, that begins with a mean and a covariance."""
    batch = mean.shape[:-1]
    return {
        "start_mean": mean, "start_cov": cov, "states": np.repeat(mean[..., None, :], N, -2),
        "moved": np.zeros(batch + (N,), bool), "measurements": np.zeros(batch + (N, p)),
        "seen": np.zeros(batch + (N, p), bool), "noises": np.zeros(batch + (N, p, p)) + np.eye(p),
    }  # fmt: skip


def _seen_from(measurement: Measurement, away: np.ndarray) -> Measurement:
    """A measurement linearised about a state that is ``away`` from the prediction, as one about the prediction."""
    return measurement._replace(innovation=measurement.innovation + np.matvec(measurement.C, away))


def _estimate(time: _Seen) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance with the measurement of a time."""
    mean, cov, _ = joseph_update(
        time.mean, time.cov, time.measurement.innovation, time.measurement.C, time.measurement.R
    )
    return mean, cov


def _backward(times: list[_Seen]) -> np.ndarray:
    """The means ``(..., N, n)`` of the states of a window given all its measurements."""
    states, r = [], np.zeros(times[-1].mean.shape)
    for i in reversed(range(len(times))):
        t = times[i]
        unexplained = t.measurement.innovation - np.matvec(t.measurement.C @ t.cov, r)
        r = r + np.vecmat(solve(t.S, unexplained[..., None])[..., 0], t.measurement.C)
        states.append(t.mean + np.matvec(t.cov, r))
        r = np.vecmat(r, t.A)
    return np.stack(states[::-1], -2)


_WINDOW = tuple(name for name in HorizonBelief.__dataclass_fields__ if name not in Belief.__dataclass_fields__)


def _window(belief: HorizonBelief) -> dict[str, Any]:
    return {name: getattr(belief, name) for name in _WINDOW}


def _where(rows: np.ndarray, new: Any, old: Any) -> Any:
    if new is None or old is None:
        return new if old is None else old
    return np.where(rows_like(rows, new), new, old)
