"""Long-crested waves: a field in place and time for the truth, and wave bands for filters."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np

from estimators.checks import finite_array
from estimators.engine import along, sincos
from vessel_gym.checks import check_numbers
from vessel_gym.processes import Process, interpolated

GRAVITY = 9.81  # m/s2
_RANGE = 0.4, 4.0
"""Lowest and highest frequency of waves, in units of the spectrum's peak frequency."""
BANDS = 3
_PEAKS = np.array([0.8, 1.0, 1.35])
"""Frequencies of the bands, in units of the spectrum's peak frequency."""
_EDGES = np.array([0.4, 0.894, 1.162, 4.0])
"""Edges of the bands, in units of the spectrum's peak frequency."""
_DAMPING = 0.05
"""Half the width of a band, in units of its frequency."""


def encounter_frequency(frequency: np.ndarray, beta: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Frequency of encounter [rad/s]; negative if the ship overtakes the waves.

    Args:
        frequency: Frequency of the waves [rad/s].
        beta: Direction of the waves relative to the heading [rad].
        speed: Speed of the ship [m/s].
    """
    given = {"frequency": frequency, "beta": beta, "speed": speed}
    frequency, beta, speed = (finite_array(name, value, "...") for name, value in given.items())
    return frequency - frequency**2 * speed * np.cos(beta) / GRAVITY


def jonswap(
    frequency: np.ndarray, height: float, period: float, peakedness: float = 3.3
) -> np.ndarray:
    """JONSWAP spectrum [m2 s] at frequencies [rad/s], scaled to a significant ``height`` [m].

    Hasselmann et al. (1973); a peakedness of 1 gives Pierson and Moskowitz's spectrum. The
    ``period`` [s] is that of the peak.

    Raises:
        ValueError: for a height, period or peakedness out of range, or frequencies that do not
            increase above 0.
    """
    check_numbers("jonswap", {"height": height}, not_negative="height")
    check_numbers(
        "jonswap", {"period": period, "peakedness": peakedness}, positive="period peakedness"
    )
    frequency = finite_array("frequency", frequency, "k")
    if len(frequency) < 2 or not frequency[0] > 0.0 or not (np.diff(frequency) > 0.0).all():
        raise ValueError(
            "frequency of jonswap must be two or more numbers above 0 [rad/s] that increase"
        )
    peak = 2.0 * np.pi / period
    width = np.where(frequency <= peak, 0.07, 0.09)
    bump = np.exp(-((frequency - peak) ** 2) / (2.0 * (width * peak) ** 2))
    shape = frequency**-5.0 * np.exp(-1.25 * (peak / frequency) ** 4) * peakedness**bump
    return shape * (height**2 / 16.0) / np.trapezoid(shape, frequency)


@dataclass(frozen=True)
class WaveField:
    """A JONSWAP sea as a field in place and time: ``sum a cos(w t - k s + p)``, s along the waves.

    All components have equal energy. In each episode the frequency w of a component is drawn within
    its bin of equal energy, and its phase p from a full turn. So the mean autocorrelation over
    episodes, of anything linear in the waves, is the integral of the spectrum, and no episode is
    periodic. In deep water k is ``w^2 / g``.
    """

    height: float  # significant wave height, m
    period: float  # peak period of the spectrum, s

    components: ClassVar[int] = 24
    uniforms: ClassVar[int] = 2 * components

    def __post_init__(self) -> None:
        check_numbers(self, not_negative="height", positive="period")

    @property
    def amplitude(self) -> float:
        """Amplitude of each component [m]."""
        return self.height / np.sqrt(8.0 * self.components)

    @cached_property
    def spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies [rad/s] and spectrum [m2 s]."""
        w = 2.0 * np.pi / self.period * np.linspace(*_RANGE, 4001)
        return w, jonswap(w, self.height, self.period)

    @cached_property
    def _quantiles(self) -> np.ndarray:
        """Frequencies [rad/s] of the energy quantiles 0, 1/2048, 2/2048 ... 1 ``(2049,)``."""
        w, spectrum = self.spectrum
        energy = np.append(0.0, np.cumsum(np.diff(w) * (spectrum[1:] + spectrum[:-1]) / 2.0))
        return np.interp(np.linspace(0.0, energy[-1], 2049), energy, w)

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Frequencies [rad/s], then phases [rad] ``(..., 2 n)`` of an episode.

        Args:
            uniforms: Random numbers in [0, 1] ``(..., 2 n)``.
        """
        n, cells = self.components, len(self._quantiles) - 1
        at = cells / n * (np.arange(n) + uniforms[..., :n])
        (w,) = along(lambda at: [interpolated(self._quantiles, at)], at)
        return np.concatenate([w, 2.0 * np.pi * uniforms[..., n:]], -1)

    def phases(
        self, drawn: np.ndarray, time: np.ndarray, place: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies [rad/s] and phases [rad] of the components ``(..., n)``.

        Args:
            drawn: Result of `draw` ``(..., 2 n)``.
            time: Time [s] ``(...)``.
            place: Position in the water along the waves [m] ``(...)``.
        """
        w, phase = drawn[..., : self.components], drawn[..., self.components : 2 * self.components]
        return w, phase + w * (time[..., None] - w * (place * (1.0 / GRAVITY))[..., None])

    def elevation(self, drawn: np.ndarray, time: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Surface elevation [m] ``(...)``; arguments as `phases`."""
        _, phases = self.phases(drawn, time, place)
        return self.amplitude * np.cos(phases).sum(-1)


@dataclass(frozen=True)
class WaveBands:
    """A filter's model of a `WaveField`: three bands ``z+ = exp((j w - b) dt) z + n``, complex.

    The variance of a band is 1 at any frequency. The damping b is constant, because a damping by
    the ship's speed through wave groups serves no better.
    """

    height: float  # significant wave height, m
    period: float  # peak period of the spectrum, s

    names = tuple(
        f"wave {band} {part}" for band in range(1, BANDS + 1) for part in ("real", "imaginary")
    )

    def __post_init__(self) -> None:
        check_numbers(self, not_negative="height", positive="period")

    @cached_property
    def frequencies(self) -> np.ndarray:
        """Frequencies of the bands [rad/s], ``(3,)``."""
        return 2.0 * np.pi / self.period * _PEAKS

    @cached_property
    def numbers(self) -> np.ndarray:
        """Wave numbers of the bands [1/m], in deep water."""
        return self.frequencies**2 / GRAVITY

    @cached_property
    def within(self) -> list[np.ndarray]:
        """Frequencies within each band [rad/s]."""
        return [
            np.linspace(low, high, 30) for low, high in pairwise(2.0 * np.pi / self.period * _EDGES)
        ]

    def power(self, band: int, response: np.ndarray) -> np.ndarray:
        """Variance of a response to the waves `within` a band.

        ``response (30, ...)`` is per metre of amplitude.
        """
        inside = self.within[band]
        whole = np.linspace(self.within[0][0], self.within[-1][-1], 400)
        spectrum = np.interp(inside, whole, jonswap(whole, self.height, self.period))
        return np.trapezoid((spectrum * np.abs(response.T) ** 2).T, inside, axis=0)

    def process(self, dt: float) -> Process:
        """Process of the bands' real and imaginary parts over a step of ``dt`` [s]."""
        check_numbers("WaveBands.process", {"dt": dt}, positive="dt")
        bands = []
        for frequency in self.frequencies:
            kept = np.exp(-_DAMPING * frequency * dt)
            cos, sin = kept * np.cos(frequency * dt), kept * np.sin(frequency * dt)
            bands.append(
                Process(
                    np.array([[cos, -sin], [sin, cos]]),
                    np.sqrt(1.0 - kept**2) * np.eye(2),
                    np.eye(2),
                )
            )
        return Process.joined(*bands)

    def at(self, z: np.ndarray, along: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Real and imaginary part ``(...)`` of each band, ``exp(-j k s) z``, at a position s."""
        parts = []
        for band, number in enumerate(self.numbers):
            sin, cos = sincos(number * along)
            real, imaginary = z[..., 2 * band], z[..., 2 * band + 1]
            parts.append((real * cos + imaginary * sin, imaginary * cos - real * sin))
        return parts
