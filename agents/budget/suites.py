"""Suites to choose from: a grade of each sensor, perhaps at a lower rate, and what they cost."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import fsum, prod
from typing import Any, NamedTuple

import numpy as np

from agents.budget.sensors import no_worse, total_error
from agents.page import named
from estimators.checks import AT_LEAST_0, number
from vessel_gym.checks import one_of
from vessel_gym.sensors import Sensor
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
        sensor: The sensor of this grade; its rate is a number.
    """

    words: str
    grade: str
    sensor: Sensor


Choices = Mapping[str, Sequence[Choice]]
"""Choices of each sensor by its name."""


class Suite(NamedTuple):
    """A choice for each sensor.

    Attributes:
        cost: Sum of the prices of the choices; of suites of one price, higher rates count more.
        choices: The choice of each sensor.
        grades: Words of the choice by sensor.
    """

    cost: tuple[float, float]
    choices: tuple[Choice, ...]
    grades: dict[str, str]

    def __str__(self) -> str:
        return named(self.grades)


def choices_of(system: System, rates: Sequence[float] = ()) -> dict[str, list[Choice]]:
    """Grades of each sensor of a system, at their own rate and at each of ``rates`` that is lower.

    Sensors of which there is no choice are left out.

    Raises:
        ValueError: if there is no choice at all, or a rate is not below that of any grade, or does
            not divide the steps of a second.
    """
    dt = system.vehicle.dt
    grades: dict[str, dict[str, Any]] = {
        name: {grade: replace(s, rate=s.rate or 1.0 / dt) for grade, s in each.items()}
        for name, each in grades_of(system).items()
    }
    highest = max(s.rate for each in grades.values() for s in each.values())
    for rate in rates:
        what = f"above 0 and below {highest:g} Hz, the highest of any grade"
        number("--rates", rate, 0.0, highest, what)
        replace(system.nominal_sensors[0], rate=rate).period(dt)
    found = {
        name: [
            Choice(
                f"{grade} at {rate:.9g} Hz" if rate else grade,
                grade,
                replace(s, rate=rate or s.rate),
            )
            for grade, s in each.items()
            for rate in (0.0, *sorted(set(rates), reverse=True))
            if rate < s.rate
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
    for chosen in product(*choices.values()):
        grades = dict(zip(choices, (choice.words for choice in chosen), strict=True))
        price = fsum(prices[sensor][words] for sensor, words in grades.items())
        found.append(Suite((price, fsum(c.sensor.rate or 0.0 for c in chosen)), chosen, grades))
    return sorted(found, key=lambda suite: suite.cost)


def no_better(suites: Sequence[Suite]) -> np.ndarray:
    """Matrix ``(K, K)``: True where a row's suite is better in no sensor than a column's."""
    found = np.ones((len(suites), len(suites)), bool)
    for column in zip(*(suite.choices for suite in suites), strict=True):
        kinds = list(dict.fromkeys(column))
        order = np.array([[no_worse(b.sensor, a.sensor) for b in kinds] for a in kinds])
        index = [kinds.index(choice) for choice in column]
        found &= order[np.ix_(index, index)]
    return found


def worthwhile(choices: Choices, prices: Prices) -> tuple[dict[str, list[Choice]], list[str]]:
    """Choices worth their prices, the cheapest first, and a sentence on each of the others.

    A choice is not worth its price if another grade costs no more and is worse in no error, or if
    its own grade costs less at a rate that is no lower.
    """
    kept: dict[str, list[Choice]] = {sensor: [] for sensor in choices}
    dropped = []
    for sensor, each in choices.items():
        price = {c: (prices[sensor][c.words], sum(no_worse(o.sensor, c.sensor) for o in each))
                 for c in each}  # fmt: skip
        for one in sorted(each, key=price.__getitem__):  # of one price, the better first
            instead = [
                other
                for other in kept[sensor]
                if (other.grade != one.grade or price[other][0] < price[one][0])
                and no_worse(other.sensor, one.sensor)
            ]
            if instead:
                dropped.append(
                    f"{sensor}: {one.words} is left out, because {instead[0].words} costs no more"
                    " and is worse in no error."
                )
            else:
                kept[sensor].append(one)
    return kept, dropped


def price_list(choices: Choices, prices: Mapping[str, Any] | None) -> dict[str, dict[str, float]]:
    """Price of every choice by sensor and words.

    A grade at a lower rate costs what the grade does, unless it has a price of its own. Without
    prices, each step to a grade of smaller `total_error` costs 1.

    Raises:
        ValueError: for a sensor or grade that there is not, a missing price, or one that is no
            number of at least 0; without prices, for noise that depends on the measurement.
    """
    if prices is None:
        return {sensor: _steps(sensor, listed) for sensor, listed in choices.items()}
    for sensor, grades in prices.items():
        one_of("sensor in the prices", sensor, choices)
        if not isinstance(grades, Mapping):
            raise ValueError(
                f"prices of {sensor} must be a table of numbers by grade, got {grades!r}"
            )
        known = [choice.words for choice in choices[sensor]]
        for grade, price in grades.items():
            one_of(f"grade of {sensor} in the prices", grade, known)
            what = f"a number from 0 to {DEAREST:g}"
            number(f"the price of {sensor}, {grade},", price, AT_LEAST_0, DEAREST + 1.0, what)
    found = {}
    for sensor, listed in choices.items():
        own = prices.get(sensor, {})
        for choice in listed:
            if choice.grade not in own:
                raise ValueError(f"the prices lack the grade {choice.grade!r} of {sensor}")
        found[sensor] = {c.words: float(own.get(c.words, own[c.grade])) for c in listed}
    return found


def _steps(sensor: str, listed: Sequence[Choice]) -> dict[str, float]:
    """Price of each choice: the number of grades with a greater mean error over the channels."""
    if any(callable(c.sensor.sd) for c in listed):
        raise ValueError(
            f"the noise of {sensor} depends on its measurement, so its grades have no order: give"
            " their prices with --prices"
        )
    errors = np.array([total_error(c.sensor) for c in listed])
    mean = (errors / np.maximum(errors.max(axis=0), np.finfo(float).tiny)).mean(axis=1)
    return {
        c.words: float(len({o.grade for o, worse in zip(listed, mean > own, strict=True) if worse}))
        for c, own in zip(listed, mean, strict=True)
    }
