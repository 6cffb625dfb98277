"""The start of episodes: seeds, random numbers and priors."""

from functools import lru_cache
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from gymnasium.error import ResetNeeded

from estimators import Gaussian
from estimators.checks import short_repr
from estimators.engine import as_word, compiled
from estimators.randomness import normals, threefry, two_uniforms, word
from vessel_gym.checks import is_integer
from vessel_gym.models.state_space import StateSpace
from vessel_gym.processes import block_diagonal
from vessel_gym.simulation.world import World

DRAWN = ("task", "vehicle", "parameters", "filter", "field")
"""Streams of random numbers at an episode's start, before those of the world and the sensors."""


def seeds_of(seed: Any, num_envs: int) -> list[int]:
    """Seeds of the environments: s, s + 1, ... for a number s; a random s for None.

    Raises:
        ValueError: for a seed that is negative or not a whole number, or a wrong number of seeds.
    """
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1)[0])
    if isinstance(seed, np.ndarray):
        seed = seed.tolist()
    if is_integer(seed):
        seeds = [*range(int(seed), int(seed) + num_envs)]
    elif isinstance(seed, list | tuple):
        seeds = [*seed]
    else:
        raise ValueError(f"seed must be a whole number or a list of them, got {short_repr(seed)}")
    if len(seeds) != num_envs:
        raise ValueError(f"got {len(seeds)} seeds for {num_envs} environments")
    if not all(is_integer(each) and each >= 0 for each in seeds):
        raise ValueError(f"seeds must be whole numbers >= 0, got {short_repr(seed)}")
    return [*map(int, seeds)]


def next_episodes(
    seeds: list[int], episode: np.ndarray, seed: Any, rows: np.ndarray
) -> tuple[list[int], np.ndarray]:
    """Seeds and numbers ``(B,)`` of episodes, after new ones have begun in some environments.

    Args:
        seeds: One for each environment; empty before the first episode.
        episode: ``(B,)`` number of each environment's episode since it was seeded.
        seed: A number s (environment i gets s + i) or one number for each environment, which
            restart the count of episodes; None to keep the seeds.
        rows: Indices of the environments that begin an episode.

    Raises:
        ValueError: as `seeds_of`.
        gymnasium.error.ResetNeeded: if the first reset leaves out an environment.
    """
    if not seeds and len(rows) < len(episode):
        raise ResetNeeded("the first reset must be of all environments")
    episode = episode.copy()
    if seed is None and seeds:
        episode[rows] += 1
        return seeds, episode
    new, episode[rows] = seeds_of(seed, len(episode)), 0
    chosen = {*rows.tolist()}
    return [new[i] if i in chosen else seeds[i] for i in range(len(episode))], episode


class StartNumbers(NamedTuple):
    """Keys and random numbers of an episode's start."""

    words: tuple[int, ...]  # for the keys of all parts
    # of each part that draws numbers: uniform ones, normal ones, and use of the normal ones
    counts: tuple[tuple[int, int, int], ...]
    world: int  # number of keys before those of the sensors

    @classmethod
    def of(cls, world: World, uniforms: int, prior_size: int, mismatch: float) -> "StartNumbers":
        """Numbers of a world, of a task with ``uniforms`` numbers, and of a prior.

        The prior has ``prior_size`` components of the vehicle's state.
        """
        biased = [sensor for sensor in world.sensors.each if sensor.bias is not None]
        parts = "disturbance", *(f"bias of {sensor.name}" for sensor in biased)
        sensed = (f"sensor {sensor.name}" for sensor in world.sensors.each)
        words = tuple(word(name) for name in (*DRAWN, *parts, *sensed))
        spread = world.vehicle.normals if mismatch else 0
        own = (
            (uniforms, 0, 0),
            (0, prior_size, 0),
            (0, spread, 0),
            (0, 0, 0),
            (world.disturbance.uniforms, 0, 0),
        )
        starts = [(0, root.shape[-1], 1) for root in world.start_roots]
        return cls(words, (*own, *starts), len(DRAWN) + len(parts))


@compiled(axes=(1, 0))
def start_numbers(
    seeds: np.ndarray,
    episodes: np.ndarray,
    *,
    words: tuple[int, ...],
    counts: tuple[tuple[int, int, int], ...],
) -> tuple[np.ndarray, ...]:
    """Keys of the parts of episodes, and the random numbers at their starts.

    The numbers are those of `estimators.RandomKeys` at step 0.

    Args:
        seeds: ``(..., 2)`` keys.
        episodes: ``(...)`` numbers of the episodes.
        words: As of `StartNumbers`.
        counts: As of `StartNumbers`.

    Returns:
        Keys ``(..., parts, 2)``, numbers ``(..., k)`` of each stream of `DRAWN`, and those of the
        slow processes of the world.
    """
    zero: Any = np.uint64(0)
    own = threefry(as_word(episodes), zero, seeds[..., 0], seeds[..., 1])
    keys = [np.stack(threefry(np.uint64(each), zero, *own), -1) for each in words]
    drawn: list[list[np.ndarray]] = []
    for key, (uniforms, count, use) in zip(keys, counts, strict=False):  # sensors draw none
        pairs = (two_uniforms(key, np.uint64(i), zero) for i in range((uniforms + 1) // 2))
        numbers = [pair[..., i] for pair in pairs for i in range(2)][:uniforms]
        drawn.append([*numbers, *normals(key, zero, count, use)])
    named = *drawn[: len(DRAWN)], [*chain(*drawn[len(DRAWN) :])]
    empty = np.zeros((*episodes.shape, 0))
    return np.stack(keys, -2), *(np.stack(each, -1) if each else empty for each in named)


def filter_prior(prior: Gaussian, space: StateSpace) -> Gaussian:
    """Prior of the states that a filter estimates."""
    start, n = _start(prior.cov.tobytes(), len(prior.cov), space), len(space.vehicle_states)
    mean = np.zeros((len(prior.mean), len(start.cov)))
    mean[:, :n] = prior.mean[:, :n]
    return start.about(mean)


@lru_cache(maxsize=16)
def _start(cov: bytes, n: int, space: StateSpace) -> Gaussian:
    """Prior of a filter about 0, given the covariance ``(n, n)`` of the vehicle."""
    whole = space.joint_prior(np.frombuffer(cov).reshape(n, n))
    bias = np.arange(len(whole) - space.sensors.bias.size, len(whole))
    kept = np.concatenate([np.arange(len(space.vehicle_states)), n + space.kept, bias])
    known = whole[np.ix_(kept, kept)]
    if space.stacked:
        known = block_diagonal(known, space.input_cov)
    if space.last:  # nothing acted before the start: a negligible, not singular variance
        known = block_diagonal(known, 1e-6 * space.cov[np.ix_(space.last, space.last)])
    return Gaussian(np.zeros(len(known)), known)
