"""Assumptions of filters about the world: state space, model, and the filter itself.

`state_space` < `structure`, `linear` < `assumed` < `input_conditions`, `reference_filters` <
`estimation`. The world has a state space, too. This folder may import vehicles, disturbances,
sensors and `estimators`; simulation, images, wrappers and environments import it.
"""
