"""ThesisCorvette-v0: the experiment of A. E. Hermawan's thesis (ITS Surabaya, 2020)."""

from typing import Any

import numpy as np

from estimators.engine import compiled
from vessel_gym.caching import cached
from vessel_gym.disturbances import Disturbance
from vessel_gym.models.estimation import BESIDE_BIASES
from vessel_gym.models.state_space import StateSpace
from vessel_gym.system import System
from vessel_gym.tasks.turning import TurningTrial
from vessel_gym.vehicles.corvette_thesis import ThesisCorvette


@compiled
class UnknownStep(Disturbance):
    """A step d that filters treat as an unknown input of unknown size; the task sets its time."""

    forces = inputs = ("yaw increment",)
    assumed_as = "unknown-input"
    input_sd = (1.0,)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Zeros ``(..., 1)``, because the task adds the step."""
        return np.zeros((*state.shape[:-1], 1))


def _tuning(name: str, space: StateSpace) -> dict[str, Any]:
    return {"radius": BESIDE_BIASES} if name == "robust-kf" else {}


@cached
def thesis_system(name: str, as_printed: bool = False) -> System:
    """Environment of a turning circle trial in which a step enters the measurements.

    Args:
        name: Id of the environment.
        as_printed: True for filters with eq. 4.3 as their model. No world has it: its ship would
            not turn.
    """
    vehicle = ThesisCorvette()
    return System(
        name=name,
        vehicle=vehicle,
        task=TurningTrial(vehicle.ship),
        disturbances=dict.fromkeys(("calm", "moderate", "rough"), UnknownStep()),  # without sea
        estimator="kf-umv-ui",
        filter_model="as_printed" if as_printed else "corrected",
        tuning=_tuning,
    )
