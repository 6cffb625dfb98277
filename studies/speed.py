"""Time of steps and filters, beside filterpy and bare NumPy: ``python -m studies.speed``."""

import time
from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.commands.console import asked, command, progress
from agents.page import markdown_table
from agents.refusal import Refusal
from estimators import names
from studies.baselines import MEASUREMENTS, NONLINEAR, STATES, Step, filterpys, numpy_kalman, ours
from studies.markdown import measured_on, publish

ENVIRONMENTS = "SigmaCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0"
STEPS, BATCH, MARK = 64, 256, "measured"
"""Steps of a block, environments of a batch, and the mark of the tables on a page."""


def time_block(step: Callable[[Any], Any], inputs: Any, rows: int) -> float:
    """CPU time of a row [µs] in a block: a step for each of the inputs."""
    start = time.process_time()
    for each in inputs:
        step(each)
    return 1e6 * (time.process_time() - start) / (rows * len(inputs))


def filter_block(step: Step, rows: int) -> Callable[[], float]:
    """A block of steps of a filter."""
    inputs = np.random.default_rng(1).normal(size=(max(2, 100 // rows), rows, MEASUREMENTS))
    return partial(time_block, step, inputs, rows)


def environment_block(env_id: str, rows: int = 0) -> Callable[[], float]:
    """A block of steps of an environment, or of a native batch, under small random actions."""
    options: dict[str, Any] = {"num_envs": rows, "vectorization_mode": "vector_entry_point"}
    env: Any = gym.make_vec(env_id, **options) if rows else gym.make(env_id)
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (STEPS, *env.action_space.shape))
    actions = actions.astype(env.action_space.dtype)

    def block() -> float:
        env.reset(seed=0)  # not timed
        return time_block(env.step, actions, max(rows, 1))

    return block


def measure(blocks: Mapping[Any, Callable[[], Any]], rounds: int) -> dict[Any, np.ndarray]:
    """Results of blocks by round: all in turn, every other round in the reverse order."""
    found: dict[Any, list[Any]] = {key: [] for key in blocks}
    with progress("measuring") as show:
        for number in range(rounds + 1):
            for key in [*blocks][:: -1 if number % 2 else 1]:
                found[key].append(blocks[key]())
            show(number + 1, rounds + 1)
    return {key: np.array(each[1:]) for key, each in found.items()}  # the first warms up


def quartiles(values: np.ndarray) -> str:
    """Median and quartiles."""
    median, *ends = (f"{q:,.0f}" if q >= 100.0 else f"{q:.3g}"
                     for q in np.quantile(values, (0.5, 0.25, 0.75)))  # fmt: skip
    return f"{median} [{', '.join(ends)}]"


def labels() -> dict[str, tuple[str, bool]]:
    """Name of each filter by its label in the table; is its model NumPy that is not compiled?"""
    linear = {name: (name, False) for name in names() if name not in NONLINEAR}
    return linear | {
        f"{name}, {'NumPy' if plain else 'compiled'} model": (name, plain)
        for name in NONLINEAR
        for plain in (False, True)
    }


def report(env_ids: tuple[str, ...], rows: tuple[int, ...], rounds: int) -> str:
    """Tables of environments and of filters, by rows, timed in one run."""
    filters = {
        (label, size): filter_block(ours(name, size, plain), size)
        for label, (name, plain) in labels().items()
        for size in rows
    }
    for name in ("kf", "ekf", "ukf"):
        filters[f"{name} of filterpy", 1] = filter_block(filterpys(name), 1)
    filters |= {("kf in bare NumPy", size): filter_block(numpy_kalman(size), size) for size in rows}
    sizes = 0, BATCH
    steps = {(name, size): environment_block(name, size) for name in env_ids for size in sizes}
    found = {at: quartiles(values) for at, values in measure(steps | filters, rounds).items()}
    steps_of = [(f"`{name}`", *(found[name, size] for size in sizes)) for name in env_ids]
    lines = [
        (name, *(found.get((name, size), "") for size in rows))
        for name in dict.fromkeys(name for name, _ in filters)
    ]
    heads = "", *(f"{size:,} system{'s' if size > 1 else ''}" for size in rows)
    return "\n\n".join((
        f"CPU time [µs]: median [quartiles] of {rounds} rounds. {measured_on()}",
        "**A step of one environment on its default estimator**",
        markdown_table(("", "alone", f"in a batch of {BATCH}"), steps_of, 1),
        f"**Prediction and update for each system: {STATES} states, {MEASUREMENTS} measurements**",
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
    rows: tuple[int, ...] = (1, 256),
    rounds: int = 11,
    page: Path | None = None,
) -> None:
    """Time steps and filters on one core, beside filterpy and bare NumPy, in short turns."""
    from agents.studies.worlds import environment_id

    if find_spec("filterpy") is None:
        raise Refusal("the baselines need filterpy: pip install filterpy")
    with asked():
        env_ids = tuple(map(environment_id, env_ids))
    publish(partial(report, env_ids, rows, rounds), page, MARK)


if __name__ == "__main__":
    command(main)
