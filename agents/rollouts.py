"""Fly any agent in any environment over many seeds, and keep what is needed to score it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import vessel_gym  # noqa: F401  (registers the environments)
from agents.agent import Agent, load_agent
from agents.named import vector_class
from agents.refusal import Refusal
from agents.wrapped import core_of
from estimators.checks import short_repr
from vessel_gym import checks
from vessel_gym.checks import is_integer
from vessel_gym.envs.vector import VesselVectorEnv

Arrays = dict[str, np.ndarray]
"""Arrays with a row for each episode, by their key in ``info``."""


@dataclass(frozen=True, eq=False, repr=False)
class Rollout:
    """One episode for each seed: N episodes of at most T steps.

    Attributes:
        env_id: The environment.
        seeds: ``(N,)``.
        score: ``(N,)`` the environment's own episode score in [0, 1]; the return where it has none.
        returns: ``(N,)`` sum of rewards.
        length: ``(N,)`` number of steps.
        terminated: ``(N,)`` mask of the episodes that ended before the time limit.
        end: ``(N,)`` end reason of the environment; empty for the time limit, and for an
            environment without end reasons.
        history: arrays of ``info`` after reset and each step, ``(T + 1, N, ...)`` by key; rows
            after an episode's end repeat its last values. ``input_covariance (T + 1, N, q, q)`` is
            that of ``input_estimate``, at an episode's end of the step before; without it for a
            filter that estimates no unknown input.
        env: The (closed) vector environment, for its system and spaces.
        scenario: ``(N, k)`` scenarios that the task has drawn; None for an environment of another
            package.
        constants: ``(N, e)`` constants that the disturbance has drawn; None for such an
            environment.
    """

    env_id: str
    seeds: np.ndarray
    score: np.ndarray
    returns: np.ndarray
    length: np.ndarray
    terminated: np.ndarray
    end: np.ndarray
    history: Arrays
    env: Any
    scenario: Any
    constants: Any

    @cached_property
    def core(self) -> Any:
        """The environment's `Core`, or the substitute that `core_of` returns."""
        return core_of(self.env)

    @property
    def config(self) -> Any:
        """The environment's `Configuration`, or its substitute."""
        return self.core.config

    @property
    def alive(self) -> np.ndarray:
        """Mask ``(T + 1, N)`` of the times up to an episode's end, which is included."""
        return np.arange(self.length.max() + 1)[:, None] <= self.length


def rollout(
    agent: Agent | str | Path,
    env_id: str,
    seeds: Sequence[int],
    env_options: dict[str, Any] | None = None,
    reset_options: dict[str, Any] | None = None,
    record: bool = True,
    ensembles: bool = False,
) -> Rollout:
    """Run one episode for each seed, all in one batch.

    Args:
        agent: An agent, or a name or path for `agents.load_agent`.
        env_id: A registered environment.
        seeds: A seed for each episode; `agents.seeds` has seeds that no training uses.
        env_options: Passed to `gymnasium.make_vec`.
        reset_options: Passed to ``reset``.
        record: Keep the history of every numeric array in ``info``.
        ensembles: Keep the members of an ensemble estimator in the history, too; they are NaN at an
            episode's end.

    Raises:
        ValueError: if there is no such environment or no seed, if the agent cannot act in the
            environment, or if it returns actions of another shape.
        TypeError: for an agent without a method ``act``, or an argument of a wrong type.
    """
    given, seeds = seeds, list(seeds) if isinstance(seeds, Iterable) else []
    if not seeds or not all(is_integer(seed) and seed >= 0 for seed in seeds):
        raise ValueError(
            f"seeds must be a list of one or more whole numbers >= 0, got {short_repr(given)}"
        )
    if not isinstance(agent, str | Path | Agent):
        raise TypeError(
            f"an agent is a name, the path of a checkpoint, or has reset and act, got {agent!r}"
        )
    with closing(batch(env_id, len(seeds), env_options)) as env:
        flyer = load_agent(agent, env) if isinstance(agent, str | Path) else agent
        flyer.reset(len(seeds))
        start = env.reset(seed=seeds, options=reset_options)  # type: ignore[arg-type]
        core: Any = getattr(env.unwrapped, "core", None)
        scenario = core and core.now.scenario
        constants = core and core.now.episode_constants
        frame: Any = partial(_frame, core, ensembles) if record else lambda info: {}
        scored = not record and type(env).step is VesselVectorEnv.step
        step = env.step_without_info if scored else env.step  # type: ignore[attr-defined]
        flown = _flown(env, step, flyer, *start, frame)
    drawn = {"scenario": scenario, "constants": constants}
    return Rollout(env_id, np.array(seeds), env=env, **drawn, **flown)


def _flown(
    env: gym.vector.VectorEnv, step: Callable[[np.ndarray], Any], agent: Agent,
    observations: np.ndarray, info: dict[str, Any], frame: Callable[[dict[str, Any]], Arrays],
) -> dict[str, Any]:  # fmt: skip
    """Fields of a `Rollout`: one episode in each environment."""
    count, frames = env.num_envs, [frame(info)]
    last = {key: values.copy() for key, values in frames[0].items()}
    alive, ended = np.ones(count, bool), np.zeros(count, bool)
    returns, length = np.zeros(count), np.zeros(count, int)
    score, end = np.full(count, np.nan), np.full(count, "", object)
    reasons = np.array(getattr(env.unwrapped, "end_reasons", ()), object)
    while alive.any():
        action = acted(agent, observations, env.action_space.shape)
        observations, reward, terminated, truncated, info = step(action)
        returns += np.where(alive, reward, 0.0)
        length += alive
        done = (terminated | truncated) & alive
        if done.any():
            ended |= terminated & done
            final = info.get("final_info", {})
            score[done] = final.get("score", score)[done]
            if reasons.size:
                end[done] = reasons[final["end"][done]]
            for key, values in last.items():
                values[done] = final.get(key, frames[-1][key])[done]
            alive &= ~done
        frames.append(frame(info))
    return {
        "score": np.where(np.isnan(score), returns, score),
        "returns": returns,
        "length": length,
        "terminated": ended,
        "end": end,
        "history": _history(frames, last, length),
    }


def _history(frames: list[Arrays], last: Arrays, length: np.ndarray) -> Arrays:
    """History of episodes of these lengths, from the last values of each on.

    An ensemble is by then that of another episode, so there is none.
    """
    over = np.arange(len(frames))[:, None] >= length
    history = {}
    for key, ends in last.items():
        values = history[key] = np.stack([each[key] for each in frames])
        values[over] = np.nan if key == "ensemble" else np.broadcast_to(ends, values.shape)[over]
    return history


def acted(agent: Agent, observations: np.ndarray, shape: tuple[int, ...] | None) -> np.ndarray:
    """Actions of an agent, of the shape that the environment takes, if that is an array.

    Raises:
        Refusal: for actions of another shape.
    """
    actions = agent.act(observations)
    if shape is not None and np.shape(actions) != shape:
        raise Refusal(
            f"act of {type(agent).__name__} returns shape {np.shape(actions)}, and must return"
            f" {shape}: a row an environment"
        )
    return actions


def _frame(core: Any, ensembles: bool, info: dict[str, Any]) -> Arrays:
    """The numeric arrays of an ``info``, and the members of an ensemble if asked for."""
    frame = {
        key: value
        for key, value in info.items()
        if isinstance(value, np.ndarray) and value.dtype != object and not key.startswith("_")
    }
    if core and core.now.belief.input_cov is not None:
        frame["input_covariance"] = core.now.belief.input_cov
    if ensembles and core and core.now.belief.ensemble is not None:
        frame["ensemble"] = core.now.belief.ensemble
    return frame


def batch(
    env_id: str, num_envs: int, options: Mapping[str, Any] | None = None
) -> gym.vector.VectorEnv:
    """Environments in one batch: ours in the native one, any other one by one.

    Native batches of others differ from each other.

    Raises:
        ValueError: if there is no such environment, or its episodes may never end.
        TypeError: for arguments of another kind.
    """
    options = checks.options("env_options", options)
    if not isinstance(env_id, str):
        raise TypeError(f"env_id must be the name of a registered environment, got {env_id!r}")
    try:
        native = issubclass(vector_class(env_id), VesselVectorEnv)
    except gym.error.Error as error:
        raise ValueError(str(error)) from None
    mode: dict[str, Any] = {"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}
    kind, mode = ("vector_entry_point", mode) if native else ("sync", {"vector_kwargs": mode})
    env = gym.make_vec(env_id, num_envs, kind, **mode, **options)
    made: Any = env.unwrapped
    if (made if native else made.envs[0].spec).max_episode_steps is None:
        env.close()
        raise ValueError(
            f"episodes of {env_id} may never end: register it with max_episode_steps, or give that"
        )
    return env
