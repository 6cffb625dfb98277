"""A ship at sea as an environment uses it: what is read of it, and the models that filters have, position included."""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np

from vessel_gym.processes import linear
from vessel_gym.sensors import Sensor, plain
from vessel_gym.vehicles.actuators import mean_input
from vessel_gym.vehicles.corvette import COMPASS, Corvette, linear_matrices, steady_turns, surge_models
from vessel_gym.vehicles.corvette_equations import STATE, corvette_sloped, corvette_step

_ESTIMATED = STATE[:6]  # all but roll
_X, _Y, _PSI, _U, _V, _R = range(6)
_TURNING = np.ix_([_V, _R, _PSI], [_V, _R, _PSI])


@dataclass(frozen=True)
class Ship(Corvette):
    """A ship whose position is read and estimated, too, in batches.

    All filters estimate (x, y, psi, u, v, r); roll, which does nothing to these, is left to itself. Their known input
    is ``u = (rudder, commanded yaw rate, believed heading, 1)``: linear ones follow the commanded turn, and the track
    on the heading. With d the yaw increment that waves give in a step, ``psi+ = psi + dt r + d``; the compass reads
    ``psi + d``, as in the thesis, and the rate gyro ``r + d / dt``.
    """

    kinds = ("nonlinear", "linear")
    linear_kinds = ("linear",)
    rates: ClassVar = {"r": "psi"}

    @cached_property
    def sensors(self) -> tuple[Sensor, ...]:  # type: ignore[override]
        """Gyro compass, rate gyro, and a receiver that reads every other step."""
        return (
            COMPASS,
            Sensor(
                "rate gyro", ("yaw rate [rad/s]",), linear(partial(_yaw_rate, self.dt)), (2e-3,), scale=(0.01,),
                gives=("r",),
            ),
            Sensor(
                "receiver", ("north [m]", "east [m]"), plain((0, 1)), (2.0, 2.0), rate=0.5 / self.dt,
                scale=(200.0, 200.0), gives=("x", "y"),
            ),
        )  # fmt: skip

    @property
    def process_sd(self) -> np.ndarray:
        """Of (x, y, psi, u, v, r) in a step: the sway of waves, and wind, of which no model knows."""
        return np.array([0.2, 0.2, 1e-4, 0.03, 0.04, 6e-4 * 0.5 / self.dt])

    def estimated(self, kind: str) -> tuple[str, ...]:
        """(x, y, psi, u, v, r)."""
        return _ESTIMATED

    def _placed(self, x: np.ndarray) -> np.ndarray:
        """The state ``(..., 8)`` out of what is estimated, upright."""
        state = np.zeros(x.shape[:-1] + (len(STATE),))
        state[..., : len(_ESTIMATED)] = x
        return state

    @property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """Straight on to the north at service speed."""
        return np.array([0.0, 0.0, 0.0, self.ship.speed, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """What is estimated one step on."""
        control = np.repeat(u[..., :1], 2, axis=-1)
        after = corvette_step(self._placed(x), control, flow, self._nominal, self.dt, 1)
        moved = np.empty(after.shape[:-1] + (len(_ESTIMATED),)) if out is None else out
        moved[...] = after[..., : len(_ESTIMATED)]
        return moved

    bent = _PSI, _U, _V, _R
    """Which components of what is estimated `drift` is not linear in; the others, a place, are carried along."""

    def slopes(
        self, x: np.ndarray, u: np.ndarray, flow: np.ndarray, columns: np.ndarray, by: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What `drift` gives rows ``(B, 6)``, and its derivatives ``(B, 6, k)``.

        Args:
            x: ``(B, 6)``.
            u: ``(1 or B, m)``.
            flow: ``(1 or B, f)``.
            columns: ``(k,)`` components of x, and of the flow from 6 on, to differ in,
            by: ``(B, k)`` so much.
        """
        after, derivatives = np.empty((len(x), len(STATE))), np.empty((len(x), len(STATE), len(columns)))
        columns = np.where(columns < len(_ESTIMATED), columns, columns + len(STATE) - len(_ESTIMATED))
        rudder = u[:, :1].copy()  # which may be read-only
        corvette_sloped(
            self._placed(x), rudder, rudder, flow, self._nominal, self.dt, 1, columns, by, after, derivatives
        )
        return after[:, : len(_ESTIMATED)], derivatives[:, : len(_ESTIMATED)]

    def known_input(self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None) -> np.ndarray:
        """The mean rudder over a step, the commanded yaw rate and believed heading, and 1.

        Where a task commands nothing: the yaw rate of the steady turn which the rudder holds, and north.
        """
        u = np.ones((len(before), 4))
        if commanded is None:
            commanded = np.zeros((len(before), 2))
            commanded[:, :1] = super().known_input(before, after, None)[:, 1:]
        mean_input(before, after, commanded, u)
        return u

    def linear(self, kind: str) -> tuple[Any, ...]:
        """A, B and what flows do: sway, yaw and surge about the commanded turn, the track on the believed heading.

        Of flows only the current is known.
        """
        A, B = linear_matrices(self.ship, self.dt)
        turns, kept = steady_turns(self.ship), surge_models(self.ship, self.dt)
        n = len(_ESTIMATED)
        carried = np.zeros((n, len(self.flows)))
        carried[_X, 0] = carried[_Y, 1] = self.dt

        def moving(u: np.ndarray) -> np.ndarray:
            matrix = np.zeros(u.shape[:-1] + (n, n))
            matrix[(..., *_TURNING)] = A(u)  # type: ignore[index]
            heading = u[..., 2] + 0.5 * self.dt * u[..., 1]  # in the middle of the step
            north, east = self.dt * np.cos(heading), self.dt * np.sin(heading)
            matrix[..., _X, _X], matrix[..., _X, _U], matrix[..., _X, _V] = 1.0, north, -east
            matrix[..., _Y, _Y], matrix[..., _Y, _U], matrix[..., _Y, _V] = 1.0, east, north
            matrix[..., _U, _U] = np.interp(np.abs(u[..., 1]), turns.yaw_rate, kept)
            return matrix

        def known(u: np.ndarray) -> np.ndarray:
            matrix, rate = np.zeros(u.shape[:-1] + (n, 4)), np.abs(u[..., 1])
            matrix[..., [_V, _R, _PSI], 0] = B(u)[..., 0]
            lost = 1.0 - np.interp(rate, turns.yaw_rate, kept)
            matrix[..., _U, 3] = lost * np.interp(rate, turns.yaw_rate, turns.speed)
            return matrix

        return moving, known, carried


def _yaw_rate(dt: float, state: np.ndarray, forcing: np.ndarray) -> np.ndarray:
    """The yaw rate with what waves do to it over the step ``(..., 1)``."""
    return state[..., _R : _R + 1] + forcing[..., :1] / dt
