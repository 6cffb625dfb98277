"""Agents that steer on estimates, and the means to train and score them.

torch and stable-baselines3 are imported only when a PPO agent is trained or loaded.
"""

from agents.agent import Agent, RandomAgent, load_agent
from agents.autopilot import TurningAutopilot
from agents.rollouts import Rollout, rollout

__all__ = ["Agent", "RandomAgent", "Rollout", "TurningAutopilot", "load_agent", "rollout"]
