"""Time of steps and filters, beside filterpy and bare NumPy: ``python -m studies.speed``."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import numpy as np

from agents.commands.console import asked, command, in_range, progress_bar
from agents.page import markdown_table
from agents.refusal import Refusal
from estimators import Gaussian, LinearModel, NonlinearModel, RandomKeys, make, names

ENVIRONMENTS = ("SigmaCorvette-v0", "ThesisCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0",
                "PunaUAV-v0")  # fmt: skip
OTHERS = {"ThesisCorvette-v0": ("kf", "ekf", "ukf"), "SegorogeniAUV-v0": ("ekf",)}
"""Filters that are timed beside an environment's default."""
STEPS, BATCH, MARK = 64, 256, "measured"
"""Steps of a block of flights, environments of a batch, and the mark of the tables on a page."""
STATES, MEASUREMENTS, INPUTS = 12, 8, 2
"""Size of the system of the filters."""
Step = Callable[[np.ndarray], Any]
"""Prediction and update by measurements ``(rows, p)``; returns the means ``(rows, n)``."""

_rng = np.random.default_rng(0)
A, C = _rng.normal(size=(STATES, STATES)), _rng.normal(size=(MEASUREMENTS, STATES))
A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
G, H = _rng.normal(size=(STATES, INPUTS)), _rng.normal(size=(MEASUREMENTS, INPUTS))
Q, R = 0.1 * np.eye(STATES), np.eye(MEASUREMENTS)


def prior(rows: int) -> Gaussian:
    """Prior with another covariance in each row."""
    spread = np.linspace(1.0, 2.0, rows)[:, None, None]
    return Gaussian(np.zeros((rows, STATES)), spread * np.eye(STATES))


def nonlinear(x: np.ndarray, u: Any = None) -> np.ndarray:
    """Transition of the nonlinear system, on which `ekf` and `ukf` are timed."""
    return np.matvec(A, x) + 0.1 * np.sin(x)


def jacobian(x: np.ndarray, u: Any = None) -> np.ndarray:
    """Jacobian of its transition."""
    return A + 0.1 * np.cos(x)[..., None] * np.eye(STATES)


def seen(x: np.ndarray, u: Any = None) -> np.ndarray:
    """Measurement function of the nonlinear system."""
    return np.matvec(C, x + 0.1 * np.sin(x))


def seen_jacobian(x: np.ndarray, u: Any = None) -> np.ndarray:
    """Jacobian of its measurement function."""
    return C * (1.0 + 0.1 * np.cos(x))[..., None, :]


def ours(name: str, rows: int) -> Step:
    """A filter of the package."""
    model: Any = LinearModel(A, C, Q, R, G=G, H=H)
    if name in ("ekf", "ukf"):
        model = NonlinearModel(
            nonlinear, seen, Q, R, transition_jacobian=jacobian, measurement_jacobian=seen_jacobian
        )
    try:
        filter = make(name, model)
    except ValueError:  # a filter without feedthrough
        filter = make(name, LinearModel(A, C, Q, R, G=G))
    keys = map(RandomKeys.seeded(range(rows)).at, count())
    belief = filter.init(prior(rows), rng=next(keys))

    def step(y: np.ndarray) -> np.ndarray:
        nonlocal belief
        rng = next(keys) if filter.random else None
        belief = filter.update(filter.predict(belief, rng=rng), y, rng=rng)
        return belief.mean

    return step


def filterpys(name: str) -> Step:
    """The filter of filterpy that computes the same for one row."""
    from filterpy import kalman

    told: tuple[Any, ...] = ()
    if name == "kf":
        rival = kalman.KalmanFilter(STATES, MEASUREMENTS)
        rival.F, rival.H = A, C
    elif name == "ekf":
        rival, told = kalman.ExtendedKalmanFilter(STATES, MEASUREMENTS), (seen_jacobian, seen)

        def predict_x(u: Any = 0) -> None:  # which is left to its user
            rival.F, rival.x = jacobian(rival.x), nonlinear(rival.x)

        rival.predict_x = predict_x
    else:
        points = kalman.MerweScaledSigmaPoints(STATES, 1.0, 2.0, 0.0)
        rival = kalman.UnscentedKalmanFilter(STATES, MEASUREMENTS, 1.0, seen, nonlinear, points)
    rival.x, rival.P, rival.Q, rival.R = prior(1).mean[0].copy(), prior(1).cov[0].copy(), Q, R

    def step(y: np.ndarray) -> np.ndarray:
        rival.predict()
        rival.update(y[0], *told)
        return rival.x[None]

    return step


def numpy_kalman(rows: int) -> Step:
    """Equations of the Kalman filter in NumPy, 64 rows at a time, without any check."""
    mean, cov = prior(rows).mean.copy(), prior(rows).cov.copy()

    def step(y: np.ndarray) -> np.ndarray:
        for first in range(0, rows, 64):
            few = slice(first, first + 64)
            x, P = mean[few] @ A.T, A @ cov[few] @ A.T + Q
            PC = P @ C.T
            K = np.linalg.solve(C @ PC + R, PC.mT)
            P -= PC @ K
            mean[few] = x + np.vecmat(y[few] - x @ C.T, K)
            cov[few] = 0.5 * (P + P.mT)
        return mean

    return step


class Block:
    """Something to time: a call does ``units`` of work and returns its seconds."""

    def __init__(self, step: Callable[[Any], Any], inputs: Any, rows: int) -> None:
        self.step, self.inputs, self.units = step, inputs, rows * len(inputs)

    def __call__(self) -> float:
        """Do the work."""
        start = time.perf_counter()
        for each in self.inputs:
            self.step(each)
        return time.perf_counter() - start


def filtered(step: Step, rows: int) -> Block:
    """Steps of a filter."""
    steps = max(2, 100 // rows)
    return Block(step, np.random.default_rng(1).normal(size=(steps, rows, MEASUREMENTS)), rows)


class Flight(Block):
    """Steps of an environment, or of a native batch, under small random actions after a reset."""

    PARTS = {"world": ["_moved"], "filter": ["step"], "task": ["_scored"],
             "observation": ["observe"], "info": ["happened", "info"]}  # fmt: skip
    """Methods of each part of `Core.step`; that of the filter is its own."""

    def __init__(self, env_id: str, rows: int = 0, **options: Any) -> None:
        if rows:
            options |= {"num_envs": rows, "vectorization_mode": "vector_entry_point"}
        self.env: Any = (gym.make_vec if rows else gym.make)(env_id, **options)
        space: Any = self.env.action_space
        straight = 0.8 if env_id == "ThesisCorvette-v0" else 0.0  # a turn needs its rudder
        actions = straight + np.random.default_rng(0).uniform(-0.2, 0.2, (STEPS, *space.shape))
        super().__init__(self.env.step, actions.astype(space.dtype), max(rows, 1))
        self.shares: list[dict[str, float]] = []

    def __call__(self) -> float:
        """Reset, which is not timed, and step."""
        self.env.reset(seed=0)
        return super().__call__()

    def parted(self) -> float:
        """A block with a clock round each part, whose shares are kept; calls included."""
        core, spent, outer = self.env.unwrapped.core, dict.fromkeys(self.PARTS, 0.0), [True]

        def clocked(part: str, method: Callable[..., Any]) -> Callable[..., Any]:
            def timed(*args: Any, **named: Any) -> Any:
                first, outer[0], start = outer[0], False, time.perf_counter()
                try:
                    return method(*args, **named)
                finally:
                    outer[0] = first
                    spent[part] += first * (time.perf_counter() - start)

            return timed

        self.env.reset(seed=0)
        with ExitStack() as stack:
            for part, methods in self.PARTS.items():
                owner = type(core.filter if part == "filter" else core)
                for name in methods:
                    new = clocked(part, getattr(owner, name))
                    stack.enter_context(patch.object(owner, name, new))
            seconds = super().__call__()
        spent["the rest"] = seconds - sum(spent.values())
        self.shares.append({part: each / seconds for part, each in spent.items()})
        return seconds


def measure(blocks: list[Callable[[], float]], rounds: int) -> np.ndarray:
    """Seconds ``(rounds, blocks)``: all in turn, every other round in the reverse order."""
    times = np.empty((rounds + 1, len(blocks)))
    with progress_bar("measuring", rounds + 1) as advance:
        for number in range(rounds + 1):
            for i in range(len(blocks))[:: -1 if number % 2 else 1]:
                times[number, i] = blocks[i]()
            advance()
    return times[1:]  # the first warms up


def shown(values: np.ndarray) -> str:
    """Median and quartiles."""
    median, *ends = (f"{q:,.0f}" if q >= 100.0 else f"{q:.3g}"
                     for q in np.quantile(values, (0.5, 0.25, 0.75)))  # fmt: skip
    return f"{median} [{', '.join(ends)}]"


def report(env_ids: tuple[str, ...], rows: tuple[int, ...], rounds: int) -> str:
    """Tables of filters by rows, of flights, and of the parts of a step, timed in one run."""
    filters = {name: [filtered(ours(name, size), size) for size in rows] for name in names()}
    filters |= {
        f"{name} of filterpy": [filtered(filterpys(name), 1)] for name in ("kf", "ekf", "ukf")
    }
    filters["kf in bare NumPy"] = [filtered(numpy_kalman(size), size) for size in rows]
    with asked():
        plain = {(env_id, size): Flight(env_id, size) for env_id in env_ids for size in (0, BATCH)}
        chosen = {
            (env_id, f"`{name}`"): Flight(env_id, BATCH, estimator=name)
            for env_id in env_ids for name in OTHERS.get(env_id, ())
        }  # fmt: skip
    blocks: list[Block] = [*plain.values(), *chosen.values()]
    blocks += [block for line in filters.values() for block in line]
    times = measure([*blocks, *(flight.parted for flight in plain.values())], rounds)
    text = {block: shown(1e6 * times[:, i] / block.units) for i, block in enumerate(blocks)}
    heads = "", *(f"{size:,} row{'s' if size > 1 else ''}" for size in rows)
    lines = [
        [name, *(text[block] for block in line), *[""] * (len(rows) - len(line))]
        for name, line in filters.items()
    ]
    parts = [*Flight.PARTS, "the rest"]
    shares = [
        (env_id, f"batch of {size}" if size else "alone", text[flight],
         *(f"{100.0 * np.median([of[part] for of in flight.shares]):.0f} %" for part in parts))
        for (env_id, size), flight in plain.items()
    ]  # fmt: skip
    others = [(*place, text[flight]) for place, flight in chosen.items()]
    return "\n\n".join((
        f"Median [quartiles] of {rounds} rounds, µs.",
        "**A step of one environment on its default estimator, and the share of each part**",
        markdown_table(("", "", "µs", *parts), shares, 2),
        f"**A step of one environment of a batch of {BATCH} on other filters**",
        markdown_table(("", "filter", "µs"), others, 2),
        f"**Prediction and update of a row: {STATES} states, {MEASUREMENTS} measurements**",
        markdown_table(heads, lines, 1),
    ))  # fmt: skip


OPTIONS = {
    "env_ids": "registered environments",
    "rows": "sizes of the batches of filters",
    "rounds": "blocks of each",
    "page": "Markdown page: what is printed also goes between its marks",
}


def main(
    env_ids: tuple[str, ...] = ENVIRONMENTS,
    /,
    rows: tuple[int, ...] = (1, 16, 256, 1024, 4096),
    rounds: int = 11,
    page: Path | None = None,
) -> None:
    """Time steps and filters on one core, beside filterpy and bare NumPy, in turns in short blocks."""
    from agents.studies.worlds import environment_id
    from studies.tables import around, put

    if find_spec("filterpy") is None:
        raise Refusal("the baselines need filterpy: pip install filterpy")
    with asked():
        for flag, size in (("--rounds", rounds), *(("--rows", size) for size in rows)):
            in_range(flag, size, 1)
        if page is not None:
            around(page, MARK)
        env_ids = tuple(map(environment_id, env_ids))
    text = report(env_ids, rows, rounds)
    print(text)
    if page is not None:
        put(page, MARK, text)


if __name__ == "__main__":
    command(main)
