"""Dubins paths: shortest paths of bounded curvature, also round circular obstacles.

Poses are (x, y, theta) [m, m, rad], with theta from +x towards +y. A word such as LSR names the
segments of a path. L is an arc on which theta increases, S a straight, and R an arc on which theta
decreases. With x north and y east, theta is a heading clockwise from north, and L turns to
starboard.
"""

from vessel_gym.guidance.planner import NoPath, approach, plan
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
