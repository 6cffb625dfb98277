"""Rudianto et al. (2024), Algoritma Robust Kalman Filtering untuk Sistem Waktu Kontinu yang Tidak Pasti.

SainsMath: Jurnal MIPA Sains Terapan 3(1), 1-11. The paper prints no number of its simulation: no matrix, no step, no
seed, no table of results. What stands here besides `FIGURES` is therefore ours, with the reason beside
it. A first trial with one reading led to three changes, which the page names or shows: two readings, the smaller
tolerance beside 0.1, and 2 σ for 1 σ among the sizes of outliers. Everything else was fixed before any run.
"""

from typing import NamedTuple

TITLE = "Rudianto et al. (2024), Algoritma Robust Kalman Filtering untuk Sistem Waktu Kontinu yang Tidak Pasti"
JOURNAL = "SainsMath: Jurnal MIPA Sains Terapan 3(1), 1–11"

FIGURES = {
    "Figure 1": "estimates of x₁ and x₂",
    "Figure 2": "estimates of x₁ and x₂ with the true states",
    "Figure 3": "Kalman gain over time",
    "Figure 4": "diagonal of the error covariance over time",
    "Figure 5": "estimates with and without disturbance",
}
"""What the paper's figures show, from its captions and section Pembahasan."""

# --- the random two-state system --------------------------------------------------------------------

STATES = 2
"""Printed: x₁ and x₂ (figures 1, 2)."""
READINGS = 2
"""The paper calls y a vector (below its eq. (4))."""
MARGIN = (0.1, 1.0)
"""Decay rate of the slowest mode, 1/s, uniform: the system is stable and remembers for 1 to 10 s."""
INTENSITY = (0.1, 10.0)
"""Intensity of the process noise, 1/s, log-uniform: predictions from much more to less certain than a reading."""
READING_VARIANCE = 1.0
"""Variance of a reading: the unit of y."""
PRIOR_VARIANCE = 10.0
"""Of each state at the start, mean 0: the filter knows little at first, as the paper says of its figures 3 and 4."""
STEP = 0.1
"""Seconds from reading to reading: ten in the shortest memory of a system."""
STEPS = 200
"""Twenty seconds: at least two memories."""
SKIPPED = 50
"""Readings before errors count: the start, of which every filter knows the same, is not the subject."""
INPUT_PERIOD = 100
"""Steps in which the known input u goes once from +1 to −1 and back, so that an error of A keeps mattering."""
PAPER_SEED = 2024
"""The system in the paper's place: the year it appeared in."""


class Population(NamedTuple):
    """Systems, and how many runs of each."""

    title: str
    seeds: tuple[int, ...]
    readings: int
    runs: int


RANDOM, PAPER, ONE_READING = "random", "paper", "one reading"
POPULATIONS = {
    RANDOM: Population("200 random systems", tuple(range(1, 201)), READINGS, 4),
    PAPER: Population(f"one system, seed {PAPER_SEED}", (PAPER_SEED,), READINGS, 300),
    ONE_READING: Population("200 random systems, only the first reading", tuple(range(1, 201)), 1, 4),
}
"""The unit of an interval is the system, so few runs of each do; of the single system it is the run.

One reading was tried first. A direction that it hardly shows lets ``robust-kf`` lose all confidence in steps of 0.1 s,
with nothing wrong at all; it stays as a warning, and the study uses two readings. No tolerance was changed for it: the
smaller one, the package's default, was added."""
NOISE_SEED = 7
"""Of everything drawn in a run: the same in every condition, so that conditions pair too."""

# --- the filters ------------------------------------------------------------------------------------

HUBER_THRESHOLD = 1.345
"""Standard deviations. Huber's own choice: 95 % of the efficiency of least squares where there is no outlier."""
TOLERANCES = (0.01, 0.1)
"""Zorzi's c of ``robust-kf``, the same for every system: the default of this package, and ten times as much.

At each step c allows a mean off by √c standard deviations: 0.1 or 0.32. An error of A of relative size δ moves the next
state by about δ |A| |x| dt, in standard deviations of the step's noise δ |A| √(dt / 2a), or roughly 0.8 δ at |A| = 2.5
and decay a = 0.5. Step by step, c is meant for errors of A of some 12 % and 40 %."""
FILTERS = {
    "kf": ("kf", {}),
    "huber-kf": ("huber-kf", {"gamma": HUBER_THRESHOLD}),
    "robust-kf, c = 0.01": ("robust-kf", {"radius": TOLERANCES[0]}),
    "robust-kf, c = 0.1": ("robust-kf", {"radius": TOLERANCES[1]}),
}
"""Name and options, the plain Kalman filter first."""

# --- what goes wrong --------------------------------------------------------------------------------


class Condition(NamedTuple):
    """What differs between the world and what the filters believe of it; nothing, by default.

    Attributes:
        rate: Probability that a reading is an outlier.
        size: By how much an outlier's noise is larger, standard deviations.
        tolerance: c of the least-favourable model that the readings come from.
        parameters: Relative error of A (Frobenius norm), in a direction of its own for every run.
    """

    rate: float = 0.0
    size: float = 10.0
    tolerance: float = 0.0
    parameters: float = 0.0


OUTLIERS = Condition(rate=0.1)
LEAST_FAVOURABLE = Condition(tolerance=0.1)
PARAMETERS = Condition(parameters=0.4)
"""One of each, in the middle of its range, for where a single one is shown."""
DISTURBANCE = Condition(rate=0.1)
"""Of figure 5: outliers; the paper does not say what its disturbance is."""

SWEEPS: dict[str, tuple[Condition, ...]] = {
    "rate": tuple(Condition(rate=rate) for rate in (0.0, 0.02, 0.05, 0.1, 0.2, 0.3)),
    "size": tuple(OUTLIERS._replace(size=size) for size in (2.0, 3.0, 5.0, 10.0, 30.0)),
    "tolerance": tuple(Condition(tolerance=c) for c in (0.0, 0.01, 0.03, 0.1, 0.3)),
    "parameters": tuple(Condition(parameters=error) for error in (0.0, 0.1, 0.2, 0.4, 0.8)),
}
"""One thing at a time, by the attribute that varies."""
CROSSED: dict[str, tuple[Condition, ...]] = {
    name: tuple(model._replace(rate=rate) for rate in (0.0, 0.02, 0.1, 0.3))
    for name, model in (("least-favourable model", LEAST_FAVOURABLE), ("parameter error", PARAMETERS))
}
"""Both at once: outlier rates under each model error."""

ALONE = (Condition(), OUTLIERS, PARAMETERS)
"""What is looked at with one reading only."""
