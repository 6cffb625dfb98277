"""Tasks: what a vehicle is asked to do, what the agent sees of it, and how it is scored.

They may import vehicles, sensors and guidance; systems and environments import them.
"""
