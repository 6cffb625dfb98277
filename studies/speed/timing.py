"""Tables of `studies.speed`: everything is timed in turns, in short blocks, in one run."""

import json
import os
import platform
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import numpy as np

import vessel_gym
import vessel_gym.core
from agents.commands.console import asked, progress_bar
from agents.refusal import Refusal
from estimators import names
from studies.speed.baselines import (
    MEASUREMENTS,
    MEMBERS,
    STATES,
    HandWrittenLoop,
    filterpys,
    measurements,
    numpy_ensemble,
    numpy_flight,
    numpy_kalman,
    ours,
)
from studies.speed.cart_pole import CART_POLE
from studies.speed.flights import STEPS, Flight, units
from vessel_gym.core import Core
from vessel_gym.wrappers.vector import EstimatedObservation

CORVETTE = "ThesisCorvette-v0"
BATCH = 256


@dataclass(frozen=True, eq=False)
class Timed:
    """Something to time: ``block()`` does ``units`` of work and tells its seconds."""

    block: Callable[[], float]
    units: int


Cell = Timed | tuple[Timed, Timed] | Callable[[], str] | None
"""Microseconds a unit; the ratio of the first to the second; what was found meanwhile; nothing."""


@dataclass
class Table:
    """A printed table: a label and cells a line."""

    title: str
    headings: tuple[str, ...]
    lines: dict[str, tuple[Cell, ...]]
    note: str = ""

    def timed(self) -> list[Timed]:
        """The timed blocks of the table, each once, those that are compared first."""
        cells = [cell for line in self.lines.values() for cell in line]
        cells.sort(key=lambda cell: not isinstance(cell, tuple))
        parts = [part for cell in cells for part in (cell if isinstance(cell, tuple) else (cell,))]
        return list(dict.fromkeys(part for part in parts if isinstance(part, Timed)))

    def text(self, times: dict[Timed, np.ndarray]) -> str:
        """The table in Markdown."""
        rule = ("---", *("---:" for _ in self.headings))
        lines = [("", *self.headings), rule]
        lines += [
            (label, *(shown(cell, times) for cell in cells)) for label, cells in self.lines.items()
        ]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        drawn = ["| " + " | ".join(map(str.ljust, line, widths)) + " |" for line in lines]
        return "\n".join(
            [f"**{self.title}**", "", *drawn, "", *([self.note, ""] if self.note else [])]
        )


def measure(timed: list[Timed], rounds: int) -> dict[Timed, np.ndarray]:
    """Microseconds a unit ``(rounds,)`` of each: a block of all in turn, every other round in the reverse order."""
    times = defaultdict(list)
    with progress_bar("measuring", rounds + 1) as advance:
        for number in range(rounds + 1):  # the first warms up
            for one in timed[:: -1 if number % 2 else 1]:
                times[one].append(1e6 * one.block() / one.units)
            advance()
    return {one: np.array(values[1:]) for one, values in times.items()}


def shown(cell: Cell, times: dict[Timed, np.ndarray]) -> str:
    """The median and the quartiles; of a ratio, those of the ratios round by round."""
    if cell is None:
        return ""
    if not isinstance(cell, Timed | tuple):
        return cell()
    values = times[cell] if isinstance(cell, Timed) else times[cell[0]] / times[cell[1]]
    median, *ends = (f"{q:,.0f}" if q >= 100.0 else f"{q:.2g}" if q < 0.1 else f"{q:.3g}"
                     for q in np.quantile(values, (0.5, 0.25, 0.75)))  # fmt: skip
    return f"{median} [{', '.join(ends)}]"


def stepped(step: Callable[[np.ndarray], Any], rows: int, steps: int) -> Timed:
    """A filter's steps, or those of its arithmetic in NumPy."""
    given = measurements(steps, rows)

    def block() -> float:
        start = time.perf_counter()
        for y in given:
            step(y)
        return time.perf_counter() - start

    return Timed(block, rows * steps)


def flown(**description: Any) -> Timed:
    """A flight in this process."""
    with asked():
        return Timed(Flight(**description).block, units(**description))


class Lacking(Refusal):
    """A version does not have what it is asked for."""


class Worker:
    """A process that flies with the `vessel_gym` of a folder, block by block on demand.

    Raises:
        Refusal: if the folder holds none, it cannot be imported, or it has ended.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, home = folder, folder.resolve()
        path = os.pathsep.join(filter(None, (str(home), os.environ.get("PYTHONPATH"))))
        call = [sys.executable, "-P", str(Path(__file__).with_name("flights.py"))]
        self.process = subprocess.Popen(
            call,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": path},
        )
        try:
            where = self.ask("where")
            if not Path(where).resolve().is_relative_to(home):
                raise Refusal(
                    f"the vessel_gym in {folder} was asked for, but that in {where} is imported"
                )
        except Refusal:
            self.close()
            raise

    def ask(self, question: Any) -> Any:
        """The answer of `studies.speed.flights.serve`."""
        there, back = self.process.stdin, self.process.stdout
        assert there is not None
        assert back is not None
        try:
            print(json.dumps(question), file=there, flush=True)
            answer = json.loads(back.readline())
        except (BrokenPipeError, json.JSONDecodeError):
            raise Refusal(
                f"the process that flies with the vessel_gym in {self.folder} has ended"
            ) from None
        if isinstance(answer, dict):
            raise Lacking(f"the vessel_gym in {self.folder} cannot: {answer['error']}")
        return answer

    def flown(self, **description: Any) -> Timed:
        """A flight over there."""
        number = self.ask(description)
        return Timed(lambda: self.ask(number), units(**description))

    def close(self) -> None:
        """End the process."""
        self.process.communicate()


def loop_table(sizes: tuple[int, ...]) -> Table:
    """The corvette on a Kalman filter: by hand, ours, and its arithmetic in NumPy."""
    env, actions = HandWrittenLoop(seed=0), np.random.default_rng(0).uniform(-0.2, 0.2, STEPS)

    def fly() -> float:
        env.reset()
        start = time.perf_counter()
        for action in actions.tolist():
            env.step(action)
        return time.perf_counter() - start

    hand, plain = (
        Timed(fly, STEPS),
        {rows: stepped(numpy_flight(rows), rows, STEPS) for rows in (1, *sizes)},
    )
    lines: dict[str, tuple[Cell, ...]] = {
        "by hand: NumPy, filterpy": (hand, None, (hand, plain[1]))
    }
    for rows in (0, *sizes):
        one = flown(env_id=CORVETTE, rows=rows, estimator="kf")
        lines[f"batch of {rows:,}" if rows else "gymnasium.make"] = (
            one,
            (one, hand),
            (one, plain[rows or 1]),
        )
    default = flown(env_id=CORVETTE, rows=0)
    lines["gymnasium.make, its own filter"] = default, (default, hand), None
    return Table(
        f"{CORVETTE} on `kf`: a step of one environment", ("µs", "times by hand", "times bare NumPy"), lines,
        "Bare NumPy: equations of motion, the filter's equations and the normal numbers, as many environments at once, "
        "written by hand; without sea, actuators, measurements, task, observation, info, checks and Gymnasium.",
    )  # fmt: skip


def filter_tables(sizes: tuple[int, ...]) -> Iterator[Table]:
    """Prediction and update of a row: beside filterpy, by rows, by members."""
    plain = {
        "kf": stepped(numpy_kalman(1), 1, 100),
        "enkf": stepped(numpy_ensemble(1, MEMBERS), 1, 100),
    }
    lines: dict[str, tuple[Cell, ...]] = {}
    for name in ("kf", "ekf", "ukf", "enkf"):
        one, rival = stepped(ours(name, 1), 1, 100), stepped(filterpys(name), 1, 10)
        lines[name] = one, rival, (one, rival), (one, plain[name]) if name in plain else None
    size = f"{STATES} states, {MEASUREMENTS} measurements"
    yield Table(
        f"Filters: prediction and update of one row, {size}, {MEMBERS} members",
        ("µs", "filterpy, µs", "times filterpy", "times bare NumPy"), lines,
        "Bare NumPy: the filter's equations (of `enkf` with its normal numbers), written by hand without checks, "
        "missing measurements, angles and recovery; none is given where the cost is the model's.",
    )  # fmt: skip

    steps = {rows: max(2, 100 // rows) for rows in sizes}
    lines = {
        name: tuple(stepped(ours(name, rows), rows, steps[rows]) for rows in sizes)
        for name in names()
    }
    lines["kf in bare NumPy"] = tuple(
        stepped(numpy_kalman(rows), rows, steps[rows]) for rows in sizes
    )
    lines["enkf in bare NumPy"] = tuple(
        stepped(numpy_ensemble(rows, MEMBERS), rows, steps[rows]) for rows in sizes
    )
    yield Table(
        f"Filters by rows: µs a row, prediction and update, {size}, {MEMBERS} members",
        tuple(f"{rows:,} row{'s' if rows > 1 else ''}" for rows in sizes), lines, "Every row has its own covariance.",
    )  # fmt: skip

    lines = {}
    for members in (10, 30, 100, 300):
        cells: list[Cell] = []
        for rows in (1, BATCH):
            count = max(2, 100 // rows)
            one = stepped(ours("enkf", rows, members=members, draws="independent"), rows, count)
            cells += [one, (one, stepped(numpy_ensemble(rows, members), rows, count))]
        lines[f"{members} members"] = tuple(cells)
    headings = "one row, µs", "times bare NumPy", f"{BATCH} rows, µs a row", "times bare NumPy"
    yield Table(f"`enkf` by members: prediction and update of a row, {size}", headings, lines)


def flight_plan(env_ids: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """Flights by label: every environment, its default estimator and others, batches, resets, lost measurements."""
    plan: dict[str, dict[str, Any]] = {}
    for env_id in env_ids:
        plan[env_id] = {"rows": 0}
        plan[batch := f"{env_id}, batch of {BATCH}"] = {"rows": BATCH}
        plan[f"{batch}, degraded sensors"] = {"rows": BATCH, "sensors": "degraded"}
        if env_id == CORVETTE:
            plan |= {
                f"{env_id}, batch of {rows:,}": {"rows": rows}
                for rows in (1, 4 * BATCH, 16 * BATCH)
            }
            plan |= {
                f"{batch}, {name}": {"rows": BATCH, "estimator": name}
                for name in ("kf", "ekf", "ukf")
            }
            plan[f"{batch}, scattered resets"] = {"rows": BATCH, "kind": "scattered"}
            plan[f"{batch}: a reset of one"] = {"rows": BATCH, "kind": "resets"}
        elif env_id == "SegorogeniAUV-v0":
            plan[f"{batch}, ekf"] = {"rows": BATCH, "estimator": "ekf"}
        for description in plan.values():
            description.setdefault("env_id", env_id)
    return plan


def flight_table(env_ids: tuple[str, ...], this: Worker | None, that: Worker | None) -> Table:
    """Flights with this version, beside those with that of a folder."""
    lines: dict[str, tuple[Cell, ...]] = {}
    refused = []
    for label, description in flight_plan(env_ids).items():
        one = flown(**description) if this is None else this.flown(**description)
        lines[label] = (one,)
        if that is not None:
            try:
                other = that.flown(**description)
                lines[label] = one, other, (one, other)
            except Lacking:
                lines[label] = one, None, None
                refused.append(label)
    headings = ("µs",) if that is None else ("this, µs", "that, µs", "this / that")
    title = "Flights: a step of one environment" + (
        f", beside the vessel_gym in {that.folder}" if that else ""
    )
    return Table(
        title, headings, lines, f"That version has no {'; '.join(refused)}." if refused else ""
    )


def balanced(rows: int, estimator: str | None = None, in_numpy: bool = False) -> Timed:
    """Steps of Gymnasium's own batch of cart-poles under random actions, by itself or behind an estimator.

    With ``in_numpy`` the filter's formulas are computed by NumPy, as the tests' reference is.
    """
    env: Any = gym.make_vec("CartPole-v1", num_envs=rows, vectorization_mode="vector_entry_point")
    if estimator is not None:
        native = env
        env = EstimatedObservation(
            env, state=lambda *_: native.unwrapped.state.T, estimator=estimator, **CART_POLE
        )
        if in_numpy:
            env.watch.filter.compiled = False
    actions = np.random.default_rng(0).integers(0, 2, (STEPS, rows))

    def block() -> float:
        env.reset(seed=0)
        start = time.perf_counter()
        for action in actions:
            env.step(action)
        return time.perf_counter() - start

    return Timed(block, rows * STEPS)


def asked_at_points(rows: int) -> Timed:
    """Evaluations of the cart-pole's model in a step of an unscented filter: its functions at all sigma points."""
    model: Any = CART_POLE["model"]
    points, u = np.zeros((rows, 2 * model.n + 1, model.n)), np.zeros((rows, 1, 1))
    return stepped(
        lambda _: (model.transition(points, u), model.measurement(points, u)), rows, STEPS
    )


def third_party_table(sizes: tuple[int, ...]) -> Table:
    """Gymnasium's cart-poles behind a batched filter: compiled, by NumPy, and without one."""
    lines: dict[str, tuple[Cell, ...]] = {}
    for rows in sizes:
        fast, slow = balanced(rows, "ukf"), balanced(rows, "ukf", in_numpy=True)
        rest = balanced(rows), balanced(rows, "truth"), asked_at_points(rows)
        lines[f"batch of {rows:,}"] = fast, slow, (slow, fast), *rest
    return Table(
        "CartPole-v1, Gymnasium's own batch, behind a `ukf`: µs a step of one environment",
        ("`ukf`", "`ukf` by NumPy", "NumPy / compiled", "no wrapper", "the oracle", "the model's functions"), lines,
        "The oracle: all of the wrapper but a filter; the model's functions: NumPy, as the user has written them, at "
        "the points of one step.",
    )  # fmt: skip


class Clock:
    """Time of a flight's steps in each part of `Core.step`, calls included, and around it."""

    PARTS = "world", "filter", "task", "observation", "info", "the rest"

    def __init__(self, flight: Flight) -> None:
        self.flight, self.core, self.inside = flight, flight.env.unwrapped.core, False
        self.shares: dict[str, list[float]] = {part: [] for part in self.PARTS}

    def block(self) -> float:
        """Fly a block, and keep its parts' shares."""
        core, self.spent = self.core, dict.fromkeys(self.PARTS, 0.0)
        timed: dict[str, list[tuple[Any, str]]] = {
            "world": [(Core, "_moved")], "filter": [(type(core.filter), "step")], "task": [(Core, "_scored")],
            "observation": [(Core, "observe")], "info": [(Core, "happened"), (Core, "info")],
        }  # fmt: skip
        self.flight.prepare()
        with ExitStack() as stack:
            for part, methods in timed.items():
                for owner, name in methods:
                    stack.enter_context(
                        patch.object(owner, name, self.around(part, getattr(owner, name)))
                    )
            seconds = self.flight.fly()
        self.spent["the rest"] = seconds - sum(self.spent.values())
        for part, spent in self.spent.items():
            self.shares[part].append(spent / seconds)
        return seconds

    def around(self, part: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """A method that tells its time."""

        def timed(*args: Any, **named: Any) -> Any:
            if self.inside:
                return method(*args, **named)
            self.inside, start = True, time.perf_counter()
            try:
                return method(*args, **named)
            finally:
                self.spent[part] += time.perf_counter() - start
                self.inside = False

        return timed

    def share(self, part: str) -> Callable[[], str]:
        """A part's share, once it is known."""
        return lambda: f"{100.0 * np.median(self.shares[part][1:]):.0f} %"


def where_table(env_ids: tuple[str, ...]) -> Table:
    """Shares of the time of a step by part, in one environment and in a batch."""
    lines: dict[str, tuple[Cell, ...]] = {}
    for env_id in env_ids:
        for rows in (0, BATCH):
            plain, clock = flown(env_id=env_id, rows=rows), Clock(Flight(env_id, rows))
            clocked = Timed(clock.block, plain.units)
            label = f"{env_id}, batch of {rows}" if rows else env_id
            lines[label] = plain, *(clock.share(part) for part in Clock.PARTS), (clocked, plain)
    headings = "µs", *Clock.PARTS, "times with the clock"
    return Table("Where a step's time goes, on default estimators", headings, lines)


def machine() -> str:
    """The machine and its libraries."""
    found = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    wide = ", AVX-512" if any(name.startswith(("AVX512", "X86_V4")) for name in found) else ""
    threads = os.environ.get("OPENBLAS_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "not set"))
    versions = ", ".join(
        f"{name} {version(name)}" for name in ("numpy", "llvmlite", "gymnasium", "filterpy")
    )
    return (
        f"{os.cpu_count()} cores{wide}, BLAS threads: {threads}, Python"
        f" {platform.python_version()}, {versions}"
    )


def report(
    env_ids: tuple[str, ...],
    what: tuple[str, ...],
    against: Path | None,
    rows: tuple[int, ...],
    rounds: int,
) -> str:
    """Build, measure and write all tables."""
    with ExitStack() as stack:
        this = that = None
        if against is not None and "flights" in what:
            this, that = Worker(Path(vessel_gym.__file__).parents[1]), Worker(against)
            stack.callback(this.close)
            stack.callback(that.close)
        tables = [loop_table(rows)] if "loop" in what else []
        tables += filter_tables(rows) if "filters" in what else []
        tables += [flight_table(env_ids, this, that)] if "flights" in what else []
        tables += [where_table(env_ids)] if "where" in what else []
        tables += [third_party_table(rows)] if "third-party" in what else []
        times = measure([timed for table in tables for timed in table.timed()], rounds)
    note = f"Median [quartiles] of {rounds} rounds; {machine()}."
    return "\n".join([note, "", *(table.text(times) for table in tables)]).strip()
