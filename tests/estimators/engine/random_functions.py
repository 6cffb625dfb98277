"""Random functions of a vector, in NumPy's words: for arrays of floats and of tracers alike."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estimators.engine import lookup, sincos

TABLE = np.array([0.3, -1.0, 2.0, 0.5, 0.0])
PLACES = np.array([-2.0, -0.5, 0.1, 1.0, 2.5])
Word = Callable[..., Any]
EXACT: dict[str, tuple[int, Word]] = {
    "add": (2, lambda a, b: a + b),
    "subtract": (2, lambda a, b: 0.7 - 1.3 * a - -b),
    "multiply": (2, lambda a, b: a * b),
    "divide": (2, lambda a, b: a / (1.0 + b * b)),
    "root": (1, lambda a: np.sqrt(np.abs(a) + 0.1) - (a**2 + 0.5) ** 0.5),
    "floor": (1, np.floor),
    "rint": (1, lambda a: np.rint(a) + np.ceil(a) - np.trunc(a)),
    "sign": (1, lambda a: np.sign(a) * a),
    "minimum": (2, lambda a, b: np.minimum(a, b) + 0.5 * np.maximum(a, b)),
    "copysign": (2, np.copysign),
    "fmod": (1, lambda a: np.fmod(a, 1.7)),
    "remainder": (1, lambda a: (a + np.pi) % (2.0 * np.pi) - np.pi),
    "clip": (1, lambda a: np.clip(a, -1.5, 1.2)),
    "where": (3, lambda a, b, c: np.where(a > 0.2, b, c)),
    "masks": (
        3,
        lambda a, b, c: np.where((a <= b + 0.017) & ~(c < 0.0) | (a == 0.5), b * c, a - 1.0),
    ),
    "either": (2, lambda a, b: np.where((a > 0.0) ^ (b >= 0.3), a, b)),
    "finite": (2, lambda a, b: np.where(np.isfinite(a) | np.isnan(b), a, 0.0)),
    "mask times": (2, lambda a, b: (a > b + 0.013) * a + 2.0 * (b != 0.0)),
    "sum": (3, lambda a, b, c: np.stack([a, b, c], -1).sum(-1)),
    "largest": (3, lambda a, b, c: np.max(np.stack([a, b, c], -1), axis=-1)),
    "cumulative": (3, lambda a, b, c: np.cumsum(np.stack([a, b, c], -1), axis=-1)[..., 1]),
    "sums": (3, lambda a, b, c: np.stack([a, b, c], -1).cumsum(-1)[..., 2]),
    "concatenate": (2, lambda a, b: np.concatenate([a[..., None], b[..., None]], -1)[..., 1]),
    "in place": (2, lambda a, b: _in_place(a, b)),
    "lookup": (1, lambda a: lookup(TABLE, a)),
}
ROUNDED: dict[str, tuple[int, Word]] = {
    "exp": (1, lambda a: np.exp(-np.abs(a))),
    "log": (1, lambda a: np.log(np.abs(a) + 0.2) - np.log1p(a * a)),
    "sines": (1, lambda a: sincos(a)[0] * sincos(a)[1] + np.sin(a) * np.cos(a)),
    "tan": (1, lambda a: np.tan(np.tanh(a))),
    "arctan": (1, np.arctan),
    "arcsin": (1, lambda a: np.arcsin(0.9 * np.cos(a))),
    "arctan2": (2, lambda a, b: np.arctan2(a, 0.3 + b * b)),
    "hypot": (2, lambda a, b: np.hypot(a, b + 0.01)),
    "interp": (1, lambda a: np.interp(a, PLACES, TABLE)),
    "mean": (3, lambda a, b, c: np.stack([a, b, c], -1).mean(-1)),
    "norm": (3, lambda a, b, c: np.linalg.norm(np.stack([a, b, c, 0.0 * a + 1.0], -1), axis=-1)),
    "matmul": (
        2,
        lambda a, b: (np.stack([a, b], -1) @ np.array([[0.5, 1.0], [-1.0, 0.2]]))[..., 1],
    ),
    "einsum": (2, lambda a, b: np.einsum("...i,i->...", np.stack([a, b], -1), [0.4, -0.9])),
}


def _in_place(a: Any, b: Any) -> Any:
    both = np.stack([a, b], -1).copy()
    both[..., 1] += both[..., 0]
    both[..., 0] = 1.0
    return both[..., 1]


class RandomFunction:
    """A function of ``(..., n)`` to ``(..., m)``, of so many of these words."""

    def __init__(self, rng: np.random.Generator, exact: bool) -> None:
        self.n, self.m = int(rng.integers(1, 5)), int(rng.integers(1, 4))
        self.words = EXACT if exact else EXACT | ROUNDED
        names = list(self.words)
        self.steps: list[tuple[str, tuple[int, ...]]] = []
        for k in range(int(rng.integers(2, 14))):
            name = names[rng.integers(len(names))]
            self.steps.append(
                (name, tuple(rng.integers(0, self.n + k, self.words[name][0]).tolist()))
            )

    def __call__(self, x: Any, rounded: Word = lambda value: value) -> Any:
        """Values of rows; ``rounded`` changes each number on the way, to see what rounding does."""
        values = [rounded(x[..., i]) for i in range(self.n)]
        for name, places in self.steps:
            values.append(rounded(self.words[name][1](*(values[place] for place in places))))
        return np.stack(values[-self.m :], -1) if self.m > 1 else values[-1]

    def __repr__(self) -> str:
        return f"{self.n} entries, {self.steps}, the last {self.m}"
