"""Filters' models, composed of a vehicle, a disturbance and sensors.

`exogenous` (inputs that act) < `parts` (states) < `linear`, `nonlinear` < `build` (`compose`). This
folder may import vehicles, disturbances, sensors and `estimators`; systems, tasks and environments
import it.
"""
