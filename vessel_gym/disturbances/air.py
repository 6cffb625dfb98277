"""Wind, gusts and turbulence around an aircraft."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimators.engine import compiled
from vessel_gym.checks import check_numbers
from vessel_gym.disturbances.disturbance import Disturbance
from vessel_gym.processes import Process, block_diagonal


@compiled
@dataclass(frozen=True)
class Air(Disturbance):
    """Wandering wind, Dryden gusts and turbulence that act on an aircraft.

    Gusts have the low-altitude Dryden spectra (MIL-F-8785C) at a constant airspeed. The vertical
    gust has the second-order form. North and east gusts have the first-order, longitudinal form, so
    that a turn does not change the spectrum. The states are the mean wind north and east, the gusts
    north and east, and two states of the vertical gust [m/s]. Turbulence shorter than a step is
    white noise that adds increments to velocities and bank, with variances in proportion to the
    step's length. A filter that assumes this disturbance has an exact model of it.
    """

    wind: float  # RMS speed of the mean wind, which is horizontal, m/s
    gust: float  # standard deviation of each horizontal gust component, m/s
    vertical_gust: float  # standard deviation of the vertical gust, m/s
    # Standard deviations of what a second of turbulence adds to each velocity, m/s per sqrt(s), and
    # to the bank, rad per sqrt(s); the values in 0.1 s are assumed.
    increment: float = 0.05 / math.sqrt(0.1)
    roll: float = 0.005 / math.sqrt(0.1)
    wind_time: float = 200.0  # correlation time of the mean wind, s; assumed
    length: float = 200.0  # length scale of horizontal gusts, m; Beard & McLain (2012), Table 4.1
    vertical_length: float = 50.0  # length scale of vertical gusts, m; the same table
    airspeed: float = 20.0  # m/s
    dt: float = 0.1  # s

    def __post_init__(self) -> None:
        check_numbers(
            self, not_negative="wind gust vertical_gust increment roll",
            positive="wind_time length vertical_length airspeed dt",
        )  # fmt: skip

    names = (
        "mean wind north", "mean wind east", "gust north", "gust east", "gust down 1",
        "gust down 2",
    )  # fmt: skip
    forces = ("wind north", "wind east", "wind down")
    white_increments = ("north increment", "east increment", "climb increment", "phi increment")
    scale = (1.0, 1.0, 0.5, 0.5, 0.5, 0.5)

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Mean wind and gusts."""
        time, vertical_time = self.length / self.airspeed, self.vertical_length / self.airspeed
        # (1 + sqrt(3) T s) / (1 + T s)^2 of white noise, scaled so that both states have a quarter
        # of the variance
        vertical = np.array([[0.0, 1.0], [-1.0, -2.0]]) / vertical_time
        level = 2.0 * self.gust**2 / time
        A = block_diagonal(-np.eye(2) / time, vertical)
        gusts = Process.stationary(
            A, np.diag([level, level, 0.0, self.vertical_gust**2 / vertical_time]), self.dt
        )
        mean = self.wind / np.sqrt(2.0)
        return Process.joined(Process.wandering((mean, mean), self.wind_time, self.dt), gusts)

    @cached_property
    def white(self) -> np.ndarray:  # type: ignore[override]
        """Root of the covariance of a step's increments of velocities [m/s] and bank [rad]."""
        return np.sqrt(self.dt) * np.diag([*[self.increment] * 3, self.roll])

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Wind north, east and down [m/s]."""
        mean_north, mean_east, north, east, down, rising = np.moveaxis(z, -1, 0)
        return np.stack([mean_north + north, mean_east + east, rising * np.sqrt(3.0) + down], -1)
