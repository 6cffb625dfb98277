"""Agents that steer on estimates, and the means to train and score them.

torch and stable-baselines3 are imported only when an agent is trained, saved or loaded.
The package may import `vessel_gym` and `estimators`; `scripts` and `studies` import it.
"""

from agents.agent import Agent, RandomAgent, load_agent
from agents.controllers import register_controller
from agents.controllers.turning import TurningAutopilot
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
    "TurningAutopilot",
    "episode",
    "load_agent",
    "register_controller",
    "register_metrics",
    "rollout",
    "save_agent",
]
