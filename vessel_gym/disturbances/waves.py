"""Waves: a field of a spectrum for the truth, wave bands and a sea of one spectrum for filters."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import add
from typing import Any, ClassVar

import numpy as np

from estimators.discretisation import van_loan
from estimators.engine import along, compiled, lookup, sincos
from vessel_gym.checks import check_numbers
from vessel_gym.disturbances.disturbance import Disturbance
from vessel_gym.disturbances.spectrum import TURN, WaveSpectrum
from vessel_gym.processes import Process, interpolated, root_of
from vessel_gym.vehicles.vehicle import GRAVITY

BANDS = 2
_EDGES = np.linspace(0.0, 1.0, BANDS + 1)
"""Shares of the energy below the edges of the frequency bands."""
_DAMPING = 0.05
"""Half the width of a band, in units of its frequency."""
_FREQUENCIES, _NODES, _DIRECTIONS = 2048, 256, 128
"""Cells between which frequencies are tabled; cells of frequency and direction of directions."""
_GAP = 0.35  # rad; between directions farther apart than this no waves run


@dataclass(frozen=True, eq=False)
class WaveField:
    """A sea as a field in place and time: ``sum a cos(w t - kx x - ky y + p)``, deep water.

    All components have equal energy, and each has a direction. In an episode the frequencies are
    drawn within bins of equal energy, one in each, as are the directions, given the frequency. Both
    are paired at random. Phases p are drawn from a full turn. So the mean autocorrelation over
    episodes, of anything linear in the waves, is the integral of the spectrum over frequency and
    direction, and no episode is periodic.
    """

    spectrum: WaveSpectrum

    components: ClassVar[int] = 24
    uniforms: ClassVar[int] = 4 * components

    @property
    def amplitude(self) -> float:
        """Amplitude of each component [m]."""
        return self.spectrum.height / np.sqrt(8.0 * self.components)

    @cached_property
    def _frequencies(self) -> np.ndarray:
        """Frequencies [rad/s] below which shares 0, 1/2048, 2/2048 ... 1 of the energy lie."""
        return self.spectrum.frequency_at(np.linspace(0.0, 1.0, _FREQUENCIES + 1))

    @cached_property
    def _directions(self) -> np.ndarray:
        """Directions [rad] below which shares of the energy run, at frequencies ``(257, 129)``.

        The 129 shares ``(1 - cos(angle)) / 2`` lie close where few waves run.
        """
        shares = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _DIRECTIONS + 1))
        nodes = self._frequencies[:: _FREQUENCIES // _NODES]
        return np.stack([self.spectrum.directions_at(w, shares) for w in nodes])

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Constants ``(..., 4 n)`` of an episode, each of all n components.

        They are frequencies [rad/s], phases [rad], and wave numbers to the north and to the east
        [1/m].

        Args:
            uniforms: Random numbers in [0, 1] ``(..., 4 n)``.
        """
        n, (first, phases, within, order) = self.components, self.constants(uniforms)
        others = [order[..., i] for i in range(n)]

        def component(first: Any, phase: Any, within: Any, own: Any) -> list[Any]:
            rank = reduce(add, [np.where(own > other, 1.0, 0.0) for other in others])
            w = interpolated(self._frequencies, _FREQUENCIES / n * first)
            share = (rank + within) * (1.0 / n)
            angle = 2.0 * np.arctan2(np.sqrt(share), np.sqrt(1.0 - share))
            place = _DIRECTIONS / np.pi * angle
            theta = self._direction(_NODES / n * first, place)
            sin, cos = sincos(theta)
            k = w * w * (1.0 / GRAVITY)
            return [w, TURN * phase, k * cos, k * sin]

        return np.concatenate(along(component, np.arange(n) + first, phases, within, order), -1)

    def _direction(self, node: Any, place: Any) -> Any:
        """Direction [rad] between tabled ones, or the nearest of them if they lie far apart."""
        row, column = np.minimum(np.floor(node), _NODES - 1.0), np.floor(place)
        cell = row * _DIRECTIONS + np.minimum(column, _DIRECTIONS - 1.0)
        nearest = interpolated(self._directions, np.rint(node), np.rint(place))
        between = interpolated(self._directions, node, place)
        return np.where(lookup(self._apart, cell) > _GAP, nearest, between)

    @cached_property
    def _apart(self) -> np.ndarray:
        """Differences [rad] of the corners of each cell of the table of directions."""
        table = self._directions
        corners = np.stack([table[:-1, :-1], table[:-1, 1:], table[1:, :-1], table[1:, 1:]])
        return np.ptp(corners, axis=0).ravel()

    def superposition(
        self, motion: Callable[..., list[Any]], drawn: np.ndarray, time: np.ndarray, north: Any,
        east: Any, *others: np.ndarray,
    ) -> list[np.ndarray]:  # fmt: skip
        """Motions ``(...)`` in all waves together, which are linear in the waves' amplitude.

        Args:
            motion: Function of a wave's frequency [rad/s], wave numbers to the north and east [1/m]
                and phase [rad], and of its entries of ``others``, that returns motions per metre of
                amplitude.
            drawn: Result of `draw` ``(..., 4 n)``.
            time: Time [s] ``(...)``.
            north: Position in the water to the north [m] ``(...)``.
            east: Position in the water to the east [m] ``(...)``.
            others: Further constants of the waves ``(..., n)``.
        """

        def of_wave(w: Any, phase: Any, kx: Any, ky: Any, *others: Any) -> list[Any]:
            return motion(w, kx, ky, phase + w * time - kx * north - ky * east, *others)

        each = along(of_wave, *self.constants(drawn), *others)
        return [self.amplitude * every.sum(-1) for every in each]

    def constants(self, drawn: np.ndarray) -> list[np.ndarray]:
        """The four constants of `draw`, each of all components ``(..., n)``."""
        return [drawn[..., i * self.components : (i + 1) * self.components] for i in range(4)]


@dataclass(frozen=True, eq=False)
class WaveBands:
    """A filter's model of a `WaveField`: waves of two frequencies in two directions each.

    Each is a complex number ``z+ = exp((j w - b) dt) z + n`` whose variance is 1 at any frequency.
    The two directions of a frequency band lie as far to either side of its mean direction as keeps
    the variance of the spreading across it; systems that run against each other in one band are not
    told apart. The damping b is constant, because a damping by the ship's speed through wave groups
    serves no better.
    """

    spectrum: WaveSpectrum

    names: ClassVar[tuple[str, ...]] = tuple(
        f"wave {band} {side} {part}"
        for band in range(1, BANDS + 1)
        for side in ("left", "right")
        for part in ("real", "imaginary")
    )

    @cached_property
    def cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies [rad/s] and directions [rad] of equal energy in each band ``(2, 144)``."""
        middles = (np.arange(12) + 0.5) / 12.0
        w = self.spectrum.frequency_at(_EDGES[:-1, None] + np.diff(_EDGES)[:, None] * middles)
        theta = [[self.spectrum.directions_at(each, middles) for each in row] for row in w]
        return np.repeat(w, len(middles), axis=1), np.reshape(theta, (BANDS, -1))

    @cached_property
    def frequencies(self) -> np.ndarray:
        """Frequency of each wave [rad/s] ``(4,)``."""
        return np.repeat(self.cells[0].mean(1), 2)

    @cached_property
    def directions(self) -> np.ndarray:
        """Direction of each wave [rad] ``(4,)``."""
        mean = np.angle(np.exp(1j * self.cells[1]).mean(1))
        off = np.arcsin(np.sqrt((np.sin(self.cells[1] - mean[:, None]) ** 2).mean(1)))
        return np.stack([mean - off, mean + off], -1).ravel()

    @cached_property
    def numbers(self) -> np.ndarray:
        """Wave numbers to the north and east ``(4, 2)`` [1/m], in deep water."""
        way = np.stack([np.cos(self.directions), np.sin(self.directions)], -1)
        return (self.frequencies**2 / GRAVITY)[:, None] * way

    def loadings(self, response: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """Complex response ``(4, ...)`` to a unit of each wave.

        Both waves of a band together have the power of all its cells.

        Args:
            response: Complex response ``(k, ...)`` per metre of amplitude, of frequencies [rad/s]
                and directions [rad] ``(k,)``.
        """
        each, energy = [], self.spectrum.height**2 / 16.0 / BANDS
        for band in range(BANDS):
            pair = slice(2 * band, 2 * band + 2)
            both = response(self.frequencies[pair], self.directions[pair])
            whole = response(*(cells[band] for cells in self.cells))
            power = energy * (np.abs(whole) ** 2).mean(0)
            each.append(both * np.sqrt(power / np.maximum((np.abs(both) ** 2).sum(0), 1e-300)))
        return np.concatenate(each)

    def process(self, dt: float) -> Process:
        """Process of the waves' real and imaginary parts over a step of ``dt`` [s]."""
        bands = []
        for frequency in self.frequencies:
            kept = np.exp(-_DAMPING * frequency * dt)
            cos, sin = kept * np.cos(frequency * dt), kept * np.sin(frequency * dt)
            rotation = np.array([[cos, -sin], [sin, cos]])
            bands.append(Process(rotation, np.sqrt(1.0 - kept**2) * np.eye(2), np.eye(2)))
        return Process.joined(*bands)

    def at(
        self, z: np.ndarray, north: np.ndarray, east: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Real and imaginary part ``(...)`` of each wave, ``exp(-j (kx x + ky y)) z``."""
        parts = []
        for wave, (kx, ky) in enumerate(self.numbers):
            sin, cos = sincos(kx * north + ky * east)
            real, imaginary = z[..., 2 * wave], z[..., 2 * wave + 1]
            parts.append((real * cos + imaginary * sin, imaginary * cos - real * sin))
        return parts


class InWaves(Disturbance):
    """Base of disturbances with waves of a spectrum: a field, which filters assume as bands."""

    spectrum: WaveSpectrum
    uniforms = WaveField.uniforms

    @cached_property
    def waves(self) -> WaveField:
        """The wave field alone."""
        return WaveField(self.spectrum)

    @cached_property
    def bands(self) -> WaveBands:
        """The waves of a filter's model alone."""
        return WaveBands(self.spectrum)


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
