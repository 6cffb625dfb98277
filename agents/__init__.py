"""Agents that steer on estimates, and the means to train and score them.

A name is imported at its first use: the commands' ``--help`` answers at once. torch and
stable-baselines3 are imported only when an agent is trained, saved or loaded. The package may
import `vessel_gym` and `estimators`; `scripts` and `studies` import it.
"""

from estimators.lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__)
