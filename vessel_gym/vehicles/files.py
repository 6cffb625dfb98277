"""Vehicles as data: TOML files of ships, underwater vehicles and aircraft (docs/vehicles.md).

A file holds numbers only, and nothing in it is executed. Errors are reported in one sentence with
the line.
"""

import re
from dataclasses import MISSING, fields
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from estimators.checks import number, short_repr
from estimators.factory import unknown
from vessel_gym.checks import LARGEST, RANGES, all_are, one_of
from vessel_gym.toml_file import TomlFile

_DATA = Path(__file__).with_name("data")
_KINDS = {
    "ship": ("corvette_equations", "CorvetteParameters"),
    "auv": ("segorogeni", "SegorogeniParameters"),
    "vertical-auv": ("itsunusa", "ItsunusaParameters"),
    "fixed-wing": ("puna", "PunaParameters"),
    "rov": ("rov", "ROVParameters"),
}
"""Module and class of the parameters by kind."""
_ANGLES = (
    "rudder_limit", "rudder_rate", "fin_limit", "fin_rate", "alpha_low", "alpha_high",
    "alpha_rate", "bank_limit",
)  # fmt: skip
"""Numbers in rad, or in degrees with ``_deg`` after the name."""
_POSITIVE, _ANY, _SHARE = RANGES["positive"], RANGES["finite"], RANGES["share"]
_NEGATIVE = (-LARGEST, np.nextafter(0.0, 1.0), "a number of at most 0: it resists the motion")
_ACUTE = (0.0, 0.5 * np.pi, "an angle above 0 and below 90 degrees")
_EITHER_SIGN = (
    "x_g", "fin_position", "buoyancy_excess", "propeller_torque", "drag", "lift", "density",
    "positions", "directions", "Yr", "Nv", "Yrdot", "Nvdot",
)  # fmt: skip
_RESISTING = (
    "Xudot", "Yvdot", "Nrdot", "Yv", "Nr", "Ydelta",
    "X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot",
    "X_uu", "Y_vv", "Z_ww", "K_pp", "M_qq", "N_rr", "X_u", "Y_v", "Z_w", "K_p", "M_q", "N_r",
    "Y_uv", "Z_uw", "M_uq", "N_ur", "K_up",
)  # fmt: skip
_SIZES = {"drag": 3, "lift": 2, "density": 3}
"""Lists of numbers, by their length."""
_OR_ZERO = (
    "z_g", "drag_coefficient", "rudder_area", "thrust_coefficient", "thrust_slope", "advance_ratio",
)  # fmt: skip
_RANGES = (
    dict.fromkeys(_EITHER_SIGN, _ANY)
    | dict.fromkeys(_RESISTING, _NEGATIVE)
    | dict.fromkeys(_OR_ZERO, RANGES["not_negative"])
    | dict.fromkeys(("rudder_limit", "fin_limit", "bank_limit"), _ACUTE)
    | dict.fromkeys(
        ("alpha_low", "alpha_high"), (-0.5 * np.pi, 0.5 * np.pi, "an angle within 90 degrees")
    )
    | dict.fromkeys(("straightening", "fin_taper", "race"), _SHARE)
    | {"yaw_radius": (0.0, np.nextafter(0.5, 1.0), "a share of the length above 0 and up to 0.5")}
)
"""Ranges of numbers that need not be positive.

Other coefficients of an underwater vehicle may be any finite number.
"""


def names() -> tuple[str, ...]:
    """Names of the vehicles of the package."""
    return tuple(sorted(path.stem for path in _DATA.glob("*.toml")))


def load(source: str | Path, expected: type[Any] = object) -> Any:
    """Load the parameters of a vehicle.

    Args:
        source: A TOML file, or one of `names`.
        expected: Expected class of the parameters.

    Raises:
        ValueError: for an unknown name, or an error in the file; the message names its line.
        TypeError: for anything but a name or a path.
        OSError: if the file cannot be read.
    """
    if not isinstance(source, str | Path):
        raise TypeError(
            f"a vehicle is the path of a file or one of {', '.join(names())}, got"
            f" {short_repr(source)}"
        )
    if isinstance(source, str) and re.fullmatch(r"[\w-]*", source):
        if source not in names():
            raise ValueError(unknown("vehicle", source, names()) + ", or name a .toml file")
        source = _DATA / f"{source}.toml"
        if isinstance(parameters := _shipped(source), expected):
            return parameters
    return _File(Path(source)).parameters(expected)


@cache
def _shipped(path: Path) -> Any:
    return _File(path).parameters(object)


class _File(TomlFile):
    """Reader of a vehicle file."""

    otherwise = ("kind",)

    def parameters(self, expected: type[Any]) -> Any:
        """Parameters of the vehicle, as `load` returns them."""
        cls = self._class(expected)
        values, known = self._values(cls), cls.__dataclass_fields__
        own = {name: x for name, x in values.items() if name in known}
        if given := tuple((name, x) for name, x in values.items() if name not in known):
            own["given"] = given
        parameters = cls(**own)
        for name, sentence in parameters.mistakes():
            raise self.fault(self._where(name), sentence)
        return parameters

    def _class(self, expected: type[Any]) -> type[Any]:
        """Class of the file's kind."""
        if "kind" not in self.data:
            raise self.fault((), f"a vehicle file needs a 'kind': {', '.join(_KINDS)}")
        kind = self.data["kind"]
        if not isinstance(kind, str) or kind not in _KINDS:
            raise self.fault(("kind",), unknown("kind", kind, _KINDS))
        module, name = _KINDS[kind]
        cls: type[Any] = getattr(import_module(f"vessel_gym.vehicles.{module}"), name)
        if not issubclass(cls, expected):
            wanted = expected.__name__.removesuffix("Parameters")
            hint = "docs/vehicles.md has an environment for each"
            raise self.fault(("kind",), f"kind {kind!r}, where {wanted} is needed: {hint}")
        return cls

    def _values(self, cls: type[Any]) -> dict[str, Any]:
        """Numbers of the file by name, in the units of the class."""
        keys, values = cls.file_keys(), dict[str, Any]()
        for table, content in self.data.items():
            if table == "kind":
                continue
            if not isinstance(content, dict):
                raise self.fault((table,), unknown("key outside of tables", table, ("kind",)))
            for key, value in content.items():
                name = key.removesuffix("_deg")
                try:
                    if table == "sources":
                        if not isinstance(value, str):
                            raise ValueError(f"a source is a text, got {short_repr(value)}")
                        continue
                    if name not in keys or (name != key and name not in _ANGLES):
                        raise ValueError(unknown("key", key, keys))
                    if name in values:
                        raise ValueError(f"{name} is given twice")
                    values[name] = _value(name, key, value)
                except ValueError as error:
                    raise self.fault((table, key), str(error)) from None
        for each in fields(cls):
            if each.default is MISSING and each.name not in values:
                raise self.fault((), f"a {self.data['kind']} needs a {each.name!r}")
        return values

    def _where(self, name: str) -> tuple[str, ...]:
        """Table and key of a number, or ``name`` if it may be a table."""
        for table, content in self.data.items():
            for key in (name, f"{name}_deg"):
                if isinstance(content, dict) and key in content:
                    return table, key
        return (name,)


def _value(name: str, key: str, value: object) -> Any:
    """Checked number or tuple of numbers; angles in rad."""
    low, high, what = _RANGES.get(name, _ANY if re.match(r"[XYZKMN]_", name) else _POSITIVE)
    if name in _SIZES:
        return _numbers(name, value, _SIZES[name], low, high)
    if name in ("positions", "directions"):
        if not isinstance(value, list | tuple) or not value:
            what = "a list of lists of 3 finite numbers"
            raise ValueError(f"{name} must be {what}, got {short_repr(value)}")
        return tuple(_numbers(f"each of {name}", row, 3, low, high) for row in value)
    if key != name:
        low, high = np.rad2deg([low, high])
        return float(np.deg2rad(number(key, value, low, high, what)))
    return number(name, value, low, high, what)


def _numbers(name: str, value: object, size: int, low: float, high: float) -> tuple[float, ...]:
    """Checked numbers of a list of a given size."""
    what = f"a list of {size} finite numbers"
    if not isinstance(value, list | tuple) or len(value) != size:
        raise ValueError(f"{name} must be {what}, got {short_repr(value)}")
    return tuple(number(name, each, low, high, what) for each in value)


class Particulars:
    """Base class of a vehicle's parameters, which are checked like the numbers of a vehicle file.

    Raises:
        ValueError: naming an invalid number.
    """

    GIVEN: ClassVar[tuple[str, ...]] = ()
    """Names of further numbers, which the field `given` holds as pairs (name, number)."""
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __post_init__(self) -> None:
        cls, given = type(self), getattr(self, "given", ())
        for each in fields(cls):
            value = getattr(self, each.name)
            if each.name != "given" and value is not each.default:
                _value(each.name, each.name, value)
        if not isinstance(given, tuple) or not all(
            all_are(object, p) and len(p) == 2 for p in given
        ):
            raise ValueError(
                f"given must be a tuple of pairs (name, number), got {short_repr(given)}"
            )
        for name, value in given:
            one_of("name in given", name, cls.GIVEN)
            _value(name, name, value)

    @classmethod
    def file_keys(cls) -> tuple[str, ...]:
        """Keys of a vehicle file."""
        return *(each.name for each in fields(cls) if each.name != "given"), *cls.GIVEN
