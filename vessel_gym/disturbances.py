"""What the sea does to a vehicle: waves, gusts, turbulence and current, all made from white noise."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.linalg import block_diag, solve_continuous_lyapunov

from estimators import van_loan


@dataclass(frozen=True)
class Sea:
    """What the sea does to a ship's heading and track: wave and gust yaw rate, and a current.

    The wave yaw rate follows the second-order linear wave model ``s / (s^2 + 2 lambda w0 s + w0^2)``
    with the damping that fits a JONSWAP peak (Fossen 2011, sec. 8.2.6); gust and current are
    first-order Gauss-Markov processes. Their state is (wave yaw angle, wave yaw rate, gust yaw
    rate, current north, current east), stationary from the first step.
    """

    wave: float  # yaw rate RMS, rad/s
    peak: float  # wave peak frequency met by the ship, rad/s
    gust: float  # yaw rate RMS, rad/s
    current: float  # speed RMS, m/s
    damping: float = 0.1  # lambda of a JONSWAP peak; 0.26 fits Pierson-Moskowitz
    gust_time: float = 15.0  # s
    current_time: float = 1000.0  # s
    dt: float = 0.5  # s

    size = 5

    @cached_property
    def stationary_cov(self) -> np.ndarray:
        """``(5, 5)`` covariance of the state."""
        A, W = self._continuous
        return solve_continuous_lyapunov(A, -W)

    @cached_property
    def unknown_input_var(self) -> float:
        """Variance [rad^2] of the yaw increment ``d`` over one step."""
        return self.dt**2 * (self.wave**2 + self.gust**2)

    def start(self, normals: np.ndarray) -> np.ndarray:
        """A stationary state ``(..., 5)`` from standard normals of the same shape."""
        return np.matvec(self._stationary_root, normals)

    def advance(self, state: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """The state ``(..., 5)`` one step later (exact discretisation)."""
        A, L = self.discrete
        return np.matvec(A, state) + np.matvec(L, normals)  # row by row: the same to the last bit in any batch

    def forcing(self, state: np.ndarray) -> np.ndarray:
        """The yaw increment d [rad] over the coming step, and the current north and east [m/s]: ``(..., 3)``."""
        forcing = state[..., 2:].copy()
        forcing[..., 0] = self.dt * (state[..., 1] + state[..., 2])
        return forcing

    @cached_property
    def _continuous(self) -> tuple[np.ndarray, np.ndarray]:
        wave = np.array([[0.0, 1.0], [-(self.peak**2), -2.0 * self.damping * self.peak]])
        A = block_diag(wave, -1.0 / self.gust_time, -1.0 / self.current_time, -1.0 / self.current_time)
        drift = 2.0 * self.current**2 / (2.0 * self.current_time)  # each component carries half the power
        W = np.diag([0.0, 4.0 * self.damping * self.peak * self.wave**2, 2.0 * self.gust**2 / self.gust_time, drift,
                     drift])  # fmt: skip
        return A, W

    @cached_property
    def _stationary_root(self) -> np.ndarray:
        return _root(self.stationary_cov)

    @cached_property
    def discrete(self) -> tuple[np.ndarray, np.ndarray]:
        """Transition ``(5, 5)`` over a step and a root ``(5, 5)`` of the noise that enters in it."""
        A, W = self._continuous
        transition, noise = van_loan(A, np.eye(self.size), W, self.dt)
        return transition, _root(noise)


@dataclass(frozen=True)
class Water:
    """What the water does to a submerged vehicle: turbulence, and a current that wanders.

    White noise: over each step turbulence kicks every velocity of the vehicle through the water, and the current, a
    first-order Gauss-Markov process that is part of the vehicle's state, gets its increment. The state
    is the forcing itself. A filter that is told ``kick_sd`` knows all that there is to know.
    """

    turbulence: float  # standard deviation of a kick, m/s
    spin: float  # of a kick on a rate, rad/s
    current: float  # RMS speed, m/s
    velocities: int = 3  # how many velocities,
    rates: int = 3  # rates
    currents: int = 2  # and components of the current the vehicle has
    current_time: float = 200.0  # s
    dt: float = 0.1  # s

    @property
    def size(self) -> int:
        """Components of the forcing."""
        return self.velocities + self.rates + self.currents

    @property
    def current_sd(self) -> float:
        """Standard deviation [m/s] of each component of the current."""
        return self.current / np.sqrt(self.currents)

    @cached_property
    def kick_sd(self) -> np.ndarray:
        """Standard deviations ``(size,)`` of the forcing: kicks on velocities, on rates, increments of the current."""
        increment = self.current_sd * np.sqrt(-np.expm1(-2.0 * self.dt / self.current_time))
        return np.repeat([self.turbulence, self.spin, increment], [self.velocities, self.rates, self.currents])

    def start(self, normals: np.ndarray) -> np.ndarray:
        """A state ``(..., size)`` from standard normals of the same shape."""
        return self.kick_sd * normals

    def advance(self, state: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """The state ``(..., size)`` one step later, which remembers nothing."""
        return self.kick_sd * normals

    def forcing(self, state: np.ndarray) -> np.ndarray:
        """Kicks on velocities [m/s] and rates [rad/s] and the increment of the current [m/s]: the state itself."""
        return state


@dataclass(frozen=True)
class Air:
    """What the air does to an aircraft: a wind that wanders, Dryden gusts on top of it, and turbulence that shakes it.

    Low-altitude Dryden spectra (MIL-F-8785C) as met at a constant airspeed: the vertical gust has the second-order
    form; north and east have the first-order, longitudinal one, so that a turn does not change the spectrum. Mean wind,
    the gusts' state (north, east, two of the vertical) and the bias of the vehicle's GNSS are part of the vehicle's
    state: this is only the white noise that enters in a step, and the state is the forcing itself. A filter that is
    told ``decay`` and ``noise_cov`` knows all that there is to know.
    """

    wind: float  # RMS speed of the mean wind, which is level, m/s
    gust: float  # standard deviation of a level gust component, m/s
    vertical_gust: float  # of the vertical one, m/s
    kick: float = 0.05  # standard deviation of what turbulence kicks each velocity in a step, m/s; assumed
    roll: float = 0.005  # of what it rolls the aircraft, rad; assumed
    wind_time: float = 200.0  # s, in which the mean wind changes; assumed
    drift: tuple[float, float, float] = (0.21, 0.21, 0.40)  # of the GNSS's bias in 1 s, m: Beard & McLain, ch. 7
    length: float = 200.0  # m, of level gusts; Beard & McLain (2012), Table 4.1
    vertical_length: float = 50.0  # m, of vertical ones; there too
    airspeed: float = 20.0  # m/s
    dt: float = 0.1  # s

    size: ClassVar = 13

    @cached_property
    def wind_sd(self) -> np.ndarray:
        """Standard deviations ``(6,)`` at any time: mean wind north, east and the four states of the gusts [m/s]."""
        mean = self.wind / np.sqrt(2.0)
        return np.array([mean, mean, *np.sqrt(np.diag(self.stationary_cov))])

    @cached_property
    def stationary_cov(self) -> np.ndarray:
        """``(4, 4)`` covariance of the gusts' state at any time."""
        A, W = self._continuous
        return solve_continuous_lyapunov(A, -W)

    @cached_property
    def decay(self) -> np.ndarray:
        """How the wind decays in a step ``(6,)``: mean, level gusts, and the vertical ones' matrix row by row."""
        A, _ = self.discrete
        return np.array([np.exp(-self.dt / self.wind_time), A[0, 0], *A[2:, 2:].ravel()])

    @cached_property
    def noise_cov(self) -> np.ndarray:
        """Covariance ``(13, 13)`` of the forcing."""
        return self._noise_root @ self._noise_root.T

    def start(self, normals: np.ndarray) -> np.ndarray:
        """A state ``(..., 13)`` from standard normals of the same shape."""
        return np.matvec(self._noise_root, normals)

    def advance(self, state: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """The state ``(..., 13)`` one step later, which remembers nothing."""
        return np.matvec(self._noise_root, normals)

    def forcing(self, state: np.ndarray) -> np.ndarray:
        """What enters velocities [m/s], bank [rad], mean wind, gusts [m/s] and bias [m]: the state itself."""
        return state

    @staticmethod
    def gusts(state: np.ndarray) -> np.ndarray:
        """Gusts ``(..., 3)`` of their state ``(..., 4)``: north, east, down [m/s]."""
        return np.matvec(np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, np.sqrt(3.0)]]), state)

    @cached_property
    def _continuous(self) -> tuple[np.ndarray, np.ndarray]:
        time, vertical_time = self.length / self.airspeed, self.vertical_length / self.airspeed
        # (1 + sqrt(3) T s) / (1 + T s)^2 of white noise, scaled so that both states have a quarter of the variance
        vertical = np.array([[0.0, 1.0], [-1.0, -2.0]]) / vertical_time
        level = 2.0 * self.gust**2 / time
        return block_diag(-1.0 / time, -1.0 / time, vertical), np.diag(
            [level, level, 0.0, self.vertical_gust**2 / vertical_time]
        )

    @cached_property
    def discrete(self) -> tuple[np.ndarray, np.ndarray]:
        """Transition ``(4, 4)`` of the gusts over a step and a root ``(4, 4)`` of the noise that enters in it."""
        A, W = self._continuous
        transition, noise = van_loan(A, np.eye(4), W, self.dt)
        return transition, _root(noise)

    @cached_property
    def _noise_root(self) -> np.ndarray:
        shake = np.diag([self.kick, self.kick, self.kick, self.roll])
        wander = self.wind_sd[0] * np.sqrt(-np.expm1(-2.0 * self.dt / self.wind_time))
        return block_diag(shake, wander, wander, self.discrete[1], np.diag(self.drift) * np.sqrt(self.dt))


def _root(cov: np.ndarray) -> np.ndarray:
    """A square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0.0))
