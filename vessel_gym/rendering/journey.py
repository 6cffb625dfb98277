"""What pictures of a vehicle on its way have in common: what happened, and how it ended."""

from typing import Any, NamedTuple

import numpy as np

from vessel_gym.core import Core
from vessel_gym.rendering.canvas import CURRENT, LIMIT, MUTED, Box, Canvas, Colour, draw_header


class Sample(NamedTuple):
    """One moment of an episode, or as columns a whole one."""

    step: np.ndarray
    truth: np.ndarray  # (n,) the vehicle's state
    estimate: np.ndarray  # (n,)
    flow: np.ndarray  # (f,) what carries it
    believed_flow: np.ndarray  # (f,)
    cov: np.ndarray  # (n + f, n + f) of what is believed of both
    action: np.ndarray  # (a,)
    actuators: np.ndarray  # (a,)
    tally: np.ndarray  # (k,) what the score remembers
    total: np.ndarray  # sum of the rewards


class Journey:
    """History of one vehicle on its way.

    Args:
        core: The environment's core.
        fix: The components of the position that readings must give to be shown as a fix; empty: none is shown.
        row: Which environment of the batch is shown.
    """

    def __init__(self, core: Core, fix: tuple[str, ...], row: int) -> None:
        self.title = core.system.name
        self._core, self._row = core, row
        self._task: Any = core.task
        self._fix = np.array([given in fix for given in core.sensors.gives])
        self._samples: list[Sample] = []
        self._fixes: list[np.ndarray] = []

    def begin(self) -> None:
        """Forget the last episode."""
        self._samples.clear()
        self._fixes.clear()

    def record(self) -> None:
        """Append the core's present state, and a fix of the position if one has come."""
        core, row = self._core, self._row
        belief, told, kicks = core.belief, core.composition, len(core.vehicle.kicks)
        both = told.state_and_flow
        self._samples.append(
            Sample(
                core.steps[row], core.state[row].copy(), belief.mean[row, : told.base].copy(),
                core.forcing[row, kicks:].copy(), told.flow(belief.mean[row]), both @ belief.cov[row] @ both.T,
                core.action[row].copy(), core.actuators[row].copy(), core.tally[row].copy(), core.total[row],
            )
        )  # fmt: skip
        readings, available = core.readings
        if self._fix.any() and available[row, self._fix].all():
            self._fixes.append(readings[row, self._fix])

    def history(self) -> Sample:
        """The episode so far, as columns."""
        return Sample(*(np.array(column) for column in zip(*self._samples, strict=True)))

    def header(self, canvas: Canvas, box: Box, missed: str) -> None:
        """Under which conditions the vehicle is on its way, for how long, and how it has ended.

        Args:
            canvas: Where to draw.
            box: There.
            missed: How far from the goal the vehicle is, in words; empty where there is no goal.
        """
        core, task = self._core, self._task
        words = (
            f"estimator {core.estimator}   ·   {core.disturbance_name} disturbance   ·   {core.sensors_name} sensors"
        )
        if core.mismatch:
            words += f"   ·   mismatch {100 * core.mismatch:g} %"
        time = f"{self._samples[-1].step * core.vehicle.dt:.1f} s"
        values = {"score": f"{core.total[self._row] / task.perfect:.3f}", "time": time}
        draw_header(canvas, box, self.title, words, values, *self._outcome(missed))

    def _outcome(self, missed: str) -> tuple[str, Colour]:
        """How the journey has ended, in words, or that it has not."""
        end, success = self._task.ends[self._core.end[self._row]], self._task.success
        if end and end == success:
            return f"{end}, {missed} from the goal" if missed else end, CURRENT
        if missed and end == "missed the goal":
            return f"{end} by {missed}", LIMIT
        if end:
            return f"lost: {end}", LIMIT
        if self._samples[-1].step >= self._task.horizon:
            return "time is up", LIMIT if success else CURRENT
        return "under way", MUTED
