"""Random formulas of matrices, valid and invalid: traced, they mean what NumPy means, or are refused.

python -m tests.estimators.engine.random_matrices 10000 0

Each formula is a row of words on given arrays, masks, constants and earlier results. A word that is accepted while it
is traced must be one that NumPy accepts, with the same shape and type a row, for whatever leading axes; at the end all
results are computed by both. Rounding may differ as far as relative noise of 1e-13 on every result of NumPy's goes.
"""

import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np

from estimators.engine import linear, machine
from estimators.engine.arrays import TracedArray
from estimators.engine.compiled import output
from estimators.engine.function import Argument, Function
from estimators.engine.matrices import MatrixTracer, is_mask, joined, matrix, matrix_input
from estimators.engine.program import Program, View
from estimators.engine.tracer import Tracer
from estimators.linalg import semidefinite_cholesky

BATCHES = (11,), (65,), (2, 6), ()
NOISE = 1e-13
NOISY = 6
"""Evaluations with noise, in pairs of opposite signs, so that what jumps is seen to jump; the last of zeros."""


def is_traced(*values: Any) -> bool:
    return any(isinstance(value, MatrixTracer | Tracer | TracedArray) for value in values)


def spd(a: Any) -> Any:
    """Positive definite and well conditioned, of any square matrix."""
    a = a / (1.0 + np.sqrt(np.square(a).sum((-2, -1))))[..., None, None]
    return a @ a.mT + np.eye(a.shape[-2])


def changed(a: Any, b: Any) -> Any:
    a[..., 0] = b
    return a


def solve(s: Any, b: Any) -> Any:
    return linear.solve_definite(s, b) if is_traced(s, b) else np.linalg.solve(s, b)


def lower(a: Any) -> Any:
    return linear.cholesky(a) if is_traced(a) else np.linalg.cholesky(a)


def solve_lower(a: Any, b: Any) -> Any:
    return linear.solve_lower(lower(a), b) if is_traced(a, b) else np.linalg.solve(lower(a), b)


def solve_upper(a: Any, b: Any) -> Any:
    return linear.solve_upper(lower(a).mT, b) if is_traced(a, b) else np.linalg.solve(lower(a).mT, b)


def symmetrise(a: Any) -> Any:
    return linear.symmetrise(a) if is_traced(a) else 0.5 * (a + a.mT)


def semidefinite(a: Any) -> Any:
    """``L L'`` of a product that need not have full rank."""
    a = a @ a.mT
    root = linear.semidefinite_cholesky(a) if is_traced(a) else semidefinite_cholesky(a)
    return root @ root.mT


def rotated(a: Any) -> Any:
    """Products of the orthogonal columns, and the matrix once more; of the rotation they do not depend on."""
    if not is_traced(a):
        return a @ a.mT + a.sum((-2, -1))[..., None, None]
    columns, rotation = linear.rotated(a)
    return columns @ columns.mT + (columns @ rotation.mT).sum((-2, -1)) * np.ones((1, 1))


def copysign(a: Any, b: Any) -> Any:
    """Of signs that zeros and NaN do not have for certain."""
    return np.copysign(a, np.where(np.abs(b) > 1e-9, b, 1.0))


def inner(a: Any, b: Any) -> Any:
    return linear.inner(a, b) if is_traced(a, b) else a @ b.mT


def beside(parts: Sequence[Any], axis: int) -> Any:
    if is_traced(*parts):
        return joined(parts, axis)
    batch = np.broadcast_shapes(*(np.shape(part)[:-2] for part in parts))
    return np.concatenate([np.broadcast_to(part, batch + part.shape[-2:]) for part in parts], axis)


WORDS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b, "subtract": lambda a, b: a - b, "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b, "remainder": lambda a, b: a % b, "maximum": np.maximum, "minimum": np.minimum,
    "greater": lambda a, b: a > b, "less": lambda a, b: a < b, "bitwise_and": lambda a, b: a & b,
    "logical_and": np.logical_and, "invert": lambda a: ~a, "logical_not": np.logical_not, "negative": lambda a: -a,
    "absolute": abs, "sqrt": np.sqrt, "floor": np.floor, "isfinite": np.isfinite, "log1p": np.log1p,
    "square": np.square, "where": np.where, "matmul": lambda a, b: a @ b, "matvec": np.matvec, "vecmat": np.vecmat,
    "mT": lambda a: a.mT, "solve": np.linalg.solve, "solve definite": lambda a, b: solve(spd(a), b),
    "solve_upper": lambda a, b: solve_upper(spd(a), b), "solve_lower": lambda a, b: solve_lower(spd(a), b),
    "cholesky": lambda a: lower(spd(a)), "symmetrise": symmetrise, "semidefinite": semidefinite, "rotated": rotated,
    "inner": inner, "congruence": lambda a, b: a @ b @ a.mT, "arctan2": np.arctan2, "exp": lambda a: np.exp(-abs(a)),
    "sin": np.sin, "cos": np.cos, "log": lambda a: np.log(abs(a)), "fmod": np.fmod, "copysign": copysign,
    "joined": lambda a, b: beside([a, b], -1), "joined below": lambda a, b, c: beside([a, b, c], -2),
}  # fmt: skip
"""Those of the language: each must be met, and accepted, many times."""
ODD: dict[str, Callable[..., Any]] = {
    "add.reduce": lambda a: np.add.reduce(a, -1), "out": lambda a, b: np.add(a, b, out=a),
    "dtype": lambda a, b: np.add(a, b, dtype=np.float32), "masked": lambda a, b, c: np.add(a, b, where=c),
    "+=": lambda a, b: a.__iadd__(b), "assignment": changed, "power": lambda a, b: a**b, "//": lambda a, b: a // b,
    "or": lambda a, b: a | b, "xor": lambda a, b: a ^ b, ">=": lambda a, b: a >= b, "==": lambda a, b: a == b,
    "positive": lambda a: +a, "divmod": lambda a, b: divmod(a, b)[0], "hypot": np.hypot, "tan": np.tan, "sign": np.sign,
    "vecdot": np.vecdot, "dot": np.dot, "inner": np.inner, "outer": np.outer, "einsum": lambda a: np.einsum("...i", a),
    "sum of all": lambda a: a.sum(), "np.sum": lambda a: np.sum(a, -1), "max": lambda a: a.max(-1),
    "mean": lambda a: a.mean(-1), "any": lambda a: a.any(-1), "cumsum": np.cumsum, "sort": np.sort, "T": lambda a: a.T,
    "trace": np.trace, "np.diagonal": lambda a: np.diagonal(a, axis1=-2, axis2=-1), "diag": np.diag,
    "inv": np.linalg.inv, "det": np.linalg.det, "norm": np.linalg.norm, "np.cholesky": np.linalg.cholesky,
    "eigh": np.linalg.eigvalsh,
    "pinv": np.linalg.pinv, "stack": lambda a, b: np.stack([a, b], -1), "hstack": lambda a, b: np.hstack([a, b]),
    "block": lambda a, b: np.block([a, b]), "clip": lambda a: np.clip(a, 0.0, 1.0), "like": np.zeros_like,
    "array": lambda a: np.array(a), "of two": lambda a, b: np.array([a, b]), "objects": lambda a: np.asarray(a, object),
    "broadcast_to": lambda a: np.broadcast_to(a, (3, 3)), "swapaxes": lambda a: np.swapaxes(a, -1, -2),
    "reshape": lambda a: a.reshape(-1), "ravel": np.ravel, "copy": lambda a: a.copy(),
    "astype": lambda a: a.astype(int),
    "squeeze": np.squeeze, "expand_dims": lambda a: np.expand_dims(a, -1), "isin": lambda a: np.isin(a, (0, 1)),
    "nan_to_num": np.nan_to_num, "float": float, "len": lambda a: len(a) * a, "rows": lambda a: next(iter(a)),
    "if": lambda a, b: a if a > b else b, "max of two": max, "tile": lambda a: np.tile(a, 2), "where one": np.where,
    "matrix": lambda a: np.asmatrix(np.eye(3)) * a, "masked array": lambda a: np.ma.array([1.0, 2.0, 3.0]) + a,
    "complex": lambda a: 1j * a, "none": lambda a: a + None, "text": lambda a: a + "1",
    "frompy": np.frompyfunc(abs, 1, 1),
    "take": lambda a: np.take(a, 0, -1), "round": np.round, "roll": lambda a: np.roll(a, 1, -1),
    "concatenate a constant": lambda a: np.concatenate([a, np.zeros(2)], -1), "append": lambda a, b: np.append(a, b),
}  # fmt: skip
"""Words beside the language."""
SOLVING = "solve", "solve definite", "solve_upper", "solve_lower", "cholesky", "semidefinite", "rotated"
"""Not of what is not finite, of which libraries make different things."""
SUMS = (*SOLVING, "matmul", "matvec", "vecmat", "congruence", "inner", "sum", "sin", "cos")


KEYS = (
    None, 0, 1, -1, -2, 2, 5, slice(None), slice(1, None), slice(None, None, -1), slice(0, 5, 2), np.int64(0),
)  # fmt: skip
ODD_KEYS = (
    slice(None, 0), slice(7, None), True, [0, 0], np.array([0]), 1.0, Ellipsis, slice(None, None, 0), "a",
)  # fmt: skip


def word(rng: np.random.Generator) -> tuple[str, Callable[..., Any], int]:
    """A name, a function and how many operands it takes."""
    kind = rng.random()
    if kind < 0.7:
        words = WORDS if kind < 0.62 else ODD
        name = str(rng.choice(list(words)))
        return name, words[name], operands_of(words[name])
    if kind < 0.78:
        axis = any_of(rng, (-1, -2, (-2, -1), 0, 1, None, -3, (-1,), (-1, -2), (0, 1), np.int64(-1), True))
        keep = {} if rng.random() < 0.9 else {"keepdims": True}
        return "sum", lambda a: a.sum(axis, **keep), 1
    if kind < 0.86:
        along = any_of(rng, ({"axis": -1}, {"axis": -2}, {"axis": 0}, {"axis": 1}, {"axis": None}, {"axis": -3}, {}))
        return "concatenate", lambda *parts: np.concatenate(list(parts), **along), int(rng.integers(1, 4))
    if kind < 0.89:
        offset, axes = any_of(rng, (0, 0, 0, 1, -1)), any_of(rng, ((-2, -1), (-2, -1), (-1, -2), (0, 1)))
        return "diagonal", lambda a: a.diagonal(offset, *axes), 1
    key = tuple(any_of(rng, KEYS if rng.random() < 0.95 else ODD_KEYS) for _ in range(rng.integers(4)))
    key = (Ellipsis, *key) if rng.random() < 0.95 else key
    return "index", lambda a: a[key], 1


def any_of(rng: np.random.Generator, values: Sequence[Any]) -> Any:
    return values[rng.integers(len(values))]


def operands_of(function: Callable[..., Any]) -> int:
    if function in (np.where, np.linalg.solve, max):
        return 3 if function is np.where else 2
    code = getattr(function, "__code__", None)
    return code.co_argcount if code else getattr(function, "nin", 1)


Inputs = tuple[Program, list[Any], list[np.ndarray], list[np.ndarray], list[Argument]]


def inputs(rng: np.random.Generator, batch: tuple[int, ...]) -> Inputs:
    """A program, its tracers, their arrays with the batch's axes, and what the program is run on."""
    program = Program()
    tracers: list[Any] = []
    values, arrays, rows = [], [], []
    sizes = rng.choice([1, 2, 3, 4, 0], size=3, p=[0.2, 0.35, 0.3, 0.12, 0.03])
    for i in range(int(rng.integers(3, 8))):
        mask = i > 2 and rng.random() < 0.4
        shape = tuple(int(k) for k in rng.choice(sizes, size=rng.choice([0, 1, 2], p=[0.15, 0.35, 0.5])))
        value = rng.normal(size=batch + shape) * rng.choice([1.0, 1.0, 100.0, 1e-3])
        odd = rng.random(value.shape)
        value = np.where(odd < 0.08, np.round(value), value)
        if rng.random() < 0.1:
            value = np.where(odd > 0.97, rng.choice([np.nan, np.inf, -np.inf, 0.0, -0.0]), value)
        value = value > 0.0 if mask else value
        tracers.append(matrix_input(program, i, 0, shape, "b" if mask else "f"))
        values.append(value)
        arrays.append(np.ascontiguousarray(value))
        rows.append(Argument(shape, "b" if mask else "f"))
    return program, tracers, values, arrays, rows


def constant(rng: np.random.Generator) -> Any:
    shape = tuple(rng.integers(1, 4, size=rng.integers(0, 3)))
    value = rng.normal(size=shape)
    kinds = (
        float(rng.normal()), 0.0, -0.0, 1.0, 2, True, np.float32(0.1), np.int8(3), value, value, value, value > 0.0,
        np.round(value).astype(int), value.astype(np.float32), np.eye(3), np.zeros(shape), [1.0, 2.0],
        np.ones((2, 2, 2)),
    )  # fmt: skip
    return any_of(rng, kinds)


def noisy(value: Any, noise: np.random.Generator, sign: int, zeros: bool) -> Any:
    """A result of NumPy's with relative noise, if it is of numbers; or with a zero of a sign where it is nearly 0."""
    if sign == 0 or np.asarray(value).dtype.kind != "f":
        return value
    if zeros:
        return np.where(np.abs(value) <= 30.0 * NOISE * np.abs(value).max(initial=0.0), sign * 0.0, value)
    return value * (1.0 + sign * NOISE * noise.standard_normal(np.shape(value)))


def spread(value: Any, noise: np.random.Generator, sign: int) -> Any:
    """An operand with noise relative to its largest entry, as sums of products amount to."""
    if sign == 0 or np.asarray(value).dtype.kind not in "fi" or np.ndim(value) == 0:
        return value
    size = np.abs(value).max((-2, -1)[-np.ndim(value) :], keepdims=True, initial=0.0)
    return value + sign * NOISE * size * noise.standard_normal(np.shape(value))


def tried(function: Callable[..., Any], operands: list[Any]) -> Any:
    """The result, or the error."""
    try:
        return function(*operands)
    except Exception as error:
        return error


def fuzz(seed: int, met: Counter) -> Iterator[str]:
    """What is wrong with one formula: nothing, as a rule."""
    rng = np.random.default_rng(seed)
    batch = any_of(rng, BATCHES)
    program, symbols, given, arrays, rows = inputs(rng, batch)
    worlds = [(k + 1) // 2 * (1 if k % 2 else -1) for k in range(NOISY + 1)]  # 0, 1, -1, 2, ...
    values: list[list[Any]] = [[value] * len(worlds) for value in given]
    names = ["given"] * len(given)
    for _ in range(int(rng.integers(4, 16))):
        name, function, count = word(rng)
        for _attempt in range(8):
            operands, everywhere = [], []
            for k in range(count):
                if rng.random() < 0.15 and (operands or k < count - 1):
                    own = constant(rng)
                    operands.append(own)
                    everywhere.append([own] * len(worlds))
                else:
                    of_masks = name in ("bitwise_and", "logical_and", "invert", "logical_not") and rng.random() < 0.5
                    pool = [i for i, each in enumerate(symbols) if is_mask(each) or not of_masks] or range(len(symbols))
                    i = int(rng.choice(pool))
                    operands.append(symbols[i])
                    everywhere.append(values[i])
            if not any(isinstance(each, MatrixTracer) for each in operands):
                continue
            expected = tried(function, [copy(o) for o, *_ in everywhere])
            if not isinstance(expected, Exception) or rng.random() < 0.25:
                break
        else:
            continue
        floats = [o for o, *_ in everywhere if np.asarray(o).dtype.kind == "f"]
        if name in SOLVING and not all(np.isfinite(o).all() for o in floats):
            continue
        found = tried(function, [copy(o) if isinstance(o, list) else o for o in operands])
        if isinstance(found, Exception):
            met[f"{name}: refused"] += 1
            if not isinstance(expected, Exception):
                met[f"{name}: refused alone"] += 1
            if not isinstance(found, TypeError | ValueError | IndexError | AttributeError) or "\n" in str(found):
                yield f"{name} of {operands}: {found!r} is no sentence"
            continue
        if isinstance(expected, np.linalg.LinAlgError) and "Singular" in str(expected):
            continue
        if isinstance(found, TracedArray):
            found = matrix(program, found)
        if not isinstance(found, MatrixTracer | Tracer):
            yield f"{name} of shapes {[np.shape(o[0]) for o in everywhere]} gave {found!r}"
            continue
        if isinstance(expected, Exception):
            yield f"{name} of {[np.shape(o[0]) for o in everywhere]} was accepted, NumPy says {expected}"
            continue
        if np.shape(expected) != batch + found.shape or (np.asarray(expected).dtype == bool) != is_mask(found):
            yield (
                f"{name} of {[np.shape(o[0]) for o in everywhere]} gave {found.shape}, mask {is_mask(found)}; NumPy "
                f"{np.shape(expected)} {np.asarray(expected).dtype}"
            )
            continue
        met[name] += 1
        results = []
        for w, sign in enumerate(worlds):
            noise, zeros = np.random.default_rng([seed, len(names), abs(sign)]), abs(sign) == 3 and name in SUMS
            sign = int(np.sign(sign))
            own = [copy(o[w]) for o in everywhere]
            much = (
                0 if zeros else 30 * sign if name == "semidefinite" else sign
            )  # pivots that are almost 0 are left out
            own = tried(function, [spread(o, noise, much) for o in own] if name in SUMS else own)
            own = np.full(np.shape(expected), np.nan) if isinstance(own, Exception) else own
            results.append(noisy(own, noise, sign, zeros))
        symbols.append(found)
        values.append(results)
        names.append(name)
    function = Function(program, rows, [output(program, each) for each in symbols])
    yield from out_of_bounds(function)
    found = function.compute(arrays)
    for name, symbol, result, (clean, *others) in zip(names, symbols, found, values, strict=False):
        met["entries"] += result.size
        wrong = differs(result, np.asarray(clean, float), [np.asarray(other, float) for other in others], met)
        if wrong.any():
            at = tuple(int(i[0]) for i in np.nonzero(wrong))
            expected, *noise = (float(np.broadcast_to(each, result.shape)[at]) for each in (clean, *others))
            yield f"{name} of {symbol.shape} gave {result[at]!r}, NumPy {expected}, with noise {noise}"
            return
    for some in () if not batch else (slice(0, 1), slice(1, 3), slice(2, None)):
        few = function.compute([each[some] for each in arrays])
        for name, whole, part in zip(names, found, few, strict=True):
            if np.ascontiguousarray(whole[some]).tobytes() != part.tobytes() and not np.isnan(part).any():
                yield f"{name} has other bits in rows {some} alone"
                return


def differs(result: np.ndarray, clean: np.ndarray, others: list[np.ndarray], met: Counter) -> np.ndarray:
    """Which entries are further apart than noise goes; where noise changes what is finite, none."""
    finite = np.isfinite(clean)
    same = [np.isfinite(other) == finite for other in others]
    same += [finite | (np.isnan(other) == np.isnan(clean)) & (np.isnan(clean) | (other == clean)) for other in others]
    steady = np.logical_and.reduce(same)
    met["entries that noise moves without bound"] += int((~steady).sum())
    spread = np.maximum.reduce([np.where(steady & finite, np.abs(other - clean), 0.0) for other in others])
    near = np.abs(result - clean) <= 4.0 * spread + 1e-13 * np.abs(clean)
    return steady & ~np.where(finite, near, (result == clean) | (np.isnan(result) & np.isnan(clean)))


def out_of_bounds(function: Function) -> Iterator[str]:
    """Instructions that read outside the values of their operands."""
    for instruction in function.instructions:
        for view in instruction.operands:
            if isinstance(view, View) and all(view.shape):
                corners = [view.start + i * view.steps[0] + j * view.steps[1]
                           for i in (0, view.shape[0] - 1) for j in (0, view.shape[1] - 1)]  # fmt: skip
                if not 0 <= min(corners) <= max(corners) < function.program.sizes[view.value]:
                    yield f"{instruction.opcode} reaches {corners} of {function.program.sizes[view.value]}"


def main(count: int, seed: int) -> int:
    """Fuzz as many formulas, tell what is wrong and what was met."""
    met: Counter = Counter()
    wrong = 0
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), np.errstate(all="ignore"):
        machine.folder = lambda: Path(folder)  # type: ignore[assignment]
        warnings.simplefilter("ignore")
        for i in range(count):
            for text in fuzz(seed + i, met):
                wrong += 1
                if wrong <= 20:
                    print(f"formula {seed + i}: {text}")
    rare = [name for name in (*WORDS, "sum", "concatenate", "diagonal", "index") if met[name] < count // 200]
    print(f"{count} formulas, {sum(met[n] for n in WORDS)} words, {wrong} wrong, met too rarely: {rare}")
    for name, times in sorted(met.items()) if "-v" in sys.argv else ():
        print(f"{times:8d} {name}")
    return int(wrong > 0 or bool(rare))


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2])))
