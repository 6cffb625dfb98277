"""The corvette with few grades of two sensors: a small case for a search of the cheapest suite."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym

from estimators.engine import compiled
from vessel_gym.envs import SigmaCorvetteEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.vehicles.ship import Ship


@compiled
@dataclass(frozen=True)
class FewGrades(Ship):
    """The ship with grades of receiver and compass."""

    grades: ClassVar[Any] = Path(__file__).with_suffix(".toml")


class FewGradesVectorEnv(VesselVectorEnv):
    """Its batch, whose episodes are short."""

    system = replace(
        SigmaCorvetteEnv.system,
        name="FewGrades-v0",
        vehicle=FewGrades(SigmaCorvetteEnv.system.vehicle.ship, SigmaCorvetteEnv.system.vehicle.dt),
    )


gym.register("FewGrades-v0", vector_entry_point=FewGradesVectorEnv, max_episode_steps=120)
