"""Microseconds per environment step, and the ratio to what one would write by hand."""

import math
import time
from collections.abc import Callable
from typing import Literal

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from agents import load_agent
from agents.studies.worlds import environment_id
from estimators import Gaussian, LinearModel, make, names
from scripts.console import asked, command, in_range
from vessel_gym.envs.sigma_corvette import SEAS
from vessel_gym.extras import require
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette import Corvette, secant_models, steady_turns
from vessel_gym.vehicles.corvette_equations import COEFFICIENTS

ENSEMBLES = ("enkf", "enkf-sr", "etkf")


class HandWrittenLoop:
    """SigmaCorvette-v0 as a user would write it: plain NumPy, filterpy's KalmanFilter, one environment.

    The same ship, integration step, sea, sensors, filter model, observation and reward as the
    package's, in a Python loop. A test holds it against the package step by step.

    Args:
        seed: Of its own random numbers.
        disturbance: Name of the sea.
    """

    def __init__(self, seed: int, disturbance: str = "moderate") -> None:
        from filterpy.kalman import KalmanFilter

        self.rng = np.random.default_rng(seed)
        self.vehicle, self.sea = Corvette(), SEAS[disturbance]
        self.task = TurningCircle(self.vehicle.ship)
        self.ship = self.vehicle.ship
        self.dt, self.reading_sd = (
            self.vehicle.dt,
            np.array([sd for sensor in self.vehicle.sensors for sd in sensor.sd]),
        )
        self.c = dict(zip(COEFFICIENTS, self.ship.vector(), strict=True))
        self.sea_A, self.sea_L = self.sea.process.transition, self.sea.process.root
        self.A_table, self.B_table = secant_models(self.ship, self.dt)
        self.rate_step = steady_turns(self.ship).yaw_rate[1]
        self.filter = KalmanFilter(dim_x=3, dim_z=2, dim_u=1)
        self.filter.H = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
        self.filter.Q = np.diag(self.vehicle.process_sd[:3] ** 2)
        self.filter.R = np.diag(self.reading_sd**2)
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        course = self.task.course(self.rng.random((1, 3)), {})[0]
        self.heading, self.rate = course
        prior = self.task.prior(course[None])
        x = self.rng.multivariate_normal(prior.mean[0], prior.cov)
        self.truth = np.array([0.0, 0.0, x[2], x[3], x[0], x[1]])
        self.rudder, self.k = 0.0, 0
        self.sea_state = self.rng.multivariate_normal(np.zeros(5), self.sea.process.start_cov)
        self.filter.x, self.filter.P = prior.mean[0, :3].copy(), prior.cov[:3, :3].copy()

    def derivative(self, state: np.ndarray, rudder: float, current: np.ndarray) -> np.ndarray:
        """The ship's equations of motion."""
        c = self.c
        _, _, psi, u, v, r = state
        a = c["half_length"]
        if abs(r) * a <= abs(v):
            sign = math.copysign(1.0, v)
            sway_drag = sign * (2.0 * a * v**2 + 2.0 / 3.0 * a**3 * r**2)
            yaw_drag = sign * 4.0 / 3.0 * a**3 * v * r
        else:
            bow, stern = v + a * r, v - a * r
            cubic = (abs(bow) ** 3 - abs(stern) ** 3) / 3.0
            sway_drag = cubic / r
            yaw_drag = ((bow * abs(bow) ** 3 - stern * abs(stern) ** 3) / 4.0 - v * cubic) / r**2
        inflow, side = c["slipstream"] * u, c["straightening"] * (v - a * r)
        force = c["rudder"] * (inflow**2 + side**2) * np.sin(rudder + np.arctan2(side, inflow))
        surge = c["thrust"] - c["resistance"] * u * abs(u) + c["sway_inertia"] * v * r
        surge += c["sway_yaw_inertia"] * r**2 - force * np.sin(rudder)
        sway = u * (c["Yv"] * v + c["Yr"] * r) - c["mass"] * u * r - c["cross_flow"] * sway_drag
        yaw = u * (c["Nv"] * v + c["Nr"] * r) - c["mass_x_g"] * u * r - c["cross_flow"] * yaw_drag
        forces = np.array([sway - force * np.cos(rudder), yaw + a * force * np.cos(rudder)])
        inertia = np.array([[c["sway_inertia"], c["sway_yaw_inertia"]], [c["yaw_sway_inertia"], c["yaw_inertia"]]])
        dv, dr = np.linalg.solve(inertia, forces)
        north = u * np.cos(psi) - v * np.sin(psi) + current[0]
        east = u * np.sin(psi) + v * np.cos(psi) + current[1]
        return np.array([north, east, r, surge / c["surge_inertia"], dv, dr])

    def ship_step(self, state: np.ndarray, before: float, after: float, current: np.ndarray) -> np.ndarray:
        """One RK4 step with the rudder moving linearly."""
        dt, middle = self.dt, 0.5 * (before + after)
        k1 = self.derivative(state, before, current)
        k2 = self.derivative(state + 0.5 * dt * k1, middle, current)
        k3 = self.derivative(state + 0.5 * dt * k2, middle, current)
        k4 = self.derivative(state + dt * k3, after, current)
        return state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    def step(self, action: float) -> tuple[np.ndarray, float]:
        """Advance by one step; observation and reward."""
        before = self.rudder
        limit = self.ship.rudder_limit
        self.rudder = float(np.clip(before + self.ship.rudder_rate * self.dt * action, -limit, limit))
        _, r_reference, _ = self.reference(self.k)
        d = self.dt * (self.sea_state[1] + self.sea_state[2])
        self.truth = self.ship_step(self.truth, before, self.rudder, self.sea_state[3:])
        self.truth[2] += d
        self.sea_state = self.sea_A @ self.sea_state + self.sea_L @ self.rng.standard_normal(5)
        self.k += 1
        d = self.dt * (self.sea_state[1] + self.sea_state[2])
        reading = np.array([self.truth[2] + d, d]) + self.reading_sd * self.rng.standard_normal(2)
        turn = round(abs(r_reference) / self.rate_step)
        u = np.array([0.5 * (before + self.rudder)])
        self.filter.predict(u=u, B=self.B_table[turn], F=self.A_table[turn])
        self.filter.update(reading)
        heading, rate, ahead = self.reference(self.k)
        x = self.filter.x
        error = (heading - x[2] + np.pi) % (2.0 * np.pi) - np.pi
        observation = [
            error / 0.1,
            (rate - x[1]) / 0.01,
            x[0] / 2.0,
            0.0,
            self.rudder / limit,
            rate / 0.04,
            ahead / 0.04,
        ]
        true_error = (heading - self.truth[2] + np.pi) % (2.0 * np.pi) - np.pi
        rate_error = (rate - self.truth[5]) / (0.15 * self.rate)
        reward = 0.8 / (1.0 + (true_error / 0.05) ** 2) + 0.2 / (1.0 + rate_error**2)
        return np.clip(observation, -10.0, 10.0).astype(np.float32), float(reward * (1.0 - 0.15 * action**2))

    def reference(self, k: int) -> tuple[float, float, float]:
        """Commanded heading, yaw rate and yaw rate ahead."""
        task = self.task
        elapsed = k * self.dt - task.lead
        share = min(max(elapsed / task.ramp, 0.0), 1.0)
        ahead = min(max((elapsed + task.preview) / task.ramp, 0.0), 1.0)
        heading = self.heading + self.rate * (0.5 * task.ramp * share**2 + max(elapsed - task.ramp, 0.0))
        return heading, self.rate * share, self.rate * ahead


class Run:
    """Something to time: ``run()`` flies one episode (or ``episodes`` of them) of ``num_envs`` environments."""

    def __init__(self, run: Callable[[], None], num_envs: int, steps: int) -> None:
        self.run, self.env_steps = run, num_envs * steps


def recorded_actions(env_id: str, estimator: str | None, num_envs: int) -> np.ndarray:
    """The autopilot's actions ``(T, num_envs, a)`` until the first episode ends: vehicles on their course are timed."""
    env = gym.make_vec(env_id, num_envs=num_envs, estimator=estimator)
    agent = load_agent("autopilot", env)
    agent.reset(num_envs)
    observation, _ = env.reset(seed=0)
    actions = []
    done = np.zeros(num_envs, bool)
    while not done.any():
        actions.append(agent.act(observation))
        observation, _, terminated, truncated, _ = env.step(actions[-1])
        done = terminated | truncated
    return np.stack(actions)


def single(env_id: str, estimator: str | None) -> Run:
    """One environment through ``gymnasium.make``, its reset included."""
    actions = recorded_actions(env_id, estimator, 1)[:, 0]
    env = gym.make(env_id, estimator=estimator)

    def run() -> None:
        env.reset(seed=0)
        for action in actions:
            env.step(action)

    return Run(run, 1, len(actions))


def batch(env_id: str, estimator: str | None, num_envs: int) -> Run:
    """A native batch, its resets before and after the episode included."""
    actions = recorded_actions(env_id, estimator, num_envs)
    env = gym.make_vec(env_id, num_envs=num_envs, vectorization_mode="vector_entry_point", estimator=estimator)

    def run() -> None:
        env.reset(seed=0)
        for action in actions:
            env.step(action)

    return Run(run, num_envs, len(actions))


def by_hand(estimator: str | None) -> Run:
    """The hand-written loop."""
    env = HandWrittenLoop(seed=0)
    actions = recorded_actions("SigmaCorvette-v0", estimator, 1)[:, 0, 0]

    def run() -> None:
        env.reset()
        for action in actions:
            env.step(float(action))

    return Run(run, 1, len(actions))


def microseconds(runs: dict[str, Run], repeats: int) -> dict[str, float]:
    """Median time of an environment step, the runs taken in turns so that all meet the same machine."""
    times: dict[str, list[float]] = {label: [] for label in runs}
    for run in runs.values():
        run.run()
    for _ in track(range(repeats), description="measuring", console=Console(stderr=True), transient=True):
        for label, run in runs.items():
            start = time.perf_counter()
            run.run()
            times[label].append(1e6 * (time.perf_counter() - start) / run.env_steps)
    return {label: float(np.median(values)) for label, values in times.items()}


STATES, MEASUREMENTS, INPUTS, MEMBERS = 12, 8, 2, 100
"""Size of the linear system on which estimators are timed: its own cost hardly counts."""


def linear_system(feedthrough: bool) -> LinearModel:
    """A stable random system; the unknown input shows in the reading or only in the state."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(STATES, STATES))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    C, G = rng.normal(size=(MEASUREMENTS, STATES)), rng.normal(size=(STATES, INPUTS))
    H = rng.normal(size=(MEASUREMENTS, INPUTS)) * feedthrough
    return LinearModel(A, C, 0.1 * np.eye(STATES), np.eye(MEASUREMENTS), G=G, H=H)


def estimator(name: str, rows: int, steps: int) -> Run:
    """Predictions and updates of one filter over a batch."""
    options = {"members": MEMBERS} if name in ENSEMBLES else {}
    try:
        filter = make(name, linear_system(feedthrough=True), **options)
    except ValueError:  # a filter without feedthrough
        filter = make(name, linear_system(feedthrough=False), **options)
    rng = [np.random.default_rng(row) for row in range(rows)]
    prior = Gaussian(np.zeros((rows, STATES)), np.eye(STATES))
    readings = np.random.default_rng(1).normal(size=(steps, rows, MEASUREMENTS))

    def run() -> None:
        belief = filter.init(prior, rng=rng)
        for reading in readings:
            belief = filter.update(filter.predict(belief, rng=rng), reading, rng=rng)

    return Run(run, rows, steps)


def filterpy_ensemble(steps: int) -> Run:
    """The same with filterpy's ensemble Kalman filter, one row."""
    from filterpy.kalman import EnsembleKalmanFilter

    model, rng = linear_system(feedthrough=False), np.random.default_rng(0)
    A, C = np.asarray(model.A), np.asarray(model.C)
    readings = rng.normal(size=(steps, MEASUREMENTS))

    def run() -> None:
        rival = EnsembleKalmanFilter(
            np.zeros(STATES), np.eye(STATES), MEASUREMENTS, 1.0, MEMBERS, lambda x: C @ x, lambda x, dt: A @ x
        )
        rival.Q, rival.R = np.asarray(model.Q), np.asarray(model.R)
        for reading in readings:
            rival.predict()
            rival.update(reading)

    return Run(run, 1, steps)


def random_numbers(rows: int, steps: int) -> Run:
    """The floor of a perturbed-observation filter: drawing its numbers, one stream a row, and nothing else."""
    rng = [np.random.default_rng(row) for row in range(rows)]

    def run() -> None:
        for _ in range(steps):
            for generator in rng:
                generator.standard_normal((MEMBERS, STATES + MEASUREMENTS))

    return Run(run, rows, steps)


def environment_table(env_id: str, estimator: str | None, num_envs: tuple[int, ...], repeats: int) -> Table:
    """Environment steps against the number of environments, and for the corvette the loop written by hand."""
    runs = {"by hand (NumPy, filterpy)": by_hand(estimator)} if env_id == "SigmaCorvette-v0" else {}
    runs["gymnasium.make"] = single(env_id, estimator)
    runs |= {f"batch of {size}": batch(env_id, estimator, size) for size in num_envs}
    medians = microseconds(runs, repeats)
    first, rival = next(iter(medians.items()))
    table = Table(title=f"{env_id}, {estimator or 'default estimator'}, one core, median of {repeats}")
    table.add_column("environment", no_wrap=True)
    for heading in ("us per step", "steps/s", "times the loop" if "hand" in first else f"times {first}"):
        table.add_column(heading, justify="right")
    for label, value in medians.items():
        table.add_row(label, f"{value:.2f}", f"{1e6 / value:,.0f}", f"{rival / value:.1f}")
    return table


def estimator_table(repeats: int) -> Table:
    """Prediction and update of every filter, at one row and in batches, beside filterpy's ensemble filter."""
    sizes = {1: 200, 256: 5, 1024: 2}
    runs = {"filterpy EnKF": filterpy_ensemble(20)}
    for rows, steps in sizes.items():
        runs |= {f"{name} {rows}": estimator(name, rows, steps if name in ENSEMBLES else 5 * steps) for name in names()}
        runs[f"random numbers {rows}"] = random_numbers(rows, steps)
    medians = microseconds(runs, repeats)
    rival = medians["filterpy EnKF"]
    table = Table(
        title=f"us per row: prediction and update, {STATES} states, {MEASUREMENTS} measurements, {MEMBERS} members",
        caption=f"one core, median of {repeats}; filterpy EnKF: {rival:.0f} us",
    )
    table.add_column("filter", no_wrap=True)
    for rows in sizes:
        table.add_column(f"{rows} row{'s' if rows > 1 else ''}", justify="right")
    for rows in (1, 256):
        table.add_column(f"times filterpy, {rows}", justify="right")
    for name in (*names(), "random numbers"):
        times = [f"{medians[f'{name} {rows}']:.2f}" for rows in sizes]
        ensemble = name in ENSEMBLES
        table.add_row(name, *times, *(f"{rival / medians[f'{name} {r}']:.1f}" if ensemble else "" for r in (1, 256)))
    return table


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    what: Literal["all", "environment", "estimators"] = "all",
    estimator: str | None = None,
    num_envs: tuple[int, ...] = (1, 16, 64, 256, 1024),
    repeats: int = 11,
) -> None:
    """Time environment steps and estimators on one core, and in the same run what one would write or use instead.

    Whole episodes are timed, resets included, under the autopilot's recorded actions.

    Args:
        env_id: Registered environment.
        what: environment, estimators or all.
        estimator: The environment's estimator; its default if not given.
        num_envs: Sizes of the native batch.
        repeats: Measurements of each; the median is reported.
    """
    require("filterpy")
    with asked():
        in_range("--repeats", repeats, 1)
        if not num_envs:
            raise ValueError("--num-envs needs at least one number")
        for size in num_envs:
            in_range("--num-envs", size, 1)
        env_id = environment_id(env_id)
        gym.make(env_id, estimator=estimator).close()
    if what != "estimators":
        Console().print(environment_table(env_id, estimator, num_envs, repeats))
    if what != "environment":
        Console().print(estimator_table(repeats))


if __name__ == "__main__":
    command(main)
