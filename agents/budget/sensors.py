"""Order of sensors by their errors: which one is no worse than another, and by how much it errs."""

import numpy as np

from vessel_gym.sensors import Sensor


def no_worse(one: Sensor, other: Sensor) -> bool:
    """True if no error of one sensor exceeds that of another with the same channels.

    Errors are white noise, bias, losses, outliers, delay and the time between measurements. Slow
    errors of different correlation times have no order, because the faster one averages out and the
    slower one can be estimated; nor has noise that depends on the measurement.
    """
    slow = [s.bias for s in (one, other) if s.bias and any(s.bias.start)]
    if len({bias.time for bias in slow}) > 1:
        return False
    if one.sd is not other.sd and (callable(one.sd) or callable(other.sd)):
        return False
    return bool((_errors(one) <= _errors(other)).all())


def _errors(sensor: Sensor) -> np.ndarray:
    """Sizes of a sensor's errors, without noise that depends on the measurement."""
    sizes = np.zeros((4, len(sensor.channels)))
    if not callable(sensor.sd):
        sizes[0] = sensor.sd
    if bias := sensor.bias:
        sizes[1:, : len(bias.names)] = bias.start, bias.pace, bias.constant
    outliers = sensor.outliers, sensor.outliers * sensor.outlier_scale
    interval = 1.0 / sensor.rate if sensor.rate else 0.0
    return np.array([*sizes.flat, sensor.dropout, *outliers, sensor.latency, interval])


def total_error(sensor: Sensor, seconds: float = 60.0) -> np.ndarray:
    """Standard deviation of each channel's whole error ``(k,)``, so long after the start.

    Raises:
        TypeError: for noise that depends on the measurement.
    """
    variance = np.square(sensor.sd)
    if sensor.bias is not None:
        process = sensor.bias.process(seconds)
        after = (
            process.transition @ process.start_cov @ process.transition.T
            + process.root @ process.root.T
        )
        variance[: len(sensor.bias.names)] += np.diag(sensor.bias.gain @ after @ sensor.bias.gain.T)
    return np.sqrt(variance)
