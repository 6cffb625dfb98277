"""Baselines: filterpy, and NumPy written by hand, of an environment and of the arithmetic and random numbers alone."""

import math
from collections.abc import Callable, Iterator
from itertools import count, repeat
from typing import Any

import numpy as np

from estimators import Gaussian, LinearModel, NonlinearModel, RandomKeys, make
from vessel_gym.envs.thesis_corvette import THESIS_CORVETTE
from vessel_gym.tasks.turning_trial import SWITCH
from vessel_gym.vehicles.corvette import secant_models, steady_turns
from vessel_gym.vehicles.corvette_equations import COEFFICIENTS


class HandWrittenLoop:
    """ThesisCorvette-v0 as a user would write it: plain NumPy, filterpy's KalmanFilter, one environment.

    The same ship, integration step, unknown input, sensors, filter model, observation and reward as
    the package's, in a Python loop, but for roll, on which nothing of these depends. A test holds
    it against the package step by step.

    Args:
        seed: Of its own random numbers.
    """

    def __init__(self, seed: int) -> None:
        from filterpy.kalman import KalmanFilter

        self.rng = np.random.default_rng(seed)
        system: Any = THESIS_CORVETTE
        self.vehicle, self.task = system.vehicle, system.task
        self.ship = self.task.ship
        self.dt, self.measurement_sd = (
            self.vehicle.dt,
            np.array([sd for sensor in self.vehicle.sensors for sd in sensor.sd]),
        )
        self.c = dict(zip(COEFFICIENTS, self.ship.vector(), strict=True))
        self.A_table, self.B_table = secant_models(self.ship, self.dt)
        self.rate_step = steady_turns(self.ship).yaw_rate[1]
        self.filter = KalmanFilter(dim_x=3, dim_z=2, dim_u=1)
        self.filter.H = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
        self.filter.Q, self.filter.R = 1e-3 * np.eye(3), 1e-3 * np.eye(2)
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        self.rate = self.task.scenario(np.zeros((1, 0)), {})[0, 1]
        self.truth = np.array([0.0, 0.0, 0.0, self.ship.speed, 0.0, 0.0])
        self.rudder, self.share, self.k = 0.0, 0.0, 0
        self.filter.x, self.filter.P = np.zeros(3), self.task.prior_variance * np.eye(3)

    def drags(self, v: Any, r: Any, a: float) -> tuple[Any, Any]:
        """Cross-flow drag's integrals along the hull."""
        if abs(r) * a <= abs(v):
            sign = math.copysign(1.0, v)
            return (
                sign * (2.0 * a * v**2 + 2.0 / 3.0 * a**3 * r**2),
                sign * 4.0 / 3.0 * a**3 * v * r,
            )
        bow, stern = v + a * r, v - a * r
        cubic = (abs(bow) ** 3 - abs(stern) ** 3) / 3.0
        return cubic / r, ((bow * abs(bow) ** 3 - stern * abs(stern) ** 3) / 4.0 - v * cubic) / r**2

    def derivative(self, state: np.ndarray, rudder: float) -> np.ndarray:
        """The ship's equations of motion."""
        c = self.c
        _, _, psi, u, v, r = state
        a = c["half_length"]
        sway_drag, yaw_drag = self.drags(v, r, a)
        inflow, side = c["slipstream"] * u, c["straightening"] * (v - a * r)
        force = c["rudder"] * (inflow**2 + side**2) * np.sin(rudder + np.arctan2(side, inflow))
        surge = c["thrust"] - c["resistance"] * u * abs(u) + c["sway_inertia"] * v * r
        surge += c["sway_yaw_inertia"] * r**2 - force * np.sin(rudder)
        sway = u * (c["Yv"] * v + c["Yr"] * r) - c["mass"] * u * r - c["cross_flow"] * sway_drag
        yaw = u * (c["Nv"] * v + c["Nr"] * r) - c["mass_x_g"] * u * r - c["cross_flow"] * yaw_drag
        forces = np.array([sway - force * np.cos(rudder), yaw + a * force * np.cos(rudder)])
        inertia = np.array(
            [[c["sway_inertia"], c["sway_yaw_inertia"]], [c["yaw_sway_inertia"], c["yaw_inertia"]]]
        )
        dv, dr = np.linalg.solve(inertia, forces)
        north, east = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
        return np.array([north, east, r, surge / c["surge_inertia"], dv, dr])

    def ship_step(self, state: np.ndarray, before: float, after: float) -> np.ndarray:
        """RK4 steps with the rudder moving linearly."""
        parts = self.vehicle.substeps
        dt = self.dt / parts
        for i in range(parts):
            start, middle, end = (
                before + (i + share) / parts * (after - before) for share in (0.0, 0.5, 1.0)
            )
            k1 = self.derivative(state, start)
            k2 = self.derivative(state + 0.5 * dt * k1, middle)
            k3 = self.derivative(state + 0.5 * dt * k2, middle)
            k4 = self.derivative(state + dt * k3, end)
            state = state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return state

    def step(self, action: float) -> tuple[np.ndarray, float]:
        """Advance by one step; observation and reward."""
        before, limit, turn = self.rudder, self.ship.rudder_limit, self.ship.rudder_rate * self.dt
        self.rudder = float(np.clip(limit * action, before - turn, before + turn))
        self.truth = self.ship_step(self.truth, before, self.rudder)
        self.k += 1
        d = 0.01 if self.k < SWITCH else -0.01
        measurement = np.array(
            [self.truth[2] + d, d]
        ) + self.measurement_sd * self.rng.standard_normal(2)
        nearest = round(abs(self.rate) / self.rate_step)
        u = np.array([0.5 * (before + self.rudder)])
        self.filter.predict(u=u, B=self.B_table[nearest], F=self.A_table[nearest])
        self.filter.update(measurement)
        record, ahead = self.task.record, round(self.task.preview / self.dt)
        (heading, rate), rate_ahead = record[self.k, [2, 5]], record[self.k + ahead, 5]
        x, pace = self.filter.x, self.task.pace
        error = (heading - x[2] + np.pi) % (2.0 * np.pi) - np.pi
        observation = [
            error / 0.1,
            (rate - x[1]) / (0.01 / pace),
            x[0] / 2.0,
            0.0,
            self.rudder / limit,
            rate / (0.04 / pace),
            rate_ahead / (0.04 / pace),
        ]
        true_error = (heading - self.truth[2] + np.pi) % (2.0 * np.pi) - np.pi
        rate_error = (rate - self.truth[5]) / (0.15 * self.rate)
        share, share_before = (self.rudder - before) / turn, self.share
        self.share = share
        reward = (0.8 + 0.2 / (1.0 + rate_error**2)) / (1.0 + (true_error / 0.05) ** 2)
        reward /= 1.0 + 1.25 * abs(share) + 2.0 * abs(share - share_before)
        return np.clip(observation, -10.0, 10.0).astype(np.float32), float(reward)


STATES, MEASUREMENTS, INPUTS, MEMBERS = 12, 8, 2, 100
"""Size of the system on which filters are timed: its own cost hardly counts."""
Step = Callable[[np.ndarray], np.ndarray]
"""Prediction and update by measurements ``(rows, p)``, then the means ``(rows, n)``."""
_CACHED = 64
"""Rows whose matrices stay in the processor's cache."""

_rng = np.random.default_rng(0)
A, C = _rng.normal(size=(STATES, STATES)), _rng.normal(size=(MEASUREMENTS, STATES))
A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
G, H = _rng.normal(size=(STATES, INPUTS)), _rng.normal(size=(MEASUREMENTS, INPUTS))
Q, R = 0.1 * np.eye(STATES), np.eye(MEASUREMENTS)


def nonlinear(x: np.ndarray, u: Any = None) -> np.ndarray:
    """Transition of a nonlinear system of that size."""
    return np.matvec(A, x) + 0.1 * np.sin(x)


def nonlinear_measurement(x: np.ndarray, u: Any = None) -> np.ndarray:
    """Its measurement function."""
    return np.matvec(C, x + 0.1 * np.sin(x))


def nonlinear_jacobian(x: np.ndarray, u: Any = None) -> np.ndarray:
    """Jacobian of the transition."""
    return A + 0.1 * np.cos(x)[..., None] * np.eye(STATES)


def nonlinear_measurement_jacobian(x: np.ndarray, u: Any = None) -> np.ndarray:
    """Jacobian of the measurement function."""
    return C * (1.0 + 0.1 * np.cos(x))[..., None, :]


def start(rows: int) -> Gaussian:
    """Prior; no two rows are equal, so that each needs a covariance of its own."""
    return Gaussian(
        np.zeros((rows, STATES)), np.linspace(1.0, 2.0, rows)[:, None, None] * np.eye(STATES)
    )


def measurements(steps: int, rows: int) -> np.ndarray:
    """Measurements ``(steps, rows, p)``."""
    return np.random.default_rng(1).normal(size=(steps, rows, MEASUREMENTS))


def ours(name: str, rows: int, **options: Any) -> Step:
    """A filter of the package: `ekf` and `ukf` on the nonlinear system, the others on the linear one."""
    if name in ("ekf", "ukf"):
        model = NonlinearModel(
            nonlinear, nonlinear_measurement, Q, R, transition_jacobian=nonlinear_jacobian,
            measurement_jacobian=nonlinear_measurement_jacobian,
        )  # fmt: skip
        filter = make(name, model, **options)
    else:
        try:
            filter = make(name, LinearModel(A, C, Q, R, G=G, H=H), **options)
        except ValueError:  # a filter without feedthrough
            filter = make(name, LinearModel(A, C, Q, R, G=G), **options)
    drawn: Iterator[Any] = (
        map(RandomKeys.seeded(range(rows)).at, count()) if filter.random else repeat(None)
    )
    belief = filter.init(start(rows), rng=next(drawn))

    def step(y: np.ndarray) -> np.ndarray:
        nonlocal belief
        rng = next(drawn)
        belief = filter.update(filter.predict(belief, rng=rng), y, rng=rng)
        return belief.mean

    return step


def filterpys(name: str) -> Step:
    """The filter of filterpy that computes the same for one row."""
    from filterpy import kalman

    prior = start(1)
    seen: tuple[Any, ...] = ()
    x, P = prior.mean[0].copy(), prior.cov[0].copy()
    rival: Any
    if name == "kf":
        rival = kalman.KalmanFilter(STATES, MEASUREMENTS)
        rival.F, rival.H = A, C
    elif name == "ekf":
        rival = kalman.ExtendedKalmanFilter(STATES, MEASUREMENTS)

        def predict_x(u: Any = 0) -> None:  # which is left to its user
            rival.F, rival.x = nonlinear_jacobian(rival.x), nonlinear(rival.x)

        rival.predict_x, seen = predict_x, (nonlinear_measurement_jacobian, nonlinear_measurement)
    elif name == "ukf":
        points = kalman.MerweScaledSigmaPoints(STATES, 1.0, 2.0, 0.0)
        rival = kalman.UnscentedKalmanFilter(
            STATES, MEASUREMENTS, 1.0, nonlinear_measurement, nonlinear, points
        )
    else:
        rival = kalman.EnsembleKalmanFilter(
            x, P, MEASUREMENTS, 1.0, MEMBERS, lambda x: C @ x, lambda x, dt: A @ x
        )
    rival.x, rival.P, rival.Q, rival.R = x, P, Q, R

    def step(y: np.ndarray) -> np.ndarray:
        rival.predict()
        rival.update(y[0], *seen)
        return rival.x[None]

    return step


def numpy_kalman(
    rows: int, model: LinearModel | None = None, prior: Gaussian | None = None
) -> Step:
    """Arithmetic of a Kalman filter in NumPy, few rows at a time: no checks, gaps, angles or recovery."""
    model, prior = model or LinearModel(A, C, Q, R), prior or start(rows)
    fixed: tuple[Any, ...] = model.A, model.C, model.Q, model.R
    A_, C_, Q_, R_ = fixed
    mean, cov = prior.mean.copy(), np.array(np.broadcast_to(prior.cov, (rows, model.n, model.n)))

    def step(y: np.ndarray) -> np.ndarray:
        for first in range(0, rows, _CACHED):
            few = slice(first, first + _CACHED)
            x, P = mean[few] @ A_.T, A_ @ cov[few] @ A_.T + Q_
            PC = P @ C_.T
            K = np.linalg.solve(C_ @ PC + R_, PC.mT)
            P -= PC @ K
            mean[few] = x + np.vecmat(y[few] - x @ C_.T, K)
            np.multiply(P + P.mT, 0.5, out=cov[few])
        return mean

    return step


def numpy_ensemble(rows: int, members: int) -> Step:
    """A stochastic ensemble filter's arithmetic in NumPy and its normal numbers from one generator, few rows at a time.

    Leaves out what `numpy_kalman` does, numbers of a row's own, centred noise, and the covariance
    that nobody asks for.
    """
    prior, rng = start(rows), np.random.default_rng(0)
    most = max(1, 1000 // members)  # whose members stay in the processor's cache
    noise, mean = np.empty((most, members, STATES + MEASUREMENTS)), np.empty((rows, STATES))
    ensemble = rng.standard_normal((rows, members, STATES)) @ np.linalg.cholesky(prior.cov).mT
    spread = np.sqrt(np.concatenate([Q.diagonal(), R.diagonal()]))

    def step(y: np.ndarray) -> np.ndarray:
        for first in range(0, rows, most):
            few = slice(first, first + most)
            drawn = noise[: rows - first]
            rng.standard_normal(out=drawn)
            drawn *= spread
            x = ensemble[few] @ A.T
            x += drawn[..., :STATES]
            expected = x @ C.T
            X, Y = x - x.mean(1, keepdims=True), expected - expected.mean(1, keepdims=True)
            K = np.linalg.solve(Y.mT @ Y / (members - 1) + R, Y.mT @ X / (members - 1))
            innovation = np.subtract(drawn[..., STATES:], expected, out=expected)
            innovation += y[few, None]
            ensemble[few] = x + innovation @ K
            mean[few] = ensemble[few].mean(1)
        return mean

    return step


class HandWrittenShips(HandWrittenLoop):
    """The ships of many environments, states ``(6, rows)``."""

    def drags(self, v: Any, r: Any, a: float) -> tuple[Any, Any]:
        """Cross-flow drag's integrals along the hulls."""
        sign, turning = np.copysign(1.0, v), np.where(np.abs(r) * a > np.abs(v), r, 1.0)
        bow, stern = v + a * r, v - a * r
        bow_cubed, stern_cubed = np.abs(bow) * bow * bow, np.abs(stern) * stern * stern
        cubic = (bow_cubed - stern_cubed) / 3.0
        quartic = (bow * bow_cubed - stern * stern_cubed) / 4.0
        straight = np.abs(r) * a <= np.abs(v)
        sway = np.where(
            straight, sign * (2.0 * a * v * v + 2.0 / 3.0 * a**3 * r * r), cubic / turning
        )
        yaw = np.where(
            straight, sign * 4.0 / 3.0 * a**3 * v * r, (quartic - v * cubic) / (turning * turning)
        )
        return sway, yaw


def numpy_flight(rows: int) -> Step:
    """Many corvettes on a Kalman filter in NumPy: equations of motion, `numpy_kalman` and the normal numbers needed.

    Leaves out Gymnasium, actuators, measurements, task, observation, reward, info and checks.
    """
    ships, rng = (
        (HandWrittenShips if rows > 1 else HandWrittenLoop)(seed=0),
        np.random.default_rng(0),
    )
    x, P, sensed = ships.filter.x, ships.filter.P, ships.filter
    turn = round(abs(ships.rate) / ships.rate_step)
    model = LinearModel(ships.A_table[turn], sensed.H, sensed.Q, sensed.R)
    filter = numpy_kalman(rows, model, Gaussian(np.tile(x, (rows, 1)), np.tile(P, (rows, 1, 1))))
    state = ships.truth
    if rows > 1:
        state = np.repeat(state[:, None], rows, 1)
    noise = np.empty((rows, len(sensed.R)))

    def step(_: np.ndarray) -> np.ndarray:
        nonlocal state
        state = ships.ship_step(state, ships.rudder, ships.rudder)
        rng.standard_normal(out=noise)
        return filter(noise)

    return step
