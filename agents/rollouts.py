"""Fly any agent in any environment over many seeds, and keep what is needed to score it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
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
from vessel_gym.simulation.core import Core
from vessel_gym.simulation.state import in_rows

Arrays = dict[str, np.ndarray]
"""Arrays with a row for each episode, by their key in ``info``."""

_TOGETHER = 8  # a multiple of the rows that a processor computes side by side


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
            that of ``input_estimate``, if the filter estimates an unknown input.
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
        ensembles: Keep the members of an ensemble estimator in the history, too.

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
        return flown(flyer, env, seeds, reset_options, record, ensembles)


def flown(
    agent: Agent, env: Any, seeds: Sequence[int], reset_options: dict[str, Any] | None = None,
    record: bool = True, ensembles: bool = False,
) -> Rollout:  # fmt: skip
    """The `rollout` of an agent in a batch of environments, one for each seed."""
    agent.reset(len(seeds))
    observations, info = env.reset(seed=seeds, options=reset_options)
    core: Any = getattr(env.unwrapped, "core", None)
    scenario, constants = core and core.now.scenario, core and core.now.episode_constants

    def watch(rows: np.ndarray, _: Any) -> None:
        frames.append(_changed(frames[-1], rows, _frame(core, ensembles), slice(None)))

    if type(env).step is VesselVectorEnv.step:
        frames = [_frame(core, ensembles) if record else {}]
        ends = run_to_ends(core, agent, env.max_episode_steps, watch if record else None)
    else:
        frames = [_numeric(info) if record else {}]
        ends = _run_others(env, agent, observations, frames)
    reasons = getattr(env.unwrapped, "end_reasons", ())
    ends["end"] = np.array([reasons[i] if reasons else "" for i in ends["end"]], object)
    history = {key: np.stack([each[key] for each in frames]) for key in frames[0]}
    drawn = {"scenario": scenario, "constants": constants}
    return Rollout(env.spec.id, np.array(seeds), **ends, history=history, env=env, **drawn)


def run_to_ends(
    core: Core,
    agent: Agent,
    horizon: int,
    watch: Callable[[np.ndarray, Any], None] | None = None,
) -> Arrays:
    """Step the B episodes that a core has begun, each up to its end.

    Episodes that have ended leave the batch. Afterwards the core is at the start again.

    Args:
        core: Environments whose episodes have begun.
        agent: It has been reset. It always gets B observations, for an ended episode the last one.
        horizon: Steps after which an episode ends.
        watch: Called after each step with the indices ``(M,)`` of the episodes in the batch, some
            perhaps several times, and the core's ``last`` before the step.

    Returns:
        Arrays ``(B,)``: score, returns, length, terminated, and the number of the end reason.
    """
    start, rows, observations = core.now, np.arange(core.num_envs), core.observe()
    ends = _ends(core)
    try:
        for step in range(1, horizon + 1):
            before, every = core.last, acted(agent, observations, core.action_shape)
            actions = np.take(every, rows, 0)
            core.advance(actions, actions.shape, info=False)
            observations = in_rows(observations, rows, core.observe())
            if watch is not None:
                watch(rows, before)
            done = (core.last.end != 0) | (step == horizon)
            if np.count_nonzero(done):
                ends = _changed(ends, rows[done], _ends(core), done)
                left = np.flatnonzero(~done)
                if not len(left):
                    break
                # Copies of others take the places of ended episodes, since each new size of a batch
                # costs time, and few rows would be another program.
                size = -(-len(left) // _TOGETHER) * _TOGETHER
                kept = np.resize(left, min(size, len(rows)))
                rows, core.last = rows[kept], core.last.take(kept)
    finally:  # also after Ctrl-C
        core.now = start
    return ends


def _ends(core: Core) -> Arrays:
    """Score, returns, length, termination and end reason of episodes that end at this step."""
    last = core.last
    return {
        "score": core.score, "returns": last.total, "length": last.steps,
        "terminated": last.end != 0, "end": last.end,
    }  # fmt: skip


def _run_others(
    env: gym.vector.VectorEnv, agent: Agent, observations: np.ndarray, frames: list[Arrays]
) -> Arrays:
    """The ends, as of `run_to_ends`, in any batch, where another episode follows each.

    A frame follows the last one after each step.
    """
    alive, ends = np.ones(env.num_envs, bool), Arrays()
    length, returns = np.zeros(env.num_envs, int), np.zeros(env.num_envs)
    while alive.any():
        action = acted(agent, observations, env.action_space.shape)
        observations, reward, terminated, truncated, info = env.step(action)
        length, returns = length + 1, returns + reward
        done = (terminated | truncated) & alive
        alive &= ~done
        final = _numeric(info.get("final_info", {}))
        values = {
            "score": final.get("score", returns), "returns": returns, "length": length,
            "terminated": terminated, "end": final.get("end", length),
        }  # fmt: skip
        ends = _changed(values | ends, done, values, done)
        going = _changed(frames[-1], alive, _numeric(info), alive)
        frames.append(_changed(going, done, final, done))
    return ends


def _changed(arrays: Arrays, rows: np.ndarray, values: Arrays, own: Any) -> Arrays:
    """Arrays whose rows have other values, perhaps of a wider type: the ``own`` rows of some."""
    changed = {}
    for key in arrays.keys() & values.keys():
        array = arrays[key].astype(np.result_type(arrays[key], values[key]), copy=False)
        changed[key] = in_rows(array, rows, values[key][own])
    return arrays | changed


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


def _frame(core: Core, ensembles: bool) -> Arrays:
    """The arrays of ``info``, the input's covariance, and an ensemble's members if asked for."""
    frame, belief = core.info(), core.now.belief
    if belief.input_cov is not None:
        frame["input_covariance"] = belief.input_cov
    if ensembles and belief.ensemble is not None:
        frame["ensemble"] = belief.ensemble
    return frame


def _numeric(info: dict[str, Any]) -> Arrays:
    """The numeric arrays of an ``info``."""
    return {
        key: value
        for key, value in info.items()
        if isinstance(value, np.ndarray) and value.dtype != object and not key.startswith("_")
    }


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
