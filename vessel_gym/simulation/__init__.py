"""The step: a record of B environments, and the parts that fill it in.

`core` has `step`, `reset` and `observe`; the world knows no task and no filter, and filters do not
read the truth. This folder may import vehicles, disturbances, sensors, tasks and filters' models;
environments, wrappers and images import it.
"""
