"""Disturbances: waves, gusts, turbulence, currents, winds, and faults of actuators.

They know vehicles' equations and the ground floor, and nothing of tasks, worlds or filters.
"""

from estimators.lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__)
