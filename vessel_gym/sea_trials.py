"""Standard sea trials: turning circle, zig-zag and initial turning.

The trials run the true `vessel_gym.vehicles.corvette_equations` in calm water; the figures are
functions of a track alone, so that they serve an episode of an agent as well as a trial.

SI units and radians. Positions are north and east, headings clockwise from north, positive rudder
turns to starboard. Definitions: IMO resolution MSC.137(76), Standards for ship manoeuvrability (2002).
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy.optimize import brentq

from estimators.checks import finite_array, integer, number
from vessel_gym.checks import check_numbers, function, instance
from vessel_gym.vehicles.corvette_equations import AROUND, STATE, CorvetteParameters, corvette_rates
from vessel_gym.vehicles.integration import runge_kutta

Command = float | Sequence[float] | np.ndarray | Callable[[float, np.ndarray], float]
"""Orders to the helm [rad]: an angle, one angle a step, or a function of time [s] and the truth state."""
_MOST_STEPS, _LARGEST_ORDER = 10**6, 1.6


@dataclass(frozen=True, eq=False)
class Track:
    """A recorded run: ``k + 1`` samples, the first at the start."""

    time: np.ndarray  # (k + 1,) s
    state: np.ndarray  # (k + 1, 6) truth: x, y, psi (unwrapped), u, v, r
    rudder: np.ndarray  # (k + 1,) rad, where it was, not what was ordered


# --- running the ship -------------------------------------------------------------------------------


def simulate(
    ship: CorvetteParameters,
    command: Command,
    duration: float,
    dt: float = 0.5,
    substeps: int = 1,
    start: np.ndarray | None = None,
    rudder: float = 0.0,
    current: tuple[float, float] = (0.0, 0.0),
    stop: Callable[[np.ndarray], bool] | None = None,
) -> Track:
    """Run the ship with its helm: the rudder follows the command at its limited rate and within its limits.

    A step in which the rudder arrives is split there, so that the ramp is integrated exactly.

    Args:
        ship: Parameters.
        command: The ordered rudder angle [rad]; a function is asked at the start of each step.
        duration: Time to run [s], rounded to whole steps.
        dt: Step [s].
        substeps: RK4 steps in each.
        start: ``(8,)`` truth state; None: straight ahead to the north at the service speed.
        rudder: Rudder angle at the start [rad].
        current: Velocity of the water, north and east [m/s].
        stop: Ends the run after the first state for which it holds.

    Raises:
        ValueError: for a step or duration that is not positive, angles in degrees, a schedule that is too short, or
            more than a million steps.
        TypeError: for a ship that is none.
    """
    instance("ship of simulate", ship, CorvetteParameters)
    check_numbers("simulate", {"rudder": rudder}, deflection="rudder")
    _check_times(ship, dt, duration=duration)
    integer("substeps of simulate", substeps, 1)
    function("stop of simulate", stop, "the state")
    current = tuple(finite_array("current of simulate", current, 2))
    steps = max(round(duration / dt), 1)
    orders = np.zeros(0) if callable(command) else finite_array("command of simulate", command, "...")
    if orders.ndim > 1 or np.abs(orders).max(initial=0.0) > _LARGEST_ORDER:
        raise ValueError("command of simulate must be rudder angles in radians (np.deg2rad makes them of degrees)")
    if orders.ndim == 0:
        orders = np.full(steps, orders)
    if not callable(command) and len(orders) < steps:
        raise ValueError(f"the schedule has {len(orders)} commands for {steps} steps")
    state = _straight_on(ship) if start is None else finite_array("start of simulate", start, len(STATE)).copy()
    helm, states, rudders = _Helm(ship, substeps, current), [state], [float(rudder)]
    for k in range(steps):
        order = number("command of simulate", command(k * dt, state) if callable(command) else orders[k])
        state, rudder = helm.step(state, rudder, order, dt)
        states.append(state)
        rudders.append(rudder)
        if stop is not None and stop(state):
            break
    return Track(dt * np.arange(len(states)), np.array(states), np.array(rudders))


def _straight_on(ship: CorvetteParameters) -> np.ndarray:
    """The state ``(8,)`` of a ship that goes to the north at service speed."""
    state = np.zeros(len(STATE))
    state[STATE.index("u")] = ship.speed
    return state


class _Helm:
    """A ship whose rudder follows orders at its limited rate and within its limits."""

    def __init__(self, ship: CorvetteParameters, substeps: int = 1, current: Sequence[float] = (0.0, 0.0)) -> None:
        self._ship, self._c, self._substeps = ship, ship.vector(), substeps
        self._around = np.array([*current, *np.zeros(len(AROUND) - 2)])

    def step(self, state: np.ndarray, rudder: float, order: float, dt: float) -> tuple[np.ndarray, float]:
        """The state and the rudder after ``dt``: the rudder moves until it has arrived, then rests."""
        if dt <= 0.0:
            return state, rudder
        order = min(max(order, -self._ship.rudder_limit), self._ship.rudder_limit)
        moving = abs(order - rudder) / self._ship.rudder_rate
        if moving >= dt:
            end = float(rudder + np.copysign(self._ship.rudder_rate * dt, order - rudder))
            return self._moved(state, rudder, end, dt), end
        if moving > 0.0:
            state = self._moved(state, rudder, order, moving)
        return self._moved(state, order, order, dt - moving), order

    def time_to(self, heading: float, state: np.ndarray, rudder: float, order: float, dt: float) -> float:
        """Time within a step at which a heading is reached."""
        return brentq(lambda time: self.step(state, rudder, order, time)[0][2] - heading, 0.0, dt, xtol=1e-12)

    def _moved(self, state: np.ndarray, before: float, after: float, dt: float) -> np.ndarray:
        """The state ``(8,)`` after ``dt``, the rudder moving from ``before`` to ``after``."""
        rudder = np.array([before]), np.array([after])
        return runge_kutta(corvette_rates, state, *rudder, self._around, self._c, dt, self._substeps)


# --- turning circle ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class CircleGeometry:
    """Figures of a turn over ground, seen from where it was ordered; None: not reached.

    Advance is along the heading at the start; transfer and tactical diameter are across it and
    positive to the side of the turn.
    """

    advance: float | None  # m, at 90 deg of heading change
    transfer: float | None  # m, at 90 deg
    tactical_diameter: float | None  # m, at 180 deg
    time_to_90: float | None  # s, None too without dt
    time_to_180: float | None  # s
    time_to_360: float | None  # s


@dataclass(frozen=True)
class Circle:
    """A circle fitted to points."""

    x: float  # centre, m
    y: float  # m
    radius: float  # m
    rms: float  # m, of the distances from the circle


@dataclass(frozen=True)
class TurningCircleTrial(CircleGeometry):
    """The figures of a turning circle in calm water; None: not reached."""

    steady_radius: float | None  # m, of the track over the last full turn
    final_speed: float  # m/s through the water, at the end
    speed_ratio: float  # final speed / approach speed
    track: Track


def circle_geometry(x: np.ndarray, y: np.ndarray, psi: np.ndarray, dt: float | None = None) -> CircleGeometry:
    """Advance, transfer and tactical diameter of any track, whose first sample is the start of execution.

    The positions at 90 and 180 degrees of heading change are interpolated linearly between samples
    (MSC.137(76), Annex, 4.2: the midship point's). The side is that to which the heading first
    changes by 90 degrees.

    Args:
        x: ``(k,)`` north [m].
        y: ``(k,)`` east [m].
        psi: ``(k,)`` heading [rad], wrapped or not; less than half a turn between samples.
        dt: Time between samples [s], for the times.

    Raises:
        ValueError: for what is no track.
    """
    check_numbers("circle_geometry", {"dt": dt}, positive="dt?")
    x, y, psi = _columns(x=x, y=y, psi=psi)
    change = np.unwrap(psi)
    change = change - change[0]
    cos, sin = np.cos(psi[0]), np.sin(psi[0])
    turned = np.flatnonzero(np.abs(change) >= 0.5 * np.pi)
    side = np.sign(change[turned[0]]) if len(turned) else 1.0
    ahead = (x - x[0]) * cos + (y - y[0]) * sin
    aside = side * ((y - y[0]) * cos - (x - x[0]) * sin)
    quarter, half, full = (_first_crossing(side * change, angle * np.pi) for angle in (0.5, 1.0, 2.0))
    return CircleGeometry(
        advance=_at(ahead, quarter),
        transfer=_at(aside, quarter),
        tactical_diameter=_at(aside, half),
        time_to_90=None if dt is None or quarter is None else quarter * dt,
        time_to_180=None if dt is None or half is None else half * dt,
        time_to_360=None if dt is None or full is None else full * dt,
    )


def fit_circle(x: np.ndarray, y: np.ndarray) -> Circle:
    """The circle through points by linear least squares (Kasa 1976, A circle fitting procedure).

    The fit is exact for points on a circle. With noise, it favours small circles on short arcs: give it half a
    turn or more.

    Args:
        x: ``(k,)`` coordinates [m].
        y: ``(k,)`` coordinates [m].

    Raises:
        ValueError: for points through which no circle, or more than one, goes.
    """
    x, y = _columns(x=x, y=y)
    middle, size = np.array([x.mean(), y.mean()]), max(np.ptp(x), np.ptp(y))
    if len(x) < 3 or size == 0.0:
        raise ValueError("a circle needs three different points")
    a, b = (x - middle[0]) / size, (y - middle[1]) / size
    columns = np.stack([2.0 * a, 2.0 * b, np.ones_like(a)], -1)
    (centre_a, centre_b, rest), _, rank, _ = np.linalg.lstsq(columns, a * a + b * b, rcond=1e-10)
    if rank < 3:
        raise ValueError("the points lie on a straight line, or fewer than three differ")
    radius = np.sqrt(rest + centre_a**2 + centre_b**2)
    rms = np.sqrt(np.mean((np.hypot(a - centre_a, b - centre_b) - radius) ** 2))
    return Circle(
        float(middle[0] + size * centre_a), float(middle[1] + size * centre_b), float(size * radius), float(size * rms)
    )


def turning_circle(
    ship: CorvetteParameters,
    rudder: float,
    speed: float | None = None,
    dt: float = 0.5,
    turns: float = 2.0,
    longest: float = 1800.0,
) -> TurningCircleTrial:
    """Put the rudder over from a straight course at constant speed, and turn.

    Args:
        ship: Parameters.
        rudder: Ordered angle [rad], positive to starboard.
        speed: Approach speed [m/s], for which the thrust is set; None: the service speed.
        dt: Step [s].
        turns: Full turns after which the trial ends; the last one gives the steady radius.
        longest: Time [s] after which it ends anyway.

    Raises:
        ValueError: for a number that no trial has, such as a rudder in degrees.
        TypeError: for a ship that is none.
    """
    check_numbers("turning_circle", {"turns": turns}, positive="turns")
    ship = _at_speed(ship, speed, rudder)
    _check_times(ship, dt, longest=longest)
    track = simulate(ship, rudder, longest, dt, stop=lambda state: abs(state[2]) >= 2.0 * np.pi * turns)
    x, y, psi, u, v = track.state.T[:5]
    geometry = circle_geometry(x, y, psi, dt)
    last = np.abs(psi) >= abs(psi[-1]) - 2.0 * np.pi
    final = float(np.hypot(u[-1], v[-1]))
    return TurningCircleTrial(
        **asdict(geometry),
        steady_radius=None if geometry.time_to_360 is None else fit_circle(x[last], y[last]).radius,
        final_speed=final,
        speed_ratio=final / ship.speed,
        track=track,
    )


# --- zig-zag and initial turning --------------------------------------------------------------------


@dataclass(frozen=True)
class ZigzagTrial:
    """The figures of a zig-zag trial; None: not reached."""

    first_overshoot: float | None  # rad beyond the heading at which the rudder was reversed
    second_overshoot: float | None  # rad
    period: float | None  # s from the second execute (the first reversal) to the fourth: one full cycle
    executes: tuple[float, ...]  # s, times at which a rudder was ordered, the first at 0
    track: Track


def zigzag(
    ship: CorvetteParameters,
    rudder: float,
    heading: float | None = None,
    dt: float = 0.5,
    speed: float | None = None,
    longest: float = 1800.0,
) -> ZigzagTrial:
    """The zig-zag trial of MSC.137(76): reverse the rudder each time that the heading has changed as far.

    The instant of a reversal is solved for within its step, so that the overshoots do not depend
    on where the samples fall.

    Args:
        ship: Parameters.
        rudder: Rudder angle [rad]; positive begins to starboard.
        heading: Change of heading [rad] at which the rudder is reversed; None: as large as the rudder angle.
        dt: Step [s].
        speed: Approach speed [m/s], for which the thrust is set; None: the service speed.
        longest: Time [s] after which the trial ends in any case.

    Raises:
        ValueError: for a number that no trial has, such as a rudder of 0 or in degrees.
        TypeError: for a ship that is none.
    """
    check_numbers("zigzag", {"heading": heading}, positive="heading?", deflection="heading?")
    ship = _at_speed(ship, speed, rudder)
    _check_times(ship, dt, longest=longest)
    target = abs(rudder if heading is None else heading)
    track, executes, peaks = _run_zigzag(ship, rudder, target, dt, longest)
    return ZigzagTrial(
        first_overshoot=peaks[0] if peaks else None,
        second_overshoot=peaks[1] if len(peaks) > 1 else None,
        period=executes[3] - executes[1] if len(executes) > 3 else None,
        executes=tuple(executes),
        track=track,
    )


def _run_zigzag(
    ship: CorvetteParameters, rudder: float, target: float, dt: float, longest: float
) -> tuple[Track, list[float], list[float]]:
    """Track, times of orders and overshoots of one full cycle, whose rudder is reversed at ``target`` [rad]."""
    helm, state, angle, order = _Helm(ship), _straight_on(ship), 0.0, float(rudder)
    states, angles, executes, peaks = [state], [angle], [0.0], []
    for k in range(max(round(longest / dt), 1)):
        elapsed = 0.0
        after = helm.step(state, angle, order, dt)
        if np.sign(order) * after[0][2] >= target:  # reverse within this step
            elapsed = helm.time_to(np.copysign(target, order), state, angle, order, dt)
            state, angle = helm.step(state, angle, order, elapsed)
            order = -order
            executes.append(k * dt + elapsed)
            after = helm.step(state, angle, order, dt - elapsed)
        # After an execute the ship still swings the old way; where the yaw rate changes sign, the heading peaks.
        before, (state, angle) = state, after
        if before[5] * state[5] <= 0.0 and before[5] * order < 0.0:
            zero = (dt - elapsed) * before[5] / (before[5] - state[5])
            peaks.append(float(abs(before[2] + 0.5 * before[5] * zero) - target))
        states.append(state)
        angles.append(angle)
        if len(executes) >= 4 and len(peaks) >= 2:
            break
    return Track(dt * np.arange(len(states)), np.array(states), np.array(angles)), executes, peaks


def initial_turning(
    ship: CorvetteParameters,
    rudder: float = np.deg2rad(10.0),
    heading: float = np.deg2rad(10.0),
    dt: float = 0.5,
    longest: float = 600.0,
) -> float | None:
    """Distance along the track, in ship lengths, until the heading has changed by ``heading`` (MSC.137(76), 5.3.2).

    Args:
        ship: Parameters.
        rudder: Ordered angle [rad].
        heading: Change of heading [rad].
        dt: Step [s].
        longest: Time [s] after which the answer is None.

    Raises:
        ValueError: for a number that no trial has, such as a rudder of 0 or in degrees.
        TypeError: for a ship that is none.
    """
    check_numbers("initial_turning", {"heading": heading}, positive="heading", deflection="heading")
    ship = _at_speed(ship, None, rudder)
    _check_times(ship, dt, longest=longest)
    track = simulate(ship, rudder, longest, dt, stop=lambda state: abs(state[2]) >= heading)
    x, y, psi = track.state.T[:3]
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    distance = _at(travelled, _first_crossing(np.abs(psi), heading))
    return None if distance is None else distance / ship.length


# --- inside -----------------------------------------------------------------------------------------


def _columns(**series: object) -> list[np.ndarray]:
    """Series of numbers, one a sample, of one length."""
    columns = [finite_array(name, values, "k") for name, values in series.items()]
    lengths = {len(column) for column in columns}
    if len(lengths) > 1 or 0 in lengths:
        raise ValueError(f"{', '.join(series)} must be as long as each other, and not empty")
    return columns


def _check_times(ship: CorvetteParameters, dt: float, **longest: float) -> None:
    """Refuse steps in which a ship sails farther than its length, and more than `_MOST_STEPS` of them."""
    for name, value in ({"dt": dt} | longest).items():
        number(f"{name} of a trial", value, 0.0, what="a positive number")
    if dt > ship.length / ship.speed:
        text = f"dt of a trial must be at most {ship.length / ship.speed:.3g} s, in which the ship sails its length"
        raise ValueError(f"{text}, got {dt:g}")
    for name, time in longest.items():
        if time / dt > _MOST_STEPS:
            raise ValueError(f"{name} of a trial must be at most {_MOST_STEPS} steps of dt = {dt:g} s, got {time:g} s")


def _at_speed(ship: CorvetteParameters, speed: float | None, rudder: float = 0.1) -> CorvetteParameters:
    """The ship of a trial with its thrust set for another speed (the same resistance coefficient)."""
    instance("ship of a trial", ship, CorvetteParameters)
    check_numbers("a trial", {"rudder": rudder, "speed": speed}, deflection="rudder", positive="speed?")
    if rudder == 0.0:
        raise ValueError("rudder of a trial must not be 0: positive turns to starboard")
    if speed is None:
        return ship
    return replace(ship, speed=speed, resistance=ship.resistance * (speed / ship.speed) ** 2)


def _first_crossing(values: np.ndarray, level: float) -> float | None:
    """Sample, by linear interpolation, at which ``values`` first reach ``level``."""
    reached = np.flatnonzero(values >= level)
    if len(reached) == 0:
        return None
    k = int(reached[0])
    return float(k) if k == 0 else float(k - 1 + (level - values[k - 1]) / (values[k] - values[k - 1]))


def _at(values: np.ndarray, sample: float | None) -> float | None:
    """``values`` at a fractional sample; None where it was not reached."""
    return None if sample is None else float(np.interp(sample, np.arange(len(values)), values))
