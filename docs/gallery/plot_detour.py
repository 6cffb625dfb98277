"""
A detour
========

The shortest path with turns of at least 100 m radius, and a path round three obstacles.
"""

import matplotlib.pyplot as plt
import numpy as np

from vessel_gym.guidance.dubins import shortest
from vessel_gym.guidance.planner import plan

start, goal, radius = [0.0, 0.0, 0.0], [600.0, 200.0, np.pi / 2], 100.0
obstacles = [(250.0, 20.0, 60.0), (430.0, 60.0, 45.0), (520.0, 150.0, 30.0)]

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for x, y, size in obstacles:
    axes.add_patch(plt.Circle((x, y), size, color="0.85"))
for name, path in (
    ("shortest", shortest(start, goal, radius)),
    ("round the obstacles", plan(start, goal, radius, obstacles)),
):
    axes.plot(*path.sample(spacing=2.0).T[:2], label=f"{name}: {path.length:.0f} m")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.legend(loc="upper left")
plt.show()
