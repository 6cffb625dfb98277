"""Controllers that follow a turning circle trial, whose action is the rudder angle."""

from typing import Any

import numpy as np

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import task_of
from agents.controllers.turning import TurningAutopilot, TurningPID, TurningRegulator
from vessel_gym.system import System
from vessel_gym.tasks.turning_trial import TurningTrial
from vessel_gym.vehicles.corvette import steady_turns


class _ByAngle:
    """The rudder angle after a step, for a controller that gives the rudder rate over it."""

    _task: Any
    _ship: Any

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder angle ``(B, 1)`` as a share of its limit."""
        turn = self._ship.rudder_rate * self._task.dt / self._ship.rudder_limit
        angle = observations[:, 4:5] + turn * super().act(observations)  # type: ignore[misc]
        return np.clip(angle, -1.0, 1.0).astype(np.float32)


@register_controller(TurningTrial, AUTOPILOT)
class TrialAutopilot(_ByAngle, TurningAutopilot):
    """`TurningAutopilot` for a rudder that is given as an angle."""


@register_controller(TurningTrial, "lqg")
class TrialRegulator(_ByAngle, TurningRegulator):
    """`TurningRegulator` for a rudder that is given as an angle."""


@register_controller(TurningTrial, "pid")
class TrialPID(_ByAngle, TurningPID):
    """`TurningPID` for a rudder that is given as an angle, with the rudder that the steady turn needs added."""

    def _ahead(self, observations: np.ndarray) -> np.ndarray:
        turns, rate = steady_turns(self._ship), self._task.command_scale * observations[:, 5]
        return np.copysign(np.interp(np.abs(rate), turns.yaw_rate, turns.rudder), rate)


@register_controller(TurningTrial, "constant-rudder")
class ConstantRudder:
    """The rudder of the trial, whatever is observed.

    Args:
        system: The environment's system.
        angle: Rudder angle [rad]; None: that of the trial. The thesis prints 35 degrees.
    """

    def __init__(self, system: System, angle: float | None = None) -> None:
        task = task_of(system, TurningTrial, "steers turning circle trials")
        self._share = (task.helm if angle is None else angle) / task.ship.rudder_limit

    def reset(self, num_envs: int) -> None:
        """There is nothing to forget."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder angle ``(B, 1)`` as a share of its limit."""
        return np.full((len(observations), 1), self._share, np.float32)
