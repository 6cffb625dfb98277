"""Fly any agent in any environment over many seeds, and keep what is needed to score it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np

import vessel_gym  # noqa: F401  (registers the environments)
from agents.agent import Agent, load_agent
from agents.named import vector_class
from agents.refusal import Refusal
from estimators import nis
from vessel_gym import checks
from vessel_gym.checks import is_integer
from vessel_gym.envs.vector import VesselVectorEnv


@dataclass(frozen=True, eq=False, repr=False)
class Rollout:
    """One episode a seed: N episodes of at most T steps.

    Attributes:
        env_id: The environment.
        seeds: ``(N,)``.
        score: ``(N,)`` the environment's own episode score in [0, 1]; the return where it has none.
        returns: ``(N,)`` sum of rewards.
        length: ``(N,)`` steps flown.
        terminated: ``(N,)`` whether the episode ended before its time.
        end: ``(N,)`` why, in the environment's words; empty for the time limit and where it has
            none.
        history: what ``info`` held after reset and each step, ``(T + 1, N, ...)`` by key; rows
            after an episode's end repeat its last values. Beside that ``nis``: the normalised
            innovation squared, NaN where an estimator has none, and at an episode's end.
        env: The (closed) vector environment, for its system and spaces.
        scenario: ``(N, k)`` parameters of the episode that the task has drawn; None where the
            environment is not ours.
    """

    env_id: str
    seeds: np.ndarray
    score: np.ndarray
    returns: np.ndarray
    length: np.ndarray
    terminated: np.ndarray
    end: np.ndarray
    history: dict[str, np.ndarray]
    env: Any
    scenario: np.ndarray | None

    def __repr__(self) -> str:
        episodes = f"{len(self.seeds)} episode{'s' * (len(self.seeds) != 1)}"
        return (
            f"<Rollout {self.env_id}: {episodes}, mean score {self.score.mean():.3f},"
            f" {self.length.sum()} steps>"
        )

    @property
    def alive(self) -> np.ndarray:
        """Mask ``(T + 1, N)`` of the times that an episode lived through, its start and end included."""
        times = (
            next(iter(self.history.values())).shape[0]
            if self.history
            else int(self.length.max()) + 1
        )
        return np.arange(times)[:, None] <= self.length


def rollout(
    agent: Agent | str | Path,
    env_id: str,
    seeds: Sequence[int],
    env_options: dict[str, Any] | None = None,
    reset_options: dict[str, Any] | None = None,
    record: bool = True,
    progress: Callable[[int, int], None] | None = None,
    trust: bool = False,
    ensembles: bool = False,
) -> Rollout:
    """Fly one episode for each seed, all in one batch.

    Args:
        agent: An agent, or a name or path for `agents.load_agent`.
        env_id: A registered environment.
        seeds: One seed an episode; see `agents.seeds` for which to use.
        env_options: Passed to `gymnasium.make_vec`.
        reset_options: Passed to ``reset``.
        record: Keep the history of every numeric array in ``info``.
        progress: Called with (step, horizon).
        trust: See `agents.load_agent`.
        ensembles: Keep in the history the members of an estimator that has an ensemble, too; NaN at
            an episode's end.

    Raises:
        ValueError: if there is no such environment, if there are no seeds, or if the agent cannot
            fly it; as `acted`.
        TypeError: for an agent that cannot act, or arguments of another kind.
    """
    seeds = _checked(seeds, agent)
    checks.function("progress", progress, "(step, horizon)")
    env = batch(env_id, len(seeds), {} if env_options is None else env_options)
    try:
        flyer = load_agent(agent, env, trust) if isinstance(agent, str | Path) else agent
        flyer.reset(len(seeds))
        observations, info = env.reset(seed=seeds, options=reset_options)  # type: ignore[arg-type]
        core: Any = getattr(env.unwrapped, "core", None)
        scenario = None if core is None else core.scenario.copy()
        history = _History(core, info, len(seeds), ensembles) if record else None
        alive, ended = np.ones(len(seeds), bool), np.zeros(len(seeds), bool)
        returns, length = np.zeros(len(seeds)), np.zeros(len(seeds), int)
        score, end = np.full(len(seeds), np.nan), np.full(len(seeds), "", dtype=object)
        horizon = env.spec.max_episode_steps if env.spec and env.spec.max_episode_steps else 0
        while alive.any():
            observations, reward, terminated, truncated, info = env.step(
                acted(flyer, observations, env.action_space.shape)
            )
            done = (terminated | truncated) & alive
            final = info.get("final_info", {}) if done.any() else {}
            if history is not None:
                history.add(info, final, alive, done)
            returns += np.where(alive, reward, 0.0)
            length, ended = length + alive, ended | (terminated & done)
            score[done], end[done] = final.get("score", score)[done], final.get("end", end)[done]
            alive &= ~done
            if progress is not None:
                progress(int(length.max()), horizon)
    finally:
        env.close()
    score, kept = (
        np.where(np.isnan(score), returns, score),
        {} if history is None else history.arrays(),
    )
    return Rollout(env_id, np.array(seeds), score, returns, length, ended, end, kept, env, scenario)


def acted(agent: Agent, observations: np.ndarray, shape: tuple[int, ...] | None) -> np.ndarray:
    """Actions of an agent, of the shape that the environment takes, if that is an array.

    Raises:
        Refusal: for actions of another shape.
    """
    actions = agent.act(observations)
    if shape is not None and np.shape(actions) != shape:
        kind = "nothing" if actions is None else f"an array of shape {np.shape(actions)}"
        raise Refusal(
            f"act of {type(agent).__name__} returns {kind}, and must return {shape}: a row an"
            " environment"
        )
    return actions


def _checked(seeds: Any, agent: Any) -> list[int]:
    """The seeds of a rollout as a list; these and the agent are refused if they are none."""
    if isinstance(seeds, str | bytes | Mapping) or not isinstance(seeds, Iterable):
        raise TypeError(f"seeds must be a list of whole numbers, got {seeds!r}")
    seeds = list(seeds)
    if not seeds:
        raise ValueError("rollout needs at least one seed")
    for seed in seeds:
        if not (is_integer(seed) and seed >= 0):
            raise ValueError(f"seeds must be whole numbers >= 0, got {seed!r}")
    acts = all(callable(getattr(agent, method, None)) for method in ("reset", "act"))
    if not isinstance(agent, str | Path) and not acts:
        raise TypeError(
            f"an agent is a name, the path of a checkpoint, or has reset and act, got {agent!r}"
        )
    return seeds


class _History:
    """Frames of a rollout: the numeric arrays of ``info``, NIS and, if asked for, ensembles."""

    def __init__(self, core: Any, info: dict[str, Any], rows: int, ensembles: bool) -> None:
        numeric = (
            key for key, v in info.items() if isinstance(v, np.ndarray) and v.dtype != object
        )
        self._core, self._rows, self._ensembles = core, rows, ensembles
        self._frames = {key: [info[key]] for key in numeric if not key.startswith("_")}
        self._nis, self._clouds = [self._innovation()], list(self._ensemble())

    def add(
        self, info: dict[str, Any], final: dict[str, Any], alive: np.ndarray, done: np.ndarray
    ) -> None:
        """Append a step: of episodes that end now the final values, of those that have ended the last ones."""
        for key, frames in self._frames.items():
            frame = np.where(rows_like(alive, info[key]), info[key], frames[-1])
            frames.append(
                np.where(rows_like(done, frame), final[key], frame) if key in final else frame
            )
        going = alive & ~done
        self._nis.append(np.where(going, self._innovation(), np.nan))
        self._clouds += [
            np.where(rows_like(going, cloud), cloud, np.nan) for cloud in self._ensemble()
        ]

    def arrays(self) -> dict[str, np.ndarray]:
        """The history ``(T + 1, N, ...)`` by key; empty if ``info`` held no arrays."""
        special = {"nis": self._nis} if self._frames else {}
        special |= {"ensemble": self._clouds} if self._clouds else {}
        return {key: np.stack(frames) for key, frames in (self._frames | special).items()}

    def _innovation(self) -> np.ndarray:
        """Normalised innovation squared of every environment ``(N,)``; NaN where there is no innovation."""
        belief = None if self._core is None else self._core.belief
        if belief is None or belief.innovation is None or belief.innovation_cov is None:
            return np.full(self._rows, np.nan)
        return nis(
            belief.innovation, belief.innovation_cov, np.abs(belief.mean).max(-1, keepdims=True)
        )

    def _ensemble(self) -> list[np.ndarray]:
        """The members of every environment's ensemble ``(N, m, n)``; none without an ensemble."""
        wanted = (
            self._ensembles and self._core is not None and self._core.belief.ensemble is not None
        )
        return [self._core.belief.ensemble] if wanted else []


def batch(env_id: str, num_envs: int, options: dict[str, Any]) -> gym.vector.VectorEnv:
    """Our environments in their native batch; any other one by one, because native batches of others differ."""
    if not isinstance(env_id, str):
        raise TypeError(f"env_id must be the name of a registered environment, got {env_id!r}")
    if not isinstance(options, Mapping) or not all(isinstance(key, str) for key in options):
        raise TypeError(f"env_options must be a dictionary of options by name, got {options!r}")
    try:
        batch = vector_class(env_id)
    except gym.error.Error as error:
        raise ValueError(str(error)) from None
    same_step = {"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}
    if issubclass(batch, VesselVectorEnv):
        native: Any = {"vectorization_mode": "vector_entry_point", **same_step}
        env = gym.make_vec(env_id, num_envs=num_envs, **native, **options)
        if cast(VesselVectorEnv, env.unwrapped).max_episode_steps is None:
            env.close()
            raise ValueError(
                f"episodes of {env_id} may never end: register it with max_episode_steps, or give"
                " that"
            )
        return env
    return gym.make_vec(
        env_id, num_envs=num_envs, vectorization_mode="sync", vector_kwargs=same_step, **options
    )


def rows_like(rows: np.ndarray, array: np.ndarray) -> np.ndarray:
    """The mask ``rows (...)`` with as many axes as an array ``(..., k, ...)``."""
    return rows.reshape(rows.shape + (1,) * (array.ndim - rows.ndim))
