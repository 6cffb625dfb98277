"""Tasks: missions, observations and scores.

They may import vehicles, sensors and guidance; simulation, images and environments import them.
"""
