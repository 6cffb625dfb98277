"""Guidance: where a vehicle should go, planned without knowing how it gets there.

It may import `estimators`; tasks import it.
"""
