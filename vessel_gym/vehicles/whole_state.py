"""What vehicles share whose filters estimate all of their state, with their own equations of motion as the model."""

from typing import Any, ClassVar

import numpy as np


class WholeState:
    """A vehicle of which filters have one model, the nonlinear one, that leaves out nothing."""

    state_names: ClassVar[tuple[str, ...]]
    kinds: ClassVar[tuple[str, ...]] = ("nonlinear",)
    linear_kinds: ClassVar[tuple[str, ...]] = ()

    def estimated(self, kind: str) -> tuple[str, ...]:
        """All of the state."""
        return self.state_names

    def placed(self, x: np.ndarray) -> np.ndarray:
        """The state out of what filters estimate, which is the same."""
        return x

    @property
    def process_sd(self) -> np.ndarray:
        """The models leave out nothing."""
        return np.zeros(len(self.state_names))

    def known_input(self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None) -> np.ndarray:
        """The actuators at the start of a step and at its end."""
        return np.concatenate([before, after], -1)

    def linear(self, kind: str) -> tuple[Any, Any]:
        """There is none."""
        raise NotImplementedError
