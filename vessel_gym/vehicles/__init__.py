"""Vehicles: compiled equations of motion, sourced parameters and the models that filters use."""
