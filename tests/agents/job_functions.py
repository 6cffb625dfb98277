"""What the jobs of the tests compute."""

import errno
import os
import signal
import sys
import time

import numpy as np

from agents.files import replacing


def draw(seed, seconds=0.0):
    time.sleep(seconds)
    return {
        "values": np.random.default_rng(seed).normal(size=50),
        "seed": seed,
        "nothing": float("nan"),
    }


def write(seed, artifact, seconds=0.0):
    with replacing(artifact) as temporary, temporary.open("wb") as file:  # as a training does
        for block in np.random.default_rng(seed).bytes(5000), b"the end":
            file.write(block)
            file.flush()
            time.sleep(seconds / 2)
    return {"size": artifact.stat().st_size}


def read(needs):
    return {"bytes": [path.read_bytes().hex() for path in needs]}


def fail(text):
    raise ValueError(text)


def leave():
    sys.exit("left")


def die(beside=None):
    """End without a word; the first time only, if there is a file to remember it by."""
    if beside is None or not os.path.exists(beside):
        if beside is not None:
            open(beside, "x").close()
        os.kill(os.getpid(), signal.SIGKILL)
    return {"alive": True}


def fill():
    """What a library makes of a full disk."""
    try:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    except OSError as error:
        raise RuntimeError("cannot write the archive") from error


def threads():
    return {
        name: os.environ.get(name)
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    }


def process(number):
    time.sleep(0.2)  # so that every process gets one
    return {"process": os.getpid()}


def echo(**arguments):
    return {"arguments": arguments, "types": [type(value).__name__ for value in arguments.values()]}


def nothing():
    return None


def loaded(modules):
    return {name: name in sys.modules for name in modules}


_kept: list[bytes] = []


def grown(megabytes: int) -> int:
    """The number of the process, which keeps so much more memory; it takes as long as loky waits for its next look."""
    _kept.append(b"x" * (megabytes * 1_000_000))
    time.sleep(1.1)
    return os.getpid()
