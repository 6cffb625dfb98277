"""Lorenz-63 and Lorenz-96: published scores of filters by members and particles, and the experiments behind them.

Each of `BENCHMARKS`, the rows of ``benchmarks.csv``, is a setting with the analysis RMSE printed
for it. The score is that of the literature: at each analysis the root of the mean square error over
the components, averaged over the analyses after a burn-in.

Sources: Lorenz (1963), Deterministic nonperiodic flow; Lorenz & Emanuel (1998), Optimal sites for
supplementary weather observations; Sakov & Oke (2008a), A deterministic formulation of the ensemble
Kalman filter; Sakov, Oliver & Bertino (2012), An iterative EnKF for strongly nonlinear systems; and
those that ``benchmarks.csv`` names. The values are those printed in DAPPER (Raanes et al.,
https://github.com/nansencenter/DAPPER) beside the settings of these papers, in ``mods/Lorenz63``
and ``mods/Lorenz96``: all but those of methods that are not here (smoothers, local, serial and
variational ones, members that are rotated, inflation that adapts), of Laplace's noise, of 400
members or 3000 particles and more, which take minutes, and doubles.
"""

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from estimators.factory import make
from estimators.models import Gaussian, NonlinearModel


def lorenz63(
    x: np.ndarray, sigma: float = 10.0, rho: float = 28.0, beta: float = 8.0 / 3.0
) -> np.ndarray:
    """Time derivative of convection in three numbers; ``x`` is ``(..., 3)``."""
    a, b, c = x[..., 0], x[..., 1], x[..., 2]
    rate = np.empty(x.shape)
    rate[..., 0] = sigma * (b - a)
    rate[..., 1] = a * (rho - c) - b
    rate[..., 2] = a * b - beta * c
    return rate


def lorenz96(x: np.ndarray, exogenous: float = 8.0) -> np.ndarray:
    """Time derivative of weather on a circle of latitude; ``x`` is ``(..., n)`` with n at least 4."""
    ring = np.concatenate([x[..., -2:], x, x[..., :1]], axis=-1)
    rate = ring[..., 3:] - ring[..., :-3]
    rate *= ring[..., 1:-2]
    rate -= x
    rate += exogenous
    return rate


def rk4(
    derivative: Callable[[np.ndarray], np.ndarray], x: np.ndarray, dt: float, steps: int = 1
) -> np.ndarray:
    """``steps`` classical Runge-Kutta steps of ``x' = derivative(x)``."""
    for _ in range(steps):
        k1 = derivative(x)
        k2 = derivative(x + 0.5 * dt * k1)
        k3 = derivative(x + 0.5 * dt * k2)
        k4 = derivative(x + dt * k3)
        k2 += k3
        x = x + dt / 6.0 * (k1 + 2.0 * k2 + k4)
    return x


@dataclass(frozen=True)
class Setting:
    """A chaotic system without process noise.

    Attributes:
        name: Of the system.
        derivative: ``x'`` as a function of ``x (..., n)``.
        start: ``(n,)`` state near the attractor.
        start_var: Variance of each component of the prior about the truth.
        dt: Integration step.
        steps: Integration steps between measurements.
        measurement_var: Variance of each measurement.
        burn_in: Analyses left out of the score.
        seen: Which components are read; None: all.
    """

    name: str
    derivative: Callable[[np.ndarray], np.ndarray]
    start: tuple[float, ...]
    start_var: float
    dt: float
    steps: int
    measurement_var: float
    burn_in: int
    seen: tuple[int, ...] | None = None

    @property
    def read(self) -> list[int]:
        """Indices of the measured components."""
        return list(range(len(self.start)) if self.seen is None else self.seen)

    def model(self) -> NonlinearModel:
        """The model, from one measurement to the next."""
        n, read = len(self.start), self.read
        return NonlinearModel(
            transition=lambda x, u: rk4(self.derivative, x, self.dt, self.steps),
            measurement=lambda x, u: x[..., read],
            Q=np.zeros((n, n)),
            R=self.measurement_var * np.eye(len(read)),
        )


LORENZ63 = Setting(
    "Lorenz-63",
    lorenz63,
    start=(1.509, -1.531, 25.46),
    start_var=2.0,
    dt=0.01,
    steps=25,
    measurement_var=2.0,
    burn_in=64,
)
FIRST63 = replace(
    LORENZ63, name="Lorenz-63, R = 8, x alone", steps=12, measurement_var=8.0, burn_in=33, seen=(0,)
)
LORENZ96 = Setting(
    "Lorenz-96",
    lorenz96,
    start=(8.0,) * 40,
    start_var=0.001,
    dt=0.05,
    steps=1,
    measurement_var=1.0,
    burn_in=400,
)
SMALL96 = replace(
    LORENZ96,
    name="Lorenz-96 of 10, R = 1.5, half",
    start=(8.0,) * 10,
    measurement_var=1.5,
    seen=(0, 2, 4, 6, 8),
)
SETTINGS = (LORENZ63, FIRST63, LORENZ96, SMALL96)


@dataclass(frozen=True)
class Benchmark:
    """A published score.

    Attributes:
        setting: The system.
        filters: The filters that the score is for: several names where they are the same transform.
        members: N, of members or of particles.
        published: Analysis RMSE as printed.
        tuning: Other options of the filter.
        reported_only: Whether the mean varies too much to be held against: with few members or
            particles, or with the least inflation that works, about one run in twenty loses the
            truth for good.
        draws: Of an ensemble: those of the published scores are independent.
    """

    setting: Setting
    filters: tuple[str, ...]
    members: int
    published: float
    tuning: dict[str, Any] = field(default_factory=dict)
    reported_only: bool = False
    draws: str = "independent"

    @property
    def options(self) -> dict[str, Any]:
        """Options of the filter."""
        size = (
            {"particles": self.members}
            if "pf" in self.filters
            else {"members": self.members, "draws": self.draws}
        )
        return size | self.tuning

    @property
    def described(self) -> str:
        """The tuning in words."""
        return ", ".join(f"{key} {value:g}" for key, value in self.tuning.items())


def _read(row: Mapping[str, str]) -> Benchmark:
    """The benchmark of a row of ``benchmarks.csv``."""
    return Benchmark(
        next(each for each in SETTINGS if each.name == row["setting"]),
        tuple(row["filters"].split()),
        int(row["members"]),
        float(row["published"]),
        {key: float(row[key]) for key in ("inflation", "jitter", "threshold") if row[key]},
        bool(row["reported_only"]),
    )


with Path(__file__).with_name("benchmarks.csv").open(encoding="utf-8") as file:
    BENCHMARKS = tuple(map(_read, csv.DictReader(file)))


def analysis_rmse(
    benchmark: Benchmark,
    filter_name: str,
    runs: int,
    cycles: int = 1000,
    seed: int = 0,
) -> np.ndarray:
    """Scores ``(runs,)`` of independent runs, which are the rows of one batch.

    The truth starts on the attractor, and the prior is as far from it as the setting says. (From
    far away a small ensemble may never find the truth, which is not what the scores are about.)

    Args:
        benchmark: The setting and the filter's options.
        filter_name: One of ``benchmark.filters``.
        runs: Rows.
        cycles: Analyses that are scored.
        seed: Of the truth, the measurements and the filter.
    """
    setting = benchmark.setting
    world, chance = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    model, n = setting.model(), len(setting.start)
    filter = make(filter_name, model, **benchmark.options)
    truth = setting.start + world.standard_normal((runs, n))
    truth = rk4(setting.derivative, truth, setting.dt, round(10.0 / setting.dt))
    guess = truth + np.sqrt(setting.start_var) * world.standard_normal((runs, n))
    belief = filter.init(Gaussian(guess, setting.start_var * np.eye(n)), rng=chance)
    total = np.zeros(runs)
    for k in range(setting.burn_in + cycles):
        truth = model.transition(truth, None)
        y = model.measurement(truth, None) + np.sqrt(
            setting.measurement_var
        ) * world.standard_normal((runs, model.p))
        belief = filter.update(filter.predict(belief, rng=chance), y, rng=chance)
        if k >= setting.burn_in:
            total += np.sqrt(np.mean((belief.mean - truth) ** 2, axis=-1))
    return total / cycles
