"""Episodes on several estimators, with equal waves and noise, as one page without a network.

They may import rollouts, metrics and `vessel_gym`; studies and commands import them.
"""

from agents.episodes.page import Episode
from agents.episodes.recording import episode, typical_seed

__all__ = ["Episode", "episode", "typical_seed"]
