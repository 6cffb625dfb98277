"""The state of environments without what is estimated."""

from dataclasses import dataclass, fields

import numpy as np

_ONE = np.ones(1, int)  # adding a Python number takes twice as long


@dataclass(slots=True, eq=False)
class EnvState:
    """Truth and score of B environments at one step; the next step makes a new object."""

    keys: np.ndarray  # (B, parts, 2) of the random numbers of disturbance and biases
    steps: np.ndarray  # (B,) since the episode's start
    scenario: np.ndarray  # (B, c) drawn by the task
    parameters: np.ndarray  # (B, k) of the true vehicle
    state: np.ndarray  # (B, n) of the vehicle
    action: np.ndarray  # (B, a) the last one, clipped; zero after a reset
    actuators: np.ndarray  # (B, a)
    drifting: np.ndarray  # (B, s) states of the disturbance, then of the sensors' biases
    noise: np.ndarray  # (B, w + s) of increments, disturbance and biases over the coming step
    exogenous: np.ndarray  # (B, f) exogenous input over the coming step
    ended_noise: np.ndarray  # (B, w + s) noise over the step that has ended; zeros after a reset
    ended: np.ndarray  # (B, f) exogenous input over that step; zeros after a reset
    drawn: np.ndarray  # (B, e) constants of the disturbance for the episode
    reference: np.ndarray  # (B, k)
    score_state: np.ndarray  # (B, k) score state
    total: np.ndarray  # (B,) sum of rewards
    end: np.ndarray  # (B,) number of the end reason
    observation: np.ndarray | None = None  # (B, k) if the step returns one

    def after(self, action: np.ndarray) -> "EnvState":
        """State for the next step: the coming noise and inputs become those of the ended step."""
        return EnvState(
            self.keys, self.steps + _ONE, self.scenario, self.parameters, self.state, action,
            self.actuators, self.drifting, self.noise, self.exogenous, self.noise, self.exogenous,
            self.drawn, self.reference, self.score_state, self.total, self.end,
        )  # fmt: skip

    def merged(self, rows: np.ndarray, some: "EnvState") -> "EnvState":
        """State with new values in some rows."""
        merged = {each.name: getattr(self, each.name) for each in fields(self)}
        for name, whole in merged.items():
            if whole is not None:
                merged[name] = whole.copy()
                merged[name][rows] = getattr(some, name)
        return EnvState(**merged)


def blank(rows: int) -> EnvState:
    """Placeholder state of environments before the first reset."""
    return EnvState(*(np.zeros(rows, int) for _ in fields(EnvState)[:-1]))
