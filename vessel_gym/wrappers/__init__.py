"""Wrappers that put an estimator into the loop of any Gymnasium environment.

They may import the loop, sensors and `estimators`; no other folder of the package imports them.
"""

from vessel_gym.wrappers.estimated import EstimatedObservation
from vessel_gym.wrappers.simulation import simulator

__all__ = ["EstimatedObservation", "simulator"]
