"""Filters' models: what a filter is to know of a vehicle, a disturbance and sensors, composed to one model.

`exogenous` (what acts) < `parts` (which states there are) < `linear`, `nonlinear` < `build` (`compose`).
It may import vehicles, disturbances, sensors and `estimators`; systems, tasks and environments import it.
"""
