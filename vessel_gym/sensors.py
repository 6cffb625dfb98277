"""Sensor suites: how good the readings are, and whether they arrive."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SensorSuite:
    """A quality of sensors, relative to a vehicle's nominal noise."""

    noise: float  # standard deviation relative to nominal
    dropout: float = 0.0  # probability that a channel's reading is missing
    outliers: float = 0.0  # probability that a reading is an outlier
    outlier_scale: float = 10.0  # size of an outlier's noise relative to nominal

    def corrupt(
        self, exact: np.ndarray, sd: np.ndarray, normals: np.ndarray, uniforms: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Noisy readings and the mask of those that arrived.

        Args:
            exact: ``(..., p)`` what perfect sensors would read.
            sd: ``(p,)`` nominal standard deviations.
            normals: ``(..., p)`` standard normals.
            uniforms: ``(..., 2 p)`` in [0, 1): drop-outs, then outliers. Always drawn, so that suites are paired.

        Returns:
            Readings ``(..., p)``, 0 where missing, and the mask ``(..., p)``.
        """
        p = sd.shape[-1]
        scale = self.noise * sd
        if self.outliers:
            scale = np.where(uniforms[..., p:] < self.outliers, self.outlier_scale * scale, scale)
        readings = exact + scale * normals
        if not self.dropout:
            return readings, np.ones(readings.shape, bool)
        available = uniforms[..., :p] >= self.dropout
        return np.where(available, readings, 0.0), available


SUITES = {
    "clean": SensorSuite(noise=0.05),
    "nominal": SensorSuite(noise=1.0),
    "degraded": SensorSuite(noise=1.0, dropout=0.10, outliers=0.05),
}
