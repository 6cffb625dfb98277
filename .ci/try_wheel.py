"""Try an installed vessel-gym as a new user would, in an environment with nothing else: words, never a traceback.

Run from anywhere but the repository, with the Python of that environment: ``python -P
.ci/try_wheel.py``.
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
    "reproduce itsunusa": (2, r"pip install 'vessel-gym\[report\]'"),
    "ablate quik": (2, "did you mean 'quick'"),
    "watch PunaUAV-v0 --out flight.foo": (2, "the suffix must be one of"),
    "evaluate PunaUAV-v0 --episodes 1 --agent own_agent:Still": (0, "Score"),
    "wacth PunaUAV-v0": (2, "did you mean 'watch'"),
}
"""Exit status and what is said, in an environment without extras and a folder of names like ours."""
ENCODINGS = "utf-8", "ascii", "cp1252"
OWN = """
import numpy as np

class Still:
    def __init__(self, system): self.size = len(system.vehicle.action_names)
    def reset(self, num_envs): pass
    def act(self, observations): return np.zeros((len(observations), self.size), np.float32)
"""
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
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", FLIGHT], cwd=folder, check=True)
        print(
            f"Python {sys.version.split()[0]}: a vehicle moved after"
            f" {time.perf_counter() - start:.0f} s"
        )
        for name in (
            "agents.py",
            "scripts.py",
            "studies.py",
            "estimators.py",
        ):  # a user's, named like ours
            Path(folder, name).touch()
        Path(folder, "own_agent.py").write_text(OWN)
        for number, (line, (status, words)) in enumerate(CALLS.items()):
            call = [str(Path(sysconfig.get_path("scripts")) / "vessel-gym"), *line.split()]
            encoding = ENCODINGS[number % len(ENCODINGS)]
            environment = os.environ | {"PYTHONIOENCODING": encoding}
            done = subprocess.run(
                call, cwd=folder, capture_output=True, encoding=encoding, env=environment
            )
            said = done.stdout + done.stderr
            if done.returncode != status or not re.search(words, said) or "Traceback" in said:
                mistakes += 1
                print(
                    f"vessel-gym {line}: exit status {done.returncode} instead of {status},"
                    f" said:\n{said}"
                )
        done = subprocess.run(
            [sys.executable, "-c", FLIGHT], cwd=folder, capture_output=True, text=True
        )
        if not re.search(r"ImportError: .*estimators\.py is found first: rename", done.stderr):
            mistakes += 1
            print(f"import vessel_gym beside an estimators.py: said\n{done.stderr}")
    return mistakes


if __name__ == "__main__":
    sys.exit(main())
