"""Suites to choose from: a grade of each sensor, perhaps at a lower rate, and what they cost."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import fsum, prod
from typing import Any

import numpy as np

from estimators.checks import short_repr
from estimators.factory import unknown
from vessel_gym.sensors import Sensor
from vessel_gym.sensors.grades import grades_of
from vessel_gym.system import System

MOST = 2000
"""Suites among which one is searched."""
DEAREST = 1e12
"""Highest price of a grade: their sums keep their digits."""

Prices = Mapping[str, Mapping[str, float]]
"""Price of each grade of each sensor, in any currency."""


@dataclass(frozen=True)
class Choice:
    """A grade of a sensor.

    Attributes:
        grade: Its name.
        rate: Measurements a second [Hz], fewer than the grade gives; None: as many.
        ranks: Of the grade and of the rate, 0 for the best.
        price: In the user's currency.
    """

    grade: str
    rate: float | None
    ranks: tuple[int, int]
    price: float = 0.0

    def __str__(self) -> str:
        return self.grade if self.rate is None else f"{self.grade} at {self.rate:g} Hz"


@dataclass(frozen=True)
class Suite:
    """A choice for each sensor.

    Attributes:
        choices: By sensor.
    """

    choices: Mapping[str, Choice]

    @cached_property
    def price(self) -> float:
        """Sum of the prices of the choices."""
        return fsum(choice.price for choice in self.choices.values())

    @property
    def cost(self) -> tuple[float, int]:
        """Price and, of suites of one price, the higher rates count more."""
        return self.price, -sum(self.ranks[1::2])

    @cached_property
    def ranks(self) -> tuple[int, ...]:
        """Ranks of grades and rates, 0 for the best."""
        return tuple(rank for choice in self.choices.values() for rank in choice.ranks)

    @property
    def names(self) -> dict[str, tuple[str, float | None]]:
        """Grade and rate by sensor, as `sensors_of` takes them."""
        return {sensor: (choice.grade, choice.rate) for sensor, choice in self.choices.items()}

    def __str__(self) -> str:
        return ", ".join(f"{sensor} {choice}" for sensor, choice in self.choices.items())


def choices_of(system: System, rates: Sequence[float] = ()) -> dict[str, list[Choice]]:
    """Grades of each sensor of a system, the best first, at their own rate and at each of ``rates`` that is lower.

    Sensors of which there is no choice are left out.

    Raises:
        ValueError: if there is no choice at all, or a rate is not below that of any grade, or does
            not divide the steps of a second.
    """
    grades, dt = grades_of(system), system.vehicle.dt
    highest = max(
        sensor.rate or 1.0 / dt for of_sensor in grades.values() for sensor in of_sensor.values()
    )
    for rate in rates:
        if not 0.0 < rate < highest:
            raise ValueError(
                f"--rates must be above 0 and below {highest:g} Hz, the highest of any grade, got"
                f" {rate:g}"
            )
    found = {}
    for name, of_sensor in grades.items():
        found[name] = [
            Choice(grade, rate, (i, j))
            for i, (grade, sensor) in enumerate(of_sensor.items())
            for j, rate in enumerate((None, *sorted(set(rates), reverse=True)))
            if rate is None or rate < (sensor.rate or 1.0 / dt)
        ]
        for choice in found[name]:
            _at_rate(of_sensor[choice.grade], choice.rate).period(dt)
    found = {name: listed for name, listed in found.items() if len(listed) > 1}
    if not found:
        raise ValueError(f"{system.name} has no grades of sensors to choose from")
    return found


def suites_of(choices: Mapping[str, Sequence[Choice]], prices: Prices | None = None) -> list[Suite]:
    """All suites, the cheapest first.

    Without prices, each step to a better grade costs 1 and a higher rate nothing.

    Raises:
        ValueError: for too many suites, and as `price_list`.
    """
    count = prod(len(each) for each in choices.values())
    if count > MOST:
        raise ValueError(
            f"there are {count} suites to choose from, and at most {MOST} are searched: give fewer"
            " rates"
        )
    costs = step_prices(choices) if prices is None else price_list(choices, prices)
    priced = [
        [replace(choice, price=costs[sensor][str(choice)]) for choice in reversed(each)]
        for sensor, each in choices.items()
    ]
    found = [Suite(dict(zip(choices, chosen, strict=True))) for chosen in product(*priced)]
    return sorted(found, key=lambda suite: suite.cost)


def levels(suites: Sequence[Suite]) -> np.ndarray:
    """Ranks ``(K,)`` of suites by their cost, equal for equal costs, 0 for the cheapest."""
    costs = sorted({suite.cost for suite in suites})
    return np.array([costs.index(suite.cost) for suite in suites])


def step_prices(choices: Mapping[str, Sequence[Choice]]) -> dict[str, dict[str, float]]:
    """Prices of 1 for each step to a better grade, where the user gives none."""
    return {
        sensor: {
            str(choice): float(max(each.ranks[0] for each in listed) - choice.ranks[0])
            for choice in listed
        }
        for sensor, listed in choices.items()
    }


def price_list(
    choices: Mapping[str, Sequence[Choice]], prices: Prices
) -> dict[str, dict[str, float]]:
    """Price of every choice; a grade at a lower rate costs what the grade does, unless it has a price of its own.

    Raises:
        ValueError: for a sensor or grade that there is not, a missing price, or one that is no
            number of at least 0.
    """
    for sensor, grades in prices.items():
        if sensor not in choices:
            raise ValueError(unknown("sensor in the prices", sensor, choices))
        if not isinstance(grades, Mapping):
            raise ValueError(
                f"prices of {sensor} must be a table of numbers by grade, got {grades!r}"
            )
        for grade, price in grades.items():
            if grade not in map(str, choices[sensor]):
                raise ValueError(
                    unknown(f"grade of {sensor} in the prices", grade, map(str, choices[sensor]))
                )
            number = isinstance(price, int | float) and not isinstance(price, bool)
            if not (number and 0.0 <= price <= DEAREST):
                raise ValueError(
                    f"the price of {sensor}, {grade}, must be a number from 0 to {DEAREST:g}, got"
                    f" {short_repr(price)}"
                )
    found: dict[str, dict[str, float]] = {}
    for sensor, choice in _each(choices):
        listed = prices.get(sensor, {})
        if choice.grade not in listed:
            raise ValueError(f"the prices lack the grade {choice.grade!r} of {sensor}")
        found.setdefault(sensor, {})[str(choice)] = float(
            listed.get(str(choice), listed[choice.grade])
        )
    return found


def _each(choices: Mapping[str, Sequence[Choice]]) -> Iterator[tuple[str, Choice]]:
    return ((sensor, choice) for sensor, listed in choices.items() for choice in listed)


def prices_toml(suites: Sequence[Suite]) -> str:
    """Prices of all choices as a TOML file."""
    found: dict[str, dict[str, float]] = {}
    for suite in suites:
        for sensor, choice in suite.choices.items():
            found.setdefault(sensor, {})[str(choice)] = choice.price
    tables = [
        "\n".join(
            [
                f"[{json.dumps(sensor)}]",
                *(f"{json.dumps(name)} = {price:g}" for name, price in listed.items()),
            ]
        )
        for sensor, listed in found.items()
    ]
    return "\n\n".join(tables) + "\n"


def sensors_of(system: System, names: Mapping[str, Sequence[Any]]) -> list[Sensor]:
    """Sensors of a system with grade and rate of some by name; the others are nominal."""
    grades, found = grades_of(system), []
    for sensor in system.sensors_of("nominal").each:
        if sensor.name in names:
            grade, rate = names[sensor.name]
            sensor = _at_rate(grades[sensor.name][grade], rate)
        found.append(sensor)
    return found


def _at_rate(sensor: Sensor, rate: float | None) -> Sensor:
    return sensor if rate is None else replace(sensor, rate=rate)
