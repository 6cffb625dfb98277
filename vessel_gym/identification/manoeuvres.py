"""Numbers of turning and zig-zag trials, measured and simulated: the gap between a log and its model.

Advance and tactical diameter are as in IMO resolution MSC.137(76), from where the rudder is put over. Overshoots are
with the rudder of the log, periods with a rudder that the model reverses itself, at the headings at which the ship did.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vessel_gym.identification.score import Predict
from vessel_gym.identification.trial import Trial

_LEAST = 0.05
"""Rudder angle [rad] of a manoeuvre."""


@dataclass(frozen=True)
class Manoeuvre:
    """Numbers of a trial; NaN of those that it does not show.

    Attributes:
        advance: Distance along the first course to a change of heading of 90 degrees [m].
        tactical_diameter: Distance across it to a change of 180 degrees [m].
        speed_loss: Share of the speed that is lost at 180 degrees.
        overshoots: Changes of heading [rad] after each reversal of the rudder; NaN where the ship does not come back.
    """

    advance: float
    tactical_diameter: float
    speed_loss: float
    overshoots: tuple[float, ...]


_PATIENCE = 3.0
"""Times the measured duration that a simulated ship may take to the heading at which the rudder is reversed."""


def execution(rudder: np.ndarray, psi: np.ndarray) -> int | None:
    """Step at which a manoeuvre begins; None of a trial without rudder.

    That of a turn is where the rudder goes to the side on which the heading changes most, if by at least 90 degrees.
    That of others is where it first reaches nine tenths of its largest angle: before, it may keep a course.

    Args:
        rudder: ``(T,)`` [rad].
        psi: Heading ``(T + 1,)`` [rad].
    """
    largest = float(np.abs(rudder).max(initial=0.0))
    if largest <= _LEAST:
        return None
    side = np.where(np.abs(rudder) > 0.5 * largest, np.sign(rudder), 0.0)
    edges = [0, *np.flatnonzero(np.diff(side)) + 1, len(side)]
    turned = [side[a] * (psi[b] - psi[a]) for a, b in pairwise(edges)]
    longest = int(np.argmax(turned))
    return int(edges[longest]) if turned[longest] >= 0.5 * np.pi else int(np.argmax(np.abs(rudder) > 0.9 * largest))


def manoeuvre(states: np.ndarray, rudder: np.ndarray) -> Manoeuvre:
    """Numbers of a trial that begins where the rudder is put over.

    Args:
        states: ``(T + 1, 6)``.
        rudder: ``(T,)`` [rad].
    """
    reversals = _reversals(rudder)
    end = int(reversals[0]) if len(reversals) else len(rudder)
    x, y, psi = states[: end + 1, :3].T
    side = float(np.sign(rudder[0]))
    turned = side * (psi - psi[0])
    ahead = (x - x[0]) * np.cos(psi[0]) + (y - y[0]) * np.sin(psi[0])
    across = side * ((y - y[0]) * np.cos(psi[0]) - (x - x[0]) * np.sin(psi[0]))
    speed = np.hypot(states[: end + 1, 3], states[: end + 1, 4])
    half = _at(turned, np.pi, speed)
    return Manoeuvre(
        _at(turned, 0.5 * np.pi, ahead),
        _at(turned, np.pi, across),
        1.0 - half / float(speed[0]),
        _overshoots(states[:, 2], rudder, reversals),
    )


def executed(trial: Trial) -> Trial | None:
    """The trial from where the rudder is put over; None without rudder."""
    first = execution(trial.control[:, 0], trial.states[:, 2])
    return None if first is None else trial.part(first, len(trial))


def compare(predict: Predict, trial: Trial) -> tuple[Manoeuvre, Manoeuvre] | None:
    """Numbers of a trial as measured, and as simulated from where the rudder is put over; None without rudder."""
    part = executed(trial)
    if part is None:
        return None
    rudder, states = part.control[:, 0], predict(part.states[:1], part.control[:, None], part.air[:, None])[:, 0]
    return manoeuvre(part.states, rudder), manoeuvre(states, rudder)


def track_errors(predict: Predict, part: Trial, distances: Sequence[float] | np.ndarray) -> np.ndarray:
    """Distance ``(k,)`` [m] of the simulated ship from the measured one after she sailed ``distances`` ``(k,)`` [m].

    Args:
        predict: The model; it begins at the first measured state.
        part: A trial, `executed` or whole.
        distances: Along the measured track; of those beyond its end the error is NaN.
    """
    states = predict(part.states[:1], part.control[:, None], part.air[:, None])[:, 0]
    sailed = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(part.states[:, :2], axis=0).T))])
    error = np.hypot(*(states - part.states)[:, :2].T)
    return np.interp(distances, sailed, error, right=np.nan)


def periods(predict: Predict, part: Trial) -> tuple[np.ndarray, np.ndarray]:
    """Periods of a zig-zag [s], measured and simulated, ``(n,)`` each: from a reversal to the next but one.

    The simulated ship reverses her rudder where she reaches the headings of the measured reversals. She has the rudder
    and revolutions of the log since the last reversal, and the wind of her own time. A period that she does not end
    is NaN.

    Args:
        predict: The model; it begins at the first measured state.
        part: A trial, `executed`.
    """
    reversals = _reversals(part.control[:, 0])
    times, state, now = [], part.states[:1], 0
    for first, last in pairwise([0, *reversals.tolist()]):
        steps = np.arange(round(_PATIENCE * (last - first)))
        control = part.control[first + np.minimum(steps, last - first - 1)]
        states = predict(state, control[:, None], part.air[np.minimum(now + steps, len(part) - 1), None])[:, 0]
        way = np.sign(part.states[last, 2] - part.states[first, 2])
        reached = np.flatnonzero(way * (states[:, 2] - part.states[last, 2]) >= 0.0)
        if len(reached) == 0:
            break
        now, state = now + int(reached[0]), states[reached[:1]]
        times.append(now)
    simulated = np.full(len(reversals), np.nan)
    simulated[: len(times)] = times
    return part.dt * (reversals[2:] - reversals[:-2]), part.dt * (simulated[2:] - simulated[:-2])


def _reversals(rudder: np.ndarray) -> np.ndarray:
    """Steps at which the rudder goes to the other side."""
    over = np.flatnonzero(np.abs(rudder) > _LEAST)
    return over[1:][np.diff(np.sign(rudder[over])) != 0.0]


def _at(turned: np.ndarray, angle: float, values: np.ndarray) -> float:
    """Values where a change of heading is first reached."""
    reached = np.flatnonzero(turned >= angle)
    if len(reached) == 0 or reached[0] == 0:
        return float("nan")
    i = int(reached[0])
    share = (angle - turned[i - 1]) / (turned[i] - turned[i - 1])
    return float(values[i - 1] + share * (values[i] - values[i - 1]))


def _overshoots(psi: np.ndarray, rudder: np.ndarray, reversals: np.ndarray) -> tuple[float, ...]:
    """Change of heading to the old side from each reversal to the next; NaN if the ship does not come back."""
    found = []
    for first, last in pairwise([*reversals, len(rudder)]):
        beyond = -np.sign(rudder[first]) * (psi[first : last + 1] - psi[first])
        found.append(float(beyond.max()) if beyond[-1] < beyond.max() else np.nan)
    return tuple(found)
