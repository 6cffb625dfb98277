"""Lorenz-63 and Lorenz-96: published scores of filters by members and particles.

Each of `BENCHMARKS`, of ``data/lorenz.toml``, is a setting with the analysis RMSE printed for
it. The score is that of the literature: at each analysis the root of the mean square error over the
components, averaged over the analyses after a burn-in.

Sources: Lorenz (1963), Deterministic nonperiodic flow; Lorenz & Emanuel (1998), Optimal sites for
supplementary weather observations; Sakov & Oke (2008a), A deterministic formulation of the ensemble
Kalman filter; Sakov, Oliver & Bertino (2012), An iterative EnKF for strongly nonlinear systems; and
those that ``data/lorenz.toml`` names. The values are those printed in DAPPER (Raanes et al.,
https://github.com/nansencenter/DAPPER) beside the settings of these papers, in ``mods/Lorenz63``
and ``mods/Lorenz96``: all but those of methods that are not here (smoothers, local, serial and
variational ones, members that are rotated, inflation that adapts), of Laplace's noise, of at most
100 particles, whose mean varies widely, of 400 members or 3000 particles and more, which take
minutes, and doubles.
"""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators import Gaussian, NonlinearModel, make
from studies.markdown import ROOT

Derivative = Callable[[np.ndarray], np.ndarray]


def lorenz63(x: np.ndarray) -> np.ndarray:
    """Time derivative of convection in three numbers; ``x`` is ``(..., 3)``."""
    a, b, c = x[..., 0], x[..., 1], x[..., 2]
    return np.stack([10.0 * (b - a), a * (28.0 - c) - b, a * b - 8.0 / 3.0 * c], -1)


def lorenz96(x: np.ndarray) -> np.ndarray:
    """Time derivative of weather on a circle of latitude; ``x`` is ``(..., n)``, n at least 4."""
    ring = np.concatenate([x[..., -2:], x, x[..., :1]], axis=-1)
    return (ring[..., 3:] - ring[..., :-3]) * ring[..., 1:-2] - x + 8.0


def rk4(derivative: Derivative, x: np.ndarray, dt: float, steps: int) -> np.ndarray:
    """``steps`` classical Runge-Kutta steps of ``x' = derivative(x)``."""
    for _ in range(steps):
        k1 = derivative(x)
        k2 = derivative(x + 0.5 * dt * k1)
        k3 = derivative(x + 0.5 * dt * k2)
        k4 = derivative(x + dt * k3)
        x = x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
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
        read: Indices of the measured components.
    """

    name: str
    derivative: Derivative
    start: list[float]
    start_var: float
    dt: float
    steps: int
    measurement_var: float
    burn_in: int
    read: list[int]

    def model(self) -> NonlinearModel:
        """The model, from one measurement to the next."""
        n, read = len(self.start), self.read
        return NonlinearModel(
            transition=lambda x, u: rk4(self.derivative, x, self.dt, self.steps),
            measurement=lambda x, u: x[..., read],
            Q=np.zeros((n, n)),
            R=self.measurement_var * np.eye(len(read)),
        )


@dataclass(frozen=True)
class Benchmark:
    """A published score.

    Attributes:
        setting: The system.
        filters: The filters that the score is for: several names of one transform.
        members: N, of members or of particles.
        published: Analysis RMSE as printed.
        source: Of the score.
        tuning: Other options of the filter.
        reported_only: True if the mean varies too much to be held against: with few members or
            particles, or with the least inflation that works, about one run in twenty loses the
            truth for good.
    """

    setting: Setting
    filters: list[str]
    members: int
    published: float
    source: str
    tuning: dict[str, Any]
    reported_only: bool = False

    @property
    def options(self) -> dict[str, Any]:
        """Options of the filter; the draws of published ensembles are independent."""
        if "pf" in self.filters:
            return {"particles": self.members} | self.tuning
        return {"members": self.members, "draws": "independent"} | self.tuning

    @property
    def described(self) -> str:
        """The tuning in words."""
        return ", ".join(f"{key} {value:g}" for key, value in self.tuning.items())


_data = tomllib.loads((ROOT / "studies/data/lorenz.toml").read_text(encoding="utf-8"))
SETTINGS = {
    name: Setting(name, **of | {"derivative": globals()[of["derivative"]]})
    for name, of in _data["settings"].items()
}
BENCHMARKS = [Benchmark(**of | {"setting": SETTINGS[of["setting"]]}) for of in _data["benchmarks"]]


def analysis_rmse(
    benchmark: Benchmark, filter_name: str, runs: int, cycles: int = 1000, seed: int = 0
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
    total, sd = np.zeros(runs), np.sqrt(setting.measurement_var)
    for k in range(setting.burn_in + cycles):
        truth = model.transition(truth, None)
        y = model.measurement(truth, None) + sd * world.standard_normal((runs, model.p))
        belief = filter.update(filter.predict(belief, rng=chance), y, rng=chance)
        if k >= setting.burn_in:
            total += np.sqrt(np.mean((belief.mean - truth) ** 2, axis=-1))
    return total / cycles
