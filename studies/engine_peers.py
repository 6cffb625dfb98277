# /// script
# requires-python = ">=3.11"
# dependencies = [
#     "numpy==2.4.6", "scipy==1.17.1", "llvmlite==0.50.0", "gymnasium==1.4.0", "rich==15.0.0",
#     "numba==0.68.1", "casadi==3.8.2", "jax==0.10.2", "heyoka==7.13.2",
# ]
# ///
"""One step of an extended Kalman filter in our engine, Numba, CasADi, JAX and heyoka.

``python -m tests.own_environment studies/engine_peers.py`` installs them in an environment of its
own, checks that all compute the same, and prints a table, which ``--page`` also writes to a page.
"""

import math
import os
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi
import heyoka
import jax
import jax.numpy as jnp
import numba
import numpy as np

from agents.commands.console import command
from agents.page import markdown_table
from estimators.engine import compiled, jacobian
from studies.corvette_filter import (
    DT,
    INPUTS,
    OUTPUTS,
    ekf_step,
    own_sine,
    random_inputs,
    rates,
)
from studies.markdown import measured_on, publish
from studies.scalars import Lines, Scalar, forward, operations, vector
from studies.speed import measure, quartiles, time_block

Prepare = Callable[[np.ndarray], Callable[[], np.ndarray]]
"""Function of inputs ``(rows, 81)`` that returns a call; the call returns ``(rows, 72)``."""
ROWS, MARK = 256, "engines"
"""Rows of the batch, and the mark of the table on a page."""


def values(numbers: Any, convert: Callable[[float], Any] = float) -> list[Any]:
    """Numbers of a library; those that do not depend on an input are converted to its type."""
    return [each.value if isinstance(each, Scalar) else convert(each) for each in numbers]


def ours() -> Prepare:
    """Our engine on the plain NumPy function."""

    def linearise(function: Any, x: Any, rudder: Any) -> Any:
        value = function(x, rudder)
        return value, jacobian(value, x)

    step = compiled(lambda row: ekf_step(row, linearise))
    return lambda rows: partial(step, rows)


def by_numba() -> Prepare:
    """Numba on straight code with a forward-mode Jacobian, in a loop over rows."""
    lines = Lines("z, out")
    row = vector([Scalar(f"z[{index}]", lines) for index in range(INPUTS)])
    found = values(ekf_step(row, forward), str)
    select = numba.njit(lambda mask, a, b: a if mask else b)
    names = operations(math, where=select, absolute=abs, maximum=max)
    last = "\n    ".join(f"out[{index}] = {name}" for index, name in enumerate(found))
    one = numba.njit(lines.function(last, names), error_model="numpy")

    @numba.njit
    def step(rows: Any) -> Any:
        out = np.empty((len(rows), OUTPUTS))
        for index in range(len(rows)):
            one(rows[index], out[index])
        return out

    return lambda rows: partial(step, rows)


def by_casadi() -> Prepare:
    """CasADi on scalar expressions (SX), called without copies."""
    names = operations(casadi, where=casadi.if_else, absolute=casadi.fabs, maximum=casadi.fmax)
    inputs = casadi.SX.sym("z", INPUTS)
    row = vector([Scalar(inputs[index], names) for index in range(INPUTS)])
    found = casadi.vertcat(*values(ekf_step(row, forward), casadi.SX))
    one = casadi.Function("step", [inputs], [found], {"cse": True})

    def prepare(rows: np.ndarray) -> Callable[[], np.ndarray]:
        buffer, step = (one if len(rows) == 1 else one.map(len(rows), "serial")).buffer()
        inputs, out = rows.copy(), np.zeros((len(rows), OUTPUTS))
        buffer.set_arg(0, inputs.data)
        buffer.set_res(0, out.data)

        return lambda: (step(), buffer, inputs, out)[-1]  # which keeps them in memory

    return prepare


def by_heyoka() -> Prepare:
    """Expressions of heyoka; rows are the columns of its arrays."""

    def number(value: Any) -> Any:
        return value if isinstance(value, heyoka.expression) else heyoka.expression(value)

    def of_numbers(operation: Any) -> Any:
        return lambda *operands: operation(*map(number, operands))

    zero = number(0.0)
    names = operations(
        heyoka,
        where=of_numbers(heyoka.select),
        greater=of_numbers(heyoka.gt),
        less=of_numbers(heyoka.lt),
        greater_equal=of_numbers(heyoka.gte),
        less_equal=of_numbers(heyoka.lte),
        absolute=lambda a: heyoka.select(heyoka.lt(a, zero), -a, a),
        maximum=lambda a, _: heyoka.relu(a),  # it has no maximum; the other operand is 0
    )

    inputs = heyoka.make_vars(*(f"z{index}" for index in range(INPUTS)))
    row = vector([Scalar(each, names) for each in inputs])
    found = values(ekf_step(row, forward), number)
    step = heyoka.cfunc(found, vars=inputs)

    def prepare(rows: np.ndarray) -> Callable[[], np.ndarray]:
        inputs = rows[0].copy() if len(rows) == 1 else rows.T.copy()
        out = np.zeros((OUTPUTS, *inputs.shape[1:]))
        return lambda: step(inputs=inputs, outputs=out).T

    return prepare


def by_jax() -> Prepare:
    """JAX on matrices: stages by ``scan``, Jacobian by ``jacfwd``, rows by ``vmap``."""
    jax.config.update("jax_enable_x64", True)
    names = operations(jnp)
    stages = DT * jnp.array([[0.0, 1 / 6], [1 / 2, 1 / 3], [1 / 2, 1 / 3], [1.0, 1 / 6]])

    def moved(x: Any, rudder: Any) -> Any:
        def stage(carried: Any, weights: Any) -> Any:
            k, total = carried
            at = vector([Scalar(each, names) for each in x + weights[0] * k])
            k = jnp.stack(values(rates(at, vector([Scalar(rudder[0], names)])), jnp.asarray))
            return (k, total + weights[1] * k), None

        (_, total), _ = jax.lax.scan(stage, (0.0 * x, 0.0 * x), stages)
        return x + total, x + total

    def linearise(function: Any, x: Any, rudder: Any) -> Any:
        slopes, value = jax.jacfwd(moved, has_aux=True)(x, rudder)
        return value, slopes

    one = partial(ekf_step, linearise=linearise, xp=jnp)
    alone, batch = jax.jit(lambda rows: one(rows[0])[None]), jax.jit(jax.vmap(one))
    return lambda rows: lambda: np.asarray((alone if len(rows) == 1 else batch)(rows))


LIBRARIES = {"ours": ours, "Numba": by_numba, "CasADi": by_casadi, "JAX": by_jax,
             "heyoka": by_heyoka}  # fmt: skip


def pendulum(x: np.ndarray) -> np.ndarray:
    """An equation of motion in NumPy, as in docs/engine.md."""
    angle, rate = np.moveaxis(x, -1, 0)
    return np.stack([rate, -9.81 * np.sin(angle) - 0.1 * rate * np.abs(rate)], -1)


def guarded(x: np.ndarray) -> np.ndarray:
    """A quotient whose divisor is guarded, and a limit."""
    speed = x[..., 0]
    return np.where(speed > 0, 1 / np.where(speed > 0, speed, 1), 0) + np.clip(x[..., 1], -1, 1)


def ranged(x: np.ndarray) -> np.ndarray:
    """A table and a distance."""
    return np.interp(x[..., 0], [0.0, 1.0, 2.0], [0.0, 2.0, 3.0]) + np.linalg.norm(x, axis=-1)


def taken(library: str) -> int:
    """Number of the three functions that a library takes as they stand."""
    casadi.GlobalOptions.setNumpyMode(1)  # NumPy's functions on its expressions
    x = np.ones(2)
    takes: dict[str, Callable[[Any], Any]] = {
        "ours": lambda function: compiled(function)(x),
        "Numba": lambda function: numba.njit(function)(x),
        "CasADi": lambda function: function(casadi.SX.sym("x", 1, 2)),
        "JAX": lambda function: jax.jit(function)(x),
        "heyoka": lambda function: function(np.array(heyoka.make_vars("a", "b"))),
    }
    count = 0
    for function in (pendulum, guarded, ranged):
        try:
            takes[library](function)
        except Exception:  # each library has its own errors
            continue
        count += 1
    return count


def block(call: Callable[[], Any], rows: int) -> Callable[[], float]:
    """A block of calls for some rows."""
    return partial(time_block, lambda _: call(), range(500 // rows + 20), rows)


def checked(name: str, rows: np.ndarray, expected: np.ndarray | None) -> tuple[np.ndarray, Any]:
    """Results of rows, and what is measured once: start, equal bits and functions taken.

    Raises:
        AssertionError: if the results differ from those expected.
    """
    start = time.process_time()
    prepare = LIBRARIES[name]()
    prepare(rows[:1])()
    step = prepare(rows)
    batch = np.array(step())
    spent = time.process_time() - start
    if expected is not None:
        scale = np.abs(expected).max(0)
        np.testing.assert_allclose(batch / scale, expected / scale, 1e-9, 1e-9, err_msg=name)
    alone = [np.array(prepare(rows[i : i + 1])()).ravel() for i in range(len(rows))]
    same = sum(map(np.array_equal, alone, batch))
    blocks = {(name, len(few)): block(prepare(few), len(few)) for few in (rows[:1], rows)}
    return batch, (blocks, (f"{spent:.1f}", f"{same} of {len(rows)}", f"{taken(name)} of 3"))


def report(rounds: int) -> str:
    """Table of the libraries, timed in one run."""
    rows, expected, facts = random_inputs(ROWS), None, {}
    blocks: dict[Any, Callable[[], float]] = {}
    for name in LIBRARIES:
        batch, (timed, facts[name]) = checked(name, rows, expected)
        expected = batch if expected is None else expected
        blocks |= timed
    found = measure(blocks, rounds)
    lines = [
        (f"{name} {version(name)}" if name != "ours" else name,
         *(quartiles(found[name, count]) for count in (1, ROWS)), *facts[name])
        for name in LIBRARIES
    ]  # fmt: skip
    heads = "", "1 row", f"{ROWS} rows", "start [s]", "same bits alone", "functions taken"
    method = f"CPU time of a row [µs]: median [quartiles] of {rounds} rounds. {measured_on()}"
    return f"{method}\n\n{markdown_table(heads, lines, 1)}"


OPTIONS = {"rounds": "blocks of each library", "page": "Markdown page that also gets the table"}


def main(rounds: int = 11, page: Path | None = None) -> None:
    """Time a step of a filter in our engine and in other compilers, in short turns."""
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    with own_sine(), TemporaryDirectory() as empty:
        os.environ["VESSEL_GYM_CACHE"] = empty  # our start is a cold one, too
        publish(partial(report, rounds), page, MARK)


if __name__ == "__main__":
    command(main)
