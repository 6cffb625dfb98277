"""Lorenz-63 and Lorenz-96: published scores of ensemble filters, and the experiments that should give them.

Each row of `BENCHMARKS` is a setting with the analysis RMSE printed for it. The score is that of the literature: at
each analysis the root of the mean square error over the components, averaged over the analyses after a burn-in.

Sources: Lorenz (1963), Deterministic nonperiodic flow; Lorenz & Emanuel (1998), Optimal sites for supplementary weather
observations; Sakov & Oke (2008a), A deterministic formulation of the ensemble Kalman filter; Sakov, Oliver & Bertino
(2012), An iterative EnKF for strongly nonlinear systems; Bocquet, Raanes & Hannart (2015), Expanding the validity of
the ensemble Kalman filter without the intrinsic need for inflation. The values are those printed in DAPPER (Raanes et
al., https://github.com/nansencenter/DAPPER), ``mods/Lorenz63/sakov2012.py`` and ``mods/Lorenz96/sakov2008.py``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.factory import make
from estimators.models import Gaussian, NonlinearModel


def lorenz63(x: np.ndarray, sigma: float = 10.0, rho: float = 28.0, beta: float = 8.0 / 3.0) -> np.ndarray:
    """Time derivative of convection in three numbers; ``x`` is ``(..., 3)``."""
    a, b, c = x[..., 0], x[..., 1], x[..., 2]
    rate = np.empty(x.shape)
    rate[..., 0] = sigma * (b - a)
    rate[..., 1] = a * (rho - c) - b
    rate[..., 2] = a * b - beta * c
    return rate


def lorenz96(x: np.ndarray, forcing: float = 8.0) -> np.ndarray:
    """Time derivative of weather on a circle of latitude; ``x`` is ``(..., n)`` with n at least 4."""
    ring = np.concatenate([x[..., -2:], x, x[..., :1]], axis=-1)
    rate = ring[..., 3:] - ring[..., :-3]
    rate *= ring[..., 1:-2]
    rate -= x
    rate += forcing
    return rate


def rk4(derivative: Callable[[np.ndarray], np.ndarray], x: np.ndarray, dt: float, steps: int = 1) -> np.ndarray:
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
    """A chaotic system that is seen whole, without process noise.

    Attributes:
        name: Of the system.
        derivative: ``x'`` as a function of ``x (..., n)``.
        start: ``(n,)`` state near the attractor.
        start_var: Variance of each component of the prior about the truth.
        dt: Integration step.
        steps: Integration steps between readings.
        reading_var: Variance of each reading.
        burn_in: Analyses left out of the score.
    """

    name: str
    derivative: Callable[[np.ndarray], np.ndarray]
    start: tuple[float, ...]
    start_var: float
    dt: float
    steps: int
    reading_var: float
    burn_in: int

    def model(self) -> NonlinearModel:
        """The model, from one reading to the next."""
        n = len(self.start)
        return NonlinearModel(
            transition=lambda x, u: rk4(self.derivative, x, self.dt, self.steps),
            measurement=lambda x, u: x,
            Q=np.zeros((n, n)),
            R=self.reading_var * np.eye(n),
        )


LORENZ63 = Setting(
    "Lorenz-63", lorenz63, start=(1.509, -1.531, 25.46), start_var=2.0, dt=0.01, steps=25, reading_var=2.0, burn_in=64
)
LORENZ96 = Setting(
    "Lorenz-96", lorenz96, start=(8.0,) * 40, start_var=0.001, dt=0.05, steps=1, reading_var=1.0, burn_in=400
)


@dataclass(frozen=True)
class Benchmark:
    """A published score.

    Attributes:
        setting: The system.
        filters: The filters that the score is for: several names where they are the same transform.
        members: N.
        inflation: Factor on the analysis anomalies.
        rotate: Whether the anomalies are rotated at random.
        published: Analysis RMSE as printed.
        source: Where.
        reported_only: Whether the mean varies too much to be held against: with few members, or with the least
            inflation that works, about one run in twenty loses the truth for good.
    """

    setting: Setting
    filters: tuple[str, ...]
    members: int
    inflation: float
    rotate: bool
    published: float
    source: str
    reported_only: bool = False

    @property
    def options(self) -> dict[str, object]:
        """Options of the filter."""
        options: dict[str, object] = {"members": self.members, "inflation": self.inflation}
        return options | ({"rotate": True} if self.rotate else {})


_ENKF, _SQUARE_ROOT = ("enkf",), ("enkf-sr", "etkf")
_SAKOV2012 = "Sakov et al. (2012), Table 1; DAPPER Lorenz63/sakov2012"
_SAKOV2008 = "Sakov & Oke (2008a), Table 1; DAPPER Lorenz96/sakov2008"
_DAPPER = "DAPPER, an early version of Lorenz96/sakov2008"
_BOCQUET2015 = "Bocquet et al. (2015), Fig. 3; DAPPER Lorenz96/sakov2008"

BENCHMARKS = (
    Benchmark(LORENZ63, _ENKF, 10, 1.04, False, 0.65, _SAKOV2012, reported_only=True),
    Benchmark(LORENZ63, _ENKF, 100, 1.01, False, 0.56, _SAKOV2012),
    Benchmark(LORENZ63, _SQUARE_ROOT, 3, 1.30, False, 0.80, _SAKOV2012),
    Benchmark(LORENZ63, _SQUARE_ROOT, 10, 1.02, True, 0.60, _SAKOV2012),
    Benchmark(LORENZ96, _ENKF, 28, 1.08, False, 0.24, _SAKOV2008),
    Benchmark(LORENZ96, _ENKF, 40, 1.06, False, 0.22, _SAKOV2008),
    Benchmark(LORENZ96, _SQUARE_ROOT, 20, 1.04, True, 0.20, _BOCQUET2015),
    Benchmark(LORENZ96, _SQUARE_ROOT, 24, 1.013, True, 0.18, _SAKOV2008, reported_only=True),
    Benchmark(LORENZ96, _SQUARE_ROOT, 40, 1.01, True, 0.175, _DAPPER),
)


def analysis_rmse(
    benchmark: Benchmark,
    filter_name: str,
    runs: int,
    cycles: int = 1000,
    seed: int = 0,
    progress: Callable[[], None] = lambda: None,
) -> np.ndarray:
    """Scores ``(runs,)`` of independent runs, which are the rows of one batch.

    The truth starts on the attractor, and the prior is as far from it as the setting says. (From far away a small
    ensemble may never find the truth, which is not what the scores are about.)

    Args:
        benchmark: The setting and the filter's options.
        filter_name: One of ``benchmark.filters``.
        runs: Rows.
        cycles: Analyses that are scored.
        seed: Of the truth, the readings and the filter.
        progress: Called after every analysis, of which there are ``benchmark.setting.burn_in + cycles``.
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
        y = truth + np.sqrt(setting.reading_var) * world.standard_normal((runs, n))
        belief = filter.update(filter.predict(belief, rng=chance), y, rng=chance)
        if k >= setting.burn_in:
            total += np.sqrt(np.mean((belief.mean - truth) ** 2, axis=-1))
        progress()
    return total / cycles
