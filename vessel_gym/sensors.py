"""Sensors: the instruments of a vehicle, how good their readings are, and whether they arrive."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Instrument:
    """One sensor of a vehicle. Its channels are read, lost and spoilt together.

    Attributes:
        name: What it is.
        channels: What each of its channels reads, with the unit.
        sd: Nominal standard deviation of each channel.
        period: Steps from one reading to the next.
        dropout: Probability that a reading is lost.
    """

    name: str
    channels: tuple[str, ...]
    sd: tuple[float, ...]
    period: int = 1
    dropout: float = 0.0

    def __post_init__(self) -> None:
        if len(self.channels) != len(self.sd):
            raise ValueError(f"{self.name} has {len(self.channels)} channels and {len(self.sd)} standard deviations")


@dataclass(frozen=True)
class SensorSuite:
    """A quality of sensors, relative to a vehicle's nominal ones."""

    noise: float  # standard deviation relative to nominal
    dropout: float = 0.0  # probability that an instrument's reading is lost, besides its own
    outliers: float = 0.0  # probability that it is an outlier
    outlier_scale: float = 10.0  # size of an outlier's noise relative to nominal
    lossless: bool = False  # no instrument loses a reading


SUITES = {
    "clean": SensorSuite(noise=0.05, lossless=True),
    "nominal": SensorSuite(noise=1.0),
    "degraded": SensorSuite(noise=1.0, dropout=0.10, outliers=0.05),
}


def nominal_sd(instruments: tuple[Instrument, ...]) -> np.ndarray:
    """The standard deviation ``(p,)`` of every channel."""
    return np.array([sd for instrument in instruments for sd in instrument.sd])


class Sensors:
    """A vehicle's instruments in the quality of a suite.

    Args:
        instruments: In the order of the vehicle's readings.
        suite: The quality.

    Attributes:
        size: p, the number of channels, and of standard normals a step.
        uniforms: Uniform numbers a step: for each instrument one for its loss, then one for its outliers.
    """

    def __init__(self, instruments: tuple[Instrument, ...], suite: SensorSuite) -> None:
        owner = np.repeat(np.arange(len(instruments)), [len(instrument.channels) for instrument in instruments])
        self.size, self.uniforms = len(owner), 2 * len(instruments)
        self._loss, self._spoilt = owner, owner + len(instruments)  # which uniform is a channel's
        self._suite, self._sd = suite, suite.noise * nominal_sd(instruments)
        own = np.array([instrument.dropout for instrument in instruments])[owner]
        self._dropout = np.zeros(self.size) if suite.lossless else np.minimum(own + suite.dropout, 1.0)
        self._period = np.array([instrument.period for instrument in instruments])[owner]
        self._complete = not self._dropout.any() and bool((self._period == 1).all())

    def read(
        self, exact: np.ndarray, steps: np.ndarray, normals: np.ndarray, uniforms: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Noisy readings and the mask of those that arrived.

        Args:
            exact: ``(B, p)`` what perfect sensors would read.
            steps: ``(B,)`` steps since the episode's start, at which every instrument reads.
            normals: ``(B, p)`` standard normals.
            uniforms: ``(B, uniforms)`` in [0, 1). Always drawn, so that suites are paired.

        Returns:
            Readings ``(B, p)``, 0 where missing, and the mask ``(B, p)``.
        """
        suite, scale = self._suite, self._sd
        if suite.outliers:
            scale = np.where(uniforms[:, self._spoilt] < suite.outliers, suite.outlier_scale * scale, scale)
        readings = exact + scale * normals
        if self._complete:
            available = np.empty(readings.shape, bool)
            available.fill(True)
            return readings, available
        available = (uniforms[:, self._loss] >= self._dropout) & (steps[:, None] % self._period == 0)
        return np.where(available, readings, 0.0), available
