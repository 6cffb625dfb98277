"""Vehicles: equations of motion, parameters with their sources, and actuators.

They may import sensors, processes and `estimators`; disturbances, filters' models and tasks import
them.
"""
