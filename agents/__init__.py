"""Agents that steer on estimates, and the means to train and score them.

A name is imported at its first use: the commands' ``--help`` answers at once. torch and
stable-baselines3 are imported only when an agent is trained, saved or loaded. The package may
import `vessel_gym` and `estimators`; `scripts` and `studies` import it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agents.agent import Agent, RandomAgent, load_agent
    from agents.controllers import register_controller
    from agents.episodes import Episode, episode
    from agents.metrics import Metric, register_metrics
    from agents.policies.checkpoint import save_agent
    from agents.rollouts import Rollout, rollout

__all__ = [
    "Agent",
    "Episode",
    "Metric",
    "RandomAgent",
    "Rollout",
    "episode",
    "load_agent",
    "register_controller",
    "register_metrics",
    "rollout",
    "save_agent",
]

_MODULES = (
    "controllers",
    "rollouts",
    "agent",
    "metrics",
    "policies.checkpoint",
    "episodes",
)
"""Modules of these names, in which they are looked for."""


def __getattr__(name: str) -> Any:
    for module in _MODULES if name in __all__ else ():
        if hasattr(found := import_module(f"agents.{module}"), name):
            return getattr(found, name)
    raise AttributeError(f"module 'agents' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
