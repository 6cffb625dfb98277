"""The recipe with Capytaine as it stands: a Wigley hull against strip theory."""

# /// script
# dependencies = [
#     "capytaine==3.0.0", "gymnasium==1.4.0", "llvmlite==0.50.0", "numpy==2.4.6", "scipy==1.17.1",
# ]
# ///

import re
from pathlib import Path
from typing import Any

import numpy as np

from vessel_gym.vehicles.seakeeping import StripTheory

PAGE = Path(__file__).parents[2] / "docs/recipes/capytaine.md"

if __name__ == "__main__":
    names: dict[str, Any] = {}
    for code in re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S):
        exec(compile(code, str(PAGE), "exec"), names)
    assert len(names["ratio"]) == 10
    assert np.abs(names["ratio"] - 1.0).max() < 0.1  # RMS yaw rates
    ship, direction = names["strip_theory"].ship, names["direction"][[3, 13]]
    motion = np.stack([names[each][0, [3, 13]] for each in ("sway", "yaw", "roll")], -1)
    # sizes and phases in waves fifteen ship lengths long
    expected = StripTheory(ship).motion(names["frequency"][:1], direction, 0.0)
    assert np.abs(motion / expected - 1.0).max() < 0.06
    names["env"].reset(seed=0)
    for _ in range(5):
        names["env"].step(np.zeros(1))
