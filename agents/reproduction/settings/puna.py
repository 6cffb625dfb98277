"""The paper on navigating and estimating a PUNA with Dubins paths and the ensemble Kalman filter (in Indonesian).

It prints two Dubins cases, eight RMS errors and the sizes of ensembles. It prints neither the aircraft's constants nor
the filter's Q and R, nor its step, its duration or how the angle of attack varies.
"""

from dataclasses import dataclass

import numpy as np

from agents.reproduction.comparison import Published


@dataclass(frozen=True)
class State:
    """A component of the state (gamma, v, x, h)."""

    symbol: str
    name: str
    unit: str


STATES = (
    State("γ", "flight-path angle", "rad"),
    State("v", "airspeed", "m/s"),
    State("x", "horizontal position", "m"),
    State("h", "altitude", "m"),
)

# --- printed: the paths -----------------------------------------------------------------------------

SPEED = 20.0
"""Airspeed of both cases [m/s]."""
RADIUS = 100.0
"""Of the first and of the last circle, in both cases [m]."""


@dataclass(frozen=True)
class OpenCase:
    """Section "Simulasi Lintasan Dubins tanpa Halangan" and figure 2."""

    start: tuple[float, float] = (-500.0, 100.0)  # m
    goal: tuple[float, float] = (0.0, 200.0)  # m
    headings: tuple[float, float] = (np.pi / 6, 0.0)  # rad, "to the y axis"
    word: str = "RSR"


@dataclass(frozen=True)
class ObstacleCase:
    """Section "Simulasi Lintasan Dubins dengan Halangan" and figure 3."""

    start: tuple[float, float] = (-407.7151, 149.8384)  # m
    goal: tuple[float, float] = (-5.6824, 126.9565)  # m
    headings: tuple[float, float] = (np.pi / 3, 0.0)  # rad, "to the y axis"
    obstacle: tuple[float, float, float] = (-250.0, 150.0, 30.0)  # x, y, radius, m
    word: str = "SRS"


OPEN, OBSTRUCTED = OpenCase(), ObstacleCase()
PRINT = 5e-5
"""What rounding hides of the obstacle case's coordinates [m]: half of their last digit."""
READINGS = {
    "from the x axis": (0.0, 1.0),
    "from the y axis, clockwise": (np.pi / 2, -1.0),
    "from the y axis, counter-clockwise": (np.pi / 2, 1.0),
}
"""Readings of a printed heading chi: theta = offset + sign chi, from +x towards +y. The paper says "to the y axis"."""

# --- printed: the estimation ------------------------------------------------------------------------

CONTROLS = ("constant", "varying")
"""The angle of attack."""
_CONSTANT, _VARYING = "section 'Simulasi dengan sudut α tetap'", "section 'Simulasi dengan sudut α tidak tetap'"
PRINTED = {
    "constant": tuple(
        Published(printed, state.unit, _CONSTANT)
        for printed, state in zip(("0.031752", "1.7216", "0.17277", "0.18417"), STATES, strict=True)
    ),
    "varying": (
        Published("0.030345", "rad", _VARYING),
        Published("18291", "m/s", _VARYING, meant=1.8291),  # 18 km/s otherwise: the decimal point was lost
        Published("0.17655", "m", _VARYING),
        Published("0.20351", "m", _VARYING),
    ),
}
"""RMS errors of (gamma, v, x, h)."""
PRINTED_MEMBERS = {"constant": 300, "varying": 100}
"""Members with which the printed errors were found."""
BEST_MEMBERS = {"constant": 300, "varying": 200}
"""Members that the abstract calls much better."""

# --- assumed ----------------------------------------------------------------------------------------

MEMBERS = (50, 100, 200, 300, 400)
"""The printed sizes, with one below and one above."""
MEASURED = {"all": "every state", "x": "x alone"}
"""The two sets of measurements, as `PlanarPuna.model` names them."""
STEPS = 200
"""Steps of a flight; with the model's 0.01 s they are 2 s. Both are assumed: the paper prints neither."""
START = (0.0, SPEED, 0.0, 100.0)
"""Level, at the speed and the first altitude of the Dubins cases; no initial state of the estimation is printed."""
SWING = float(np.deg2rad(2.0))
"""Amplitude of the varying angle of attack [rad]: twice the angle of level flight, clear of the stall."""
PERIOD = 1.0
"""Of the varying angle of attack [s]: two periods in a flight."""
SEED = 2017
RUNS = 150

SIZES = np.array([float(f"{published.value**2:.0e}") for published in PRINTED["constant"]])
"""Variances D ``(4,)``: squares of the printed errors, to one digit. What follows from them is circular."""


@dataclass(frozen=True)
class Level:
    """A noise level: covariances of a step and of a reading in units of D; the reasons stand in ``pages/puna.md``."""

    title: str
    process: float
    reading: float


LEVELS = {
    "flight": Level("noise of a flight", 0.03, 1.5),
    "sizes": Level("noise of the printed sizes", 3.0, 1.5),
}
"""Each holds for all numbers of its table and was not changed after its results; neither is more the paper's than the
other."""

SCALES = ((1.0, 1.0), (2.0, 2.0), (0.5, 0.5), (0.1, 0.1), (0.5, 1.0), (0.1, 1.0), (1.0, 0.5), (1.0, 0.1))
"""Factors on Q and on R, to see how much of a printed error they decide."""
