"""Training of agents by algorithms of stable-baselines3, which needs torch.

It may import policies, environments and `estimators`; studies and commands import it.
"""
