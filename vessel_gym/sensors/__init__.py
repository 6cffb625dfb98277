"""Sensors: measurements, their noise, rate, drop-outs and delay.

A sensor is one object, from which measurements, raw observations and a filter's R follow. Your own
sensor is a `Sensor`: docs/own-sensor.md.

This folder may import processes and `estimators`; vehicles, filters' models and simulation import
it.
"""

from vessel_gym.sensors.array import Sensors
from vessel_gym.sensors.sensor import (
    LONGEST,
    SUITE_NAMES,
    SUITES,
    Bias,
    Known,
    Sensor,
    in_quality,
    plain,
)

__all__ = [
    "LONGEST",
    "SUITES",
    "SUITE_NAMES",
    "Bias",
    "Known",
    "Sensor",
    "Sensors",
    "in_quality",
    "plain",
]  # fmt: skip
