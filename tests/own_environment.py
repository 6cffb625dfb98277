"""Runs a script in a virtual environment of its own, with the packages that its head pins.

Packages whose pins conflict with ours are compared this way. A script names its packages by
inline script metadata (https://packaging.python.org/specifications/inline-script-metadata), so
``pipx run`` and ``uv run`` can run it, too. It imports this project from its sources.
"""

import fcntl
import hashlib
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
ENVIRONMENTS = ROOT / ".environments"
_HEAD = re.compile(r"(?m)^# /// script$\n(?P<lines>(?:^#(?: .*)?$\n)+?)^# ///$")
_THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def packages(script: Path) -> list[str]:
    """Requirements in the head of a script.

    Raises:
        ValueError: if the script has no such head.
    """
    head = _HEAD.search(script.read_text())
    if head is None:
        raise ValueError(f"{script} needs a head '# /// script' with its dependencies")
    lines = [line[2:] for line in head["lines"].splitlines()]
    return list(tomllib.loads("\n".join(lines))["dependencies"])


def interpreter(requirements: list[str], python: str = sys.executable) -> Path:
    """A Python's own environment with these packages, installed when first asked for."""
    key = hashlib.sha256("\n".join([python, *requirements]).encode()).hexdigest()[:12]
    folder = ENVIRONMENTS / key
    own, installed = folder / "bin" / "python", folder / "installed.txt"
    ENVIRONMENTS.mkdir(exist_ok=True)
    with (ENVIRONMENTS / f"{key}.lock").open("w") as lock:  # tests run side by side
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not installed.exists():
            subprocess.run([python, "-m", "venv", "--clear", folder], check=True)
            # torch first and alone, so that its pinned build stays for what wants any torch
            torch = [name for name in requirements if re.match(r"torch\b(?!-)", name)]
            for names in filter(None, (torch, requirements)):
                subprocess.run([own, "-m", "pip", "install", "-q", *names], check=True)
            installed.write_text("\n".join(requirements))
    return own


def run_script(script: Path, *arguments: str, timeout: float) -> str:
    """What a script prints in its own environment.

    Raises:
        RuntimeError: with all that was printed, if the script fails.
        subprocess.TimeoutExpired: after ``timeout`` seconds.
    """
    python = interpreter(packages(script))
    done = subprocess.run(
        [python, "-W", "ignore", script, *arguments],
        cwd=ROOT,
        env=os.environ | _THREADS | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    if done.returncode:
        raise RuntimeError(f"{script.name} failed:\n{done.stdout}\n{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    python = interpreter(packages(script := Path(sys.argv[1]).resolve()))
    os.execve(
        python, [python, script, *sys.argv[2:]], os.environ | _THREADS | {"PYTHONPATH": str(ROOT)}
    )
