"""Vehicles: equations of motion, parameters with their sources, actuators, and filters' models.

They may import sensors, processes and `estimators`; disturbances of a ship, filter models and tasks
import them.
"""
