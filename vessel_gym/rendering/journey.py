"""What pictures of a vehicle on its way have in common: what happened, and how it ended."""

from typing import Any, NamedTuple

import numpy as np

from vessel_gym.core import Core
from vessel_gym.rendering.canvas import CURRENT, LIMIT, MUTED, TEXT, Box, Canvas, Colour, draw_header, draw_icon


class Sample(NamedTuple):
    """One moment of an episode, or as columns a whole one."""

    step: np.ndarray
    truth: np.ndarray  # (n,) the vehicle's state
    estimate: np.ndarray  # (n,)
    flow: np.ndarray  # (f,) what carries it
    believed_flow: np.ndarray  # (f,)
    kicks: np.ndarray  # (k,) what changes it at the end of a step
    input_estimate: np.ndarray  # (q,) what is believed of the unknown input; NaN where the estimator has none
    cov: np.ndarray  # (n + f, n + f) of what is believed of both
    action: np.ndarray  # (a,)
    actuators: np.ndarray  # (a,)
    reference: np.ndarray  # (r,)
    tally: np.ndarray  # (k,) what the score remembers
    total: np.ndarray  # sum of the rewards

    def sd(self, component: int) -> np.ndarray:
        """Standard deviations ``(k,)`` of what is believed of a component of state and flow."""
        return np.sqrt(np.maximum(self.cov[:, component, component], 0.0))


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
        acting = core.forcing[row, : core.forces.outside].copy()
        both, d = told.state_and_flow, belief.input_mean
        believed = belief.mean[row], None if d is None else d[row]
        self._samples.append(
            Sample(
                core.steps[row], core.state[row].copy(), belief.mean[row, : told.base].copy(),
                acting[kicks:], told.flow(*believed), acting[:kicks],
                np.full(1, np.nan) if d is None else d[row].copy(),
                both @ belief.cov[row] @ both.T, core.action[row].copy(), core.actuators[row].copy(),
                core.reference[row].copy(), core.tally[row].copy(), core.total[row],
            )
        )  # fmt: skip
        readings, available = core.readings
        if self._fix.any() and available[row, self._fix].all():
            self._fixes.append(readings[row, self._fix])

    def history(self) -> Sample:
        """The episode so far, as columns."""
        return Sample(*(np.array(column) for column in zip(*self._samples, strict=True)))

    @property
    def members(self) -> np.ndarray | None:
        """The members of the ensemble ``(N, n)``, if there is one."""
        ensemble = self._core.belief.ensemble
        return None if ensemble is None else ensemble[self._row]

    def conditions(self, what: str) -> str:
        """Under which conditions the vehicle is on its way, ``what`` being what its disturbance is called."""
        core = self._core
        words = f"estimator {core.estimator}   ·   {core.disturbance_name} {what}   ·   {core.sensors_name} sensors"
        return words + (f"   ·   mismatch {100 * core.mismatch:g} %" if core.mismatch else "")

    def sheet(self, canvas: Canvas, missed: str) -> Box:
        """Begin a picture with its header: under which conditions the vehicle is on its way, for how long, and its end.

        Args:
            canvas: Where to draw.
            missed: How far from the goal the vehicle is, in words; empty where there is no goal.

        Returns:
            Where the rest belongs.
        """
        canvas.clear()
        width, height = canvas.size
        box = Box(16, 0, width - 32, 60)
        core, task = self._core, self._task
        time = f"{self._samples[-1].step * core.vehicle.dt:.1f} s"
        values = {"score": f"{core.total[self._row] / task.perfect:.3f}", "time": time}
        draw_header(canvas, box, self.title, self.conditions("disturbance"), values, *self._outcome(missed))
        return Box(16, 60, width - 32, height - 76)

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

    def legend(self, canvas: Canvas, box: Box, labels: dict[str, str], pitch: float, body: np.ndarray) -> None:
        """A card of what the marks mean, a line every ``pitch`` pixels; ``body`` as in `draw_icon`."""
        canvas.panel(box)
        for i, (kind, label) in enumerate(labels.items()):
            y = box.top + 8 + (i + 0.5) * pitch
            canvas.text(box.left + 46, y, label, TEXT, 11)
            draw_icon(canvas, kind, np.array([box.left + 25, y]), body)

    def belief_label(self, cov: np.ndarray) -> dict[str, str]:
        """What shows in a legend how sure the estimator is of the position, ``cov`` being its covariance."""
        if self.members is not None:
            return {"cloud": f"ensemble of {len(self.members)} guesses"}
        return {"ellipse": "believed position ±2σ"} if np.trace(cov) > 0.0 else {}


def deviation(direction: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Standard deviations ``(k,)`` along directions ``(k, n)`` of covariances ``(k, n, n)``."""
    return np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", direction, cov, direction), 0.0))
