"""Episodes with several estimators and equal waves and noise, as one page that works offline.

They may import rollouts, metrics and `vessel_gym`; studies and commands import them.
"""

from agents.episodes.page import Episode
from agents.episodes.recording import episode, typical_seed

__all__ = ["Episode", "episode", "typical_seed"]
