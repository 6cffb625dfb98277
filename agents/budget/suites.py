"""Suites to choose from: a grade of each sensor, perhaps at a lower rate, and what they cost."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import fsum, prod
from typing import Any, NamedTuple

from estimators.checks import short_repr
from estimators.factory import unknown
from vessel_gym.sensors.grades import grades_of
from vessel_gym.system import System

MOST = 2000
"""Suites among which one is searched."""
DEAREST = 1e12
"""Highest price of a grade: their sums keep their digits."""

Prices = Mapping[str, Mapping[str, float]]
"""Price of each grade by sensor, in any currency."""


class Choice(NamedTuple):
    """A grade of a sensor, at its own rate or a lower one.

    Attributes:
        words: As `agents.studies.records.Condition` takes them: "SBAS" or "SBAS at 0.5 Hz".
        grade: Its name alone.
        ranks: Of the grade and of the rate, 0 for the best.
    """

    words: str
    grade: str
    ranks: tuple[int, int]


Choices = Mapping[str, Sequence[Choice]]
"""Choices of each sensor by its name, the best first."""


class Suite(NamedTuple):
    """A choice for each sensor.

    Attributes:
        cost: Sum of the prices of the choices; of suites of one price, higher rates count more.
        ranks: Ranks of grade and rate of each sensor, 0 for the best.
        grades: Words of the choice by sensor.
    """

    cost: tuple[float, int]
    ranks: tuple[int, ...]
    grades: dict[str, str]

    def __str__(self) -> str:
        return ", ".join(f"{sensor} {words}" for sensor, words in self.grades.items())


def choices_of(system: System, rates: Sequence[float] = ()) -> dict[str, list[Choice]]:
    """Grades of each sensor of a system, at their own rate and at each of ``rates`` that is lower.

    Sensors of which there is no choice are left out.

    Raises:
        ValueError: if there is no choice at all, or a rate is not below that of any grade, or does
            not divide the steps of a second.
    """
    grades, dt = grades_of(system), system.vehicle.dt
    highest = max(s.rate or 1.0 / dt for each in grades.values() for s in each.values())
    for rate in rates:
        if not 0.0 < rate < highest:
            raise ValueError(
                f"--rates must be above 0 and below {highest:g} Hz, the highest of any grade, got"
                f" {rate:g}"
            )
        replace(system.nominal_sensors[0], rate=rate).period(dt)
    found = {
        name: [
            Choice(f"{grade} at {rate:.9g} Hz" if rate else grade, grade, (i, j))
            for i, (grade, sensor) in enumerate(each.items())
            for j, rate in enumerate((0.0, *sorted(set(rates), reverse=True)))
            if rate < (sensor.rate or 1.0 / dt)
        ]
        for name, each in grades.items()
    }
    found = {name: listed for name, listed in found.items() if len(listed) > 1}
    if not found:
        raise ValueError(f"{system.name} has no grades of sensors to choose from")
    return found


def suites_of(choices: Choices, prices: Prices) -> list[Suite]:
    """All suites, the cheapest first, at the prices of `price_list`.

    Raises:
        ValueError: for too many suites.
    """
    count = prod(map(len, choices.values()))
    if count > MOST:
        raise ValueError(
            f"there are {count} suites to choose from, and at most {MOST} are searched: give fewer"
            " rates"
        )
    found = []
    for chosen in product(*(reversed(listed) for listed in choices.values())):
        grades = dict(zip(choices, (choice.words for choice in chosen), strict=True))
        price = fsum(prices[sensor][words] for sensor, words in grades.items())
        ranks = sum((choice.ranks for choice in chosen), ())
        found.append(Suite((price, -sum(ranks[1::2])), ranks, grades))
    return sorted(found, key=lambda suite: suite.cost)


def price_list(choices: Choices, prices: Mapping[str, Any] | None) -> dict[str, dict[str, float]]:
    """Price of every choice by sensor and words.

    A grade at a lower rate costs what the grade does, unless it has a price of its own. Without
    prices, each step to a better grade costs 1.

    Raises:
        ValueError: for a sensor or grade that there is not, a missing price, or one that is no
            number of at least 0.
    """
    if prices is None:
        return {
            sensor: {c.words: float(listed[-1].ranks[0] - c.ranks[0]) for c in listed}
            for sensor, listed in choices.items()
        }
    for sensor, grades in prices.items():
        if sensor not in choices:
            raise ValueError(unknown("sensor in the prices", sensor, choices))
        if not isinstance(grades, Mapping):
            raise ValueError(
                f"prices of {sensor} must be a table of numbers by grade, got {grades!r}"
            )
        known = [choice.words for choice in choices[sensor]]
        for grade, price in grades.items():
            if grade not in known:
                raise ValueError(unknown(f"grade of {sensor} in the prices", grade, known))
            if type(price) not in (int, float) or not 0.0 <= price <= DEAREST:
                raise ValueError(
                    f"the price of {sensor}, {grade}, must be a number from 0 to {DEAREST:g}, got"
                    f" {short_repr(price)}"
                )
    found = {}
    for sensor, listed in choices.items():
        own = prices.get(sensor, {})
        for choice in listed:
            if choice.grade not in own:
                raise ValueError(f"the prices lack the grade {choice.grade!r} of {sensor}")
        found[sensor] = {c.words: float(own.get(c.words, own[c.grade])) for c in listed}
    return found


def prices_toml(prices: Prices) -> str:
    """Prices as a TOML file."""
    tables = (
        [f"[{json.dumps(sensor)}]", *(f"{json.dumps(words)} = {p:g}" for words, p in each.items())]
        for sensor, each in prices.items()
    )
    return "\n\n".join("\n".join(lines) for lines in tables) + "\n"
