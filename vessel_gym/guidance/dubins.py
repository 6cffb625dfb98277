"""Dubins paths: shortest paths of bounded curvature between poses, and short ones round circular obstacles.

Poses are (x, y, theta) [m, m, rad], theta from +x towards +y; L turns theta up. In a frame of x
north and y east theta is a heading clockwise from north, and L turns to starboard.
"""

from vessel_gym.guidance.detours import NoPath, approach, plan
from vessel_gym.guidance.words import WORDS, Path, candidates, lengths, shortest, word_path

__all__ = [
    "WORDS",
    "NoPath",
    "Path",
    "approach",
    "candidates",
    "lengths",
    "plan",
    "shortest",
    "word_path",
]
