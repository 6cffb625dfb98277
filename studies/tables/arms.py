"""Arms of the comparisons in the documentation's tables: an estimator in a world, flown by a controller."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents import rollout
from agents.metrics import scores
from agents.seeds import evaluation_seeds

EPISODES = 100


@dataclass(frozen=True)
class Arm:
    """An estimator and the world in which it is flown; an estimator of None is the environment's own."""

    label: str
    estimator: str | None
    options: dict[str, Any] = field(default_factory=dict)
    world: dict[str, Any] = field(default_factory=dict)

    def fly(
        self, env_id: str, episodes: int = EPISODES, agent: str = "autopilot", **world: Any
    ) -> Any:
        """Rollout of the evaluation seeds; ``world`` holds further options of the environment."""
        chosen = {} if self.estimator is None else {"estimator": self.estimator}
        settings = chosen | {"estimator_options": self.options} | self.world | world
        return rollout(agent, env_id, evaluation_seeds(episodes), settings)

    def scores(self, env_id: str, episodes: int = EPISODES, **world: Any) -> dict[str, np.ndarray]:
        """Metrics of that rollout by name, one number an episode ``(episodes,)``."""
        return scores(self.fly(env_id, episodes, **world))
