"""Ranges in which parameters of filters and controllers are tuned.

A class names what can be tuned beside its constructor, which takes the parameters as keywords::

    tunable = {"heading": Log(0.005, 0.5), "approach": Linear(0.2, 1.5)}
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import signature
from typing import Any

import numpy as np

from estimators.checks import number, short_repr
from estimators.factory import unknown


@dataclass(frozen=True)
class Linear:
    """Range of a parameter that is searched on its own scale.

    Raises:
        ValueError: if ``low`` and ``high`` are not finite numbers in rising order.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        low = number("low of a range", self.low, what="a finite number")
        number("high of a range", self.high, low, what=f"a finite number above its low, {low:g}")

    def to_unit(self, value: float) -> float:
        """Share of the range at which a value lies: 0 for ``low``, 1 for ``high``."""
        return (value - self.low) / (self.high - self.low)

    def from_unit(self, share: float) -> float:
        """The value at a share of the range."""
        return self.low + share * (self.high - self.low)


@dataclass(frozen=True)
class Log(Linear):
    """Range of a positive parameter that is searched by its logarithm.

    Raises:
        ValueError: if ``low`` and ``high`` are not finite numbers above 0 in rising order.
    """

    def __post_init__(self) -> None:
        number("low of a logarithmic range", self.low, 0.0, what="a finite number above 0")
        super().__post_init__()

    def to_unit(self, value: float) -> float:
        """Share of the range, in logarithms, at which a value lies: 0 for low, 1 for high."""
        return float(np.log(value / self.low) / np.log(self.high / self.low))

    def from_unit(self, share: float) -> float:
        """The value at a share of the range, in logarithms."""
        return float(self.low * (self.high / self.low) ** share)


def defaults(title: str, factory: Callable[..., Any]) -> dict[str, float]:
    """Defaults of the parameters in ``tunable`` of a class or function, by name.

    Args:
        title: Its name, for the error message.
        factory: The class or function.

    Raises:
        ValueError: for a parameter without a range, or that the factory does not take with a number
            for a default.
    """
    ranges: Mapping[str, Linear] = getattr(factory, "tunable", {})
    taken = signature(factory).parameters
    for name, range in ranges.items():
        if not isinstance(range, Linear):
            raise ValueError(
                f"tunable of {title} needs a range of {name}, estimators.Linear(low, high) or Log,"
                f" got {short_repr(range)}"
            )
        if name not in taken or taken[name].default is taken[name].empty:
            raise ValueError(f"{title} has {name} in tunable: it must take {name} with a default")
    values = {name: taken[name].default for name in ranges}
    check_parameters(title, ranges, values)
    return values


def check_parameters(
    title: str, tunable: Mapping[str, Linear], parameters: Mapping[str, object]
) -> None:
    """Refuse parameters that cannot be tuned. They may lie outside of the range for tuning.

    Args:
        title: Name of the filter or controller, for the error message.
        tunable: Its ranges by name.
        parameters: Values by name.

    Raises:
        ValueError: for an unknown parameter, for one that is not a finite number, or for one that
            is not above 0 though it is searched by its logarithm.
    """
    for name, value in parameters.items():
        if not tunable:
            raise ValueError(f"{title} has no parameters: leave out {short_repr(name)}")
        if name not in tunable:
            raise ValueError(unknown(f"parameter of {title}", name, tunable))
        low, what = (0.0, " above 0") if isinstance(tunable[name], Log) else (-np.inf, "")
        number(f"{name} of {title}", value, low, what=f"a finite number{what}")
