"""Sensors: their measurements, how well and how often they are taken, what they tell, and whether they arrive.

A sensor is one object, and nothing else knows of it: measurements, raw observations, a filter's R
and what can be had without a filter follow from it. Yours is a `Sensor`: docs/own-sensor.md.

They may import processes and `estimators`; vehicles, filter models and the loop import them.
"""

from vessel_gym.sensors.array import Sensors
from vessel_gym.sensors.sensor import (
    LONGEST,
    SUITE_NAMES,
    SUITES,
    Bias,
    Known,
    Sensor,
    SensorSuite,
    check_values,
    columns,
    plain,
)

__all__ = [
    "LONGEST",
    "SUITES",
    "SUITE_NAMES",
    "Bias",
    "Known",
    "Sensor",
    "SensorSuite",
    "Sensors",
    "check_values",
    "columns",
    "plain",
]  # fmt: skip
