"""Wrappers that put an estimator into the loop of any Gymnasium environment.

They may import simulation, filters' models, sensors and `estimators`; only `agents` imports them.
"""

from vessel_gym.wrappers.estimated import EstimatedObservation

__all__ = ["EstimatedObservation"]
