# /// script
# requires-python = ">=3.11"
# dependencies = [
#     "numpy==2.4.6", "scipy==1.17.1", "llvmlite==0.50.0", "gymnasium==1.4.0", "rich==15.0.0",
#     "filterpy==2.0.0", "torch==2.13.0", "rotorpy==3.0.0", "torchdiffeq==0.2.5", "roma==1.8.0",
#     "opt-einsum==3.4.0", "stable-baselines3==2.9.2",
# ]
# ///
"""A step of SigmaCorvette-v0 beside what one writes by hand, and beside RotorPy.

``python -m tests.own_environment studies/environment_peers.py`` installs the peers in an
environment of their own, and prints a table, which ``--page`` also writes to a page. By hand, a
corvette has four sensors, process noise, a rudder and an extended Kalman filter with differences
for a Jacobian. All rows of a batch are in one array, except in ``SyncVectorEnv``.
"""

import contextlib
import io
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from filterpy.kalman import ExtendedKalmanFilter

from agents.commands.console import command
from agents.page import markdown_table
from studies.corvette_filter import SEEN, SPREAD, START, STATES, Q, R, own_sine, rates, transition
from studies.markdown import measured_on, publish
from studies.scalars import Lines, Scalar, operations, vector
from studies.speed import Flight, measure, quartiles, time_block

ROWS, MARK, SHORT = 256, "peers", 1e-5
"""Environments of a batch, the mark of the table on a page, and the step of differences."""
LACKS = {
    "ours": "",
    "NumPy and filterpy in SyncVectorEnv": "waves, missing measurements, exact Jacobian",
    "NumPy batch by hand": "as above; resets, records of `info`",
    "torch batch by hand": "as above; resets, records of `info`",
    "RotorPy 3.0.0 (a quadrotor)": "sensors and filter",
}
"""What is compared, and what it lacks beside ours."""


class Batch:
    """Corvettes with extended Kalman filters in one array of NumPy or torch."""

    def __init__(
        self, rows: int, xp: Any = np, rates: Any = rates, array: Any = np.array, normal: Any = None
    ) -> None:
        self.xp, self.rates = xp, rates
        self.normal = normal or np.random.default_rng(0).standard_normal
        self.truth = self.mean = array(np.tile(START, (rows, 1)))
        self.cov = array(np.tile(np.diag(SPREAD**2), (rows, 1, 1)))
        self.rudder, self.shifts = array(np.zeros((rows, 1))), array(SHORT * np.eye(STATES))
        self.Q, self.R = array(Q), array(np.diag(R))
        self.deviations = array(np.sqrt(np.diag(Q))), array(np.sqrt(R))

    def step(self, action: Any) -> tuple[Any, Any]:
        """Move, measure and filter; returns means and rewards."""
        xp, mean = self.xp, self.mean[:, None]
        self.rudder = self.rudder + xp.clip(0.6 * action - self.rudder, -0.02, 0.02)
        points = xp.concatenate([self.truth[:, None], mean, mean + self.shifts], 1)
        moved = transition(points, self.rudder[:, None], self.rates)
        self.truth = moved[:, 0] + self.deviations[0] * self.normal(self.truth.shape)
        y = self.truth[:, SEEN]
        y = y + self.deviations[1] * self.normal(y.shape)
        self.correct(moved[:, 1], (moved[:, 2:] - moved[:, 1:2]).mT / SHORT, y)
        away = xp.hypot(self.truth[:, 0], self.truth[:, 1]) - 500.0
        return self.mean, xp.exp(-abs(away) / 100.0)

    def correct(self, x: Any, A: Any, y: Any) -> None:
        """Kalman filter for predicted means, Jacobians and measurements."""
        P = A @ self.cov @ A.mT + self.Q
        PC = P[..., SEEN]
        K = self.xp.linalg.solve(PC[:, SEEN] + self.R, PC.mT).mT
        self.mean = x + (K @ (y - x[:, SEEN])[..., None])[..., 0]
        P = P - K @ PC.mT
        self.cov = 0.5 * (P + P.mT)


class Filterpy(Batch):
    """A corvette with the extended Kalman filter of filterpy."""

    def correct(self, x: Any, A: Any, y: Any) -> None:
        """Kalman filter of the only row."""
        filter = ExtendedKalmanFilter(STATES, len(SEEN))
        filter.predict_x = lambda u=0: None  # the mean is predicted already
        filter.x, filter.P, filter.F, filter.Q, filter.R = x[0], self.cov[0], A[0], Q, self.R
        filter.predict()
        filter.update(y[0], lambda x: np.eye(STATES)[SEEN], lambda x: x[SEEN])
        self.mean, self.cov = filter.x[None], filter.P[None]


class Single(gym.Env[np.ndarray, np.ndarray]):
    """A corvette in NumPy as a Gymnasium environment."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (STATES,), np.float64)
    action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, Any]:
        """Begin at the mean."""
        self.plant = Filterpy(1)
        return START, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, Any]:
        """Move, measure and filter."""
        (mean,), (reward,) = self.plant.step(action)
        return mean, float(reward), False, False, {}


def torch_rates() -> Callable[[Any, Any], Any]:
    """The equations of motion as straight code of torch."""
    lines = Lines("x, rudder")
    row = vector([Scalar(f"x[{index}]", lines) for index in range(STATES)])
    found = rates(row, vector([Scalar("rudder", lines)]))
    names = operations(torch, maximum=lambda a, least: torch.clamp(a, min=least))
    written = lines.function(f"return {', '.join(each.value for each in found)}", names)
    return lambda x, rudder: torch.stack(
        torch.broadcast_tensors(*written(x.unbind(-1), rudder[..., 0])), -1
    )


def rotorpy(rows: int) -> Callable[[np.ndarray], Any]:
    """Step of RotorPy's batch of quadrotors under motor speeds."""
    from rotorpy.learning.quadrotor_environments import make_default_vec_env
    from rotorpy.vehicles.crazyflie_params import quad_params

    device = torch.device("cpu")
    with contextlib.redirect_stdout(io.StringIO()):
        env = make_default_vec_env(rows, quad_params, "cmd_motor_speeds", device)
    env.reset()
    return lambda action: env.step(np.tile(action, 4))


def blocks(rows: int) -> dict[Any, Callable[[], float]]:
    """A block of steps for each peer."""
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (60 // rows + 3, rows, 1))
    sync = gym.vector.SyncVectorEnv([Single] * rows)
    sync.reset(seed=0)
    normal = partial(torch.randn, dtype=torch.float64)
    by_torch = Batch(rows, torch, torch_rates(), torch.tensor, normal)
    steps: list[Callable[[Any], Any]] = [
        sync.step, Batch(rows).step, lambda action: by_torch.step(torch.tensor(action)),
        rotorpy(rows),
    ]  # fmt: skip
    names = [(name, rows) for name in LACKS]
    ours = Flight("SigmaCorvette-v0", rows if rows > 1 else 0, estimator="ekf")
    others = [partial(time_block, step, actions, rows) for step in steps]
    return dict(zip(names, [ours, *others], strict=True))


def report(rounds: int) -> str:
    """Table of the peers, timed in one run."""
    torch.set_num_threads(1)
    found = measure(blocks(1) | blocks(ROWS), rounds)
    lines = [
        (name, *(quartiles(found[name, rows]) for rows in (1, ROWS)), lacks)
        for name, lacks in LACKS.items()
    ]
    heads = "", "1 environment", f"{ROWS} environments", "lacks"
    method = f"CPU time of a step [µs]: median [quartiles] of {rounds} rounds. {measured_on()}"
    return f"{method}\n\n{markdown_table(heads, lines, 1)}"


OPTIONS = {"rounds": "blocks of each peer", "page": "Markdown page that also gets the table"}


def main(rounds: int = 11, page: Path | None = None) -> None:
    """Time a step of an environment with a filter, ours and others, in short turns."""
    with own_sine():
        publish(partial(report, rounds), page, MARK)


if __name__ == "__main__":
    command(main)
