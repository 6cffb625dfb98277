"""A sea whose waves have one spectrum of yaw rates on every course."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimators.discretisation import van_loan
from estimators.engine import compiled
from vessel_gym.checks import check_numbers
from vessel_gym.disturbances.disturbance import Disturbance
from vessel_gym.processes import Process, root_of


@compiled
@dataclass(frozen=True)
class Sea(Disturbance):
    """Yaw rates by waves and gusts, and a current, that act on a ship.

    The wave yaw rate follows the second-order linear wave model ``s / (s^2 + 2 lambda w0 s +
    w0^2)`` with a damping for a JONSWAP peak (Fossen 2011, sec. 8.2.6). Gust and current are
    first-order Gauss-Markov processes. The state is (wave yaw angle, wave yaw rate, gust yaw rate,
    current north, current east), stationary from the first step.
    """

    wave: float  # yaw rate RMS, rad/s
    peak: float  # wave peak frequency met by the ship, rad/s
    gust: float  # yaw rate RMS, rad/s
    current: float  # speed RMS, m/s
    damping: float = 0.1  # lambda of a JONSWAP peak; 0.26 fits Pierson-Moskowitz
    gust_time: float = 15.0  # s
    current_time: float = 1000.0  # s
    dt: float = 0.5  # s

    def __post_init__(self) -> None:
        check_numbers(
            self,
            not_negative="wave gust current",
            positive="peak damping gust_time current_time dt",
        )

    names = ("wave yaw", "wave yaw rate", "gust yaw rate", "current north", "current east")
    forces = ("yaw increment", "current north", "current east")
    assumed_as = "unknown-input"

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Waves, gust and current."""
        wave = np.array([[0.0, 1.0], [-(self.peak**2), -2.0 * self.damping * self.peak]])
        intensity = np.diag([0.0, 4.0 * self.damping * self.peak * self.wave**2])
        transition, noise = van_loan(wave, np.eye(2), intensity, self.dt)
        waves = Process(transition, root_of(noise), self.wave**2 * np.diag([self.peak**-2, 1.0]))
        gust = Process.wandering((self.gust,), self.gust_time, self.dt)
        each = self.current / np.sqrt(2.0)  # component, which carries half the power
        return Process.joined(
            waves, gust, Process.wandering((each, each), self.current_time, self.dt)
        )

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Yaw increment d [rad] in the coming step, current north and east [m/s]: ``(..., 3)``."""
        increment = self.dt * (z[..., 1] + z[..., 2])
        return np.concatenate([increment[..., None], z[..., 3:]], -1)
