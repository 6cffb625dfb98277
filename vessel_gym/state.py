"""The state of environments: all that a step changes but for what is estimated."""

from dataclasses import dataclass, fields

import numpy as np

_ONE = np.ones(1, int)  # a number of Python's takes twice as long to add


@dataclass(slots=True, eq=False)
class EnvState:
    """Truth and score of B environments at one step; the next step makes another one."""

    keys: np.ndarray  # (B, parts, 2) of the random numbers of disturbance and biases
    steps: np.ndarray  # (B,) since the episode's start
    scenario: np.ndarray  # (B, c) drawn by the task
    parameters: np.ndarray  # (B, k) of the true vehicle
    state: np.ndarray  # (B, n) of the vehicle
    action: np.ndarray  # (B, a) the last one, clipped; zero after a reset
    actuators: np.ndarray  # (B, a)
    drifting: np.ndarray  # (B, s) states of the disturbance, then of the sensors' biases
    noise: np.ndarray  # (B, w + s) new in increments, disturbance and biases over the coming step
    exogenous: np.ndarray  # (B, f) exogenous input over the coming step
    ended_noise: np.ndarray  # (B, w + s) what was new over the step that has ended,
    ended: np.ndarray  # (B, f) and the exogenous input then; zeros after a reset
    drawn: np.ndarray  # (B, e) constants of the disturbance for the episode
    reference: np.ndarray  # (B, k)
    score_state: np.ndarray  # (B, k) score state
    total: np.ndarray  # (B,) sum of rewards
    end: np.ndarray  # (B,) number in the task's ends
    observation: np.ndarray | None = None  # (B, k) where the step gives it

    def after(self, action: np.ndarray) -> "EnvState":
        """The state a step later, in which what was coming has ended, and the rest is as it was."""
        return EnvState(
            self.keys, self.steps + _ONE, self.scenario, self.parameters, self.state, action, self.actuators,
            self.drifting, self.noise, self.exogenous, self.noise, self.exogenous, self.drawn, self.reference,
            self.score_state, self.total, self.end,
        )  # fmt: skip

    def merged(self, rows: np.ndarray, some: "EnvState") -> "EnvState":
        """The state with new values of some rows."""
        merged = {each.name: getattr(self, each.name) for each in fields(self)}
        for name, whole in merged.items():
            if whole is not None:
                merged[name] = whole.copy()
                merged[name][rows] = getattr(some, name)
        return EnvState(**merged)


def blank(rows: int) -> EnvState:
    """The state of environments that were never reset: nothing has begun."""
    return EnvState(*(np.zeros(rows, int) for _ in fields(EnvState)[:-1]))
