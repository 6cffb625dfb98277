"""Disturbances: waves, wind, currents, turbulence, and faults of actuators.

They may import vehicles, processes and `estimators`, and know no task, world or filter; filters'
models and simulation import them.
"""

from estimators.lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__)
