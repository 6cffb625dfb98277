"""Flights to time, by public names alone; run as a file it is a process that flies them with another vessel_gym.

Imports nothing of this project but the `vessel_gym` that comes first on the path: any version of it
will do.
"""

import json
import os
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np

STEPS = 64
"""Steps of a block. Versions that draw random numbers for so many at once pay for them once a block."""
LEAD = 16
"""Steps between the two starts in a scattered batch."""


class Flight:
    """Blocks of steps of one environment or a batch, under small random actions, from the same start each time.

    Args:
        env_id: Registered environment.
        rows: Size of a native batch; 0: one environment through ``gymnasium.make``.
        kind: ``"steps"`` after a reset, which is not timed; ``"scattered"``: after another one of
            half of the rows, so that their episodes have different ages; ``"resets"`` of all rows
            in place of steps.
        **options: The environment's.
    """

    def __init__(self, env_id: str, rows: int, kind: str = "steps", **options: Any) -> None:
        self.kind = kind
        self.env: Any
        if rows:
            self.env = gym.make_vec(
                env_id, num_envs=rows, vectorization_mode="vector_entry_point", **options
            )
        else:
            self.env = gym.make(env_id, **options)
        rng, space = np.random.default_rng(0), self.env.action_space
        mean = (
            0.8 if env_id == "ThesisCorvette-v0" else 0.0
        )  # her turn is lost with the rudder amidships
        self.actions = (mean + rng.uniform(-0.2, 0.2, (LEAD + STEPS, *space.shape))).astype(
            space.dtype
        )
        self.half = np.arange(max(rows, 1)) % 2 == 0

    def prepare(self) -> None:
        """Prepare a block; this is not timed."""
        if self.kind != "resets":
            self.env.reset(seed=0)
        if self.kind == "scattered":
            for action in self.actions[:LEAD]:
                self.env.step(action)
            self.env.reset(options={"reset_mask": self.half})

    def fly(self) -> float:
        """The seconds of a block."""
        start = time.perf_counter()
        if self.kind == "resets":
            self.env.reset(seed=0)
        else:
            for action in self.actions[LEAD:]:
                self.env.step(action)
        return time.perf_counter() - start

    def block(self) -> float:
        """Prepare and fly one."""
        self.prepare()
        return self.fly()


def units(rows: int, kind: str = "steps", **_: Any) -> int:
    """Steps of single environments, or their resets, in a block."""
    return max(rows, 1) * (1 if kind == "resets" else STEPS)


def serve() -> None:
    """Answer lines of JSON: "where" by the package's path, a flight by its number, a number by a block's seconds."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what anybody else prints goes there
    flights: list[Flight] = []
    for line in sys.stdin:
        asked = json.loads(line)
        answer: Any
        try:
            import vessel_gym

            if asked == "where":
                answer = vessel_gym.__file__
            elif isinstance(asked, dict):
                flights.append(Flight(**asked))
                answer = len(flights) - 1
            else:
                answer = flights[asked].block()
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    serve()
