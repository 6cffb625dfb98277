"""Training of agents by PPO. It needs torch and stable-baselines3.

It may import policies and `estimators`; studies and commands import it.
"""
