"""The track of a ship on a turning circle, through the water: a current carries the true ship away from it."""

import numpy as np

from estimators.checks import finite_array
from vessel_gym.checks import check_numbers, instance
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette import steady_turns


def path(heading: np.ndarray, surge: np.ndarray, sway: np.ndarray, dt: float) -> np.ndarray:
    """Positions ``(k, 2)`` north and east [m] from the origin, by the trapezoidal rule through the water.

    Args:
        heading: ``(k,)`` rad.
        surge: ``(k,)`` m/s.
        sway: ``(k,)`` m/s.
        dt: Time between samples [s].
    """
    heading = finite_array("heading", heading, "k")
    surge, sway = (finite_array(name, given, len(heading)) for name, given in (("surge", surge), ("sway", sway)))
    check_numbers("a track", {"dt": dt}, positive="dt")
    velocity = np.stack(
        [surge * np.cos(heading) - sway * np.sin(heading), surge * np.sin(heading) + sway * np.cos(heading)], -1
    )
    steps = 0.5 * dt * (velocity[1:] + velocity[:-1])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)])


def commanded_path(task: TurningCircle, course: np.ndarray) -> np.ndarray:
    """The path ``(k, 2)``, one circle long: the track, or that of the reference heading at the turn's speed and drift.

    Args:
        task: The task.
        course: ``(2,)`` what it drew.
    """
    instance("task", task, TurningCircle)
    course = finite_array("course", course, 4 if isinstance(task, CircleTrack) else 2)
    if isinstance(task, CircleTrack):
        lead, whole = task.ship.speed * (task.lead + task.ramp), 2.0 * np.pi / abs(course[2])
        along = np.linspace(0.0, lead + whole, 200)
        return task.track(np.tile(course, (len(along), 1)), along)[0]
    steps = np.arange(task.horizon + 1)
    reference = task.command(np.tile(course, (len(steps), 1)), steps)
    turned = np.abs(reference[:, 0] - course[0]) - 0.5 * task.ramp * abs(course[1])
    reference = reference[: 2 + np.searchsorted(turned, 2.0 * np.pi)]
    turns = steady_turns(task.ship)
    rate = np.abs(reference[:, 1])
    surge = np.interp(rate, turns.yaw_rate, turns.speed)
    sway = np.sign(reference[:, 1]) * np.interp(rate, turns.yaw_rate, turns.sway)
    return path(reference[:, 0], surge, sway, task.dt)
