"""What users write in NumPy: traced as NumPy computes it, or refused in a sentence; never silently something else."""

import functools
import math
import operator
import os
import random
import re
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.spatial.transform
import scipy.special

from estimators.engine.foreign import inspect

A = np.array(
    [[1.0, 0.1, 0.0, 0.0], [0.0, 0.9, 0.0, 0.0], [0.0, 0.0, 1.0, 0.2], [0.3, 0.0, 0.0, 1.0]]
)
NAMES = {
    "np": np, "math": math, "random": random, "time": time, "os": os, "functools": functools, "operator": operator,
    "scipy": scipy, "A": A, "B": A[:, :2].copy(), "GAIN": 2.0, "COUNT": 0, "LOG": [],
    "TABLE": np.linspace(0.0, 1.0, 11),
}  # fmt: skip
RIGHT = (
    "x = x + 0.0; x[..., 0] = 2 * x[..., 0]; return x",
    "y = x.copy(); y[..., 1] += u[..., 0]; y[..., 2:] *= 2; return y",
    "y = np.zeros_like(x); y[..., 0] = x[..., 1]; y[..., 3] = np.sin(x[..., 2]); return y",
    "y = np.zeros(x.shape, dtype=x.dtype); y[..., 0] = x[..., 1]; return y",
    "y = x.copy(); y[y < 0] = 0.0; return y",
    "y = x * 1.0; y += 1; y *= 2; y -= .5; y /= 3; y **= 2; return y",
    "y = np.empty_like(x); np.multiply(x, 2.0, out=y); return y",
    "return x[..., ::2] - x[..., 1::2]",
    "return x[..., ::-1]",
    "return np.where(np.any(x > 0, axis=-1, keepdims=True), x, -x)",
    "return np.where((x > 0).all(-1)[..., None], x, -x)",
    "return np.einsum('ij,...j->...i', A, x)",
    "return np.clip(x, -1, 1)",
    "return x.clip(-1.0, 1.0)",
    "return np.clip(x, A[0], None)",
    "return GAIN * x",
    "return x * np.float32(0.1)",
    "return x * np.array([.1, .2, .3, .4], np.float32)",
    "return x[..., [3, 0, 2]]",
    "return x[..., np.array([[0, 1], [2, 3]])]",
    "return x[..., np.array([True, False, True, False])]",
    "return np.take(x, [1, 2], axis=-1)",
    "P = x[..., :, None] * x[..., None, :]\nreturn P[(..., *np.ix_([0, 1], [1, 2]))]",
    "return np.linalg.norm(x, axis=-1)",
    "return x / np.linalg.norm(x, axis=-1, keepdims=True)",
    "return x @ np.linalg.pinv(A).T",
    "a, b, c, d = x.T\nreturn np.array([a + b, c * d]).T",
    "a, b, c, d = np.moveaxis(x, -1, 0)\nreturn np.stack([a + b, c * d], axis=-1)",
    "return x * x.shape[-1]",
    "total = 0.0\nfor i in range(x.shape[-1]): total = total + x[..., i] ** 2\nreturn total",
    "y = np.ones_like(x)\nfor _ in range(6): y = y - (y * y * y - x) / (3 * y * y)\nreturn y",
    "return x @ scipy.linalg.expm(A).T",
    "return x * math.pi + math.sqrt(2.0) * math.sin(.3)",
    "try: return np.stack([x[..., 0], x[..., 3]], -1)\nexcept IndexError: return x",
    "return x @ A.T + u @ B.T",
    "return np.matvec(A, x) + np.matvec(B, u)",
    "return np.dot(x, A.T) + u.dot(B.T)",
    "return (A @ x[..., None])[..., 0] + (B @ u[..., None]).squeeze(-1)",
    "return (x * x).sum(axis=-1)",
    "return x.astype(int)",
    "return (x > 0).astype(float)",
    "return np.cumsum(x, axis=-1)",
    "return x.cumsum(-1)",
    "return np.cumprod(x, axis=-1)",
    "return x - x.mean(axis=-1, keepdims=True)",
    "return np.std(x, axis=-1)",
    "return x.var(axis=-1, ddof=1)",
    "return np.prod(x, axis=-1)",
    "return x[..., :, np.newaxis] * u[..., np.newaxis, :]",
    "return np.select([x < 0, x > 1], [0.0, 1.0], x)",
    "return np.heaviside(x, 0.5)",
    "return np.interp(x, np.linspace(-1, 1, 11), np.linspace(-1, 1, 11) ** 3)",
    "return np.polyval([1, -2, 3.0], x)",
    "return np.poly1d([1.0, 2, 3])(x)",
    "return np.polynomial.polynomial.polyval(x, [1.0, 2.0, 3.0])",
    "return np.sign(x) * np.abs(x) ** 0.5",
    "return x ** 3 + x ** -2 + x ** 0",
    "return x // 0.3",
    "return (x + np.pi) % (2 * np.pi) - np.pi",
    "return np.round(x) + x.round()",
    "return np.floor(x) + np.ceil(x) + np.trunc(x) + np.fix(x) + np.rint(x)",
    "return np.arctan2(x[..., 0], x[..., 1]) + np.hypot(x[..., 2], x[..., 3])",
    "return np.log2(np.abs(x)) + np.log10(np.abs(x) + 1) + np.log1p(np.abs(x))",
    "return np.maximum.reduce(x, axis=-1) + np.add.reduce(x, -1)",
    "return np.cross(x[..., :3], x[..., 1:])",
    "return x @ np.diag([1.0, 2, 3, 4]) ",
    "return x[..., None] * np.eye(4)",
    "return np.trace(x[..., :, None] * x[..., None, :], axis1=-2, axis2=-1)",
    (
        "c, s = np.cos(x[..., 0]), np.sin(x[..., 0])\nR = np.stack([np.stack([c, -s], -1),"
        " np.stack([s, c], -1)], -2)\nreturn (R @ u[..., None])[..., 0]"
    ),
    (
        "c, s = np.cos(x[..., 0]), np.sin(x[..., 0])\nR = np.moveaxis(np.array([[c, -s], [s, c]]),"
        " (0, 1), (-2, -1))\nreturn np.einsum('...ij,...j->...i', R, u)"
    ),
    "return np.concatenate([x, u], axis=-1)",
    "return np.hstack([x, u])",
    "return np.stack([x[..., 0], np.zeros_like(x[..., 0]), np.ones(x.shape[:-1])], -1)",
    "return [x[..., 0], x[..., 1]]",
    "return x * 2, u > 0",
    "return np.array([1.0, 2.0])",
    "return 3.0",
    "return x",
    "return x.reshape(x.shape[:-1] + (2, 2)).swapaxes(-1, -2)",
    "return np.tile(x, 2) + np.repeat(x, 2, axis=-1)",
    "return np.roll(x, 1, axis=-1)",
    "return np.diff(x, axis=-1)",
    "return (x > 0).sum(-1)",
    "return (x > 0) * x + (x < 0) * 2.0",
    "return 1 - (x > 0)",
    "return (x > 0) * (x < 1)",
    "return np.where((x > 0) & ~(x > 1) | (x < -1), x, 0)",
    "return sum(x[..., i] for i in range(4))",
    "return abs(x)",
    "return x * (2.0 if isinstance(x[..., 0], float) else 3.0)",
    "return np.squeeze(x)",
    "x = np.asarray(x); return np.sin(x) * 2",
    "y = np.array(x, copy=True); y[..., 0] = 0; return y",
    "return np.array(x.tolist()) * 2",
    "return x + np.finfo(float).eps",
    "return np.where(x > 0, 1.0 / np.where(x > 0, x, 1.0), 0.0)",
    "with np.errstate(all='ignore'): return np.log(x)",
    "return np.log(x) + np.sqrt(x)",
    "return np.broadcast_to(x[..., :1], x.shape) * 2",
    "return functools.reduce(operator.add, [x[..., i] for i in range(4)])",
    "return sum(a * x[..., i] for i, a in zip(range(4), (1., 2., 3., 4.)))",
    "return np.stack([x[..., i] * (i + 1) for i in range(4)], axis=-1)",
    "import numpy as xp\nreturn xp.sin(x)",
    "return np.stack(list(x[..., i] for i in range(2)), -1)",
    "return x * len({1, 2})",
    "return np.linalg.norm(x[..., None] * x[..., None, :], axis=(-2, -1))",
    "return x @ np.linalg.matrix_power(A, 3).T",
    "return (x.astype(np.int64) & 3) << 2",
    "return np.real(x) + np.conj(x) + x.real",
    "y = np.zeros_like(x)\nfor i, v in np.ndenumerate(x): y[i] = v * 2\nreturn y",
    (
        "y = x.copy()\nfor i in range(1, x.shape[-1]): y[..., i] = y[..., i - 1] * 0.5 + y[...,"
        " i]\nreturn y"
    ),
    "y = np.empty(x.shape); y[..., 0] = x[..., 1]; y[..., 1:] = 0.0; return y",
    "x = np.asarray(x, dtype=float); return x * 2",
    "y = np.array(x); y[..., 0][x[..., 1] > 0] = 5.0; return y",
    "y = np.zeros(x.shape); y[..., 0] = x[..., 1]; y[..., 1:] = np.sin(x[..., :3]); return y",
    (
        "F = np.zeros(x.shape[:-1] + (4, 4))\nF[..., 0, 1] = x[..., 0]\nF[..., range(4), range(4)]"
        " = 1.0\nreturn (F @ x[..., None])[..., 0]"
    ),
    "M = np.zeros((4, 4)); M[0, 1] = 0.1; M += np.eye(4)\nreturn x @ np.linalg.inv(M).T",
    (
        "c, s = np.cos(x[..., 0]), np.sin(x[..., 0])\nreturn np.einsum('ij...,...j->...i',"
        " np.array([[c, -s], [s, c]]), u)"
    ),
    "y = np.empty_like(x); y[..., :2] = u; y[..., 2:] = np.where(x[..., 2:] > 0, 1, -1); return y",
    "return np.ones(x.shape) * x + np.zeros(4) - np.full(4, 2.0)",
    "t = np.zeros(4); t[1] = 3; return t",
    "n = np.zeros(4, dtype=int); n[2] = 1; return x[..., n]",
    "return np.asarray(x, dtype=int)",
)
REFUSED = {
    "y = np.zeros(x.shape, dtype=np.float32); y[..., 0] = x[..., 0]; return y": "fresh arrays",
    "y = np.zeros(x.shape); y[0] = x[0]; return y": "rows in a batch depend on each other",
    "if np.any(x > 100): return x * 0\nreturn x": "cannot branch on values",
    "return np.where(np.any(x > 1e3), 0.0, x)": "rows in a batch depend on each other",
    "return np.einsum('bi,bi->b', x, x)": "it raises ValueError",
    "return x.astype(np.float32)": "float64, int64",
    "return np.asarray(x, dtype=np.float32) * 2": "not float32",
    "i = x[..., 0].astype(int) % 4\nreturn TABLE[i]": "valid indices",
    "return x[x > 0]": "x\\[mask\\]",
    "return np.take_along_axis(x, np.argsort(x, -1), -1)": "cannot have np.argsort in it",
    "return np.linalg.inv(np.eye(4) + x[..., :, None] * x[..., None, :])": (
        "cannot have np.inv in it"
    ),
    "return np.linalg.solve(A, x[..., None])[..., 0]": "cannot have np.solve in it",
    "return np.linalg.solve(np.eye(4) + x[..., :, None] * x[..., None, :], x[..., None])": (
        "cannot have np.solve in it"
    ),
    "return np.linalg.det(x.reshape(x.shape[:-1] + (2, 2)))": "cannot have np.det in it",
    "return x / np.linalg.norm(x)": "rows in a batch depend on each other",
    "return np.linalg.eigvalsh(np.eye(4) + x[..., :, None] * x[..., None, :])": (
        "cannot have np.eigvalsh in it"
    ),
    "return x.T": "for 3 rows it gives",
    "return x / len(x)": "rows in a batch depend on each other",
    "return x * x.shape[0]": "rows in a batch depend on each other",
    "return np.array([row[0] * 2 for row in x])": "too many indices",
    "y = x\nwhile np.max(np.abs(y)) > 1: y = y / 2\nreturn y": "cannot branch on values",
    "return scipy.special.gamma(x)": "cannot have gamma in it",
    "return scipy.special.erf(x)": "cannot have erf in it",
    "return np.stack([math.sin(x[..., 0]), math.cos(x[..., 1])], -1)": "it raises TypeError",
    "return x + np.random.normal(size=x.shape)": "random numbers",
    "return x + random.random()": "uses the module random",
    "print('x', x); return x": "calls print",
    "return x + time.time()": "uses the module time",
    "return x * float(os.environ.get('NOPE', '2'))": "uses the module os",
    "try: y = float(x[..., 0])\nexcept TypeError: y = 7.0\nreturn x * y": "in NumPy where it gives",
    "global COUNT\nCOUNT += 1\nreturn x": "changes the variable",
    "LOG.append(1); return x": "changes something that it reads",
    "LOG.append(x); return x": "changes something that it reads",
    "return A @ x": "it raises ValueError",
    "return np.vdot(x, x)": "cannot have np.vdot in it",
    "return np.vectorize(lambda a: a * 2 + 1)(x)": "cannot have <lambda>",
    "return np.vectorize(lambda a: a if a > 0 else 0.0)(x)": "cannot branch on values",
    "return int(x[..., 0]) * x": "it raises TypeError",
    "return np.sort(x, -1)": "cannot have np.sort in it",
    "y = x.copy(); y.sort(); return y": "cannot branch on values",
    "return np.argmax(x, -1)": "cannot have np.argmax in it",
    "return x.argsort(-1)": "cannot branch on values",
    "return np.median(x, -1)": "cannot have np.median in it",
    "return x - np.mean(x)": "rows in a batch depend on each other",
    "return np.ptp(x, axis=-1)": "cannot have np.ptp in it",
    "return np.average(x, axis=-1, weights=[.1, .2, .3, .4])": "cannot have np.average in it",
    "return x[:, None, :] - x[None, :, :]": "too many indices",
    "return np.stack([x[:, 0], x[:, 1]], -1)": "too many indices",
    "return np.array([x[0] + u[0], x[1]])": "it raises ValueError",
    "a, b, c, d = x\nreturn np.array([a, b * c])": "it raises ValueError",
    "return np.piecewise(x, [x < 0, x >= 0], [-1, 1])": "cannot have np.piecewise in it",
    "return np.choose((x > 0).astype(int), [x, -x])": "cannot have np.choose in it",
    "return np.interp(.5, [0., 1.], x[..., :2])": "it raises ValueError",
    "return np.searchsorted(TABLE, x)": "cannot have np.searchsorted in it",
    "return np.sinc(x)": "cannot have np.sinc in it",
    "return np.abs(x) ** 1.7": "constant exponents",
    "return np.abs(x[..., :2]) ** u": "constant exponents",
    "return 2.0 ** x": "constant exponents",
    "return np.stack(divmod(x, 0.7), -1)": "cannot have divmod in it",
    "return np.round(x, 1)": "np.round",
    "return np.unwrap(x)": "cannot have np.unwrap in it",
    "return np.angle(np.exp(1j * (x[..., 0] - x[..., 1])))": "real numbers and masks",
    "return (x[..., 0] + 1j * x[..., 1]).real": "real numbers and masks",
    "return np.sinh(x) + np.cosh(x)": "cannot have sinh in it",
    "return np.exp2(x) + np.cbrt(x)": "cannot have exp2 in it",
    "return np.logaddexp(x[..., 0], x[..., 1])": "cannot have logaddexp in it",
    "return np.nan_to_num(x)": "cannot have np.nan_to_num in it",
    "return np.isclose(x, 0.0)": "cannot have np.isclose in it",
    "return x if np.allclose(x, 0) else 2 * x": "cannot have np.allclose in it",
    "return np.nansum(x, axis=-1)": "cannot have np.nansum in it",
    "return np.nanmean(x, axis=-1)": "cannot have np.nanmean in it",
    "return np.add.outer(x, u)": "cannot have np.add.outer in it",
    "return np.outer(x, x)": "for 3 rows it gives",
    "return np.kron(A, x)": "for 3 rows it gives",
    "return np.diag(x)": "for 3 rows it gives",
    "c, s = np.cos(x[..., 0]), np.sin(x[..., 0])\nR = np.array([[c, -s], [s, c]])\nreturn R @ u": (
        "for 3 rows it gives"
    ),
    "return scipy.spatial.transform.Rotation.from_euler('z', x[..., 0]).as_matrix()": (
        "it raises ValueError"
    ),
    "return np.concatenate([x, u])": "it raises ValueError",
    "return np.column_stack([x, u])": "it raises ValueError",
    "return np.c_[x, u]": "it raises ValueError",
    "return np.r_[x, u]": "it raises ValueError",
    "return {'x': x}": "not arrays of real numbers",
    "return None": "not arrays of real numbers",
    "return 'x'": "not arrays of real numbers",
    "return x.reshape(-1, 4)": "for 3 rows it gives",
    "return x.ravel()": "for 3 rows it gives",
    "return x.flatten()[0]": "rows in a batch depend on each other",
    "return np.roll(x, 1, axis=-1) - np.roll(x, 1)": "rows in a batch depend on each other",
    "return np.pad(x, [(0, 0)] * (x.ndim - 1) + [(1, 1)])": "cannot have np.pad in it",
    "return np.gradient(x, axis=-1)": "cannot have np.gradient in it",
    "return np.trapezoid(x, axis=-1)": "cannot have np.trapezoid in it",
    "return np.convolve(x, [1, 2], 'same')": "it raises ValueError",
    "return np.abs(np.fft.fft(x))": "cannot have np.fft in it",
    "return np.meshgrid(x, u)[0]": "cannot have np.meshgrid in it",
    "return np.unique(x)": "cannot have np.unique in it",
    "return np.histogram(x)[0]": "cannot have np.histogram in it",
    "return np.count_nonzero(x > 0, axis=-1)": "cannot have np.count_nonzero in it",
    "return (x > 0) + (x < -1)": "two masks",
    "x[..., 0] = 2 * x[..., 0]; return x": (
        "it writes into an array that it is given: work on a copy"
    ),
    "return np.where((x > 0) and (x < 1), x, 0)": "it raises ValueError",
    "return np.where(0 < x < 1, x, 0)": "it raises ValueError",
    "return max(x[..., 0], 0.0)": "it raises ValueError",
    "return sum(x)": "for 3 rows it gives",
    "return round(x[..., 0])": "it raises TypeError",
    "if x.ndim == 1: x = x[None]\nreturn x * 2": "for 3 rows it gives",
    "return np.atleast_2d(x)[..., 0]": "for 3 rows it gives",
    "return x[..., 0].item()": "it raises ValueError",
    "return x / 2 if np.issubdtype(x.dtype, np.floating) else x // 2": "in NumPy where it gives",
    "return np.divide(1.0, x, where=x > 0, out=np.zeros_like(x))": "cannot have divide in it",
    "assert np.all(np.isfinite(x)); return x": "cannot branch on values",
    "if (x < -1e6).any(): raise ValueError('far')\nreturn x": "cannot branch on values",
    "return x * len(open('/etc/hostname').read())": "calls open",
    "raise SystemExit(3)": "it raises SystemExit",
    "for i in range(30000): x = x * 0.999 + i\nreturn x": "too long",
    "return eval('x * 2')": "calls eval",
    "return np.linalg.lstsq(B, x)[0]": "it raises LinAlgError",
    "return np.apply_along_axis(lambda r: r * 2, -1, x)": "cannot have np.apply_along_axis in it",
    "return np.ma.masked_less(x, 0).filled(0.0)": "cannot branch on values",
    "return np.asarray(np.matrix(A) * np.asarray(x).reshape(4, -1))": "for 3 rows it gives",
    "return np.nextafter(x, 1.0)": "cannot have nextafter in it",
    "return np.ldexp(x, 2)": "cannot have ldexp in it",
    "return np.modf(x)[0]": "cannot have modf in it",
    "return np.fmax(x, 0.0)": "cannot have fmax in it",
}


def function(body: str) -> Callable[..., Any]:
    """A user's function of a state x (..., 4) and an input u (..., 2)."""
    names = dict(NAMES, LOG=[], A=A.copy())
    exec("def function(x, u):\n" + "\n".join("    " + line for line in body.split("\n")), names)
    return names["function"]  # type: ignore[return-value]


def arguments(*batch: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(len(batch) + sum(batch))
    return rng.normal(size=(*batch, 4)), rng.normal(size=(*batch, 2))


def in_numpy(f: Callable[..., Any], *given: np.ndarray) -> Any:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return f(*(each.copy() for each in given))


@pytest.mark.parametrize("body", RIGHT)
def test_an_idiom_that_is_traced_gives_what_numpy_gives(body: str):
    f = function(body)
    inspection = inspect(f, *arguments(6))
    assert inspection.traceable, inspection.reason
    assert inspection.unchanged()
    for batch in ((), (1,), (6,), (33,)):
        given = arguments(*batch)
        found, expected = inspection(*given), in_numpy(f, *given)
        for one, other in zip(
            *([found], [expected]) if not inspection.several else (found, expected), strict=True
        ):
            np.testing.assert_allclose(
                one, np.broadcast_to(other, one.shape), rtol=1e-12, atol=1e-13
            )


@pytest.mark.parametrize(("body", "phrase"), REFUSED.items())
def test_an_idiom_that_is_not_traced_is_refused_in_a_sentence(body: str, phrase: str):
    inspection = inspect(function(body), *arguments(6))
    assert not inspection.traceable
    assert re.search(phrase, inspection.reason), inspection.reason
    assert "\n" not in inspection.reason
    assert not inspection.unchanged()
    with pytest.raises(TypeError):
        inspection(*arguments(6))
