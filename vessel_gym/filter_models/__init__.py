"""Filters' models, composed of a vehicle, a disturbance and sensors.

`exogenous` (what acts) < `parts` (which states there are) < `linear`, `nonlinear` < `build`
(`compose`). It may import vehicles, disturbances, sensors and `estimators`; systems, tasks and
environments import it.
"""
