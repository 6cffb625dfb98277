# /// script
# requires-python = ">=3.11"
# dependencies = [
#     "numpy==2.4.6", "scipy==1.17.1", "llvmlite==0.50.0", "gymnasium==1.4.0", "rich==15.0.0",
#     "casadi==3.8.2", "jax==0.10.2", "heyoka==7.13.2", "numba==0.68.1",
#     "drjit==1.5.0",
# ]
# ///
"""One step of an extended Kalman filter in our engine and in its peers.

``python -m tests.own_environment studies/engine_peers.py`` installs them in an environment of its
own, checks that all compute the same, and prints a table, which ``--page`` also writes to a page.

The filter follows a ship: position north, east [m], heading [rad], surge, sway [m/s], yaw rate
[rad/s] and current north, east [m/s]. Compass, rate gyro and two coordinates of a receiver are
measured. Its equations take the functions of NumPy, or of a library that has the same names. Numba
and Dr.Jit, which give no Jacobian, get the instructions that our engine traces from them.
"""

import operator
import os
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np

from agents.commands.console import command
from agents.page import markdown_table
from estimators.engine import Argument, compiled, jacobian, trace
from studies.lorenz import rk4
from studies.markdown import measured_on, publish
from studies.speed import measure, quartiles, time_block

STATES, MEASURED, DT = 8, (2, 5, 0, 1), 0.5
"""Number of states, measured states, and step [s]."""
Q = np.diag([0.04, 0.04, 1e-8, 9e-4, 1.6e-3, 3.6e-7, 6.4e-4, 6.4e-4])
R = np.array([4e-6, 4e-6, 4.0, 4.0])
"""Covariance of process noise, and variances of the sensors."""
OUTPUTS = STATES + STATES**2
INPUTS = OUTPUTS + 1 + 2 * len(MEASURED)
"""Mean and covariance of a row; and with rudder, measurements and mask, one after the other."""
ROWS, MARK = 256, "engines"
"""Rows of the batch, and the mark of the table on a page."""

Prepare = Callable[[np.ndarray], Callable[[], np.ndarray]]
"""Function of inputs ``(rows, 81)`` that returns a call; the call returns ``(rows, 72)``."""


def rates(x: Any, rudder: Any, m: Any) -> Any:
    """Rates ``(8,)`` of a ship's state under a rudder angle [rad]; the current decays."""
    heading, surge, sway, yaw_rate = (x[i] for i in range(2, 6))
    sin, cos, lift = m.sin(heading), m.cos(heading), surge * surge * m.sin(rudder)
    return m.stack([
        surge * cos - sway * sin + x[6],
        surge * sin + sway * cos + x[7],
        yaw_rate,
        4e-4 * (225.0 - surge * surge) + sway * yaw_rate,
        4e-4 * lift - 4e-3 * surge * sway - 0.3 * surge * yaw_rate,
        -3e-5 * lift - 1e-4 * surge * sway - 0.012 * surge * yaw_rate,
        -0.01 * x[6],
        -0.01 * x[7],
    ])  # fmt: skip


def transition(x: Any, rudder: Any, m: Any) -> Any:
    """State ``(8,)`` after a step by the classical Runge-Kutta method."""
    return rk4(lambda x: rates(x, rudder, m), x, DT, 1)


def ekf_step(row: Any, m: Any, linearise: Callable[..., Any]) -> Any:
    """Mean and covariance ``(72,)`` after prediction and update, one sensor after the other.

    Args:
        row: ``(81,)``, see `INPUTS`. The mask is 1 where a sensor has measured, otherwise 0.
        m: NumPy, or a module with its functions.
        linearise: ``linearise(function, x)`` returns the value and its Jacobian.
    """
    cov, (y, available) = row[STATES:OUTPUTS], (row[OUTPUTS + 1 : -4], row[-4:])
    x, A = linearise(lambda x: transition(x, row[OUTPUTS], m), row[:STATES])
    P = A @ cov.reshape((STATES, STATES)) @ A.T + Q
    for i, state in enumerate(MEASURED):
        PC = P[:, state]
        K = available[i] * PC / (PC[state] + R[i])
        x = x + K * (y[i] - x[state])
        P = P - m.outer(K, PC)
    P = 0.5 * (P + P.T)
    return m.concatenate([x, *(P[:, i] for i in range(STATES))])


def random_inputs(rows: int) -> np.ndarray:
    """Inputs ``(rows, 81)`` of steps in a turn; every other row lacks the receiver."""
    rng = np.random.default_rng(0)
    sd = np.array([1.0, 1.0, 1e-3, 0.1, 0.1, 1e-3, 0.15, 0.13])
    mean = [300.0, 50.0, 0.2, 15.0, -0.5, 0.01, -0.1, 0.1] + sd * rng.normal(size=(rows, STATES))
    cov = rng.uniform(0.5, 2.0, (rows, 1, 1)) * (0.8 * np.eye(STATES) + 0.2) * np.outer(sd, sd)
    y = mean[:, MEASURED] + 3.0 * np.sqrt(R) * rng.normal(size=(rows, len(MEASURED)))
    available = np.ones_like(y)
    available[1::2, 2:] = 0.0
    return np.hstack([mean, cov.reshape(rows, -1), rng.uniform(-0.3, 0.3, (rows, 1)), y, available])


def plain_step(row: Any) -> Any:
    """The step in NumPy's functions, with the Jacobian of our engine, to be traced."""

    def linearise(function: Any, x: Any) -> Any:
        value = function(x)
        return value, jacobian(value, x)

    return ekf_step(row, np, linearise)


def ours() -> Prepare:
    """Our engine."""
    step = compiled(plain_step)
    return lambda rows: partial(step, rows)


def written_out(m: Any) -> Callable[[Any, Any], None]:
    """The instructions of our trace as a Python function of a row and of what it gets.

    Args:
        m: NumPy, or a module with its functions.
    """
    traced = trace(plain_step, [Argument((INPUTS,))])
    lines = [f"v{value} = {float(x)!r}" for value, x in traced.program.constants.items()]
    for opcode, operands, result, place in traced.instructions:
        given = ", ".join(f"v{value}" for value in operands)
        lines.append(f"v{result} = " + (f"row[{place[1]}]" if place else f"m.{opcode}({given})"))
    lines += [f"out[{j}] = v{value}" for j, value in enumerate(traced.outputs[0])]
    space: dict[str, Any] = {"m": m}
    exec("\n ".join(["def step(row, out):", *lines]), space)
    return space["step"]


def by_numba() -> Prepare:
    """Numba, which has no derivatives, on the instructions of our trace, in a loop over rows."""
    import numba

    one = numba.njit(written_out(np), error_model="numpy")

    @numba.njit
    def step(rows: np.ndarray, out: np.ndarray) -> np.ndarray:
        for i in range(len(rows)):
            one(rows[i], out[i])
        return out

    return lambda rows: partial(step, rows.copy(), np.zeros((len(rows), OUTPUTS)))


def by_drjit() -> Prepare:
    """Dr.Jit, whose derivatives are by one input at a time, on the instructions of our trace.

    It loads LLVM's shared library, which it does not install.
    """
    import drjit
    from drjit.llvm import Float64

    m = SimpleNamespace(
        add=operator.add, subtract=operator.sub, multiply=operator.mul, divide=operator.truediv,
        negative=operator.neg, sin=drjit.sin, cos=drjit.cos,
    )  # fmt: skip
    one = written_out(m)

    @drjit.freeze
    def step(columns: list[Any]) -> Any:
        out = [Float64()] * OUTPUTS
        one(columns, out)
        return drjit.concat(out)

    drjit.set_thread_count(0)

    def prepare(rows: np.ndarray) -> Callable[[], np.ndarray]:
        columns = [Float64(column) for column in rows.T.copy()]
        return lambda: np.array(step(columns)).reshape(OUTPUTS, -1).T

    return prepare


def by_casadi() -> Prepare:
    """CasADi on scalar expressions (SX), called without copies."""
    import casadi

    def linearise(function: Any, x: Any) -> Any:
        value = function(x)
        return value, casadi.jacobian(value, x)

    def join(parts: list[Any]) -> Any:
        return casadi.vertcat(*parts)

    names = {"sin": casadi.sin, "cos": casadi.cos, "stack": join, "concatenate": join}
    m = SimpleNamespace(outer=lambda a, b: a @ b.T, **names)
    row = casadi.SX.sym("row", INPUTS)
    one = casadi.Function("step", [row], [ekf_step(row, m, linearise)], {"cse": True})

    def prepare(rows: np.ndarray) -> Callable[[], np.ndarray]:
        buffer, step = (one if len(rows) == 1 else one.map(len(rows), "serial")).buffer()
        inputs, out = rows.copy(), np.zeros((len(rows), OUTPUTS))
        buffer.set_arg(0, inputs.data)
        buffer.set_res(0, out.data)
        return lambda: (step(), buffer, inputs, out)[-1]  # which keeps them in memory

    return prepare


def by_jax() -> Prepare:
    """JAX in double precision, with rows by ``vmap``."""
    import jax

    jax.config.update("jax_enable_x64", True)

    def linearise(function: Any, x: Any) -> Any:
        slopes, value = jax.jacfwd(lambda x: (function(x),) * 2, has_aux=True)(x)
        return value, slopes

    step = jax.jit(jax.vmap(partial(ekf_step, m=jax.numpy, linearise=linearise)))
    return lambda rows: lambda: np.asarray(step(rows))


def by_heyoka() -> Prepare:
    """Expressions of heyoka; rows are the columns of its arrays."""
    import heyoka

    def linearise(function: Any, x: Any) -> Any:
        value = function(x)
        return value, heyoka.diff_tensors([*value], diff_args=[*x]).jacobian

    m = SimpleNamespace(
        sin=heyoka.sin, cos=heyoka.cos, stack=np.stack, concatenate=np.concatenate, outer=np.outer
    )
    row = np.array(heyoka.make_vars(*(f"z{index}" for index in range(INPUTS))))
    step = heyoka.cfunc([*ekf_step(row, m, linearise)], vars=[*row])

    def prepare(rows: np.ndarray) -> Callable[[], np.ndarray]:
        inputs = rows[0].copy() if len(rows) == 1 else rows.T.copy()
        out = np.zeros((OUTPUTS, *inputs.shape[1:]))
        return lambda: step(inputs=inputs, outputs=out).T

    return prepare


LIBRARIES = {
    "ours": ours, "Numba": by_numba, "CasADi": by_casadi, "JAX": by_jax, "heyoka": by_heyoka,
    "drjit": by_drjit,
}  # fmt: skip


def prepared(name: str, rows: np.ndarray) -> tuple[np.ndarray, Any, tuple[str, str]]:
    """Results of rows, timed blocks of one row and of all, and in words start and equal bits."""
    start = time.process_time()
    prepare = LIBRARIES[name]()
    prepare(rows[:1])()
    step = prepare(rows)
    batch = np.array(step())
    spent = time.process_time() - start
    alone = [np.array(prepare(rows[i : i + 1])()).ravel() for i in range(len(rows))]
    same = sum(map(np.array_equal, alone, batch))

    def block(few: np.ndarray) -> Callable[[], float]:
        call = prepare(few)
        return partial(time_block, lambda _: call(), range(500 // len(few) + 20), len(few))

    blocks = {(name, len(few)): block(few) for few in (rows[:1], rows)}
    return batch, blocks, (f"{spent:.1f}", f"{same} of {len(rows)}")


def report(rounds: int) -> str:
    """Table of the libraries, timed in one run.

    Raises:
        AssertionError: if the results of two libraries differ.
    """
    rows, batches, blocks, facts = random_inputs(ROWS), {}, dict[Any, Any](), {}
    for name in LIBRARIES:
        batches[name], timed, facts[name] = prepared(name, rows)
        blocks |= timed
    expected = batches["ours"]
    scale = np.abs(expected).max(0)
    for name, batch in batches.items():
        np.testing.assert_allclose(batch / scale, expected / scale, 1e-9, 1e-9, err_msg=name)
    found = measure(blocks, rounds)
    lines = [
        (name if name == "ours" else f"{name} {version(name)}",
         *(quartiles(found[name, count]) for count in (1, ROWS)), *facts[name])
        for name in LIBRARIES
    ]  # fmt: skip
    heads = "", "1 row", f"{ROWS} rows", "start [s]", "same bits alone"
    method = f"CPU time of a row [µs]: median [quartiles] of {rounds} rounds. {measured_on()}"
    return f"{method}\n\n{markdown_table(heads, lines, 1)}"


OPTIONS = {"rounds": "blocks of each library", "page": "Markdown page that also gets the table"}


def main(rounds: int = 11, page: Path | None = None) -> None:
    """Time a step of a filter in our engine and in other compilers, in short turns."""
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    with TemporaryDirectory() as empty:
        os.environ["VESSEL_GYM_CACHE"] = empty  # our start is a cold one, too
        publish(partial(report, rounds), page, MARK)


if __name__ == "__main__":
    command(main)
