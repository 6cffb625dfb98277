"""Try an installed vessel-gym as a new user would, in an environment with nothing else: words, never a traceback.

Run from anywhere but the repository, with the Python of that environment: ``python -P .ci/try_wheel.py``.
"""

import os
import re
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

CALLS = {
    "--version": (0, r"vessel-gym \d+\.\d+\.\d+"),
    "--help": (0, "usage: vessel-gym COMMAND"),
    "watch --help": (0, "usage: vessel-gym watch"),
    "evaluate PunaUAV-v0 --episodes 2": (0, "Score"),
    "watch PunaUAV-v0 --out e.html": (0, "wrote e.html"),
    "watch PunaUAV-v0 --out flight.gif": (2, r"pip install 'vessel-gym\[render\]'"),
    "train SigmaCorvette-v0": (2, r"pip install 'vessel-gym\[train\]'"),
    "ablate quick": (2, r"pip install 'vessel-gym\[report\]'"),
    "reproduce all": (2, "run this in a checkout"),
    "wacth PunaUAV-v0": (2, "did you mean 'watch'"),
}
"""Exit status and what is said, in an environment without extras."""
UTF8 = {"PYTHONUTF8": "1"}
FLIGHT = """
import gymnasium as gym
import vessel_gym
env = gym.make("PunaUAV-v0")
env.reset(seed=0)
for _ in range(10):
    env.step(env.action_space.sample())
"""


def main() -> int:
    """Try everything; returns the number of mistakes."""
    mistakes = 0
    with tempfile.TemporaryDirectory() as empty:
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", FLIGHT], cwd=empty, check=True)
        print(f"Python {sys.version.split()[0]}: a vehicle moved after {time.perf_counter() - start:.0f} s")
        for line, (status, words) in CALLS.items():
            call = [str(Path(sysconfig.get_path("scripts")) / "vessel-gym"), *line.split()]
            done = subprocess.run(call, cwd=empty, capture_output=True, encoding="utf-8", env=os.environ | UTF8)
            said = done.stdout + done.stderr
            if done.returncode != status or not re.search(words, said) or "Traceback" in said:
                mistakes += 1
                print(f"vessel-gym {line}: exit status {done.returncode} instead of {status}, said:\n{said}")
    return mistakes


if __name__ == "__main__":
    sys.exit(main())
