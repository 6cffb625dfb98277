"""Grades of a vehicle's sensors, best first, and the suites that choose among them, with sources.

A TOML file has a table for each grade of each sensor, in the order from the best to the cheapest::

    ["gyro compass".magnetic]
    sd = 3.5e-3
    bias = { start = 9.3e-3, time = 30.0, constant = 8.7e-3 }
    source = "..."
    assumed = ["time"]

``sd`` is a number for all channels or one for each; ``rate`` [Hz] and ``latency`` [s] are rounded
to whole steps of the vehicle; ``dropout`` is a probability. ``bias`` has ``start`` and possibly
``pace``, ``time`` or ``constant``, see `vessel_gym.sensors.Bias`.
A missing figure is 0, and a missing rate is one measurement in every step. ``source`` names the
document of the figures, and ``assumed`` lists the keys of figures that no document states. The
grade ``nominal``, which every sensor has, is the vehicle's own sensor: its table has only
``source`` and ``assumed``. ``[suites.NAME]`` chooses a grade for each sensor; the default is
``nominal``.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from estimators.checks import short_repr
from estimators.factory import unknown
from vessel_gym.checks import check_numbers
from vessel_gym.sensors.sensor import SLOWEST, Bias, Sensor
from vessel_gym.toml_file import TomlFile

DATA = Path(__file__).with_name("data")
NOMINAL = "nominal"
_TEXTS = ("source", "assumed")
_FIGURES = ("sd", "rate", "dropout", "latency")
_BIAS = ("start", "pace", "time", "constant")


@dataclass(frozen=True)
class Grades:
    """Grades of the sensors of a vehicle.

    Attributes:
        sensors: Sensors by name and grade, best first.
        tables: Tables of the file, by sensor and grade, with sources.
        suites: Name of the grade, by suite and sensor.
    """

    sensors: dict[str, dict[str, Sensor]]
    tables: dict[str, dict[str, dict[str, Any]]]
    suites: dict[str, dict[str, str]]

    def suite(self, name: str) -> tuple[Sensor, ...]:
        """Sensors of a suite."""
        return tuple(
            grades[self.suites[name].get(sensor, NOMINAL)]
            for sensor, grades in self.sensors.items()
        )


def grades_of(system: Any, path: str | Path | None = None) -> dict[str, dict[str, Sensor]]:
    """Grades of a system's sensors, by sensor and grade, best first.

    Args:
        system: A `vessel_gym.system.System`.
        path: A file of grades; None: the file of the system's vehicle.

    Raises:
        ValueError: for a vehicle without grades, or anything wrong in the file; the message names
            its line.
        OSError: if the file cannot be read.
    """
    return read_grades(system, path).sensors


def read_grades(system: Any, path: str | Path | None = None) -> Grades:
    """Grades, sources and suites of a system's sensors.

    Args:
        system: A `vessel_gym.system.System`. The attribute ``grades`` of its vehicle is the name of
            a file of the package or the path of another file.
        path: A file. None: the vehicle's file, without the sensors that the system lacks.

    Raises:
        ValueError: for a vehicle without grades, or anything wrong in the file; the message names
            its line.
        OSError: if the file cannot be read.
    """
    own_alone = path is None
    if path is None:
        path = system.vehicle.grades
        if path is None:
            title = type(system.vehicle).__name__
            raise ValueError(
                f"{title} has no grades of sensors: set its attribute grades to the path of a TOML"
                " file"
            )
        if isinstance(path, str) and "." not in path:
            path = DATA / f"{path}.toml"
    return _GradesFile(Path(path), system.nominal_sensors, system.vehicle.dt).grades(own_alone)


class _GradesFile(TomlFile):
    """Reader of a file of grades, for sensors that measure at steps of ``dt`` [s]."""

    def __init__(self, path: Path, own: Sequence[Sensor], dt: float) -> None:
        super().__init__(path)
        self.own, self.dt = {sensor.name: sensor for sensor in own}, dt

    def grades(self, own_alone: bool) -> Grades:
        """The grades; ``own_alone`` leaves out unknown sensors instead of refusing them."""
        for name in () if own_alone else self.data:
            self._check((name,), "sensor", name, ("suites", *self.own))
        sensors, tables = {}, {}
        for name, own in self.own.items():
            table = self._table((name,), self.data.get(name, {}))
            if NOMINAL not in table:  # a file may leave it out: it is then the best
                table = {NOMINAL: {"source": "the vehicle's own"}} | table
            tables[name] = table
            sensors[name] = {grade: self._sensor(own, grade, each) for grade, each in table.items()}
        return Grades(sensors, tables, self._suites(sensors, own_alone))

    def _check(self, keys: tuple[str, ...], kind: str, value: Any, known: Collection[str]) -> None:
        """Refuse a value of a key that is not one of the known names."""
        if not isinstance(value, str) or value not in known:
            raise self.fault(keys, unknown(kind, value, known))

    def _table(self, keys: tuple[str, ...], value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise self.fault(keys, f"{keys[-1]} must be a table, got {short_repr(value)}")
        return value

    def _sensor(self, own: Sensor, grade: str, figures: Any) -> Sensor:
        """The sensor in a grade."""
        keys, name = (own.name, grade), f"{own.name} of the grade {grade!r}"
        figures, nominal = self._table(keys, figures), grade == NOMINAL
        for key in figures:
            allowed = _TEXTS if nominal else (*_TEXTS, *_FIGURES, "bias")
            self._check((*keys, key), f"key of {name}", key, allowed)
        for key in ("source",) if nominal else ("source", "sd"):
            if key not in figures:
                raise self.fault(keys, f"{name} needs a {key!r}")
        if not isinstance(figures["source"], str):
            raise self.fault((*keys, "source"), f"source of {name} must be a text")
        assumed = figures.get("assumed", [])
        for key in assumed if isinstance(assumed, list) else (assumed,):
            self._check((*keys, "assumed"), f"assumed figure of {name}", key, (*_FIGURES, *_BIAS))
        try:
            return own if nominal else self._with(own, figures)
        except (ValueError, TypeError) as error:
            about = "bias" if "bias" in str(error) else str(error).partition(" of ")[0]
            raise self.fault((*keys, about), str(error)) from None

    def _with(self, own: Sensor, figures: dict[str, Any]) -> Sensor:
        """The sensor with the figures of a grade."""
        channels, dt = len(own.channels), self.dt
        times = {"rate": figures.get("rate", 1.0 / dt), "latency": figures.get("latency", 0.0)}
        check_numbers(own.name, times, positive="rate", not_negative="latency")
        period = round(1.0 / np.clip(times["rate"] * dt, 1.0 / SLOWEST, 1.0))
        bias = None
        if "bias" in figures:
            table = figures["bias"]
            if not isinstance(table, dict) or not {"start"} <= {*table} <= {*_BIAS}:
                raise ValueError(
                    f"bias of {own.name} must be a table of start, and pace, time or constant"
                )
            given = {key: _tuple(each, channels) for key, each in table.items() if key != "time"}
            start = given["start"]
            names = [f"bias {channel.split(' [')[0]}" for channel in own.channels]
            scale = max((1e-9, *start, *given.get("constant", ())))
            bias = Bias(tuple(names[: len(start)]), **given, scale=scale, time=table.get("time"))
        return replace(
            own, sd=_tuple(figures["sd"], channels),
            rate=None if period == 1 else 1.0 / (period * dt),
            dropout=figures.get("dropout", 0.0), latency=round(times["latency"] / dt) * dt,
            bias=bias,
        )  # fmt: skip

    def _suites(
        self, sensors: dict[str, dict[str, Sensor]], own_alone: bool
    ) -> dict[str, dict[str, str]]:
        """The grades that suites choose, checked."""
        suites = self._table(("suites",), self.data.get("suites", {}))
        for suite, table in suites.items():
            for name, grade in self._table(("suites", suite), table).items():
                keys = "suites", suite, name
                if name in sensors:
                    self._check(keys, f"grade of {name}", grade, sensors[name])
                elif not own_alone:
                    raise self.fault(keys, unknown("sensor", name, sensors))
        return suites


def _tuple(value: Any, count: int) -> tuple[Any, ...]:
    """Values of a list, or one number repeated for each channel."""
    return tuple(value) if isinstance(value, list) else (value,) * count
