"""The record of environments, and stages: functions that fill in some of its arrays.

A step makes a new record from the last one, and each stage of the step fills in its arrays. What
no step changes is in `vessel_gym.simulation.configuration.Configuration`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from types import SimpleNamespace
from typing import Any

import numpy as np

from estimators.engine import Compiled

Changes = dict[str, Any]
"""Arrays that a stage fills in, by name."""
_OF_EVERY_BELIEF = tuple(
    f"belief.{name}" for name in ("mean", "cov", "healthy", "input_mean", "input_cov")
)
_ONE = np.ones(1, int)  # adding a Python number takes twice as long


@dataclass(eq=False)
class State:
    """B environments after a step: random numbers, truth, measurements, belief, mission.

    A field without a use is None: ``transit`` without late sensors, ``faults`` without sensors with
    faults, ``raw`` without guidance from raw measurements, ``observation`` where a step gives none,
    and the numbers of a start after the start.
    """

    # --- the episode
    episode: Any = None  # (B,) its number since the environment was seeded
    over: Any = None  # (B,) mask of episodes that have ended and are not yet reset
    steps: Any = None  # (B,) since the episode's start
    keys: Any = None  # (B, parts, 2) of the random numbers of disturbance and biases
    sensing: Any = None  # (B, sensors, 2) of the sensors
    filtering: Any = None  # (B, 2) of the filter
    scenario: Any = None  # (B, c) drawn by the task
    parameters: Any = None  # (B, k) of the true vehicle
    episode_constants: Any = None  # (B, e) of the disturbance
    # --- the numbers of its start
    prior_mean: Any = None  # (B, n) of the vehicle's state
    prior_root: Any = None  # (B, n, n) root of its covariance
    prior_normals: Any = None  # (B, n)
    slow_normals: Any = None  # (B, s') of disturbance and biases
    constant_uniforms: Any = None  # (B, k) of the disturbance's constants
    # --- the truth
    state: Any = None  # (B, n) of the vehicle
    actuators: Any = None  # (B, a)
    slow: Any = None  # (B, s) states of the disturbance, then of the sensors' biases
    noise: Any = None  # (B, w + s) of increments, disturbance and biases over the coming step
    exogenous: Any = None  # (B, f) exogenous input over the coming step
    noise_before: Any = None  # (B, w + s) over the step that has ended; zeros after a reset
    exogenous_before: Any = None  # (B, f) over the step that has ended; zeros after a reset
    # --- what filters get
    u: Any = None  # (B, m) known input over the step that has ended
    y: Any = None  # (B, p) measurements: the youngest that arrived, 0 where none did
    available: Any = None  # (B, p) mask of those that arrived
    arrived: Any = None  # with late sensors, all that arrived and its mask, (B, ages, p) each
    transit: Any = None  # measurements by age, (B, ages, p), and their mask
    faults: Any = None  # see `vessel_gym.simulation.loop.Delivery`
    # --- what they believe
    belief: Any = None  # of the estimator
    raw: Any = None  # of the estimator "measurement", for guidance from raw measurements
    # --- the mission
    action: Any = None  # (B, a) the last one, clipped; zero after a reset
    reference: Any = None  # (B, k)
    commanded: Any = None  # (B, c) commands over the coming step; None for a task without any
    imposed: Any = None  # (B, f') the task's addition to increments and flows of the coming step
    score_state: Any = None  # (B, k)
    reward: Any = None  # (B,)
    total: Any = None  # (B,) sum of rewards
    end: Any = None  # (B,) number of the end reason
    observation: Any = None  # (B, k)

    def end_of(self, row: int) -> int:
        """Number of the end reason of one environment."""
        return int(self.end[row])

    def but(self, **changes: Any) -> "State":
        """A record with other values in some fields."""
        other = object.__new__(State)
        other.__dict__ = vars(self) | changes
        return other

    def acted(self, action: np.ndarray) -> "State":
        """The record at the beginning of the next step, which an action ``(B, a)`` begins."""
        return self.but(
            action=action, steps=self.steps + _ONE, noise_before=self.noise,
            exogenous_before=self.exogenous,
        )  # fmt: skip

    def without_start(self) -> "State":
        """The record without the numbers of a start, which no step reads."""
        return self.but(
            prior_mean=None, prior_root=None, prior_normals=None, slow_normals=None,
            constant_uniforms=None,
        )  # fmt: skip

    def take(self, rows: np.ndarray) -> "State":
        """The record of the environments of some indices ``(B',)``."""
        return State(**{name: _taken(value, rows) for name, value in vars(self).items()})

    def merged(self, rows: np.ndarray, some: "State") -> "State":
        """The record with the values of another one in the rows of some indices."""
        pairs = ((name, value, getattr(some, name)) for name, value in vars(self).items())
        return State(**{name: _merged(rows, value, new) for name, value, new in pairs})


def _taken(value: Any, rows: np.ndarray) -> Any:
    """Rows of a field."""
    if isinstance(value, tuple):
        return tuple(_taken(each, rows) for each in value)
    return None if value is None else value[rows]


def _merged(rows: np.ndarray, whole: Any, some: Any) -> Any:
    """A field with new values in some rows."""
    if whole is None:
        return None
    if isinstance(whole, tuple):
        return tuple(_merged(rows, *each) for each in zip(whole, some, strict=True))
    if not isinstance(whole, np.ndarray):
        mask = np.zeros(len(whole.mean), bool)
        mask[rows] = True
        return whole.with_rows(mask, some)
    return in_rows(whole, rows, some)


def in_rows(array: np.ndarray, rows: np.ndarray, new: Any) -> np.ndarray:
    """An array with new values in the rows of some indices."""
    changed = array.copy()
    changed[rows] = new
    return changed


class Stage:
    """A part of a step: a function of the record that returns the arrays that it fills in.

    Args:
        function: Function of a `State`.
        compiled: Is it compiled? The record then has the fields that it has at the first call.
        own: Number of last arrays that are the caller's own, if it is compiled.
    """

    def __init__(self, function: Callable[[State], Changes], compiled: bool, own: int = 0) -> None:
        self.function, self.compiled, self._own = function, compiled, own
        self._read: Any = None

    def __call__(self, now: State) -> None:
        """Fill in the arrays."""
        vars(now).update(self.changes(now))

    def changes(self, now: State) -> Changes:
        """The arrays."""
        if not self.compiled:
            return self.function(now)
        if self._read is None:
            self._compile(now)
        found = self._program(*self._read(now))
        return dict(zip(self._program.names, found, strict=True))

    def _compile(self, now: State) -> None:
        """Make a program of the record's arrays; environments share it whose filters differ."""
        arrays = arrays_of(now).items()
        held = {k: a for k, a in arrays if "." not in k or k in _OF_EVERY_BELIEF}

        def function(*tracers: Any) -> Changes:
            fields, belief = apart(dict(zip(held, tracers, strict=True)))
            belief = {"input_mean": None, "input_cov": None} | belief
            return self.function(State(**fields, belief=SimpleNamespace(**belief)))

        axes = [a.ndim - 1 for a in held.values()]
        self._program = Compiled(function, axes, sealed=True, own=self._own)
        self._read = attrgetter(*held)


def in_turn(*stages: Stage) -> Stage:
    """Stages one after another as one, which is one program if all of them are compiled."""
    compiled = all(stage.compiled for stage in stages)

    def function(now: State) -> Changes:
        changes: Changes = {}
        for stage in stages:
            run = stage.function if compiled else stage.changes
            changes |= run(now.but(**changes))
        return changes

    return Stage(function, compiled)


def arrays_of(now: State) -> dict[str, np.ndarray]:
    """Arrays of a record and, as "belief.mean" and others, of its belief."""
    names = () if now.belief is None else now.belief.names()
    fields = vars(now) | {f"belief.{name}": getattr(now.belief, name) for name in names}
    return {name: each for name, each in fields.items() if isinstance(each, np.ndarray)}


def apart(arrays: Changes) -> tuple[Changes, Changes]:
    """Arrays of a record, and of its belief."""
    belief = {name: each for name, each in arrays.items() if name.startswith("belief.")}
    fields = {name: each for name, each in arrays.items() if name not in belief}
    return fields, {name.partition(".")[2]: each for name, each in belief.items()}
