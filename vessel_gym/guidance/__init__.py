"""Guidance: where a vehicle should go, planned without knowing how it gets there."""
