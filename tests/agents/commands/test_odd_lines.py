"""Odd command lines in any surroundings: a sentence each, or the right output."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


STILL = """
import numpy as np

class σ:
    def __init__(self, system): pass
    def reset(self, num_envs): pass
    def act(self, observations): return np.zeros((len(observations), 3), np.float32)
"""
TABLE = r"Score +0\.\d{3}"
SURROUNDINGS = {
    "utf-8": ("", {"PYTHONIOENCODING": "utf-8"}, 0, "still:σ: means.*episodes: 1.*Score"),
    "ascii": ("", {"PYTHONIOENCODING": "ascii"}, 0, r"still:\\u03c3: means.*episodes: 1.*Score"),
    "no home": ("", {"HOME": "", "XDG_CACHE_HOME": "", "TERM": ""}, 0, TABLE),
    "no folder to keep anything": ("", {"HOME": "/proc", "VESSEL_GYM_CACHE": "/proc"}, 0, TABLE),
    "a full disk": (">/dev/full", {}, 2, "No space left on device"),
    "both closed": (">&- 2>&-", {}, 0, ""),
}
"""Redirections and variables, with the exit status and a pattern of what is printed."""


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="redirections of a POSIX shell")
@pytest.mark.parametrize("surroundings", SURROUNDINGS)
def test_the_same_episodes_are_flown_in_any_surroundings(tmp_path: Path, surroundings: str):
    """In a folder with an agents and a scripts of its own, and the agent that is named."""
    for name in ("agents.py", "scripts.py"):
        (tmp_path / name).touch()
    (tmp_path / "still.py").write_text(STILL, encoding="utf-8")
    redirection, variables, status, words = SURROUNDINGS[surroundings]
    line = f"vessel_gym evaluate PunaUAV-v0 --episodes 1 --agent still:σ {redirection}"
    done = subprocess.run(
        f"'{sys.executable}' -m {line}", shell=True, cwd=tmp_path, capture_output=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | variables,
    )  # fmt: skip
    printed = (done.stdout + done.stderr).decode(variables.get("PYTHONIOENCODING", "utf-8"))
    assert (done.returncode, "Traceback" in printed) == (status, False)
    assert re.search(words, printed, re.DOTALL)
