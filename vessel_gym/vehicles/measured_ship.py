"""A ship identified from logs: particulars, coefficients with their uncertainty, noise, and the file of them."""

from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from estimators.checks import short_repr
from estimators.factory import unknown
from vessel_gym.toml_file import TomlFile
from vessel_gym.vehicles.manoeuvring import AIR, COEFFICIENTS, STATE, Particulars, rates
from vessel_gym.vehicles.steered import SteeredShip

KIND = "measured ship"
_TABLES = ("particulars", "coefficients", "standard_errors", "correlation", "service", "noise", "identification")
_SERVICE = ("revolutions", "rudder_rate")
_DIGITS = 6
_MIRROR = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class MeasuredShip(SteeredShip):
    """A ship of `vessel_gym.vehicles.manoeuvring`.

    Attributes:
        particulars: What was known of her.
        coefficients: ``(k,)`` in the order of `COEFFICIENTS`.
        covariance: ``(k, k)`` of their errors.
        degrees_of_freedom: Of Student's t for intervals: independent blocks of the logs, less one; 0 without any log.
        dispersion: How many dependent simulation errors count as one.
        noise: What filters assume, by name: `vessel_gym.identification.filtering.NOISE`.
        errors: RMS errors of simulated windows by their length [s], in the order of the state.
        logs: Names of the logs.
        revolutions: Of the propeller at service speed [1/s]; 0 without any log.
        rudder_rate: Of the steering gear [rad/s]; 0 without any log.
    """

    particulars: Particulars
    coefficients: np.ndarray
    covariance: np.ndarray
    degrees_of_freedom: int = 0
    dispersion: float = 1.0
    noise: dict[str, float] = field(default_factory=dict)
    errors: dict[float, np.ndarray] = field(default_factory=dict)
    logs: tuple[str, ...] = ()
    revolutions: float = 0.0
    rudder_rate: float = 0.0

    @classmethod
    def assumed(cls, particulars: Particulars) -> "MeasuredShip":
        """The ship before any log: what regressions and experience say of her particulars."""
        table = particulars.coefficients
        return cls(
            particulars, np.array([each.mean for each in table]), np.diag([float(each.sd) ** 2 for each in table])
        )

    @property
    def standard_errors(self) -> np.ndarray:
        """``(k,)``."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def determined(self) -> np.ndarray:
        """``(k,)`` mask: the logs leave less than half of what was assumed of the coefficient's deviation."""
        return self.standard_errors < 0.5 * np.array([each.sd for each in self.particulars.coefficients])

    @property
    def intervals(self) -> np.ndarray:
        """``(k, 2)`` 95 % intervals of the coefficients."""
        from scipy.stats import t

        half = t.ppf(0.975, max(1, self.degrees_of_freedom)) * self.standard_errors
        return np.stack([self.coefficients - half, self.coefficients + half], -1)

    def drawn(self, normals: np.ndarray) -> np.ndarray:
        """Coefficients ``(..., k)`` from the distribution of the estimates, of standard normal numbers ``(..., k)``."""
        values, vectors = np.linalg.eigh(self.covariance)
        return self.coefficients + normals @ (vectors * np.sqrt(np.maximum(values, 0.0))).T

    length = property(lambda self: self.particulars.length)
    beam = property(lambda self: self.particulars.beam)
    rudder_limit = property(lambda self: self.particulars.rudder_limit)

    @cached_property
    def speed(self) -> float:  # type: ignore[override]
        """Speed [m/s] at which thrust and resistance balance on a straight course.

        Raises:
            ValueError: if they do nowhere.
        """
        from scipy.optimize import brentq

        def surge(speed: float) -> float:
            return float(self.accelerations(np.array([speed, 0.0, 0.0]), np.zeros(1))[0])

        low, high = 1e-3 * np.sqrt(9.81 * self.length), np.sqrt(9.81 * self.length)
        if not surge(low) > 0.0 > surge(high):
            raise ValueError(
                f"the ship keeps no speed at {self.revolutions:g} revolutions a second: her file needs a [service] "
                "table, which identify writes from logs of a ship that goes ahead"
            )
        return float(brentq(surge, low, high))

    def accelerations(self, motion: np.ndarray, rudder: np.ndarray) -> np.ndarray:
        """See `SteeredShip`: the mean of a turn and its mirror image, at service revolutions."""
        revolutions, none = np.full_like(rudder, self.revolutions), np.zeros((*motion.shape[:-1], 3))
        each = [
            side * rates(
                np.concatenate([none, side * motion], -1), np.concatenate([side[1] * rudder, revolutions], -1),
                np.zeros(len(AIR)), self.coefficients, self.particulars.vector(),
            )[..., 3:]
            for side in (np.ones(3), _MIRROR)
        ]  # fmt: skip
        return 0.5 * (each[0] + each[1])

    def write(self, path: Path) -> None:
        """Write the file that `read` reads.

        Raises:
            OSError: if it cannot be written.
        """
        scale = np.where(self.standard_errors > 0.0, self.standard_errors, 1.0)
        correlation = self.covariance / np.outer(scale, scale)
        meaning = {each.symbol: each.meaning for each in self.particulars.coefficients}
        lines = [f'kind = "{KIND}"', "", "[particulars]"]
        lines += [f"{each.name} = {float(getattr(self.particulars, each.name))!r}" for each in fields(self.particulars)]
        lines += ["", "[coefficients]"]
        for name, value, known in zip(COEFFICIENTS, self.coefficients, self.determined, strict=True):
            remark = meaning[name] + ("" if known else "; not determined by the logs")
            lines.append(f"{name} = {value:.{_DIGITS}g}  # {remark}")
        lines += ["", "[standard_errors]"]
        lines += [f"{k} = {v:.{_DIGITS}g}" for k, v in zip(COEFFICIENTS, self.standard_errors, strict=True)]
        lines += ["", "[correlation]  # with the coefficients before it"]
        lines += [
            f"{name} = [{', '.join(f'{x:.5f}' for x in row[:i])}]"
            for i, (name, row) in enumerate(zip(COEFFICIENTS, correlation, strict=True))
        ]
        lines += ["", "[service]"] + [f"{name} = {getattr(self, name):.{_DIGITS}g}" for name in _SERVICE]
        lines += ["", "[noise]"] + [f'"{name}" = {value:.{_DIGITS}g}' for name, value in self.noise.items()]
        lines += ["", "[identification]", f"degrees_of_freedom = {self.degrees_of_freedom}"]
        lines += [f"dispersion = {self.dispersion:.4g}", f"logs = {[str(log) for log in self.logs]!r}"]
        errors = ", ".join(
            f'"{length:g}" = [{", ".join(f"{x:.4g}" for x in row)}]' for length, row in self.errors.items()
        )
        lines += [f"errors = {{{errors}}}  # RMS by length of window [s]: {', '.join(STATE)}", ""]
        path.write_text("\n".join(lines), encoding="utf-8")


def read(path: Path) -> MeasuredShip:
    """A measured ship of a file; one of particulars alone is as regressions and experience assume.

    Raises:
        ValueError: for anything wrong in the file, in one sentence with its line.
        OSError: if it cannot be read.
    """
    return _File(path).ship()


class _File(TomlFile):
    """A file of a measured ship being read."""

    otherwise = ("kind",)

    def ship(self) -> MeasuredShip:
        """The ship."""
        if self.data.get("kind") != KIND:
            raise self.fault(("kind",), f"a measured ship's file has kind = {KIND!r}, got {self.data.get('kind')!r}")
        for table in self.data:
            if table not in ("kind", *_TABLES):
                raise self.fault((table,), unknown("table", table, _TABLES))
            if table != "kind" and not isinstance(self.data[table], dict):
                raise self.fault((table,), f"[{table}] must be a table, got {short_repr(self.data[table])}")
        ship = MeasuredShip.assumed(self._particulars())
        given = [table for table in ("coefficients", "standard_errors", "correlation") if table in self.data]
        if not given:
            return ship
        if len(given) < 3:
            raise self.fault((given[0],), "coefficients, standard_errors and correlation belong together")
        about = self.data.get("identification", {})
        service = self._table("service", _SERVICE, low=0.0) if "service" in self.data else {}
        errors = self._table("standard_errors", COEFFICIENTS, low=0.0)
        sd, correlation = np.array([errors[name] for name in COEFFICIENTS]), np.eye(len(COEFFICIENTS))
        for i, name in enumerate(COEFFICIENTS):
            row = self.data["correlation"].get(name)
            if not isinstance(row, list) or len(row) != i or not all(_finite(x) and abs(x) <= 1.0 for x in row):
                raise self.fault(("correlation", name), f"correlation of {name} must be a list of {i} numbers up to 1")
            correlation[i, :i] = correlation[:i, i] = row
        coefficients = self._table("coefficients", COEFFICIENTS)
        freedom = about.get("degrees_of_freedom", 0)
        if type(freedom) is not int or freedom < 0:
            raise self.fault(("identification", "degrees_of_freedom"), "degrees_of_freedom must be a whole number")
        return replace(
            ship,
            coefficients=np.array([coefficients[name] for name in COEFFICIENTS]),
            covariance=correlation * np.outer(sd, sd),
            degrees_of_freedom=freedom,
            noise=self._table("noise", tuple(self.data.get("noise", {})), low=0.0),
            revolutions=service.get("revolutions", 0.0),
            rudder_rate=service.get("rudder_rate", 0.0),
            logs=tuple(map(str, about.get("logs", ()))) if isinstance(about.get("logs", ()), list) else (),
        )

    def _particulars(self) -> Particulars:
        """Particulars of the table, all positive but the centre of gravity and areas."""
        known = {each.name: each for each in fields(Particulars)}
        table: dict[str, Any] = self.data.get("particulars", {})
        for name in table:
            if name not in known:
                raise self.fault(("particulars", name), unknown("key in [particulars]", name, known))
        for name, each in known.items():
            if name not in table and each.default is MISSING:
                raise self.fault(("particulars",), f"[particulars] needs a {name!r}")
        values = self._table("particulars", tuple(table))
        for name, value in values.items():
            free = name == "x_g" or (name in ("frontal_area", "lateral_area") and value == 0.0)
            if value <= 0.0 and not free:
                raise self.fault(("particulars", name), f"{name} must be a number above 0, got {value:g}")
        return Particulars(**values)

    def _table(self, table: str, names: tuple[str, ...], low: float = -np.inf) -> dict[str, float]:
        """Numbers of a table, each of ``names``."""
        content = self.data.get(table, {})
        for name in content:
            if name not in names:
                raise self.fault((table, name), unknown(f"key in [{table}]", name, names))
        for name in names:
            if name not in content:
                raise self.fault((table,), f"[{table}] needs a {name!r}")
            if not _finite(content[name]) or content[name] < low:
                what = "a finite number" if low == -np.inf else f"a number of at least {low:g}"
                raise self.fault((table, name), f"{name} must be {what}, got {short_repr(content[name])}")
        return {name: float(content[name]) for name in names}


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < np.inf
