"""Manoeuvres of ships in calm water, and their figures (IMO resolution MSC.137(76)).

Rates are functions of a state (x, y, psi, u, v, r) and the rudder, positive to starboard. Figures
are over ground, from a straight course to the north.
"""

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from stepping import corvette_step

from vessel_gym.vehicles.corvette_equations import AROUND, CorvetteParameters, corvette_rates

DEG = np.pi / 180.0
RATE = 5.0 * DEG  # of the rudder of every ship here, rad/s
STILL = np.zeros(len(AROUND))  # no current, no forces

Rates = Callable[[np.ndarray, float], np.ndarray]


@cache
def rates_of(ship: CorvetteParameters) -> Rates:
    """The rates of one of our ships, upright: roll does nothing to the other motions."""
    c = ship.vector()
    return lambda state, rudder: corvette_rates(
        np.append(state, [0.0, 0.0]), np.array([rudder]), STILL, c
    )[:6]


def sailed(
    ship: CorvetteParameters, rudder: np.ndarray, dt: float = 0.5, start: np.ndarray | None = None
):
    """States ``(k + 1, 8)`` under rudder angles ``(k + 1,)``, between which the rudder moves evenly."""
    states = [np.array([0.0, 0.0, 0.0, ship.speed, 0.0, 0.0, 0.0, 0.0]) if start is None else start]
    for each in pairwise(rudder):
        states.append(corvette_step(states[-1], np.array(each), STILL, ship.vector(), dt, 1))
    return np.array(states)


def helmed(
    rates: Rates, state: np.ndarray, rudder: float, order: float, duration: float, event: Any = None
):
    """A ship under an order of the helm until the duration is over or an event: its solution, and the last rudder."""

    def angle(t: float) -> float:
        return rudder + np.clip(order - rudder, -RATE * t, RATE * t)

    solution = solve_ivp(
        lambda t, s: rates(s, angle(t)), (0.0, duration), state, rtol=1e-7, atol=1e-9, max_step=1.0,
        events=event, dense_output=True,
    )  # fmt: skip
    return solution, angle(solution.t[-1])


def ahead(speed: float) -> np.ndarray:
    """The state of a ship that goes to the north."""
    return np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0])


class Turn(NamedTuple):
    """Figures of a turning circle [m]."""

    advance: float  # at 90 degrees of heading change
    transfer: float  # at 90 degrees
    tactical_diameter: float  # at 180 degrees


def figures(x: np.ndarray, y: np.ndarray, psi: np.ndarray) -> Turn:
    """Figures of a turn, by linear interpolation."""
    turned, aside = np.abs(psi), np.sign(psi[-1]) * y
    quarter, half = 0.5 * np.pi, np.pi
    return Turn(
        np.interp(quarter, turned, x),
        np.interp(quarter, turned, aside),
        np.interp(half, turned, aside),
    )


@cache
def turning_circle(rates: Rates, speed: float, degrees: float) -> tuple[Turn, float, float]:
    """Figures of a turn, the radius [m] of the steady turn and its speed as a share of that before."""
    solution, _ = helmed(rates, ahead(speed), 0.0, degrees * DEG, 900.0)
    x, y, psi, u, v, r = solution.sol(np.arange(0.0, 900.0, 0.5))
    final = np.hypot(u[-1], v[-1])
    return figures(x, y, psi), float(final / abs(r[-1])), float(final / speed)


@cache
def overshoots(rates: Rates, speed: float, degrees: float) -> tuple[float, float]:
    """First and second overshoot of a zig-zag [deg]."""
    state, rudder, side, peaks = ahead(speed), 0.0, 1.0, []
    for _ in range(3):

        def reached(_: float, s: np.ndarray, side: float = side) -> float:
            return side * s[2] - degrees * DEG

        reached.terminal, reached.direction = True, 1.0  # type: ignore[attr-defined]
        solution, rudder = helmed(rates, state, rudder, side * degrees * DEG, 600.0, reached)
        peaks.append((-side * solution.y[2]).max() / DEG - degrees)
        state, side = solution.y[:, -1], -side
    return peaks[1], peaks[2]
