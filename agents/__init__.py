"""Agents that steer on estimates, and the means to train and score them.

torch and stable-baselines3 are imported only when an agent is trained, saved or loaded.
"""

from agents.agent import Agent, RandomAgent, load_agent
from agents.autopilot import TurningAutopilot
from agents.checkpoint import save_agent
from agents.rollouts import Rollout, rollout

__all__ = ["Agent", "RandomAgent", "Rollout", "TurningAutopilot", "load_agent", "rollout", "save_agent"]
