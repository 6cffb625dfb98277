"""Jobs of the tests, and what they compute."""

import os
import signal
import sys
from time import sleep

import numpy as np

from agents.files import replacing
from agents.jobs import Job


def job(name: str, needs: tuple[Job, ...] = (), artifact: str = "", **arguments) -> Job:
    return Job(f"job_functions:{name}", arguments, name, needs, artifact)


def study(seconds: float = 0.0, draws: int = 8) -> list[Job]:
    """Twelve jobs, or more, in two waves, three of them with artifacts."""
    written = tuple(job("write", artifact=".bin", seed=seed, seconds=seconds) for seed in range(3))
    drawn = [job("draw", seed=seed, seconds=seconds) for seed in range(draws)]
    return [*drawn, job("read", needs=written)]


def long_study() -> list[Job]:
    """44 jobs that take two seconds in all."""
    return study(0.05, draws=40)


def draw(seed, seconds=0.0):
    sleep(seconds)
    drawn = np.random.default_rng(seed).normal(size=50)
    return {"values": drawn, "seed": np.int64(seed), "nothing": float("nan")}


def write(seed, artifact, seconds=0.0):
    with replacing(artifact) as temporary:  # as a training does
        sleep(seconds)
        temporary.write_bytes(np.random.default_rng(seed).bytes(5000))
    return {"seed": seed}


def read(needs):
    return {"bytes": [path.read_bytes().hex() for path in needs]}


def fail(text):
    raise ValueError(text)


def leave():
    sys.exit("left")


def die(unless):
    """End without a word, unless there is such a file."""
    if not os.path.exists(unless):
        os.kill(os.getpid(), signal.SIGKILL)
    return {"alive": True}


def process():
    return {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}


def echo(**arguments):
    return {"arguments": arguments, "types": [type(value).__name__ for value in arguments.values()]}
