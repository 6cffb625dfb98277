"""Tasks: missions, observations and scores.

They may import vehicles, sensors and guidance; systems and environments import them.
"""
