"""Training: of agents by PPO, and of filters with a learned gain. It needs torch and stable-baselines3.

It may import policies and `estimators`; studies and commands import it.
"""
