"""Learned policies: their checkpoints, and those that come with the package.

They may import `vessel_gym` and, late, torch; training, agents and studies import them.
"""
