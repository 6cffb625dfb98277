"""Guidance: planned paths, and positions relative to them.

This folder may import `estimators`; tasks and images import it.
"""
