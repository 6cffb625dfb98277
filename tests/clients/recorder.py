"""What really happened in the environments below a learner, and checks of what it stored of it."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np

import vessel_gym  # noqa: F401  (registers the environments)
from vessel_gym.simulation.core import Core

ENVIRONMENTS = {"SigmaCorvette-v0": 105, "ItsunusaAUV-v0": 90}
"""Environments and time limits within which random actions end episodes early or in time."""
SEED, ROWS, STEPS = 7, 2, 500
Arrays = dict[str, np.ndarray]


class Record:
    """Episodes of all environments, noted in the core, where no autoreset mode reaches.

    Args:
        env_id: The environment, which the learner makes with ``max_episode_steps=limit``.
    """

    def __init__(self, env_id: str) -> None:
        self.env_id, self.limit = env_id, ENVIRONMENTS[env_id]
        self.rows: dict[tuple[Core, int], list[Any]] = {}
        self._start, self._advance = Core.start, Core.advance

    def __enter__(self) -> "Record":
        def start(core: Core, seed: Any = None, options: Any = None, rows: Any = None) -> Any:
            started = self._start(core, seed, options, rows)
            for row in range(core.num_envs) if rows is None else rows:
                episode = SimpleNamespace(first=core.observe()[row], steps=[])
                episode.number = core.now.episode[row]
                self.rows.setdefault((core, int(row)), []).append(episode)
            return started

        def advance(
            core: Core, action: Any, shape: Any, ended: Any = None,
            info: bool = True,
        ) -> Any:  # fmt: skip
            before = core.observe()
            made = self._advance(core, action, shape, ended, info)
            now, after = core.now, core.observe()
            actions = np.reshape(action, core.action_shape).clip(-1.0, 1.0)
            for row in range(core.num_envs) if ended is None else np.flatnonzero(~ended):
                happened = {"observation": before[row], "next_observation": after[row]}
                happened |= {"action": actions[row], "reward": now.reward[row]}
                happened |= {"terminated": now.end[row] > 0}
                happened["truncated"] = now.steps[row] >= self.limit and not now.end[row]
                self.rows[core, int(row)][-1].steps.append(happened)
            return made

        Core.start, Core.advance = start, advance
        return self

    def __exit__(self, *_: object) -> None:
        Core.start, Core.advance = self._start, self._advance

    def played(self) -> list[list[Any]]:
        """Episodes of each row that moved, from the first in which it did."""
        moved = [[bool(each.steps) for each in row] for row in self.rows.values()]
        return [
            row[steps.index(True) :]
            for row, steps in zip(self.rows.values(), moved, strict=True)
            if any(steps)
        ]

    def rows_happened(self) -> list[Arrays]:
        """Transitions of each row that moved, each array ``(T, ...)``."""
        rows = [[step for each in row for step in each.steps] for row in self.played()]
        return [{name: np.array([step[name] for step in row]) for name in row[0]} for row in rows]

    def happened(self) -> Arrays:
        """Transitions of rows that moved equally often, each array ``(T, B, ...)``."""
        rows = self.rows_happened()
        return {name: np.stack([row[name] for row in rows], 1) for name in rows[0]}

    def check(self, seeds: list[int], stored: Arrays | list[Arrays]) -> None:
        """Compare what a learner stored with what happened, and print the counts.

        Args:
            seeds: Those that the rows should have.
            stored: Arrays ``(T, B, ...)``, or those ``(T, ...)`` of each row.

        Raises:
            AssertionError: if a transition is missing, differs or never happened; if an episode
                was skipped, a seed did not arrive, or episodes did not end in both ways.
        """
        happened = self.rows_happened()
        if isinstance(stored, dict):
            stored = [{k: v[:, row] for k, v in stored.items()} for row in range(len(happened))]
        for kept, row in zip(stored, happened, strict=True):
            if "truncated" in kept:  # an episode that ends at its time limit has ended
                kept["truncated"] = kept["truncated"] > kept["terminated"]
            for name, values in kept.items():
                np.testing.assert_allclose(values, row[name], 1e-5, 1e-5, err_msg=name)
        for episodes, seed in zip(self.played(), seeds, strict=True):
            numbers = [each.number for each in episodes]
            assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
            assert all(each.steps for each in episodes[:-1]), "an episode was skipped"
            single = gym.make(self.env_id)
            first = single.reset(seed=seed)[0]
            for _ in range(numbers[0]):
                first = single.reset()[0]
            np.testing.assert_allclose(episodes[0].first, first, 0, 1e-6, err_msg="the seed")
        counts = {
            "transitions": sum(len(row["reward"]) for row in happened),
            "terminated": sum(row["terminated"].sum() for row in happened),
            "cut off": sum(row["truncated"].sum() for row in happened),
        }
        print(self.env_id, *(f"{count} {name}," for name, count in counts.items()), *stored[0])
        assert counts["transitions"] >= ROWS * STEPS
        assert all(counts.values()), "episodes ended in one way"


def returns(
    happened: Arrays, value: Callable[[np.ndarray], np.ndarray], gamma: float, lam: float
) -> np.ndarray:
    """TD(lambda) returns ``(T, B)`` of a rollout.

    After a time limit the value of the episode's own last observation stands for the rest.
    """
    reward, terminated = happened["reward"], happened["terminated"]
    now, following = (
        value(np.concatenate(happened[name])).reshape(reward.shape)
        for name in ("observation", "next_observation")
    )
    goes_on = ~(terminated | happened["truncated"])
    out, carried = np.zeros_like(reward), 0.0
    for t in reversed(range(len(out))):
        out[t] = reward[t] + gamma * (following[t] * ~terminated[t] + lam * goes_on[t] * carried)
        carried = out[t] - now[t]
    return out


def run(play: Callable[[Record], None]) -> None:
    """Let a learner play every environment."""
    for env_id in ENVIRONMENTS:
        with Record(env_id) as record:
            play(record)
